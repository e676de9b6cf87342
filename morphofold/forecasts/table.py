"""The stored table: what runs cost beyond their ideal, and how wrong their results were, by edge."""

from __future__ import annotations

import functools
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from morphofold.sim.scene import Scene

#: the error of a run is the larger one of these: its numbers of folding that converge last
HEADLINE = ("gyrification index", "wavelength")
ROUNDED = 0.05          # share of an edge within which two of them are alike: cells are whole and even


@dataclass(frozen=True)
class Expected:
    """A relative error expected of the mesh, and the range in which two of three runs are; 0.01 is 1 %. ``other``: what
    other settings of the solver change beside it, which no edge makes smaller."""

    error: float
    low: float
    high: float
    other: float


@functools.cache
def table() -> dict[str, Any]:
    """Contents of ``table.json``: ``costs`` and ``errors``."""
    return json.loads((resources.files("morphofold.forecasts") / "table.json").read_text("utf-8"))


def costs() -> Mapping[str, Any]:
    """What runs cost: constants of forecasts of time and memory, each with what it means."""
    return table()["costs"]


def expected_errors(edge_over_T: float) -> dict[str, Expected]:
    """Expected relative error of each quantity with surface edges of ``edge_over_T`` thicknesses.

    ``coefficient * edge_over_T ** power``, with a factor exp(+-spread) of scatter. Beyond the edges that were studied
    the same power goes on; ``doubts`` says so.
    """
    found = {}
    for name, law in table()["errors"]["quantities"].items():
        error, factor = law["coefficient"] * edge_over_T ** law["power"], math.exp(law["spread"])
        found[name] = Expected(error, error / factor, error * factor, law["other"])
    return found


def headline(edge_over_T: float) -> tuple[str, Expected]:
    """The larger one of the errors of ``HEADLINE``, and of what it is."""
    errors = expected_errors(edge_over_T)
    name = max(HEADLINE, key=lambda name: errors[name].error)
    return name, errors[name]


def studied() -> tuple[float, float]:
    """Finest and coarsest edge over thickness at which all of ``HEADLINE`` were studied."""
    laws = [table()["errors"]["quantities"][name] for name in HEADLINE]
    return max(law["finest"] for law in laws), min(law["coarsest"] for law in laws)


def doubts(scene: Scene, edge_over_T: float) -> list[str]:
    """Why the table may not hold for a scene: one sentence each, none if it is like what was studied."""
    from morphofold.sim.scene import elements_through

    errors, (finest, coarsest) = table()["errors"], studied()
    said = []
    if scene.geometry.shape not in ("sphere", "ellipsoid"):
        said.append(f"The errors are those of spheres ({errors['subject']}), not of a {scene.geometry.shape}.")
    if not (1 - ROUNDED) * finest <= edge_over_T <= (1 + ROUNDED) * coarsest:
        said.append(
            f"An edge of {edge_over_T:.2f} T is outside of the {finest:.2f} to {coarsest:.2f} T that were studied."
        )
    last = scene.stages[-1]
    if abs(last - errors["growth"]) > 0.05:
        said.append(
            f"The errors of folds are those at g = {errors['growth']:g}, not at {last:g}, where this scene ends; as "
            "long as it is smooth there are none."
        )
    layers = scene.elements_through_cortex, elements_through(scene.edge / scene.thinnest)
    if layers[0] != layers[1] and scene.geometry.shape != "mesh":
        said.append(f"The errors are those of {layers[1]} elements through the cortex, here are {layers[0]}.")
    return said
