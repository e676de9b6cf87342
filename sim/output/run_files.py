"""The files of a run in a folder: find them, remove incomplete ones of a killed run, remove all."""

import re
import shutil
from contextlib import suppress
from pathlib import Path

from pydantic import RootModel

from morphofold.io import files_of
from morphofold.io.folders import LOCK_FILE, MARKER_FILE
from morphofold.io.json_files import read_json

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


def stage_folder(out: Path, g: float) -> Path:
    return out / "stages" / f"g{g:.2f}"


def is_temporary(path: Path) -> bool:
    """Whether a path has the temporary name of a file that a run has not finished writing."""
    return _TEMPORARY_NAME.fullmatch(path.name) is not None


def sweep(folder: Path) -> None:
    """Remove files that a killed run had not finished writing, known by their temporary names."""
    for place in (folder, folder / "stages"):
        for path in place.iterdir() if place.is_dir() else ():
            if not is_temporary(path):
                continue
            if path.is_dir() and not path.is_symlink():
                shutil.rmtree(path)
            else:
                path.unlink()


def files_of_run(folder: Path) -> dict[str, Path]:
    """Files that a run wrote in its folder, by their relative path."""
    found = {name: folder / name for name in _RUN_FILE_NAMES}
    for stage in sorted((folder / "stages").glob("g*")):
        found |= {f"stages/{stage.name}/{name}": path for name, path in files_of(stage).items()}
    return {name: path for name, path in found.items() if path.is_file()}


def clear_run(folder: Path) -> None:
    """Remove the files of a run from its folder, and the folder.

    Raises
    ------
    FileExistsError
        If the folder holds other files; then nothing is removed.
    """
    sweep(folder)
    ours = {folder / name for name in (*_RUN_FILE_NAMES, LOCK_FILE)}
    for stage in (folder / "stages").glob("g*"):
        with suppress(OSError, ValueError):  # the list is damaged, or the run is older than such lists
            ours |= {stage / name for name in read_json(stage / "files.json", Digests, AND_GROW_AGAIN)}
        ours |= {stage / "files.json", stage / MARKER_FILE, *files_of(stage).values()}
    there = [path for path in folder.rglob("*") if path.is_symlink() or not path.is_dir()]
    if others := [path for path in there if path not in ours]:
        raise FileExistsError(f"{others[0]}: was not written by a run, so {folder} can't be cleared. Move it away.")
    for path in there:
        path.unlink()
    shutil.rmtree(folder)  # only empty folders are left
