"""The files of a run in a folder, and what it was begun with beside its scene: mesh, maps, own effects, a state."""

import hashlib
import os
import re
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, RootModel

from morphofold.digests_and_json import Row, sha256_of
from morphofold.errors import Mismatch
from morphofold.io import files_of
from morphofold.io.atomic_folders import LOCK_FILE, MARKER_FILE
from morphofold.io.json_files import Record, read_json
from morphofold.sim.scene import MeshFile, Radial, Scene, UnfoldedCortex

AND_GROW_AGAIN = "and grow the scene again from the start"
_RUN_FILE_NAMES = (
    "scene.toml",
    "inputs.json",
    "log.jsonl",
    "health.json",
    "checkpoint.npz",
    "last-sound-state.npz",
    "error.json",
    "stages.pvd",
)
_TEMPORARY_NAME = re.compile(
    r"\.[0-9a-f]{8}\.(" + "|".join(map(re.escape, _RUN_FILE_NAMES)) + r")|\.g\d+\.\d\d\.[0-9a-f]{8}(\.old)?"
)


class Digests(RootModel[dict[str, str]]):
    """``files.json`` of a stage."""


class Restart(Record):
    """The state of another run at which a run began: its file, that run's :func:`scene_digest`, the growth."""

    file: str
    sha256: str
    scene_sha256: str
    growth: Annotated[float, Field(ge=1, le=1000)]


class Inputs(Record):
    """``inputs.json``: what :func:`inputs_of` returns, names of the caller's own effects, and where the run began."""

    effects: list[str] = []
    restart: Restart | None = None


def inputs_of(scene: Scene) -> dict[str, Row]:
    """The mesh of a scene as it is now: the scene only names a file or a level.

    ``{"geometry.file": {"file", "sha256", "bytes"}}`` for a mesh file; ``{"accuracy": {"edge",
    "elements_through_cortex"}}`` for bricks, the mesh that the level stands for [mm], and ``{"geometry.subject":
    {"subject", "sha256"}}`` if they are a subject's; ``{"maps": {"sha256"}}`` if there are maps; nothing in one
    dimension.

    Raises
    ------
    FileNotFoundError, ValueError
        If there is no such file, or it can't be a mesh.
    """
    geometry = scene.geometry
    inputs: dict[str, Row] = {}
    if isinstance(geometry, MeshFile):
        mesh = geometry.path()
        inputs["geometry.file"] = {"file": geometry.file, "sha256": sha256_of(mesh), "bytes": mesh.stat().st_size}
    elif not isinstance(geometry, Radial):
        inputs["accuracy"] = {"edge": scene.edge, "elements_through_cortex": scene.elements_through_cortex}
    if isinstance(geometry, UnfoldedCortex):
        from morphofold.sim.hemisphere.subject_maps import files_of_subject

        inputs["geometry.subject"] = {"subject": geometry.subject, "sha256": _digests(files_of_subject(geometry))}
    if map_files := scene.map_files:
        inputs["maps"] = {"sha256": _digests(map_files)}
    return inputs


def _digests(files: Mapping[str, Path]) -> dict[str, str]:
    return {name: sha256_of(path) for name, path in files.items()}


def check_inputs(folder: Path, scene: Scene, own: Sequence[str], restart_from: str | Path | None) -> None:
    """Raise unless the run in ``folder`` began with the mesh and maps of a scene as they are now, byte for byte, with
    the same own effects of the caller, and at the same state, if one is named."""
    begun_inputs = begun_with(folder)
    if changes := list(_changes(begun_inputs, inputs_of(scene))):
        raise Mismatch(
            f"{folder / 'inputs.json'}: the run began with other inputs: {'; '.join(changes)}. Restore the old files, "
            "or choose another folder."
        )
    old_effects, start_file = begun_inputs.get("effects", []), begun_inputs.get("restart", {}).get("file")
    if old_effects != list(own):
        raise FileExistsError(
            f"{folder}: its run has own effects beside those of its scene: {', '.join(old_effects) or 'none'}; given "
            f"are {', '.join(own) or 'none'}. Resume in Python, mf.simulate(..., effects=[...], resume=True), with the "
            "same effects in the same order, or choose another folder."
        )
    if restart_from is not None and not (start_file and Path(start_file).is_relative_to(os.path.abspath(restart_from))):
        raise FileExistsError(
            f"{folder}: its run began {f'at {start_file}' if start_file else 'ungrown'}, not at {restart_from}; choose "
            "another folder."
        )


def _changes(old_inputs: Mapping[str, Any], new_inputs: Mapping[str, Any], name: str = "") -> Iterator[str]:
    """One text for each value that differs between two records of inputs, with the file or part that it belongs to."""
    for key, value in new_inputs.items():
        if isinstance(value, dict):
            part_name = value.get("file") or value.get("subject") or name or key
            yield from _changes(old_inputs.get(key) or {}, value, part_name)
        elif old_inputs.get(key) != value:
            yield f"{name}: {key} was {old_inputs.get(key)!s:.12}, is now {value!s:.12}"


def begun_with(folder: Path) -> Row:
    """Contents of ``inputs.json`` of the run in a folder; empty if no run has begun, or the run has none."""
    if not ((folder / "scene.toml").is_file() and (folder / "inputs.json").is_file()):
        return {}
    return read_json(folder / "inputs.json", Inputs, f"Delete {folder} {AND_GROW_AGAIN}, or choose another folder.")


def written_stages(folder: Path, scene: Scene) -> tuple[float, ...]:
    """Growth of the stages that the run in a folder writes: those of its scene from the growth at which it began."""
    restart = begun_with(folder).get("restart")
    return tuple(g for g in scene.stages if restart is None or g >= restart["growth"])


def scene_digest(folder: Path) -> str:
    """SHA-256 of ``scene.toml`` and ``inputs.json`` of the run in a folder, as written when it began."""
    contents = [path.read_bytes() for name in ("scene.toml", "inputs.json") if (path := folder / name).is_file()]
    return hashlib.sha256(b"\0".join(contents)).hexdigest()


def stage_folder(out: Path, g: float) -> Path:
    return out / "stages" / f"g{g:.2f}"


def is_temporary(path: Path) -> bool:
    """Whether a path has the temporary name of a file that a run has not finished writing."""
    return _TEMPORARY_NAME.fullmatch(path.name) is not None


def remove_temporaries(folder: Path) -> None:
    """Remove files that a killed run had not finished writing, known by their temporary names."""
    for path in [*folder.glob(".*"), *folder.glob("stages/.*")]:
        if is_temporary(path):
            shutil.rmtree(path) if path.is_dir() else path.unlink()


def files_of_run(folder: Path) -> dict[str, Path]:
    """Files that a run wrote in its folder, by their relative path."""
    files = {name: folder / name for name in _RUN_FILE_NAMES}
    for stage_path in sorted((folder / "stages").glob("g*")):
        files |= {f"stages/{stage_path.name}/{name}": path for name, path in files_of(stage_path).items()}
    return {name: path for name, path in files.items() if path.is_file()}


def clear_run(folder: Path) -> None:
    """Remove the files of a run from its folder, and the folder.

    Raises
    ------
    FileExistsError
        If the folder holds other files; then nothing is removed.
    """
    remove_temporaries(folder)
    run_paths = {folder / LOCK_FILE, *files_of_run(folder).values()}
    for stage_path in (folder / "stages").glob("g*"):
        run_paths |= {stage_path / "files.json", stage_path / MARKER_FILE}
        with suppress(OSError, ValueError):  # the list is damaged, or the run is older than such lists
            run_paths |= {stage_path / name for name in read_json(stage_path / "files.json", Digests, AND_GROW_AGAIN)}
    if foreign := [path for path in folder.rglob("*") if not path.is_dir() and path not in run_paths]:
        raise FileExistsError(f"{foreign[0]}: was not written by a run, so {folder} can't be cleared. Move it away.")
    shutil.rmtree(folder)
