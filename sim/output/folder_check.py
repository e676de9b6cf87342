"""What a simulation folder holds, read back: whole and of this run, or refused with the file's name and the cure."""

from __future__ import annotations

import hashlib
import json
import math
import os
import re
import shutil
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, RootModel

from morphofold.io import files_of, read_cortex, sample_path
from morphofold.io.cortices import StageHealth, StageRecord
from morphofold.io.files import decoding, existing_file
from morphofold.io.folders import MARKER
from morphofold.io.json_files import Amount, Count, Length, Record, read_json
from morphofold.io.locks import LOCK
from morphofold.provenance import sha256_of
from morphofold.sim.scene import MeshFile, Radial, Scene

ANEW = "to grow anew from the start"
_KEPT = (
    "scene.toml", "inputs.json", "log.jsonl", "health.json", "checkpoint.npz", "last-sound-state.npz", "error.json",
    "stages.pvd",
)  # fmt: skip
_TEMPORARY = re.compile(r"\.[0-9a-f]{8}\.(" + "|".join(map(re.escape, _KEPT)) + r")|\.g\d+\.\d\d\.[0-9a-f]{8}(\.old)?")


class Health(Record):
    """``health.json`` of a finished run; what an early version did not write has a default."""

    morphofold: str
    healthy: bool
    warnings: list[str]
    stages: Annotated[list[StageHealth], Field(min_length=1)]
    steps: Count
    seconds: Amount
    seconds_by_phase: dict[str, Amount] = {}
    effects: list[str] = []
    elements: Count = 0
    threads: Count = 1
    surface_edge_mm: Length = 1.0
    peak_memory_GiB: Amount | None = None


class MeshBytes(Record):
    """The file of a mesh."""

    file: str
    sha256: str
    bytes: Count


class MeshSize(Record):
    """What a level of accuracy stood for."""

    edge: Length
    elements_through_cortex: Count


class Restart(Record):
    """The state of another run that one began at: its file, that run's :func:`scene_digest`, the growth."""

    file: str
    sha256: str
    scene_sha256: str
    growth: Annotated[float, Field(ge=1, le=1000)]


class Inputs(Record):
    """``inputs.json``: either of the first two is there; with names of effects that a scene can't name."""

    geometry: Annotated[MeshBytes | None, Field(alias="geometry.file")] = None
    accuracy: MeshSize | None = None
    effects: list[str] = []
    restart: Restart | None = None


class Digests(RootModel[dict[str, str]]):
    """``files.json`` of a stage."""


def read_health(folder: Path) -> dict[str, Any]:
    """``health.json`` of a finished run; raises as :func:`morphofold.io.json_files.read_json` does."""
    return read_json(folder / "health.json", Health, f"Delete it {ANEW}.")


def stage_folder(out: Path, g: float) -> Path:
    return out / "stages" / f"g{g:.2f}"


# what a killed run leaves ------------------------------------------------------------------------------------


def is_temporary(path: Path) -> bool:
    """Whether a name is one under which a run writes what is not whole yet."""
    return _TEMPORARY.fullmatch(path.name) is not None


def sweep(folder: Path) -> None:
    """Remove what a killed run had not finished writing; only names of our own making."""
    for place in (folder, folder / "stages"):
        for path in place.iterdir() if place.is_dir() else ():
            if not is_temporary(path):
                continue
            if path.is_dir() and not path.is_symlink():
                shutil.rmtree(path)
            else:
                path.unlink()


def files_of_run(folder: Path) -> dict[str, Path]:
    """What a run wrote in its folder, by paths from there."""
    found = {name: folder / name for name in _KEPT}
    for stage in sorted((folder / "stages").glob("g*")):
        found |= {f"stages/{stage.name}/{name}": path for name, path in files_of(stage).items()}
    return {name: path for name, path in found.items() if path.is_file()}


def clear_run(folder: Path) -> None:
    """Remove what a run wrote in its folder, and nothing else.

    Raises
    ------
    FileExistsError
        If something else is there, so that no other run can be written there; all stays then.
    """
    sweep(folder)
    ours = {folder / name for name in (*_KEPT, LOCK)}
    for stage in (folder / "stages").glob("g*"):
        with suppress(OSError, ValueError):                             # of one that is damaged, or older than lists
            ours |= {stage / name for name in read_json(stage / "files.json", Digests, ANEW)}
        ours |= {stage / "files.json", stage / MARKER, *files_of(stage).values()}
    there = [path for path in folder.rglob("*") if path.is_symlink() or not path.is_dir()]
    if others := [path for path in there if path not in ours]:
        raise FileExistsError(f"{others[0]}: no run wrote this, so {folder} can't be cleared. Move it away.")
    for path in there:
        path.unlink()
    shutil.rmtree(folder)                                               # of empty folders


# what a scene only names -------------------------------------------------------------------------------------


def inputs_of(scene: Scene) -> dict[str, dict[str, Any]]:
    """What a scene only names, as it is now: its mesh, and so that of its run.

    ``{"geometry.file": {"file", "sha256", "bytes"}}`` with a mesh file, ``{"accuracy": {"edge",
    "elements_through_cortex"}}`` of bricks, which its level stands for [mm]; nothing in one dimension.

    Raises
    ------
    FileNotFoundError, ValueError
        If there is no such file, or it can't be a mesh.
    """
    if isinstance(scene.geometry, Radial):
        return {}
    if not isinstance(scene.geometry, MeshFile):
        return {"accuracy": {"edge": scene.edge, "elements_through_cortex": scene.elements_through_cortex}}
    name = scene.geometry.file
    path = Path(name)
    if not path.exists():                                               # then the name of a sample, if anything
        try:
            path = sample_path(name)
        except FileNotFoundError:
            path = Path(name)
    path = existing_file(path, "tetrahedral mesh")
    return {"geometry.file": {"file": name, "sha256": sha256_of(path), "bytes": path.stat().st_size}}


def check_inputs(folder: Path, scene: Scene) -> None:
    """Refuse a scene whose mesh is not the one that the run in ``folder`` began with: a file byte for byte."""
    now = inputs_of(scene)
    if not now:
        return
    (what, mine), = now.items()
    path = folder / "inputs.json"
    began = read_json(path, Inputs, f"Delete {folder} {ANEW}, or choose another folder.").get(what)
    if began is None:
        raise ValueError(f"{path}: has no {what}. Delete {folder} {ANEW}, or choose another folder.")
    if what == "accuracy" and began != mine:
        raise ValueError(
            f"{folder}: its run began with edges of {began['edge']:g} mm and {began['elements_through_cortex']} "
            f"elements through the cortex; accuracy.level = {scene.accuracy.level!r} stands for {mine['edge']:g} mm "
            f"and {mine['elements_through_cortex']} now. Choose another folder."
        )
    if what == "geometry.file" and began["sha256"] != mine["sha256"]:
        raise ValueError(
            f"{mine['file']}: has changed since the run in {folder} began (sha256 {began['sha256'][:12]}... then, "
            f"{mine['sha256'][:12]}... now). Put the old file back, or choose another folder."
        )


def begun_with(folder: Path) -> dict[str, Any]:
    """``inputs.json`` of the run in a folder; empty where none has begun, or it has none."""
    if not ((folder / "scene.toml").is_file() and (folder / "inputs.json").is_file()):
        return {}
    return read_json(folder / "inputs.json", Inputs, f"Delete {folder} {ANEW}, or choose another folder.")


def check_begun(folder: Path, own: Sequence[str], restart_from: str | Path | None) -> None:
    """Refuse to go on with a run that began with other effects of its caller's, or elsewhere."""
    begun = begun_with(folder)
    had, state = begun.get("effects", []), begun.get("restart", {}).get("file")
    if had != list(own):
        raise FileExistsError(
            f"{folder}: its run has effects beside those of its scene: {', '.join(had) or 'none'}; given are "
            f"{', '.join(own) or 'none'}. Go on in Python, mf.simulate(..., effects=[...], resume=True), with the same "
            "in their order, or choose another folder."
        )
    if restart_from is not None and not (state and Path(state).is_relative_to(os.path.abspath(restart_from))):
        raise FileExistsError(
            f"{folder}: its run began {f'at {state}' if state else 'ungrown'}, not at {restart_from}; choose another "
            "folder."
        )


def written_stages(folder: Path, scene: Scene) -> tuple[float, ...]:
    """Growth of the stages that the run in a folder writes: those of its scene but for those before it began."""
    start = begun_with(folder).get("restart")
    return tuple(g for g in scene.stages if start is None or g >= start["growth"])


def scene_digest(folder: Path) -> str:
    """SHA-256 of the scene of the run in a folder and of what it only names, as the run wrote both when it began."""
    found = [path.read_bytes() for name in ("scene.toml", "inputs.json") if (path := folder / name).is_file()]
    return hashlib.sha256(b"\0".join(found)).hexdigest()


# stages ------------------------------------------------------------------------------------------------------


def read_stage(out: Path, g: float) -> dict[str, Any]:
    """``stage.json`` of the stage at growth ``g``, once its files are found as they were written.

    A stage without ``files.json`` (their digests) need only have surfaces and maps that can be read; one without the
    digest of its scene may be of any.

    Raises
    ------
    ValueError
        If something is missing, cut or of another stage.
    """
    stage = stage_folder(out, g)
    beside = [name for name in ("checkpoint.npz", "health.json") if (out / name).exists()]
    cure = f"Delete {stage}{''.join(f' and {out / name}' for name in beside)}; --resume then grows it anew."
    record = stage / "stage.json"
    info = read_json(record, StageRecord, cure)
    if info.get("scene_sha256", scene_digest(out)) != scene_digest(out):
        raise ValueError(f"{record}: is of a run with another scene or mesh. {cure}")
    if info.get("g") != g or info.get("health", {}).get("growth") != g:
        raise ValueError(f"{record}: is of g = {info.get('g')!r} or without health, not of {g:g}. {cure}")
    listed = stage / "files.json"
    if listed.exists():
        with decoding(listed, "a list of files", cure):
            for name, digest in read_json(listed, Digests, cure).items():
                if not (stage / name).is_file():
                    raise ValueError(f"{name} is missing")
                if sha256_of(stage / name) != digest:
                    raise ValueError(f"{name} is not as it was written")
    with decoding(stage, "a stage", cure):
        read_cortex(stage)
    return info


def check_stages(out: Path, scene: Scene) -> dict[float, dict[str, Any]]:
    """The ``stage.json`` of each stage there is, by growth; refuses one that is damaged or none of the scene's."""
    found = {}
    known = {stage_folder(out, g): g for g in scene.stages}
    for path in sorted((out / "stages").glob("g*")):
        if path not in known:
            raise ValueError(f"{path}: is no stage of this scene. Move it away.")
        found[known[path]] = read_stage(out, known[path])
    return found


def check_reached(out: Path, scene: Scene, growth: float) -> None:
    """Refuse to go on from ``growth`` where a stage below it is missing: it could not be written any more."""
    for g in written_stages(out, scene):
        if g < growth and not stage_folder(out, g).exists():
            raise ValueError(
                f"{stage_folder(out, g)}: is missing, and {out / 'checkpoint.npz'} lies beyond it, at "
                f"g = {growth:.3f}. Delete the checkpoint {ANEW}."
            )


def check_finished(out: Path, scene: Scene) -> None:
    """Refuse a finished folder whose ``health.json`` isn't as a run writes it, or whose stages aren't as it says."""
    path, health = out / "health.json", read_health(out)
    if missing := {"effects", *(() if isinstance(scene.geometry, Radial) else ("elements",))} - health.keys():
        raise ValueError(f"{path}: lacks {', '.join(sorted(missing))}. Delete it {ANEW}.")
    grown = [stage.get("growth") for stage in health["stages"]]
    if grown != (stages := list(written_stages(out, scene))):
        raise ValueError(f"{path}: its stages are {grown}, those of the scene {stages}. Delete it {ANEW}.")
    found = check_stages(out, scene)
    for stage in health["stages"]:
        g = stage["growth"]
        if g not in found:
            raise ValueError(f"{stage_folder(out, g)}: is missing, and {path} names it. Delete {path} {ANEW}.")
        if found[g]["health"] != stage:
            raise ValueError(f"{path}: says of g = {g:g} other than {stage_folder(out, g)}. Delete {path} {ANEW}.")


# the state of a run ------------------------------------------------------------------------------------------


def read_arrays(path: Path, like: Mapping[str, NDArray]) -> dict[str, NDArray]:
    """Arrays by name from an .npz file, of the names, shapes and kinds of ``like``, finite.

    Raises
    ------
    ValueError
        If the file is anything else; by its checksums a single changed byte is found.
    """
    with decoding(path, "a checkpoint of this run", f"Delete it {ANEW}."):
        with np.load(existing_file(path, "checkpoint"), allow_pickle=False) as file:
            names = set(file.files)
            if names != like.keys():
                raise ValueError(f"it lacks, or has too much: {', '.join(sorted(names ^ like.keys()))}")
            for entry in file.zip.infolist():                           # before anything is unpacked
                name = entry.filename.removesuffix(".npy")
                if entry.file_size > 4 * like[name].nbytes + 4096:
                    raise ValueError(f"{name} unpacks to {entry.file_size:,} bytes, needs {like[name].nbytes:,}")
            found = {name: np.asarray(file[name]) for name in file.files}
        for name, array in found.items():
            shape, kind = like[name].shape, like[name].dtype.kind
            if array.shape != shape or array.dtype.kind != kind:
                raise ValueError(f"{name} has shape {array.shape} and type {array.dtype}, needs {shape} of '{kind}'")
            if kind == "f" and not np.isfinite(array).all():
                raise ValueError(f"{name} has {np.count_nonzero(~np.isfinite(array))} values that are not finite")
    return found


def as_lines(log: Sequence[Mapping[str, Any]]) -> str:
    """The text of ``log.jsonl``."""
    return "".join(json.dumps(line, allow_nan=False) + "\n" for line in log)


def as_bytes(text: str) -> NDArray[np.uint8]:
    """SHA-256 of a text, as a checkpoint holds it: (32,) uint8."""
    return np.frombuffer(hashlib.sha256(text.encode()).digest(), np.uint8)


def read_log(out: Path, step: int, lines: int, digest: NDArray[np.uint8]) -> list[dict[str, Any]]:
    """The lines of ``log.jsonl`` up to ``step``, of which there must be ``lines``, of this ``digest``.

    Raises
    ------
    ValueError
        If they can't be had: the log isn't as the run left it beside its checkpoint.
    """
    path = out / "log.jsonl"
    with decoding(path, "the log of this run", f"Delete {out / 'checkpoint.npz'} {ANEW}."):
        kept = []
        for number, text in enumerate(existing_file(path, "log").read_text("utf-8").splitlines(), start=1):
            line = _object(text, f"line {number}")
            if not isinstance(line.get("step"), int):
                raise ValueError(f"line {number} has no step")
            if line["step"] <= step:
                _check_line(line, number)
                kept.append(line)
        if len(kept) != lines:
            raise ValueError(f"it has {len(kept)} lines up to step {step}, had {lines}")
        if not np.array_equal(as_bytes(as_lines(kept)), digest):
            raise ValueError("its lines are not those of this checkpoint")
    return kept


def _check_line(line: Mapping[str, Any], number: int) -> None:
    seconds = line.get("seconds")
    values = [line.get("growth"), line.get("elapsed"), *(seconds.values() if isinstance(seconds, dict) else [None])]
    if not all(isinstance(v, int | float) and math.isfinite(v) for v in values):
        raise ValueError(f"line {number} lacks growth, elapsed or seconds")




def _object(text: str, what: str) -> dict[str, Any]:
    """A JSON object, without NaN or infinity."""

    def refuse(constant: str) -> None:
        raise ValueError(f"{what} holds {constant}")

    content = json.loads(text, parse_constant=refuse)
    if not isinstance(content, dict):
        raise ValueError(f"{what} is no JSON object")
    return content
