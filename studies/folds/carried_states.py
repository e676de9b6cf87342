"""The bias of a mesh at equal folds: a state of one mesh is carried to another mesh of the same body, and held there.

Two meshes fold into two patterns, and their gyrification indices differ by both the pattern and the mesh. A state that
is carried keeps its pattern: what is left is the mesh.

    python -m morphofold.studies.folds.carried_states [SEED ...]
"""

import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.interpolate import RectBivariateSpline

from morphofold.analysis import gyrification_index
from morphofold.frozen_arrays import Array, Ints
from morphofold.sim.body import Body
from morphofold.sim.build import build_body
from morphofold.sim.dynamics import REST_DAMPING_PER_CROSSING, Dynamics, State
from morphofold.sim.effects import build_effects
from morphofold.sim.mesh.brick_mesh import SYMMETRY_AXES, cube_surface
from morphofold.sim.output.stage_surfaces import whole_surfaces
from morphofold.sim.scene import Scene
from morphofold.sim.scene.scene_files import load_scene
from morphofold.studies.markdown import table

PORTION = "octant"
REST_TICKS = 24  # times that a wave crosses the cortex, for which a carried state is held
COARSER_EDGE, STANDARD_EDGE, FINE_EDGE = 0.60, 0.45, 0.27  # of the surface cells, in T
FINER_EDGES = (0.36, FINE_EDGE, 0.18)
GROWTHS = (1.5, 2.0)


@dataclass
class MeshedOctant:
    """An octant of a sphere on one mesh.

    Attributes
    ----------
    scene, body : Scene, Body
    cells : int
        Cells along the edge of a face of the octant.
    faces : list of three (cells + 1, cells + 1) int
        Pial nodes of each face of the cube, as a grid.
    """

    scene: Scene
    body: Body
    cells: int
    faces: list[Ints]

    @property
    def edge_over_T(self) -> float:
        """Longest edge of the pial surface before growth, in thicknesses of the cortex."""
        return self.body.bilayer.edge / self.body.thickness

    @property
    def radii(self) -> Array:
        """Mean distance (L,) of the layers of nodes from the centre, before growth [mm]."""
        return np.linalg.norm(self.layers(self.body.bilayer.mesh.p.T), axis=2).mean(axis=1)

    def layers(self, nodal_values: Array) -> Array:
        """Values (N, 3) by layer and pial node, (L, S, 3)."""
        return nodal_values.reshape(-1, self.body.n_surface, 3)


def meshed_octant(name: str, edge_over_T: float, seed: int, settings: Sequence[str] = ()) -> MeshedOctant:
    """The octant of a built-in scene of a sphere with surface cells of ``edge_over_T``, three bricks through its
    cortex."""
    thickness = load_scene(name).geometry.cortex_thickness
    words = [f"geometry.portion={PORTION}", f"accuracy.edge={edge_over_T * thickness}"]
    words += ["accuracy.elements_through_cortex=3", f"effects.perturbation.seed={seed}", *settings]
    scene = load_scene(name, words)
    body, cells = build_body(scene, build_effects(scene)), scene.cells // 2
    lattice = cube_surface(scene.cells, SYMMETRY_AXES[PORTION])[0]
    node_at = np.full((cells + 1,) * 3, -1)
    node_at[tuple(lattice.T)] = np.arange(len(lattice))
    faces = [np.take(node_at, cells, axis=axis) for axis in range(3)]
    return MeshedOctant(scene, body, cells, faces)


def carried(source: MeshedOctant, target: MeshedOctant, nodal_values: Array) -> Array:
    """Values (N, 3) of the nodes of one mesh at those of another, (M, 3): cubic splines over the angles of each face of
    the cube, linear between layers."""
    values, places = source.layers(nodal_values), np.linspace(0, 1, source.cells + 1)
    on_layers = np.empty((len(values), target.body.n_surface, 3))
    target_places = np.linspace(0, 1, target.cells + 1)
    for source_face, target_face in zip(source.faces, target.faces):
        for layer, column in np.ndindex(len(values), 3):
            spline = RectBivariateSpline(places, places, values[layer, source_face, column])
            on_layers[layer, target_face, column] = spline(target_places, target_places)
    order, radii = np.argsort(source.radii), source.radii
    upper = np.clip(np.searchsorted(radii[order], target.radii), 1, len(radii) - 1)
    low, high = order[upper - 1], order[upper]
    share = np.clip((target.radii - radii[low]) / (radii[high] - radii[low]), 0, 1)[:, None, None]
    return np.asarray((1 - share) * on_layers[low] + share * on_layers[high]).reshape(-1, 3)


def rested(source: MeshedOctant, target: MeshedOctant, x: Array, growth: float) -> float:
    """Gyrification index of a state x (N, 3) of one mesh after it was carried to another and held for REST_TICKS."""
    body = target.body
    positions = body.X + carried(source, target, x - source.body.X)
    positions[body.bilayer.held] = body.X[body.bilayer.held]
    for plane in body.bilayer.planes:
        positions[body.on_plane[:, plane.axis], plane.axis] = plane.at
    effects = build_effects(target.scene)
    dynamics = Dynamics.of(target.scene, body, effects, State(positions, np.zeros_like(positions), growth=growth))
    dynamics.damping = min(dynamics.damping, REST_DAMPING_PER_CROSSING / body.crossing)
    dynamics.relax(round(REST_TICKS * body.crossing))
    return gyrification(body, dynamics.state.x)


def gyrification(body: Body, x: Array) -> float:
    """Gyrification index of the whole pial surface at positions x (N, 3)."""
    pial = whole_surfaces(body, x)[1]
    return gyrification_index(pial.verts, pial.faces)


def carried_indices(
    name: str, edge: float, other_edges: Sequence[float], seed: int, growths: Sequence[float] = GROWTHS
) -> Iterator[dict[Any, Any]]:
    """Gyrification indices of a run with surface cells of ``edge`` [T], and of its states on other meshes.

    A row for each growth: ``scene``, ``seed`` and ``g``; ``run``, that of the run itself; and by edge over T those of
    the states that were carried, its own mesh included, since to be held changes it, too.
    """
    own = meshed_octant(name, edge, seed)
    others = [meshed_octant(name, other_edge, seed) for other_edge in other_edges]  # also of its own mesh: a new body
    dynamics = Dynamics.of(own.scene, own.body, build_effects(own.scene))
    for growth in growths:
        dynamics.grow_to(growth)
        dynamics.settle()
        x = dynamics.state.x.copy()
        indices = {other.edge_over_T: rested(own, other, x, growth) for other in others}
        yield {"scene": name, "seed": seed, "g": growth, "run": gyrification(own.body, x), **indices}


def limit_of_first_order(indices: Mapping[float, float]) -> float:
    """Value at an edge of 0 by the two coarsest of values by edge: the two that a standard run can afford."""
    (coarse, at_coarse), (fine, at_fine) = sorted(indices.items(), reverse=True)[:2]
    return at_fine + (at_fine - at_coarse) * fine / (coarse - fine)


def rows_of_page(runs: Iterator[dict[Any, Any]]) -> Iterator[list[str]]:
    """Cells of a table: scene, seed, growth, the run, each mesh, the limit, and how far the run is below it."""
    for row in runs:
        indices = {key: value for key, value in row.items() if isinstance(key, float)}
        limit = limit_of_first_order(indices)
        about = [f"{row['scene']}", f"{row['seed']}", f"{row['g']:.1f}", f"{row['run']:.3f}"]
        edges = [f"{edge:.2f} T: {value:.3f}" for edge, value in sorted(indices.items(), reverse=True)]
        yield [*about, ", ".join(edges), f"{limit:.3f}", f"{100 * (row['run'] / limit - 1):+.1f} %".replace("-", "−")]


COLUMNS = ["scene", "seed", "g", "run", "carried, by edge", "limit", "run against it"]


def main(seeds: Sequence[int]) -> None:
    """Print two tables: standard runs of two scenes, carried to a coarser mesh; and one fine run on five meshes."""
    standard_runs = (
        row
        for name in ("fig6-thick", "fig5")
        for seed in seeds
        for row in carried_indices(name, STANDARD_EDGE, (COARSER_EDGE, STANDARD_EDGE), seed)
    )
    print(table(COLUMNS, list(rows_of_page(standard_runs))))
    fine_run = carried_indices("fig6-thick", FINE_EDGE, (COARSER_EDGE, STANDARD_EDGE, *FINER_EDGES), seeds[0])
    print(table(COLUMNS, list(rows_of_page(fine_run))))


if __name__ == "__main__":
    main([*map(int, sys.argv[1:])] or [0])
