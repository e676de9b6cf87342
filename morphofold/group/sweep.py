"""A sweep: its runs, each of which grows a scene and measures its last stage as ``analyze`` does; and their results,
read from the folder: measures and health of every run, theory of every point, and tables."""

import math
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import groupby
from pathlib import Path
from typing import Literal

import numba
import numpy as np

from morphofold import results, simulation
from morphofold.analysis.measures_result import SCALARS
from morphofold.digests_and_json import Row
from morphofold.forecasts.cost_record import READING_STAGE
from morphofold.group.group_tables import GROUP_FOLDER, read_results, write_measures
from morphofold.group.measure_subject import Options, measure_as_asked
from morphofold.group.sweep_grid import Grid, GridIndex, SweepPoint
from morphofold.group.task_records import INPUT_ERRORS, Outcome, TaskFolder, TaskLog, digest, perform, read_record
from morphofold.io import atomic_folder, files_of, read_surface, remove_folder
from morphofold.io.files import write_text
from morphofold.number_texts import in_one_line
from morphofold.progress_callbacks import Progress, logged
from morphofold.results.analysis_files import DrawPage
from morphofold.sim.dynamics import UnstableError
from morphofold.sim.output.run_inputs import clear_run, files_of_run, inputs_of
from morphofold.sim.output.stage_records import read_health
from morphofold.sim.run import Simulation
from morphofold.sim.scene import Patch, Radial, Scene, Sphere, Strip
from morphofold.sim.scene.scene_files import to_toml
from morphofold.sim.sphere_theory.smooth_sphere import ConvergenceError
from morphofold.sim.theory import bifurcation
from morphofold.tables import write_table
from morphofold.timing import Stages

RUNS_FOLDER = "runs"


@dataclass(frozen=True)
class Run:
    """A scene to grow and to measure.

    Attributes
    ----------
    task_folder : TaskFolder
    scene : Scene
    threads : int
        Threads of its worker.
    report : callable or False
        Draws its own page and pictures, as for :func:`morphofold.results.write_analysis`.
    options : mapping
        ``curvature_scale_mm``, ``gyral_width_mm``, ``thickness_cap_mm`` and ``accuracy``, as for ``analyze``.
    """

    task_folder: TaskFolder
    scene: Scene
    threads: int = 1
    report: DrawPage | Literal[False] = False
    options: Options = field(default_factory=dict)

    @property
    def folder(self) -> Path:
        """Folder with its output: ``simulation`` and ``analysis``."""
        return Path(self.task_folder.out) / RUNS_FOLDER / self.task_folder.name

    @property
    def simulation(self) -> Path:
        return self.folder / "simulation"

    @property
    def analysis(self) -> Path:
        return self.folder / "analysis"


def grow_and_measure(run: Run) -> Outcome:
    """Grow a scene and measure its last stage, unless this was done for the same scene with the same options.

    Only what has changed is done again: other measuring options do not grow the scene again. An unfinished simulation
    continues from its checkpoint. A simulation that leaves its bounds has failed; its output up to there is kept.
    """

    def key() -> str:
        return digest({"grown": _simulation_digest(run.scene), "report": bool(run.report), **run.options})

    def files() -> dict[str, Path]:
        files_by_part = {"simulation": files_of_run(run.simulation), "analysis": files_of(run.analysis)}
        return {f"{folder}/{name}": path for folder, paths in files_by_part.items() for name, path in paths.items()}

    def work(log: TaskLog, changed_files: list[str]) -> dict[str, str]:
        run.folder.mkdir(parents=True, exist_ok=True)
        try:
            finished = _simulation_of_run(run, log, redo=any(name.startswith("simulation/") for name in changed_files))
            _analyse_last_stage(run, finished, log)
        except (ConvergenceError, UnstableError, *INPUT_ERRORS) as error:
            remove_folder(run.analysis)  # results of an earlier scene
            return {"": in_one_line(error)}
        return {}

    return perform(run.task_folder, key, files, work)


def _simulation_digest(scene: Scene) -> str:
    """Digest of everything that a simulation depends on."""
    return digest({"scene": to_toml(scene), "inputs": inputs_of(scene)})


def _simulation_of_run(run: Run, log: TaskLog, *, redo: bool) -> Simulation:
    """The simulation of a run: continued if it was begun with the same scene, otherwise grown from the start."""
    folder, digest_file, current, last_tenth = run.simulation, run.folder / "grown-of", _simulation_digest(run.scene), 0

    def say_progress(share_done: float, text: str) -> None:
        nonlocal last_tenth
        if (tenth := int(10 * share_done)) > last_tenth:
            last_tenth = tenth
            log(f"{share_done:4.0%}  {text}")

    def grow() -> Simulation:
        threads = min(run.threads, numba.config.NUMBA_NUM_THREADS)  # type: ignore[attr-defined]  # of a running worker
        return simulation.simulate(run.scene, folder, resume=True, threads=threads, progress=say_progress)

    was_begun = folder.exists()
    if was_begun and (redo or not digest_file.is_file() or digest_file.read_text("utf-8", errors="replace") != current):
        log("its scene or its files have changed: it is grown again")
        clear_run(folder)
        was_begun = False
    write_text(digest_file, current)
    try:
        return grow()
    except ValueError as error:
        if not was_begun:
            raise
        log(f"{error} It is grown again.")  # the existing files are damaged
        clear_run(folder)
        return grow()


def _analyse_last_stage(run: Run, finished_run: Simulation, log: TaskLog) -> None:
    """Write the analysis of the last stage."""
    clock = Stages()
    clock.begin(READING_STAGE)
    cortex = finished_run.cortex()
    stage_cortices = [finished_run.cortex(growth) for growth in finished_run.stages] if run.report else []
    clock.end()
    measures = measure_as_asked(cortex, run.options, clock, log)
    log("writing")
    parameters = {"hemi": None, "name": None, **run.options}
    results.write_analysis(
        [measures], run.analysis, parameters=parameters, report=run.report, stages=stage_cortices, clock=clock
    )


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
    run_sizes : mapping
        ``elements`` and ``steps`` of the run.
    pial : Path or None
        Its last pial surface, as measured.
    """

    point: SweepPoint
    reason: str = ""
    measures: Mapping[str, float] = field(default_factory=dict)
    notes: Mapping[str, str] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    run_sizes: Mapping[str, int] = field(default_factory=dict)
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
    def runs_at(self) -> dict[GridIndex, list[RunResult]]:
        """The runs of each point, one per seed."""
        return {index: list(runs) for index, runs in groupby(self.runs, key=lambda run: run.point.grid_index)}


# theory ------------------------------------------------------------------------------------------------------


def theory_of(scene: Scene) -> SphereTheory:
    """First wrinkles of a scene's sphere in theory, by :func:`morphofold.sim.theory.bifurcation` with its thickness,
    radius, hole, moduli and growth law."""
    if scene.beyond_theory:
        return SphereTheory(reason=scene.beyond_theory)
    geometry = scene.geometry
    assert isinstance(geometry, Sphere | Radial)
    try:
        first_wrinkles = bifurcation(
            geometry.cortex_thickness / geometry.radius,
            scene.material.mu_ratio,
            scene.growth.law,
            scene.material.kappa_ratio,
            A_over_C=geometry.hole_radius / geometry.radius,
        )
    except (ValueError, ConvergenceError) as error:
        return SphereTheory(reason=in_one_line(error))
    wavelength = first_wrinkles.wavelength_deformed * geometry.radius
    return SphereTheory(first_wrinkles.g_crit, first_wrinkles.g_crease, wavelength, first_wrinkles.reason)


def theory_by_point(grid: Grid, progress: Progress = logged) -> dict[GridIndex, SphereTheory]:
    """Theory of every point of a grid; ``bifurcation`` remembers the spheres that points share."""
    theories: dict[GridIndex, SphereTheory] = {}
    for grid_index, scene in grid.scenes.items():
        theories[grid_index] = theory_of(scene)
        progress(len(theories) / len(grid.scenes), "theory")
    return theories


# results -----------------------------------------------------------------------------------------------------


def read_run(out: Path, point: SweepPoint) -> RunResult:
    """Read the result of a run from disk; without results, it has the reason."""
    record, folder = read_record(out / "records" / f"{point.name}.json"), out / RUNS_FOLDER / point.name
    failures = record.get("failures", {"": "not run yet. Run the sweep again."})
    result = RunResult(point, " ".join(failures.values()) or "failed; the reason is in its log")
    with suppress(OSError, ValueError):  # it did not finish
        health = read_health(folder / "simulation")
        health_numbers = {key: value for key, value in health.items() if key in ("elements", "steps")}
        result = replace(result, warnings=tuple(health["warnings"]), run_sizes=health_numbers)
    if not record.get("results"):
        return result
    try:
        return replace(result, reason="", **_measures_of_run(folder / "analysis", point.scene))
    except (OSError, ValueError) as error:
        return replace(result, reason=in_one_line(error))


def _measures_of_run(folder: Path, scene: Scene) -> Row:
    """Measures of a run, reasons for missing ones, and its pial surface."""
    (row, *_), geometry = read_results(folder), scene.geometry
    pial_file = folder / "surf" / f"{row['hemi']}.pial"
    measures = {key: float(row[key]) for key in SCALARS if row[key] is not None}
    if area := measures.get("area_pial_mm2"):
        if "n_hinges" in measures and not isinstance(geometry, Strip):
            measures[HINGES_PER_AREA] = 1000 * measures["n_hinges"] / area
        if isinstance(geometry, Patch):
            measures[AREA_OVER_FLAT] = area / math.prod(geometry.size)
        if isinstance(geometry, Strip):  # its width is that of its mesh
            measures[AREA_OVER_FLAT] = area / (geometry.length * float(np.ptp(read_surface(pial_file).verts[:, 1])))
    missing_notes = {key: row["notes"][key] for key in SCALARS if key not in measures and key in row["notes"]}
    return {"measures": measures, "notes": missing_notes, "pial": pial_file}


# tables ------------------------------------------------------------------------------------------------------


def write_sweep(
    out: Path,
    grid: Grid,
    theory: Mapping[GridIndex, SphereTheory],
    *,
    report: Callable[[Phases, Path, Progress], object] | Literal[False] = False,
    progress: Progress = logged,
) -> Phases:
    """Write ``out/group`` completely or not at all: measures.tsv, measures.parquet, runs.tsv and theory.tsv, and
    report.html if ``report`` is given.

    Parameters
    ----------
    out : Path
        Folder of the sweep.
    grid : Grid
    theory : mapping of point to SphereTheory
    report : callable or False
        Draws the page into a folder: :func:`morphofold.group_pages.phase_page.phase_report`.
    progress : callable
        Called with the share done and the current step.
    """
    with atomic_folder(out / GROUP_FOLDER) as folder:
        phases = Phases(grid, tuple(read_run(out, point) for point in grid.points), theory)
        write_tables(phases, folder)
        if report:
            report(phases, folder, progress)
    return phases


def write_tables(phases: Phases, folder: Path) -> None:
    """Write the tables of a sweep: tidy measures (one row per run and measure), runs with health, theory per point."""
    grid = phases.grid
    axis_types = {axis.label: float if axis.numeric else str for axis in grid.axes}
    measure_rows, run_rows, theory_rows = [], [], []
    for run in phases.runs:
        run_cells = {"run": run.point.name, **_axis_values(grid, run.point.grid_index), "seed": run.point.seed}
        measure_keys = () if run.reason else RUN_MEASURES if AREA_OVER_FLAT in run.measures else RUN_MEASURES[:-1]
        measure_rows += [(*run_cells.values(), key, run.measures.get(key)) for key in measure_keys]
        run_rows.append(
            {
                **run_cells,
                "state": "failed" if run.reason else "done",
                "healthy": None if run.reason else not run.warnings,
                "warnings": "; ".join(run.warnings) or None,
                "reason": run.reason or None,
                **run.run_sizes,
                "log": f"logs/{run.point.name}.log",
            }
        )
    for grid_index in phases.runs_at:
        theory, final_growth = phases.theory[grid_index], grid.scenes[grid_index].growth.final
        theory_cells = (final_growth, theory.g_crit, theory.g_crease, theory.wavelength, theory.reason or None)
        theory_rows.append(_axis_values(grid, grid_index) | dict(zip(THEORY_COLUMNS, theory_cells)))
    write_measures(folder, {"run": str, **axis_types, "seed": int, "measure": str, "value": float}, [measure_rows])
    columns = ("run", *axis_types, "seed", "state", "healthy", "warnings", "reason", "elements", "steps", "log")
    write_table(folder / "runs.tsv", columns, run_rows)
    write_table(folder / "theory.tsv", (*axis_types, *THEORY_COLUMNS), theory_rows)


def _axis_values(grid: Grid, grid_index: GridIndex) -> Row:
    """The value on each axis; lists as text."""
    return {
        axis.label: axis.values[i] if isinstance(axis.values[i], int | float) else axis.texts[i]
        for axis, i in zip(grid.axes, grid_index)
    }
