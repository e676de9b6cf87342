"""What a run or an analysis cost: its time by part, its memory, and the errors to expect of it, in one record ``Cost``.

In go the ``health.json`` of a finished run, or the clock of an analysis; out come the record, which pages and
``cost.json`` show, and lines for the terminal. Expected errors are looked up in a table of measured ones
(``table.json``), of a run by its edge, of an analysis by its accuracy. Forecasts look up the same before a run; which
scenes the table holds for, and the memory that an analysis will need, are here, too.
"""

from __future__ import annotations

import json
import math
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from numba import get_num_threads

from morphofold.digests_and_json import Row
from morphofold.number_texts import percent, span
from morphofold.sim.output.stage_records import read_health
from morphofold.sim.scene import Scene, Sphere, elements_through
from morphofold.sim.scene.effect_registry import effect_names, options_of
from morphofold.sim.scene.scene_files import load_scene
from morphofold.surface import Cortex
from morphofold.timing import Stages, peak_memory

if TYPE_CHECKING:
    from morphofold.analysis.measures_result import Measures

GiB = 2**30
#: the error of a run is the larger one of these: the numbers of its folds that converge last
HEADLINE_QUANTITIES = ("gyrification index", "wavelength")
#: share of an edge within which two edges count as the same: numbers of cells are whole and even
SAME_EDGE_TOLERANCE = 0.05
#: errors are given for spheres in these ranges: those compared with finer meshes (docs/accuracy.md, docs/folds.md), and
#: a third of that thickness (T/C of fig6-thick), the paper's thinnest
STUDIED_RANGES = {"growth": (1.5, 2.0), "mu_ratio": (1.0, 4.0), "kappa_ratio": (12.5, 200.0), "thickness": (0.02, 0.1)}
SIMILAR_SIZE_RATIO = 1.5  # ratio of numbers of vertices beyond which a surface does not count as similar to the table's
TABLE: Row = json.loads(Path(__file__).with_name("table.json").read_text("utf-8"))
COSTS: Row = TABLE["costs"]  # constants for forecasts of time and memory, each with its meaning
OTHER_PHASE = "other"
READING_STAGE, WRITING_STAGE, PAGE_STAGE = "reading", "writing", "page"
#: in words: phases of the solver's clock that belong to no effect, stages of an analysis, and what the study compared
#: a measure with
_WORDS = tomllib.loads(Path(__file__).with_suffix(".toml").read_text("utf-8"))
SOLVER_PHASES, ANALYSIS_STAGES, COMPARISONS = _WORDS.values()


@dataclass(frozen=True)
class Expected:
    """An expected relative error from the mesh, and the range of the runs that were studied; 0.01 is 1 %. ``other`` is
    the error from other settings of the solver, which a shorter edge does not reduce."""

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

    errors: Row
    how: str
    doubts: tuple[str, ...] = ()
    not_studied: tuple[str, ...] = ()


def expected_errors(edge_over_T: float) -> dict[str, Expected]:
    """Expected relative error of each quantity with surface edges of ``edge_over_T`` thicknesses.

    ``coefficient * edge_over_T ** power``, with a factor exp(+-spread) of scatter. For the scenes to which it does
    not apply see ``not_studied``.
    """
    errors = {}
    for name, power_law in TABLE["errors"]["quantities"].items():
        error, scatter = power_law["coefficient"] * edge_over_T ** power_law["power"], math.exp(power_law["spread"])
        errors[name] = Expected(error, error / scatter, error * scatter, power_law["other"])
    return errors


def headline(errors: Mapping[str, Expected]) -> tuple[str, Expected]:
    """The quantity of ``HEADLINE_QUANTITIES`` with the larger expected error, and that error."""
    name = max(HEADLINE_QUANTITIES, key=lambda name: errors[name].error)
    return name, errors[name]


def studied() -> tuple[float, float]:
    """Finest and coarsest edge over thickness at which all of ``HEADLINE_QUANTITIES`` were studied."""
    error_laws = [TABLE["errors"]["quantities"][name] for name in HEADLINE_QUANTITIES]
    return max(error_law["finest"] for error_law in error_laws), min(error_law["coarsest"] for error_law in error_laws)


def not_studied(scene: Scene, edge_over_T: float) -> tuple[str, ...]:
    """Properties of a scene outside ``STUDIED_RANGES``, for which no errors are given; empty if the table holds for it.

    ``"shape"`` (not a sphere of even thickness), ``"law"`` (not isotropic), ``"material"``, ``"effects"`` (one that
    no study of errors had), ``"edge"``, and the names of ``STUDIED_RANGES``.
    """
    sphere, material = scene.geometry if isinstance(scene.geometry, Sphere) else None, scene.material
    is_unstudied = {
        "shape": sphere is None or bool(sphere.thickness_spots or sphere.thickness_map),
        "law": scene.growth.law != "isotropic",
        "material": not material.errors_known,
        "effects": not all(options.errors_known for options in scene.effects.values()),
        "edge": _is_outside(edge_over_T, studied(), SAME_EDGE_TOLERANCE),
    }
    value_of_range = {"growth": scene.growth.final, "mu_ratio": material.mu_ratio, "kappa_ratio": material.kappa_ratio}
    if sphere:
        value_of_range["thickness"] = sphere.cortex_thickness / sphere.radius
    is_unstudied |= {name: _is_outside(value, STUDIED_RANGES[name], 1e-9) for name, value in value_of_range.items()}
    return tuple(name for name, is_outside in is_unstudied.items() if is_outside)


def _is_outside(value: float, limits: tuple[float, float], tolerance: float) -> bool:
    return not (1 - tolerance) * limits[0] <= value <= (1 + tolerance) * limits[1]


def called(quantity: str) -> str:
    """Name of a quantity in tables of errors: errors are relative, except a distance, which is over the thickness."""
    return "pial distance, over T" if quantity == "pial distance" else quantity


def errors_of_run(scene: Scene, edge_over_T: float) -> Errors:
    """Expected errors of a run, from its largest surface edge over the thickness."""
    if unstudied := not_studied(scene, edge_over_T):
        return Errors({}, f"not studied for this {', '.join(unstudied).replace('_', ' ')}", (), unstudied)
    error_table, growth, doubts = TABLE["errors"], scene.growth.final, []
    if abs(growth - error_table["growth"]) > 0.05:
        doubts.append(
            f"The errors of folds hold at g = {error_table['growth']:g}, not at {growth:g}, where this scene ends."
        )
    layers, studied_layers = scene.elements_through_cortex, elements_through(scene.edge / scene.thinnest)
    if layers != studied_layers:
        doubts.append(f"The errors are those of {studied_layers} elements through the cortex; here there are {layers}.")
    how = f"before the run, from its edge and a table: {error_table['subject']}"
    return Errors(expected_errors(edge_over_T), how, tuple(doubts))


def measured_errors(cortices: Sequence[Cortex], accuracy: str) -> Errors:
    """Expected errors of an accuracy: those of the hemisphere in the table with the nearest number of vertices.

    Of several cortices the one with the fewest vertices decides; a doubt is given for each cortex that differs from the
    table's. Beyond the meshes of the table by more than ``SIMILAR_SIZE_RATIO`` no errors are known: a mesh of 42
    vertices has an error of 26 % in thickness, a mesh of 10,001 vertices one of 5 %.
    """
    counts = sorted({cortex.n_vertices for cortex in cortices})
    persons = TABLE["errors"]["measuring"]
    fewest, *_, most = sorted(person["vertices"] for person in persons)
    if not fewest / SIMILAR_SIZE_RATIO <= counts[0] <= most * SIMILAR_SIZE_RATIO:
        how = f"not known for meshes of {counts[0]:,} vertices: measured only on those of {fewest:,} to {most:,}"
        return Errors({}, how)
    nearest = min(persons, key=lambda person: abs(math.log(person["vertices"] / counts[0])))
    vertices, doubts = nearest["vertices"], []
    if any(cortex.origin == "simulation" for cortex in cortices):
        doubts.append("The errors are those of a person's hemisphere, not of a simulated cortex.")
    if unlike_counts := [n for n in counts if not 1 / SIMILAR_SIZE_RATIO <= n / vertices <= SIMILAR_SIZE_RATIO]:
        doubts.append(
            f"The errors are those of a mesh of {vertices:,} vertices; how much they differ on one of "
            f"{' or '.join(f'{n:,}' for n in unlike_counts)} is not known."
        )
    how = (
        f"from the mesh, not from noise of the image: measured at {accuracy} on one person's hemisphere "
        f"({nearest['subject']}: {vertices:,} vertices) for docs/accuracy.md, once each; "
        "no accuracy is listed as better than a slower one"
    )
    errors = {name: Measured(law[accuracy], COMPARISONS[law["against"]]) for name, law in nearest["quantities"].items()}
    return Errors(errors, how, tuple(doubts))


# after the work ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Cost:
    """Cost of a run or an analysis.

    Attributes
    ----------
    size : mapping
        Of a run its ``elements`` and ``steps``, None if an early version did not write them; of an analysis its
        ``vertices`` by hemisphere and its ``accuracy``.
    threads : int or None
    seconds : float
        Wall time without compiling [s].
    parts : mapping
        Seconds of each phase and effect of a run, or of each stage of an analysis.
    labels : mapping
        What each part does, in words; and where the time of an effect is counted that is no part of its own.
    memory_GiB : float or None
        Most that the process has held.
    expected : Errors
    """

    size: Row
    threads: int | None
    seconds: float
    parts: Mapping[str, float]
    labels: Mapping[str, str]
    memory_GiB: float | None
    expected: Errors

    def as_dict(self) -> Row:
        """Plain values of an analysis, for JSON."""
        return {
            **self.size,
            "threads": self.threads,
            "seconds": self.seconds,
            "stages": {name: {"seconds": t, "share": t / (self.seconds or 1)} for name, t in self.parts.items()},
            "memory_GiB": self.memory_GiB,
            "errors": {name: asdict(error) for name, error in self.expected.errors.items()},
            "how": self.expected.how,
            "doubts": self.expected.doubts,
        }


def cost_of(health: Row, scene: Scene) -> Cost:
    """Cost of a run from its ``health.json`` and scene."""
    seconds, seconds_by_phase = health["seconds"], dict(health.get("seconds_by_phase", {}))
    if seconds_by_phase:
        seconds_by_phase[OTHER_PHASE] = max(0.0, seconds - sum(seconds_by_phase.values()))
    effects = health.get("effects", scene.called_effects)
    part_seconds = dict(sorted(seconds_by_phase.items(), key=lambda part: (part[0] in effects, -part[1])))
    labels = {name: SOLVER_PHASES.get(name, "") for name in part_seconds}
    for effect in effects:
        counted_in = options_of(effect).counted if effect in effect_names() else ""
        counted_text = "within radial" if "radial" in part_seconds else counted_in or "not timed separately"
        labels[effect] = "effect" if effect in part_seconds else f"effect: {counted_text}"
    edge = health.get("surface_edge_mm")
    return Cost(
        {name: health.get(name) for name in ("elements", "steps")},
        health.get("threads"),
        seconds,
        part_seconds,
        labels,
        health.get("peak_memory_GiB"),
        Errors({}, "") if edge is None else errors_of_run(scene, edge / scene.thinnest),
    )


def stored_cost(folder: Path) -> Cost | None:
    """Cost of the run in a folder; None if it is incomplete or does not exist any more."""
    try:
        return cost_of(read_health(folder), load_scene(folder / "scene.toml"))
    except (OSError, ValueError):
        return None


def cost_of_analysis(measures: Sequence[Measures], clock: Stages) -> Cost:
    """Cost of an analysis of at least one hemisphere; ends the stage that its clock is timing."""
    clock.end()
    accuracy = measures[0].parameters["accuracy"]
    return Cost(
        {"vertices": {m.cortex.hemi: m.cortex.n_vertices for m in measures}, "accuracy": accuracy},
        get_num_threads(),
        sum(clock.seconds.values()),
        dict(clock.seconds),
        {name: ANALYSIS_STAGES.get(name, "") for name in clock.seconds},
        peak_memory(),
        measured_errors([m.cortex for m in measures], accuracy),
    )


def memory_of_analysis(vertices: Sequence[int], *, accuracy: str, report: bool) -> float:
    """Most memory of a process that measures hemispheres of these numbers of vertices, one after the other [GiB]."""
    from morphofold.analysis.resampled_cortex import accuracy_of

    accuracy_settings, memory, n_vertices = accuracy_of(accuracy), COSTS["analysis"], sum(vertices)
    largest_mesh = max(4 * n if n < accuracy_settings.least_vertices else n for n in vertices)
    mesh_bytes = memory["kept_per_vertex"] * n_vertices + memory["per_vertex"] * largest_mesh
    measuring_GiB = memory["process"] + (mesh_bytes + memory["per_voxel"] * accuracy_settings.radius_voxels**3) / GiB
    page = memory["page"] + memory["page_per_hemisphere"] * len(vertices) + memory["page_per_vertex"] * n_vertices / GiB
    return max(measuring_GiB, page) if report else measuring_GiB


def largest(part_seconds: Mapping[str, float], total_seconds: float, n_most: int = 3) -> str:
    """The largest parts of a time with their shares, in words."""
    longest_parts = sorted(part_seconds.items(), key=lambda part: -part[1])[:n_most]
    return ", ".join(f"{name} {percent(seconds / (total_seconds or 1))}" for name, seconds in longest_parts)


def cost_line(cost: Cost) -> str:
    """A line with the largest times of a run and its expected error."""
    errors, how, doubts, not_studied = cost.expected
    sentences = [f"time: {largest(cost.parts, cost.seconds)}"] if cost.parts else []
    if not_studied:
        sentences.append(f"expected error: {how}")
    elif errors:
        name, expected = headline(errors)
        sentences.append(f"expected error about {percent(expected.error)} ({name}), from its edge and a table")
    return ". ".join(sentence.removesuffix(".") for sentence in ("; ".join(sentences), *doubts))


def analysis_cost_line(cost: Cost) -> str:
    """A line with the largest times of an analysis and its largest expected error: the least may be small by chance."""
    line, errors = f"time: {span(cost.seconds)}, {largest(cost.parts, cost.seconds)}; ", cost.expected.errors
    if not errors:
        return f"{line}errors: {cost.expected.how}"
    worst = max(errors, key=lambda name: errors[name].error)
    return (
        f"{line}expected errors up to {percent(errors[worst].error)} ({worst}), by one person's hemisphere and its mesh"
    )
