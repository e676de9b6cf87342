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


def keep_figures(out: Path, folder: Path, figure_names: Collection[str], redrawn: Iterable[str]) -> dict[str, Any]:
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
    index_path = out / "summary.json"
    if not index_path.exists():
        return {}
    figure_entries = read_json(index_path, FigureIndex, CURE_TEXT)["figures"]
    kept_entries = {}
    for name in sorted(set(figure_entries) & set(figure_names) - set(redrawn), key=list(figure_names).index):
        file_names, digest_of_file = figure_entries[name]["files"], figure_entries[name].get("sha256", {})
        if not all((out / file_name).is_file() for file_name in file_names):
            continue
        for file_name in file_names:
            shutil.copy2(out / file_name, folder / file_name)
            if sha256_of(folder / file_name) != digest_of_file.get(file_name, sha256_of(folder / file_name)):
                raise Mismatch(f"{out / file_name}: has changed since it was drawn. Move it away, or draw {name}, too.")
        kept_entries[name] = figure_entries[name]
    return kept_entries
