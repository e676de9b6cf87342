"""Scene in, simulation folder out: stages, log, health, checkpoints that a stopped run goes on from."""

from __future__ import annotations

import errno
import io
import json
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from morphofold import __version__
from morphofold.io import atomic_file, atomic_folder, read_cortex, write_morph, write_surface
from morphofold.sim.growth import volume as det_G
from morphofold.sim.interrupt import deferred_interrupt
from morphofold.sim.scene import Scene, load_scene
from morphofold.surface import Cortex
from morphofold.threads import set_threads

Progress = Callable[[float, str], None]
Describe = Callable[[Cortex], Mapping[str, NDArray[np.float64]]]

RELAXATION = 0.15       # steps at the final growth, as a share of the steps of the whole ramp to it
LOG_EVERY = 0.01        # growth between two lines of the log,
LOG_STEPS = 100         # or steps


@dataclass(frozen=True)
class Simulation:
    """A folder of growth stages."""

    path: Path
    scene: Scene

    @property
    def stages(self) -> tuple[float, ...]:
        """Growth stretches whose surfaces are written, ascending."""
        return tuple(sorted(float(p.name[1:]) for p in (self.path / "stages").glob("g*")))

    @property
    def health(self) -> dict[str, Any]:
        """Contents of ``health.json``."""
        return json.loads((self.path / "health.json").read_text())

    def cortex(self, g: float | None = None) -> Cortex:
        """The surfaces at growth stretch ``g``, by default the final one."""
        return read_cortex(stage_folder(self.path, self.stages[-1] if g is None else g))


def stage_folder(out: Path, g: float) -> Path:
    return out / "stages" / f"g{g:.2f}"


def simulate(
    source: str | Path | Scene,
    out: str | Path | None = None,
    *,
    settings: Iterable[str] = (),
    resume: bool = False,
    threads: int | None = None,
    progress: Progress = lambda share, text: None,
    describe: Describe = lambda cortex: {},
) -> Simulation:
    """Grow a scene and write its simulation folder.

    Parameters
    ----------
    source : str, Path or Scene
        A built-in scene's name, a TOML file, or a scene.
    out : str or Path, optional
        Folder to write; by default the scene's name in the working directory.
    settings : iterable of str
        ``"growth.final=1.8"`` and the like, put over the scene.
    resume : bool
        Go on from the checkpoint in ``out``; a finished run of the same scene is returned as it is.
    threads : int, optional
        Threads of the kernels; the result is bitwise the same for any number.
    progress : callable
        Called with the share done (0 to 1) and a line of text.
    describe : callable
        Per-vertex maps to write beside each stage's surfaces, by name, from its ``Cortex``; the growth room itself
        measures nothing.

    Returns
    -------
    Simulation

    Raises
    ------
    ValueError, FileNotFoundError
        If the scene cannot be had; nothing is written then.
    FileExistsError
        If ``out`` holds something else, or a run and ``resume`` is not asked for.
    UnstableError
        If the run leaves its bounds; the last checkpoint and the stages so far stay.
    KeyboardInterrupt
        At Ctrl-C or SIGTERM, once a checkpoint is written; a second one stops at once.
    """
    scene = load_scene(source, settings)
    folder = Path(scene.name if out is None else out)
    with deferred_interrupt() as interrupted:
        set_threads(threads)
        if not _finished(folder, scene, resume):
            _Run(scene, folder, progress, describe, interrupted).go()      # builds the body before it writes
    return Simulation(folder, scene)


def _finished(folder: Path, scene: Scene, resume: bool) -> bool:
    """Whether ``folder`` holds this very simulation, finished; refuses a folder that can't be used. Writes nothing."""
    written = folder / "scene.toml"
    if folder.exists() and not folder.is_dir():
        raise FileExistsError(f"{folder}: is a file; choose a folder to write.")
    if not written.exists():
        if folder.exists() and any(folder.iterdir()):
            raise FileExistsError(f"{folder}: is not empty and holds no simulation; choose another folder to write.")
        return False
    if not resume:
        raise FileExistsError(f"{folder}: holds a simulation; ask to resume it, or choose another folder.")
    if load_scene(written) != scene:
        raise FileExistsError(f"{folder}: holds a simulation of another scene; choose another folder.")
    return (folder / "health.json").exists()


class _Run:
    """One run: the body, its dynamics, and where it writes."""

    def __init__(
        self, scene: Scene, out: Path, progress: Progress, describe: Describe, interrupted: Callable[[], bool]
    ):
        from morphofold.sim.dynamics import Dynamics
        from morphofold.sim.effects import build_effects
        from morphofold.sim.geometry import build_body

        self.scene, self.out, self.progress, self.describe = scene, out, progress, describe
        self.interrupted = interrupted
        self.started = time.perf_counter()
        effects = build_effects(scene)
        self.body = build_body(scene, effects)
        steps_per_unit = scene.steps_per_unit(self.body.bilayer.extent)
        self.dynamics = Dynamics(self.body, effects, steps_per_unit=steps_per_unit)
        self.relaxing = int(RELAXATION * steps_per_unit * (scene.growth.final - 1))
        self.log: list[dict[str, Any]] = []
        self.checkpoint_due = time.perf_counter() + 60 * scene.output.checkpoint_minutes

    def go(self) -> None:
        from morphofold.sim.dynamics import UnstableError

        self.out.mkdir(parents=True, exist_ok=True)
        if not (self.out / "scene.toml").exists():
            with atomic_file(self.out / "scene.toml") as temporary:
                temporary.write_text(self.scene.to_toml())
        self._take_up()
        try:
            self._grow()
        except OSError as error:
            if error.errno not in (errno.ENOSPC, errno.EDQUOT):
                raise
            raise OSError(
                f"{self.out}: the disk is full at g = {self.dynamics.state.growth:.3f}. What was written stands; free "
                "some space and go on with --resume."
            ) from error
        except UnstableError as error:
            self._write_log()
            self._write_arrays(self.out / "last-sound-state.npz", error.sound)
            raise

    def _grow(self) -> None:
        from morphofold.sim.health import broken_bounds

        stages = []
        for g in self.scene.stages:
            self.dynamics.grow_to(g, self._after)
            if g == self.scene.growth.final:
                self.dynamics.relax(self.relaxing, self._after)
            stages.append(self._write_stage(g))
        self._note()
        self._write_log()
        effects = self.scene.effects
        warnings = [sentence for stage in stages for sentence in broken_bounds(stage)]
        body = self.body
        self._write_json(
            self.out / "health.json",
            {
                "morphofold": __version__,
                "healthy": not warnings,
                "warnings": warnings,
                "stages": stages,
                "elements": body.elements.n,
                "nodes": len(body.X),
                "surface_edge_mm": body.bilayer.edge,
                "steps": self.dynamics.state.step,
                "seconds": round(self._elapsed(), 2),
                "seconds_by_phase": {k: round(v, 3) for k, v in self.dynamics.seconds.items()},
                "effects": list(self.scene.called_effects),
                "effects_left_out": [n for n in type(effects).model_fields if n not in effects.named],
            },
        )
        (self.out / "checkpoint.npz").unlink(missing_ok=True)
        self.progress(1.0, "done")

    def _after(self, state: Any) -> None:
        """Between steps: progress, log, checkpoint."""
        final = self.scene.growth.final
        ramp = (state.growth - 1) / (final - 1) if final > 1 else 1.0
        rest = RELAXATION * state.relaxed / self.relaxing if self.relaxing else RELAXATION
        self.progress(
            0.99 * (ramp + min(rest, RELAXATION)) / (1 + RELAXATION),
            f"g {state.growth:.3f}, min J {state.record['min_J']:.2f}, "
            f"kinetic/strain {state.record['kinetic_over_strain']:.0e}",
        )
        last = self.log[-1] if self.log else {"growth": 0.0, "step": 0}
        if state.growth - last["growth"] >= LOG_EVERY or state.step - last["step"] >= LOG_STEPS:
            self._note()
        if self.interrupted():
            self._checkpoint()
            raise KeyboardInterrupt
        if time.perf_counter() > self.checkpoint_due:
            self._checkpoint()

    def _note(self) -> None:
        seconds = {k: round(v, 3) for k, v in self.dynamics.seconds.items()}
        self.log.append({**self.dynamics.state.record, "elapsed": round(self._elapsed(), 3), "seconds": seconds})

    def _elapsed(self) -> float:
        """Wall seconds of this run, those before a stop included."""
        return time.perf_counter() - self.started

    def _write_log(self) -> None:
        with atomic_file(self.out / "log.jsonl") as temporary:
            temporary.write_text("".join(json.dumps(line, allow_nan=False) + "\n" for line in self.log))

    def _checkpoint(self) -> None:
        self._write_log()
        self._write_arrays(self.out / "checkpoint.npz", self.dynamics.save())
        self.checkpoint_due = time.perf_counter() + 60 * self.scene.output.checkpoint_minutes

    def _take_up(self) -> None:
        """Go on from a checkpoint, if there is one."""
        path = self.out / "checkpoint.npz"
        if not path.exists():
            return
        with np.load(path, allow_pickle=False) as arrays:
            self.dynamics.load(dict(arrays))
        step = self.dynamics.state.step
        lines = (self.out / "log.jsonl").read_text().splitlines()
        self.log = [line for line in map(json.loads, lines) if line["step"] <= step]
        if self.log:
            self.started -= self.log[-1]["elapsed"]
            self.dynamics.seconds.update(self.log[-1]["seconds"])

    def _write_stage(self, g: float) -> dict[str, Any]:
        """Surfaces, maps and volume of the present state; returns its numbers for health.json."""
        from morphofold.sim.health import broken_bounds, check_surface, enclosed_volume
        from morphofold.sim.surfaces import whole_surfaces

        folder = stage_folder(self.out, g)
        if (folder / "stage.json").exists():                            # written before a stop
            return json.loads((folder / "stage.json").read_text())["health"]
        scene, body, state = self.scene, self.body, self.dynamics.state
        white, pial = whole_surfaces(body, state.x)
        closed = body.bilayer.closed
        grown = self.grown_volume()
        found = enclosed_volume(pial) - enclosed_volume(white) if closed else self._cortex_volume()
        numbers = {
            "growth": g,
            **{k: state.record[k] for k in ("step", "strain_energy", "kinetic_energy", "kinetic_over_strain", "min_J")},
            "lowest_J": state.lowest_J,
            **check_surface(pial, closed),
            "volume_drift": abs(found / grown - 1),
            "mean_radius_mm": float(np.linalg.norm(pial.verts, axis=1).mean()) if closed else None,
        }
        info = {
            "name": scene.name,
            "g": g,
            "law": scene.growth.law,
            "mu_ratio": scene.material.mu_ratio,
            "shape": scene.geometry.shape,
            "reference_thickness": scene.geometry.cortex_thickness,
            "reference_radius": float(np.linalg.norm(body.X[: body.n_surface], axis=1).mean()),
            "portion": body.bilayer.portion,
            "units": "mm",
            "health": numbers,
            "warnings": broken_bounds(numbers),
        }
        cortex = Cortex(white, pial, name=scene.name, origin="simulation", portion=body.bilayer.portion, info=info)
        maps = self.describe(cortex)
        missing = {name: int(np.isnan(values).sum()) for name, values in maps.items() if np.isnan(values).any()}
        if missing:
            info["vertices_without_value_written_as_0"] = missing
        with atomic_folder(folder) as temporary:
            (temporary / "surf").mkdir()
            for surface in (white, pial):
                write_surface(temporary / "surf" / surface.name, surface)
            for name, values in maps.items():
                write_morph(temporary / "surf" / f"lh.{name}", values, nan=0.0)
            if scene.output.volume:
                self._write_volume(temporary / "volume.vtu")
            self._write_json(temporary / "stage.json", info)
        return numbers

    def grown_volume(self) -> float:
        """Volume of the closed cortex after free growth: the reference volume times det G [mm^3]."""
        body = self.body
        stretch = 1 + (body.growth - 1) * np.asarray(body.pattern)
        volume = body.elements.volume[: body.elements.n_cortex] * det_G(stretch, body.law)
        return float(volume.sum()) / body.bilayer.portion

    def _cortex_volume(self) -> float:
        """Present volume of the elements of the cortex [mm^3]."""
        body = self.body
        n = body.elements.n_cortex
        stretch = 1 + (body.growth - 1) * np.asarray(body.pattern)
        grown = body.elements.volume[:n] * det_G(stretch, body.law)
        return float(np.sum(grown * body.elements.state()["volume_ratio"][:n])) / body.bilayer.portion

    def _write_volume(self, path: Path) -> None:
        import meshio

        from morphofold.sim.bricks import BINARY_CORNERS

        body, state = self.body, self.dynamics.state
        element = body.elements.state()
        layer = np.zeros(body.elements.n)
        layer[: body.elements.n_cortex] = 1
        corners = body.bilayer.mesh.t.T
        bricks = corners.shape[1] == 8
        if bricks:
            corners = corners[:, BINARY_CORNERS[[0, 4, 6, 2, 1, 5, 7, 3]]]          # VTK's order of i, j, k
        meshio.Mesh(
            state.x,
            [("hexahedron" if bricks else "tetra", corners)],
            point_data={"reference": body.X, "displacement": state.x - body.X},
            cell_data={
                "cortex": [layer],
                "volume_ratio": [element["volume_ratio"]],
                "min_J": [element["J_min"]],
                "energy": [element["energy"]],
            },
        ).write(path)

    @staticmethod
    def _write_arrays(path: Path, arrays: Mapping[str, NDArray]) -> None:
        buffer = io.BytesIO()
        np.savez(buffer, **arrays)                                      # type: ignore[arg-type]
        with atomic_file(path) as temporary:
            temporary.write_bytes(buffer.getvalue())

    @staticmethod
    def _write_json(path: Path, content: Mapping[str, Any]) -> None:
        with atomic_file(path) as temporary:
            temporary.write_text(json.dumps(content, indent=1, allow_nan=False) + "\n")
