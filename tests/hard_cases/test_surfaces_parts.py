"""Parts too many or too few: unused vertices, pieces, holes, borders, a split medial wall, 12 vertices.

Where coordinates lie and how they are written: far from the origin, in other units, in single precision.
"""

import re
from dataclasses import replace

import numpy as np
import pytest
from hard_cases.made_surfaces import CORTEX, analyze, case, change, changed, clean, hold_all, pair, refusal, with_island
from made_surfaces import FORMATS

from morphofold import geometry
from morphofold.analysis import curvatures, measure, vertex_areas
from morphofold.analysis.graph.curve_net import Net
from morphofold.analysis.graph.depth_potential import SurfaceOperators
from morphofold.analysis.gyrification import folding_indices as folding, local_gyrification
from morphofold.analysis.thickness import gyral_thickness as widths
from morphofold.intersections.box_tree import box_tree
from morphofold.io import read_cortex, read_surface, write_surface
from morphofold.mesh_quality import cortex_checks as checks, defects, repair
from morphofold.shapes import icosphere
from morphofold.studies.known_shapes import REGULAR_SOLIDS
from morphofold.surface import Surface


def all_of_them(patch):
    """Vertices that no triangle uses are measured and boxed with the others."""
    patch.setattr(repair, "_build_mended", lambda cortex, *_: repair.as_given(cortex))
    patch.setattr(local_gyrification, "in_use", lambda verts, faces: (np.arange(len(verts)), verts, faces))


IN_USE = {"guard": "only vertices in use are measured", "without": all_of_them}
CLOSED = (geometry, "is_closed", lambda faces: True)
STRAY = np.full((5, 3), 1e6) + np.eye(5, 3)


@pytest.mark.parametrize("first", [False, True])
@case("unused vertices, a kilometre away", **IN_USE)
def test_unused_vertices_change_no_measure_and_are_told(holds, tmp_path, capsys, first):
    put = lambda verts: np.concatenate([STRAY, verts] if first else [verts, STRAY])
    result = measure(changed(CORTEX, put, CORTEX.faces + 5 * first))
    maps = {name: values[5:] if first else values for name, values in result.maps.items()}
    hold_all(holds, replace(result, maps=maps), bent=1e-6, lines=0.01, width=1e-4)
    holds.equal("vertices without H", int(np.isnan(result.maps["H"]).sum()), 5)
    analyze(holds, tmp_path, capsys, result.cortex, " 5 of 2567 ", "[mesh]")


@case("unused vertices, a kilometre away, in a file of float32", **IN_USE)
def test_unused_vertices_far_away_do_not_make_the_others_seem_rounded(holds, tmp_path, capsys):
    """FreeSurfer's format has single precision."""
    far = changed(CORTEX, lambda verts: np.concatenate([verts, STRAY]))
    printed = analyze(holds, tmp_path, capsys, far, " 5 of 2567 ", "[mesh]")
    holds.equal("told to be rounded", "float32" in printed, False)


SINGLE_PIECE = property(lambda self: np.zeros(len(self.verts), dtype=np.int64), lambda self, pieces: None)


@pytest.mark.parametrize("at", [(0.0, 0.0, 0.0), (80.0, 0.0, 0.0)], ids=["inside", "outside"])
@case(
    "two pieces: a closed island of 1 mm",
    "the depth potential has mean 0 on each piece",
    (SurfaceOperators, "_piece", SINGLE_PIECE, False),
    peers="libigl crashes on small components (said)",
)
def test_an_island_changes_what_is_its_own_only(holds, tmp_path, capsys, at):
    result = measure(with_island(CORTEX, at), repair=False)
    holds.equal("gyrification index", result.scalars["gyrification_index"], None)
    gained = result.scalars["intrinsic_curvature_index"] - clean()[1].scalars["intrinsic_curvature_index"]
    holds("curvature index gained, of 1 by Gauss-Bonnet", change(gained, 1), at_most=0.02)
    own = "mean_local_gyrification_index intrinsic_curvature_index mean_sulcal_depth_mm mean_cortical_thickness_mm"
    hold_all(holds, result, area=1e-3, without=["gyrification_index", "lines", *own.split()])  # 12 mm^2 of 40,000
    analyze(holds, tmp_path, capsys, result.cortex, " 80, ", "[repair]", what="analyze, which leaves it out")


def hold_areas_gained(holds, result, level, count=1, **radii):
    """By so many spheres."""
    sphere = vertex_areas(*icosphere(level)).sum()
    for name, radius in radii.items():
        gained = result.scalars[f"area_{name}_mm2"] - clean()[1].scalars[f"area_{name}_mm2"]
        holds(f"area gained, {name}", change(gained, count * radius**2 * sphere), at_most=1e-9)


@case(
    "a cavity: a closed piece within another, its outside within",
    "what lies around a piece turned inwards",
    (checks, "cavities", lambda cortex: []),
)
def test_the_wall_of_a_cavity_is_measured_and_told(holds, tmp_path, capsys):
    """A sphere in white matter, with 2.5 mm of cortex around it: areas and thickness are of both pieces."""
    whole = clean()[1]
    hollow = with_island(CORTEX, (0.0, 0.0, 0.0), white=17.5, pial=15.0, hollow=True)
    result = measure(hollow, curvature_scale=whole.parameters["curvature_scale_mm"])
    hold_areas_gained(holds, result, 1, white=17.5, pial=15.0)
    of_wall = {name: values[2562:] for name, values in result.maps.items()}
    # the triangles lie up to a twentieth of the radius inside the spheres
    holds("thickness of the wall, of 2.5", np.abs(of_wall["cortical_thickness"] / 2.5 - 1).max(), at_most=0.1)
    holds("H of the wall, of -1/15", np.abs(-15 * of_wall["H"] - 1).max(), at_most=1e-9)
    for name in ("H", "cortical_thickness", "sulcal_depth"):
        off = np.abs(result.maps[name][:2562] - whole.maps[name]).max()
        holds(f"change of {name} elsewhere", off, at_most=1e-9)
    holds.equal("hinges", result.scalars["n_hinges"], whole.scalars["n_hinges"])
    holds.equal("white is said to lie outside pial", "crossing" in result.notes, False)
    analyze(holds, tmp_path, capsys, hollow, " 2 ", " 2562, 42 ", "(1 ")


@pytest.mark.parametrize(("at", "white", "pial"), [((0, 0, 0), 15.0, 17.5), ((90, 0, 0), 17.5, 15.0)])
@case("what is no cavity, but inside out", "the volume of each piece", (checks, "check_sides", lambda cortex: None))
def test_a_piece_turned_inwards_that_is_no_cavity_is_refused(holds, tmp_path, capsys, at, white, pial):
    """White within pial, and a piece in no other one."""
    cortex = with_island(CORTEX, at, white=white, pial=pial, hollow=True)
    analyze(holds, tmp_path, capsys, cortex, " 2562 of lh.white ", status=2, options=["--no-repair"])


def a_tree_each(surface, piece, asked, together=checks._pieces_within_others):
    """The pieces are looked at one by one, each with a tree of all the faces."""
    return asked[[len(together(surface, piece, asked[[n]])) > 0 for n in range(len(asked))]]


@case(
    "500 pieces turned inwards",
    "one tree of boxes does for all of them",
    (checks, "_pieces_within_others", a_tree_each),
)
def test_many_cavities_are_told_with_few_trees_and_what_is_none_is_refused(holds, tmp_path, capsys, monkeypatch):
    """In a grid of 3 mm; then the last one is put, smaller, into the first one, where no tissue is."""
    grid = 3.0 * np.stack(np.meshgrid(*[np.arange(-5, 6)] * 3), axis=-1).reshape(-1, 3)
    at = grid[np.argsort(np.linalg.norm(grid, axis=1), kind="stable")[:500]]
    holed, trees = with_island(CORTEX, at, white=1.0, pial=0.7, hollow=True, level=0), []
    monkeypatch.setattr(checks, "box_tree", lambda *mesh: (trees.append(1), box_tree(*mesh))[1])
    result = measure(holed, curvature_scale=clean()[1].parameters["curvature_scale_mm"])
    holds("trees, of two surfaces", len(trees), at_most=4)
    hold_areas_gained(holds, result, 0, count=500, white=1.0, pial=0.7)
    holds.says("note", result.notes["mesh"], " 501 ", "(500 ")
    shrunk = changed(holed, lambda v: np.concatenate([v[:-12], at[0] + 0.3 * (v[-12:] - at[-1])]))
    analyze(holds, tmp_path, capsys, shrunk, f" {holed.n_vertices - 12} of lh.white ", status=2)


@case(
    "a hole of one triangle",
    "n/a for what cannot be had",
    CLOSED,
    peers="Workbench: smoothing an open surface breaks its curvature (said)",
)
def test_a_hole_takes_the_indices_of_closed_surfaces_and_nothing_else(holds, tmp_path, capsys):
    lowest = np.linalg.norm(CORTEX.pial.verts[CORTEX.faces], axis=2).max(axis=1).argmin()  # on no crest
    holed = changed(CORTEX, faces=np.delete(CORTEX.faces, lowest, axis=0))
    phrases = ("GI n/a", f" {geometry.border_edges(holed.faces)[0, 0]}, (", "[mesh]")
    analyze(holds, tmp_path, capsys, holed, *phrases, kind=".vtk")
    hold_all(holds, measure(holed), area=1e-3, without=("gyrification_index", "mean_local_gyrification_index"))


@case(
    "a wide border: half of the surface cut away",
    "a border has no hull of its own",
    CLOSED,
    peers="pyvista is wrong at borders (said)",
)
def test_half_a_surface_has_the_measures_of_half(holds, tmp_path, capsys):
    whole = clean()[1]
    z, scale = CORTEX.pial.verts[:, 2], whole.parameters["curvature_scale_mm"]
    cut = [changed(CORTEX, faces=CORTEX.faces[half[CORTEX.faces].all(axis=1)]) for half in (z >= 0, z <= 0)]
    halves = [measure(half, curvature_scale=scale) for half in cut]
    for m in halves:
        holds.equal("gyrification index", m.scalars["gyrification_index"], None)
        inner = np.isfinite(m.maps["H"]) & (np.abs(z) > 2 * scale)
        off = {name: (m.maps[name] - whole.maps[name])[inner] for name in ("H", "cortical_thickness")}
        size = np.sqrt(np.mean(whole.maps["H"] ** 2))
        holds("H two scales inside", np.abs(off["H"] / size).max(), at_most=1e-9)
        holds("thickness there", np.abs(off["cortical_thickness"]).max(), at_most=1e-9, unit="mm")
        width, true = (a.scalars["median_gyral_thickness_mm"] for a in (m, whole))
        holds("gyral thickness", change(width, true), at_most=0.05)
    hinges = sum(m.scalars["n_hinges_high"] for m in halves)  # at the cut, doubtful ones too
    holds.equal("hinges of both", hinges, whole.scalars["n_hinges_high"])
    border = len(geometry.border_edges(cut[0].faces))
    analyze(holds, tmp_path, capsys, cut[0], "GI n/a", f" {border} ", "[mesh]")


@pytest.mark.parametrize("closed", [False, True])
@case(
    "a medial wall that splits the cortex in two", "crests are cut at the wall", (Net, "keep", lambda self, good: None)
)
def test_a_medial_wall_that_splits_the_surface_leaves_two_cortices(holds, tmp_path, capsys, closed):
    """Told by a label, or by white and pial being one there."""
    whole = clean()[1]
    wall = np.abs(CORTEX.pial.verts[:, 2]) < 8
    met = pair(np.where(wall[:, None], CORTEX.pial.verts, CORTEX.white.verts), CORTEX.pial.verts, CORTEX.faces)
    m = measure(met if closed else replace(CORTEX, cortex=~wall))
    for name in ("H", "cortical_thickness", "sulcal_depth"):
        holds.equal(f"{name} known", np.flatnonzero(np.isnan(m.maps[name])).tolist(), np.flatnonzero(wall).tolist())
    holds("H off the wall", np.abs((m.maps["H"] - whole.maps["H"])[~wall]).max(), at_most=1e-12, unit="/mm")
    heights = [polyline[:, 2] for *_, polyline in m.graph.edges(data="polyline")]
    edge = geometry.mean_edge_length(CORTEX.white.verts, CORTEX.faces)
    holds("crests inside the wall", 8 - np.abs(np.concatenate(heights)).min(), at_most=edge, unit="mm")
    holds.equal("crests across", [z for z in heights if (z[0] > 0) != (z[-1] > 0)], [])
    loops = m.graph.number_of_edges() - m.graph.number_of_nodes()
    holds.equal("sum of degrees less 2", sum(degree - 2 for _, degree in m.graph.degree()), 2 * loops)
    if closed:  # two files have no label
        mean = m.scalars["mean_cortical_thickness_mm"]
        analyze(holds, tmp_path, capsys, m.cortex, f"cortical thickness {mean:.2f} mm")


@case(
    "12 vertices",
    "triangles wider than the region of the index are cut",
    (local_gyrification, "LARGEST_EDGE_OVER_REGION", np.inf),
    peers="libigl crashes with fewer than six neighbours (said)",
)
def test_the_icosahedron_is_measured_as_such(holds, tmp_path, capsys):
    verts, faces = icosphere(0)
    m = measure(pair(40 * verts, 50 * verts, faces))
    side = 50 / np.sin(2 * np.pi / 5)
    holds("area", change(m.scalars["area_pial_mm2"], 5 * 3**0.5 * side**2), at_most=1e-12)
    holds("gyrification index", change(m.scalars["gyrification_index"], 1), at_most=1e-12)
    local = m.scalars["mean_local_gyrification_index"]
    holds("local gyrification, of a convex body", change(local, 1), at_most=0.05)
    holds("depth", m.scalars["mean_sulcal_depth_mm"], at_most=1e-9, unit="mm")
    holds("H at the corners, on a sphere", np.abs(m.maps["H"] * 50 - 1).max(), at_most=1e-9)
    holds.equal("hinges", m.scalars["n_hinges"], 0)
    analyze(holds, tmp_path, capsys, m.cortex, "12 vertices", "gyral thickness n/a")


def defects_of_fit(verts, faces):
    """K is that of the fit, where there is none nothing."""
    return np.nan_to_num(curvatures.curvature(verts, faces).K * vertex_areas(verts, faces))


@case(
    "4 vertices: no curvature can be fitted", "K of the indices is no fit", (folding, "angle_defects", defects_of_fit)
)
def test_the_tetrahedron_has_no_curvature_and_says_so(holds, tmp_path, capsys):
    verts, faces = np.array(REGULAR_SOLIDS["tetrahedron"]), np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]])
    m = measure(pair(25.0 * verts, 30.0 * verts, faces))
    holds.equal("vertices with H", int(np.isfinite(m.maps["H"]).sum()), 0)
    holds("intrinsic curvature index, of 1", change(m.scalars["intrinsic_curvature_index"], 1), at_most=1e-3)
    holds("gyrification index", change(m.scalars["gyrification_index"], 1), at_most=1e-12)
    phrases = ("4 vertices, GI 1.00", "gyral thickness n/a", f" {m.parameters['curvature_scale_mm']:.3g}, ")
    analyze(holds, tmp_path, capsys, m.cortex, *phrases, "[curvature_scale]")


FAR = 1e6


@case(
    "coordinates offset by 1e6 mm, in double precision",
    "rays are cast around the origin",
    (widths.RayCaster, "_scaled", lambda self, points: points.astype(np.float32)),
    peers="embree's rays are single precision (said)",
)
def test_a_surface_a_kilometre_away_has_the_same_measures(holds):
    """Round-off is 1e6 x 2^-52 = 2e-10 mm, and over the square of a scale of 10 mm in curvature."""
    hold_all(holds, measure(changed(CORTEX, lambda verts: verts + FAR)), bent=1e-8, lines=1e-6, width=1e-8)


@case(
    "coordinates offset by 1e6 mm and written as float32",
    "the note on rounding",
    (defects, "remarks", lambda cortex, mask, given=None: {}),
)
def test_coordinates_rounded_far_from_the_origin_are_told(holds, tmp_path, capsys):
    """float32 has steps of 1/16 mm there; those of the scanner, 100 mm away, are none to speak of."""
    rounded = lambda by: changed(CORTEX, lambda verts: (verts + by).astype(np.float32))
    far, near = rounded(FAR), rounded(100.0)
    holds.says("note", measure(far).notes.get("mesh", ""), " 0.062 (float32")
    analyze(holds, tmp_path, capsys, far, " lh.white ", " 0.062 (float32", "[mesh]")
    holds.equal("note, 100 mm away", measure(near).notes.get("mesh"), None)


def in_float16(self, made=Surface.__post_init__):
    """What is read has half the precision."""
    object.__setattr__(self, "verts", np.asarray(self.verts).astype(np.float16))
    made(self)


FLOAT64 = {"guard": "float64 from there on", "without": (Surface, "__post_init__", in_float16)}


@pytest.mark.parametrize(("size", "by"), [(1.0, 0.0), (1e-3, 0.0), (1e3, 0.0), (1.0, 1000.0)])
@case("float32 in files of FreeSurfer, in any unit and a metre away", **FLOAT64)
def test_single_precision_in_a_file_is_round_off_in_the_measures(holds, tmp_path, size, by):
    """2^-24 of 60 mm is 4e-6 mm; over the square of the scale that is 1e-6 of curvature, and ten times that in K.
    All of it 16 times as much a metre away."""
    files = {name: tmp_path / f"lh.{name}" for name in ("white", "pial")}
    for name, path in files.items():
        surface = getattr(CORTEX, name)
        write_surface(path, Surface(size * surface.verts + by, surface.faces))
    result, coarser = measure(read_cortex(**files)), 1 + by / 60
    holds.equal("read as", result.cortex.pial.verts.dtype, np.dtype(np.float64))
    bounds = {"area": 1e-7, "bent": 1e-5, "lines": 1e-4, "width": 1e-5}
    without = () if size == 1 else ("mean_local_gyrification_index",)
    hold_all(holds, result, unit=size, without=without, **{name: bound * coarser for name, bound in bounds.items()})


@pytest.mark.parametrize("kind", FORMATS)
@case("the same surface in every format", **FLOAT64)
def test_every_format_holds_the_surface_to_single_precision(holds, tmp_path, kind):
    surface = CORTEX.pial
    write_surface(tmp_path / kind, surface)
    copy = read_surface(tmp_path / kind)
    holds.equal(f"faces, {kind}", copy.faces.tolist(), surface.faces.tolist())
    holds(f"vertices, {kind}", np.abs(copy.verts - surface.verts).max(), at_most=64 * 2.0**-24, unit="mm")


@pytest.mark.parametrize("size", [1e-3, 1e3], ids=["metres", "micrometres"])
@case(
    "coordinates in metres or micrometres",
    "the scale follows the mesh",
    (curvatures, "LEAST_CURVATURE_SCALE_IN_EDGES", 0.0),
    peers="LaPy: curvature in units of the mean edge, not 1/mm (measured)",
)
def test_another_unit_changes_lengths_only_and_is_told(holds, tmp_path, capsys, size):
    whole = clean()[1]
    result = measure(changed(CORTEX, lambda verts: size * verts))
    hold_all(holds, result, unit=size, bent=1e-9, lines=1e-9, without=("mean_local_gyrification_index",))
    holds.equal("local gyrification, of a ball of 15 mm", result.scalars["mean_local_gyrification_index"], None)
    note = result.notes["curvature_scale"]
    holds.says("note", note, f" {result.parameters['curvature_scale_mm']:.3g}, ")
    radius = re.search(r" (\S+)\.$", note)[1]
    area = min(whole.scalars["area_white_mm2"], whole.scalars["area_pial_mm2"])
    holds("radius it names", change(float(radius), size * np.sqrt(area / (4 * np.pi))), at_most=5e-3)
    analyze(holds, tmp_path, capsys, result.cortex, f" {radius}.", "[curvature_scale]")


@pytest.mark.parametrize("value", [np.nan, np.inf])
@case(
    "coordinates that are no numbers",
    "the check of what is read",
    ("morphofold.validators.check_positions", lambda verts, name: None),
)
def test_coordinates_that_are_no_numbers_are_refused(holds, value):
    verts = CORTEX.white.verts.copy()
    verts[77, 1] = value
    try:
        message = refusal(pair(verts, CORTEX.pial.verts, CORTEX.faces))
    except ValueError as error:
        message = str(error)
    holds.says("refusal", message, "lh.white: ", " 1 of 2562 ", " 77:")
