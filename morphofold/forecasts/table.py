"""The stored table: costs of runs, errors of their results by edge, and errors of the measures of a surface, one
person's hemisphere."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from morphofold.sim.scene import Scene, Sphere, elements_through
from morphofold.surface import Cortex

GiB = 2**30
#: the error of a run is the larger one of these: the numbers of its folds that converge last
HEADLINE_QUANTITIES = ("gyrification index", "wavelength")
#: share of an edge within which two edges count as the same: numbers of cells are whole and even
SAME_EDGE_TOLERANCE = 0.05
#: errors are given for spheres in these ranges: those compared with finer meshes (docs/accuracy.md, docs/folds.md), and
#: a third of that thickness (T/C of fig6-thick), the paper's thinnest
STUDIED_RANGES = {"growth": (1.5, 2.0), "mu_ratio": (1.0, 4.0), "kappa_ratio": (12.5, 200.0), "thickness": (0.02, 0.1)}
SIMILAR_SIZE_RATIO = 1.5  # ratio of numbers of vertices beyond which a surface does not count as similar to the table's
#: what the study compared a measure with, in words
COMPARISON_LABELS = {
    "split surface": "the same surface with every triangle cut in four",
    "whole mesh": "the mesh before it was thinned",
    "smallest voxels": "the smallest voxels",
}
TABLE: dict[str, Any] = json.loads(Path(__file__).with_suffix(".json").read_text("utf-8"))
COSTS: Mapping[str, Any] = TABLE["costs"]  # constants for forecasts of time and memory, each with its meaning


@dataclass(frozen=True)
class Expected:
    """An expected relative error from the mesh, and the range of two of three runs; 0.01 is 1 %. ``other`` is the error
    from other settings of the solver, which a shorter edge does not reduce."""

    error: float
    low: float
    high: float
    other: float


@dataclass(frozen=True)
class Measured:
    """A relative error (0.01 is 1 %) of a measure, and what it was compared with, in words."""

    error: float
    against: str


class Errors(NamedTuple):
    """Expected errors of a run or an analysis.

    Attributes
    ----------
    errors : mapping
        Quantity to its ``Expected`` or ``Measured`` error; empty where none are known.
    how : str
        How they were obtained, or why there are none.
    doubts : tuple of str
        Why they may not hold, one sentence each.
    not_studied : tuple of str
        Properties of a run's scene that were not studied (:func:`not_studied`).
    """

    errors: Mapping[str, Any]
    how: str
    doubts: tuple[str, ...] = ()
    not_studied: tuple[str, ...] = ()


def expected_errors(edge_over_T: float) -> dict[str, Expected]:
    """Expected relative error of each quantity with surface edges of ``edge_over_T`` thicknesses.

    ``coefficient * edge_over_T ** power``, with a factor exp(+-spread) of scatter. For the scenes to which it does
    not apply see ``not_studied``.
    """
    errors = {}
    for name, law in TABLE["errors"]["quantities"].items():
        error, factor = law["coefficient"] * edge_over_T ** law["power"], math.exp(law["spread"])
        errors[name] = Expected(error, error / factor, error * factor, law["other"])
    return errors


def headline(errors: Mapping[str, Expected]) -> tuple[str, Expected]:
    """The quantity of ``HEADLINE_QUANTITIES`` with the larger expected error, and that error."""
    name = max(HEADLINE_QUANTITIES, key=lambda name: errors[name].error)
    return name, errors[name]


def studied() -> tuple[float, float]:
    """Finest and coarsest edge over thickness at which all of ``HEADLINE_QUANTITIES`` were studied."""
    laws = [TABLE["errors"]["quantities"][name] for name in HEADLINE_QUANTITIES]
    return max(law["finest"] for law in laws), min(law["coarsest"] for law in laws)


def not_studied(scene: Scene, edge_over_T: float) -> tuple[str, ...]:
    """Properties of a scene outside ``STUDIED_RANGES``, for which no errors are given; empty if the table holds for it.

    ``"shape"`` (not a sphere of even thickness), ``"law"`` (not isotropic), ``"material"``, ``"effects"`` (one that
    no study of errors had), ``"edge"``, and the names of ``STUDIED_RANGES``.
    """
    sphere = scene.geometry if isinstance(scene.geometry, Sphere) else None
    outside = {
        "shape": sphere is None or bool(sphere.thickness_spots or sphere.thickness_map),
        "law": scene.growth.law != "isotropic",
        "material": not scene.material.errors_known,
        "effects": not all(options.errors_known for options in scene.effects.values()),
        "edge": _is_outside(edge_over_T, studied(), SAME_EDGE_TOLERANCE),
    }
    values = {"growth": scene.growth.final}
    values |= {name: getattr(scene.material, name) for name in ("mu_ratio", "kappa_ratio")}
    if sphere:
        values["thickness"] = sphere.cortex_thickness / sphere.radius
    outside |= {name: _is_outside(value, STUDIED_RANGES[name], 1e-9) for name, value in values.items()}
    return tuple(name for name, is_outside in outside.items() if is_outside)


def _is_outside(value: float, ends: tuple[float, float], tolerance: float) -> bool:
    return not (1 - tolerance) * ends[0] <= value <= (1 + tolerance) * ends[1]


def called(quantity: str) -> str:
    """Name of a quantity in tables of errors: errors are relative, except a distance, which is over the thickness."""
    return "pial distance, over T" if quantity == "pial distance" else quantity


def errors_of_run(scene: Scene, edge_over_T: float | None) -> Errors:
    """Expected errors of a run, from its largest surface edge over the thickness; None if that is not known."""
    if edge_over_T is None:
        return Errors({}, "")
    if outside := not_studied(scene, edge_over_T):
        return Errors({}, f"not studied for this {', '.join(outside).replace('_', ' ')}", (), outside)
    law, last, doubts = TABLE["errors"], scene.growth.final, []
    if abs(last - law["growth"]) > 0.05:
        doubts.append(f"The errors of folds hold at g = {law['growth']:g}, not at {last:g}, where this scene ends.")
    layers, studied_layers = scene.elements_through_cortex, elements_through(scene.edge / scene.thinnest)
    if layers != studied_layers:
        doubts.append(f"The errors are those of {studied_layers} elements through the cortex; here there are {layers}.")
    how = f"before the run, from its edge and a table: {law['subject']}"
    return Errors(expected_errors(edge_over_T), how, tuple(doubts))


def measured_errors(cortices: Sequence[Cortex], accuracy: str) -> Errors:
    """Expected errors of an accuracy: those of the hemisphere in the table with the nearest number of vertices.

    Of several cortices the one with the fewest vertices decides; a doubt is given for each cortex that differs from the
    table's. Beyond the meshes of the table by more than ``SIMILAR_SIZE_RATIO`` no errors are known: a mesh of 42
    vertices has an error of 26 % in thickness, a mesh of 10,001 vertices one of 5 %.
    """
    sizes = sorted({cortex.n_vertices for cortex in cortices})
    persons = sorted(TABLE["errors"]["measuring"], key=lambda person: person["vertices"])
    least, most = (person["vertices"] for person in (persons[0], persons[-1]))
    if not least / SIMILAR_SIZE_RATIO <= sizes[0] <= most * SIMILAR_SIZE_RATIO:
        how = f"not known for meshes of {sizes[0]:,} vertices: measured only on those of {least:,} to {most:,}"
        return Errors({}, how)
    nearest = min(persons, key=lambda person: abs(math.log(person["vertices"] / sizes[0])))
    vertices, doubts = nearest["vertices"], []
    if any(cortex.origin == "simulation" for cortex in cortices):
        doubts.append("The errors are those of a person's hemisphere, not of a simulated cortex.")
    if unlike := [n for n in sizes if not 1 / SIMILAR_SIZE_RATIO <= n / vertices <= SIMILAR_SIZE_RATIO]:
        doubts.append(
            f"The errors are those of a mesh of {vertices:,} vertices; how much they differ on one of "
            f"{' or '.join(f'{n:,}' for n in unlike)} is not known."
        )
    how = (
        f"from the mesh, not from noise of the image: measured at {accuracy} on one person's hemisphere "
        f"({nearest['subject']}: {vertices:,} vertices) for docs/accuracy.md, once each; "
        "no accuracy is listed as better than a slower one"
    )
    errors = {
        name: Measured(law[accuracy], COMPARISON_LABELS.get(law["against"], law["against"]))
        for name, law in nearest["quantities"].items()
    }
    return Errors(errors, how, tuple(doubts))
