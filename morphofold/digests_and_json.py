"""Records of where numbers come from: digests of files, names that can be written, JSON that every reader accepts."""

import hashlib
import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import is_dataclass
from pathlib import Path
from typing import Any
from unicodedata import category

import numpy as np

from morphofold.surface import Cortex

#: categories of characters that end a line, control a terminal, or can't be printed
_UNPRINTABLE_CATEGORIES = ("Cc", "Cf", "Cs", "Zl", "Zp")
#: in a text of several lines, what controls a terminal or the direction of writing
CONTROL_PATTERN = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]")

Row = dict[str, Any]  # values by name: a row of a table, or an object of JSON


def sha256_of(path: Path) -> str:
    """SHA-256 of the bytes of a file."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def digests(folder: Path) -> dict[str, str]:
    """SHA-256 of each file in a folder and below, by its path from there."""
    return {p.relative_to(folder).as_posix(): sha256_of(p) for p in sorted(folder.rglob("*")) if p.is_file()}


def changed_since(digests: Mapping[str, str], files: Mapping[str, Path]) -> list[str]:
    """Names of the files in ``digests`` that are missing now, or have another digest."""
    present_digests = {name: sha256_of(files[name]) for name in digests if name in files and files[name].is_file()}
    return [name for name, digest in digests.items() if present_digests.get(name) != digest]


def input_records(paths: Iterable[str | Path]) -> list[Row]:
    """``{"path", "sha256", "bytes"}`` of each path; sha256 and bytes are None if it is not a file here."""
    records = []
    for path_text in map(str, paths):
        path = Path(path_text)
        digest, n_bytes = (sha256_of(path), path.stat().st_size) if path.is_file() else (None, None)
        records.append({"path": path_text, "sha256": digest, "bytes": n_bytes})
    return records


@contextmanager
def unchanged(paths: Iterable[str | Path]) -> Iterator[list[Row]]:
    """Context for reading files: yields their ``input_records``, which are those of the bytes that are read.

    Raises
    ------
    OSError
        If a file changed while it was read.
    """
    records = input_records(paths)
    yield records
    for old_record, new_record in zip(records, input_records(row["path"] for row in records)):
        if old_record != new_record:
            raise OSError(f"{old_record['path']}: changed while it was read. Run this again when no program writes it.")


def records_as_read(cortices: Sequence[Cortex], other_paths: Iterable[str | Path] = ()) -> list[Row]:
    """``input_records`` of ``other_paths`` as they are now, then of files of surfaces, for the bytes that were read."""
    record_by_path = {row["path"]: dict(row) for cortex in cortices for row in cortex.inputs}
    files = dict.fromkeys([*map(str, other_paths), *(file for cortex in cortices for file in cortex.files)])
    return [record_by_path.get(file) or input_records([file])[0] for file in files]


def printable(text: str) -> str:
    """Text that can be written as UTF-8; in a name that is not UTF-8, a byte such as 0xff becomes ``\\udcff``."""
    return text.encode("utf-8", "backslashreplace").decode("utf-8")


def clean_name(text: str) -> str:
    """A name from a file in one line: characters that end a line or control a terminal are escaped as in Python."""
    return "".join(
        c.encode("unicode_escape").decode("ascii") if category(c) in _UNPRINTABLE_CATEGORIES else c for c in text
    )


def strict_json(content: Any) -> str:
    """JSON that every reader accepts: NumPy values and records are plain, NaN and infinity null, other objects text."""
    text = json.dumps(json_value(content), indent=1, allow_nan=False, ensure_ascii=False)
    return CONTROL_PATTERN.sub(lambda control: f"\\u{ord(control[0]):04x}", text) + "\n"


def json_value(value: Any) -> Any:
    """A value as :func:`strict_json` writes it."""
    if isinstance(value, str):
        return printable(value)
    if value is None or isinstance(value, int):
        return value
    if isinstance(value, float):
        return float(value) if np.isfinite(value) else None
    if isinstance(value, np.generic | np.ndarray):
        return json_value(value.tolist())
    if is_dataclass(value):
        value = vars(value)
    if isinstance(value, Mapping):
        return {printable(str(key)): json_value(item) for key, item in value.items()}
    if isinstance(value, Sequence | set | frozenset):
        return [json_value(item) for item in value]
    return printable(str(value))
