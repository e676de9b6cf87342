"""Records of where numbers come from: the digests of input files, and JSON that every reader accepts."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np


def input_records(paths: Iterable[str | Path]) -> list[dict[str, Any]]:
    """``{"path", "sha256", "bytes"}`` of each path; sha256 and bytes are None for what is not a file here."""
    records: list[dict[str, Any]] = []
    for name in map(str, paths):
        path = Path(name)
        if path.is_file():
            with path.open("rb") as file:
                digest = hashlib.file_digest(file, "sha256").hexdigest()
            records.append({"path": name, "sha256": digest, "bytes": path.stat().st_size})
        else:
            records.append({"path": name, "sha256": None, "bytes": None})
    return records


def strict_json(content: Any) -> str:
    """JSON that every reader accepts: NumPy values made plain, NaN and infinity null, anything else text."""
    return json.dumps(_plain(content), indent=1, allow_nan=False, ensure_ascii=False) + "\n"


def _plain(value: Any) -> Any:
    if value is None or isinstance(value, str | bool | int):
        return value
    if isinstance(value, float | np.floating):
        return float(value) if np.isfinite(value) else None
    if isinstance(value, np.generic | np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, Sequence | set | frozenset):
        return [_plain(v) for v in value]
    return str(value)
