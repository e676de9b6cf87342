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
#: errors are told of spheres between these: what was held against finer meshes (docs/accuracy.md, docs/folds.md), and
#: a third of that thickness (T/C of fig6-thick), the paper's thinnest
STUDIED = {"growth": (1.5, 2.0), "mu_ratio": (1.0, 4.0), "kappa_ratio": (12.5, 200.0), "thickness": (0.02, 0.1)}


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

    ``coefficient * edge_over_T ** power``, with a factor exp(+-spread) of scatter. Of which scenes: ``not_studied``.
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


def not_studied(scene: Scene, edge_over_T: float) -> tuple[str, ...]:
    """What of a scene lies outside of ``STUDIED``, so that no errors are told of it; empty if the table holds for it.

    ``"shape"`` (no sphere of even thickness), ``"law"`` (not isotropic), ``"material"``, ``"effects"`` (one that
    no study of errors had), ``"edge"``, and the names of ``STUDIED``.
    """
    geometry, (finest, coarsest) = scene.geometry, studied()
    found = {
        "shape": geometry.shape != "sphere" or bool(getattr(geometry, "thickness_spots", ())),
        "law": scene.growth.law != "isotropic",
        "material": not scene.material.errors_known,
        "effects": not all(options.errors_known for options in scene.effects.values()),
        "edge": not (1 - ROUNDED) * finest <= edge_over_T <= (1 + ROUNDED) * coarsest,
    }
    values = {"growth": scene.growth.final, "mu_ratio": scene.material.mu_ratio,
              "kappa_ratio": scene.material.kappa_ratio}  # fmt: skip
    if geometry.shape == "sphere":
        values["thickness"] = geometry.cortex_thickness / geometry.radius
    for name, value in values.items():
        least, most = STUDIED[name]
        found[name] = not least * (1 - 1e-9) <= value <= most * (1 + 1e-9)
    return tuple(name for name, outside in found.items() if outside)


def doubts(scene: Scene, edge_over_T: float) -> list[str]:
    """How a scene of which errors are told differs from the one of the table: one sentence each."""
    from morphofold.sim.scene import elements_through

    if not_studied(scene, edge_over_T):
        return []
    growth, last, said = table()["errors"]["growth"], scene.growth.final, []
    if abs(last - growth) > 0.05:
        said.append(f"The errors of folds are those at g = {growth:g}, not at {last:g}, where this scene ends.")
    layers = scene.elements_through_cortex, elements_through(scene.edge / scene.thinnest)
    if layers[0] != layers[1]:
        said.append(f"The errors are those of {layers[1]} elements through the cortex, here are {layers[0]}.")
    return said
