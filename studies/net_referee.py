"""A referee for gyral nets: which method finds the hinges and crests that are there, and finds them again.

No field standard exists: no public set has surfaces with their hinges marked. So the cases are of two kinds. On spheres
with ridges along known nets the true hinges and crests are known. On a person's white surface they are not, but a
method should find the same net on another mesh of it, with a little noise, and turned in space.

- ``python -m morphofold.studies.net_referee write FOLDER`` writes the surfaces, as GIFTI, for a method in any language.
- It answers with two tables for each surface, ``FOLDER/METHOD/CASE.nodes.tsv`` (columns x, y, z in mm: the hinges) and
  ``CASE.arcs.tsv`` (columns node, other: rows of nodes, from 0, that a crest joins without a hinge between).
- ``python -m morphofold.studies.net_referee score FOLDER docs/net-referee.md`` scores the answers in the
  folder and the methods here, and writes the tables of the page. It takes two minutes.
"""

import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations
from pathlib import Path
from typing import Any

import networkx as nx
import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

from morphofold.analysis import curvature
from morphofold.analysis.curvatures import scale_of_curvature
from morphofold.analysis.graph.gyral_graph import gyral_graph
from morphofold.errors import OutOfRange
from morphofold.frozen_arrays import Array, Bools, Ints
from morphofold.geometry import edges, mean_edge_length
from morphofold.io import read_cortex, sample_path, write_surface
from morphofold.shapes.spherical_nets import irregular_net
from morphofold.studies.known_shapes import regular_net
from morphofold.studies.markdown import number, table, table_with_tsv, update_page
from morphofold.studies.ridged_nets import ridged_net
from morphofold.surface import Cortex, Surface
from morphofold.tables import read_table, write_table

RADIUS, HEIGHT, WIDTH = 50.0, 4.0, 6.0  # of the ridged spheres [mm]
TOLERANCE = WIDTH / 2  # largest distance between a hinge and the one that it stands for [mm]
#: how a ridged sphere differs from the clean one
VARIANTS: Mapping[str, Mapping[str, Any]] = {
    "clean": {"level": 6},
    "coarse mesh": {"level": 5},
    "noise of 0.1 edges": {"level": 6, "noise": 0.1},
    "noise of 0.3 edges": {"level": 6, "noise": 0.3},
    "ridges that dip by 0.3": {"level": 6, "dip": 0.3},
    "ridges that dip by 0.6": {"level": 6, "dip": 0.6},
    "turned": {"level": 6, "turned": True},
}
KNOWN_NETS = {
    "cube": regular_net("cube"),
    "octahedron": regular_net("octahedron"),
    "36 hinges": irregular_net(20, seed=5, shortest=0.12),
    "76 hinges": irregular_net(40, seed=5, shortest=0.12),
}
#: cases in the page; all are in the table beside it
SHOWN_CASES = (
    "octahedron, clean",
    "octahedron, noise of 0.1 edges",
    "octahedron, noise of 0.3 edges",
    "76 hinges, noise of 0.3 edges",
    "person, finer mesh",
)
PERSON, PERSON_NOISE = "S1", 0.05  # the sample; noise of its vertices [mean edges]
#: rows of nodes (K, 3) [mm], and pairs of their numbers (A, 2)
Net = tuple[Array, Ints]
Method = Callable[[Surface], Net]
#: F1 of nodes and of arcs, and the mean distance of right nodes [mm], by case
Scores = dict[str, tuple[float, float, float]]


@dataclass(frozen=True, eq=False)
class Case:
    """A surface, and the net that is in it: the true one, or None if it is the one that the method finds on ``base``.

    ``turn`` (3, 3) turned the base into the surface.
    """

    surface: Surface
    truth: Net | None = None
    base: Surface | None = None
    turn: Array | None = None


def cases() -> dict[str, Case]:
    """All cases by their names, those with a known net first."""
    turn = _random_rotation(0)
    known_cases = {}
    for net_name, net in KNOWN_NETS.items():
        for variant_name, options in VARIANTS.items():
            placed = net.rotated(turn) if options.get("turned") else net
            ridges = {key: value for key, value in options.items() if key != "turned"}
            surface = ridged_net(placed, width=WIDTH, height=HEIGHT, radius=RADIUS, rng=0, **ridges)
            known_cases[f"{net_name}, {variant_name}"] = Case(surface, ((RADIUS + HEIGHT) * placed.nodes, placed.arcs))
    white = read_cortex(sample_path(PERSON)).white
    noise = PERSON_NOISE * mean_edge_length(white.verts, white.faces)
    moved_verts = white.verts + noise * np.random.default_rng(0).standard_normal(white.verts.shape)
    people_cases = {
        "person, noise": Case(Surface(moved_verts, white.faces), base=white),
        "person, finer mesh": Case(subdivided(white), base=white),
        "person, turned": Case(Surface(white.verts @ turn.T, white.faces), base=white, turn=turn),
    }
    return known_cases | people_cases


def _random_rotation(seed: int) -> Array:
    q, r = np.linalg.qr(np.random.default_rng(seed).standard_normal((3, 3)))
    q = q * np.sign(np.diag(r))
    return q * np.sign(np.linalg.det(q))


def subdivided(surface: Surface) -> Surface:
    """Each triangle split into four at the middles of its edges: the same surface on another mesh."""
    edge_ends, n = edges(surface.faces), len(surface.verts)
    edge_number = {pair: n + k for k, pair in enumerate(map(tuple, edge_ends.tolist()))}
    sides = np.sort(np.stack([surface.faces, np.roll(surface.faces, -1, axis=1)], axis=-1), axis=-1)
    a, b, c = np.array([[edge_number[i, j] for i, j in face] for face in sides.tolist()]).T
    i, j, k = surface.faces.T
    faces = np.vstack([np.column_stack(corner) for corner in ((i, a, c), (j, b, a), (k, c, b), (a, b, c))])
    return Surface(np.vstack([surface.verts, surface.verts[edge_ends].mean(axis=1)]), faces)


# methods -----------------------------------------------------------------------------------------------------


def morphofold_net(surface: Surface) -> Net:
    """Hinges of any confidence, and the crests between them."""
    return _net_of(gyral_graph(surface))


def _net_of(graph: nx.MultiGraph) -> Net:
    hinges = [node for node, degree in graph.nodes(data="degree") if degree > 2]
    number_of = {node: k for k, node in enumerate(hinges)}
    arcs = [(number_of[i], number_of[j]) for i, j in graph.edges() if i in number_of and j in number_of]
    positions = [graph.nodes[node]["position"] for node in hinges]
    return np.array(positions).reshape(-1, 3), np.array(arcs, dtype=np.int64).reshape(-1, 2)


def morphofold_without_lengths(surface: Surface) -> Net:
    """The same, with nothing too small to count: no basins joined, no hinges merged, no spurs removed."""
    scales = gyral_graph(surface).graph["scales"]
    return _net_of(gyral_graph(surface, scales=replace(scales, persistence=1e-3, merge=1e-3, prune=1e-3)))


def plain_watershed(surface: Surface) -> Net:
    """Borders of the basins of mean curvature, none joined: hinges are triangles with corners in three basins, and a
    crest joins two of them that have two basins in common."""
    scale, _ = scale_of_curvature(Cortex(surface, surface), None)
    H = curvature(surface.verts, surface.faces, scale).H
    lowest = np.arange(len(H))  # the lowest neighbour of each vertex, or itself
    both_ways = np.vstack([(pairs := edges(surface.faces)), pairs[:, ::-1]])
    order = np.lexsort((H[both_ways[:, 1]], both_ways[:, 0]))
    firsts = both_ways[order][np.unique(both_ways[order][:, 0], return_index=True)[1]]
    lowest[firsts[:, 0]] = np.where(H[firsts[:, 1]] < H[firsts[:, 0]], firsts[:, 1], firsts[:, 0])
    while np.any(lowest != lowest[lowest]):
        lowest = lowest[lowest]
    basins = np.sort(lowest[surface.faces], axis=1)
    triple = np.flatnonzero((np.diff(basins, axis=1) > 0).all(axis=1))
    nodes_of_pair: dict[tuple[int, int], list[int]] = {}
    for node, three_basins in enumerate(basins[triple].tolist()):
        for pair in combinations(three_basins, 2):
            nodes_of_pair.setdefault(pair, []).append(node)
    arcs = [nodes for nodes in nodes_of_pair.values() if len(nodes) == 2]
    return surface.verts[surface.faces[triple]].mean(axis=1), np.array(arcs, dtype=np.int64).reshape(-1, 2)


def scattered(surface: Surface, n_nodes: int = 50) -> Net:
    """Vertices at random, each joined to its three nearest: what chance finds."""
    nodes = np.random.default_rng(0).choice(surface.verts, n_nodes, replace=False)
    nearest = np.argsort(cdist(nodes, nodes), axis=1)[:, 1:4]
    pairs = np.column_stack([np.repeat(np.arange(n_nodes), 3), nearest.ravel()])
    return nodes, np.unique(np.sort(pairs, axis=1), axis=0)


METHODS: Mapping[str, Method] = {
    "morphofold": morphofold_net,
    "morphofold, no length too small": morphofold_without_lengths,
    "watershed of mean curvature, no basins joined": plain_watershed,
    "50 places at random": scattered,
}

# scores ------------------------------------------------------------------------------------------------------


def score(net: Net, truth: Net) -> tuple[float, float, float]:
    """F1 scores, 0 to 1, of the nodes and of the arcs of a net, and the mean distance of the right nodes [mm].

    Nodes are paired one to one, at the least total distance, within ``TOLERANCE``. An arc is right if its nodes are
    right and an arc of the truth joins theirs, each of the truth once. F1 is twice the right ones over those of both.
    """
    (nodes, arcs), (true_nodes, true_arcs) = net, truth
    if not (len(nodes) and len(true_nodes)):
        return 0.0, 0.0, np.nan
    distance = cdist(nodes, true_nodes)
    found, true = linear_sum_assignment(np.minimum(distance, 10 * TOLERANCE))
    is_right: Bools = distance[found, true] <= TOLERANCE
    stands_for = np.full(len(nodes), -1)
    stands_for[found[is_right]] = true[is_right]
    unused_arcs = [tuple(sorted(arc)) for arc in true_arcs.tolist()]
    n_right_arcs = 0
    for arc in stands_for[arcs].tolist():
        if (pair := tuple(sorted(arc))) in unused_arcs:
            unused_arcs.remove(pair)
            n_right_arcs += 1
    node_f1 = 2 * int(is_right.sum()) / (len(nodes) + len(true_nodes))
    arc_f1 = 2 * n_right_arcs / max(len(arcs) + len(true_arcs), 1)
    offsets = distance[found, true][is_right]
    return node_f1, arc_f1, float(offsets.mean()) if len(offsets) else np.nan


def scores(answer: Callable[[str, Surface], Net], all_cases: Mapping[str, Case]) -> Scores:
    """The scores of a method on each case; ``answer`` gives its net of a case's name and surface, and that of the
    unchanged person for the name ``"person"``."""
    rows, base_net = {}, None
    for name, case in all_cases.items():
        if (truth := case.truth) is None:
            base_net = base_net or answer("person", case.base or case.surface)
            truth = base_net if case.turn is None else (base_net[0] @ case.turn.T, base_net[1])
        rows[name] = score(answer(name, case.surface), truth)
    return rows


def summary(rows: Scores) -> list[float]:
    """Score, and its parts [%]: hinges and crests on known nets, and those found again on the person; and the mean
    distance of right hinges from the true ones [mm].

    The score is the harmonic mean of the known nets and the person, so to find again what is not there is worth little.
    """
    is_person = np.array([name.startswith("person") for name in rows])
    values = np.array(list(rows.values()))
    parts = [100 * values[is_part, column].mean() for is_part in (~is_person, is_person) for column in (0, 1)]
    known_offsets = values[~is_person, 2]
    is_known = np.isfinite(known_offsets)
    known, again = np.mean(parts[:2]), np.mean(parts[2:])
    total = 2 * known * again / max(known + again, 1e-9)
    return [float(total), *parts, float(known_offsets[is_known].mean()) if is_known.any() else np.nan]


# files -------------------------------------------------------------------------------------------------------


def write_surfaces(folder: Path) -> None:
    """Write the surface of each case, and the unchanged person, as ``CASE.surf.gii``."""
    all_cases = cases()
    surfaces = {name: case.surface for name, case in all_cases.items()}
    surfaces["person"] = next(case.base for case in all_cases.values() if case.base is not None)
    folder.mkdir(parents=True, exist_ok=True)
    for name, surface in surfaces.items():
        write_surface(folder / f"{file_name(name)}.surf.gii", surface)


def file_name(case_name: str) -> str:
    """The name of a case in files."""
    return case_name.replace(", ", "-").replace(" ", "-")


def read_answer(folder: Path, case_name: str, _: Surface) -> Net:
    """The net that a method found, from its two tables."""
    nodes = read_table(folder / f"{file_name(case_name)}.nodes.tsv")
    arcs = read_table(folder / f"{file_name(case_name)}.arcs.tsv")
    positions = np.array([[row["x"], row["y"], row["z"]] for row in nodes], dtype=np.float64).reshape(-1, 3)
    pairs = np.array([[row["node"], row["other"]] for row in arcs], dtype=np.int64).reshape(-1, 2)
    if pairs.size and not (0 <= pairs.min() and pairs.max() < len(positions)):
        raise OutOfRange(
            f"{folder}, {case_name}: rows of nodes are 0 to {len(positions) - 1}. Were they counted from 1?"
        )
    return positions, pairs


def write_answer(folder: Path, case_name: str, net: Net) -> None:
    """Write a net as :func:`read_answer` reads it."""
    folder.mkdir(parents=True, exist_ok=True)
    node_rows = [dict(zip("xyz", node)) for node in net[0].tolist()]
    write_table(folder / f"{file_name(case_name)}.nodes.tsv", "xyz", node_rows)
    arc_rows = [{"node": i, "other": j} for i, j in net[1].tolist()]
    write_table(folder / f"{file_name(case_name)}.arcs.tsv", ("node", "other"), arc_rows)


def write_page(folder: Path, page: Path) -> None:
    """Score the methods here and those with answers in a folder, and write the tables of the page."""
    all_cases = cases()
    answers = {name: lambda _, surface, method=method: method(surface) for name, method in METHODS.items()}
    answers |= {each.name: partial(read_answer, each) for each in sorted(folder.glob("*/")) if each.is_dir()}
    rows_of = {name: scores(answer, all_cases) for name, answer in answers.items()}
    summaries = {name: summary(rows) for name, rows in rows_of.items()}
    heads = "method | score | hinges, known | crests, known | hinges again | crests again | off by [mm]"
    ranking = sorted(summaries, key=lambda name: -summaries[name][0])
    formats = ("**{:.0f}**", *["{:.0f}"] * 4, "{:.2f}")
    summary_rows = [[name, *map(number, summaries[name], formats)] for name in ranking]
    case_rows = [
        [case, *(f"{100 * rows_of[name][case][0]:.0f}, {100 * rows_of[name][case][1]:.0f}" for name in ranking)]
        for case in all_cases
    ]
    cases_table = table_with_tsv(page, "cases", ["case", *ranking], case_rows, lambda row: row[0] in SHOWN_CASES)
    update_page(page, {"scores": [table(heads, summary_rows)], "cases": [cases_table]})


if __name__ == "__main__":
    command, *paths = sys.argv[1:]
    write_surfaces(Path(paths[0])) if command == "write" else write_page(Path(paths[0]), Path(paths[1]))
