"""Gyrification index against shapes whose hull is known."""

import numpy as np
import pytest

from morphofold.analysis import gyrification_index
from morphofold.errors import BadMesh
from morphofold.io import read_surface, sample_path
from morphofold.studies import shapes


def box_with_a_hole(depth):
    """Unit cube whose top face (z = 1) has a square hole of side 1/2 sunk to the given depth."""
    ring = lambda r, z: [[s * r + 0.5, t * r + 0.5, z] for s, t in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    verts = np.array(ring(0.5, 0) + ring(0.5, 1) + ring(0.25, 1) + ring(0.25, 1 - depth))
    quads = [[3, 2, 1, 0], [12, 13, 14, 15]]
    for low in (0, 4, 8):
        quads += [[low + k, low + (k + 1) % 4, low + 4 + (k + 1) % 4, low + 4 + k] for k in range(4)]
    quads = np.array(quads)
    return verts, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def test_gyrification_of_a_convex_surface_is_one(rng):
    for shape in (shapes.sphere(4, rng=rng), shapes.ellipsoid(4, rng=rng)):
        assert gyrification_index(shape.verts, shape.faces) == pytest.approx(1, abs=1e-3)


def test_gyrification_of_a_cube_with_a_hole_counts_the_walls_of_the_hole():
    for depth in (0.1, 0.5, 0.9):
        assert gyrification_index(*box_with_a_hole(depth)) == pytest.approx((6 + 4 * 0.5 * depth) / 6)


def test_gyrification_does_not_depend_on_size_place_or_unused_vertices():
    verts, faces = box_with_a_hole(0.5)
    moved = np.concatenate([7 * verts - 100, [[1e4, 0, 0]]])
    assert gyrification_index(moved, faces) == pytest.approx(gyrification_index(verts, faces), rel=1e-12)


def test_the_pial_surface_of_fsaverage5_has_a_gyrification_of_1_65():
    pial = read_surface(sample_path("fsaverage5") / "surf" / "lh.pial")
    assert gyrification_index(pial.verts, pial.faces) == pytest.approx(1.65, abs=0.01)


def test_a_flat_patch_is_refused():
    verts = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.0]])
    with pytest.raises(BadMesh, match=r"\b4\b"):
        gyrification_index(verts, np.array([[0, 1, 2], [0, 2, 3]]))
