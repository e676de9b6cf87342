"""The bias of a mesh at equal folds: a state of one mesh is carried to other meshes of the same body, and held there.

Two meshes fold into two patterns, and their gyrification indices differ by both the pattern and the mesh. A state that
is carried keeps its pattern: what is left is the mesh.

    python -m morphofold.studies.folds.carried_states docs/folds.md morphofold/forecasts/table.json 5 6 7

writes the table of the page and beside it, and the error of the gyrification index that forecasts expect: both agree.
"""

import json
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from morphofold.forecasts.richardson import HOLD_TICKS, ORDER, coarser, gyrification_of, meshed, stage_estimate
from morphofold.io.json_files import write_json
from morphofold.sim.dynamics import Dynamics, State
from morphofold.sim.effects import build_effects
from morphofold.sim.nested_meshes import NestedDynamics, carry
from morphofold.sim.scene import LEVELS, Scene
from morphofold.sim.scene.scene_files import load_scene
from morphofold.studies.markdown import table_with_tsv, update_page

SCENES = ("fig6-thick", "fig5")
GROWTHS = (1.5, 2.0)
#: edges of the meshes to which a state of the finest run is carried, in T
EDGES_OF_LIMIT = (LEVELS["standard"], 0.36, LEVELS["finest"])


def octant(name: str, seed: int, *settings: str) -> Scene:
    """The octant of a built-in scene of a sphere, with its last stage at the last of ``GROWTHS``."""
    return load_scene(name, ["geometry.portion=octant", f"effects.perturbation.seed={seed}", *settings])


def grown(scene: Scene) -> Iterator[tuple[float, Dynamics]]:
    """Each stage of a scene: its growth, and the dynamics that hold its state, nested or not."""
    run = meshed(scene) if scene.not_nested else NestedDynamics(scene, build_effects(scene))
    for growth in scene.stages:
        run.grow_to(growth, lambda state: None)
        run.settle(lambda state: None, lambda: None)
        yield growth, run if isinstance(run, Dynamics) else run.run


def indices_by_mesh(run: Dynamics, others: Sequence[Dynamics]) -> dict[float, float]:
    """Gyrification indices of the state of a run on other meshes, by their edge over T."""
    indices = {}
    for other in others:
        carry(run.body, run.state, other)
        other.hold(HOLD_TICKS)
        indices[other.body.bilayer.edge / other.body.thickness] = gyrification_of(other.body, other.state.x)
    return indices


def limit_of_line(indices: Mapping[float, float]) -> float:
    """Value at an edge of 0 of the line through indices by edge, by least squares."""
    edges, values = np.array([*indices]), np.array([*indices.values()])
    return float(np.polynomial.Polynomial.fit(edges, values, 1)(0.0))


def rows_of_page(name: str, seed: int) -> Iterator[list[Any]]:
    """Cells: scene, seed, growth, limit of the finest run; of each level its index and the corrected one, the latter
    against the limit of its own folds, these by mesh, and their limit."""
    others = [meshed(octant(name, seed, f"accuracy.edge={edge * thickness(name)}")) for edge in EDGES_OF_LIMIT]
    finest = grown(octant(name, seed, "accuracy.level=finest"))
    finest_limits = {g: limit_of_line(indices_by_mesh(run, others)) for g, run in finest if g in GROWTHS}
    for level in ("standard", "fine"):
        scene = octant(name, seed, f"accuracy.level={level}")
        own, coarse = meshed(scene), meshed(coarser(scene))
        for growth, run in grown(scene):
            if growth in GROWTHS:
                state = State(run.state.x.copy(), np.zeros_like(run.state.x), growth=growth)
                stage, indices = stage_estimate(state, own, coarse), indices_by_mesh(run, others)
                limit = limit_of_line(indices)
                by_edge = ", ".join(f"{edge:.2f} T: {index:.3f}" for edge, index in indices.items())
                against = [f"{gi:.3f} ({100 * (gi / limit - 1):+.1f} %)" for gi in (stage.index, stage.corrected)]
                limits = [f"{limit:.3f}", f"{finest_limits[growth]:.3f}"]
                yield [name, seed, f"{growth:g}", level, *against, by_edge, *limits]


def thickness(name: str) -> float:
    """Thickness of the cortex of a built-in scene [mm]."""
    return float(load_scene(name).geometry.cortex_thickness)


COLUMNS = ["scene", "seed", "g", "run", "its index", "corrected", "its folds by edge", "limit", "limit of finest run"]


def law_of_rows(rows: Sequence[Sequence[str]]) -> dict[str, Any]:
    """The error of the index by the edge over T, as forecasts read it, from the rows of the table: of first order, with
    the largest difference of a run from that as its spread."""
    edges, percents = [], []
    for *_, run, index, _, folds_by_edge, _, _ in rows:
        of_mesh = re.findall(r"([\d.]+) T: ", folds_by_edge)
        edges.append(float(of_mesh[0] if run == "standard" else of_mesh[-1]))
        percents.append(float(re.findall(r"\(−([\d.]+) %\)", index)[0]))
    logarithms = np.log(0.01 * np.array(percents)) - np.log(edges)
    return {
        "coefficient": float(np.exp(logarithms.mean())),
        "power": float(ORDER),
        "spread": float(np.abs(logarithms - logarithms.mean()).max()),
        "against": "limit of its folds",
    }


def main(page: Path, error_table: Path, seeds: Sequence[int]) -> None:
    """Grow the runs, and write their table into the page and beside it, and its law into the table of forecasts. The
    page has the last growth of the first seed."""
    rows = [row for name in SCENES for seed in seeds for row in rows_of_page(name, seed)]
    cells = [[cell.replace("-", "−") if "%" in cell else cell for cell in map(str, row)] for row in rows]
    shown = lambda cells_of_row: cells_of_row[1:3] == [f"{seeds[0]}", f"{GROWTHS[-1]:g}"]
    update_page(page, {"carried": [table_with_tsv(page, "carried", COLUMNS, cells, shown)]})
    content = json.loads(error_table.read_text("utf-8"))
    content["errors"]["quantities"]["gyrification index"] |= law_of_rows(cells)
    write_json(error_table, content)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), [*map(int, sys.argv[3:])])
