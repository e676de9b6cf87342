"""Run a scene and write its simulation folder: stages, log, health, and checkpoints to resume a stopped run."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from morphofold.errors import DoesNotApply
from morphofold.io.atomic_folders import alone
from morphofold.progress_callbacks import Progress, logged
from morphofold.sim.effects import Effect, own_effects
from morphofold.sim.output.checkpoint import restart_of
from morphofold.sim.output.simulation_folder import Describe, FolderWriter, Simulation, is_finished
from morphofold.sim.output.stage_records import write_series
from morphofold.sim.scene import Radial, Scene
from morphofold.sim.scene.scene_files import load_scene
from morphofold.threads import one_blas_thread, using_threads

if TYPE_CHECKING:
    from morphofold.sim.dynamics import Dynamics

HANG_UP = getattr(signal, "SIGHUP", None)  # Windows has none


@one_blas_thread()
def simulate(
    source: str | Path | Scene,
    out: str | Path | None = None,
    *,
    settings: Iterable[str] = (),
    resume: bool = False,
    threads: int | None = None,
    progress: Progress = logged,
    describe: Describe = lambda cortex: {},
    effects: Iterable[Effect] = (),
    after: Callable[[Dynamics], None] | None = None,
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
    callers_effects = own_effects(effects)
    effect_names = [effect.name for effect in callers_effects]
    is_radial = isinstance(scene.geometry, Radial)
    if is_radial and (callers_effects or after or restart_from):
        raise DoesNotApply(
            f"{scene.name}: a radial scene has no steps. Leave out the options effects, after, restart_from."
        )
    with deferred_interrupt() as interrupted, using_threads(threads):
        if is_finished(folder, scene, resume, effect_names, restart_from):
            with suppress(OSError):  # a folder that is not writable goes without
                write_series(folder, scene)
            return Simulation(folder, scene)
        with alone(folder):
            restart_entry = restart_of(folder, scene, restart_from)
            writer = FolderWriter(folder, scene, describe, resume, effect_names, restart_entry)
            run_class: Any
            if is_radial:  # it never imports the solver in three dimensions
                from morphofold.sim.radial_run import RadialRun as run_class
            else:
                from morphofold.sim.body_run import BodyRun as run_class
            run_class(scene, writer, progress, interrupted, callers_effects, after).go()
    return Simulation(folder, scene)


@contextmanager
def deferred_interrupt() -> Iterator[Callable[[], bool]]:
    """Hold back SIGINT, SIGTERM and SIGHUP; yields a function that returns whether one came. A second acts at once.

    Signals that are ignored (SIGHUP under nohup) stay ignored. A second SIGHUP does not count: a terminal and its shell
    both send one when they close. Only the main thread can hold signals; in other threads nothing is held and the
    function returns False.
    """
    if threading.current_thread() is not threading.main_thread():
        yield lambda: False
        return
    received_signals: list[int] = []

    def hold(signal_number: int, frame: object) -> None:
        if received_signals and signal_number != HANG_UP:
            raise KeyboardInterrupt
        received_signals.append(signal_number)

    signals = [n for n in (signal.SIGINT, signal.SIGTERM, HANG_UP) if n and signal.getsignal(n) != signal.SIG_IGN]
    old_handlers = {signal_id: signal.signal(signal_id, hold) for signal_id in signals}
    try:
        yield lambda: bool(received_signals)
    finally:
        for signal_id, handler in old_handlers.items():
            signal.signal(signal_id, handler)
    if received_signals:  # too late to stop the work, but it stops what comes after
        raise KeyboardInterrupt
