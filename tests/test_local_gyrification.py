"""Local gyrification: 1 on what is convex, the ratio of areas where folds are even, and what it refuses."""

import numpy as np
import pytest

from morphofold.analysis import gyrification_index, local_gyrification_index
from morphofold.analysis.gyrification.local_gyrification import envelope
from morphofold.errors import OpenSurface, OutOfRange, TooLarge
from morphofold.geometry import face_areas, vertex_areas
from morphofold.studies.shapes import ellipsoid, ridged_sphere, sphere


@pytest.mark.parametrize("shape", [sphere(5), ellipsoid(5, (60.0, 45.0, 35.0), rng=2)], ids=["sphere", "ellipsoid"])
def test_a_convex_surface_is_its_own_envelope(shape):
    points, triangles = envelope(shape.verts, shape.faces, 15.0, 1.25)
    assert face_areas(points, triangles).sum() == pytest.approx(face_areas(shape.verts, shape.faces).sum(), rel=0.01)
    index = local_gyrification_index(shape.verts, shape.faces)
    np.testing.assert_allclose(index, 1, atol=0.03)
    assert np.average(index, weights=vertex_areas(shape.verts, shape.faces)) == pytest.approx(1, abs=0.01)


def test_even_folds_have_everywhere_what_they_have_in_all():
    """Ridges 4 mm high that a ball of 15 mm bridges: the envelope is a sphere of the radius of their crests."""
    cortex, _ = ridged_sphere(6, rng=1)
    verts, faces = cortex.pial.verts, cortex.faces
    index = local_gyrification_index(verts, faces)
    mean = np.average(index, weights=vertex_areas(verts, faces))
    points, triangles = envelope(verts, faces, 15.0, 1.25)
    total = face_areas(verts, faces).sum()
    assert mean == pytest.approx(total / face_areas(points, triangles).sum(), rel=0.01)
    assert index.std() < 0.03
    assert mean >= gyrification_index(verts, faces)  # a hull is the closing by an infinite ball


def test_lengths_of_another_unit_change_nothing():
    cortex, _ = ridged_sphere(5)
    verts, faces = cortex.pial.verts, cortex.faces
    there, cwd = (local_gyrification_index(f * verts, faces, closing=f * 15, region=f * 25) for f in (1.0, 0.001))
    np.testing.assert_allclose(there, cwd, rtol=1e-6)


def test_a_vertex_that_no_face_uses_has_none():
    shape = sphere(4)
    index = local_gyrification_index(np.vstack([shape.verts, [[500.0, 0, 0]]]), shape.faces)
    assert np.isnan(index[-1])
    assert np.isfinite(index[:-1]).all()


def test_what_can_not_be_is_refused():
    shape = sphere(3)
    with pytest.raises(OpenSurface):
        local_gyrification_index(shape.verts, shape.faces[1:])
    with pytest.raises(OutOfRange, match=r"\bclosing\b.* 0\.0\b"):
        local_gyrification_index(shape.verts, shape.faces, closing=0.0)
    with pytest.raises(TooLarge, match=r"\d mm .*\d mm; .*\d mm\b"):
        local_gyrification_index(1000 * shape.verts, shape.faces)
