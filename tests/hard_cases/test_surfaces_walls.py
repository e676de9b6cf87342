"""White and pial in each other's way: crossing, coinciding, walls in contact and through each other; flat and round."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from hard_cases.cases import hard_case
from hard_cases.made_surfaces import NET, analyzed, clean, hold_all, known_cortex, refusal, with_white_outside
from made_folds import bulged, pressed_sphere
from scipy.spatial import cKDTree

from morphofold.analysis import (
    cortical_thickness,
    crest_lines,
    crests,
    gyral_graph,
    gyral_thickness,
    measure,
    measuring,
    vertex_areas,
    vertex_normals,
)
from morphofold.analysis import curvatures as bending
from morphofold.analysis.graph.depth_potential import SurfaceOperators
from morphofold.analysis.thickness import cortical, gyral
from morphofold.geometry import face_normals, mean_edge_length
from morphofold.intersections.intersection import self_intersections
from morphofold.io import read_cortex, sample_path
from morphofold.mesh_quality import checks, defects
from morphofold.shapes.ridges import irregular_net, ridged_net
from morphofold.sim.health import enclosed_volume
from morphofold.studies import shapes
from morphofold.surface import Cortex, Regions, Surface


def silent(patch):
    patch.setattr(defects, "remarks", lambda cortex, mask, given=None: {})


@hard_case(
    "surfaces",
    "white crossing pial",
    guard="the note on crossings",
    without=silent,
    peers="FreeSurfer caps thickness at 5 mm (said)",
)
def test_white_outside_pial_is_told_with_its_place(holds, tmp_path, capsys):
    crossed, there = with_white_outside(clean()[0])
    found = measure(crossed)
    note = found.notes.get("crossing", "")
    first = min(there)
    holds.says("note", note, f" {len(there)} of 2562 ", f" {first}, at (")
    far = np.ones(crossed.n_vertices, dtype=bool)
    far[np.argsort(np.linalg.norm(crossed.pial.verts - crossed.pial.verts[0], axis=1))[:60]] = False
    off = found.maps["cortical_thickness"] - clean()[1].maps["cortical_thickness"]
    holds("thickness farther off", np.abs(off[far]).max(), at_most=1e-9, unit="mm")
    of_white = ("area_white_mm2", "folding_index", "intrinsic_curvature_index", "mean_cortical_thickness_mm")
    hold_all(holds, found, without=of_white)
    status, printed = analyzed(tmp_path, capsys, crossed)
    holds.equal("exit status", status, 0)
    holds.says("analyze", printed, f" {len(there)} of 2562 ", "[crossing]")
    holds.equal("note of the clean one", clean()[1].notes.get("crossing"), None)


@hard_case("surfaces", "a pial surface shifted by 4 mm against white", guard="the note on the pair", without=silent)
def test_white_and_pial_that_do_not_belong_together_are_told(holds, tmp_path, capsys):
    cortex = clean()[0]
    apart = replace(cortex, pial=Surface(cortex.pial.verts + [4.0, 0.0, 0.0], cortex.faces, "lh.pial"))
    status, printed = analyzed(tmp_path, capsys, apart)
    holds.equal("exit status", status, 0)
    note = measure(apart).notes.get("pair", "")
    share = float(found[1]) if (found := re.search(r"([\d.]+)%", note)) else np.nan
    holds("cortex on the wrong side", share, at_least=5, unit="%")
    holds.equal("analyze tells of it", note in printed, True)
    holds.equal("note of the clean one", clean()[1].notes.get("pair"), None)


@hard_case(
    "surfaces",
    "white and pial 1e-6 of their radius apart",
    guard="the check of the pair",
    without=lambda patch: patch.setattr(checks, "SAME_SURFACE_IN_RADII", 0.0),
)
def test_one_surface_given_twice_but_for_rounding_is_refused(holds, tmp_path, capsys):
    pial = clean()[0].pial
    twice = replace(clean()[0], white=Surface((1 - 1e-6) * pial.verts, pial.faces, "lh.white"))
    apart = np.median(np.linalg.norm(twice.pial.verts - twice.white.verts, axis=1))
    holds.says("measure", refusal(twice), "lh.white", "lh.pial", f" {apart:.2g} mm ")
    status, _ = analyzed(tmp_path, capsys, twice)
    holds.equal("exit status", status, 2)


@hard_case(
    "surfaces",
    "a cortex label of ten vertices",
    guard="a label that small is none",
    without=lambda patch: patch.setattr(checks, "LEAST_LABELLED_SHARE", 0.0),
    fails=(AssertionError, ValueError),
)
def test_a_cortex_label_of_ten_vertices_is_refused(holds):
    label = np.arange(2562) < 10
    holds.says("measure", refusal(replace(clean()[0], cortex=label)), " 10 of 2562 ")


def everywhere(patch):
    for where in (checks, gyral):
        patch.setattr(where, "cortex_mask", lambda cortex: np.ones(cortex.n_vertices, dtype=bool))


@hard_case(
    "surfaces", "zero thickness: white and pial coincide on a patch", guard="that is no cortex", without=everywhere
)
def test_where_white_is_pial_there_is_no_cortex(holds, tmp_path, capsys):
    cortex, whole = clean()
    cap = cortex.pial.verts @ np.array([0.0, 0.0, 1.0]) > 35
    white = np.where(cap[:, None], cortex.pial.verts, cortex.white.verts)
    found = measure(replace(cortex, white=Surface(white, cortex.faces, "lh.white")))
    unknown = np.flatnonzero(np.isnan(found.maps["cortical_thickness"])).tolist()
    holds.equal("vertices without thickness", unknown, np.flatnonzero(cap).tolist())
    mean = np.mean(whole.maps["cortical_thickness"][~cap])
    holds("mean thickness", abs(found.scalars["mean_cortical_thickness_mm"] / mean - 1), at_most=0.02)
    status, printed = analyzed(tmp_path, capsys, found.cortex)
    holds.equal("exit status", status, 0)
    holds.says("analyze", printed, f"cortical thickness {found.scalars['mean_cortical_thickness_mm']:.2f} mm")


@hard_case(
    "surfaces",
    "a medial wall that nothing marks, with noise of 0.1 mm on every coordinate",
    guard="a large patch where white and pial nearly meet is none",
    without=lambda patch: patch.setattr(checks, "wall_of_geometry", lambda cortex: np.zeros(2562, dtype=bool)),
    peers="FreeSurfer takes its cortex label (said)",
)
def test_a_noisy_medial_wall_is_no_cortex(holds, tmp_path, capsys):
    cortex, whole = clean()
    cap, noise = cortex.pial.verts[:, 2] > 43, np.random.default_rng(1)
    verts = (np.where(cap[:, None], cortex.pial.verts, cortex.white.verts), cortex.pial.verts)
    white, pial = (
        Surface(v + noise.normal(0, 0.1, v.shape), cortex.faces, s.name)
        for v, s in zip(verts, (cortex.white, cortex.pial))
    )
    found = measure(replace(cortex, white=white, pial=pial))
    wall = np.isnan(found.maps["cortical_thickness"])
    holds("vertices of the wall found", np.count_nonzero(wall & cap) / np.count_nonzero(cap), at_least=0.75)
    holds.equal("vertices of cortex taken for it", np.count_nonzero(wall & ~cap), 0)
    mean = np.mean(whole.maps["cortical_thickness"][~cap])
    holds("mean thickness", abs(found.scalars["mean_cortical_thickness_mm"] / mean - 1), at_most=0.02)
    status, printed = analyzed(tmp_path, capsys, found.cortex)
    holds.equal("exit status", status, 0)
    holds.says("analyze", printed, f"{np.count_nonzero(wall)} of 2,562 ")


@hard_case("surfaces", "white and pial coincide everywhere", guard="the check of the mask", without=everywhere)
def test_one_surface_given_twice_is_refused(holds, tmp_path, capsys):
    twice = replace(clean()[0], pial=Surface(clean()[0].white.verts, clean()[0].faces, "lh.pial"))
    holds.says("measure", refusal(twice), "lh.white", "lh.pial", " 2562 ")
    status, printed = analyzed(tmp_path, capsys, twice)
    holds.equal("exit status", status, 2)
    holds.says("analyze", printed, " 2562 ")


def as_it_stands(patch):
    """The file's numbers are taken at their word."""
    patch.setattr(defects, "given_thickness", lambda cortex, mask: (cortex.maps["thickness"], {}))


@pytest.mark.slow
@hard_case(
    "surfaces",
    "NaN and zero in the thickness that came with the surfaces",
    guard="no number, no thickness",
    without=as_it_stands,
)
def test_a_thickness_file_with_gaps_changes_its_own_means_only_and_is_told(holds, tmp_path, capsys):
    cortex, unknown = clean()[0], np.zeros(2562, dtype=bool)
    north = cortex.pial.verts[:, 2] > 0
    given = np.where(north, 2.5, 3.5)
    gaps = np.flatnonzero(north)[:100]
    given[gaps[:60]], given[gaps[60:]], unknown[gaps] = np.nan, 0.0, True
    parts = Regions(north.astype(np.int64), ("south", "north"), np.array([[9, 9, 9], [8, 8, 8]], dtype=np.uint8))
    whole = replace(cortex, maps={"thickness": given}, regions=parts)
    found = measure(whole)
    hold_all(holds, found, bent=1e-9, lines=1e-9, width=1e-9)
    rows = {row["region"]: row for row in found.regions}
    for name, true in (("north", 2.5), ("south", 3.5)):
        holds(f"thickness of the file, {name}", abs(rows[name]["thickness_file_mm"] - true), at_most=1e-12, unit="mm")
    nowhere = np.flatnonzero(np.isnan(found.maps["thickness_file"])).tolist()
    holds.equal("unknown in the map", nowhere, np.flatnonzero(unknown).tolist())
    status, printed = analyzed(tmp_path, capsys, whole)
    holds.equal("exit status", status, 0)
    holds.says("analyze", printed, " 100 of 2562 ", "(3.9%), 40 ", f" {gaps[0]}, at (", "[thickness_file]")
    holds.equal(
        "note where it is whole",
        "thickness_file" in measure(replace(cortex, maps={"thickness": np.full(2562, 2.5)})).notes,
        False,
    )


def spiked(cortex, vertex=0, by=1.0):
    """Pial with one vertex drawn through the body and ``by`` mm out of the face on its other side; and that face."""
    verts = cortex.pial.verts.copy()
    middles = verts[cortex.faces].mean(axis=1)
    f = int((middles @ verts[vertex] / np.linalg.norm(middles, axis=1)).argmin())
    verts[vertex] = middles[f] + by * face_normals(verts, cortex.faces)[f]
    return replace(cortex, pial=Surface(verts, cortex.faces, "lh.pial")), f


@hard_case(
    "surfaces",
    "self-intersections: a spike through a pial surface",
    guard="edges are held against all faces",
    without=lambda patch: patch.setattr(defects, "self_crossings", lambda cortex, mask: ({}, 0.0)),
)
def test_self_intersections_are_told_with_their_count_and_place(holds, tmp_path, capsys):
    """The faces around the tip go through one other face, and cross no more."""
    cortex, f = spiked(clean()[0])
    around = int((cortex.faces == 0).sum())
    status, printed = analyzed(tmp_path, capsys, cortex)
    holds.equal("exit status", status, 0)
    holds.says("analyze", printed, "lh.pial ", f": {around + 1} of 5120 ", " 1 mm", "[self_crossing]")
    place = np.array(re.search(r" of 5120 .*?\((.*?)\)", printed)[1].split(","), dtype=float)
    off = np.linalg.norm(place - clean()[0].pial.verts[clean()[0].faces[f]].mean(axis=0))
    holds("place it names, off the face's middle", off, at_most=1.0, unit="mm")  # the spike is less than 45° aslant
    holds.equal("white is said to cross itself", re.search("^warning: .*lh.white", printed, re.M) is not None, False)
    holds.equal("note of the clean one", clean()[1].notes.get("self_crossing"), None)


def wherever(patch):
    """Crossings are told wherever they are."""
    self_crossings = defects.self_crossings
    patch.setattr(defects, "self_crossings", lambda cortex, mask: self_crossings(cortex, np.ones_like(mask)))


@pytest.mark.slow
@hard_case(
    "surfaces",
    "self-intersections off the cortex",
    guard="those with a vertex in the cortex are told",
    without=wherever,
)
def test_self_intersections_off_the_cortex_are_not_told(holds):
    """The label lacks the spike, and then the face that it goes through, too."""
    cortex, f = spiked(clean()[0])
    label = np.ones(cortex.n_vertices, dtype=bool)
    label[np.unique(cortex.faces[(cortex.faces == 0).any(axis=1)])] = False
    within = int(label[cortex.faces].any(axis=1).sum())
    note = measure(replace(cortex, cortex=label.copy())).notes.get("self_crossing", "")
    holds.says("note on the face", note, "lh.pial ", f": 1 of {within} ")
    label[cortex.faces[f]] = False
    holds.equal("note", measure(replace(cortex, cortex=label)).notes.get("self_crossing"), None)


@hard_case(
    "surfaces",
    "white through itself: an offset along the normals of a noisy surface",
    guard="the net is taken half way to pial",
    without=lambda patch: patch.setattr(measuring, "LARGEST_CROSSED_SHARE", 1.0),
)
def test_hinges_of_a_cortex_whose_white_crosses_itself_are_those_of_its_ridges(holds):
    """Ridges 6 mm wide, white 2.5 mm within: crowns are gone from it, and on it alone 33 hinges of 48 are found."""
    net = irregular_net(26, seed=5, shortest=0.1)
    pial = ridged_net(net, 5, 6.0, noise=0.05, rng=3)
    white = pial.verts - 2.5 * vertex_normals(pial.verts, pial.faces, "max")
    ridged = Cortex(Surface(white, pial.faces, "lh.white"), Surface(pial.verts, pial.faces, "lh.pial"))
    found = measure(ridged)
    crossed = self_intersections(ridged.white, vertices=False).crossed_faces(ridged.faces)
    holds("share of white's triangles that others cross", len(crossed) / len(ridged.faces), at_least=0.02)
    holds.equal("hinges", found.scalars["n_hinges"], len(net.nodes))
    holds.says("note", found.notes["n_hinges"], "lh.white", "lh.pial")
    holds.equal("remark on the width", found.notes.get("gyral_width"), None)
    holds.equal("of the clean one", "lh.pial" in clean()[1].notes["n_hinges"], False)


def shell(pial, depth):
    """A cortex of uniform depth inside a surface."""
    inner = pial.verts - depth * vertex_normals(pial.verts, pial.faces)
    return Cortex(Surface(inner, pial.faces, "lh.white"), Surface(pial.verts, pial.faces, "lh.pial"))


def nearest_of_all(patch):
    """The nearest vertex, whatever wall it is of."""
    patch.setattr(cortical, "_distance_to_nearest_triangle", lambda start, target, *_: cKDTree(target).query(start)[0])


@pytest.mark.slow
@hard_case(
    "surfaces",
    "self-intersection: walls of a sulcus that pass through each other",
    without=nearest_of_all,
    guard="only the surface around the own partner, facing the same way, is searched",
    peers="unrestricted closest points jump across sulci: bias -0.06 mm, r 0.975 (measured)",
)
def test_thickness_of_walls_that_cross_is_that_of_each_wall(holds, tmp_path, capsys):
    """Each passes up to 0.8 beyond the other, whose white is 0.5 behind it: at 0.25 the two are in one place."""
    pial = pressed_sphere(5, press=1.5)
    cortex = shell(pial, 0.5)
    passed = self_intersections(pial).vertex
    holds("vertices that have passed the other wall", len(passed), at_least=10)
    found = cortical_thickness(cortex.white, cortex.pial, cap=None)
    holds("mean thickness, of 0.5", abs(found.mean() / 0.5 - 1), at_most=0.02)
    holds("least thickness of the vertices that have passed", found[passed].min() / 0.5, at_least=0.9)
    status, printed = analyzed(tmp_path, capsys, cortex)
    holds.equal("exit status", status, 0)
    holds.says("analyze", printed, "lh.white ", "; lh.pial ", "[self_crossing]")


@pytest.mark.parametrize("by", [3.8, 4.1], ids=["0.1 mm", "0.7 mm"])
@hard_case(
    "surfaces",
    "gyral thickness where the walls of a sulcus pass through each other",
    guard="a point in two gyri leaves the other one first",
    without=lambda patch: patch.setattr(
        gyral.RayCaster, "bodies", lambda self, points, *_: np.zeros(len(points), dtype=np.int64)
    ),
)
def test_the_gap_between_walls_that_cross_is_no_gyrus(holds, by):
    """Corrugated sheet; the gyri at its ends, whose other half lacks a wall, are left out."""
    sheet, width = bulged(by)
    found = gyral_thickness(sheet, scale=10.0)
    inner = (np.abs(found.points[:, 0] - 60) < 45) & np.isfinite(found.width)
    holds("median, of what it is", abs(found.median / width - 1), at_most=0.02)
    holds("least width, of what it is", found.width[inner].min() / width, at_least=0.9)
    holds(
        "contour measured, without the ends", inner.sum() / (np.abs(found.points[:, 0] - 60) < 45).sum(), at_least=0.8
    )


def fitted_in_space(patch):
    """A quadric through all that lies within the scale, whatever wall it is of."""
    own = bending.curvature

    def curvature(verts, faces, scale):
        normals, used, H = vertex_normals(verts, faces), np.unique(faces), np.full(len(verts), np.nan)
        for i, around in zip(used, cKDTree(verts[used]).query_ball_point(verts[used], scale)):
            around = used[around]
            across = np.linalg.svd(normals[i][None])[2][1:]
            u, v, h = np.vstack([across, normals[i]]) @ (verts[around] - verts[i]).T
            a = np.linalg.lstsq(np.stack([1 + 0 * u, u, v, u * u, u * v, v * v], axis=1), h, rcond=None)[0]
            H[i] = -(a[3] + a[5])
        return replace(own(verts, faces, scale), k1=H, k2=H)

    patch.setattr(bending, "curvature", curvature)


@pytest.mark.parametrize("press", [1.0, 1.5], ids=["touching", "crossing"])
@hard_case(
    "surfaces",
    "curvature of walls that touch, or pass through each other",
    guard="a fit along the surface",
    without=fitted_in_space,
)
def test_the_other_wall_of_a_sulcus_does_not_change_curvature(holds, press):
    """The sphere is cut along the plane that the walls meet in, which on the surface is the bottom of the sulcus."""
    pial, scale = pressed_sphere(5, press=press), 1.2
    before = pressed_sphere(5, press=0.0).verts[:, 0]  # 3 mm and more along the surface from the cut
    pressed = (before > 1.5) & (before < 2.4) & (np.abs(pial.verts[:, 0]) < 0.5) & (np.abs(pial.verts[:, 1]) < 2)
    holds("vertices in contact", pressed.sum(), at_least=5)
    alone = pial.faces[(before[pial.faces] >= 0).all(axis=1)]
    both, one = (bending.curvature(pial.verts, faces, scale).H[pressed] for faces in (pial.faces, alone))
    holds("change of H", np.abs(both - one).max(), at_most=1e-9, unit="/mm")


@hard_case(
    "surfaces",
    "a simulated surface with sulcal walls in contact",
    without=nearest_of_all,
    guard="only the surface around the own partner, facing the same way, is searched",
)
def test_thickness_of_a_simulated_cortex_fills_its_volume(holds):
    """Between surfaces a distance t apart the volume is t (A + 4 A' + A'') / 6, of white, midway and pial: areas are
    quadratic in the distance (Steiner), so that Simpson's rule is exact. Between planes that meet at an angle a, at the
    distance r from their edge: both closest distances are r sin(a), areas 1, cos(a / 2) and 1, the volume r a."""
    cortex = read_cortex(sample_path("simulated"))
    white, pial, faces = cortex.white.verts, cortex.pial.verts, cortex.faces
    outward = [vertex_normals(verts, faces) for verts in (white, pial)]
    edge = mean_edge_length(pial, faces)
    i, j = cKDTree(pial).query_pairs(0.2 * edge, output_type="ndarray").T
    facing = np.sum(outward[1][i] * outward[1][j], axis=1) < -0.5  # contact acts from 0.2 edges on
    holds("vertices of pial in contact with one of another wall", len(np.union1d(i[facing], j[facing])), at_least=100)
    found = cortical_thickness(cortex.white, cortex.pial, cap=None)
    linked = np.linalg.norm(pial - white, axis=1)
    holds("thickness less the way to the own partner", (found - linked).max(), at_most=1e-12, unit="mm")
    inner, middle, outer = (vertex_areas(verts, faces) for verts in (white, (white + pial) / 2, pial))
    area = (inner + 4 * middle + outer) / 6
    volume = enclosed_volume(cortex.pial) - enclosed_volume(cortex.white)
    angle = np.arccos(np.clip(np.sum(outward[0] * outward[1], axis=1), -1, 1 - 1e-12))
    wedge = np.sin(angle) * (1 + 2 * np.cos(angle / 2)) / (3 * angle)
    least = np.average(wedge, weights=found * area)
    holds("volume filled", np.sum(found * area) / volume, at_least=least, at_most=1.0)


def of_curvature(patch):
    """The net is that of mean curvature, which on a flat crown has no ridge but two."""
    patch.setattr(
        SurfaceOperators, "depth_and_curvature", lambda self, _, scale: (self.smooth(self._curvatures(), scale),) * 2
    )


@hard_case(
    "surfaces", "gyri with flat crowns", guard="a net of the depth potential, not of curvature", without=of_curvature
)
def test_the_net_of_gyri_with_flat_crowns_is_that_of_their_middles(holds, tmp_path, capsys):
    """Cut off at 3 of 8 mm above the floor, 20 mm wide there."""
    verts = known_cortex().pial.verts
    radius = np.linalg.norm(verts, axis=1, keepdims=True)
    flat = Surface(verts * np.minimum(1, 53 / radius), clean()[0].faces, "lh.white")
    graph = gyral_graph(flat)
    holds.equal("hinges", [data["degree"] for _, data in graph.nodes(data=True)], len(NET.nodes) * [3])
    holds.equal("crests", graph.number_of_edges(), len(NET.arcs))
    length = sum(crest["length"] for *_, crest in graph.edges(data=True))
    holds("length of crests", abs(length / (53 * NET.lengths.sum()) - 1), at_most=0.03)
    at = np.array([data["position"] for _, data in graph.nodes(data=True)])
    off = cKDTree(53 * NET.nodes).query(at)[0]
    holds("hinges off their place, median", np.median(off), at_most=4.0, unit="mm")  # an edge
    thicker = Surface(flat.verts * (1 + 2.5 / np.linalg.norm(flat.verts, axis=1, keepdims=True)), flat.faces, "lh.pial")
    status, printed = analyzed(tmp_path, capsys, Cortex(flat, thicker), "--json")
    holds.equal("exit status", status, 0)
    found = json.loads(printed)["surfaces"][0]["measures"]
    holds.equal("analyze: hinges, crests", [found["n_hinges"], found["n_crests"]], [len(NET.nodes), len(NET.arcs)])


def any_extremum(patch):
    for name in ("LEAST_CURVATURE_DIFFERENCE", "LEAST_SHARPNESS", "LEAST_CURVATURE_DROP"):
        patch.setattr(crests, name, -np.inf)


UMBILIC = {"sphere": lambda: shapes.sphere(4, rng=1), "torus": lambda: shapes.torus(rng=1), "cylinder": shapes.cylinder}


@pytest.mark.parametrize("name", UMBILIC)
@hard_case(
    "surfaces",
    "umbilics everywhere, and curvature that nowhere has an extremum",
    without=any_extremum,
    guard="crests fall away to both sides",
    peers="CGAL Ridges_3: 6041 segments on the sphere, 7328 on the torus (measured)",
)
def test_cyclides_have_no_crest_lines(holds, name):
    shape = UMBILIC[name]()
    holds.equal(f"lines on the {name}", len(crest_lines(shape.verts, shape.faces).lines), 0)


@hard_case(
    "surfaces",
    "a plane",
    guard="no shape without curvature",
    without=lambda patch: patch.setattr(
        bending.Curvature, "shape_index", property(lambda c: 2 / np.pi * np.arctan2(c.k1 + c.k2, c.k1 - c.k2))
    ),
)
def test_a_plane_has_no_curvature_and_no_shape(holds):
    sheet, _ = shapes.corrugated_sheet(2.0, height=0.0, size=40.0, rng=1)
    found = bending.curvature(sheet.verts, sheet.faces)
    holds("curvature", np.abs([found.k1, found.k2]).max(), at_most=1e-12, unit="/mm")
    holds.equal("vertices with a shape index", int(np.isfinite(found.shape_index).sum()), 0)
    holds.equal("crest lines", len(crest_lines(sheet.verts, sheet.faces).lines), 0)
