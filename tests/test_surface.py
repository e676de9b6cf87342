"""Surface, Cortex and check_mesh: what they refuse, and that they cannot be changed."""

import dataclasses
import re

import numpy as np
import pytest

from morphofold import geometry
from morphofold.errors import BadMesh, MissingPart, NotFinite, OutOfRange, UnknownName, UnlikeSurfaces, WrongShape
from morphofold.geometry import face_areas
from morphofold.mesh_quality import checks
from morphofold.shapes import icosphere
from morphofold.surface import Cortex, Regions, Surface
from morphofold.validators import check_mesh


@pytest.fixture
def ball():
    return icosphere(1, radius=10.0)


def cortex(**changes):
    verts, faces = icosphere(1, radius=10.0)
    parts = {"white": Surface(verts, faces, "lh.white"), "pial": Surface(verts * 1.2, faces, "lh.pial")}
    return Cortex(**{**parts, **changes})


def open_shell(level=4):
    verts, faces = icosphere(level)
    return verts, faces[verts[faces][:, :, 2].min(axis=1) > -0.6]


@pytest.mark.parametrize("only", ["white", "pial", "other vertices", "same vertices"])
def test_a_few_vertices_that_are_nan_at_a_border_are_left_out_with_their_triangles(only):
    verts, faces = open_shell()
    border = np.unique(geometry.border_edges(faces))
    gone = {"white": (border[:4], []), "pial": ([], border[:4]), "other vertices": (border[:3], border[2:5])}
    inner, outer = gone.get(only, (border[:4], border[:4]))
    white, pial = 47 * verts, 50 * verts
    white[inner], pial[outer] = np.nan, np.nan
    cortex = (
        Cortex.from_arrays(white, pial, faces)
        if only == "white"
        else Cortex(*(Surface(v, faces) for v in (white, pial)))
    )
    left = faces[~np.isin(faces, np.union1d(inner, outer).astype(int)).any(axis=1)]
    assert 0.99 * len(faces) <= len(left) < len(faces)
    assert np.array_equal(cortex.faces, left)
    assert np.isfinite(cortex.white.verts).all()
    assert (cortex.white.unknown, cortex.pial.unknown) == (len(inner), len(outer))


def test_a_vertex_of_no_triangle_may_be_nan():
    verts, faces = icosphere(2)
    surface = Surface(np.vstack([verts, [[np.nan] * 3]]), faces)
    assert surface.unknown == 1
    assert np.isfinite(surface.verts).all()
    assert np.array_equal(surface.faces, faces)


@pytest.mark.parametrize("case", ["closed", "many", "infinite"])
def test_nan_elsewhere_is_refused(case):
    verts, faces = icosphere(4) if case == "closed" else open_shell()
    verts = verts.copy()
    border = np.unique(geometry.border_edges(faces)) if case != "closed" else [7]
    verts[border if case == "many" else border[:1]] = np.inf if case == "infinite" else np.nan
    with pytest.raises(NotFinite):
        Surface(verts, faces)


def test_a_sound_mesh_is_accepted(ball):
    check_mesh(*ball)


@pytest.mark.parametrize("shape", [(3, 42), (42,), (0, 3), (42, 2)])
def test_vertices_of_another_shape_are_refused(ball, shape):
    with pytest.raises(WrongShape, match=rf"\bverts\b.*{re.escape(str(shape))}"):
        check_mesh(np.zeros(shape), ball[1])


@pytest.mark.parametrize("shape", [(80, 4), (80,), (0, 3)])
def test_faces_of_another_shape_are_refused(ball, shape):
    with pytest.raises(WrongShape, match=rf"\bfaces\b.*{re.escape(str(shape))}"):
        check_mesh(ball[0], np.zeros(shape, dtype=int))


def test_faces_that_are_not_integers_are_refused(ball):
    with pytest.raises(TypeError, match=r"\bfaces\b.*\bfloat64\b"):
        check_mesh(ball[0], ball[1].astype(float))


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_vertex_that_is_not_finite_is_named(ball, value):
    verts = ball[0].copy()
    verts[7, 1] = value
    with pytest.raises(NotFinite, match=r"\b1 of 42\b.*\b7\b"):
        check_mesh(verts, ball[1])


@pytest.mark.parametrize("shift", [+1, -1])
def test_a_vertex_index_out_of_range_is_refused(ball, shift):
    with pytest.raises(OutOfRange, match=r"\b0\.\.41\b"):
        check_mesh(ball[0], ball[1] + shift)


def test_a_face_that_names_a_vertex_twice_is_named(ball):
    faces = ball[1].copy()
    faces[5] = [3, 4, 3]
    with pytest.raises(BadMesh, match=r"\b1 of 80\b.*\b5 = \[3, 4, 3\]"):
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
    with pytest.raises(OutOfRange, match=r"lh\.pial: \d+ of 80\b"):
        Surface(ball[0], ball[1] + 1, name="lh.pial")


def test_white_and_pial_of_different_counts_are_refused_with_both_counts():
    with pytest.raises(UnlikeSurfaces, match=r"lh\.white\b.*\b42\b.*rh\.pial\b.*\b162\b"):
        cortex(pial=Surface(*icosphere(2), name="rh.pial"))


def test_white_and_pial_with_different_faces_are_refused(ball):
    with pytest.raises(UnlikeSurfaces, match=r"lh\.white\b.*lh\.pial\b.*\b42\b"):
        cortex(pial=Surface(ball[0], ball[1][::-1], name="lh.pial"))


def test_a_hemisphere_that_is_neither_left_nor_right_is_refused():
    with pytest.raises(UnknownName, match=r"lh, rh.*'left'"):
        cortex(hemi="left")


@pytest.mark.parametrize(
    ("name", "size", "changes"),
    [
        ("thickness", "(41,", {"maps": {"thickness": np.ones(41)}}),
        ("cortex label", "(43,", {"cortex": np.ones(43, dtype=bool)}),
        ("regions", "(40,", {"regions": Regions(np.zeros(40, dtype=int), ("a",), np.zeros((1, 3), dtype=np.uint8))}),
        ("inflated", "(162,", {"inflated": Surface(*icosphere(2))}),
    ],
)
def test_a_map_of_another_surface_is_refused_by_name(name, size, changes):
    with pytest.raises(WrongShape, match=rf"\b{name}\b.*{re.escape(size)}.*\b42\b"):
        cortex(**changes)


def test_a_cortex_counts_its_vertices_and_shows_the_common_faces():
    c = cortex(maps={"thickness": np.full(42, 2.0)})
    assert c.n_vertices == 42
    assert c.faces is c.white.faces


# --- nouns in the wrong place


def public():
    """Public functions that take a noun, each with the noun that it takes."""
    import morphofold as mf
    from morphofold import analysis

    of_arrays = [
        analysis.crest_lines,
        analysis.curvature,
        analysis.fractal_dimension,
        analysis.gyrification_index,
        analysis.local_gyrification_index,
        analysis.sulcal_depth,
        analysis.vertex_areas,
        analysis.vertex_normals,
        analysis.wavelength,
    ]
    return {
        "one": [
            mf.measure,
            mf.compare,
            mf.estimate_error,
            analysis.euler_characteristic,
            analysis.gray_volumes,
            analysis.gyral_graph,
            analysis.gyral_thickness,
            analysis.hinge_sensitivity,
            analysis.hinge_shapes,
            analysis.hinges,
            lambda x: analysis.region_table(x, {}),
            lambda x: mf.compare({"model": x}),
        ],
        "two": [mf.Cortex, mf.Surface, analysis.cortical_thickness, *of_arrays],
    }


@pytest.mark.parametrize("wrong", ["lh.pial", None, 3, Surface, {}.keys()], ids=str)
def test_the_wrong_noun_is_a_type_error_everywhere(wrong):
    for function in public()["one"]:
        with pytest.raises(TypeError):
            function(wrong)
    for function in public()["two"]:
        with pytest.raises(TypeError):
            function(wrong, wrong)


def test_bare_arrays_and_surfaces_in_place_of_each_other_are_type_errors(ball):
    functions = public()
    for function in functions["one"]:
        with pytest.raises(TypeError):
            function((ball[0], ball[1]))
    surface = Surface(*ball)
    for function in functions["two"]:
        with pytest.raises(TypeError):
            function((ball[0], ball[1]), (ball[0], ball[1]))
        with pytest.raises(TypeError):
            function(surface, ball[1])
    for function in functions["one"][-2:]:
        with pytest.raises(TypeError):
            function(surface)


def test_sequences_of_numbers_make_a_surface_and_uneven_ones_do_not(ball):
    assert np.array_equal(Surface(ball[0].tolist(), ball[1].tolist()).verts, ball[0])
    with pytest.raises(TypeError):
        Surface([[0, 0, 0], [1, 0]], ball[1])


# --- what other packages and people see


@pytest.mark.parametrize("level", [1, 5])
def test_reprs_hold_counts_and_no_arrays(level):
    verts, faces = icosphere(level, radius=10.0)
    surface = Surface(verts, faces, "lh.pial")
    regions = Regions(np.zeros(len(verts), int), ("a", "b"), np.zeros((2, 3), np.uint8))
    both = Cortex(surface, Surface(verts * 1.2, faces), regions=regions, maps={"curv": verts[:, 0]})
    for noun in (surface, regions, both):
        assert len(repr(noun)) < 80
        assert f"{len(verts):,} vertices" in repr(noun)
    assert "lh.pial" in repr(surface)


def test_nilearn_takes_a_surface_for_a_mesh(ball):
    from nilearn.surface import load_surf_mesh

    surface = Surface(*ball)
    mesh = load_surf_mesh(surface)
    np.testing.assert_array_equal(mesh.coordinates, surface.verts)
    np.testing.assert_array_equal(mesh.faces, surface.faces)


def test_coordinates_can_be_turned_and_changed_and_the_surface_stays(ball):
    from scipy.spatial.transform import Rotation

    surface = Surface(*ball)
    turned = Rotation.from_euler("z", 90, degrees=True).apply(surface.coordinates)
    np.testing.assert_allclose(turned[:, 1], surface.verts[:, 0], atol=1e-12)
    surface.coordinates[:] = 0
    assert np.array_equal(surface.verts, ball[0])


# --- arrays in, and copies for other libraries out


@pytest.fixture
def rough_cortex(rng):
    """A cortex without symmetry, with two maps, one of them with a gap, and a triangle that names a vertex twice."""
    verts, faces = icosphere(3, radius=40.0)
    verts = verts + rng.standard_normal(verts.shape)
    faces = np.concatenate([faces, [[0, 0, 1]]])
    gap = rng.standard_normal(len(verts))
    gap[7] = np.nan
    return Cortex.from_arrays(0.9 * verts, verts, faces, hemi="rh", name="rough", maps={"gap": gap, "x": verts[:, 0]})


def test_arrays_make_the_same_cortex_as_surfaces(rough_cortex):
    white, pial = rough_cortex.white, rough_cortex.pial
    assert (white.name, pial.name, rough_cortex.hemi, rough_cortex.origin) == ("rh.white", "rh.pial", "rh", "arrays")
    assert np.array_equal(white.verts, 0.9 * pial.verts)
    assert white.faces is pial.faces
    with pytest.raises(UnlikeSurfaces):
        Cortex.from_arrays(white.verts[:-1], pial.verts, white.faces[(white.faces < 600).all(axis=1)])


@pytest.mark.parametrize("name", ["white", "pial"])
@pytest.mark.parametrize("to", ["to_trimesh", "to_pyvista"])
def test_copies_for_other_libraries_hold_the_same_numbers_in_the_same_order(rough_cortex, name, to):
    surface, copy = getattr(rough_cortex, name), getattr(rough_cortex, to)(name)
    verts, faces, maps = (
        (copy.vertices, copy.faces, copy.vertex_attributes)
        if to == "to_trimesh"
        else (copy.points, copy.regular_faces, copy.point_data)
    )
    assert np.array_equal(verts, surface.verts)
    assert verts.dtype == np.float64
    assert np.array_equal(faces, surface.faces)
    assert {key: maps[key].tobytes() for key in maps} == {k: v.tobytes() for k, v in rough_cortex.maps.items()}
    back = Surface(np.array(verts), np.array(faces))
    assert np.array_equal(back.verts, surface.verts)


def test_other_libraries_find_our_volume_and_area(rough_cortex):
    surface = rough_cortex.pial
    volume, area = checks.volume(surface), face_areas(surface.verts, surface.faces).sum()
    mesh, poly = surface.to_trimesh(), surface.to_pyvista()
    assert [mesh.volume, poly.volume] == pytest.approx([volume, volume], rel=1e-12)
    assert [mesh.area, poly.area] == pytest.approx([area, area], rel=1e-12)


def test_a_copy_can_be_changed_and_the_surface_stays(rough_cortex):
    before = rough_cortex.pial.verts.copy()
    mesh, poly = rough_cortex.to_trimesh(), rough_cortex.to_pyvista()
    mesh.vertices *= 2
    mesh.faces[0] = [3, 4, 5]
    poly.points[:] = 0
    poly.point_data["x"][:] = 0
    assert np.array_equal(rough_cortex.pial.verts, before)
    assert np.array_equal(rough_cortex.maps["x"], before[:, 0])
    assert rough_cortex.faces[0].tolist() != [3, 4, 5]


def test_a_map_of_another_length_and_a_surface_that_is_not_there_are_refused(rough_cortex):
    for to in (rough_cortex.pial.to_trimesh, rough_cortex.pial.to_pyvista):
        with pytest.raises(WrongShape, match="641"):
            to({"short": np.zeros(641)})
    with pytest.raises(MissingPart, match="white, pial"):
        rough_cortex.to_trimesh("inflated")
    with pytest.raises(UnknownName, match="inflated"):
        rough_cortex.to_pyvista("middle")
