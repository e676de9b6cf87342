"""Required content of the index files (``summary.json``) of ``reproduce`` and ``bench``."""

import shutil
from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from morphofold.digests_and_json import sha256_of
from morphofold.errors import Mismatch
from morphofold.io.json_files import Amount, Count, Record, read_json
from morphofold.tables import write_table

CURE_TEXT = "Delete it."


class GrownRecord(Record):
    """A simulation of a figure or a study."""

    folder: str
    seconds: Amount
    level: str
    healthy: bool
    warnings: list[str]
    elements: Count | None
    steps: Count


class FigureRecord(Record):
    """A drawn figure; earlier versions wrote no digests of its files."""

    files: list[str]
    shows: str
    seconds: Amount = 0.0
    sha256: dict[str, str] = {}
    simulations: list[GrownRecord] = []


class FigureIndex(Record):
    """Index of ``reproduce``."""

    figures: dict[str, FigureRecord]


class FoldParameters(Record):
    """Parameters of a study of folds."""

    levels: list[str]
    seeds: list[int]
    all_seeds_at_level: str


class FoldIndex(Record):
    """Index of ``bench folds``."""

    parameters: FoldParameters
    files: list[str]
    left_out: dict[str, str]
    simulations: list[GrownRecord]


class AccuracyIndex(Record):
    """Index of ``bench accuracy``."""

    shows: str
    made: dict[str, Any]
    halves: list[str]
    files: list[str]
    errors: dict[str, Any] | None


def write_tables(folder: Path, tables: Mapping[str, tuple[Sequence[Mapping[str, Any]], str]]) -> dict[str, Any]:
    """Write tables into ``folder`` by name; each comes with the reason for leaving it out if it has no rows.

    Returns
    -------
    dict
        Their entry in an index: the written ``files``, and the tables that were ``left_out``, with the reasons.
    """
    for name, (rows, _) in tables.items():
        if rows:
            write_table(folder / f"{name}.tsv", (), rows)
    return {
        "files": [f"{name}.tsv" for name, (rows, _) in tables.items() if rows],
        "left_out": {name: reason for name, (rows, reason) in tables.items() if not rows},
    }


def keep_figures(out: Path, folder: Path, names: Collection[str], redrawn: Iterable[str]) -> dict[str, Any]:
    """Copy into ``folder`` the figures in ``out`` that an earlier run drew and that are not drawn again.

    Returns
    -------
    dict
        Their entries of the index. A figure with a missing file is left out.

    Raises
    ------
    ValueError
        If ``out/summary.json`` is not an index, or a file has changed since its figure was drawn.
    """
    path = out / "summary.json"
    if not path.exists():
        return {}
    entries = read_json(path, FigureIndex, CURE_TEXT)["figures"]
    unchanged_entries = {}
    for name in sorted(set(entries) & set(names) - set(redrawn), key=list(names).index):
        files, digests = entries[name]["files"], entries[name].get("sha256", {})
        if not all((out / file).is_file() for file in files):
            continue
        for file in files:
            shutil.copy2(out / file, folder / file)
            if sha256_of(folder / file) != digests.get(file, sha256_of(folder / file)):
                raise Mismatch(f"{out / file}: has changed since it was drawn. Move it away, or draw {name}, too.")
        unchanged_entries[name] = entries[name]
    return unchanged_entries
