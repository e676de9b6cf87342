"""Vectors of triangles: as numpy has them, and none from faces that name no vertex."""

import numpy as np
import pytest
import reference

from morphofold import geometry
from morphofold.errors import OutOfRange
from morphofold.shapes import icosphere, irregular_sphere


def test_face_vectors_are_half_the_cross_products(rng):
    verts, faces = irregular_sphere(3, radius=50.0, rng=rng)
    np.testing.assert_array_equal(geometry.face_vectors(verts, faces), reference.face_vectors(verts, faces))


@pytest.mark.parametrize("shift", [+1, -1])
def test_a_face_with_a_vertex_that_is_not_there_is_refused(shift):
    verts, faces = icosphere(0)
    with pytest.raises(OutOfRange, match=r"\b0\.\.11\b"):
        geometry.vertex_areas(verts, faces + shift)
