"""Parts too many or too few: unused vertices, pieces, holes, borders, a split medial wall, 12 vertices."""

from dataclasses import replace

import numpy as np
import pytest
from hard_cases.cases import hard_case
from hard_cases.made_surfaces import analyzed, changed, clean, hold_all, with_island

from morphofold import geometry
from morphofold.analysis import curvatures, measure, vertex_areas
from morphofold.analysis.graph.depth_potential import SurfaceOperators
from morphofold.analysis.graph.net import Net
from morphofold.analysis.gyrification import folding, local_gyrification
from morphofold.cli import cortex as analyze
from morphofold.intersections.boxes import box_tree
from morphofold.mesh_quality import checks, repair
from morphofold.shapes import icosphere
from morphofold.studies.shapes import REGULAR_SOLIDS
from morphofold.surface import Cortex, Surface


def all_of_them(patch):
    """Vertices that no triangle uses are measured and boxed with the others."""
    patch.setattr(repair, "_build_mended", lambda cortex, *_: repair.as_given(cortex))
    patch.setattr(local_gyrification, "in_use", lambda verts, faces: (np.arange(len(verts)), verts, faces))


@pytest.mark.parametrize("first", [False, True])
@hard_case(
    "surfaces",
    "unused vertices, a kilometre away",
    guard="only vertices in use are measured",
    without=all_of_them,
    fails=(AssertionError, ValueError, MemoryError),
)
def test_unused_vertices_change_no_measure_and_are_told(holds, tmp_path, capsys, first):
    stray = np.full((5, 3), 1e6) + np.eye(5, 3)
    cortex = clean()[0]
    put = (lambda verts: np.concatenate([stray, verts])) if first else (lambda verts: np.concatenate([verts, stray]))
    found = measure(changed(cortex, put, cortex.faces + 5 * first))
    maps = {name: values[5:] if first else values for name, values in found.maps.items()}
    hold_all(holds, replace(found, maps=maps), bent=1e-6, lines=0.01, width=1e-4)
    holds.equal("vertices without H", int(np.isnan(found.maps["H"]).sum()), 5)
    status, printed = analyzed(tmp_path, capsys, found.cortex)
    holds.equal("exit status", status, 0)
    holds.says("analyze", printed, " 5 of 2567 ", "[mesh]")


@hard_case(
    "surfaces",
    "unused vertices, a kilometre away, in a file of float32",
    without=all_of_them,
    guard="only vertices in use are measured",
)
def test_unused_vertices_far_away_do_not_make_the_others_seem_rounded(holds, tmp_path, capsys):
    cortex = changed(clean()[0], lambda verts: np.concatenate([verts, np.full((5, 3), 1e6)]))
    status, printed = analyzed(tmp_path, capsys, cortex)  # FreeSurfer's format has single precision
    holds.equal("exit status", status, 0)
    holds.says("analyze", printed, " 5 of 2567 ", "[mesh]")
    holds.equal("told to be rounded", "float32" in printed, False)


def one_mean(patch):
    """Mean curvature is subtracted over all pieces at once."""
    patch.setattr(
        SurfaceOperators, "_mean_curvatures", lambda self: np.full(len(self._mass), self._bent.sum() / self.area)
    )


@pytest.mark.parametrize("at", [(0.0, 0.0, 0.0), (80.0, 0.0, 0.0)], ids=["inside", "outside"])
@hard_case(
    "surfaces",
    "two pieces: a closed island of 1 mm",
    guard="the depth potential has mean 0 on each piece",
    peers="libigl crashes on small components (said)",
    without=one_mean,
)
def test_an_island_changes_what_is_its_own_only(holds, tmp_path, capsys, at):
    found = measure(with_island(clean()[0], at), repair=False)
    holds.equal("gyrification index", found.scalars["gyrification_index"], None)
    holds.says("its note", found.notes["gyrification_index"], " 2 ")
    gained = found.scalars["intrinsic_curvature_index"] - clean()[1].scalars["intrinsic_curvature_index"]
    holds("curvature index gained, of 1 by Gauss-Bonnet", abs(gained - 1), at_most=0.02)
    own = (
        "gyrification_index",
        "mean_local_gyrification_index",
        "intrinsic_curvature_index",
        "mean_sulcal_depth_mm",
        "mean_cortical_thickness_mm",
        "lines",
    )
    hold_all(holds, found, area=1e-3, without=own)  # 12 mm^2 of 40,000
    status, printed = analyzed(tmp_path, capsys, found.cortex)
    holds.equal("exit status", status, 0)
    holds.says("analyze, which leaves it out", printed, " 80, ", "[repair]")


@hard_case(
    "surfaces",
    "a cavity: a closed piece within another, its outside within",
    without=lambda patch: patch.setattr(checks, "cavities", lambda cortex: []),
    guard="what lies around a piece turned inwards",
    fails=(AssertionError, ValueError),
)
def test_the_wall_of_a_cavity_is_measured_and_told(holds, tmp_path, capsys):
    """A sphere in white matter, with 2.5 mm of cortex around it: areas and thickness are of both pieces."""
    cortex, whole = clean()
    hollow = with_island(cortex, (0.0, 0.0, 0.0), white=17.5, pial=15.0, hollow=True)
    found = measure(hollow, curvature_scale=whole.parameters["curvature_scale_mm"])
    verts, faces = icosphere(1)
    for name, radius in (("white", 17.5), ("pial", 15.0)):
        gained = found.scalars[f"area_{name}_mm2"] - whole.scalars[f"area_{name}_mm2"]
        holds(f"area gained, {name}", abs(gained / (radius**2 * vertex_areas(verts, faces).sum()) - 1), at_most=1e-9)
    wall = slice(cortex.n_vertices, None)
    # the triangles lie up to a twentieth of the radius inside the spheres
    holds("thickness of the wall, of 2.5", np.abs(found.maps["cortical_thickness"][wall] / 2.5 - 1).max(), at_most=0.1)
    holds("H of the wall, of -1/15", np.abs(-15 * found.maps["H"][wall] - 1).max(), at_most=1e-9)
    for name in ("H", "cortical_thickness", "sulcal_depth"):
        off = np.abs(found.maps[name][: cortex.n_vertices] - whole.maps[name]).max()
        holds(f"change of {name} elsewhere", off, at_most=1e-9)
    holds.equal("hinges", found.scalars["n_hinges"], whole.scalars["n_hinges"])
    holds.equal("white is said to lie outside pial", "crossing" in found.notes, False)
    status, printed = analyzed(tmp_path, capsys, found.cortex)
    holds.equal("exit status", status, 0)
    holds.says("analyze", printed, " 2 ", " 2562, 42 ", "(1 ")


@pytest.mark.parametrize(
    ("at", "white", "pial"),
    [((0, 0, 0), 15.0, 17.5), ((90, 0, 0), 17.5, 15.0)],
    ids=["white within", "in no other piece"],
)
@hard_case(
    "surfaces",
    "what is no cavity, but inside out",
    guard="the volume of each piece",
    without=lambda patch: patch.setattr(checks, "check_sides", lambda cortex: None),
)
def test_a_piece_turned_inwards_that_is_no_cavity_is_refused(holds, tmp_path, capsys, at, white, pial):
    cortex = with_island(clean()[0], at, white=white, pial=pial, hollow=True)
    status, printed = analyzed(tmp_path, capsys, cortex, "--no-repair")
    holds.equal("exit status", status, 2)
    holds.says("analyze", printed, " 2562 of lh.white ")


def a_tree_each(patch):
    """The pieces are looked at one by one, each with a tree of all the faces."""
    together = checks._pieces_within_others
    patch.setattr(
        checks,
        "_pieces_within_others",
        lambda surface, piece, asked: asked[
            [len(together(surface, piece, asked[n : n + 1])) > 0 for n in range(len(asked))]
        ],
    )


def with_cavities(cortex, at):
    """The cortex and small cavities in its white matter, icosahedra."""
    verts, faces = icosphere(0)
    n = cortex.n_vertices + len(verts) * np.arange(len(at))
    both = np.concatenate([cortex.faces, (n[:, None, None] + faces[:, ::-1]).reshape(-1, 3)])
    walls = {r: (at[:, None, :] + r * verts).reshape(-1, 3) for r in (1.0, 0.7)}
    white, pial = (
        Surface(np.concatenate([s.verts, walls[r]]), both, s.name) for s, r in ((cortex.white, 1), (cortex.pial, 0.7))
    )
    return replace(cortex, white=white, pial=pial)


@hard_case("surfaces", "500 pieces turned inwards", guard="one tree of boxes does for all of them", without=a_tree_each)
def test_many_cavities_are_told_with_few_trees_and_what_is_none_is_refused(holds, tmp_path, capsys, monkeypatch):
    """In a grid of 3 mm; then the last one is put, smaller, into the first one, where no tissue is."""
    grid = 3.0 * np.stack(np.meshgrid(*[np.arange(-5, 6)] * 3), axis=-1).reshape(-1, 3)
    at = grid[np.argsort(np.linalg.norm(grid, axis=1), kind="stable")[:500]]
    holed, trees = with_cavities(clean()[0], at), []
    monkeypatch.setattr(checks, "box_tree", lambda *mesh: (trees.append(1), box_tree(*mesh))[1])
    found = measure(holed, curvature_scale=clean()[1].parameters["curvature_scale_mm"])
    holds("trees, of two surfaces", len(trees), at_most=4)
    verts, faces = icosphere(0)
    for name, radius in (("white", 1.0), ("pial", 0.7)):
        gained = found.scalars[f"area_{name}_mm2"] - clean()[1].scalars[f"area_{name}_mm2"]
        true = 500 * radius**2 * vertex_areas(verts, faces).sum()
        holds(f"area gained, {name}", abs(gained / true - 1), at_most=1e-9)
    holds.says("note", found.notes["mesh"], " 501 ", "(500 ")
    shrunk = lambda v: np.concatenate([v[:-12], at[0] + 0.3 * (v[-12:] - at[-1])])
    status, printed = analyzed(tmp_path, capsys, changed(holed, shrunk))
    holds.equal("exit status", status, 2)
    holds.says("analyze", printed, f" {holed.n_vertices - 12} of lh.white ")


def numbers_only(patch):
    patch.setattr(analyze, "_formatted_or_na", lambda value, form, unit="": f"{value:{form}}{unit}")


@hard_case(
    "surfaces",
    "a hole of one triangle",
    guard="n/a for what cannot be had",
    peers="Workbench: smoothing an open surface breaks its curvature (said)",
    without=numbers_only,
)
def test_a_hole_takes_the_indices_of_closed_surfaces_and_nothing_else(holds, tmp_path, capsys):
    cortex = clean()[0]
    lowest = np.linalg.norm(cortex.pial.verts[cortex.faces], axis=2).max(axis=1).argmin()  # on no crest
    holed = changed(cortex, faces=np.delete(cortex.faces, lowest, axis=0))
    status, printed = analyzed(tmp_path, capsys, holed, kind=".vtk")
    holds.equal("exit status", status, 0)
    first = geometry.border_edges(holed.faces)[0, 0]
    holds.says("analyze", printed, "GI n/a", f" {first}, (", "[mesh]")
    found = measure(holed)
    hold_all(holds, found, area=1e-3, without=("gyrification_index", "mean_local_gyrification_index"))
    holds.says("note of the index", found.notes["gyrification_index"], "has a border")


def part(cortex, keep):
    return changed(cortex, faces=cortex.faces[keep[cortex.faces].all(axis=1)])


@hard_case(
    "surfaces",
    "a wide border: half of the surface cut away",
    guard="a border has no hull of its own",
    peers="pyvista is wrong at borders (said)",
    without=lambda patch: patch.setattr(geometry, "is_closed", lambda faces: True),
    fails=(AssertionError, ValueError),
)
def test_half_a_surface_has_the_measures_of_half(holds, tmp_path, capsys):
    cortex, whole = clean()
    z, scale = cortex.pial.verts[:, 2], whole.parameters["curvature_scale_mm"]
    half = [measure(part(cortex, keep), curvature_scale=scale) for keep in (z >= 0, z <= 0)]
    for m in half:
        holds.equal("gyrification index", m.scalars["gyrification_index"], None)
        both = np.isfinite(m.maps["H"])
        inner = both & (np.abs(z) > 2 * scale)
        off = (m.maps["H"] - whole.maps["H"])[inner] / np.sqrt(np.mean(whole.maps["H"] ** 2))
        holds("H two scales inside", np.abs(off).max(), at_most=1e-9)
        thick = (m.maps["cortical_thickness"] - whole.maps["cortical_thickness"])[inner]
        holds("thickness there", np.abs(thick).max(), at_most=1e-9, unit="mm")
        holds(
            "gyral thickness",
            abs(m.scalars["median_gyral_thickness_mm"] / whole.scalars["median_gyral_thickness_mm"] - 1),
            at_most=0.05,
        )
    hinges = sum(m.scalars["n_hinges_high"] for m in half)  # at the cut, doubtful ones too
    holds.equal("hinges of both", hinges, whole.scalars["n_hinges_high"])
    status, printed = analyzed(tmp_path, capsys, half[0].cortex)
    holds.equal("exit status", status, 0)
    holds.says("analyze", printed, "GI n/a", f" {len(geometry.border_edges(half[0].cortex.faces))} ", "[mesh]")


def wall_of_nothing(patch):
    """Crests run on through what is no cortex."""
    patch.setattr(Net, "keep", lambda self, good: None)


@pytest.mark.parametrize("closed", [False, True])
@hard_case(
    "surfaces",
    "a medial wall that splits the cortex in two",
    guard="crests are cut at the wall",
    without=wall_of_nothing,
)
def test_a_medial_wall_that_splits_the_surface_leaves_two_cortices(holds, tmp_path, capsys, closed):
    """Told by a label, or by white and pial being one there."""
    cortex, whole = clean()
    wall = np.abs(cortex.pial.verts[:, 2]) < 8
    white = Surface(np.where(wall[:, None], cortex.pial.verts, cortex.white.verts), cortex.faces, "lh.white")
    m = measure(replace(cortex, white=white) if closed else replace(cortex, cortex=~wall))
    for name in ("H", "cortical_thickness", "sulcal_depth"):
        holds.equal(f"{name} known", np.flatnonzero(np.isnan(m.maps[name])).tolist(), np.flatnonzero(wall).tolist())
    off = (m.maps["H"] - whole.maps["H"])[~wall]
    holds("H off the wall", np.abs(off).max(), at_most=1e-12, unit="/mm")
    ends = np.array([point for *_, crest in m.graph.edges(data=True) for point in crest["polyline"]])
    edge = geometry.mean_edge_length(cortex.white.verts, cortex.faces)
    holds("crests inside the wall", 8 - np.abs(ends[:, 2]).min(), at_most=edge, unit="mm")
    sides = [sorted({bool(crest["polyline"][k, 2] > 0) for k in (0, -1)}) for *_, crest in m.graph.edges(data=True)]
    holds.equal("crests across", [side for side in sides if len(side) > 1], [])
    graph = m.graph
    loops = graph.number_of_edges() - graph.number_of_nodes()
    holds.equal("sum of degrees less 2", sum(degree - 2 for _, degree in graph.degree()), 2 * loops)
    if closed:  # two files have no label
        status, printed = analyzed(tmp_path, capsys, m.cortex)
        holds.equal("exit status", status, 0)
        holds.says("analyze", printed, f"cortical thickness {m.scalars['mean_cortical_thickness_mm']:.2f} mm")


@hard_case(
    "surfaces",
    "12 vertices",
    guard="triangles wider than the region of the index are cut",
    peers="libigl crashes with fewer than six neighbours (said)",
    without=lambda patch: patch.setattr(local_gyrification, "LARGEST_EDGE_OVER_REGION", np.inf),
)
def test_the_icosahedron_is_measured_as_such(holds, tmp_path, capsys):
    verts, faces = icosphere(0)
    m = measure(Cortex(*(Surface(r * verts, faces, f"lh.{name}") for r, name in ((40, "white"), (50, "pial")))))
    s = m.scalars
    side = 50 / np.sin(2 * np.pi / 5)
    holds("area", abs(s["area_pial_mm2"] / (5 * 3**0.5 * side**2) - 1), at_most=1e-12)
    holds("gyrification index", abs(s["gyrification_index"] - 1), at_most=1e-12)
    holds("local gyrification, of a convex body", abs(s["mean_local_gyrification_index"] - 1), at_most=0.05)
    holds("depth", s["mean_sulcal_depth_mm"], at_most=1e-9, unit="mm")
    holds("H at the corners, on a sphere", np.abs(m.maps["H"] * 50 - 1).max(), at_most=1e-9)
    holds.equal("hinges", s["n_hinges"], 0)
    holds.equal("gyral thickness", s["median_gyral_thickness_mm"], None)
    status, printed = analyzed(tmp_path, capsys, m.cortex)
    holds.equal("exit status", status, 0)
    holds.says("analyze", printed, "12 vertices", "gyral thickness n/a")


def fitted(patch):
    """K is that of the fit, where there is none nothing."""
    patch.setattr(
        folding,
        "angle_defects",
        lambda verts, faces: np.nan_to_num(curvatures.curvature(verts, faces).K * vertex_areas(verts, faces)),
    )


@hard_case("surfaces", "4 vertices: no curvature can be fitted", guard="K of the indices is no fit", without=fitted)
def test_the_tetrahedron_has_no_curvature_and_says_so(holds, tmp_path, capsys):
    verts, faces = np.array(REGULAR_SOLIDS["tetrahedron"]), np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]])
    m = measure(Cortex(Surface(25.0 * verts, faces, "lh.white"), Surface(30.0 * verts, faces, "lh.pial")))
    holds.equal("vertices with H", int(np.isfinite(m.maps["H"]).sum()), 0)
    holds("intrinsic curvature index, of 1", abs(m.scalars["intrinsic_curvature_index"] - 1), at_most=1e-3)
    holds("gyrification index", abs(m.scalars["gyrification_index"] - 1), at_most=1e-12)
    status, printed = analyzed(tmp_path, capsys, m.cortex)
    holds.equal("exit status", status, 0)
    scale = m.parameters["curvature_scale_mm"]
    holds.says("analyze", printed, "4 vertices, GI 1.00", "gyral thickness n/a", f" {scale:.3g}, ", "[curvature_scale]")
