"""Pictures and the generated part of docs/measures: every measure on several surfaces, and how the number of hinges
depends on the lengths of the method. The cut through folds shows the first surface.

``python -m morphofold.studies.pages.measuring_pictures FOLDER NAME=CORTEX...`` draws them into the folder of pages and
writes a table between the marks ``sensitivity`` of its gyral-net.md, with all its rows in a TSV beside. A CORTEX is
anything that ``morphofold.read_cortex`` reads, or S1, the sample.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cyclopts
import numpy as np

from morphofold.analysis import Measures, crest_lines, gyral_thickness, hinge_sensitivity
from morphofold.analysis.gyrification.across_scales import box_counts
from morphofold.analysis.relief import relief
from morphofold.geometry import mean_edge_length
from morphofold.io import atomic_file, sample_path
from morphofold.io.files import write_text
from morphofold.quantities import Quantity, quantity
from morphofold.report.pictures.gyral_net import net_figure, net_row, paint_lines, shaded
from morphofold.report.pictures.pixel_canvas import Picture, halved, png_bytes
from morphofold.report.pictures.surfaces import Row, figure
from morphofold.report.plots.figure_style import legend_of_figure, line_style, new_figure, save
from morphofold.studies.markdown import cells, number, renewed, table_with_tsv
from morphofold.studies.pages.section_plot import section_figure
from morphofold.surface import Surface

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: drawn maps, with their colour limits if the limits of a page would not show the folds of both
DRAWN_MAPS: dict[str, tuple[float, float] | None] = {
    "H": None,
    "shape_index": None,
    "sulcal_depth": None,
    "local_gyrification_index": None,
    "cortical_thickness": (1, 8),
    "gyral_thickness": (4, 24),
}
LEAST_CREST_SCALE_EDGES = 4.0  # least scale of crest lines, in mean edges, because surfaces are noisy
LINE_COLOURS = {"gyral": "#d55e00", "sulcal": "#0072b2"}
PHASE_QUANTITY = Quantity(
    "phase", "Position in the fold of the pial surface: 1 on the crown, 0 at mid-height, −1 at the fundus", signed=True
)


def write_pages(folder: Path, measures_of: dict[str, Measures]) -> None:
    """Update pictures, plots and the marked part of gyral-net.md in ``folder``.

    Raises
    ------
    FileNotFoundError
        If the page is missing.
    MissingPart
        If the page lacks one pair of marks. Then nothing is changed.
    """
    hinge_rows_of = {name: hinge_sensitivity(measures.cortex) for name, measures in measures_of.items()}
    page = folder / "gyral-net.md"
    page_text = page.read_text(encoding="utf-8")
    renewed(page, page_text, {"sensitivity": []})  # raises before anything is written
    page_text = renewed(page, page_text, {"sensitivity": [_sensitivity(page, hinge_rows_of)]})
    for name, picture in pictures(measures_of).items():
        with atomic_file(folder / f"{name}.png") as temp_path:
            temp_path.write_bytes(png_bytes(halved(picture)))
    plots = {
        "sensitivity": sensitivity_figure(hinge_rows_of),
        "fractal-dimension": fractal_figure({name: measures.cortex.pial for name, measures in measures_of.items()}),
    }
    first_measures = next(iter(measures_of.values()))
    plots["section"] = section_figure(first_measures.cortex, gyral_thickness(first_measures.cortex))
    for name, plot in plots.items():
        with atomic_file(folder / f"{name}.png") as temp_path:
            save(plot, temp_path)
    write_text(page, page_text)


def pictures(measures_of: dict[str, Measures]) -> dict[str, Picture]:
    """Pictures of all measures, with a row per surface."""
    images = {
        "crest-lines": crest_figure([crest_row(m, name) for name, m in measures_of.items()]),
        "gyral-net": net_figure([net_row(m, name) for name, m in measures_of.items()]),
    }
    for key, colour_limits in DRAWN_MAPS.items():
        map_quantity = quantity(key)
        rows = [
            Row(name, m.cortex.pial, np.asarray(m.maps.get(key, np.full(m.cortex.n_vertices, np.nan))), m.cortex.hemi)
            for name, m in measures_of.items()
        ]
        images[key.replace("_", "-")] = figure(rows, map_quantity, colour_limits or map_quantity.limits or (0, 1))
    images["wavelength"] = figure([_phase_row(m, name) for name, m in measures_of.items()], PHASE_QUANTITY, (-1, 1))
    return images


def crest_row(measures: Measures, name: str) -> Row:
    """The pial surface of measures with its crest lines, at the curvature scale, sulci darker."""
    pial = measures.cortex.pial
    edge = mean_edge_length(pial.verts, pial.faces)
    scale = max(LEAST_CREST_SCALE_EDGES * edge, measures.parameters["curvature_scale_mm"])
    crests = crest_lines(pial.verts, pial.faces, scale=scale)
    vertex_rgb = shaded(measures)
    for kind, colour in LINE_COLOURS.items():
        paint_lines(vertex_rgb, pial.verts, [line.points for line in crests.of_kind(kind)], edge, colour)
    return Row(name, pial, hemi=measures.cortex.hemi, rgb=vertex_rgb)


def crest_figure(rows: Sequence[Row]) -> Picture:
    """Picture of rows of crest lines, in all views."""
    return figure(rows, Quantity("crests", "Crest lines"), None, legend=[*LINE_COLOURS.items()])


def _phase_row(m: Measures, name: str) -> Row:
    """The phase of the folds, drawn on white because its sulci are open; the name gives the wavelengths."""
    pial, scale = m.cortex.pial, m.parameters["gyral_scale_mm"]
    phase = np.full(m.cortex.n_vertices, np.nan) if scale is None else relief(pial.verts, pial.faces, scale).phase
    wave_texts = [number(m.scalars[key], "{:.1f} mm") for key in ("wavelength_mm", "spectral_wavelength_mm")]
    row_label = f"{name}: {wave_texts[0]} from fundus to fundus, {wave_texts[1]} in the spectrum of the depth potential"
    phase_values = np.where(np.isfinite(m.maps["gyral_thickness"]), 1 - 2 * phase, np.nan)
    return Row(row_label, m.cortex.white, phase_values, m.cortex.hemi)


def sensitivity_figure(hinge_rows_of: dict[str, list[dict[str, Any]]]) -> Figure:
    """Number of hinges against the factor of each length, one panel per surface."""
    with new_figure(4.2 * len(hinge_rows_of) + 0.4, 4.4, 1, len(hinge_rows_of), sharey=True) as (plot, panels):
        legend: dict[str, Any] = {}
        for ax, (name, rows) in zip(panels[0], hinge_rows_of.items()):
            for k, length in enumerate(dict.fromkeys(row["length"] for row in rows[1:])):
                legend[length] = {**line_style(k), "marker": "o", "markersize": 3.5}
                points = sorted(
                    [rows[0], *(row for row in rows if row["length"] == length)], key=lambda row: row["factor"]
                )
                ax.plot([row["factor"] for row in points], [row["n_hinges"] for row in points], **legend[length])
            factors = sorted({row["factor"] for row in rows})
            ax.set(xlim=(0.9 * factors[0], 1.1 * factors[-1]), ylim=ax.get_ylim(), title=name)
            ax.set(xscale="log", xlabel="length over the length in use")
            ax.set_xticks(factors, [f"{factor:g}" for factor in factors])
            ax.minorticks_off()
        panels[0][0].set(ylabel="hinges", ylim=(0, panels[0][0].get_ylim()[1]))
        legend_of_figure(plot, legend, panels[0][0], columns=3)
    return plot


def fractal_figure(surfaces: dict[str, Surface]) -> Figure:
    """Number of boxes that meet each surface against their size, and the lines whose slope gives the dimension."""
    with new_figure(6.4, 4.8, 1, 1) as (plot, ((ax,),)):
        legend: dict[str, Any] = {}
        for k, (name, surface) in enumerate(surfaces.items()):
            box_sizes, n_boxes = box_counts(surface.verts, surface.faces)
            slope, intercept = np.polyfit(np.log(box_sizes), np.log(n_boxes), 1)
            ax.plot(box_sizes, n_boxes, "o", color=line_style(k)["color"], markersize=4.5)
            legend[f"{name}: {-slope:.2f}"] = line_style(k)
            ax.plot(box_sizes, np.exp(intercept) * box_sizes**slope, **line_style(k))
        ax.set(xscale="log", yscale="log", xlabel="size of the boxes [mm]", ylabel="boxes that meet the surface")
        low, high = ax.get_xlim()
        ticks = [m * 10.0**power for power in range(-3, 6) for m in (1, 2, 5) if low <= m * 10.0**power <= high]
        ax.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
        ax.minorticks_off()
        legend_of_figure(plot, legend, ax, columns=2)
    return plot


def _sensitivity(page: Path, rows_of: dict[str, list[dict[str, Any]]]) -> str:
    """The table of all lengths, beside the page; the page has the length that matters most."""
    column_heads = "surface | length | times | mm | hinges | three arms | four arms | crests, mm | kept"
    format_of = {"surface": "", "length": "", "factor": "{:g}", "mm": "{:.2f}"}
    format_of |= dict.fromkeys(("n_hinges", "n_hinges_3", "n_hinges_4"), "{}")
    format_of |= {"crest_length_mm": "{:.0f}", "kept": "{:.2f}"}
    table_rows = [
        {
            **row,
            "surface": surface_name,
            "length": row["length"] or "as they are",
            **{key: row[key] if np.isfinite(row[key]) else None for key in ("mm", "kept")},
        }
        for surface_name, rows in rows_of.items()
        for row in rows
    ]
    is_shown = lambda row: row[1] == "as they are" or (row[1] == "persistence" and row[2] in ("0.5", "2"))
    return table_with_tsv(page, "sensitivity", column_heads, cells(table_rows, format_of), is_shown)


def main(folder: Path, *cortices: str) -> None:
    """Measure cortices, each given as NAME=CORTEX, and write the pages in the folder."""
    import morphofold as mf

    measures_of = {}
    for argument in cortices:
        name, path = argument.rsplit("=", 1)
        measures_of[name] = mf.measure(mf.read_cortex(sample_path("S1") if path == "S1" else path, hemi="lh"))
    write_pages(folder, measures_of)


if __name__ == "__main__":
    cyclopts.run(main)
