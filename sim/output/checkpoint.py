"""Read the checkpoint and the log of a run to resume it; files that the run did not leave so are refused."""

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from morphofold.errors import DamagedFile, Mismatch
from morphofold.io.files import decoding, existing_file
from morphofold.sim.output.run_files import AND_GROW_AGAIN

#: what differs if these arrays of a checkpoint do
MARKS = {"scene": "another scene or mesh", "version": "another version of morphofold"}


def check_marks(path: Path, mine: Mapping[str, NDArray]) -> None:
    """Refuse a checkpoint of another scene, mesh or version: its arrays may be others than `read_arrays` expects.

    Raises
    ------
    Mismatch
        If ``scene`` or ``version`` of ``mine`` is another in the file.
    """
    with decoding(path, "a checkpoint of this run", f"Delete it {AND_GROW_AGAIN}."):
        with np.load(existing_file(path, "checkpoint"), allow_pickle=False) as file:
            small = {name for name in file.files if file.zip.getinfo(f"{name}.npy").file_size < 4096}
            others = [name for name in MARKS if name in small and not np.array_equal(file[name], mine[name])]
    if others:
        raise Mismatch(f"{path}: belongs to a run with {MARKS[others[0]]}. Delete it {AND_GROW_AGAIN}.")


def read_arrays(path: Path, like: Mapping[str, NDArray]) -> dict[str, NDArray]:
    """Arrays by name from an .npz file; names, shapes and kinds must be those of ``like``, values must be finite.

    Raises
    ------
    DamagedFile
        If the file differs from that; its checksums reveal a single changed byte.
    """
    with decoding(path, "a checkpoint of this run", f"Delete it {AND_GROW_AGAIN}."):
        with np.load(existing_file(path, "checkpoint"), allow_pickle=False) as file:
            names = set(file.files)
            if names != like.keys():
                raise DamagedFile(f"missing or unexpected arrays: {', '.join(sorted(names ^ like.keys()))}")
            found = {name: np.asarray(file[name]) for name in file.files}
        for name, array in found.items():
            shape, kind = like[name].shape, like[name].dtype.kind
            if array.shape != shape or array.dtype.kind != kind:
                raise DamagedFile(f"{name} has shape {array.shape} and type {array.dtype}, needs {shape} of '{kind}'")
            if kind == "f" and not np.isfinite(array).all():
                raise DamagedFile(f"{name} has {np.count_nonzero(~np.isfinite(array))} values that are not finite")
    return found


def as_lines(log: Sequence[Mapping[str, Any]]) -> str:
    """The text of ``log.jsonl``."""
    return "".join(json.dumps(line, allow_nan=False) + "\n" for line in log)


def as_bytes(text: str) -> NDArray[np.uint8]:
    """SHA-256 of a text, as a checkpoint holds it: (32,) uint8."""
    return np.frombuffer(hashlib.sha256(text.encode()).digest(), np.uint8)


def read_log(out: Path, lines: int, digest: NDArray[np.uint8]) -> list[dict[str, Any]]:
    """The first ``lines`` lines of ``log.jsonl``, whose SHA-256 must be ``digest``.

    The log is written before its checkpoint: a process killed between the two leaves more lines, which are dropped.

    Raises
    ------
    DamagedFile
        If the log is not as the run left it beside its checkpoint.
    """
    path = out / "log.jsonl"
    with decoding(path, "the log of this run", f"Delete {out / 'checkpoint.npz'} {AND_GROW_AGAIN}."):
        texts = existing_file(path, "log").read_text("utf-8").splitlines()
        if len(texts) < lines:
            raise DamagedFile(f"it has {len(texts)} lines, needs {lines}")
        log = [_json_object(text, f"line {number}") for number, text in enumerate(texts[:lines], start=1)]
        for number, line in enumerate(log, start=1):
            _check_log_line(line, number)
        if not np.array_equal(as_bytes(as_lines(log)), digest):
            raise DamagedFile("its lines do not belong to this checkpoint")
    return log


def _check_log_line(line: Mapping[str, Any], number: int) -> None:
    seconds = line.get("seconds")
    values = [line.get("growth"), line.get("elapsed"), *(seconds.values() if isinstance(seconds, dict) else [None])]
    if not all(isinstance(v, int | float) and math.isfinite(v) for v in values):
        raise DamagedFile(f"line {number} lacks growth, elapsed or seconds")


def _json_object(text: str, what: str) -> dict[str, Any]:
    """The JSON object in a text; raises on NaN and infinity."""

    def refuse(constant: str) -> None:
        raise DamagedFile(f"{what} holds {constant}")

    content = json.loads(text, parse_constant=refuse)
    if not isinstance(content, dict):
        raise DamagedFile(f"{what} is not a JSON object")
    return content
