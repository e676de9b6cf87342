"""Results of a sweep, read from its folder: measures and health of every run, theory of every point, and tables."""

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import groupby
from pathlib import Path
from typing import Literal

import numpy as np

from morphofold.analysis.measures import SCALARS
from morphofold.group.grid import Grid, GridIndex, SweepPoint
from morphofold.group.group_tables import GROUP_FOLDER, read_results, refuse_changed, what_became, write_measures
from morphofold.group.sweep import RUNS_FOLDER
from morphofold.group.tasks import Outcome, read_record
from morphofold.group.workers import Lost, Workers
from morphofold.io import atomic_folder, read_surface
from morphofold.progress import Progress, silent
from morphofold.provenance import Row
from morphofold.sim.output.stages import read_health
from morphofold.sim.scene import Patch, Radial, Scene, Sphere, Strip
from morphofold.sim.sphere_theory.smooth_sphere import ConvergenceError
from morphofold.sim.theory import bifurcation
from morphofold.tables import write_table
from morphofold.words import in_one_line

HINGES_PER_AREA = "hinges_per_1000_mm2"
AREA_OVER_FLAT = "area_over_flat"
RUN_MEASURES = (*SCALARS, HINGES_PER_AREA, AREA_OVER_FLAT)
THEORY_COLUMNS = ("final_growth", "g_crit", "g_crease", "wavelength_mm", "reason")


@dataclass(frozen=True, eq=False)
class RunResult:
    """Result of a run.

    Attributes
    ----------
    point : SweepPoint
    reason : str
        Why it has no measures; empty if it has measures.
    measures : mapping of measure to float
        Those of RUN_MEASURES that it has. ``hinges_per_1000_mm2`` is hinges per 1000 mm^2 of the pial surface; both are
        of the whole closed surface after mirroring, so the simulated share makes no difference. A strip is a section
        and has no hinges. ``area_over_flat`` is for patches and strips only: their pial area over that of the flat
        piece at the start (the symmetry planes on their sides keep its extent).
    notes : mapping of measure to str
        Why a measure is missing.
    warnings : tuple of str
        Health warnings; empty if it is healthy.
    numbers : mapping
        ``elements`` and ``steps`` of the run.
    pial : Path or None
        Its last pial surface, as measured.
    """

    point: SweepPoint
    reason: str = ""
    measures: Mapping[str, float] = field(default_factory=dict)
    notes: Mapping[str, str] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    numbers: Mapping[str, int] = field(default_factory=dict)
    pial: Path | None = None


@dataclass(frozen=True)
class SphereTheory:
    """Theory of the sphere for a scene: growth stretch at the first wrinkles and at the crease criterion, and the
    wavelength of the first wrinkles on the grown sphere [mm]. NaN if there is none; ``reason`` gives the cause."""

    g_crit: float = math.nan
    g_crease: float = math.nan
    wavelength: float = math.nan
    reason: str = ""


@dataclass(frozen=True, eq=False)
class Phases:
    """A sweep: its grid, its runs in the order of the grid's points, and theory by point."""

    grid: Grid
    runs: tuple[RunResult, ...]
    theory: Mapping[GridIndex, SphereTheory]

    @cached_property
    def at(self) -> dict[GridIndex, list[RunResult]]:
        """The runs of each point, one per seed."""
        return {at: list(runs) for at, runs in groupby(self.runs, key=lambda run: run.point.at)}


DrawReport = Callable[[Phases, Path, Progress], object]


# theory ------------------------------------------------------------------------------------------------------


def theory_of(scene: Scene) -> SphereTheory:
    """First wrinkles of a scene's sphere in theory, by :func:`morphofold.sim.theory.bifurcation` with its thickness,
    radius, hole, moduli and growth law."""
    if scene.beyond_theory:
        return SphereTheory(reason=scene.beyond_theory)
    geometry = scene.geometry
    assert isinstance(geometry, Sphere | Radial)
    try:
        wrinkles = bifurcation(
            geometry.cortex_thickness / geometry.radius,
            scene.material.mu_ratio,
            scene.growth.law,
            scene.material.kappa_ratio,
            A_over_C=geometry.hole_radius / geometry.radius,
        )
    except (ValueError, ConvergenceError) as error:
        return SphereTheory(reason=in_one_line(error))
    wavelength = wrinkles.wavelength_deformed * geometry.radius
    return SphereTheory(wrinkles.g_crit, wrinkles.g_crease, wavelength, wrinkles.reason)


def theory_by_point(workers: Workers, grid: Grid, progress: Progress = silent) -> dict[GridIndex, SphereTheory]:
    """Theory of every point of a grid, computed once per sphere, on the workers."""
    scenes = {_theory_parameters(scene): scene for scene in grid.scenes.values()}
    theories: dict[str, SphereTheory] = {}
    for scene, outcome in workers.run(theory_of, [*scenes.values()]):
        theory = SphereTheory(reason=outcome.reason) if isinstance(outcome, Lost) else outcome
        theories[_theory_parameters(scene)] = theory
        progress(len(theories) / len(scenes), "theory")
    return {at: theories[_theory_parameters(scene)] for at, scene in grid.scenes.items()}


def _theory_parameters(scene: Scene) -> str:
    """Text of everything in a scene that theory depends on."""
    return repr((scene.geometry, scene.material, scene.growth.law, scene.growth.thickness, tuple(scene.effects)))


# results -----------------------------------------------------------------------------------------------------


def read_run(out: Path, point: SweepPoint, outcome: Outcome | None = None) -> RunResult:
    """Read the result of a run from disk; without results, it has the reason. ``outcome``: of a run done just now."""
    record, folder = read_record(out / "records" / f"{point.name}.json"), out / RUNS_FOLDER / point.name
    failures, has_results = what_became(record, outcome, "not run yet. Run the sweep again.")
    result = RunResult(point, " ".join(failures.values()) or "failed; the reason is in its log")
    with suppress(OSError, ValueError):  # it did not finish
        health = read_health(folder / "simulation")
        numbers = {key: value for key, value in health.items() if key in ("elements", "steps")}
        result = replace(result, warnings=tuple(health["warnings"]), numbers=numbers)
    if not has_results:
        return result
    try:
        hemi = getattr(point.scene.geometry, "hemi", "lh")
        files = "analysis/summary.json", "analysis/regions.tsv", f"analysis/surf/{hemi}.pial", "simulation/health.json"
        refuse_changed(record, folder, [folder / name for name in files])
        return replace(result, reason="", **_measures_of_run(folder / "analysis", point.scene))
    except (OSError, ValueError) as error:
        return replace(result, reason=in_one_line(error))


def _measures_of_run(analysis: Path, scene: Scene) -> Row:
    """Measures of a run, reasons for missing ones, and its pial surface."""
    (row, *_), geometry = read_results(analysis)[0], scene.geometry
    pial = analysis / "surf" / f"{row['hemi']}.pial"
    measures = {key: float(row[key]) for key in SCALARS if row[key] is not None}
    if area := measures.get("area_pial_mm2"):
        if "n_hinges" in measures and not isinstance(geometry, Strip):
            measures[HINGES_PER_AREA] = 1000 * measures["n_hinges"] / area
        if isinstance(geometry, Patch):
            measures[AREA_OVER_FLAT] = area / math.prod(geometry.size)
        if isinstance(geometry, Strip):  # its width is that of its mesh
            measures[AREA_OVER_FLAT] = area / (geometry.length * float(np.ptp(read_surface(pial).verts[:, 1])))
    notes = {key: row["notes"][key] for key in SCALARS if key not in measures and key in row["notes"]}
    return {"measures": measures, "notes": notes, "pial": pial}


# tables ------------------------------------------------------------------------------------------------------


def write_sweep(
    out: Path,
    grid: Grid,
    theory: Mapping[GridIndex, SphereTheory],
    outcomes: Sequence[Outcome] = (),
    *,
    report: DrawReport | Literal[False] = False,
    progress: Progress = silent,
) -> Phases:
    """Write ``out/group`` completely or not at all: measures.tsv, measures.parquet, runs.tsv and theory.tsv, and
    report.html if there is a ``report``.

    Parameters
    ----------
    out : Path
        Folder of the sweep.
    grid : Grid
    theory : mapping of point to SphereTheory
    outcomes : sequence of Outcome
        Outcomes of runs done just now; for others, the records are used.
    report : callable or False
        Draws the page into a folder: :func:`morphofold.group_pages.phase_page.phase_report`.
    progress : callable
        Called with the share done and the current step.
    """
    with atomic_folder(out / GROUP_FOLDER) as folder:
        by_name = {outcome.name: outcome for outcome in outcomes}
        runs = tuple(read_run(out, point, by_name.get(point.name)) for point in grid.points)
        phases = Phases(grid, runs, theory)
        write_tables(phases, folder)
        if report:
            report(phases, folder, progress)
    return phases


def write_tables(phases: Phases, folder: Path) -> None:
    """Write the tables of a sweep: tidy measures (one row per run and measure), runs with health, theory per point."""
    grid = phases.grid
    axes = {axis.label: float if axis.numeric else str for axis in grid.axes}
    tidy, runs, theories = [], [], []
    for run in phases.runs:
        identity = {"run": run.point.name, **_axis_values(grid, run.point.at), "seed": run.point.seed}
        keys = () if run.reason else RUN_MEASURES if AREA_OVER_FLAT in run.measures else RUN_MEASURES[:-1]
        tidy += [(*identity.values(), key, run.measures.get(key)) for key in keys]
        state = {
            "state": "failed" if run.reason else "done",
            "healthy": None if run.reason else not run.warnings,
            "warnings": "; ".join(run.warnings) or None,
            "reason": run.reason or None,
        }
        runs.append({**identity, **state, **run.numbers, "log": f"logs/{run.point.name}.log"})
    for at in grid.places:
        theory, final = phases.theory[at], grid.scenes[at].growth.final
        numbers = (final, theory.g_crit, theory.g_crease, theory.wavelength, theory.reason or None)
        theories.append(_axis_values(grid, at) | dict(zip(THEORY_COLUMNS, numbers)))
    write_measures(folder, {"run": str, **axes, "seed": int, "measure": str, "value": float}, [tidy])
    columns = ("run", *axes, "seed", "state", "healthy", "warnings", "reason", "elements", "steps", "log")
    write_table(folder / "runs.tsv", columns, runs)
    write_table(folder / "theory.tsv", (*axes, *THEORY_COLUMNS), theories)


def _axis_values(grid: Grid, at: GridIndex) -> Row:
    """The value on each axis; lists as text."""
    return {
        axis.label: axis.values[i] if isinstance(axis.values[i], int | float) else axis.texts[i]
        for axis, i in zip(grid.axes, at)
    }
