"""One run of a sweep: grow a scene, and measure its last stage as ``analyze`` does."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numba

from morphofold import results, simulation
from morphofold.forecasts.cost import READING_STAGE
from morphofold.group.common_scales import Options, measure_as_asked
from morphofold.group.tasks import INPUT_ERRORS, Outcome, Say, TaskFolder, digest, perform
from morphofold.io import files_of, remove_folder
from morphofold.io.files import write_text
from morphofold.results.analyses import DrawPage
from morphofold.sim.dynamics import UnstableError
from morphofold.sim.output.run_files import clear_run, files_of_run, inputs_of
from morphofold.sim.run import Simulation
from morphofold.sim.scene import Scene
from morphofold.sim.scene.scene_files import to_toml
from morphofold.sim.sphere_theory.smooth_sphere import ConvergenceError
from morphofold.timing import Stages
from morphofold.words import in_one_line

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
    options: Options = field(default_factory=dict)

    @property
    def folder(self) -> Path:
        """Folder with its output: ``simulation`` and ``analysis``."""
        return Path(self.place.out) / RUNS_FOLDER / self.place.name

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
        parts = {"simulation": files_of_run(run.simulation), "analysis": files_of(run.analysis)}
        return {f"{part}/{name}": path for part, paths in parts.items() for name, path in paths.items()}

    def work(say: Say, changed: list[str]) -> dict[str, str]:
        run.folder.mkdir(parents=True, exist_ok=True)
        try:
            grown = _simulation_of_run(run, say, anew=any(name.startswith("simulation/") for name in changed))
            _analyse_last_stage(run, grown, say)
        except (ConvergenceError, UnstableError, *INPUT_ERRORS) as error:
            remove_folder(run.analysis)  # results of an earlier scene
            return {"": in_one_line(error)}
        return {}

    return perform(run.place, key, files, work)


def _simulation_digest(scene: Scene) -> str:
    """Digest of everything that a simulation depends on."""
    return digest({"scene": to_toml(scene), "inputs": inputs_of(scene)})


def _simulation_of_run(run: Run, say: Say, *, anew: bool) -> Simulation:
    """The simulation of a run: continued if it was begun with the same scene, otherwise grown from the start."""
    folder, mark, now, tenths = run.simulation, run.folder / "grown-of", _simulation_digest(run.scene), [0]

    def show(share: float, text: str) -> None:
        if (tenth := int(10 * share)) > tenths[0]:
            tenths[0] = tenth
            say(f"{share:4.0%}  {text}")

    def grow() -> Simulation:
        threads = min(run.threads, numba.config.NUMBA_NUM_THREADS)  # type: ignore[attr-defined]  # of a running worker
        return simulation.simulate(run.scene, folder, resume=True, threads=threads, progress=show)

    begun = folder.exists()
    if begun and (anew or not mark.is_file() or mark.read_text("utf-8", errors="replace") != now):
        say("its scene or its files have changed: it is grown again")
        clear_run(folder)
        begun = False
    write_text(mark, now)
    try:
        return grow()
    except ValueError as error:
        if not begun:
            raise
        say(f"{error} It is grown again.")  # the existing files are damaged
        clear_run(folder)
        return grow()


def _analyse_last_stage(run: Run, grown: Simulation, say: Say) -> None:
    """Write the analysis of the last stage."""
    clock = Stages()
    clock.begin(READING_STAGE)
    cortex = grown.cortex()
    stages = [grown.cortex(g) for g in grown.stages] if run.report else []
    clock.end()
    measures = measure_as_asked(cortex, run.options, clock, say)
    say("writing")
    parameters = {"hemi": None, "name": None, **run.options}
    results.write_analysis(
        [measures], run.analysis, parameters=parameters, report=run.report, stages=stages, clock=clock
    )
