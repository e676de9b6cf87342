"""A scene in three dimensions: its body grows step by step, with a log and checkpoints between the stages."""

import time
from contextlib import suppress
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from morphofold import __version__
from morphofold.digests_and_json import Row
from morphofold.frozen_arrays import Array
from morphofold.sim.build import build_body
from morphofold.sim.dynamics import Dynamics, State, UnstableError, patience
from morphofold.sim.equilibrium.statics import unstable_modes
from morphofold.sim.equilibrium.wrinkle_onset import first_wrinkles
from morphofold.sim.nested_meshes import NestedDynamics
from morphofold.sim.output import checkpoint
from morphofold.sim.output.run_inputs import scene_digest, written_stages
from morphofold.sim.output.simulation_folder import Run
from morphofold.sim.output.stage_records import check_written, write_volume
from morphofold.sim.output.stage_surfaces import whole_surfaces, write_labels
from morphofold.sim.scene import Strip
from morphofold.sim.stage_checks import bending, broken_bounds, check_surface, enclosed_volume
from morphofold.timing import peak_memory

REST_OVER_PATIENCE = 0.75  # share of its patience for which a body rests at a stage, about
TICKS_PER_UNIT_GROWTH = 150.0  # ticks that growth by 1 takes; both estimate the share of the work that is done
LOG_GROWTH_INTERVAL = 0.01  # growth between two lines of the log,
LOG_STEP_INTERVAL = 100  # or steps
WORK_GROWTH_INTERVAL = 0.02  # growth between two evaluations of its power, which take as long as two steps
LOG_ONLY = ("growth", "max_J", "inverted", "mean_volume_ratio", "effects")  # numbers of a state that stages leave out


class BodyRun(Run):
    """One run of a body; ``after`` is called every ``STEPS_PER_MEASUREMENT`` steps."""

    def build(self) -> None:
        self.not_nested = self.scene.not_nested
        if self.writer.own or self.writer.restart:
            self.not_nested = "effects of one's own, and states of other runs, are not carried to another mesh"
        self.dynamics: Dynamics | NestedDynamics
        if self.not_nested:
            self.body = build_body(self.scene, self.effects)
            restart_entry = None if self.writer.checkpoint_to_resume else self.writer.restart
            start_state = checkpoint.state_of(restart_entry, self.body, self.scene) if restart_entry else None
            self.dynamics = Dynamics.of(self.scene, self.body, self.effects, start_state)
        else:
            self.dynamics = NestedDynamics(self.scene, self.effects)
            self.body = self.dynamics.fine.body
        self.mode_count: tuple[int, int | None] = (-1, None)  # step of the last count of unstable modes, and how many
        self.checkpoint_due = time.perf_counter() + 60 * self.scene.output.checkpoint_minutes

    def go(self) -> None:
        try:
            super().go()
        except UnstableError as error:
            self.writer.log(self.log)
            self.writer.arrays("last-sound-state.npz", error.sound)
            raise

    def grow_to(self, g: float) -> None:
        self.dynamics.grow_to(max(g, self.dynamics.state.growth), self._after_steps)  # a resumed run may be beyond
        if self.dynamics.state.growth == g:
            self.dynamics.settle(self._after_steps, self._unstable_modes)
            self._note()

    def warnings(self, numbers: Row) -> list[str]:
        return broken_bounds(numbers, self.scene)

    def cost(self) -> Row:
        return {
            "elements": self.body.elements.n,
            **self._meshes(),
            "nodes": len(self.body.X),
            "surface_edge_mm": self.body.bilayer.edge,
            "steps": self.dynamics.state.step,
            "seconds": round(self.elapsed, 2),
            "seconds_by_phase": self._seconds_by_phase(),
            "threads": self._running.threads,
            "peak_memory_GiB": peak_memory(),
        }

    def _meshes(self) -> Row:
        """The coarse one of two meshes; or why a run at ``fine`` has none."""
        if isinstance(self.dynamics, NestedDynamics):
            return {"coarse_elements": self.dynamics.coarse.body.elements.n}
        return {"not_nested": self.not_nested} if self.scene.accuracy.level == "fine" else {}

    @property
    def _running(self) -> Dynamics:
        """The dynamics on the mesh that is under way."""
        return self.dynamics.run if isinstance(self.dynamics, NestedDynamics) else self.dynamics

    def _seconds_by_phase(self) -> dict[str, float]:
        return {phase: round(seconds, 3) for phase, seconds in self.dynamics.seconds.items()}

    def _share_done(self, state: State) -> float:
        """Share of the run that is done, from the ticks of growth and of rest."""
        stages, unit_ticks = self.scene.stages, TICKS_PER_UNIT_GROWTH / self.scene.growth.rate
        patience_ticks = [patience(), *(patience(unit_ticks * (end - start)) for start, end in pairwise(stages))]
        rest_ticks = [REST_OVER_PATIENCE * patience_of_stage for patience_of_stage in patience_ticks]
        all_ticks = unit_ticks * (stages[-1] - 1) + sum(rest_ticks)
        rested = sum(ticks for ticks, g in zip(rest_ticks, stages) if g < state.growth)
        resting = sum(ticks for ticks, g in zip(rest_ticks, stages) if g == state.growth)
        return (unit_ticks * (state.growth - 1) + rested + min(resting, state.relaxed / self.body.crossing)) / all_ticks

    def _after_steps(self, state: State) -> None:
        """Between steps: progress, log, checkpoint."""
        self.growth, record, distance_over_T = state.growth, state.record, state.record["distance_over_T"]
        self.progress(
            0.99 * self._share_done(state),
            f"g {state.growth:.3f}, min J {record['min_J']:.2f}"
            + ("" if distance_over_T is None else f", {distance_over_T:.2f} T from rest"),
        )
        entry = self.log[-1] if self.log else {"growth": 0.0, "step": 0}
        if state.growth - entry["growth"] >= LOG_GROWTH_INTERVAL or state.step - entry["step"] >= LOG_STEP_INTERVAL:
            self._note()
        if self.after is not None:
            self.after(self._running)
        must_stop = self.interrupted()
        if must_stop or time.perf_counter() > self.checkpoint_due:
            self.writer.log(self.log)
            self.writer.arrays("checkpoint.npz", self._checkpoint())
            self.checkpoint_due = time.perf_counter() + 60 * self.scene.output.checkpoint_minutes
        if must_stop:
            raise KeyboardInterrupt

    def _note(self) -> None:
        run, so_far = self._running, {"elapsed": round(self.elapsed, 3), "seconds": self._seconds_by_phase()}
        self.log.append({**run.state.record, **self._work(), "elements": run.body.elements.n, **so_far})

    def _work(self) -> Row:
        """The work that growth has done, by the trapezoidal rule, and its slope by growth where it was last taken."""
        growth = self.dynamics.state.growth
        if not self.log:
            return {"work": 0.0, "work_slope": self._running.energy_slope(), "work_growth": growth}
        work = {key: self.log[-1][key] for key in ("work", "work_slope", "work_growth")}
        increment = growth - work["work_growth"]
        if increment < (1e-9 if growth in self.scene.stages else WORK_GROWTH_INTERVAL):
            return work
        slope = self._running.energy_slope()
        new_work = work["work"] + 0.5 * increment * (slope + work["work_slope"])
        return {"work": new_work, "work_slope": slope, "work_growth": growth}

    def _checkpoint(self) -> dict[str, NDArray[Any]]:
        """The state of the run, and what identifies it: its scene and mesh, its version, and its log so far."""
        texts = {"scene": scene_digest(self.writer.out), "version": __version__, "log": checkpoint.as_lines(self.log)}
        bytes_by_name = {name: checkpoint.as_bytes(text) for name, text in texts.items()}
        return {**self.dynamics.save(), **bytes_by_name, "lines": np.array(len(self.log)), "reference": self.body.X}

    def resume(self) -> None:
        run_folder, path = self.writer.out, self.writer.checkpoint_to_resume
        if path is None:
            return
        arrays = checkpoint.read_checkpoint(path, self._checkpoint())
        checkpoint.check_mesh(path, arrays["reference"], self.body.X, self.scene)  # own effects may reshape the body
        self.growth = arrays["growth"].item()
        check_written(run_folder, [g for g in written_stages(run_folder, self.scene) if g < self.growth], path)
        self.log = checkpoint.read_log(run_folder, arrays["lines"].item(), arrays["log"])
        self.dynamics.load(arrays)
        if self.log:
            self.started -= self.log[-1]["elapsed"]
            self._running.seconds.update(self.log[-1]["seconds"])

    def write_stage(self, g: float) -> Row:
        """Write surfaces, maps and volume of the present state; returns its numbers for health.json."""
        body, state, bilayer = self.body, self.dynamics.state, self.body.bilayer
        white, pial, images = whole_surfaces(body, state.x)
        is_closed = bilayer.closed
        grown_volumes = body.grown_volumes()
        if is_closed and bilayer.faces.shape[1] == 4:
            cortex_volume = enclosed_volume(pial) - enclosed_volume(white)
        else:  # the white surface cuts through tetrahedra
            element_ratios = body.elements.state()["volume_ratio"][: body.elements.n_cortex]
            cortex_volume = float(np.sum(grown_volumes * element_ratios)) / bilayer.portion
        numbers = {
            "growth": g,
            **{name: value for name, value in state.record.items() if name not in LOG_ONLY},
            "lowest_J": state.lowest_J,
            "rested_steps": state.relaxed,
            "unstable_modes": self._unstable_modes(),
            **check_surface(pial, is_closed, n_tested=body.n_surface),
            **self._resolution(g),
            "bending": bending(self._first_pial, pial.verts) if is_closed else None,
            "volume_drift": abs(cortex_volume / (float(np.sum(grown_volumes)) / bilayer.portion) - 1),
            "mean_radius_mm": float(np.linalg.norm(pial.verts, axis=1).mean()) if is_closed else None,
        }

        def add_files(folder: Path) -> None:
            write_labels(folder, body, white)
            if self.scene.output.volume:
                write_volume(folder, body, state.x)

        self.writer.stage(
            g,
            white,
            pial,
            portion=bilayer.portion,
            images=images,
            reference_radius=float(np.linalg.norm(body.X[: body.n_surface], axis=1).mean()),
            numbers=numbers,
            warnings=self.warnings(numbers),
            add_files=add_files,
        )
        return numbers

    @cached_property
    def _first_pial(self) -> Array:
        """Positions (S, 3) of the whole pial surface before growth [mm]."""
        return whole_surfaces(self.body, self.body.X)[1].verts

    def _unstable_modes(self) -> int | None:
        """Unstable modes of the present state, if asked for or by default in a strip; None if they can't be counted."""
        must_count = self.scene.output.stability
        if must_count is None:
            must_count = isinstance(self.scene.geometry, Strip)
        if not must_count or not self._running.waits_for_balance:
            return None
        step = self.dynamics.state.step
        if self.mode_count[0] != step:
            self.mode_count = step, None
            with suppress(MemoryError, ZeroDivisionError):  # too large, or a mode of zero stiffness
                self.mode_count = step, unstable_modes(self._running)
        return self.mode_count[1]

    def _resolution(self, g: float) -> dict[str, float | None]:
        """Largest edge of the ungrown pial surface or height of a brick of the cortex, over T; that edge over the
        length of the first wrinkles, if theory has one.

        None before first wrinkles, because a smooth body is right on any mesh, and for tetrahedra, whose meshes have
        not been compared.
        """
        body, quads, wrinkles = self.body, self.body.bilayer.faces, first_wrinkles(self.scene)
        if quads.shape[1] == 3 or g <= wrinkles.growth:
            return {"cell_over_T": None, "cell_over_wave": None}
        edge_over_T = body.bilayer.edge / body.thickness
        # 0 where the shortest waves come first, NaN where theory has none
        over_wave = edge_over_T / wrinkles.wavelength_over_T if wrinkles.wavelength_over_T > 0 else None
        return {"cell_over_T": max(edge_over_T, len(quads) / body.elements.n_cortex), "cell_over_wave": over_wave}
