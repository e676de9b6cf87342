"""A simulation folder: its contents, who may write it, and the parts that every run writes in the same way."""

import errno
import io
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from morphofold import __version__
from morphofold.io import atomic_file, atomic_folder, read_cortex, write_morph, write_surface
from morphofold.io.files import decoding, write_text
from morphofold.io.folders import LOCK_FILE, refuse_overlap
from morphofold.lazy import draw
from morphofold.provenance import digests
from morphofold.sim.output.checkpoint import as_lines
from morphofold.sim.output.inputs import check_begun, check_inputs, inputs_of, scene_digest
from morphofold.sim.output.run_files import AND_GROW_AGAIN, is_temporary, stage_folder, sweep
from morphofold.sim.output.stages import check_finished, check_stages, read_health, read_stage
from morphofold.sim.output.volume import check_series, write_series
from morphofold.sim.scene import Scene, UnfoldedCortex
from morphofold.sim.scene.effects import effect_names
from morphofold.sim.scene.files import load_scene, to_toml
from morphofold.surface import Cortex, Surface

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
        return tuple(sorted(float(p.name[1:]) for p in (self.path / "stages").glob("g*")))

    @property
    def health(self) -> dict[str, Any]:
        """Contents of ``health.json``."""
        return read_health(self.path)

    def cortex(self, g: float | None = None) -> Cortex:
        """The surfaces at growth stretch ``g``, by default the final one."""
        return read_cortex(stage_folder(self.path, self.stages[-1] if g is None else g))


def is_finished(
    folder: Path, scene: Scene, resume: bool, own: Sequence[str] = (), restart_from: str | Path | None = None
) -> bool:
    """Whether ``folder`` holds this simulation, finished and complete. Writes nothing.

    ``own`` are the names of the caller's own effects; ``restart_from`` is the place where the run begins, if given.

    Raises
    ------
    FileExistsError
        If the folder holds something else, or a run without ``resume``.
    ValueError
        If the scene's mesh file has changed since the run began, or a finished run is damaged.
    """
    refuse_overlap(folder)
    written = folder / "scene.toml"
    if folder.exists() and not folder.is_dir():
        raise FileExistsError(f"{folder}: is a file; choose a folder to write.")
    if not written.exists():
        begun = (LOCK_FILE, "inputs.json")  # a run writes these before its scene
        if folder.exists() and any(p.name not in begun and not is_temporary(p) for p in folder.iterdir()):
            raise FileExistsError(f"{folder}: is not empty and holds no simulation; choose another folder to write.")
        return False
    if not resume:
        raise FileExistsError(f"{folder}: holds a simulation; resume it (--resume), or choose another folder.")
    with decoding(
        written, "a scene as a run writes it", f"Delete {folder} {AND_GROW_AGAIN}, or choose another folder."
    ):
        began = load_scene(written)
    if began != scene:
        raise FileExistsError(f"{folder}: holds a simulation of another scene; choose another folder.")
    check_inputs(folder, scene)
    check_begun(folder, own, restart_from)
    if not (folder / "health.json").exists():
        return False
    check_finished(folder, scene)
    check_series(folder, scene)
    return True


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
    Create it before the body is built, and call ``begin`` after that: the digest of the scene's mesh file is then of
    the bytes from which the body was built.
    """

    def __init__(
        self,
        out: Path,
        scene: Scene,
        describe: Describe,
        resume: bool = False,
        own: Sequence[str] = (),
        restart: Mapping[str, Any] | None = None,
    ):
        self.out, self.scene, self._describe, self.resume = out, scene, describe, resume
        self.own, self.restart = list(own), restart
        self._inputs = inputs_of(scene)

    def begin(self) -> None:
        """Write the folder and its ``scene.toml``, unless they exist; remove incomplete files of a killed run.

        Raises
        ------
        FileExistsError
            If the folder holds something else, a run that is not to be resumed, or a finished run.
        ValueError
            If the run to resume is damaged.
        OSError
            If the scene's mesh file changed while the body was built from it.
        """
        if inputs_of(self.scene) != self._inputs:
            name = next(given[key] for given in self._inputs.values() for key in ("file", "subject") if key in given)
            raise OSError(f"{name}: changed while it was read. Run this again when no program writes it.")
        if is_finished(self.out, self.scene, self.resume, self.own):
            raise FileExistsError(f"{self.out}: holds a finished run of this scene; choose another folder.")
        self.out.mkdir(parents=True, exist_ok=True)
        sweep(self.out)
        check_stages(self.out, self.scene)
        if not (self.out / "scene.toml").exists():
            added = {"effects": self.own, "restart": self.restart}
            if inputs := {**self._inputs, **{name: what for name, what in added.items() if what}}:
                _write_json(self.out / "inputs.json", inputs)
            write_text(self.out / "scene.toml", to_toml(self.scene))
        write_series(self.out, self.scene)  # the run may have been killed before it

    @property
    def checkpoint_to_resume(self) -> Path | None:
        """The checkpoint to resume from, if there is one."""
        path = self.out / "checkpoint.npz"
        return path if self.resume and path.exists() else None

    @contextmanager
    def telling_a_full_disk(self, growth: Callable[[], float]) -> Iterator[None]:
        """If an error means a full disk, raise one that says so, with the growth reached."""
        try:
            yield
        except OSError as error:
            if error.errno not in (errno.ENOSPC, errno.EDQUOT):
                raise
            raise OSError(
                f"{self.out}: the disk is full at g = {growth():.3f}. The written files are kept; free some space and "
                "continue with --resume."
            ) from error

    def log(self, lines: list[dict[str, Any]]) -> None:
        """Write all lines of ``log.jsonl``."""
        write_text(self.out / "log.jsonl", as_lines(lines))

    def arrays(self, name: str, arrays: Mapping[str, NDArray]) -> None:
        """Write arrays by name into the file ``name`` (.npz)."""
        buffer = io.BytesIO()
        np.savez(buffer, **arrays)  # type: ignore[arg-type]
        with atomic_file(self.out / name) as temporary:
            temporary.write_bytes(buffer.getvalue())

    def health_of(self, g: float) -> dict[str, Any] | None:
        """Numbers of a stage that was written before the run was stopped; None if it was not."""
        return read_stage(self.out, g)["health"] if stage_folder(self.out, g).exists() else None

    def stage(
        self,
        g: float,
        white: Surface,
        pial: Surface,
        *,
        portion: float,
        reference_radius: float,
        numbers: Mapping[str, Any],
        warnings: list[str],
        beside: Callable[[Path], None] = lambda folder: None,
    ) -> None:
        """Write the surfaces of a stage, their maps, ``stage.json``, and what ``beside`` adds to the same folder."""
        scene = self.scene
        info: dict[str, Any] = {
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
            "scene_sha256": scene_digest(self.out),
        }
        if isinstance(scene.geometry, UnfoldedCortex):
            given = ["thickness_map"] if scene.geometry.thickness_map else []
            given += [name for name in scene.effects if name in ("growth_map", "stiffness_map")]
            from morphofold.sim.hemisphere.subject import subject_of_cortex

            info["grown_from"] = {
                **self._inputs["geometry.subject"],
                "unfold": scene.geometry.unfold,
                "maps": given,
                "cortex_mask": subject_of_cortex(scene.geometry).marked_by,
            }
        hemi = pial.name[:2]
        cortex = Cortex(white, pial, hemi, scene.name, origin="simulation", portion=portion, info=info)
        maps = self._describe(cortex)
        missing = {name: int(np.isnan(values).sum()) for name, values in maps.items() if np.isnan(values).any()}
        if missing:
            info["vertices_without_value_written_as_0"] = missing
        with atomic_folder(stage_folder(self.out, g)) as temporary:
            (temporary / "surf").mkdir()
            for surface in (white, pial):
                write_surface(temporary / "surf" / surface.name, surface)
                write_surface(temporary / "surf" / f"{surface.name}.surf.gii", surface)  # for Connectome Workbench
            for name, values in maps.items():
                write_morph(temporary / "surf" / f"{hemi}.{name}", values, nan=0.0)
            beside(temporary)
            _write_json(temporary / "stage.json", info)
            _write_json(temporary / "files.json", digests(temporary))
        write_series(self.out, scene)

    def health(self, stages: list[dict[str, Any]], warnings: list[str], **numbers: Any) -> None:
        """Write ``health.json``, which finishes a run."""
        content = {
            "morphofold": __version__,
            "healthy": not warnings,
            "warnings": warnings,
            "stages": stages,
            **numbers,
            "effects": [*self.scene.called_effects, *self.own],
            "effects_left_out": [name for name in effect_names() if name not in self.scene.effects],
        }
        _write_json(self.out / "health.json", content)


def _write_json(path: Path, content: Mapping[str, Any]) -> None:
    write_text(path, json.dumps(content, indent=1, allow_nan=False) + "\n")
