"""What accuracy costs on a hemisphere: the same body on several meshes, with the errors against the finest."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from morphofold.analysis import gyrification_index
from morphofold.analysis.relief import relief
from morphofold.analysis.thickness.gyral_thickness import gyral_thickness
from morphofold.geometry import equal_area_radius, unit
from morphofold.shapes import even_directions
from morphofold.sim.run import Simulation
from morphofold.studies.person import BODY_SETTINGS
from morphofold.studies.runs import Runs
from morphofold.studies.surface_distance import distance

SCENE = "hemisphere"
N_POINTS = 10_000  # on the sphere, where heights of two bodies are compared
FOLD_SCALE_OVER_RADIUS = 0.2  # of the relief


def rows(levels: Sequence[str], thicknesses: Sequence[float], growth: float, runs: Runs) -> list[dict[str, Any]]:
    """Cost, folds, and differences from the last level, for each thickness [mm] of the cortex; levels from coarse to
    fine."""
    mesh_rows = []
    for T in thicknesses:
        settings = (f"geometry.cortex_thickness={T}", *BODY_SETTINGS, f"growth.final={growth}", "output.stages=[]")
        simulations = [runs.grow(f"T{T:g}-{level}", SCENE, [*settings, f"accuracy.level={level}"]) for level in levels]
        mesh_rows += [
            {"thickness_mm": T, "level": level, **_numbers(simulation, simulations[-1])}
            for level, simulation in zip(levels, simulations)
        ]
    return mesh_rows


def _numbers(run: Simulation, finest_run: Simulation) -> dict[str, Any]:
    health, cortex, finest_cortex = run.health, run.cortex(), finest_run.cortex()
    return {
        "bricks": health["elements"],
        "steps": health["steps"],
        "seconds": health["seconds"],
        "threads": health["threads"],
        "healthy": health["healthy"],
        "gyrification_index": gyrification_index(cortex.pial.verts, cortex.faces),
        "gyral_width_mm": gyral_thickness(cortex).median,
        "distance_over_T": distance(cortex.pial, finest_cortex.pial) / run.scene.geometry.cortex_thickness,
        "height_correlation": height_correlation(cortex, finest_cortex),
    }


def height_correlation(first_cortex: Any, second_cortex: Any) -> float:
    """Correlation of the heights of folds of two bodies with one sphere, over even places of the cortex."""
    points, heights, is_cortex = even_directions(N_POINTS), [], np.ones(N_POINTS, dtype=bool)
    for cortex in (first_cortex, second_cortex):
        verts = np.asarray(cortex.pial.verts)
        height = relief(verts, cortex.faces, FOLD_SCALE_OVER_RADIUS * equal_area_radius(verts, cortex.faces)).height
        nearest_vertex = cKDTree(unit(cortex.sphere.verts)).query(points)[1]
        heights.append(height[nearest_vertex])
        is_cortex &= True if cortex.cortex is None else cortex.cortex[nearest_vertex]
    return float(np.corrcoef(heights[0][is_cortex], heights[1][is_cortex])[0, 1])
