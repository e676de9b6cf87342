"""Pictures and tables that are shown for each figure, in docs/figures.md and in a page."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from scipy import stats

from morphofold.studies import markdown
from morphofold.studies.folds.fold_agreement import line
from morphofold.studies.markdown import Row, cells, number, read_rows
from morphofold.studies.paper.paper_folds import FIG5, FIG6, FIG7, Column
from morphofold.studies.paper.paper_theory import ONE_D, THREE_D

Tables = dict[str, list[Row]]

#: columns of the figures' tables that stay text
TEXT_COLUMNS = (*markdown.TEXT_COLUMNS, "surface", "other_surface", "points", "kind", "subject", "hemi", "verdict")
#: heads of the table of folds -> the column of the table of the figure, and the format of its numbers
FOLD_COLUMNS = {
    "g": ("growth", "{:.2f}"),
    "GI": ("gyrification_index", "{:.2f}"),
    "rms, mm": ("height_rms_mm", "{:.2f}"),
    "skewness": ("height_skewness", "{:.2f}"),
    "sulci": ("sulci", "{:.0f}"),
    "gyri": ("gyri", "{:.0f}"),
    "degree": ("degree", "{:.1f}"),
    "wavelength, mm": ("wavelength_mm", "{:.1f}"),
    "gyral thickness, mm": ("gyral_thickness_mm", "{:.1f}"),
    "cortex, mm": ("cortical_thickness_mm", "{:.2f}"),
    "crossings": ("crossings", "{:.0f}"),
}

SEED_HEADS = ("GI", "skewness", "sulci", "degree", "gyral thickness, mm")  # columns that are shown for three seeds


@dataclass(frozen=True)
class Image:
    """The picture ``name``.png and its description."""

    name: str
    description: str


@dataclass(frozen=True)
class Table:
    """A table: heads of columns, and cells as text. A long one has a name, for a file beside docs/figures.md."""

    heads: Sequence[str]
    rows: Sequence[Sequence[str]]
    name: str = ""


def read_tables(folder: Path, files: Sequence[str]) -> Tables:
    """The tables among the files of a figure, by file name."""
    return {file: read_rows(folder / file, TEXT_COLUMNS) for file in files if file.endswith(".tsv")}


def _fig3(tables: Tables) -> list[Image | Table]:
    radius_rows, stress_rows = tables["fig3a.tsv"], tables["fig3b.tsv"]

    def worst(rows: Sequence[Row], column: str) -> str:
        return f"{100 * max(abs(row[column]) for row in rows):.3f} %"

    def line_of(rows: Sequence[Row], quantity: str) -> list[str]:
        source, kappa_text = rows[0]["source"], f"{rows[0]['kappa_ratio']:g}"
        over_1d_text = worst(rows, "over_1d") if source == THREE_D else "–"
        return [quantity, source, _range(rows), kappa_text, worst(rows, "over_theory"), over_1d_text]

    cell_rows = []
    for quantity, source, is_folded in (("radius", ONE_D, 0), ("radius", THREE_D, 0), ("radius, folded", THREE_D, 1)):
        source_rows = [row for row in radius_rows if row["source"] == source and row["folded"] == is_folded]
        cell_rows += [line_of(source_rows, quantity)] if source_rows else []
    for T in sorted({row["thickness_mm"] for row in stress_rows}):
        thickness_rows = [row for row in stress_rows if row["source"] == ONE_D and row["thickness_mm"] == T]
        cell_rows.append(line_of(thickness_rows, f"stress, T = {T:g} mm"))
    heads = ["quantity", "by", "g", "κ/μ", "largest difference from theory", "from 1-D at this κ/μ"]
    return [
        Image("fig3", "outer radius against growth, tangential stress through the cortex"),
        Table(heads, cell_rows, "fig3"),
    ]


def _range(rows: Sequence[Row]) -> str:
    lowest_growth, highest_growth = (extreme([row["growth"] for row in rows]) for extreme in (min, max))
    return f"{lowest_growth:g}" if lowest_growth == highest_growth else f"{lowest_growth:g} to {highest_growth:g}"


def _fig5(tables: Tables) -> list[Image | Table]:
    rows = [row for row in tables["fig5.tsv"] if any(row["growth"] in growths for growths in FIG5)]
    return [
        Image("fig5", "six stages of a folding sphere, coloured by displacement"),
        Table(list(FOLD_COLUMNS), cells(rows, dict(FOLD_COLUMNS.values())), "fig5"),
        _seeds(tables, "fig5", FIG6[1:2]),
    ]


def _fig6(tables: Tables) -> list[Image | Table]:
    rows = tables["fig6.tsv"]
    return [
        Image("fig6", "thin, normal and thick cortex at three growths, coloured by displacement"),
        _columns("fig6", rows, FIG6),
        _seeds(tables, "fig6", FIG6),
        _first("fig6", rows, FIG6),
        _slopes(rows, FIG6),
    ]


def _fig7(tables: Tables) -> list[Image | Table]:
    rows = tables["fig7.tsv"]
    return [
        Image("fig7", "shear moduli 1, 2 and 4 to 1 at three growths, coloured by displacement"),
        _columns("fig7", rows, FIG7),
        _seeds(tables, "fig7", FIG7),
        _first("fig7", rows, FIG7),
    ]


def _seeds(tables: Tables, figure: str, columns: Sequence[Column]) -> Table:
    """Least and largest numbers of three seeds in the first and last pictures: the figure's own, and two octants."""
    rows, cell_rows = [*tables[f"{figure}.tsv"], *tables[f"{figure}-seeds.tsv"]], []
    for column, g in ((column, column.growths[picture]) for column in columns for picture in (0, -1)):
        body_rows = [row for row in rows if (row["scene"], row["growth"]) == (column.scene, g)]
        ranges = [_least_and_largest(body_rows, *FOLD_COLUMNS[head]) for head in SEED_HEADS]
        cell_rows.append([column.title, f"{g:.2f}", *ranges])
    return Table(["three seeds", "g", *SEED_HEADS], cell_rows, f"{figure}-seeds")


def _least_and_largest(rows: Sequence[Row], column: str, number_format: str) -> str:
    values = [row[column] for row in rows if row[column] is not None]
    return " to ".join(number_format.format(extreme(values)) for extreme in (min, max)) if values else "–"


def _fig8(tables: Tables) -> list[Image | Table]:
    slope_columns = "robust_slope robust_low robust_high slope slope_low slope_high slope_without_few".split()
    ratio_columns = ("r", "gyral_over_cortical", "gyral_over_cortical_at_crests")
    format_by_column = {"surface": "", "points": "", "n": "{:.0f}", **dict.fromkeys(slope_columns, "{:.2f}")}
    format_by_column |= {"intercept_mm": "{:.1f}", **dict.fromkeys(ratio_columns, "{:.2f}")}
    heads = (
        "surface | points | n | robust slope | from | to | least squares | from | to | without few | "
        "at 0, mm | r | W / t | at crests"
    ).split(" | ")
    return [
        Image("fig8a", "the average brain, precentral and postcentral gyrus marked"),
        Image("fig8b", "gyral against cortical thickness of brains and models"),
        Table(heads, cells(tables["fig8.tsv"], format_by_column), "fig8"),
    ]


def _fig9(tables: Tables) -> list[Image | Table]:
    surface_rows = tables["fig9-surfaces.tsv"]
    median_columns = [column for column in surface_rows[0] if column.startswith("median ")]
    density_formats = {
        "surface": "",
        "hinges": "{:.0f}",
        "three_armed": "{:.0f}",
        "width_mm": "{:.2f}",
        "per_width_squared": "{:.3f}",
        "per_cm_squared": "{:.3f}",
        **dict.fromkeys(median_columns, "{:.3g}"),
    }
    number_formats = {"number": "", **dict.fromkeys(("median", "other_median", "ks", "energy", "p"), "{:.3g}")}
    nearest_formats = {"source": "", "n": "{:.0f}", "to_other": "{:.3f}", "from_other": "{:.3f}"}
    return [
        Image("fig9a", "three-hinge patterns of models, above those of a person"),
        Image("fig9b", "distributions of the numbers of hinge shapes"),
        Table(
            ["surface", "hinges", "with three arms", "crown width, mm", "per width²", "per cm²", *median_columns],
            cells(surface_rows, density_formats),
            "fig9-surfaces",
        ),
        Table(
            ["number", "models", "MRI", "Kolmogorov-Smirnov", "energy distance", "p"],
            cells(tables["fig9-numbers.tsv"], number_formats),
            "fig9-numbers",
        ),
        Table(
            ["hinges of", "on either side", "distance to the nearest on MRI, median", "from MRI to the nearest"],
            cells(tables["fig9-nearest.tsv"], nearest_formats),
            "fig9-nearest",
        ),
    ]


def _columns(figure: str, rows: Sequence[Row], columns: Sequence[Column]) -> Table:
    """The numbers of the folds in the pictures."""
    picture_rows = [
        {"title": column.title, **row}
        for column in columns
        for row in rows
        if row["scene"] == column.scene and row["growth"] in column.growths
    ]
    cell_rows = cells(picture_rows, {"title": "", **dict(FOLD_COLUMNS.values())})
    return Table(["body", *FOLD_COLUMNS], cell_rows, figure)


def _first(figure: str, rows: Sequence[Row], columns: Sequence[Column]) -> Table:
    """The first pictures, soon after the onset of folding, compared with the first wrinkles of theory."""
    heads = (
        "body | first picture, g | wrinkles by theory, g | walls touch, g | degree | by theory | wavelength / T | "
        "by theory | by the film formula"
    ).split(" | ")
    table_rows = []
    for column in columns:
        row = _at(rows, column, 0)
        T = row["thickness_mm"]
        values = [row[key] for key in ("growth", "theory_g", "first_contact_g", "degree", "theory_degree")]
        values += [row[key] and row[key] / T for key in (f"{stem}wavelength_mm" for stem in ("", "theory_", "film_"))]
        formats = ("{:.2f}", "{:.3f}", "{:.2f}", "{:.1f}", "{:.0f}", "{:.2f}", "{:.2f}", "{:.2f}")
        table_rows.append([column.title, *(number(value, spec) for spec, value in zip(formats, values))])
    return Table(heads, table_rows, f"{figure}-waves")


def _at(rows: Sequence[Row], column: Column, picture_index: int) -> Row:
    """The row of the k-th picture of a column."""
    return next(row for row in rows if row["scene"] == column.scene and row["growth"] == column.growths[picture_index])


def _slopes(rows: Sequence[Row], columns: Sequence[Column]) -> Table:
    """Least-squares lines on the cortical thickness T over the bodies, with the 95 % interval of the slope."""

    def fit(label: str, number_name: str, picture_index: int) -> list[str]:
        body_rows = [_at(rows, column, picture_index) for column in columns]
        if any(row[number_name] is None for row in body_rows):
            return [label, *"–––––"]
        fit_line = line([row["thickness_mm"] for row in body_rows], [row[number_name] for row in body_rows])
        t_95 = stats.t.ppf(0.975, len(body_rows) - 2)  # 12.7 for three bodies
        half = t_95 * (fit_line.standard_error or 0.0)
        values = fit_line.slope, fit_line.slope - half, fit_line.slope + half, fit_line.intercept, fit_line.r
        return [label, *(number(value, spec) for value, spec in zip(values, [*4 * ["{:.2f}"], "{:.4f}"]))]

    slope_rows = [
        fit("wavelength, first picture", "wavelength_mm", 0),
        fit("wavelength, last picture", "wavelength_mm", -1),
        fit("wavelength of the first wrinkles, theory", "theory_wavelength_mm", 0),
        fit("wavelength by the film formula", "film_wavelength_mm", 0),
        fit("gyral thickness, last picture", "gyral_thickness_mm", -1),
        fit("rms height, last picture", "height_rms_mm", -1),
    ]
    heads = ["on cortical thickness T", "slope, mm/mm", "95 % from", "to", "at T = 0, mm", "r"]
    return Table(heads, slope_rows, "fig6-slopes")


def _fig4(tables: Tables) -> list[Image | Table]:
    return [Image("fig4", "growth at which the surface can crease, over the radii, both laws")]


def _fig8_grown(tables: Tables) -> list[Image | Table]:
    column_formats = {
        "hemisphere": ("hemisphere", ""),
        "kind": ("kind", ""),
        "parcels or pairs": ("n", "{:.0f}"),
        "slope": ("slope", "{:.2f}"),
        "standard error": ("standard_error", "{:.2f}"),
        "95 % from": ("low", "{:.2f}"),
        "to": ("high", "{:.2f}"),
        "r": ("r", "{:.2f}"),
        "p by rotations": ("spin_p", "{:.4f}"),
    }
    rows = [
        {**row, "hemisphere": f"{row['subject']} {row['hemi']}"}
        for row in tables["fig8-grown.tsv"]
        if row["kind"] == "mean of seeds" or row["subject"] == "all"
    ]
    return [
        Image(
            "fig8-grown", "change of gyral thickness against change of thickness, and slopes of all pairs and controls"
        ),
        Table(list(column_formats), cells(rows, dict(column_formats.values()))),
    ]


#: figure -> its pictures and tables, from its tables by file name
PART_MAKERS: dict[str, Callable[[Tables], list[Image | Table]]] = {
    "fig3": _fig3,
    "fig4": _fig4,
    "fig5": _fig5,
    "fig6": _fig6,
    "fig7": _fig7,
    "fig8": _fig8,
    "fig9": _fig9,
    "fig8-grown": _fig8_grown,
}
