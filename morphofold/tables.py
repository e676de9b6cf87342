"""Tables on disk: rows as dicts, written to tab-separated text and read back."""

from __future__ import annotations

import csv
import io
from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from morphofold.records import shown

MISSING = "n/a"


def write_table(path: Path, columns: Sequence[str], rows: Iterable[Mapping[str, Any]]) -> None:
    """Tab-separated, header always, ``n/a`` for what is missing; further columns follow as they appear."""
    rows = list(rows)
    extra = [k for k in dict.fromkeys(k for row in rows for k in row) if k not in columns]
    with path.open("w", encoding="utf-8", newline="") as file:
        lines = csv.writer(file, delimiter="\t", lineterminator="\n", quoting=csv.QUOTE_MINIMAL)
        lines.writerow([*columns, *extra])
        lines.writerows([cell(row.get(k)) for k in (*columns, *extra)] for row in rows)


def cell(value: Any) -> str:
    """A value as tables have it: seven digits, ``n/a`` for what is missing, text without tabs and line breaks."""
    if value is None:
        return MISSING
    if isinstance(value, bool | int | np.integer | np.bool_):
        return str(int(value))
    if isinstance(value, float | np.floating):
        return f"{float(value):.7g}" if np.isfinite(value) else MISSING
    return " ".join(shown(str(value)).split())  # no tab or line break may leave its cell


def read_table(path: Path, words: Collection[str] = (), count: int | None = None) -> list[dict[str, Any]]:
    """A table of an analysis, as ``write_table`` wrote it: numbers as numbers, None for n/a, text in columns ``words``.

    ``count`` is the number of rows that were written, where it is known.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If it was cut, has another number of rows than ``count``, or a line another number of cells than the header.
    """
    if not path.is_file():
        raise FileNotFoundError(f"{path}: missing from the analysis. Analyze anew.")
    try:
        text = path.read_text(encoding="utf-8")
    except UnicodeDecodeError:
        raise ValueError(f"{path}: is damaged: it is not UTF-8 text. Analyze anew.") from None
    if not text.endswith("\n"):
        raise ValueError(f"{path}: was cut: its last line has no end. Analyze anew.")
    try:
        rows = list(csv.DictReader(io.StringIO(text), delimiter="\t"))
    except csv.Error as error:
        raise ValueError(f"{path}: is no table ({error}). Analyze anew.") from None
    for number, row in enumerate(rows, start=2):
        if None in row or None in row.values():
            raise ValueError(f"{path}: line {number} has another number of cells than the header. Analyze anew.")
    if count not in (None, len(rows)):
        raise ValueError(f"{path}: has {len(rows)} rows of the {count!r:.20} that were written. Analyze anew.")
    return [{k: _value(v, k in words) for k, v in row.items()} for row in rows]


def _value(text: str, is_word: bool) -> Any:
    if text == MISSING:
        return None
    if not is_word:
        for kind in (int, float):
            try:
                return kind(text)
            except ValueError:
                pass
    return text
