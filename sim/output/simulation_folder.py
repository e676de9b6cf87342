"""A simulation folder: its contents, who may write it, and what every run does in the same way: grow and write."""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from morphofold import __version__
from morphofold.digests_and_json import Row, digests
from morphofold.errors import DISK_FULL_ERRORS
from morphofold.io import atomic_file, atomic_folder, read_cortex, write_morph, write_surface
from morphofold.io.atomic_folders import LOCK_FILE, refuse_overlap
from morphofold.io.files import decoding, write_text
from morphofold.io.json_files import write_json
from morphofold.lazy import draw
from morphofold.progress_callbacks import Progress
from morphofold.sim.effects import Effect, build_effects
from morphofold.sim.output import run_inputs
from morphofold.sim.output.checkpoint import as_lines
from morphofold.sim.output.run_inputs import AND_GROW_AGAIN, stage_folder
from morphofold.sim.output.stage_records import check_finished, check_stages, read_health, write_series
from morphofold.sim.scene import Scene, UnfoldedCortex
from morphofold.sim.scene.effect_registry import effect_names
from morphofold.sim.scene.scene_files import load_scene, to_toml
from morphofold.surface import Cortex, Surface
from morphofold.timing import working_seconds

if TYPE_CHECKING:
    from morphofold.sim.dynamics import Dynamics

Describe = Callable[[Cortex], Mapping[str, NDArray[np.float64]]]


@dataclass(frozen=True)
class Simulation:
    """A folder with the stages of a growth simulation."""

    path: Path
    scene: Scene

    def __repr__(self) -> str:
        shape, final = self.scene.geometry.shape, self.scene.growth.final
        return f"Simulation({str(self.path)!r}, scene {self.scene.name!r}, {shape}, growth to {final:g})"

    def _repr_html_(self) -> str:
        return str(draw("html", self))

    @property
    def stages(self) -> tuple[float, ...]:
        """Growth stretches of the written stages, ascending."""
        return tuple(sorted(float(path.name[1:]) for path in (self.path / "stages").glob("g*")))

    @property
    def health(self) -> Row:
        """Contents of ``health.json``."""
        return read_health(self.path)

    def cortex(self, g: float | None = None) -> Cortex:
        """The surfaces at growth stretch ``g``, by default the final one."""
        return read_cortex(stage_folder(self.path, self.stages[-1] if g is None else g))


def is_finished(
    folder: Path, scene: Scene, resume: bool, own_effects: Sequence[str] = (), restart_from: str | Path | None = None
) -> bool:
    """Whether ``folder`` holds this simulation, finished and complete. Writes nothing.

    ``own_effects`` are names of the caller's own effects; ``restart_from`` is the place where the run begins, if given.

    Raises
    ------
    FileExistsError
        If the folder holds something else, or a run without ``resume``.
    ValueError
        If the scene's mesh file has changed since the run began, or a finished run is damaged.
    """
    refuse_overlap(folder)
    scene_file, other = folder / "scene.toml", "choose another folder"
    if folder.exists() and not folder.is_dir():
        raise FileExistsError(f"{folder}: is a file; choose a folder to write.")
    if not scene_file.exists():
        early = (LOCK_FILE, "inputs.json")  # a run writes these before its scene
        if folder.exists() and any(p.name not in early and not run_inputs.is_temporary(p) for p in folder.iterdir()):
            raise FileExistsError(f"{folder}: is not empty and holds no simulation; {other} to write.")
        return False
    if not resume:
        raise FileExistsError(f"{folder}: holds a simulation; resume it (--resume), or {other}.")
    with decoding(scene_file, "a scene as a run writes it", f"Delete {folder} {AND_GROW_AGAIN}, or {other}."):
        begun_scene = load_scene(scene_file)
    if begun_scene != scene:
        raise FileExistsError(f"{folder}: holds a simulation of another scene; {other}.")
    run_inputs.check_inputs(folder, scene, own_effects, restart_from)
    if not (folder / "health.json").exists():
        return False
    check_finished(folder, scene)
    return True


@dataclass
class FolderWriter:
    """Writes the folder of one scene; each file completely or not at all.

    Parameters
    ----------
    out : Path
    scene : Scene
    describe : callable
        Returns per-vertex maps by name from the ``Cortex`` of a stage.
    resume : bool
        Whether a run of this scene in the folder may be resumed.
    own : sequence of str
        Names of the caller's own effects, added to those of the scene.
    restart : mapping, optional
        Entry of ``inputs.json`` for the state of another run at which this one begins.

    Notes
    -----
    Create it before the body is built, and call ``begin`` after that: nothing is written if the body cannot be built.
    """

    out: Path
    scene: Scene
    describe: Describe
    resume: bool = False
    own: Sequence[str] = ()
    restart: Mapping[str, Any] | None = None

    def __post_init__(self) -> None:
        self._inputs = run_inputs.inputs_of(self.scene)

    def begin(self) -> dict[float, Row]:
        """Write the folder and its ``scene.toml``, unless they exist; remove incomplete files of a killed run.

        Returns the ``stage.json`` of each stage that was written before the run was stopped, by growth.

        Raises
        ------
        ValueError
            If the run to resume is damaged.
        """
        self.out.mkdir(parents=True, exist_ok=True)
        run_inputs.remove_temporaries(self.out)
        stages = check_stages(self.out, self.scene)
        if not (self.out / "scene.toml").exists():
            extra_inputs = {"effects": [*self.own], "restart": self.restart}
            if inputs := self._inputs | {name: value for name, value in extra_inputs.items() if value}:
                write_json(self.out / "inputs.json", inputs)
            write_text(self.out / "scene.toml", to_toml(self.scene))
        write_series(self.out, self.scene)  # the run may have been killed before it
        return stages

    @property
    def checkpoint_to_resume(self) -> Path | None:
        """The checkpoint to resume from, if there is one."""
        path = self.out / "checkpoint.npz"
        return path if self.resume and path.exists() else None

    def log(self, lines: Sequence[Row]) -> None:
        """Write all lines of ``log.jsonl``."""
        write_text(self.out / "log.jsonl", as_lines(lines))

    def arrays(self, name: str, arrays: Mapping[str, NDArray]) -> None:
        """Write arrays by name into the file ``name`` (.npz)."""
        buffer = io.BytesIO()
        np.savez(buffer, **arrays)  # type: ignore[arg-type]
        with atomic_file(self.out / name) as temporary_file:
            temporary_file.write_bytes(buffer.getvalue())

    def stage(
        self,
        g: float,
        white: Surface,
        pial: Surface,
        *,
        portion: float,
        images: NDArray[np.int64] | None = None,
        reference_radius: float,
        numbers: Mapping[str, Any],
        warnings: list[str],
        add_files: Callable[[Path], None] = lambda folder: None,
    ) -> None:
        """Write the surfaces of a stage, their maps, ``stage.json``, and what ``add_files`` adds to the same folder."""
        scene = self.scene
        info: Row = {
            "name": scene.name,
            "g": g,
            "law": scene.growth.law,
            "mu_ratio": scene.material.mu_ratio,
            "material": scene.material.model,
            "shape": scene.geometry.shape,
            "reference_thickness": scene.geometry.cortex_thickness,
            "reference_radius": reference_radius,
            "portion": portion,
            "units": "mm",
            "health": numbers,
            "warnings": warnings,
            "scene_sha256": run_inputs.scene_digest(self.out),
        }
        if isinstance(scene.geometry, UnfoldedCortex):
            from morphofold.sim.hemisphere.subject_maps import subject_of_cortex

            map_names = ["thickness_map"] if scene.geometry.thickness_map else []
            info["grown_from"] = {
                **self._inputs["geometry.subject"],
                "unfold": scene.geometry.unfold,
                "maps": map_names + [name for name in scene.effects if name in ("growth_map", "stiffness_map")],
                "cortex_mask": subject_of_cortex(scene.geometry).marked_by,
            }
        hemi = pial.name[:2]
        cortex = Cortex(white, pial, hemi, scene.name, origin="simulation", portion=portion, images=images, info=info)
        maps = self.describe(cortex)
        if n_missing := {name: int(np.isnan(values).sum()) for name, values in maps.items() if np.isnan(values).any()}:
            info["vertices_without_value_written_as_0"] = n_missing
        with atomic_folder(stage_folder(self.out, g)) as new_folder:
            (new_folder / "surf").mkdir()
            for surface in (white, pial):
                write_surface(new_folder / "surf" / surface.name, surface)
            for name, values in maps.items():
                write_morph(new_folder / "surf" / f"{hemi}.{name}", values, nan=0.0)
            add_files(new_folder)
            write_json(new_folder / "stage.json", info)
            write_json(new_folder / "files.json", digests(new_folder))
        write_series(self.out, scene)

    def health(self, stages: list[Row], warnings: list[str], **numbers: Any) -> None:
        """Write ``health.json``, which finishes a run."""
        health_row = {
            "morphofold": __version__,
            "healthy": not warnings,
            "warnings": warnings,
            "stages": stages,
            **numbers,
            "effects": [*self.scene.called_effects, *self.own],
            "effects_left_out": [name for name in effect_names() if name not in self.scene.effects],
        }
        write_json(self.out / "health.json", health_row)


@dataclass
class Run:
    """One run: its stages of growth one after the other, and the folder that it writes; it builds before it writes.

    Attributes
    ----------
    growth : float
        Growth reached so far.
    log : list of dict
        The lines of ``log.jsonl`` so far.
    """

    scene: Scene
    writer: FolderWriter
    progress: Progress
    interrupted: Callable[[], bool]
    effects: Sequence[Effect] = ()
    after: Callable[[Dynamics], None] | None = None

    def __post_init__(self) -> None:
        self.growth, self.started = 1.0, working_seconds()
        self.effects = [*build_effects(self.scene), *self.effects]
        self.log: list[Row] = []
        self.build()

    def build(self) -> None:
        """Build what grows."""

    def go(self) -> None:
        """Grow to each stage and write it, then the log and ``health.json``."""
        writer = self.writer
        written_records = writer.begin()
        self.resume()
        try:
            stage_numbers = []
            for g in run_inputs.written_stages(writer.out, self.scene):
                self.grow_to(g)
                stage_numbers.append(written_records[g]["health"] if g in written_records else self.write_stage(g))
                self.after_stage(stage_numbers[-1])
            writer.log(self.log)
            warnings = [sentence for numbers in stage_numbers for sentence in self.warnings(numbers)]
            writer.health(stage_numbers, warnings, **self.cost())
            (writer.out / "checkpoint.npz").unlink(missing_ok=True)
        except OSError as error:
            if error.errno not in DISK_FULL_ERRORS:
                raise
            raise OSError(
                f"{writer.out}: the disk is full at g = {self.growth:.3f}. The written files are kept; free some space "
                "and continue with --resume."
            ) from error
        self.progress(1.0, "done")

    @property
    def elapsed(self) -> float:
        """Wall seconds of this run, including those before a stop, without compiling."""
        return working_seconds() - self.started

    def resume(self) -> None:
        """Resume from a checkpoint, if that is asked for and there is one."""

    def grow_to(self, g: float) -> None:
        """Grow to a stage."""

    def write_stage(self, g: float) -> Row:
        """Write the present state as a stage; returns its numbers for ``health.json``."""
        raise NotImplementedError

    def after_stage(self, numbers: Row) -> None:
        """Called when a stage is written."""

    def warnings(self, numbers: Row) -> list[str]:
        """What is not healthy of the numbers of a stage."""
        return []

    def cost(self) -> Row:
        """Size and time of the run for ``health.json``."""
        raise NotImplementedError
