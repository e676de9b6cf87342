"""Inputs of a run beside its scene: the mesh that the scene only names, the caller's own effects, a state."""

import hashlib
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from morphofold.errors import DamagedFile, Mismatch
from morphofold.io.json_files import Count, Length, Record, read_json
from morphofold.provenance import sha256_of
from morphofold.sim.output.run_files import AND_GROW_AGAIN
from morphofold.sim.scene import MeshFile, Radial, Scene, UnfoldedCortex


class MeshBytes(Record):
    """The file of a mesh."""

    file: str
    sha256: str
    bytes: Count


class SubjectBytes(Record):
    """The files of the subject whose cortex grows: SHA-256 by content."""

    subject: str
    sha256: dict[str, str]


class MapBytes(Record):
    """The maps that a scene names: SHA-256 by content."""

    sha256: dict[str, str]


class MeshSize(Record):
    """Mesh size that a level of accuracy stood for."""

    edge: Length
    elements_through_cortex: Count


class Restart(Record):
    """The state of another run at which a run began: its file, that run's :func:`scene_digest`, the growth."""

    file: str
    sha256: str
    scene_sha256: str
    growth: Annotated[float, Field(ge=1, le=1000)]


class Inputs(Record):
    """``inputs.json``: a mesh file or a mesh size, a subject and maps if there are any; ``effects`` are the names of
    the caller's own effects."""

    geometry: Annotated[MeshBytes | None, Field(alias="geometry.file")] = None
    subject: Annotated[SubjectBytes | None, Field(alias="geometry.subject")] = None
    maps: MapBytes | None = None
    accuracy: MeshSize | None = None
    effects: list[str] = []
    restart: Restart | None = None


def inputs_of(scene: Scene) -> dict[str, dict[str, Any]]:
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
    if isinstance(scene.geometry, Radial):
        return {}
    if not isinstance(scene.geometry, MeshFile):
        size = {"accuracy": {"edge": scene.edge, "elements_through_cortex": scene.elements_through_cortex}}
        return {**size, **_subject_of(scene), **_maps_of(scene)}
    path = scene.geometry.path()
    file = {"file": scene.geometry.file, "sha256": sha256_of(path), "bytes": path.stat().st_size}
    return {"geometry.file": file, **_maps_of(scene)}


def check_inputs(folder: Path, scene: Scene) -> None:
    """Raise unless the mesh of a scene is that with which the run in ``folder`` began; a file byte for byte."""
    for what, mine in inputs_of(scene).items():
        _check_input(folder, scene, what, mine)


def _subject_of(scene: Scene) -> dict[str, dict[str, Any]]:
    if not isinstance(scene.geometry, UnfoldedCortex):
        return {}
    from morphofold.sim.hemisphere.subject import files_of_subject

    return {
        "geometry.subject": {"subject": scene.geometry.subject, "sha256": _digests(files_of_subject(scene.geometry))}
    }


def _maps_of(scene: Scene) -> dict[str, dict[str, Any]]:
    return {"maps": {"sha256": _digests(files)}} if (files := scene.map_files) else {}


def _digests(files: Mapping[str, Path]) -> dict[str, str]:
    return {what: sha256_of(path) for what, path in files.items()}


def _check_input(folder: Path, scene: Scene, what: str, mine: dict[str, Any]) -> None:
    path = folder / "inputs.json"
    began = read_json(path, Inputs, f"Delete {folder} {AND_GROW_AGAIN}, or choose another folder.").get(what)
    if began is None:
        raise DamagedFile(f"{path}: has no {what}. Delete {folder} {AND_GROW_AGAIN}, or choose another folder.")
    if what in ("geometry.subject", "maps") and began != mine:
        changed = sorted(name for name in mine["sha256"] if began["sha256"].get(name) != mine["sha256"][name])
        raise Mismatch(
            f"{mine.get('subject', 'maps')}: {' and '.join(changed) or 'a file'} changed since the run in {folder} "
            "began. Restore the old files, or choose another folder."
        )
    if what == "accuracy" and began != mine:
        raise Mismatch(
            f"{folder}: its run began with edges of {began['edge']:g} mm and {began['elements_through_cortex']} "
            f"elements through the cortex; accuracy.level = {scene.accuracy.level!r} now means {mine['edge']:g} mm "
            f"and {mine['elements_through_cortex']}. Choose another folder."
        )
    if what == "geometry.file" and began["sha256"] != mine["sha256"]:
        raise Mismatch(
            f"{mine['file']}: has changed since the run in {folder} began (sha256 {began['sha256'][:12]}... then, "
            f"{mine['sha256'][:12]}... now). Restore the old file, or choose another folder."
        )


def begun_with(folder: Path) -> dict[str, Any]:
    """Contents of ``inputs.json`` of the run in a folder; empty if no run has begun, or the run has none."""
    if not ((folder / "scene.toml").is_file() and (folder / "inputs.json").is_file()):
        return {}
    return read_json(folder / "inputs.json", Inputs, f"Delete {folder} {AND_GROW_AGAIN}, or choose another folder.")


def check_begun(folder: Path, own: Sequence[str], restart_from: str | Path | None) -> None:
    """Raise if the run in ``folder`` began with other own effects of the caller, or at another state."""
    begun = begun_with(folder)
    had, state = begun.get("effects", []), begun.get("restart", {}).get("file")
    if had != list(own):
        raise FileExistsError(
            f"{folder}: its run has own effects beside those of its scene: {', '.join(had) or 'none'}; given are "
            f"{', '.join(own) or 'none'}. Resume in Python, mf.simulate(..., effects=[...], resume=True), with the "
            "same effects in the same order, or choose another folder."
        )
    if restart_from is not None and not (state and Path(state).is_relative_to(os.path.abspath(restart_from))):
        raise FileExistsError(
            f"{folder}: its run began {f'at {state}' if state else 'ungrown'}, not at {restart_from}; choose another "
            "folder."
        )


def written_stages(folder: Path, scene: Scene) -> tuple[float, ...]:
    """Growth of the stages that the run in a folder writes: those of its scene from the growth at which it began."""
    start = begun_with(folder).get("restart")
    return tuple(g for g in scene.stages if start is None or g >= start["growth"])


def scene_digest(folder: Path) -> str:
    """SHA-256 of ``scene.toml`` and ``inputs.json`` of the run in a folder, as written when it began."""
    found = [path.read_bytes() for name in ("scene.toml", "inputs.json") if (path := folder / name).is_file()]
    return hashlib.sha256(b"\0".join(found)).hexdigest()
