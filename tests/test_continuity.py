"""The law of continuity: what changes nothing of a cortex moves none of its maps and tables."""

import numpy as np
import pytest
from made_changes import CHANGES, changed
from scipy.spatial import cKDTree

from morphofold.analysis import measure
from morphofold.geometry import vertex_normals
from morphofold.io import read_cortex, sample_path
from morphofold.shapes import icosphere
from morphofold.surface import Cortex, Surface

# largest change points any vertex, of the 90th percentile of a map: curvature is fitted, and solvers stop points 1e-6
MAP_BOUND = 1e-5
# contours of voxels are not mirrored triangle by triangle
MIRRORED_LOCAL_GYRIFICATION_BOUND = 2e-3
HINGE_BOUND_MM = 1e-4
TABLE_BOUND = 2e-3  # relative, of an angle, a curvature or a strength; lengths and thicknesses: 1e-5
NUMBERING = {"hinge", "crest", "from_hinge", "to_hinge", "arm", "vertex", "x", "y", "z"}
SMOOTH = {"length_mm", "gyral_thickness_mm", "cortical_thickness_mm", "area_mm2", "gray_volume_mm3", "thickness_mm"}


@pytest.fixture(scope="module", params=[pytest.param("fsaverage5", marks=pytest.mark.slow), "simulated"])
def before(request):
    cortex = read_cortex(sample_path(request.param), hemi="lh")
    return cortex, measure(cortex, accuracy="draft")


@pytest.mark.parametrize("change", CHANGES)
def test_what_changes_nothing_moves_no_map_and_no_row(before, change):
    cortex, measures = before
    new, place, back = changed(cortex, change)
    other = measure(new, accuracy="draft")
    for name, values in measures.maps.items():
        voxels = change == "mirror" and name == "local_gyrification_index"
        bound = (MIRRORED_LOCAL_GYRIFICATION_BOUND if voxels else MAP_BOUND) * np.nanpercentile(np.abs(values), 90)
        np.testing.assert_allclose(other.maps[name][place], values, rtol=0, atol=bound, err_msg=name)
    assert [k for k, v in other.scalars.items() if v is None] == [k for k, v in measures.scalars.items() if v is None]
    for name, value in ((k, v) for k, v in measures.scalars.items() if v is not None):
        assert other.scalars[name] == pytest.approx(value, rel=1e-4, abs=1e-9), name
    for name in ("regions", "crests", "hinges", "arms", "shapes"):
        assert_same_rows(getattr(measures, name), getattr(other, name), name)
    points, there = (np.array([[row[k] for k in "xyz"] for row in m.hinges]) for m in (measures, other))
    away, nearest = cKDTree(back(there)).query(points)
    assert away.max() < HINGE_BOUND_MM
    assert [other.hinges[k]["shape"] for k in nearest] == [row["shape"] for row in measures.hinges]


def test_noise_moves_no_arm_of_a_body_with_three_planes_of_symmetry():
    verts, faces = icosphere(4)
    bumps = np.cos(6 * verts).prod(axis=1)
    verts = verts * (50 + 3 * bumps + 2 * np.cos(14 * verts[:, 2]))[:, None]
    cortex = Cortex(Surface(verts - 2 * vertex_normals(verts, faces), faces), Surface(verts, faces))
    measures, other = (measure(c, accuracy="draft").arms for c in (cortex, changed(cortex, "noise")[0]))
    angles = [np.sort([row["angle_deg"] for row in rows]) for rows in (measures, other)]
    np.testing.assert_allclose(*angles, rtol=TABLE_BOUND)


def assert_same_rows(measures, other, name):
    """Columns of two tables as sets, because rows are in the order of positions."""
    assert len(other) == len(measures), name
    for key in {key for row in measures for key in row} - NUMBERING:
        values, theirs = ([row.get(key) for row in rows] for rows in (measures, other))
        if any(isinstance(value, str) for value in values):
            assert sorted(map(str, theirs)) == sorted(map(str, values)), (name, key)
        else:
            a, b = (np.sort(np.array(values, dtype=np.float64)) for values in (values, theirs))
            bound = 1e-5 if key in SMOOTH else TABLE_BOUND
            np.testing.assert_allclose(b, a, rtol=bound, atol=1e-6 * np.nanmax(np.abs(a), initial=0), err_msg=key)
