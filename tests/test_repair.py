"""Faults put into a cortex whose measures are known are mended, counted and placed, and change no number."""

from dataclasses import replace

import numpy as np
import pytest
import pyvista
from hard_cases.made_surfaces import changed, clean, with_island
from scipy.spatial import cKDTree

from morphofold import geometry
from morphofold.analysis import measure
from morphofold.errors import BadMesh, InsideOut
from morphofold.io import read_cortex, sample_path
from morphofold.mesh_quality import cortex_checks
from morphofold.mesh_quality.repair import measurable, mended
from morphofold.shapes import icosphere
from morphofold.surface import Cortex, Regions, Surface


def flipped(cortex, count=1):
    faces = cortex.faces.copy()
    faces[10 * np.arange(count)] = faces[10 * np.arange(count)][:, ::-1]
    return changed(cortex, faces=faces)


def torn(cortex):
    """One corner of a triangle is a vertex of its own."""
    faces = cortex.faces.copy()
    faces[700, 0] = cortex.n_vertices
    return changed(cortex, lambda verts: np.concatenate([verts, verts[cortex.faces[700, :1]]]), faces)


def soup(cortex):
    return changed(cortex, lambda verts: verts[cortex.faces.ravel()], np.arange(cortex.faces.size).reshape(-1, 3))


def with_faces(cortex, *more):
    return changed(cortex, faces=np.concatenate([cortex.faces, *(np.atleast_2d(face) for face in more)]))


def fin(cortex):
    """A triangle that stands on an edge, with a vertex of its own."""
    i, j = cortex.faces[700, :2]
    faces = np.concatenate([cortex.faces, [[i, j, cortex.n_vertices]]])
    return changed(cortex, lambda verts: np.concatenate([verts, 1.05 * (verts[i] + verts[j])[None] / 2]), faces)


def welded(cortex, pairs):
    faces = cortex.faces.copy()
    for stays, gone in pairs:
        faces[faces == gone] = stays
    return changed(cortex, faces=faces)


def path(cortex, start, length):
    """Vertices along edges, each as far from the first as can be."""
    near, line = geometry.adjacency(cortex.n_vertices, cortex.faces), [start]
    while len(line) < length:
        ring = near.indices[near.indptr[line[-1]] : near.indptr[line[-1] + 1]]
        away = np.linalg.norm(cortex.pial.verts[ring] - cortex.pial.verts[start], axis=1)
        line.append(int(ring[away.argmax()]))
    return line


def neighbours_apart(cortex, vertex):
    """Two neighbours of a vertex on opposite sides of it."""
    near = geometry.adjacency(cortex.n_vertices, cortex.faces)
    ring = near.indices[near.indptr[vertex] : near.indptr[vertex + 1]]
    return next((a, b) for a in ring for b in ring if a < b and not near[a, b])


def crowded(cortex):
    return int((geometry.edges_and_counts(cortex.faces)[1] > 2).sum())


FAULTS = {
    "a triangle flipped": (flipped, {"flipped_triangles": 1}),
    "all flipped": (lambda c: changed(c, faces=c.faces[:, ::-1]), {"flipped_triangles": 5120}),
    "a vertex twice": (torn, {"seam_vertices": 1}),
    "all triangles apart": (soup, {"seam_vertices": 15360 - 2562}),
    "a triangle twice": (lambda c: with_faces(c, c.faces[700]), {"double_triangles": 1}),
    "and turned": (lambda c: with_faces(c, c.faces[700, ::-1]), {"double_triangles": 1}),
    "a fin": (fin, {"pinched_edges": 1, "debris_triangles": 1}),
    "a fin of two sides": (lambda c: with_faces(fin(c), fin(c).faces[-1, ::-1]), {"double_triangles": 2}),
    "a vertex named twice": (lambda c: with_faces(c, [3, 4, 3]), {"flat_triangles": 1}),
}


def triangles(cortex):
    """With the lowest corner first, in order: the same for the same surface."""
    first = cortex.faces.argmin(axis=1)[:, None]
    return np.array(sorted(np.take_along_axis(cortex.faces, (first + np.arange(3)) % 3, axis=1).tolist()))


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_is_mended_to_the_surface_that_it_was_put_into(name):
    (put, done), cortex = FAULTS[name], clean()[0]
    faulty = put(cortex)
    with pytest.raises({"all flipped": InsideOut, "a vertex named twice": ValueError}.get(name, BadMesh)):
        measurable(faulty, repair=False)
    mend = measurable(faulty)
    assert mend.numbers == {f"repaired_{key}": value for key, value in done.items()}
    away, same = cKDTree(cortex.pial.verts).query(mend.cortex.pial.verts)
    assert not away.any()
    present = mend.target >= 0
    assert np.array_equal(same[mend.target[present]], cKDTree(cortex.pial.verts).query(faulty.pial.verts)[1][present])
    assert np.array_equal(triangles(changed(cortex, faces=same[mend.cortex.faces])), triangles(cortex))


def test_faults_that_are_mended_change_no_number_and_maps_fit_the_input():
    """A triangle flipped, a vertex twice and a fin; what came with the vertices goes with them."""
    cortex, without = clean()
    faulty = fin(torn(flipped(cortex)))
    n = faulty.n_vertices
    label = np.arange(n) % 2562 > 9
    regions = Regions(np.zeros(n, np.int64), ("a",), np.zeros((1, 3), np.uint8))
    faulty = replace(faulty, regions=regions, maps={"thickness": np.arange(n) + 1.0})
    measures = measure(faulty)
    x, y, z = cortex.white.verts[cortex.faces[700, 0]]
    assert f"({x:.6g}, {y:.6g}, {z:.6g})" in measures.notes["repair"]
    for key, value in without.scalars.items():
        if not key.startswith("gyral_to_cortical"):  # a line through regions, of which it had none
            assert measures.scalars[key] == (None if value is None else pytest.approx(value, rel=1e-9)), key
    numbers = {key: value for key, value in measures.parameters.items() if key.startswith("repaired_")}
    repaired = "seam_vertices", "pinched_edges", "debris_triangles", "flipped_triangles"
    assert numbers == {f"repaired_{name}": 1 for name in repaired}
    twin = cortex.faces[700, 0]
    for key, values in measures.maps.items():
        assert values.shape == (n,)
        if key in without.maps:
            np.testing.assert_allclose(values[:-2], without.maps[key], rtol=1e-9, atol=1e-12)
        np.testing.assert_array_equal(values[-2], 0 if key == "area" else values[twin])
        assert np.isnan(values[-1])  # the tip of the fin
    assert measures.cortex.regions is regions
    assert mended(replace(faulty, cortex=label)).cortex.cortex.tolist() == label[:-2].tolist()
    assert measures.maps["thickness_file"][5] == 6.0


def test_a_clean_cortex_is_the_same_object_and_nothing_is_told():
    cortex, measures = clean()
    assert mended(cortex).cortex is cortex
    assert "repair" not in measures.notes
    assert not [key for key in measures.parameters if key.startswith("repaired")]


@pytest.mark.parametrize("sample", ["fsaverage5", "simulated"])
def test_a_real_and_a_simulated_cortex_are_left_alone(sample):
    """Also if triangles begin at another corner on pial."""
    cortex = read_cortex(sample_path(sample))
    assert mended(cortex).cortex is cortex
    assert mended(replace(cortex, pial=replace(cortex.pial, faces=np.roll(cortex.faces, 1, axis=1)))).numbers == {}


@pytest.mark.parametrize("length", [2, 5])
def test_sheets_welded_along_edges_are_parted(length):
    """Two paths of vertices far apart become one; the middle of a longer one is parted after its ends."""
    cortex = clean()[0]
    pairs = list(zip(path(cortex, 100, length), path(cortex, 1500, length)))
    faulty = welded(cortex, pairs)
    assert crowded(faulty) == length - 1
    mend = measurable(faulty)
    assert mend.numbers == {"repaired_pinched_edges": length - 1}
    assert crowded(mend.cortex) == 0
    assert geometry.euler_characteristic(mend.cortex.faces) == 2
    assert geometry.is_closed(mend.cortex.faces)
    assert mend.cortex.n_vertices == cortex.n_vertices
    assert sorted(mend.source.tolist()).count(pairs[0][0]) == 2


@pytest.mark.parametrize(
    "pairs",
    [lambda c: [neighbours_apart(c, 100)], lambda c: [(100, 1500)]],
    ids=["neighbours of one vertex", "at a vertex alone"],
)
def test_a_sphere_that_touches_itself_is_a_sphere_again(pairs):
    """Connected as it was: corners have the same vertex where they had the same one."""
    cortex = clean()[0]
    mend = measurable(welded(cortex, pairs(cortex)))
    pairs_of_vertices = np.unique(np.column_stack([cortex.faces.ravel(), mend.cortex.faces.ravel()]), axis=0)
    assert [len(np.unique(column)) for column in pairs_of_vertices.T] == [len(pairs_of_vertices)] * 2
    assert sum(mend.numbers.values()) == 1
    assert (geometry.euler_characteristic(mend.cortex.faces), geometry.is_closed(mend.cortex.faces)) == (2, True)


def test_a_pinch_is_told_and_what_is_measured_has_the_input_s_vertices():
    i, j = neighbours_apart(clean()[0], 100)
    faulty = welded(clean()[0], [(i, j)])
    measures = measure(faulty, only=["euler_characteristic", "H", "hinges"])
    assert measures.scalars["euler_characteristic"] == 2
    assert measures.parameters["repaired_pinched_edges"] == 1
    assert all(len(values) == faulty.n_vertices for values in measures.maps.values())
    assert np.isnan(measures.maps["H"][j])  # no triangle has it
    assert np.isfinite(measures.maps["H"][i])
    assert max(node["vertex"] for _, node in measures.graph.nodes(data=True)) < faulty.n_vertices


@pytest.mark.parametrize("hollow", [False, True])
def test_a_second_piece_is_no_debris(hollow):
    """An island with 1 % of the area stays, and so does the smallest cavity; a flipped triangle in it turns."""
    cortex = clean()[0]
    two = with_island(cortex, (0.0, 0.0, 0.0), white=2.0 if hollow else 4.0, pial=1.0 if hollow else 5.0, hollow=hollow)
    faces = two.faces.copy()
    faces[-1] = faces[-1, ::-1]
    mend = measurable(changed(two, faces=faces))
    assert mend.numbers == {"repaired_flipped_triangles": 1}
    assert np.array_equal(mend.cortex.faces[:-1], two.faces[:-1])
    assert len(cortex_checks.cavities(mend.cortex)) == hollow


@pytest.mark.parametrize(("radius", "pieces"), [(1.0, 1), (20.0, 2)])
def test_of_spheres_that_touch_only_a_tiny_one_is_debris(radius, pieces):
    faces, centre = icosphere(1)[1], (50.0 + radius) / 50.0 * clean()[0].pial.verts[100]
    two = with_island(clean()[0], centre, white=0.9 * radius, pial=radius)
    mend = measurable(welded(two, [(100, clean()[0].n_vertices)]))
    assert geometry.components(mend.cortex.n_vertices, mend.cortex.faces)[0] == pieces
    assert mend.numbers.get("repaired_debris_triangles", 0) == (len(faces) if pieces == 1 else 0)


@pytest.mark.parametrize(("reverse", "open_"), [(False, True), (True, False)])
def test_a_speck_beside_the_cortex_is_left_out_and_changes_no_number(reverse, open_):
    cortex = clean()[0]
    two = with_island(cortex, (70.0, 0.0, 0.0), white=1.5, pial=2.0)
    n = len(cortex.faces)
    speck = two.faces[n + 5 * open_ :]
    speck = speck[:, ::-1] if reverse else speck
    mend = measurable(changed(two, faces=np.concatenate([cortex.faces, speck])))
    assert mend.numbers == {"repaired_debris_triangles": len(speck)}
    assert mend.cortex.n_vertices == cortex.n_vertices
    assert np.array_equal(mend.cortex.pial.verts, cortex.pial.verts)
    assert (mend.target[cortex.n_vertices :] == -1).all()


def test_a_surface_with_one_side_is_refused_with_the_reason():
    """Two triangles cut out, and the holes sewn together with the wrong sense."""
    cortex = clean()[0]
    a, b = cortex.faces[[100, 3000]]
    faulty = welded(changed(cortex, faces=np.delete(cortex.faces, [100, 3000], axis=0)), zip(a, b))
    assert mended(faulty).cortex is faulty
    with pytest.raises(BadMesh, match="one side only"):
        measure(faulty)


def test_a_sheet_too_large_for_debris_is_refused_with_the_reason():
    cortex = clean()[0]
    i, j = cortex.faces[700, :2]
    faces = np.concatenate([cortex.faces, [[i, j, cortex.n_vertices]]])
    far = changed(cortex, lambda verts: np.concatenate([verts, [[300.0, 300.0, 300.0]]]), faces)
    with pytest.raises(BadMesh, match="cannot be told"):
        measure(far)


def test_what_vtk_leaves_of_a_real_surface_is_a_sphere():
    """decimate_pro keeps places, so white is that of the same vertices."""
    cortex = read_cortex(sample_path("fsaverage5"))
    fewer = pyvista.PolyData.from_regular_faces(cortex.pial.verts, cortex.faces).decimate_pro(0.85)
    vertex, faces = cKDTree(cortex.pial.verts).query(fewer.points)[1], fewer.faces.reshape(-1, 4)[:, 1:]
    thin = Cortex(*(Surface(s.verts[vertex], faces, s.name) for s in (cortex.white, cortex.pial)))
    assert crowded(thin) > 0
    mend = measurable(thin)
    assert (geometry.euler_characteristic(mend.cortex.faces), geometry.is_closed(mend.cortex.faces)) == (2, True)


@pytest.mark.parametrize("rows", [[7], slice(None)], ids=["one", "all"])
def test_triangles_that_run_the_other_way_on_pial_alone_change_no_number(rows):
    cortex = clean()[0]
    faces = cortex.faces.copy()
    faces[rows] = faces[rows][:, ::-1]
    unlike = replace(cortex, pial=replace(cortex.pial, faces=np.roll(faces, 1, axis=1)))
    mend = mended(unlike)
    assert mend.numbers == {"repaired_unlike_triangles": len(cortex.faces[rows])}
    np.testing.assert_array_equal(mend.cortex.white.faces, cortex.faces)
    np.testing.assert_array_equal(mend.cortex.pial.faces, cortex.faces)
    with pytest.raises(BadMesh, match=rf"\b{len(cortex.faces[rows])} of {len(cortex.faces)}"):
        measurable(unlike, repair=False)


def test_a_closed_piece_that_is_inside_out_is_turned_beside_an_open_one():
    verts, ball = icosphere(3)
    open_piece = ball[verts[ball].mean(axis=1)[:, 2] < 0.5]
    faces = np.concatenate([open_piece, ball[:, ::-1] + len(verts)])
    both = np.concatenate([verts, verts + [4.0, 0, 0]])
    center = np.repeat([[0.0, 0, 0], [4.0, 0, 0]], len(verts), axis=0)
    mend = mended(Cortex(Surface(40 * both, faces), Surface(42 * both - 2 * center, faces)))
    assert mend.numbers == {"repaired_flipped_triangles": len(ball)}
    np.testing.assert_array_equal(mend.source[mend.cortex.faces[: len(open_piece)]], open_piece)
    closed = mend.cortex.faces[len(open_piece) :]
    assert cortex_checks.signed_volumes(mend.cortex.white.verts, closed, np.zeros(len(ball), dtype=np.int64))[0] > 0


def test_areas_of_what_was_joined_or_parted_sum_up_and_the_inflated_surface_is_mended():
    i, j = neighbours_apart(clean()[0], 100)
    for faulty in (torn(clean()[0]), welded(clean()[0], [(i, j)])):
        measures = measure(replace(faulty, inflated=faulty.white), only=["area", "area_white_mm2"])
        assert np.nansum(measures.maps["area"]) == pytest.approx(measures.scalars["area_white_mm2"], rel=1e-12)
        own = geometry.vertex_areas(measures.cortex.white.verts, measures.cortex.faces)
        np.testing.assert_allclose(np.nan_to_num(measures.maps["area"]), own, atol=1e-12)
        np.testing.assert_array_equal(measures.cortex.inflated.faces, measures.cortex.faces)
