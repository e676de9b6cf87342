"""White and pial in each other's way: crossing, coinciding, walls in contact and through each other; flat and round."""

import re
from dataclasses import replace

import numpy as np
import pytest
from hard_cases.made_surfaces import CORTEX, FACES, NET, PIAL, analyze, case, change, clean, hold_all, pair, refusal
from made_folds import bulged, pressed_sphere
from scipy.spatial import cKDTree

from morphofold import analysis, geometry
from morphofold.analysis import curvatures, measure, measuring
from morphofold.analysis.graph.depth_potential import SurfaceOperators
from morphofold.analysis.thickness import cortical_thickness as thicknesses, gyral_thickness as widths
from morphofold.intersections.intersection import self_intersections
from morphofold.io import read_cortex, sample_path
from morphofold.mesh_quality import cortex_checks as checks, defects
from morphofold.shapes.spherical_nets import irregular_net
from morphofold.sim.stage_checks import enclosed_volume
from morphofold.studies import known_shapes as shapes
from morphofold.studies.ridged_nets import ridged_net
from morphofold.surface import Regions, Surface


def no_remarks(cortex, mask, given=None):
    return {}


SILENT = (defects, "remarks", no_remarks)


def everywhere(patch):
    for module in (checks, widths):
        patch.setattr(module, "cortex_mask", lambda cortex: np.ones(cortex.n_vertices, dtype=bool))


@case("white crossing pial", "the note on crossings", SILENT, peers="FreeSurfer caps thickness at 5 mm (said)")
def test_white_outside_pial_is_told_with_its_place(holds, tmp_path, capsys):
    """White pushed 2 mm out through pial around vertex 0, where there is no crest."""
    order = np.argsort(np.linalg.norm(PIAL - PIAL[0], axis=1))
    white, near, far = CORTEX.white.verts.copy(), order[:8], order[60:]
    white[near] = PIAL[near] + 2.0 * geometry.vertex_normals(PIAL, FACES)[near]
    result = measure(pair(white, PIAL, FACES))
    holds.says("note", result.notes.get("crossing", ""), " 8 of 2562 ", f" {min(near)}, at (")
    off = result.maps["cortical_thickness"] - clean()[1].maps["cortical_thickness"]
    holds("thickness farther off", np.abs(off[far]).max(), at_most=1e-9, unit="mm")
    of_white = ("area_white_mm2", "folding_index", "intrinsic_curvature_index", "mean_cortical_thickness_mm")
    hold_all(holds, result, without=of_white)
    analyze(holds, tmp_path, capsys, result.cortex, " 8 of 2562 ", "[crossing]")


@case("a pial surface shifted by 4 mm against white", "the note on the pair", SILENT)
def test_white_and_pial_that_do_not_belong_together_are_told(holds, tmp_path, capsys):
    shifted = pair(CORTEX.white.verts, PIAL + [4.0, 0.0, 0.0], FACES)
    printed = analyze(holds, tmp_path, capsys, shifted)
    note = measure(shifted).notes.get("pair", "")
    percent = re.search(r"([\d.]+)%", note)
    holds("cortex on the wrong side", float(percent[1]) if percent else np.nan, at_least=5, unit="%")
    holds.equal("analyze tells of it", note in printed, True)


@case("white and pial 1e-6 of their radius apart", "the check of the pair", (checks, "SAME_SURFACE_IN_RADII", 0.0))
def test_one_surface_given_twice_but_for_rounding_is_refused(holds, tmp_path, capsys):
    twice = pair((1 - 1e-6) * PIAL, PIAL, FACES)
    distance = 1e-6 * np.median(np.linalg.norm(PIAL, axis=1))
    holds.says("measure", refusal(twice), "lh.white", "lh.pial", f" {distance:.2g} mm ")
    analyze(holds, tmp_path, capsys, twice, status=2)


@case("a cortex label of ten vertices", "a label that small is none", (checks, "LEAST_LABELLED_SHARE", 0.0))
def test_a_cortex_label_of_ten_vertices_is_refused(holds):
    holds.says("measure", refusal(replace(CORTEX, cortex=np.arange(2562) < 10)), " 10 of 2562 ")


def with_cap(holds, height, noise):
    """White is pial above this height, with noise on both; the measures, where thickness is unknown, and the cap."""
    cap, rng = PIAL[:, 2] > height, np.random.default_rng(1)
    white = np.where(cap[:, None], PIAL, CORTEX.white.verts)
    noisy = (verts + rng.normal(0, noise, verts.shape) for verts in (white, PIAL))
    result = measure(pair(*noisy, FACES))
    true = np.mean(clean()[1].maps["cortical_thickness"][~cap])
    holds("mean thickness", change(result.scalars["mean_cortical_thickness_mm"], true), at_most=0.02)
    return result, np.isnan(result.maps["cortical_thickness"]), cap


@case("zero thickness: white and pial coincide on a patch", "that is no cortex", everywhere)
def test_where_white_is_pial_there_is_no_cortex(holds, tmp_path, capsys):
    result, unknown, cap = with_cap(holds, 35, 0.0)
    holds.equal("vertices without thickness", np.flatnonzero(unknown).tolist(), np.flatnonzero(cap).tolist())
    mean = result.scalars["mean_cortical_thickness_mm"]
    analyze(holds, tmp_path, capsys, result.cortex, f"cortical thickness {mean:.2f} mm")


@case(
    "a medial wall that nothing marks, with noise of 0.1 mm on every coordinate",
    "a large patch where white and pial nearly meet is none",
    (checks, "wall_of_geometry", lambda cortex: np.zeros(2562, dtype=bool)),
    peers="FreeSurfer takes its cortex label (said)",
)
def test_a_noisy_medial_wall_is_no_cortex(holds, tmp_path, capsys):
    result, wall, cap = with_cap(holds, 43, 0.1)
    holds("vertices of the wall found", np.mean(wall[cap]), at_least=0.75)
    holds.equal("vertices of cortex taken for it", np.count_nonzero(wall & ~cap), 0)
    analyze(holds, tmp_path, capsys, result.cortex, f"{np.count_nonzero(wall)} of 2,562 ")


@case("white and pial coincide everywhere", "the check of the mask", everywhere)
def test_one_surface_given_twice_is_refused(holds, tmp_path, capsys):
    twice = pair(CORTEX.white.verts, CORTEX.white.verts, FACES)
    holds.says("measure", refusal(twice), "lh.white", "lh.pial", " 2562 ")
    analyze(holds, tmp_path, capsys, twice, " 2562 ", status=2)


@case(
    "NaN and zero in the thickness that came with the surfaces",
    "no number, no thickness",
    (defects, "given_thickness", lambda cortex, mask: (cortex.maps["thickness"], {})),
)
def test_a_thickness_file_with_gaps_changes_its_own_means_only_and_is_told(holds):
    north = PIAL[:, 2] > 0
    thickness, gaps = np.where(north, 2.5, 3.5), np.flatnonzero(north)[:100]
    thickness[gaps[:60]], thickness[gaps[60:]] = np.nan, 0.0
    parts = Regions(north.astype(np.int64), ("south", "north"), np.array([[9, 9, 9], [8, 8, 8]], dtype=np.uint8))
    result = measure(replace(CORTEX, maps={"thickness": thickness}, regions=parts))
    hold_all(holds, result, bent=1e-9, lines=1e-9, width=1e-9)
    means = {row["region"]: row["thickness_file_mm"] for row in result.regions}
    for name, true in (("north", 2.5), ("south", 3.5)):
        holds(f"thickness of the file, {name}", abs(means[name] - true), at_most=1e-12, unit="mm")
    holds.equal("unknown in the map", np.flatnonzero(np.isnan(result.maps["thickness_file"])).tolist(), gaps.tolist())
    note = result.notes.get("thickness_file", "")
    holds.says("note", note, " 100 of 2562 ", "(3.9%), 40 ", f" {gaps[0]}, at (")


def spiked():
    """Pial with vertex 0 drawn through the body and 1 mm out of the face on its other side; and that face."""
    verts = PIAL.copy()
    middles = verts[FACES].mean(axis=1)
    f = int((middles @ verts[0] / np.linalg.norm(middles, axis=1)).argmin())
    verts[0] = middles[f] + geometry.face_normals(verts, FACES)[f]
    return pair(CORTEX.white.verts, verts, FACES), f


@case(
    "self-intersections: a spike through a pial surface",
    "edges are held against all faces",
    (defects, "self_crossings", lambda cortex, mask: ({}, 0.0)),
)
def test_self_intersections_are_told_with_their_count_and_place(holds, tmp_path, capsys):
    """The faces around the tip go through one other face, and cross no more."""
    cortex, f = spiked()
    count = int((cortex.faces == 0).sum()) + 1
    phrases = (f": {count} of 5120 ", " 1 mm", "[self_crossing]")
    printed = analyze(holds, tmp_path, capsys, cortex, "lh.pial ", *phrases)
    point = np.array(re.search(r" of 5120 .*?\((.*?)\)", printed)[1].split(","), dtype=float)
    off = np.linalg.norm(point - PIAL[cortex.faces[f]].mean(axis=0))
    holds("place it names, off the face's middle", off, at_most=1.0, unit="mm")  # the spike is less than 45° aslant
    holds.equal("white is said to cross itself", re.search("^warning: .*lh.white", printed, re.M) is not None, False)


def crossings_off_the_cortex(cortex, mask, self_crossings=defects.self_crossings):
    return self_crossings(cortex, np.ones_like(mask))


@case(
    "self-intersections off the cortex",
    "those with a vertex in the cortex are told",
    (defects, "self_crossings", crossings_off_the_cortex),
)
def test_self_intersections_off_the_cortex_are_not_told(holds):
    """The label lacks the spike, and then the face that it goes through, too."""
    cortex, f = spiked()
    label = np.ones(cortex.n_vertices, dtype=bool)
    note = lambda: measure(replace(cortex, cortex=label.copy())).notes.get("self_crossing")
    label[np.unique(cortex.faces[(cortex.faces == 0).any(axis=1)])] = False
    holds.says("note on the face", note() or "", "lh.pial ", f": 1 of {label[cortex.faces].any(axis=1).sum()} ")
    label[cortex.faces[f]] = False
    holds.equal("note", note(), None)


@case(
    "white through itself: an offset along the normals of a noisy surface",
    "the net is taken half way to pial",
    (measuring, "LARGEST_CROSSED_SHARE", 1.0),
)
def test_hinges_of_a_cortex_whose_white_crosses_itself_are_those_of_its_ridges(holds):
    """Ridges 6 mm wide, white 2.5 mm within: crowns are gone from it, and on it alone 33 hinges of 48 are found."""
    net = irregular_net(26, seed=5, shortest=0.1)
    pial = ridged_net(net, 5, 6.0, noise=0.05, rng=3)
    ridged = pair(pial.verts - 2.5 * geometry.vertex_normals(pial.verts, pial.faces, "max"), pial.verts, pial.faces)
    result = measure(ridged)
    crossed = self_intersections(ridged.white, vertices=False).crossed_faces(ridged.faces)
    holds("share of white's triangles that others cross", len(crossed) / len(ridged.faces), at_least=0.02)
    holds.equal("hinges", result.scalars["n_hinges"], len(net.nodes))
    holds.says("note", result.notes["n_hinges"], "lh.white", "lh.pial")
    holds.equal("remark on the width", result.notes.get("gyral_width"), None)


#: instead, the nearest vertex, whatever wall it is of
OWN_WALL = {
    "guard": "only the surface around the own partner, facing the same way, is searched",
    "without": (thicknesses, "_distance_to_nearest_triangle", lambda start, end, *_: cKDTree(end).query(start)[0]),
}


@case(
    "self-intersection: walls of a sulcus that pass through each other",
    peers="unrestricted closest points jump across sulci: bias -0.06 mm, r 0.975 (measured)",
    **OWN_WALL,
)
def test_thickness_of_walls_that_cross_is_that_of_each_wall(holds, tmp_path, capsys):
    """Each passes up to 0.8 beyond the other, whose white is 0.5 behind it: at 0.25 the two are in one place."""
    pial = pressed_sphere(5, press=1.5)
    cortex = pair(pial.verts - 0.5 * geometry.vertex_normals(pial.verts, pial.faces), pial.verts, pial.faces)
    passed = self_intersections(pial).vertex
    holds("vertices that have passed the other wall", len(passed), at_least=10)
    thickness = analysis.cortical_thickness(cortex.white, cortex.pial, cap=None)
    holds("mean thickness, of 0.5", change(thickness.mean(), 0.5), at_most=0.02)
    holds("least thickness of the vertices that have passed", thickness[passed].min() / 0.5, at_least=0.9)
    analyze(holds, tmp_path, capsys, cortex, "lh.white ", "; lh.pial ", "[self_crossing]")


@pytest.mark.parametrize("by", [3.8, 4.1], ids=["0.1 mm", "0.7 mm"])
@case(
    "gyral thickness where the walls of a sulcus pass through each other",
    "a point in two gyri leaves the other one first",
    (widths.RayCaster, "bodies", lambda self, points, *_: np.zeros(len(points), dtype=np.int64)),
)
def test_the_gap_between_walls_that_cross_is_no_gyrus(holds, by):
    """Corrugated sheet; the gyri at its ends, whose other half lacks a wall, are left out."""
    sheet, width = bulged(by)
    result = analysis.gyral_thickness(sheet, scale=10.0)
    inner = np.abs(result.points[:, 0] - 60) < 45
    measured = inner & np.isfinite(result.width)
    holds("median, of what it is", change(result.median, width), at_most=0.02)
    holds("least width, of what it is", result.width[measured].min() / width, at_least=0.9)
    holds("contour measured, without the ends", measured.sum() / inner.sum(), at_least=0.8)


def fitted_in_space(verts, faces, scale, own=curvatures.curvature):
    """A quadric through all that lies within the scale, whatever wall it is of."""
    normals, used, H = geometry.vertex_normals(verts, faces), np.unique(faces), np.full(len(verts), np.nan)
    for i, around in zip(used, cKDTree(verts[used]).query_ball_point(verts[used], scale)):
        across = np.linalg.svd(normals[i][None])[2][1:]
        u, v, h = np.vstack([across, normals[i]]) @ (verts[used[around]] - verts[i]).T
        a = np.linalg.lstsq(np.stack([1 + 0 * u, u, v, u * u, u * v, v * v], axis=1), h, rcond=None)[0]
        H[i] = -(a[3] + a[5])
    return replace(own(verts, faces, scale), k1=H, k2=H)


@pytest.mark.parametrize("press", [1.0, 1.5], ids=["touching", "crossing"])
@case(
    "curvature of walls that touch, or pass through each other",
    "a fit along the surface",
    (curvatures, "curvature", fitted_in_space),
)
def test_the_other_wall_of_a_sulcus_does_not_change_curvature(holds, press):
    """The sphere is cut along the plane that the walls meet in, which on the surface is the bottom of the sulcus."""
    pial = pressed_sphere(5, press=press)
    before = pressed_sphere(5, press=0.0).verts[:, 0]  # 3 mm and more along the surface from the cut
    pressed = (before > 1.5) & (before < 2.4) & (np.abs(pial.verts[:, 0]) < 0.5) & (np.abs(pial.verts[:, 1]) < 2)
    holds("vertices in contact", pressed.sum(), at_least=5)
    alone = pial.faces[(before[pial.faces] >= 0).all(axis=1)]
    both, single = (curvatures.curvature(pial.verts, faces, 1.2).H[pressed] for faces in (pial.faces, alone))
    holds("change of H", np.abs(both - single).max(), at_most=1e-9, unit="/mm")


@case("a simulated surface with sulcal walls in contact", **OWN_WALL)
def test_thickness_of_a_simulated_cortex_fills_its_volume(holds):
    """Between surfaces a distance t apart the volume is t (A + 4 A' + A'') / 6, of white, midway and pial: areas are
    quadratic in the distance (Steiner), so that Simpson's rule is exact. Between planes that meet at an angle a, at the
    distance r from their edge: both closest distances are r sin(a), areas 1, cos(a / 2) and 1, the volume r a."""
    cortex = read_cortex(sample_path("simulated"))
    white, pial, faces = cortex.white.verts, cortex.pial.verts, cortex.faces
    inward, outward = (geometry.vertex_normals(verts, faces) for verts in (white, pial))
    i, j = cKDTree(pial).query_pairs(0.2 * geometry.mean_edge_length(pial, faces), output_type="ndarray").T
    facing = np.sum(outward[i] * outward[j], axis=1) < -0.5  # contact acts from 0.2 edges on
    holds("vertices of pial in contact with one of another wall", len(np.union1d(i[facing], j[facing])), at_least=100)
    thickness = analysis.cortical_thickness(cortex.white, cortex.pial, cap=None)
    linked = np.linalg.norm(pial - white, axis=1)
    holds("thickness less the way to the own partner", (thickness - linked).max(), at_most=1e-12, unit="mm")
    inner, middle, outer = (geometry.vertex_areas(verts, faces) for verts in (white, (white + pial) / 2, pial))
    filled = thickness * (inner + 4 * middle + outer) / 6
    volume = enclosed_volume(cortex.pial) - enclosed_volume(cortex.white)
    angle = np.arccos(np.clip(np.sum(inward * outward, axis=1), -1, 1 - 1e-12))
    wedge = np.sin(angle) * (1 + 2 * np.cos(angle / 2)) / (3 * angle)
    holds("volume filled", filled.sum() / volume, at_least=np.average(wedge, weights=filled), at_most=1.0)


def smoothed_curvature(self, _, scale):
    """It has no ridge on a flat crown but two."""
    return (self.smooth(geometry.ratio(self._H_sums, self._mass), scale),) * 2


@case(
    "gyri with flat crowns",
    "a net of the depth potential, not of curvature",
    (SurfaceOperators, "depth_and_curvature", smoothed_curvature),
)
def test_the_net_of_gyri_with_flat_crowns_is_that_of_their_middles(holds):
    """Cut off at 3 of 8 mm above the floor, 20 mm wide there."""
    flat = PIAL * np.minimum(1, 53 / np.linalg.norm(PIAL, axis=1, keepdims=True))
    graph = analysis.gyral_graph(Surface(flat, FACES))
    holds.equal("hinges", [degree for _, degree in graph.nodes(data="degree")], len(NET.nodes) * [3])
    holds.equal("crests", graph.number_of_edges(), len(NET.arcs))
    length = sum(length for *_, length in graph.edges(data="length"))
    holds("length of crests", change(length, 53 * NET.lengths.sum()), at_most=0.03)
    off = cKDTree(53 * NET.nodes).query([position for _, position in graph.nodes(data="position")])[0]
    holds("hinges off their place, median", np.median(off), at_most=4.0, unit="mm")  # an edge


def any_extremum(patch):
    for name in ("LEAST_CURVATURE_DIFFERENCE", "LEAST_SHARPNESS", "LEAST_CURVATURE_DROP"):
        patch.setattr(analysis.crests, name, -np.inf)


UMBILIC = {"sphere": lambda: shapes.sphere(4, rng=1), "torus": lambda: shapes.torus(rng=1), "cylinder": shapes.cylinder}


@pytest.mark.parametrize("name", UMBILIC)
@case(
    "umbilics everywhere, and curvature that nowhere has an extremum",
    "crests fall away to both sides",
    any_extremum,
    peers="CGAL Ridges_3: 6041 segments on the sphere, 7328 on the torus (measured)",
)
def test_cyclides_have_no_crest_lines(holds, name):
    shape = UMBILIC[name]()
    holds.equal(f"lines on the {name}", len(analysis.crest_lines(shape.verts, shape.faces).lines), 0)


def shape_index(curvature):
    return 2 / np.pi * np.arctan2(curvature.k1 + curvature.k2, curvature.k1 - curvature.k2)


@case("a plane", "no shape without curvature", (curvatures.Curvature, "shape_index", property(shape_index)))
def test_a_plane_has_no_curvature_and_no_shape(holds):
    sheet, _ = shapes.corrugated_sheet(2.0, height=0.0, size=40.0, rng=1)
    plane = curvatures.curvature(sheet.verts, sheet.faces)
    holds("curvature", np.abs([plane.k1, plane.k2]).max(), at_most=1e-12, unit="/mm")
    holds.equal("vertices with a shape index", int(np.isfinite(plane.shape_index).sum()), 0)
    holds.equal("crest lines", len(analysis.crest_lines(sheet.verts, sheet.faces).lines), 0)
