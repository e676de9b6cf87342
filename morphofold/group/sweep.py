"""One run of a sweep: grow a scene, and measure its last stage as ``analyze`` does."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from morphofold.group.measure_options import measure_as_asked
from morphofold.group.tasks import INPUT_ERRORS, Outcome, Say, TaskFolder, digest, perform
from morphofold.io import files_of, remove_folder
from morphofold.io.files import write_text
from morphofold.results.analyses import DrawPage
from morphofold.sim.output.run_files import clear_run, files_of_run, inputs_of
from morphofold.sim.scene import Ellipsoid, MeshFile, Radial, Scene, Sphere, UnfoldedCortex
from morphofold.sim.scene.files import to_toml
from morphofold.words import in_one_line

if TYPE_CHECKING:
    from morphofold.sim.run import Simulation

RUNS_FOLDER = "runs"


@dataclass(frozen=True)
class Run:
    """A scene to grow and to measure.

    Attributes
    ----------
    place : TaskFolder
    scene : Scene
    threads : int
        Threads of its worker.
    report : callable or False
        Draws its own page and pictures, as for :func:`morphofold.results.write_analysis`.
    options : mapping
        ``curvature_scale_mm``, ``gyral_width_mm``, ``thickness_cap_mm`` and ``accuracy``, as for ``analyze``.
    """

    place: TaskFolder
    scene: Scene
    threads: int = 1
    report: DrawPage | Literal[False] = False
    options: Mapping[str, Any] = field(default_factory=dict)

    @property
    def folder(self) -> Path:
        """Folder with its output: ``simulation`` and ``analysis``."""
        return folder_of(Path(self.place.out), self.place.name)

    @property
    def simulation(self) -> Path:
        return self.folder / "simulation"

    @property
    def analysis(self) -> Path:
        return self.folder / "analysis"


def folder_of(out: Path, name: str) -> Path:
    """The folder of a run of a sweep."""
    return out / RUNS_FOLDER / name


def grow_and_measure(run: Run) -> Outcome:
    """Grow a scene and measure its last stage, unless this was done for the same scene with the same options.

    Only what has changed is done again: other measuring options do not grow the scene again. An unfinished simulation
    continues from its checkpoint. A simulation that leaves its bounds has failed; its output up to there is kept.
    """

    def key() -> str:
        return digest({"grown": _simulation_digest(run.scene), "report": bool(run.report), **run.options})

    def files() -> dict[str, Path]:
        parts = {"simulation": files_of_run(run.simulation), "analysis": files_of(run.analysis)}
        return {f"{part}/{name}": path for part, found in parts.items() for name, path in found.items()}

    return perform(run.place, key, files, lambda say, changed: _grow_and_measure_run(run, say, changed))


def _simulation_digest(scene: Scene) -> str:
    """Digest of everything that a simulation depends on."""
    return digest({"scene": to_toml(scene), "inputs": inputs_of(scene)})


def _grow_and_measure_run(run: Run, say: Say, changed: list[str]) -> dict[str, str]:
    from morphofold.sim.dynamics import UnstableError
    from morphofold.sim.sphere_theory.smooth_sphere import ConvergenceError

    run.folder.mkdir(parents=True, exist_ok=True)
    try:
        _analyse_last_stage(
            run, _simulation_of_run(run, say, anew=any(name.startswith("simulation/") for name in changed)), say
        )
    except (ConvergenceError, UnstableError, *INPUT_ERRORS) as error:
        remove_folder(run.analysis)  # results of an earlier scene
        return {"": in_one_line(error)}
    return {}


def _simulation_of_run(run: Run, say: Say, *, anew: bool) -> Simulation:
    """The simulation of a run: continued if it was begun with the same scene, otherwise grown from the start."""
    from morphofold.simulation import simulate

    now, mark, tenths = _simulation_digest(run.scene), run.folder / "grown-of", [0]

    def show(share: float, text: str) -> None:
        if (tenth := int(10 * share)) > tenths[0]:
            tenths[0] = tenth
            say(f"{share:4.0%}  {text}")

    def grow() -> Simulation:
        return simulate(run.scene, run.simulation, resume=True, threads=_available_threads(run), progress=show)

    begun = run.simulation.exists()
    if begun and (anew or _text_or_empty(mark) != now):
        say("its files have changed: it is grown again" if anew else "the scene has changed: it is grown again")
        clear_run(run.simulation)
        begun = False
    write_text(mark, now)
    try:
        return grow()
    except ValueError as error:
        if not begun:
            raise
        say(f"{error} It is grown again.")  # the existing files are damaged
        clear_run(run.simulation)
        return grow()


def _text_or_empty(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8") if path.is_file() else ""
    except (OSError, ValueError):
        return ""


def _available_threads(run: Run) -> int:
    """The requested threads, or as many as an already running worker can have."""
    import numba

    return min(run.threads, numba.config.NUMBA_NUM_THREADS)  # type: ignore[attr-defined,no-any-return]


def _analyse_last_stage(run: Run, simulation: Simulation, say: Say) -> None:
    """Write the analysis of the last stage."""
    from morphofold.forecasts.cost import READING_STAGE
    from morphofold.results import write_analysis
    from morphofold.timing import Stages

    clock = Stages()
    clock.begin(READING_STAGE)
    cortex = simulation.cortex()
    asked = {"hemi": None, "name": None, **run.options}
    stages = [simulation.cortex(g) for g in simulation.stages] if run.report else []
    clock.end()

    found = measure_as_asked(cortex, run.options, clock, say)
    say("writing")
    write_analysis([found], run.analysis, parameters=asked, report=run.report, stages=stages, clock=clock)


def memory_of_run(scene: Scene, accuracy: str, report: bool) -> float:
    """Expected peak memory of growing and measuring a scene [GiB]; 0 (not known) for a mesh from a file."""
    from morphofold.forecasts.cost import memory_of_analysis
    from morphofold.forecasts.sizes import memory_of_run as memory_of_growing
    from morphofold.forecasts.sizes import sizes_by_rule

    geometry = scene.geometry
    if isinstance(geometry, MeshFile):
        return 0.0
    if isinstance(geometry, Radial):
        return memory_of_analysis([2562], accuracy=accuracy, report=report)
    if isinstance(geometry, Sphere):
        deep = geometry.radius - geometry.hole_radius
    elif isinstance(geometry, Ellipsoid | UnfoldedCortex):
        deep = min(geometry.semi_axes) * (1 - geometry.hole_share)
    else:
        deep = geometry.depth
    sizes = sizes_by_rule(scene, (geometry.cortex_thickness, deep - geometry.cortex_thickness))
    return max(memory_of_growing(scene, sizes), memory_of_analysis([sizes.vertices], accuracy=accuracy, report=report))
