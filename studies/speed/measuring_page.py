"""The generated parts of docs/speed.md on measuring: seconds of each step by size, pairs of versions, and peers.

``python -m morphofold.studies.speed.measuring_page PAGE --measures FILE --pairs FILE --peers FILE`` writes them after
the marks ``<!-- measures -->``, ``<!-- pairs -->`` and ``<!-- peers -->`` of the Markdown page PAGE, and beside it all
pairs and peers (``speed-peers.tsv``) and the picture ``speed-measures.png``. The files hold the output of ``python3
run.py bench measures --json``, of the same with ``--against PYTHON``, and with ``--peers``.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cyclopts
import numpy as np

from morphofold.io import atomic_file
from morphofold.report.plots.figure_style import BLACK, legend_of_figure, line_style, new_figure, save
from morphofold.studies.accuracy.error_points import OUR_CODE
from morphofold.studies.markdown import Row, cells, table, table_with_tsv, update_page
from morphofold.studies.speed.measuring_speed import exponent
from morphofold.studies.speed.speed_page import LongTable, read_rows, whole_table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SHOWN_PAIRS = ("all", "gyral graph", "local gyrification")  # measures of which the page shows the pairs
PICTURE_NAME = "speed-measures.png"


def write_page(page: Path, *, measures: Path, pairs: Path, peers: Path) -> None:
    """Update the marked parts of ``page``, and its picture.

    Raises
    ------
    FileNotFoundError, ValueError
        If a file is missing or has other content, or the page lacks marks. The page is then unchanged.
    """
    step_rows = read_rows(measures, "measures", "vertices", "seconds", "threads")
    pair_rows = read_rows(pairs, "measures --against PYTHON", "seconds", "other_seconds", "ratio")
    peer_rows = read_rows(peers, "measures --peers", "seconds", "error")
    long_table = partial(table_with_tsv, page)
    pairs_text, peers_text = _pairs(pair_rows, long_table), _peers(peer_rows, long_table)
    update_page(page, {"measures": steps_part(step_rows), "pairs": pairs_text, "peers": peers_text})
    with atomic_file(page.parent / PICTURE_NAME) as temporary_file:
        save(speed_figure(step_rows), temporary_file)


def steps_part(rows: Sequence[Row]) -> list[str]:
    """Seconds of each step by size; the page shows these parts, and bench prints them."""
    sizes = sorted({row["vertices"] for row in rows})
    table_rows = []
    for step in dict.fromkeys(row["stage"] for row in rows):
        seconds_cells = [f"{row['seconds']:.2f}" for row in rows if row["stage"] == step]
        table_rows.append([step, *seconds_cells, f"{exponent(rows, step):.2f}" if len(sizes) > 1 else "–"])
    memory_cells = [f"{row['memory_GiB']:.2f}" for row in rows if row.get("memory_GiB")]
    return [
        f"Seconds with {rows[0]['threads']} threads. Steps run beside each other; their times add up to the time that "
        "passed. The last column is the power p for which the time grows as (n log n)^p:",
        table(["step", *(f"{size:,}" for size in sizes), "p"], [*table_rows, ["peak memory, GiB", *memory_cells, "–"]]),
    ]


def pairs_part(rows: Sequence[Row]) -> list[str]:
    """Two installations beside each other, all measures, as bench prints them."""
    return _pairs(rows, whole_table)


def _pairs(rows: Sequence[Row], long_table: LongTable) -> list[str]:
    """Two installations beside each other; the page shows ``SHOWN_PAIRS``."""
    heads = ["measure", "here, s", "there, s", "ratio", "quartiles"]
    formats = {"case": "", "seconds": "{:.2f}", "other_seconds": "{:.2f}", "ratio": "{:.2f}", "spread": ""}
    spread_rows = [{**row, "spread": f"{row['low']:.2f} to {row['high']:.2f}"} for row in rows]
    return [
        f"{rows[0]['repeats']} pairs for each measure, {rows[0]['vertices']:,} vertices:",
        long_table("pairs", heads, cells(spread_rows, formats), lambda row_cells: row_cells[0] in SHOWN_PAIRS),
    ]


def peers_part(rows: Sequence[Row]) -> list[str]:
    """Other programs beside ours, all of them, as bench prints them."""
    return _peers(rows, whole_table)


def _peers(rows: Sequence[Row], long_table: LongTable) -> list[str]:
    """Other programs beside ours; the page shows ours, and the fastest other one of each quantity."""
    formats = {"quantity": "", "program": "", "seconds": "{:.2f}", "error": "{:.2%}"}
    others = sorted((row for row in rows if not _is_ours(row["program"])), key=lambda row: -row["seconds"])
    fastest = {row["quantity"]: row["program"] for row in others}
    shown = lambda row_cells: _is_ours(row_cells[1]) or fastest[row_cells[0]] == row_cells[1]
    return [
        f"{rows[0]['vertices']:,} vertices; the error is the area-weighted rms over that of the exact values:",
        long_table("peers", ["quantity", "program", "seconds", "error"], cells(rows, formats), shown),
    ]


def _is_ours(program: str) -> bool:
    return program.startswith(OUR_CODE)


def speed_figure(rows: Sequence[Row]) -> Figure:
    """Seconds of each stage against the number of vertices, compared with n log n."""
    n = np.array([row["vertices"] for row in rows if row["stage"] == "all"], dtype=np.float64)
    total_seconds = np.array([row["seconds"] for row in rows if row["stage"] == "all"])
    with new_figure(6.4, 4.8, 1, 1) as (figure, ((ax,),)):
        styles: dict[str, Any] = {"all": {"color": BLACK, "marker": "o", "markersize": 4}}
        stages = [stage for stage in dict.fromkeys(row["stage"] for row in rows) if stage != "all"]
        styles |= {stage: line_style(k) for k, stage in enumerate(stages)}
        for stage, style in styles.items():
            ax.plot(n, [row["seconds"] for row in rows if row["stage"] == stage], **style)
        mid_size = len(n) // 2
        styles["n log n"] = {"color": "#bbbbbb", "linewidth": 5, "zorder": 0}
        ax.plot(n, total_seconds[mid_size] * n * np.log(n) / (n[mid_size] * np.log(n[mid_size])), **styles["n log n"])
        ax.set(xscale="log", yscale="log", xlabel="vertices", ylabel="seconds")
        legend_of_figure(figure, styles, ax, columns=3)
    return figure


if __name__ == "__main__":
    cyclopts.run(write_page)
