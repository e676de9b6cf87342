"""Run a scene and write its simulation folder: stages, log, health, and checkpoints to resume a stopped run."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from morphofold import __version__
from morphofold.arrays import Array
from morphofold.errors import DamagedFile, DoesNotApply
from morphofold.io.files import decoding
from morphofold.io.folders import alone
from morphofold.progress import Progress, silent
from morphofold.sim.effects import own_effects
from morphofold.sim.interrupt import deferred_interrupt
from morphofold.sim.output.checkpoint import as_bytes, as_lines, check_marks, read_arrays, read_log
from morphofold.sim.output.folder import Describe, FolderWriter, Simulation, is_finished
from morphofold.sim.output.inputs import scene_digest, written_stages
from morphofold.sim.output.run_files import AND_GROW_AGAIN
from morphofold.sim.output.stages import check_reached
from morphofold.sim.output.volume import write_series, write_volume
from morphofold.sim.restart import check_mesh, restart_of, state_of
from morphofold.sim.scene import Radial, Scene, Strip
from morphofold.sim.scene.files import load_scene
from morphofold.threads import one_blas_thread, using_threads
from morphofold.timing import peak_memory, working_seconds

if TYPE_CHECKING:
    from morphofold.sim.dynamics import Dynamics
    from morphofold.sim.effects import Effect

__all__ = ["Progress", "Simulation", "simulate"]

Look = Callable[["Dynamics"], None]

RESTING_SHARE = 0.75  # share of its patience for which a body rests at a stage, about
TICKS_PER_UNIT_GROWTH = 150.0  # ticks that growth by 1 takes; both estimate the share of the work that is done
LOG_GROWTH_INTERVAL = 0.01  # growth between two lines of the log,
LOG_STEP_INTERVAL = 100  # or steps
STAGE_NUMBERS = (
    "step",
    "strain_energy",
    "kinetic_energy",
    "kinetic_over_strain",
    "dissipated_energy",
    "distance_over_T",
    "at_rest",
    "min_J",
)


@one_blas_thread()
def simulate(
    source: str | Path | Scene,
    out: str | Path | None = None,
    *,
    settings: Iterable[str] = (),
    resume: bool = False,
    threads: int | None = None,
    progress: Progress = silent,
    describe: Describe = lambda cortex: {},
    effects: Iterable[Effect] = (),
    after: Look | None = None,
    restart_from: str | Path | None = None,
) -> Simulation:
    """Grow a scene and write its simulation folder.

    Parameters
    ----------
    source : str, Path or Scene
        Name of a built-in scene, a TOML file, or a scene.
    out : str or Path, optional
        Folder to write; by default the scene's name in the working directory.
    settings : iterable of str
        Settings such as ``"growth.final=1.8"``, which override the scene.
    resume : bool
        Resume from the checkpoint in ``out``; a finished run of the same scene is returned as it is.
    threads : int, optional
        Threads of the kernels; the result is bitwise the same for any number.
    progress : callable
        Called with the share done (0 to 1) and a line of text.
    describe : callable
        Returns per-vertex maps by name from the ``Cortex`` of a stage, to write beside its surfaces. The solver itself
        measures nothing.
    effects : iterable of Effect
        Your own effects, new instances for each run. They act after those of the scene. The folder records their names,
        and a run can be resumed only with effects of the same names. Not in one dimension.
    after : callable
        Called every ``STEPS_PER_MEASUREMENT`` steps with the ``Dynamics``. It may read ``state`` and ``body`` but not
        change them. Not in one dimension.
    restart_from : str or Path, optional
        Folder of another run, or of one of its stages. The run begins at its positions and growth. It takes the
        velocities of a checkpoint, too, unless either run has inertia. The mesh must be the same, all else may differ.
        The state of effects is not taken. Stages of a smaller growth are not written. A resumed run knows where it
        began. Not in one dimension.

    Returns
    -------
    Simulation

    Raises
    ------
    ValueError, FileNotFoundError
        If the scene, an effect or the state to restart from cannot be read; nothing is written then. Also if the run to
        resume is damaged, or the scene's mesh file has changed since the run began.
    FileExistsError
        If ``out`` holds something else, or a run without ``resume``, or another run is writing there.
    UnstableError
        If the run leaves its bounds; the last checkpoint and the stages so far stay.
    KeyboardInterrupt
        At Ctrl-C or SIGTERM, once a checkpoint is written; a second signal stops at once. A signal after the run is
        complete still stops what would follow.
    """
    scene = load_scene(source, settings)
    folder = Path(scene.name if out is None else out)
    own = own_effects(effects)
    names = [effect.name for effect in own]
    if isinstance(scene.geometry, Radial) and (own or after or restart_from):
        raise DoesNotApply(
            f"{scene.name}: a radial scene has no steps. Leave out the options effects, after, restart_from."
        )
    with deferred_interrupt() as interrupted, using_threads(threads):
        if is_finished(folder, scene, resume, names, restart_from):
            with suppress(OSError):  # a folder that is not writable goes without
                write_series(folder, scene)
        else:
            with alone(folder):
                if not is_finished(folder, scene, resume, names, restart_from):  # another run may have been first
                    restart = restart_of(folder, scene, restart_from)
                    writer = FolderWriter(folder, scene, describe, resume, names, restart)
                    added = {"effects": own, "look": after} if own or after else {}
                    _run_class_of(scene)(scene, writer, progress, interrupted, **added).go()  # builds before it writes
    return Simulation(folder, scene)


def _run_class_of(scene: Scene) -> Any:
    """The class that grows a scene; a scene in one dimension never imports the solver in three dimensions."""
    if isinstance(scene.geometry, Radial):
        from morphofold.sim.radial_run import RadialRun

        return RadialRun
    return _Run


class _Run:
    """One run: the body, its dynamics, and the folder that it writes."""

    def __init__(
        self,
        scene: Scene,
        writer: FolderWriter,
        progress: Progress,
        interrupted: Callable[[], bool],
        effects: Sequence[Effect] = (),
        look: Look | None = None,
    ):
        from morphofold.sim.build import build_body
        from morphofold.sim.dynamics import Dynamics
        from morphofold.sim.effects import build_effects

        self.scene, self.writer, self.progress, self.interrupted = scene, writer, progress, interrupted
        self.started, self.look = working_seconds(), look
        effects = [*build_effects(scene), *effects]
        self.body = build_body(scene, effects)
        start = (
            None
            if writer.restart is None or writer.checkpoint_to_resume
            else state_of(writer.restart, self.body, scene)
        )
        self.dynamics = Dynamics.of(scene, self.body, effects, start)
        self.log: list[dict[str, Any]] = []
        self.counted: tuple[int, int | None] = (-1, None)  # step of the last count of unstable modes, and their number
        self.checkpoint_due = time.perf_counter() + 60 * scene.output.checkpoint_minutes

    def go(self) -> None:
        from morphofold.sim.dynamics import UnstableError

        self.writer.begin()
        self._take_up()
        try:
            with self.writer.telling_a_full_disk(lambda: self.dynamics.state.growth):
                self._grow()
        except UnstableError as error:
            self.writer.log(self.log)
            self.writer.arrays("last-sound-state.npz", error.sound)
            raise

    def _grow(self) -> None:
        from morphofold.sim.health import broken_bounds

        stages = []
        for g in written_stages(self.writer.out, self.scene):
            self.dynamics.grow_to(max(g, self.dynamics.state.growth), self._after)  # a resumed run may be beyond
            if self.dynamics.state.growth == g:
                self.dynamics.settle(self._after, self._unstable_modes)
                self._note()
            stages.append(self._write_stage(g))
        self.writer.log(self.log)
        body = self.body
        self.writer.health(
            stages,
            [sentence for stage in stages for sentence in broken_bounds(stage, self.scene)],
            elements=body.elements.n,
            nodes=len(body.X),
            surface_edge_mm=body.bilayer.edge,
            steps=self.dynamics.state.step,
            seconds=round(self._elapsed(), 2),
            seconds_by_phase={k: round(v, 3) for k, v in self.dynamics.seconds.items()},
            threads=self.dynamics.threads,
            peak_memory_GiB=peak_memory(),
        )
        (self.writer.out / "checkpoint.npz").unlink(missing_ok=True)
        self.progress(1.0, "done")

    def _share(self, state: Any) -> float:
        """Share of the run that is done, from the ticks of growth and of rest."""
        from morphofold.sim.dynamics import patience

        stages, per_unit = self.scene.stages, TICKS_PER_UNIT_GROWTH / self.scene.growth.rate
        rests = [patience()] + [patience(per_unit * (b - a)) for a, b in pairwise(stages)]
        whole = per_unit * (stages[-1] - 1) + RESTING_SHARE * sum(rests)
        done = sum(RESTING_SHARE * rest for rest, g in zip(rests, stages) if g < state.growth)
        now = sum(RESTING_SHARE * rest for rest, g in zip(rests, stages) if g == state.growth)
        return (per_unit * (state.growth - 1) + done + min(now, state.relaxed / self.body.crossing)) / whole

    def _after(self, state: Any) -> None:
        """Between steps: progress, log, checkpoint."""
        record, distance = state.record, state.record["distance_over_T"]
        self.progress(
            0.99 * self._share(state),
            f"g {state.growth:.3f}, min J {record['min_J']:.2f}"
            + ("" if distance is None else f", {distance:.2f} T from rest"),
        )
        last = self.log[-1] if self.log else {"growth": 0.0, "step": 0}
        if state.growth - last["growth"] >= LOG_GROWTH_INTERVAL or state.step - last["step"] >= LOG_STEP_INTERVAL:
            self._note()
        if self.look is not None:
            self.look(self.dynamics)
        if self.interrupted():
            self._checkpoint()
            raise KeyboardInterrupt
        if time.perf_counter() > self.checkpoint_due:
            self._checkpoint()

    def _note(self) -> None:
        seconds = {k: round(v, 3) for k, v in self.dynamics.seconds.items()}
        self.log.append({**self.dynamics.state.record, "elapsed": round(self._elapsed(), 3), "seconds": seconds})

    def _elapsed(self) -> float:
        """Wall seconds of this run, including those before a stop, without compiling."""
        return working_seconds() - self.started

    def _checkpoint(self) -> None:
        self.writer.log(self.log)
        self.writer.arrays("checkpoint.npz", {**self.dynamics.save(), **self._marks()})
        self.checkpoint_due = time.perf_counter() + 60 * self.scene.output.checkpoint_minutes

    def _marks(self) -> dict[str, NDArray[Any]]:
        """What identifies the run of a checkpoint: its scene and mesh, its version, and its log so far."""
        marks = {"scene": scene_digest(self.writer.out), "version": __version__, "log": as_lines(self.log)}
        of_bytes = {name: as_bytes(text) for name, text in marks.items()}
        return {**of_bytes, "lines": np.array(len(self.log)), "reference": self.body.X}

    def _take_up(self) -> None:
        """Resume from a checkpoint, if that is asked for and there is one."""
        out, path = self.writer.out, self.writer.checkpoint_to_resume
        if path is None:
            return
        mine = self._marks()
        check_marks(path, mine)
        arrays = read_arrays(path, {**self.dynamics.save(), **mine})
        check_mesh(path, arrays["reference"], self.body.X, self.scene)  # own effects may give the body another shape
        growth, final = arrays["growth"].item(), self.scene.growth.final
        with decoding(path, "a checkpoint of this run", f"Delete it {AND_GROW_AGAIN}."):
            if not 1 <= growth <= final:
                raise DamagedFile(f"g = {growth:g} is not between 1 and {final:g}")
            self.dynamics.load(arrays)  # a state out of its bounds was never saved
        check_reached(out, self.scene, growth)
        self.log = read_log(out, arrays["lines"].item(), arrays["log"])
        if self.log:
            self.started -= self.log[-1]["elapsed"]
            self.dynamics.seconds.update(self.log[-1]["seconds"])

    def _write_stage(self, g: float) -> dict[str, Any]:
        """Write surfaces, maps and volume of the present state; returns its numbers for health.json."""
        from morphofold.sim.health import bending, broken_bounds, check_surface, enclosed_volume
        from morphofold.sim.output.surfaces import whole_surfaces, write_labels

        before = self.writer.health_of(g)
        if before is not None:  # written before a stop
            return before
        body, state = self.body, self.dynamics.state
        white, pial = whole_surfaces(body, state.x)
        closed = body.bilayer.closed
        grown = float(np.sum(body.grown_volumes())) / body.bilayer.portion
        between = closed and body.bilayer.faces.shape[1] == 4  # the white surface cuts through tetrahedra
        found = enclosed_volume(pial) - enclosed_volume(white) if between else self._cortex_volume()

        def write_beside(folder: Path) -> None:
            write_labels(folder, body, white)
            self._write_volume(folder)

        numbers = {
            "growth": g,
            **{name: state.record[name] for name in STAGE_NUMBERS},
            "lowest_J": state.lowest_J,
            "rested_steps": state.relaxed,
            "unstable_modes": self._unstable_modes(),
            **check_surface(pial, closed),
            "cell_over_T": self._cell_over_T(g),
            "bending": bending(self._first_pial, pial.verts) if closed else None,
            "volume_drift": abs(found / grown - 1),
            "mean_radius_mm": float(np.linalg.norm(pial.verts, axis=1).mean()) if closed else None,
        }
        self.writer.stage(
            g,
            white,
            pial,
            portion=body.bilayer.portion,
            reference_radius=float(np.linalg.norm(body.X[: body.n_surface], axis=1).mean()),
            numbers=numbers,
            warnings=broken_bounds(numbers, self.scene),
            beside=write_beside,
        )
        return numbers

    @cached_property
    def _first_pial(self) -> Array:
        """Positions (S, 3) of the whole pial surface before growth [mm]."""
        from morphofold.sim.output.surfaces import whole_surfaces

        return whole_surfaces(self.body, self.body.X)[1].verts

    def _unstable_modes(self) -> int | None:
        """Unstable modes of the present state, if asked for or by default in a strip; None if they can't be counted."""
        asked = self.scene.output.stability
        wanted = isinstance(self.scene.geometry, Strip) if asked is None else asked
        if not wanted or not self.dynamics.waits_for_balance:
            return None
        from morphofold.sim.equilibrium.unstable import unstable_modes

        step = self.dynamics.state.step
        if self.counted[0] != step:
            self.counted = step, None
            with suppress(MemoryError, ZeroDivisionError):  # too large, or a mode of zero stiffness
                self.counted = step, unstable_modes(self.dynamics)
        return self.counted[1]

    def _cell_over_T(self, g: float) -> float | None:
        """Largest edge of the ungrown pial surface or height of a brick of the cortex, over T.

        None before first wrinkles, because a smooth body is right on any mesh, and for tetrahedra, whose meshes have
        not been compared.
        """
        from morphofold.sim.equilibrium.wrinkles import first_wrinkles

        body, faces = self.body, self.body.bilayer.faces
        if faces.shape[1] == 3 or g <= first_wrinkles(self.scene).growth:
            return None
        return max(body.bilayer.edge / body.thickness, len(faces) / body.elements.n_cortex)

    def _cortex_volume(self) -> float:
        """Present volume of the elements of the cortex [mm^3]."""
        body = self.body
        present = body.grown_volumes() * body.elements.state()["volume_ratio"][: body.elements.n_cortex]
        return float(np.sum(present)) / body.bilayer.portion

    def _write_volume(self, folder: Path) -> None:
        if self.scene.output.volume:
            write_volume(folder, self.body, self.dynamics.state.x)
