"""A ferret's brain: gyrification against area of published simulated stages, beside bodies grown from the first.

The surfaces are those of Choi and others (2025, eLife reviewed preprint 107141), Apache-2.0; this package has none of
them. Both axes are shares of the area of the convex hull of the first surface, so units cancel.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import ConvexHull

from morphofold.geometry import face_areas
from morphofold.io import read_surface
from morphofold.studies.person import BODY_SETTINGS
from morphofold.studies.runs import Runs
from morphofold.surface import Surface

SETTINGS = (
    "geometry.held=hole",
    *BODY_SETTINGS,
    "geometry.unfold=0.02",
    "geometry.cortex_thickness=4.0",
    "growth.final=2.0",
    "output.stages=[1.2, 1.4, 1.5, 1.6, 1.7, 1.8, 1.9]",
    "output.volume=false",
)
LEVELS = ("draft", "standard")


def published_rows(paths: Sequence[Path]) -> list[dict[str, Any]]:
    """Area over the hull of the first surface, and gyrification, of surfaces in the order of their growth."""
    pials = [read_surface(file) for file in paths]
    hull = _hull_area(pials[0])
    return [{"kind": "published", "level": None, "seed": None, "growth": None, **_ratios(pial, hull)} for pial in pials]


def grown_rows(subject: Path, seeds: Sequence[int], runs: Runs) -> list[dict[str, Any]]:
    """The same of stages that are grown from the first surface, on two meshes, with several imperfections."""
    rows, first_hull_area = [], _hull_area(read_surface(subject))
    for level in LEVELS:
        for seed in seeds:
            settings = (f"geometry.subject={subject}", f"accuracy.level={level}", f"effects.perturbation.seed={seed}")
            simulation = runs.grow(f"ferret-{level}-seed{seed}", "hemisphere", [*SETTINGS, *settings])
            for growth in simulation.stages:
                pial = simulation.cortex(growth).pial
                run_columns = {"kind": "grown", "level": level, "seed": seed, "growth": growth}
                rows.append({**run_columns, **_ratios(pial, first_hull_area * _scale(simulation) ** 2)})
    return rows


def _scale(simulation: Any) -> float:
    """Lengths of a run over those of the file: its body is scaled to the area of a sphere of the scene's radius."""
    from morphofold.sim.hemisphere.subject_maps import subject_of_cortex

    return subject_of_cortex(simulation.scene.geometry).unfolding.scale


def _ratios(surface: Surface, first_hull_area: float) -> dict[str, float]:
    area = float(face_areas(surface.verts, surface.faces).sum())
    return {"area_over_first_hull": area / first_hull_area, "gyrification_index": area / _hull_area(surface)}


def _hull_area(surface: Surface) -> float:
    return float(ConvexHull(np.asarray(surface.verts)).area)


def at_area(rows: Sequence[dict[str, Any]], target_area: float) -> list[float]:
    """Gyrification of each grown body where it has this area over the first hull, of those that reach it."""
    gyrifications = []
    for body_key in dict.fromkeys((row["level"], row["seed"]) for row in rows if row["kind"] == "grown"):
        body_rows = [row for row in rows if (row["level"], row["seed"]) == body_key]
        area, gi = (np.array([row[key] for row in body_rows]) for key in ("area_over_first_hull", "gyrification_index"))
        area_order = np.argsort(area)
        if area.min() <= target_area <= area.max():
            gyrifications.append(float(np.interp(target_area, area[area_order], gi[area_order])))
    return gyrifications
