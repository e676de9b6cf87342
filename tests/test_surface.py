"""Surface, Cortex and check_mesh: what they refuse, and that they cannot be changed."""

import dataclasses

import numpy as np
import pytest

from morphofold.shapes import icosphere
from morphofold.surface import Cortex, Regions, Surface, check_mesh


@pytest.fixture
def ball():
    return icosphere(1, radius=10.0)


def cortex(**changes):
    verts, faces = icosphere(1, radius=10.0)
    parts = {"white": Surface(verts, faces, "lh.white"), "pial": Surface(verts * 1.2, faces, "lh.pial")}
    return Cortex(**{**parts, **changes})


def test_a_sound_mesh_is_accepted(ball):
    check_mesh(*ball)


@pytest.mark.parametrize("shape", [(3, 42), (42,), (0, 3), (42, 2)])
def test_vertices_of_another_shape_are_refused(ball, shape):
    with pytest.raises(ValueError, match=r"verts must have shape \(N, 3\)"):
        check_mesh(np.zeros(shape), ball[1])


@pytest.mark.parametrize("shape", [(80, 4), (80,), (0, 3)])
def test_faces_of_another_shape_are_refused(ball, shape):
    with pytest.raises(ValueError, match=r"faces must have shape \(M, 3\)"):
        check_mesh(ball[0], np.zeros(shape, dtype=int))


def test_faces_that_are_not_integers_are_refused(ball):
    with pytest.raises(TypeError, match="faces must be integers, got dtype float64"):
        check_mesh(ball[0], ball[1].astype(float))


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_vertex_that_is_not_finite_is_named(ball, value):
    verts = ball[0].copy()
    verts[7, 1] = value
    with pytest.raises(ValueError, match="1 of 42 vertices are not finite; the first is vertex 7"):
        check_mesh(verts, ball[1])


@pytest.mark.parametrize("shift", [+1, -1])
def test_a_vertex_index_out_of_range_is_refused(ball, shift):
    with pytest.raises(ValueError, match=r"name a vertex outside 0\.\.41; the first is face"):
        check_mesh(ball[0], ball[1] + shift)


def test_a_face_that_names_a_vertex_twice_is_named(ball):
    faces = ball[1].copy()
    faces[5] = [3, 4, 3]
    with pytest.raises(ValueError, match=r"1 of 80 faces name a vertex twice; .* face 5 = \[3, 4, 3\]"):
        check_mesh(ball[0], faces)


def test_a_surface_is_read_only_and_does_not_share_its_input(ball):
    verts, faces = ball[0].copy(), ball[1].astype(np.int32)
    surface = Surface(verts, faces)
    verts[0] = 99.0
    assert surface.verts.dtype == np.float64
    assert surface.faces.dtype == np.int64
    assert np.array_equal(surface.verts, ball[0])
    with pytest.raises(ValueError, match="read-only"):
        surface.verts[0] = 0.0
    with pytest.raises(ValueError, match="read-only"):
        surface.faces[0] = 0
    with pytest.raises(dataclasses.FrozenInstanceError):
        surface.name = "other"


def test_an_error_says_which_surface_it_means(ball):
    with pytest.raises(ValueError, match=r"lh\.pial: \d+ of 80 faces"):
        Surface(ball[0], ball[1] + 1, name="lh.pial")


def test_white_and_pial_of_different_counts_are_refused_with_both_counts():
    with pytest.raises(ValueError, match=r"white \(lh.white\) has 42 vertices and pial \(rh.pial\) has 162"):
        cortex(pial=Surface(*icosphere(2), name="rh.pial"))


def test_white_and_pial_with_different_faces_are_refused(ball):
    with pytest.raises(ValueError, match="have 42 vertices each but different faces"):
        cortex(pial=Surface(ball[0], ball[1][::-1], name="lh.pial"))


def test_a_hemisphere_that_is_neither_left_nor_right_is_refused():
    with pytest.raises(ValueError, match="hemi must be 'lh' or 'rh', got 'left'"):
        cortex(hemi="left")


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("thickness", {"maps": {"thickness": np.ones(41)}}),
        ("cortex label", {"cortex": np.ones(43, dtype=bool)}),
        ("regions", {"regions": Regions(np.zeros(40, dtype=int), ("a",), np.zeros((1, 3), dtype=np.uint8))}),
        ("inflated", {"inflated": Surface(*icosphere(2))}),
    ],
)
def test_a_map_of_another_surface_is_refused_by_name(name, changes):
    with pytest.raises(ValueError, match=f"{name} has shape .* the surfaces have 42 vertices"):
        cortex(**changes)


def test_a_cortex_counts_its_vertices_and_shows_the_common_faces():
    c = cortex(maps={"thickness": np.full(42, 2.0)})
    assert c.n_vertices == 42
    assert c.faces is c.white.faces
