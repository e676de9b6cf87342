"""The stages of a run and its ``health.json``, read back: whole and of this run, or refused with the cure."""

from __future__ import annotations

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
from morphofold.sim.output.run_files import ANEW, Digests, stage_folder
from morphofold.sim.scene import Radial, Scene


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


def read_health(folder: Path) -> dict[str, Any]:
    """``health.json`` of a finished run; raises as :func:`morphofold.io.json_files.read_json` does."""
    return read_json(folder / "health.json", Health, f"Delete it {ANEW}.")


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
        raise Mismatch(f"{record}: is of a run with another scene or mesh. {cure}")
    if info.get("g") != g or info.get("health", {}).get("growth") != g:
        raise DamagedFile(f"{record}: is of g = {info.get('g')!r} or without health, not of {g:g}. {cure}")
    listed = stage / "files.json"
    if listed.exists():
        with decoding(listed, "a list of files", cure):
            for name, digest in read_json(listed, Digests, cure).items():
                if not (stage / name).is_file():
                    raise DamagedFile(f"{name} is missing")
                if sha256_of(stage / name) != digest:
                    raise DamagedFile(f"{name} is not as it was written")
    with decoding(stage, "a stage", cure):
        read_cortex(stage)
    return info


def check_stages(out: Path, scene: Scene) -> dict[float, dict[str, Any]]:
    """The ``stage.json`` of each stage there is, by growth; refuses one that is damaged or none of the scene's."""
    found = {}
    known = {stage_folder(out, g): g for g in scene.stages}
    for path in sorted((out / "stages").glob("g*")):
        if path not in known:
            raise Mismatch(f"{path}: is no stage of this scene. Move it away.")
        found[known[path]] = read_stage(out, known[path])
    return found


def check_reached(out: Path, scene: Scene, growth: float) -> None:
    """Refuse to go on from ``growth`` where a stage below it is missing: it could not be written any more."""
    for g in written_stages(out, scene):
        if g < growth and not stage_folder(out, g).exists():
            raise MissingPart(
                f"{stage_folder(out, g)}: is missing, and {out / 'checkpoint.npz'} lies beyond it, at "
                f"g = {growth:.3f}. Delete the checkpoint {ANEW}."
            )


def check_finished(out: Path, scene: Scene) -> None:
    """Refuse a finished folder whose ``health.json`` isn't as a run writes it, or whose stages aren't as it says."""
    path, health = out / "health.json", read_health(out)
    if missing := {"effects", *(() if isinstance(scene.geometry, Radial) else ("elements",))} - health.keys():
        raise DamagedFile(f"{path}: lacks {', '.join(sorted(missing))}. Delete it {ANEW}.")
    grown = [stage.get("growth") for stage in health["stages"]]
    if grown != (stages := list(written_stages(out, scene))):
        raise Mismatch(f"{path}: its stages are {grown}, those of the scene {stages}. Delete it {ANEW}.")
    found = check_stages(out, scene)
    for stage in health["stages"]:
        g = stage["growth"]
        if g not in found:
            raise MissingPart(f"{stage_folder(out, g)}: is missing, and {path} names it. Delete {path} {ANEW}.")
        if found[g]["health"] != stage:
            raise Mismatch(f"{path}: says of g = {g:g} other than {stage_folder(out, g)}. Delete {path} {ANEW}.")
