"""Tables on disk: rows as dicts, written to tab-separated text and read back.

A cell has no tab, no line break and no quotation marks around it, so ``cut`` and ``awk`` find columns. No cell is a
formula of a spreadsheet: text that begins with ``= + - @`` or ``"``, and text that is ``n/a``, gets an apostrophe in
front, as in spreadsheets; ``read_table`` removes it.
"""

import math
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from morphofold.digests_and_json import Row, printable
from morphofold.errors import DamagedFile

MISSING_CELL = "n/a"

#: characters that end a cell or a line, or control a terminal
_CONTROL_CHARACTERS = dict.fromkeys([*range(32), *range(127, 160), 0x2028, 0x2029], " ")
_NEEDS_APOSTROPHE = re.compile(r"""'*(?:[=+\-@"]|n/a\Z)""")
_WHOLE_NUMBER, _DECIMAL_NUMBER = re.compile(r"-?\d{1,18}"), re.compile(r"-?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")


def write_table(path: Path, columns: Sequence[str], rows: Iterable[Mapping[str, Any]]) -> None:
    """Write a tab-separated table, always with a header, ``n/a`` for missing values; further columns come last."""
    rows = list(rows)
    all_columns = dict.fromkeys([*columns, *(key for row in rows for key in row)])
    with path.open("w", encoding="utf-8", errors="backslashreplace", newline="") as stream:
        stream.write(line(all_columns))
        stream.writelines(line([row.get(key) for key in all_columns]) for row in rows)


def line(values: Iterable[Any]) -> str:
    """A row of a table as text of its file."""
    return "\t".join(map(cell, values)) + "\n"


def cell(value: Any) -> str:
    """A value as text of a cell: seven digits, ``n/a`` if missing, text without tabs and line breaks."""
    if isinstance(value, int | np.integer | np.bool_):
        return f"{int(value)}"
    if isinstance(value, float | np.floating):
        return f"{float(value):.7g}" if np.isfinite(value) else MISSING_CELL
    return MISSING_CELL if value is None else _cell_of_text(f"{value}")


@lru_cache(maxsize=4096)  # names are repeated
def _cell_of_text(text: str) -> str:
    text = printable(text).translate(_CONTROL_CHARACTERS)
    return f"'{text}" if _NEEDS_APOSTROPHE.match(text) else text


def read_table(
    path: Path, text_columns: Collection[str] = (), n_rows: int | None = None, *, number_columns: Collection[str] = ()
) -> list[Row]:
    """Read a table that ``write_table`` wrote: numbers as numbers, None for n/a, text in columns ``text_columns``.

    ``n_rows`` is the number of rows that were written, if known; columns ``number_columns`` contain only numbers.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    DamagedFile
        If the file was truncated, the number of rows is not ``n_rows``, a line has more or fewer cells than the header,
        or a cell of ``number_columns`` is not a finite number.
    """
    if not path.is_file():
        raise FileNotFoundError(f"{path}: missing from the analysis. Analyze again.")
    try:
        return _rows(path.read_text("utf-8"), text_columns, n_rows, number_columns)
    except ValueError as error:  # or it is not UTF-8 text
        raise DamagedFile(f"{path}: {error}. Analyze again.") from None


def _rows(text: str, text_columns: Collection[str], n_rows: int | None, number_columns: Collection[str]) -> list[Row]:
    if not text.endswith("\n"):
        raise DamagedFile("it was truncated: its last line has no end")
    header_cells, *cell_rows = [row.split("\t") for row in text[:-1].split("\n")]
    columns, rows = list(map(_without_apostrophe, header_cells)), []
    for line_number, cells in enumerate(cell_rows, start=2):
        if len(cells) != len(columns):
            raise DamagedFile(f"line {line_number} has more or fewer cells than the header")
        rows.append({column: _cell_value(cell, column in text_columns) for column, cell in zip(columns, cells)})
        for column in number_columns:
            if isinstance(value := rows[-1].get(column), str):
                raise DamagedFile(f"line {line_number}: {column} is {value!r:.40}, not a number")
    if n_rows not in (None, len(rows)):
        raise DamagedFile(f"it has {len(rows)} rows of the {n_rows!r:.20} that were written")
    return rows


def _cell_value(text: str, is_text: bool) -> Any:
    if text == MISSING_CELL:
        return None
    if not is_text:
        if _WHOLE_NUMBER.fullmatch(text):
            return int(text)
        if _DECIMAL_NUMBER.fullmatch(text) and math.isfinite(float(text)):
            return float(text)
    return _without_apostrophe(text)


def _without_apostrophe(text: str) -> str:
    return text[1:] if text.startswith("'") and _NEEDS_APOSTROPHE.match(text) else text
