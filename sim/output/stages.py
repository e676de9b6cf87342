"""Read the stages of a run and its ``health.json``; damaged files and files of another run are refused."""

from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from morphofold.errors import DamagedFile, Mismatch, MissingPart
from morphofold.io import read_cortex
from morphofold.io.cortices import StageHealth, StageRecord
from morphofold.io.files import decoding
from morphofold.io.json_files import Amount, Count, Length, Record, read_json
from morphofold.provenance import sha256_of
from morphofold.sim.output.inputs import scene_digest, written_stages
from morphofold.sim.output.run_files import AND_GROW_AGAIN, Digests, stage_folder
from morphofold.sim.scene import Radial, Scene


class Health(Record):
    """``health.json`` of a finished run; entries that early versions did not write have a default."""

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


def read_health(folder: Path) -> dict[str, Any]:
    """Contents of ``health.json`` of a finished run; raises as :func:`morphofold.io.json_files.read_json`."""
    return read_json(folder / "health.json", Health, f"Delete it {AND_GROW_AGAIN}.")


def read_stage(out: Path, g: float) -> dict[str, Any]:
    """Contents of ``stage.json`` at growth ``g``, after a check that the files of the stage are unchanged.

    If a stage has no ``files.json`` (digests of its files), its surfaces and maps must be readable. If it has no digest
    of its scene, the scene is not checked.

    Raises
    ------
    ValueError
        If something is missing, truncated or of another stage.
    """
    stage = stage_folder(out, g)
    beside = [name for name in ("checkpoint.npz", "health.json") if (out / name).exists()]
    cure = f"Delete {stage}{''.join(f' and {out / name}' for name in beside)}; --resume then grows it again."
    record = stage / "stage.json"
    info = read_json(record, StageRecord, cure)
    if info.get("scene_sha256", scene_digest(out)) != scene_digest(out):
        raise Mismatch(f"{record}: belongs to a run with another scene or mesh. {cure}")
    if info.get("g") != g or info.get("health", {}).get("growth") != g:
        raise DamagedFile(f"{record}: is for g = {info.get('g')!r} or has no health numbers for {g:g}. {cure}")
    listed = stage / "files.json"
    if listed.exists():
        with decoding(listed, "a list of files", cure):
            for name, digest in read_json(listed, Digests, cure).items():
                if not (stage / name).is_file():
                    raise DamagedFile(f"{name} is missing")
                if sha256_of(stage / name) != digest:
                    raise DamagedFile(f"{name} has changed since it was written")
    with decoding(stage, "a stage", cure):
        read_cortex(stage)
    return info


def check_stages(out: Path, scene: Scene) -> dict[float, dict[str, Any]]:
    """The ``stage.json`` of each stage in the folder, by growth; raises if one is damaged or not of the scene."""
    found = {}
    known = {stage_folder(out, g): g for g in scene.stages}
    for path in sorted((out / "stages").glob("g*")):
        if path not in known:
            raise Mismatch(f"{path}: is not a stage of this scene. Move it away.")
        found[known[path]] = read_stage(out, known[path])
    return found


def check_reached(out: Path, scene: Scene, growth: float) -> None:
    """Raise if a stage below ``growth``, that of the checkpoint, is missing: it could not be written any more."""
    for g in written_stages(out, scene):
        if g < growth and not stage_folder(out, g).exists():
            raise MissingPart(
                f"{stage_folder(out, g)}: is missing, and {out / 'checkpoint.npz'} is beyond it, at "
                f"g = {growth:.3f}. Delete the checkpoint {AND_GROW_AGAIN}."
            )


def check_finished(out: Path, scene: Scene) -> None:
    """Raise if ``health.json`` of a finished run is incomplete, or does not agree with its stages."""
    path, health = out / "health.json", read_health(out)
    if missing := {"effects", *(() if isinstance(scene.geometry, Radial) else ("elements",))} - health.keys():
        raise DamagedFile(f"{path}: lacks {', '.join(sorted(missing))}. Delete it {AND_GROW_AGAIN}.")
    grown = [stage.get("growth") for stage in health["stages"]]
    if grown != (stages := list(written_stages(out, scene))):
        raise Mismatch(f"{path}: its stages are {grown}, but the scene has {stages}. Delete it {AND_GROW_AGAIN}.")
    found = check_stages(out, scene)
    for stage in health["stages"]:
        g = stage["growth"]
        if g not in found:
            raise MissingPart(
                f"{stage_folder(out, g)}: is missing, but {path} lists it. Delete {path} {AND_GROW_AGAIN}."
            )
        if found[g]["health"] != stage:
            raise Mismatch(
                f"{path}: disagrees at g = {g:g} with {stage_folder(out, g)}. Delete {path} {AND_GROW_AGAIN}."
            )
