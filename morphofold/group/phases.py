"""Results of a sweep, read from its folder: measures and health of every run, theory of every point, and tables."""

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np

from morphofold.analysis.measures import SCALARS
from morphofold.group.fleet import Fleet, Job, Lost
from morphofold.group.grid import Grid, SweepPoint
from morphofold.group.group_tables import TidyWriter, read_results, refuse_changed, what_became
from morphofold.group.sweep import folder_of
from morphofold.group.tasks import Outcome, read_record
from morphofold.io import atomic_folder, read_surface
from morphofold.progress import Progress, silent
from morphofold.sim.output.stages import read_health
from morphofold.sim.scene import Patch, Radial, Scene, Sphere, Strip
from morphofold.sim.scene.geometries import Geometry
from morphofold.tables import write_table
from morphofold.words import in_one_line

GROUP_FOLDER = "group"
HINGES_PER_AREA = "hinges_per_1000_mm2"
AREA_OVER_FLAT = "area_over_flat"
RUN_MEASURES = (*SCALARS, HINGES_PER_AREA, AREA_OVER_FLAT)


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
    theory: Mapping[tuple[int, ...], SphereTheory]

    @cached_property
    def at(self) -> dict[tuple[int, ...], list[RunResult]]:
        """The runs of each point, one per seed."""
        found: dict[tuple[int, ...], list[RunResult]] = {}
        for run in self.runs:
            found.setdefault(run.point.at, []).append(run)
        return found


DrawReport = Callable[[Phases, Path, Progress], object]


# theory ------------------------------------------------------------------------------------------------------


def theory_of(scene: Scene) -> SphereTheory:
    """First wrinkles of a scene's sphere in theory, by :func:`morphofold.sim.theory.bifurcation` with its thickness,
    radius, hole, moduli and growth law."""
    from morphofold.sim import theory
    from morphofold.sim.sphere_theory.smooth_sphere import ConvergenceError

    if scene.beyond_theory:
        return SphereTheory(reason=scene.beyond_theory)
    geometry = scene.geometry
    assert isinstance(geometry, Sphere | Radial)
    try:
        found = theory.bifurcation(
            geometry.cortex_thickness / geometry.radius,
            scene.material.mu_ratio,
            scene.growth.law,
            scene.material.kappa_ratio,
            A_over_C=geometry.hole_radius / geometry.radius,
        )
    except (ValueError, ConvergenceError) as error:
        return SphereTheory(reason=in_one_line(error))
    return SphereTheory(found.g_crit, found.g_crease, found.wavelength_deformed * geometry.radius, found.reason)


def theory_by_place(fleet: Fleet, grid: Grid, show: Progress = silent) -> dict[tuple[int, ...], SphereTheory]:
    """Theory of every point of a grid, computed once per sphere, on the workers of a fleet."""
    spheres = {at: _theory_parameters(scene) for at, scene in grid.scenes.items()}
    wanted = {spheres[at]: scene for at, scene in grid.scenes.items()}
    found: dict[str, SphereTheory] = {}
    for job, outcome in fleet.run(theory_of, [Job(f"theory {i}", scene) for i, scene in enumerate(wanted.values())]):
        found[_theory_parameters(job.argument)] = (
            SphereTheory(reason=outcome.reason) if isinstance(outcome, Lost) else outcome
        )
        show(len(found) / len(wanted), "theory")
    return {at: found[key] for at, key in spheres.items()}


def _theory_parameters(scene: Scene) -> str:
    """Text of everything in a scene that theory depends on."""
    return repr((scene.geometry, scene.material, scene.growth.law, scene.growth.thickness, tuple(scene.effects)))


# results -----------------------------------------------------------------------------------------------------


def read_run(out: Path, point: SweepPoint, outcome: Outcome | None = None) -> RunResult:
    """Read the result of a run from disk; without results, it has the reason. ``outcome``: of a run done just now."""
    record = read_record(out / "records" / f"{point.name}.json")
    folder = folder_of(out, point.name)
    warnings, numbers = _warnings_and_sizes(folder / "simulation")
    failures, there = what_became(record, outcome, "not run yet. Run the sweep again.")
    reason = "" if there else " ".join(failures.values()) or "failed; the reason is in its log"
    if there:
        try:
            hemi = getattr(point.scene.geometry, "hemi", "lh")
            files = ("summary.json", "regions.tsv", f"surf/{hemi}.pial")
            names = (*(f"analysis/{name}" for name in files), "simulation/health.json")
            refuse_changed(record, {name: folder / name for name in names})
            measures, notes, pial = _measures_of_run(folder / "analysis", point.scene.geometry)
            return RunResult(point, "", measures, notes, warnings, numbers, pial)
        except (OSError, ValueError, IndexError) as error:
            reason = in_one_line(error)
    return RunResult(point, reason, {}, {}, warnings, numbers)


def _measures_of_run(analysis: Path, geometry: Geometry) -> tuple[dict[str, float], dict[str, str], Path]:
    """Measures of a run, reasons for missing ones, and its pial surface."""
    entry = read_results(analysis).entries[0]
    pial = analysis / "surf" / f"{entry['hemi']}.pial"
    measures = {key: float(value) for key in SCALARS if isinstance(value := entry["measures"].get(key), int | float)}
    area = measures.get("area_pial_mm2")
    if area and "n_hinges" in measures and not isinstance(geometry, Strip):
        measures[HINGES_PER_AREA] = 1000 * measures["n_hinges"] / area
    if area and isinstance(geometry, Patch | Strip):
        measures[AREA_OVER_FLAT] = area / _area_before_growth(geometry, pial)
    notes = {key: str(entry["notes"][key]) for key in SCALARS if key not in measures and key in entry["notes"]}
    return measures, notes, pial


def _area_before_growth(geometry: Patch | Strip, pial: Path) -> float:
    """Area [mm^2] of the flat piece at the start of a patch or strip; the width of a strip is that of its mesh."""
    if isinstance(geometry, Patch):
        return geometry.size[0] * geometry.size[1]
    return geometry.length * float(np.ptp(read_surface(pial).verts[:, 1]))


def _warnings_and_sizes(folder: Path) -> tuple[tuple[str, ...], dict[str, int]]:
    try:
        health = read_health(folder)
    except (OSError, ValueError):
        return (), {}  # it did not finish
    return tuple(health["warnings"]), {key: health[key] for key in ("elements", "steps") if key in health}


# tables ------------------------------------------------------------------------------------------------------


def write_sweep(
    out: Path,
    grid: Grid,
    theory: Mapping[tuple[int, ...], SphereTheory],
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
    theory : mapping of place to SphereTheory
    outcomes : sequence of Outcome
        Outcomes of runs done just now; for others, the records are used.
    report : callable or False
        Draws the page into a folder: :func:`morphofold.report.pages.phase_page.phase_report`.
    progress : callable
        Called with the share done and the current step.
    """
    with atomic_folder(out / GROUP_FOLDER) as folder:
        by_name = {one.name: one for one in outcomes}
        phases = Phases(grid, tuple(read_run(out, point, by_name.get(point.name)) for point in grid.points), theory)
        write_tables(phases, folder)
        if report:
            report(phases, folder, progress)
    return phases


def write_tables(phases: Phases, folder: Path) -> None:
    """Write the tables of a sweep: tidy measures (one row per run and measure), runs with health, theory per point."""
    axes = {axis.label: float if axis.numeric else str for axis in phases.grid.axes}
    with closing(TidyWriter(folder, {"run": str, **axes, "seed": int, "measure": str, "value": float})) as writer:
        writer.write(
            [
                (*_run_identity(phases.grid, run.point).values(), key, run.measures.get(key))
                for run in phases.runs
                for key in RUN_MEASURES
                if not run.reason and (key != AREA_OVER_FLAT or key in run.measures)
            ]
        )
    write_table(
        folder / "runs.tsv",
        ("run", *axes, "seed", "state", "healthy", "warnings", "reason", "elements", "steps", "log"),
        [_run_row(phases.grid, run) for run in phases.runs],
    )
    write_table(
        folder / "theory.tsv",
        (*axes, "final_growth", "g_crit", "g_crease", "wavelength_mm", "reason"),
        [_theory_row(phases, at) for at in phases.grid.places],
    )


def _run_identity(grid: Grid, point: SweepPoint) -> dict[str, Any]:
    return {"run": point.name, **_axis_values(grid, point.at), "seed": point.seed}


def _axis_values(grid: Grid, at: tuple[int, ...]) -> dict[str, Any]:
    """The value on each axis; lists as text."""
    return {
        axis.label: axis.values[i] if isinstance(axis.values[i], int | float) else axis.words[i]
        for axis, i in zip(grid.axes, at)
    }


def _run_row(grid: Grid, run: RunResult) -> dict[str, Any]:
    return {
        **_run_identity(grid, run.point),
        "state": "failed" if run.reason else "done",
        "healthy": None if run.reason else not run.warnings,
        "warnings": "; ".join(run.warnings) or None,
        "reason": run.reason or None,
        **run.numbers,
        "log": f"logs/{run.point.name}.log",
    }


def _theory_row(phases: Phases, at: tuple[int, ...]) -> dict[str, Any]:
    found, scene = phases.theory[at], phases.grid.scenes[at]
    return {
        **_axis_values(phases.grid, at),
        "final_growth": scene.growth.final,
        "g_crit": found.g_crit,
        "g_crease": found.g_crease,
        "wavelength_mm": found.wavelength,
        "reason": found.reason or None,
    }
