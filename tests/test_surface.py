"""Surface, Cortex and check_mesh: what they refuse, and that they cannot be changed."""

import dataclasses

import numpy as np
import pytest
from nilearn.surface import load_surf_mesh
from scipy.spatial.transform import Rotation

import morphofold as mf
from morphofold import analysis, geometry
from morphofold.errors import BadMesh, MissingPart, NotFinite, OutOfRange, UnknownName, UnlikeSurfaces, WrongShape
from morphofold.geometry import face_areas
from morphofold.mesh_quality import cortex_checks
from morphofold.shapes import icosphere
from morphofold.surface import Cortex, Regions, Surface
from morphofold.validators import check_mesh

VERTS, FACES = icosphere(1, radius=10.0)


def cortex(**changes):
    parts = {"white": Surface(VERTS, FACES, "lh.white"), "pial": Surface(VERTS * 1.2, FACES, "lh.pial")}
    return Cortex(**{**parts, **changes})


def open_shell(level=4):
    verts, faces = icosphere(level)
    return verts, faces[verts[faces][:, :, 2].min(axis=1) > -0.6]


@pytest.mark.parametrize("only", ["white", "pial", "other vertices", "same vertices"])
def test_a_few_vertices_that_are_nan_at_a_border_are_left_out_with_their_triangles(only):
    verts, faces = open_shell()
    border = np.unique(geometry.border_edges(faces))
    missing = {"white": (border[:4], []), "pial": ([], border[:4]), "other vertices": (border[:3], border[2:5])}
    inner, outer = missing.get(only, (border[:4], border[:4]))
    white, pial = 47 * verts, 50 * verts
    white[inner], pial[outer] = np.nan, np.nan
    surfaces = [Surface(verts, faces) for verts in (white, pial)]
    cortex = Cortex.from_arrays(white, pial, faces) if only == "white" else Cortex(*surfaces)
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


def with_value(array, index, value):
    changed = array.copy()
    changed[index] = value
    return changed


@pytest.mark.parametrize(
    ("verts", "faces", "error", "message"),
    [
        (VERTS.T, FACES, WrongShape, r"\bverts\b.*\(3, 42\)"),
        (np.zeros((0, 3)), FACES, WrongShape, r"\bverts\b.*\(0, 3\)"),
        (VERTS, FACES[:, 0], WrongShape, r"\bfaces\b.*\(80,\)"),
        (VERTS, FACES[:0], WrongShape, r"\bfaces\b.*\(0, 3\)"),
        (VERTS, FACES.astype(float), TypeError, r"\bfaces\b.*\bfloat64\b"),
        (with_value(VERTS, (7, 1), np.inf), FACES, NotFinite, r"\b1 of 42\b.*\b7\b"),
        (VERTS, FACES + 1, OutOfRange, r"\b0\.\.41\b"),
        (VERTS, FACES - 1, OutOfRange, r"\b0\.\.41\b"),
        (VERTS, with_value(FACES, 5, [3, 4, 3]), BadMesh, r"\b1 of 80\b.*\b5 = \[3, 4, 3\]"),
    ],
)
def test_what_is_no_sound_mesh_is_refused(verts, faces, error, message):
    check_mesh(VERTS, FACES)
    with pytest.raises(error, match=message):
        check_mesh(verts, faces)


def test_a_surface_is_read_only_and_does_not_share_its_input():
    verts, faces = VERTS.copy(), FACES.astype(np.int32)
    surface = Surface(verts, faces)
    verts[0] = 99.0
    assert surface.verts.dtype == np.float64
    assert surface.faces.dtype == np.int64
    assert np.array_equal(surface.verts, VERTS)
    with pytest.raises(ValueError, match="read-only"):
        surface.verts[0] = 0.0
    with pytest.raises(ValueError, match="read-only"):
        surface.faces[0] = 0
    with pytest.raises(dataclasses.FrozenInstanceError):
        surface.name = "other"


@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        ({"pial": Surface(*icosphere(2), "rh.pial")}, UnlikeSurfaces, r"lh\.white\b.*\b42\b.*rh\.pial\b.*\b162\b"),
        ({"pial": Surface(VERTS, FACES[::-1], "lh.pial")}, UnlikeSurfaces, r"lh\.white\b.*lh\.pial\b.*\b42\b"),
        ({"hemi": "left"}, UnknownName, r"lh, rh.*'left'"),
        ({"maps": {"thickness": np.ones(41)}}, WrongShape, r"\bthickness\b.*\(41,.*\b42\b"),
        ({"cortex": np.ones(43, bool)}, WrongShape, r"\bcortex label\b.*\(43,.*\b42\b"),
        (
            {"regions": Regions(np.zeros(40, int), ("a",), np.zeros((1, 3), np.uint8))},
            WrongShape,
            r"\bregions\b.*\(40,.*\b42\b",
        ),
        ({"inflated": Surface(*icosphere(2))}, WrongShape, r"\binflated\b.*\(162,.*\b42\b"),
    ],
)
def test_what_does_not_belong_to_a_cortex_is_refused_by_name(changes, error, message):
    with pytest.raises(error, match=message):
        cortex(**changes)


def test_an_error_says_which_surface_it_means():
    with pytest.raises(OutOfRange, match=r"lh\.pial: \d+ of 80\b"):
        Surface(VERTS, FACES + 1, name="lh.pial")


def test_a_cortex_counts_its_vertices_and_shows_the_common_faces():
    c = cortex(maps={"thickness": np.full(42, 2.0)})
    assert c.n_vertices == 42
    assert c.faces is c.white.faces


# --- nouns in the wrong place


NAMES_OF_ONE = "euler_characteristic gray_volumes gyral_graph gyral_thickness hinge_sensitivity hinge_shapes hinges"
NAMES_OF_TWO = "cortical_thickness crest_lines curvature fractal_dimension gyrification_index local_gyrification_index "
NAMES_OF_TWO += "sulcal_depth vertex_areas vertex_normals wavelength"
#: public functions that take one cortex or measures, and those that take two surfaces or arrays
OF_ONE = [
    *(mf.measure, mf.compare, mf.estimate_error, *(getattr(analysis, name) for name in NAMES_OF_ONE.split())),
    lambda x: analysis.region_table(x, {}),
    lambda x: mf.compare({"model": x}),
]
OF_TWO = [mf.Cortex, mf.Surface, *(getattr(analysis, name) for name in NAMES_OF_TWO.split())]


@pytest.mark.parametrize(
    "wrong", ["lh.pial", None, 3, Surface, {}.keys(), (VERTS, FACES)], ids=lambda x: type(x).__name__
)
def test_the_wrong_noun_is_a_type_error_everywhere(wrong):
    for function in OF_ONE:
        with pytest.raises(TypeError):
            function(wrong)
    for function in OF_TWO:
        with pytest.raises(TypeError):
            function(wrong, wrong)


def test_a_surface_in_place_of_arrays_or_of_a_cortex_is_a_type_error():
    surface = Surface(VERTS, FACES)
    for function in OF_TWO:
        with pytest.raises(TypeError):
            function(surface, FACES)
    for function in OF_ONE[-2:]:
        with pytest.raises(TypeError):
            function(surface)


def test_sequences_of_numbers_make_a_surface_and_uneven_ones_do_not():
    assert np.array_equal(Surface(VERTS.tolist(), FACES.tolist()).verts, VERTS)
    with pytest.raises(TypeError):
        Surface([[0, 0, 0], [1, 0]], FACES)


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


def test_nilearn_and_scipy_take_a_surface_and_it_stays():
    surface = Surface(VERTS, FACES)
    mesh = load_surf_mesh(surface)
    np.testing.assert_array_equal(mesh.coordinates, surface.verts)
    np.testing.assert_array_equal(mesh.faces, surface.faces)
    rotated = Rotation.from_euler("z", 90, degrees=True).apply(surface.coordinates)
    np.testing.assert_allclose(rotated[:, 1], surface.verts[:, 0], atol=1e-12)
    surface.coordinates[:] = 0
    assert np.array_equal(surface.verts, VERTS)


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


@pytest.mark.parametrize(("name", "to"), [("white", "to_trimesh"), ("pial", "to_pyvista")])
def test_copies_for_other_libraries_hold_the_same_numbers_in_the_same_order(rough_cortex, name, to):
    surface, copy = getattr(rough_cortex, name), getattr(rough_cortex, to)(name)
    fields = "vertices faces vertex_attributes" if to == "to_trimesh" else "points regular_faces point_data"
    verts, faces, maps = (getattr(copy, field) for field in fields.split())
    assert np.array_equal(verts, surface.verts)
    assert verts.dtype == np.float64
    assert np.array_equal(faces, surface.faces)
    assert {key: maps[key].tobytes() for key in maps} == {k: v.tobytes() for k, v in rough_cortex.maps.items()}
    assert np.array_equal(Surface(np.array(verts), np.array(faces)).verts, surface.verts)
    assert copy.volume == pytest.approx(cortex_checks.volume(surface), rel=1e-12)
    assert copy.area == pytest.approx(face_areas(surface.verts, surface.faces).sum(), rel=1e-12)


@pytest.mark.parametrize(("hemi", "part"), [("lh", "left"), ("rh", "right")])
def test_a_map_becomes_an_image_of_nilearn(rough_cortex, hemi, part):
    pytest.importorskip("nilearn")
    cortex = dataclasses.replace(rough_cortex, hemi=hemi)
    image = cortex.to_nilearn(cortex.maps["x"], "white")
    assert [*image.mesh.parts] == [part]
    assert np.array_equal(image.mesh.parts[part].coordinates, cortex.white.verts)
    assert np.array_equal(image.mesh.parts[part].faces, cortex.faces)
    assert np.array_equal(np.ravel(image.data.parts[part]), cortex.maps["x"])
    with pytest.raises(WrongShape):
        cortex.to_nilearn(np.zeros(5))


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
