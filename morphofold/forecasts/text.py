"""What forecasts and costs call accuracies and quantities."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from morphofold.sim.scene import Scene


def unstudied(names: Iterable[str]) -> str:
    """Why no errors are told of a scene, from what ``table.not_studied`` names."""
    return f"not studied for this {', '.join(name.replace('_', ' ') for name in names)}"


def called(quantity: str) -> str:
    """A quantity as tables of errors call it: errors are relative, but for a distance, which is over the thickness."""
    return "pial distance, over T" if quantity == "pial distance" else quantity


def setting_words(scene: Scene, edge: float) -> str:
    """The accuracy of a scene: its level, or where its edge [mm] lies among the levels."""
    from morphofold.sim.scene import LEVELS

    if scene.geometry.shape in ("mesh", "radial"):
        return "the mesh of the file" if scene.geometry.shape == "mesh" else "one dimension"
    if scene.accuracy.edge is None:
        return scene.accuracy.level
    return between_levels(edge / scene.thinnest, LEVELS)


def between_levels(edge_over_T: float, levels: Mapping[str, float]) -> str:
    """Among ``levels``, from the coarsest to the finest, where an edge over the thickness lies."""
    coarser = [name for name, edge in levels.items() if edge >= edge_over_T]
    finer = [name for name, edge in levels.items() if edge <= edge_over_T]
    if not coarser:
        return f"coarser than {finer[0]}"
    if not finer:
        return f"finer than {coarser[-1]}"
    return f"between {coarser[-1]} and {finer[0]}" if coarser[-1] != finer[0] else finer[0]
