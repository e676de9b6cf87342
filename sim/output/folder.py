"""A simulation folder: what it holds, who may write it, and the parts that every run writes the same way."""

from __future__ import annotations

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
from morphofold.io.files import decoding
from morphofold.io.locks import LOCK
from morphofold.provenance import digests
from morphofold.sim.output.checkpoint import as_lines
from morphofold.sim.output.inputs import check_begun, check_inputs, inputs_of, scene_digest
from morphofold.sim.output.run_files import ANEW, is_temporary, stage_folder, sweep
from morphofold.sim.output.stages import check_finished, check_stages, read_health, read_stage
from morphofold.sim.output.volume import check_series, write_series
from morphofold.sim.scene import Scene
from morphofold.sim.scene.effects import effect_names
from morphofold.sim.scene.files import load_scene, to_toml
from morphofold.surface import Cortex, Surface

Describe = Callable[[Cortex], Mapping[str, NDArray[np.float64]]]


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
        return read_health(self.path)

    def cortex(self, g: float | None = None) -> Cortex:
        """The surfaces at growth stretch ``g``, by default the final one."""
        return read_cortex(stage_folder(self.path, self.stages[-1] if g is None else g))


def is_finished(
    folder: Path, scene: Scene, resume: bool, own: Sequence[str] = (), restart_from: str | Path | None = None
) -> bool:
    """Whether ``folder`` holds this very simulation, finished and whole. Writes nothing.

    ``own`` are the names of effects that its caller adds, ``restart_from`` where it is to begin, if that is said.

    Raises
    ------
    FileExistsError
        If the folder holds something else, or a run and ``resume`` is not asked for.
    ValueError
        If the scene's mesh file has changed since the run began, or a finished run is damaged.
    """
    written = folder / "scene.toml"
    if folder.exists() and not folder.is_dir():
        raise FileExistsError(f"{folder}: is a file; choose a folder to write.")
    if not written.exists():
        begun = (LOCK, "inputs.json")  # what a run writes before its scene
        if folder.exists() and any(p.name not in begun and not is_temporary(p) for p in folder.iterdir()):
            raise FileExistsError(f"{folder}: is not empty and holds no simulation; choose another folder to write.")
        return False
    if not resume:
        raise FileExistsError(f"{folder}: holds a simulation; ask to resume it, or choose another folder.")
    with decoding(written, "a scene as a run writes it", f"Delete {folder} {ANEW}, or choose another folder."):
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
    """Writes the folder of one scene; each file whole or not at all.

    Parameters
    ----------
    out : Path
    scene : Scene
    describe : callable
        Per-vertex maps of a stage's ``Cortex``, by name.
    resume : bool
        Whether what is there of this scene may be gone on from.
    own : sequence of str
        Names of effects that its caller adds to the scene's.
    restart : mapping, optional
        What ``inputs.json`` says of the state of another run that this one begins at.

    Notes
    -----
    To be made before the body is built, and begun after it: the digest of the scene's mesh file is then of the bytes
    that the body was built of.
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
        """The folder and its ``scene.toml``, unless they are there; without what a killed run left half-written.

        Raises
        ------
        FileExistsError
            If the folder holds something else, or a run that is not to be gone on from, or a finished one.
        ValueError
            If what is to be gone on from is damaged.
        OSError
            If the scene's mesh file changed while the body was built of it.
        """
        if inputs_of(self.scene) != self._inputs:
            name = self._inputs["geometry.file"]["file"]
            raise OSError(f"{name}: changed while it was read. Wait until what writes it has ended.")
        if is_finished(self.out, self.scene, self.resume, self.own):
            raise FileExistsError(f"{self.out}: holds a finished run of this scene; choose another folder.")
        self.out.mkdir(parents=True, exist_ok=True)
        sweep(self.out)
        check_stages(self.out, self.scene)
        if not (self.out / "scene.toml").exists():
            added = {"effects": self.own, "restart": self.restart}
            if inputs := {**self._inputs, **{name: what for name, what in added.items() if what}}:
                _write_json(self.out / "inputs.json", inputs)
            with atomic_file(self.out / "scene.toml") as temporary:
                temporary.write_text(to_toml(self.scene), encoding="utf-8")
        write_series(self.out, self.scene)  # a kill may have come before it

    @property
    def checkpoint(self) -> Path | None:
        """The checkpoint that the run goes on from, if there is one."""
        path = self.out / "checkpoint.npz"
        return path if self.resume and path.exists() else None

    @contextmanager
    def telling_a_full_disk(self, growth: Callable[[], float]) -> Iterator[None]:
        """Say of an error that the disk is full, and how far the run came."""
        try:
            yield
        except OSError as error:
            if error.errno not in (errno.ENOSPC, errno.EDQUOT):
                raise
            raise OSError(
                f"{self.out}: the disk is full at g = {growth():.3f}. What was written stands; free some space and go "
                "on with --resume."
            ) from error

    def log(self, lines: list[dict[str, Any]]) -> None:
        """All lines of ``log.jsonl``."""
        with atomic_file(self.out / "log.jsonl") as temporary:
            temporary.write_text(as_lines(lines))

    def arrays(self, name: str, arrays: Mapping[str, NDArray]) -> None:
        """Arrays by name, as ``NAME`` (.npz)."""
        buffer = io.BytesIO()
        np.savez(buffer, **arrays)  # type: ignore[arg-type]
        with atomic_file(self.out / name) as temporary:
            temporary.write_bytes(buffer.getvalue())

    def health_of(self, g: float) -> dict[str, Any] | None:
        """Numbers of a stage that was written before a stop, None where it wasn't."""
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
        """The surfaces of a stage, their maps, ``stage.json``, and what ``beside`` writes into the same folder."""
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
        cortex = Cortex(white, pial, name=scene.name, origin="simulation", portion=portion, info=info)
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
                write_morph(temporary / "surf" / f"lh.{name}", values, nan=0.0)
            beside(temporary)
            _write_json(temporary / "stage.json", info)
            _write_json(temporary / "files.json", digests(temporary))
        write_series(self.out, scene)

    def health(self, stages: list[dict[str, Any]], warnings: list[str], **numbers: Any) -> None:
        """``health.json``, with which a run is finished."""
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
    with atomic_file(path) as temporary:
        temporary.write_text(json.dumps(content, indent=1, allow_nan=False) + "\n")
