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
from morphofold.studies.markdown import Row, cells, health, number, read_rows, renewed, table

Cells = tuple[str, list[list[str]]]
Summary = dict[str, Any]

#: criteria for two neighbouring meshes: least correlation of the outer radii, greatest change of GI [%]
SAME_FOLDS, SAME_GI = 0.95, 4.0
NAMES = {
    "gyrification_index": "GI",
    "gyri": "the number of gyri",
    "sulci": "the number of sulci",
    "wavelength_mm": "the wavelength",
    "gyral_thickness_mm": "the gyral thickness",
}


def text_tables(out: Path) -> list[str]:
    """The tables of a study as text, each below its title."""
    summary, tables = _read(out)
    return [f"{p.title}\n{table(*p.cells(tables[name], summary))}" for name, p in PARTS.items() if name in tables]


def write_page(out: Path, page: Path) -> list[str]:
    """Update the marked parts of ``page`` and its picture from a study; returns the names of the written files.

    For a table that the study left out, the reason is given instead.

    Raises
    ------
    FileNotFoundError
        If the page is missing, or ``out`` holds no summary, or lacks a file that the summary names.
    ValueError
        If the summary is of another command, or the page lacks one pair of marks for a part; the page is unchanged.
    """
    summary, tables = _read(out)
    text = page.read_text(encoding="utf-8")
    picture = page.with_suffix(".png")
    parts = {
        name: [part.sentences(tables[name], summary), table(*part.cells(tables[name], summary))]
        if name in tables
        else [f"Left out: {summary['left_out'][name]}."]
        for name, part in PARTS.items()
    }
    if "slope" in tables:
        parts["slope"].insert(1, f"![wavelength of the folds against the thickness of the cortex]({picture.name})")
    text = renewed(page, text, {**parts, "runs": [_runs(summary), health(summary["simulations"])]})
    if "slope" in tables:
        with atomic_file(picture) as temporary:
            save(thickness_figure(tables["folds"], tables["slope"], summary), temporary)
    write_text(page, text)
    return [str(page), *([str(picture)] if "slope" in tables else [])]


def _read(out: Path) -> tuple[Summary, dict[str, list[Row]]]:
    summary = read_json(out / "summary.json", FoldIndex, "Name a folder that `python3 run.py bench folds` wrote.")
    return summary, {file.removesuffix(".tsv"): read_rows(out / file) for file in summary["files"]}


# tables -----------------------------------------------------------------------------------------------------


def _folds(rows: Sequence[Row], summary: Summary) -> Cells:
    """The folds on the finest mesh, with the first seed."""
    parameters = summary["parameters"]
    heads = (
        "scene | g | GI | gyri | sulci | wavelength, mm | over T | theory, over T | gyral thickness, mm | cortex, mm"
    )
    columns = {"scene": "", "growth": "{:.2f}", "gyrification_index": "{:.2f}", "gyri": "{:.0f}", "sulci": "{:.0f}"}
    columns |= {"wavelength_mm": "{:.1f}", "over_T": "{:.2f}", "theory_over_T": "{:.2f}"}
    columns |= {"gyral_thickness_mm": "{:.1f}", "cortical_thickness_mm": "{:.2f}"}
    table_rows = []
    for row in rows:
        if (row["level"], row["seed"]) == (parameters["levels"][-1], parameters["seeds"][0]):
            T, wave = row["thickness_mm"], row["wavelength_mm"]
            table_rows.append({**row, "over_T": wave and wave / T, "theory_over_T": row["theory_wavelength_mm"] / T})
    return heads, cells(table_rows, columns)


def _convergence(rows: Sequence[Row], summary: Summary) -> Cells:
    heads = "scene | g | meshes | correlation | GI | change | gyri | sulci | wavelength, mm | change"

    def pair(row: Row, name: str, how: str) -> str:
        return f"{number(row[f'{name}_coarser'], how)} → {number(row[f'{name}_finer'], how)}"

    cell_rows = []
    for row in rows:
        meshes = f"{row['coarser']} → {row['finer']}", number(row["correlation"], "{:.3f}")
        indices = pair(row, "gyrification_index", "{:.2f}"), _signed(row["gyrification_index_change_percent"])
        counts = pair(row, "gyri", "{:.0f}"), pair(row, "sulci", "{:.0f}")
        wave_cells = pair(row, "wavelength_mm", "{:.1f}"), _signed(row["wavelength_mm_change_percent"])
        cell_rows.append([row["scene"], number(row["growth"], "{:.2f}"), *meshes, *indices, *counts, *wave_cells])
    return heads, cell_rows


def _spread(rows: Sequence[Row], summary: Summary) -> Cells:
    heads = "scene | g | GI | gyri | range | sulci | range | wavelength, mm | range"

    def mean_text(row: Row, name: str, number_format: str) -> str:
        mean, sd = row[f"{name}_mean"], row[f"{name}_sd"]
        return "–" if mean is None else f"{number_format.format(mean)} ± {number_format.format(sd)}"

    def range_text(row: Row, name: str, number_format: str) -> str:
        least, largest = row[f"{name}_min"], row[f"{name}_max"]
        return "–" if least is None else f"{number_format.format(least)} to {number_format.format(largest)}"

    cell_rows = []
    for row in rows:
        line = [row["scene"], number(row["growth"], "{:.2f}"), mean_text(row, "gyrification_index", "{:.3f}")]
        for name, number_format, range_format in (("gyri", "{:.1f}", "{:.0f}"), ("sulci", "{:.1f}", "{:.0f}")):
            line += [mean_text(row, name, number_format), range_text(row, name, range_format)]
        cell_rows.append([*line, mean_text(row, "wavelength_mm", "{:.2f}"), range_text(row, "wavelength_mm", "{:.2f}")])
    return heads, cell_rows


def _slope(rows: Sequence[Row], summary: Summary) -> Cells:
    heads = "law | of | mesh | g | points | slope, mm/mm | standard error | at T = 0, mm | theory | film formula"
    named_rows = [{**row, "number": NAMES[row["number"]].removeprefix("the ")} for row in rows]
    slope_columns = ("slope", "standard_error", "intercept", "theory_slope", "film_slope")
    columns = {"law": "", "number": "", "level": "", "growth": "{:.2f}", "points": "{:.0f}"}
    return heads, cells(named_rows, {**columns, **dict.fromkeys(slope_columns, "{:.2f}")})


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
        worst = min(correlated_rows, key=lambda row: row["correlation"])
        most = max(folded_rows, key=lambda row: abs(row["gyrification_index_change_percent"]))
        n_same_folds = sum(row["correlation"] >= SAME_FOLDS for row in correlated_rows)
        n_same = sum(abs(row["gyrification_index_change_percent"]) <= SAME_GI for row in folded_rows)
        wave_row = max(folded_rows, key=lambda row: abs(row["wavelength_mm_change_percent"]))
        sentences.append(
            f"Between **{coarser} and {finer}** it correlates at {SAME_FOLDS:g} or more in {n_same_folds} of "
            f"{len(folded_rows)} folded stages. The median correlation is "
            f"{np.median([row['correlation'] for row in correlated_rows]):.3f}, the least "
            f"{worst['correlation']:.3f} ({_where(worst)}). GI changes by {SAME_GI:g} % or less in {n_same}, most by "
            f"{_signed(most['gyrification_index_change_percent'])} ({_where(most)}). The wavelength changes most by "
            f"{_signed(wave_row['wavelength_mm_change_percent'])} ({_where(wave_row)})."
        )
    return "\n\n".join(sentences)


def _where(row: Row) -> str:
    return f"{row['scene']}, g = {row['growth']:.2f}"


def _signed(percent: float | None) -> str:
    return number(percent, "{:+.1f} %")


def _say_spread(rows: Sequence[Row], summary: Summary) -> str:
    sentences = []
    for name in ("gyrification_index", "gyri", "sulci", "wavelength_mm"):
        percents = [(100 * row[f"{name}_sd"] / row[f"{name}_mean"], row) for row in rows if row[f"{name}_mean"]]
        if percents:
            most, row = max(percents, key=lambda pair: pair[0])
            median = np.median([percent for percent, _ in percents])
            sentences.append(f"{NAMES[name]} {median:.1f} % in the median and {most:.1f} % at most ({_where(row)})")
    parameters = summary["parameters"]
    seeds = listed([str(seed) for seed in parameters["seeds"]])
    first_words = f"At level {parameters['all_seeds_at_level']}, over the {len(parameters['seeds'])} seeds {seeds}"
    text = f"the standard deviation over the mean is: {listed(sentences)}" if sentences else "nothing is folded"
    return f"{first_words}, {text}."


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
        last = fitted_rows[-1]["level"]
        slopes = [
            f"{number(row['slope'], '{:.2f}')} ± {number(row['standard_error'], '{:.2f}')} at g = {row['growth']:.2f}"
            for row in fitted_rows
            if row["level"] == last
        ]
        sentences.append(
            f"With **{law}** growth the wavelength increases, per mm of T, by {listed(slopes)} mm (level {last}). The "
            f"slope of the first wrinkles of linear stability is {law_rows[0]['theory_slope']:.2f}, that of the film "
            f"formula {law_rows[0]['film_slope']:.2f}."
        )
    return "\n\n".join(sentences)


def _runs(summary: Summary) -> str:
    runs = summary["simulations"]
    n_healthy = sum(entry["healthy"] for entry in runs)
    return f"{n_healthy} of {len(runs)} runs are healthy. Version {summary['morphofold']}."


class Part(NamedTuple):
    """One table of a study: its title in a terminal, its cells, and its text in a page."""

    title: str
    cells: Callable[[Sequence[Row], Summary], Cells]
    sentences: Callable[[Sequence[Row], Summary], str]


PARTS = {
    "folds": Part("folds on the finest mesh", _folds, _say_folds),
    "convergence": Part("coarser mesh → finer mesh, outer radius and folds", _convergence, _say_convergence),
    "spread": Part("mean ± standard deviation over seeds", _spread, _say_spread),
    "slope": Part("lines on cortical thickness T", _slope, _say_slope),
}
