"""The bias of a mesh at equal folds: a state of one mesh is carried to other meshes of the same body, and held there.

Two meshes fold into two patterns, and their gyrification indices differ by both the pattern and the mesh. A state that
is carried keeps its pattern: what is left is the mesh.

    python -m morphofold.studies.folds.carried_states [SEED ...]
"""

import sys
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from morphofold.forecasts.richardson import HOLD_TICKS, StageEstimate, coarser, gyrification_of, stage_estimate
from morphofold.sim.build import build_body
from morphofold.sim.dynamics import Dynamics, State
from morphofold.sim.effects import build_effects
from morphofold.sim.nested_meshes import NestedDynamics, carry
from morphofold.sim.scene import LEVELS, Scene
from morphofold.sim.scene.scene_files import load_scene
from morphofold.studies.markdown import table

SCENES = ("fig6-thick", "fig5")
GROWTHS = (1.5, 2.0)
#: edges of the meshes to which a state of the finest run is carried, in T
EDGES_OF_LIMIT = (LEVELS["standard"], 0.36, LEVELS["finest"])


def octant(name: str, seed: int, *settings: str) -> Scene:
    """The octant of a built-in scene of a sphere, with its last stage at the last of ``GROWTHS``."""
    return load_scene(name, ["geometry.portion=octant", f"effects.perturbation.seed={seed}", *settings])


def meshed(scene: Scene) -> Dynamics:
    """The dynamics of a scene on one mesh, ungrown."""
    effects = build_effects(scene)
    return Dynamics.of(scene, build_body(scene, effects), effects)


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


def corrected_stages(scene: Scene, growths: Sequence[float] = GROWTHS) -> Iterator[StageEstimate]:
    """The estimate of ``--estimate`` at some stages of a scene."""
    coarse = meshed(coarser(scene))
    for growth, run in grown(scene):
        if growth in growths:
            state = State(run.state.x.copy(), np.zeros_like(run.state.x), growth=growth)
            yield stage_estimate(run.body, state, coarse)


def rows_of_page(name: str, seed: int) -> Iterator[list[Any]]:
    """Cells: scene, seed, growth, the finest run by mesh, its limit; index of each level, corrected, against it."""
    others = [meshed(octant(name, seed, f"accuracy.edge={edge * thickness(name)}")) for edge in EDGES_OF_LIMIT]
    by_mesh = {g: indices_by_mesh(run, others) for g, run in grown(octant(name, seed, "accuracy.level=finest"))}
    for level in ("standard", "fine"):
        for stage in corrected_stages(octant(name, seed, f"accuracy.level={level}")):
            indices = by_mesh[stage.growth]
            limit = limit_of_line(indices)
            against = [f"{value:.3f} ({100 * (value / limit - 1):+.1f} %)" for value in (stage.index, stage.corrected)]
            meshes_text = ", ".join(f"{edge:.2f} T: {value:.3f}" for edge, value in indices.items())
            yield [name, seed, f"{stage.growth:g}", meshes_text, f"{limit:.3f}", level, *against]


def thickness(name: str) -> float:
    """Thickness of the cortex of a built-in scene [mm]."""
    return float(load_scene(name).geometry.cortex_thickness)


COLUMNS = ["scene", "seed", "g", "finest run, carried", "limit", "run", "its index", "corrected"]


def main(seeds: Sequence[int]) -> None:
    """Print the table of docs/folds.md."""
    rows = [row for name in SCENES for seed in seeds for row in rows_of_page(name, seed)]
    print(table(COLUMNS, [[str(cell).replace("-", "−") if "%" in str(cell) else cell for cell in row] for row in rows]))


if __name__ == "__main__":
    main([*map(int, sys.argv[1:])] or [5, 6, 7])
