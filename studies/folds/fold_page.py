"""Text tables, a Markdown page and a picture from the results of ``python3 run.py bench folds``."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from morphofold.io import atomic_file
from morphofold.io.files import write_text
from morphofold.io.json_files import read_json
from morphofold.number_texts import listed
from morphofold.report.plots.figure_style import save
from morphofold.studies.folds.fold_plots import thickness_figure
from morphofold.studies.index_schemas import FoldIndex
from morphofold.studies.markdown import Row, cells, number, read_rows, renewed, table, table_with_tsv

Cells = tuple[str, list[list[str]]]
Summary = dict[str, Any]

#: criteria for two neighbouring meshes: least correlation of the outer radii, greatest change of GI [%]
SAME_FOLDS, SAME_GI = 0.95, 4.0
LABELS = {
    "gyrification_index": "GI",
    "gyri": "the number of gyri",
    "sulci": "the number of sulci",
    "wavelength_mm": "the wavelength",
    "gyral_thickness_mm": "the gyral thickness",
}


def text_tables(out: Path) -> list[str]:
    """The tables of a study as text, each below its title."""
    summary, tables = _read(out)
    return [f"{part.title}\n{table(*part.cells(tables[key], summary))}" for key, part in PARTS.items() if key in tables]


def write_page(out: Path, page: Path) -> list[str]:
    """Update the marked parts of ``page`` and its picture from a study; returns the names of the written files.

    The page has the rows of the last growth, and all rows are in tables beside it (``PAGE-folds.tsv``), which are not
    among these names. For a table that the study left out, the reason is given instead.

    Raises
    ------
    FileNotFoundError
        If the page is missing, or ``out`` holds no summary, or lacks a file that the summary names.
    ValueError
        If the summary is of another command, or the page lacks one pair of marks for a part; the page is unchanged.
    """
    summary, tables = _read(out)
    text = page.read_text(encoding="utf-8")
    png_file = page.with_suffix(".png")
    blocks = {
        name: [part.sentences(tables[name], summary), _table_with_tsv(page, name, part, tables[name], summary)]
        if name in tables
        else [f"Left out: {summary['left_out'][name]}."]
        for name, part in PARTS.items()
    }
    if "slope" in tables:
        blocks["slope"].insert(1, f"![wavelength of the folds against the thickness of the cortex]({png_file.name})")
    text = renewed(page, text, {**blocks, "runs": _runs(page, summary)})
    if "slope" in tables:
        with atomic_file(png_file) as temporary_path:
            save(thickness_figure(tables["folds"], tables["slope"], summary), temporary_path)
    write_text(page, text)
    return [str(page), *([str(png_file)] if "slope" in tables else [])]


def _read(out: Path) -> tuple[Summary, dict[str, list[Row]]]:
    summary = read_json(out / "summary.json", FoldIndex, "Name a folder that `python3 run.py bench folds` wrote.")
    return summary, {file.removesuffix(".tsv"): read_rows(out / file) for file in summary["files"]}


def _table_with_tsv(page: Path, name: str, part: "Part", rows: Sequence[Row], summary: Summary) -> str:
    heads, cell_rows = part.cells(rows, summary)
    columns = [heads.split(" | ").index(head) for head in part.as_in_last_row]
    shown = lambda row_cells: all(row_cells[k] == cell_rows[-1][k] for k in columns)
    return table_with_tsv(page, name, heads, cell_rows, shown)


# tables -----------------------------------------------------------------------------------------------------


def _folds(rows: Sequence[Row], summary: Summary) -> Cells:
    """The folds on the finest mesh, with the first seed."""
    parameters = summary["parameters"]
    heads = (
        "scene | g | GI | gyri | sulci | wavelength, mm | over T | theory, over T | gyral thickness, mm | cortex, mm"
    )
    formats = {"scene": "", "growth": "{:.2f}", "gyrification_index": "{:.2f}", "gyri": "{:.0f}", "sulci": "{:.0f}"}
    formats |= {"wavelength_mm": "{:.1f}", "over_T": "{:.2f}", "theory_over_T": "{:.2f}"}
    formats |= {"gyral_thickness_mm": "{:.1f}", "cortical_thickness_mm": "{:.2f}"}
    table_rows = []
    for row in rows:
        if (row["level"], row["seed"]) == (parameters["levels"][-1], parameters["seeds"][0]):
            T, wave = row["thickness_mm"], row["wavelength_mm"]
            table_rows.append({**row, "over_T": wave and wave / T, "theory_over_T": row["theory_wavelength_mm"] / T})
    return heads, cells(table_rows, formats)


def _convergence(rows: Sequence[Row], summary: Summary) -> Cells:
    column_heads = "scene | g | meshes | correlation | GI | change | gyri | sulci | wavelength, mm | change"

    def pair(row: Row, column: str, number_format: str) -> str:
        return f"{number(row[f'{column}_coarser'], number_format)} → {number(row[f'{column}_finer'], number_format)}"

    cell_rows = []
    for row in rows:
        meshes = f"{row['coarser']} → {row['finer']}", number(row["correlation"], "{:.3f}")
        gi_cells = pair(row, "gyrification_index", "{:.2f}"), _signed(row["gyrification_index_change_percent"])
        count_cells = pair(row, "gyri", "{:.0f}"), pair(row, "sulci", "{:.0f}")
        wave_cells = pair(row, "wavelength_mm", "{:.1f}"), _signed(row["wavelength_mm_change_percent"])
        cell_rows.append([row["scene"], number(row["growth"], "{:.2f}"), *meshes, *gi_cells, *count_cells, *wave_cells])
    return column_heads, cell_rows


def _spread(rows: Sequence[Row], summary: Summary) -> Cells:
    heads = "scene | g | GI | gyri | range | sulci | range | wavelength, mm | range"

    def mean_text(row: Row, column: str, number_format: str) -> str:
        mean, sd = row[f"{column}_mean"], row[f"{column}_sd"]
        return "–" if mean is None else f"{number_format.format(mean)} ± {number_format.format(sd)}"

    def range_text(row: Row, column: str, number_format: str) -> str:
        least, largest = row[f"{column}_min"], row[f"{column}_max"]
        return "–" if least is None else f"{number_format.format(least)} to {number_format.format(largest)}"

    cell_rows = []
    for row in rows:
        line = [row["scene"], number(row["growth"], "{:.2f}"), mean_text(row, "gyrification_index", "{:.3f}")]
        for column, number_format, range_format in (("gyri", "{:.1f}", "{:.0f}"), ("sulci", "{:.1f}", "{:.0f}")):
            line += [mean_text(row, column, number_format), range_text(row, column, range_format)]
        cell_rows.append([*line, mean_text(row, "wavelength_mm", "{:.2f}"), range_text(row, "wavelength_mm", "{:.2f}")])
    return heads, cell_rows


def _slope(rows: Sequence[Row], summary: Summary) -> Cells:
    heads = "law | of | mesh | g | points | slope, mm/mm | standard error | at T = 0, mm | theory | film formula"
    named_rows = [{**row, "number": LABELS[row["number"]].removeprefix("the ")} for row in rows]
    slope_columns = ("slope", "standard_error", "intercept", "theory_slope", "film_slope")
    formats = {"law": "", "number": "", "level": "", "growth": "{:.2f}", "points": "{:.0f}"}
    return heads, cells(named_rows, {**formats, **dict.fromkeys(slope_columns, "{:.2f}")})


# sentences --------------------------------------------------------------------------------------------------


def _say_folds(rows: Sequence[Row], summary: Summary) -> str:
    parameters = summary["parameters"]
    n_unfolded = sum(row["wavelength_mm"] is None for row in rows)
    sentence = (
        f"At level {parameters['levels'][-1]}, seed {parameters['seeds'][0]}; simulated: {parameters['portion']}. "
        "The numbers are for the whole sphere, including the mirrored parts."
    )
    return sentence + (f" {n_unfolded} of {len(rows)} stages of all runs are not folded yet." if n_unfolded else "")


def _say_convergence(rows: Sequence[Row], summary: Summary) -> str:
    """A paragraph per pair of meshes."""
    sentences = [
        f"The outer radius is compared along {summary['parameters']['directions']:,} directions of the whole sphere. "
        "Each radius is the first hit from outside."
    ]
    for coarser, finer in dict.fromkeys((row["coarser"], row["finer"]) for row in rows):
        folded_rows = [row for row in rows if (row["coarser"], row["finer"]) == (coarser, finer) and row["folded"]]
        if not folded_rows:
            sentences.append(f"Between {coarser} and {finer} no stage is folded on both.")
            continue
        correlated_rows = [row for row in folded_rows if row["correlation"] is not None]
        least_row = min(correlated_rows, key=lambda row: row["correlation"])
        most_row = max(folded_rows, key=lambda row: abs(row["gyrification_index_change_percent"]))
        n_same_folds = sum(row["correlation"] >= SAME_FOLDS for row in correlated_rows)
        n_same_index = sum(abs(row["gyrification_index_change_percent"]) <= SAME_GI for row in folded_rows)
        wave_row = max(folded_rows, key=lambda row: abs(row["wavelength_mm_change_percent"]))
        sentences.append(
            f"Between **{coarser} and {finer}** it correlates at {SAME_FOLDS:g} or more in {n_same_folds} of "
            f"{len(folded_rows)} folded stages. The median correlation is "
            f"{np.median([row['correlation'] for row in correlated_rows]):.3f}, the least "
            f"{least_row['correlation']:.3f} ({_where(least_row)}). GI changes by {SAME_GI:g} % or less in "
            f"{n_same_index}, most by {_signed(most_row['gyrification_index_change_percent'])} ({_where(most_row)}). "
            f"The wavelength changes most by {_signed(wave_row['wavelength_mm_change_percent'])} ({_where(wave_row)})."
        )
    return "\n\n".join(sentences)


def _where(row: Row) -> str:
    return f"{row['scene']}, g = {row['growth']:.2f}"


def _signed(percent: float | None) -> str:
    return number(percent, "{:+.1f} %")


def _say_spread(rows: Sequence[Row], summary: Summary) -> str:
    sentences = []
    for name in ("gyrification_index", "gyri", "sulci", "wavelength_mm"):
        spread_pairs = [(100 * row[f"{name}_sd"] / row[f"{name}_mean"], row) for row in rows if row[f"{name}_mean"]]
        if spread_pairs:
            most, row = max(spread_pairs, key=lambda percent_row: percent_row[0])
            median = np.median([percent for percent, _ in spread_pairs])
            sentences.append(f"{LABELS[name]} {median:.1f} % in the median and {most:.1f} % at most ({_where(row)})")
    parameters = summary["parameters"]
    seeds_text = listed([str(seed) for seed in parameters["seeds"]])
    start_text = f"At level {parameters['all_seeds_at_level']}, over the {len(parameters['seeds'])} seeds {seeds_text}"
    spread_text = f"the standard deviation over the mean is: {listed(sentences)}" if sentences else "nothing is folded"
    return f"{start_text}, {spread_text}."


def _say_slope(rows: Sequence[Row], summary: Summary) -> str:
    """A sentence per law: the slope of the wavelength on the finest mesh that has lines."""
    sentences = [
        "Lines are least-squares fits on the thickness T of the cortex before growth, over all seeds of a mesh."
    ]
    for law in dict.fromkeys(row["law"] for row in rows):
        law_rows = [row for row in rows if (row["law"], row["number"]) == (law, "wavelength_mm")]
        fitted_rows = [row for row in law_rows if row["slope"] is not None]
        if not fitted_rows:
            sentences.append(f"With {law} growth the three bodies are not all folded at any growth.")
            continue
        last_level = fitted_rows[-1]["level"]
        slope_texts = [
            f"{number(row['slope'], '{:.2f}')} ± {number(row['standard_error'], '{:.2f}')} at g = {row['growth']:.2f}"
            for row in fitted_rows
            if row["level"] == last_level
        ]
        sentences.append(
            f"With **{law}** growth the wavelength increases, per mm of T, by {listed(slope_texts)} mm "
            f"(level {last_level}). The slope of the first wrinkles of linear stability "
            f"is {law_rows[0]['theory_slope']:.2f}, that of the film formula {law_rows[0]['film_slope']:.2f}."
        )
    return "\n\n".join(sentences)


def _runs(page: Path, summary: Summary) -> list[str]:
    """How many runs are healthy, and, of those at the finest level, why they are not."""
    runs, finest = summary["simulations"], summary["parameters"]["levels"][-1]
    rows = [
        [
            run["folder"].rpartition("/")[2],
            run["level"],
            *(number(run[count_key], "{:,}") for count_key in ("elements", "steps")),
            "; ".join(warning.partition(":")[0] for warning in run["warnings"]) or "–",
        ]
        for run in runs
    ]
    intro = f"{sum(run['healthy'] for run in runs)} of {len(runs)} runs are healthy. Version {summary['morphofold']}."
    heads = "run | level | bricks | steps | warnings"
    return [intro, table_with_tsv(page, "runs", heads, rows, lambda row_cells: row_cells[1] == finest)]


class Part(NamedTuple):
    """One table of a study: its title in a terminal, its cells, and its text in a page; the page has the rows that are
    as the last one below some heads."""

    title: str
    cells: Callable[[Sequence[Row], Summary], Cells]
    sentences: Callable[[Sequence[Row], Summary], str]
    as_in_last_row: tuple[str, ...] = ("g",)


PARTS = {
    "folds": Part("folds on the finest mesh", _folds, _say_folds),
    "convergence": Part(
        "coarser mesh → finer mesh, outer radius and folds", _convergence, _say_convergence, ("g", "meshes")
    ),
    "spread": Part("mean ± standard deviation over seeds", _spread, _say_spread),
    "slope": Part("lines on cortical thickness T", _slope, _say_slope, ("g", "mesh")),
}
