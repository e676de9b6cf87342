"""Figs. 8 and 9 of Razavi et al. (2015): gyral thickness and three-hinge patterns of model and MRI, side by side.

The models are the bodies of Fig. 6 at g = 2. MRI means the average brain and the person that come with the package.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from morphofold.analysis import Measures, hinge_shapes
from morphofold.analysis.graph.hinge_statistics import HingeShapes
from morphofold.comparison import ThicknessPoint, fit_line
from morphofold.comparison.hinge_comparison import RANDOM_NET_NAME, HingeComparison, compare_hinges, net_at_chance
from morphofold.comparison.thickness_plot_data import thickness_ratios
from morphofold.errors import MissingPart
from morphofold.io import read_cortex, sample_path
from morphofold.quantities import Quantity
from morphofold.report.colours import rgb_of
from morphofold.report.pictures.gyral_net import clear_examples, hinge_pairs, shaded
from morphofold.report.pictures.pixel_canvas import Picture, png_bytes
from morphofold.report.pictures.surfaces import Row, figure
from morphofold.report.plots.figure_style import GREY, legend_of_figure, line_style, new_figure, save
from morphofold.studies.paper.paper_folds import grow_scene
from morphofold.studies.paper.thickness_plots import (
    GYRUS_LABELS,
    GYRUS_RGB,
    both_thicknesses,
    crest_points,
    region_points,
    thickness_figure,
)
from morphofold.studies.runs import Runs, run_record
from morphofold.tables import write_table

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

GROWTH = 2.0
PARAMETERS = {"growth": GROWTH, "thickness_mm": [1, 2, 3], "outer_radius_mm": 50, "mu_ratio": 2}
MODEL_SCENES = {"T = 1 mm": "fig6-thin", "T = 2 mm": "fig5", "T = 3 mm": "fig6-thick"}
SAMPLE_HEMIS = {"fsaverage5": ("lh", "rh"), "S1": ("lh",)}
FIT_COLUMNS = tuple(
    ("points n robust_slope robust_low robust_high slope slope_low slope_high slope_without_few intercept_mm r").split()
)
COLUMN_TEXTS = {
    "n": "regions, crests or bodies",
    "robust_slope": "gyral on cortical thickness [mm/mm], median over pairs of points, with 95 % bounds from a "
    "bootstrap over the points (at least five); both pairs of bounds treat points as independent",
    "slope": "least squares; slope_low and slope_high are its 95 % bounds, slope_without_few is without the twentieth "
    "of the points that change it most",
    "gyral_over_cortical": "median gyral over mean cortical thickness of the surface",
    "gyral_over_cortical_at_crests": "median over its crests of gyral over cortical thickness",
}


def reproduce_fig8(folder: Path, runs: Runs) -> dict[str, Any]:
    """Write fig8a.png, fig8b.png and fig8.tsv into ``folder``; returns their entry for an index."""
    models, simulations = _models(runs)
    brains = _brains(runs, "fsaverage5")
    people = _brains(runs, "S1")
    (folder / "fig8a.png").write_bytes(png_bytes(annotation(brains["fsaverage5 lh"])))
    rows = fit_rows(models, brains, people)
    write_table(folder / "fig8.tsv", list(rows[0]), rows)
    save(thickness_figure(models, brains, people, [run.scene for run in simulations]), folder / "fig8b.png")
    return {
        "shows": "gyri of the average brain, and gyral against cortical thickness: regions of brains, bodies of Fig. 6",
        "files": ["fig8a.png", "fig8b.png", "fig8.tsv"],
        "columns": COLUMN_TEXTS,
        "parameters": PARAMETERS,
        "simulations": [run_record(simulation) for simulation in simulations],
    }


def reproduce_fig9(folder: Path, runs: Runs) -> dict[str, Any]:
    """Write fig9a.png, fig9b.png and fig9.tsv into ``folder``; returns their entry for an index."""
    models, simulations = _models(runs)
    people = _brains(runs, "S1")
    all_measures = {**models, **people}
    shapes = {name: shape for name, measures in all_measures.items() if (shape := hinge_shapes(measures)) is not None}
    (comparison,) = compare_hinges(shapes, {"model": list(models), "MRI": list(people)})
    pair_picture = hinge_pairs(clear_examples(comparison.matches, all_measures), (comparison.one, comparison.other))
    (folder / "fig9a.png").write_bytes(png_bytes(pair_picture))
    save(shape_figure(shapes, list(models), list(people)), folder / "fig9b.png")
    rows_by_file = hinge_tables(comparison, all_measures, shapes)
    rows_by_file["fig9.tsv"] = [asdict(match) for match in comparison.matches]
    for name, rows in rows_by_file.items():
        write_table(folder / name, list(rows[0]), rows)
    return {
        "shows": "three-hinge patterns of the models of Fig. 6, and those of a person with the most similar shape",
        "files": ["fig9a.png", "fig9b.png", *rows_by_file],
        "columns": {
            "distance": "root mean square difference of angles [rad], logarithms of lengths, curvatures and "
            "sharpness in crown widths; pose 3 or more: mirrored",
            "to_other": "median distance from hinges of the source to the nearest on MRI, from_other that from MRI to "
            "the nearest of the source; by angles and lengths, n hinges on either side",
            "p": "of the energy distance, with hinges as units",
        },
        "parameters": PARAMETERS,
        "simulations": [run_record(simulation) for simulation in simulations],
    }


def _models(runs: Runs) -> tuple[dict[str, Measures], list[Any]]:
    simulations = [grow_scene(scene, runs) for scene in MODEL_SCENES.values()]
    return {name: runs.measure(name, run.cortex(GROWTH)) for name, run in zip(MODEL_SCENES, simulations)}, simulations


def _brains(runs: Runs, sample: str) -> dict[str, Measures]:
    """Measures of the hemispheres that a sample has."""
    cortices = {f"{sample} {hemi}": read_cortex(sample_path(sample), hemi=hemi) for hemi in SAMPLE_HEMIS[sample]}
    return {brain_name: runs.measure(brain_name, cortex) for brain_name, cortex in cortices.items()}


def annotation(measures: Measures) -> Picture:
    """The pial surface from all sides, with precentral and postcentral gyrus in colour."""
    cortex = measures.cortex
    if cortex.regions is None:
        raise MissingPart(f"{cortex.name}: has no regions, so no gyrus can be marked. Use a cortex with an annotation.")
    rgb = shaded(measures)
    for gyrus, colour in GYRUS_RGB.items():
        is_in_region = cortex.regions.labels == cortex.regions.names.index(gyrus)
        rgb[is_in_region] = np.round(0.35 * rgb[is_in_region] + 0.65 * np.array(rgb_of(colour))).astype(np.uint8)
    surface_row = Row(f"{cortex.name}, {cortex.hemi}", cortex.pial, hemi=cortex.hemi, rgb=rgb)
    legend_entries = [(f"{GYRUS_LABELS[gyrus]}, {gyrus} gyrus", colour) for gyrus, colour in GYRUS_RGB.items()]
    return figure([surface_row], Quantity("regions", "Gyri of the average brain"), None, legend=legend_entries)


# gyral against cortical thickness ---------------------------------------------------------------------------


def fit_rows(
    models: Mapping[str, Measures], brains: Mapping[str, Measures], people: Mapping[str, Measures]
) -> list[dict[str, Any]]:
    """Fits of lines to the regions of brains, to the crests of a person and of each body, and to the bodies."""
    rows = []
    for name, measures in brains.items():
        for column, thickness_source in (("cortical_thickness_mm", "its surfaces"), ("thickness_file_mm", "its file")):
            thickness_pairs = np.array(list(region_points(measures, column).values())).reshape(-1, 2)
            rows.append(_fit(name, f"regions, thickness of {thickness_source}", thickness_pairs, measures))
    for name, measures in {**people, **models}.items():
        rows.append(_fit(name, "crests", crest_points(measures), measures))
    rows.append(_fit("models", "bodies", np.array([both_thicknesses(measures) for measures in models.values()]), None))
    return rows


def _fit(surface_name: str, label: str, thickness_pairs: np.ndarray, measures: Measures | None) -> dict[str, Any]:
    x, y = thickness_pairs.T
    row: dict[str, Any] = {"surface": surface_name, **dict.fromkeys(FIT_COLUMNS), "points": label, "n": len(x)}
    ratio, crest_ratio = (float(y.mean() / x.mean()), None) if measures is None else thickness_ratios(measures).values()
    row |= {"gyral_over_cortical": ratio, "gyral_over_cortical_at_crests": crest_ratio}
    fit = fit_line([ThicknessPoint(float(cortical), float(gyral), "") for cortical, gyral in thickness_pairs])
    if fit is None or np.ptp(y) == 0:
        return row
    keys = "robust_low robust_high slope slope_low slope_high slope_without_few r".split()
    return row | {"robust_slope": fit.robust, "intercept_mm": fit.intercept} | {key: getattr(fit, key) for key in keys}


# three-hinge patterns ---------------------------------------------------------------------------------------


def hinge_tables(
    comparison: HingeComparison, measures: Mapping[str, Measures], shapes: Mapping[str, HingeShapes]
) -> dict[str, list[dict[str, Any]]]:
    """Tables by file name: density of hinges, their numbers in both groups, and distances to the nearest hinges.

    The first row of the numbers is the whole shape, with the energy distance in place of the Kolmogorov-Smirnov one.
    """
    density_rows = [
        {
            "surface": surface_name,
            "hinges": measures[surface_name].scalars["n_hinges"],
            "three_armed": len(shape),
            "width_mm": shape.width,
            "per_width_squared": shape.per_area,
            "per_cm_squared": 100 * shape.per_area / shape.width**2,
            **{f"median {number_name}": float(np.median(values)) for number_name, values in shape.numbers().items()},
        }
        for surface_name, shape in shapes.items()
    ]
    shape_test = comparison.shape
    whole_shape: dict[str, Any] = {"number": "shape", "median": None, "other_median": None, "ks": None}
    whole_shape |= {"energy": shape_test.statistic, "p": shape_test.p}
    return {
        "fig9-surfaces.tsv": density_rows,
        "fig9-numbers.tsv": [whole_shape, *({**asdict(row), "energy": None, "p": None} for row in comparison.numbers)],
        "fig9-nearest.tsv": [
            {**asdict(control), "verdict": None if control_index else comparison.verdict}
            for control_index, control in enumerate(comparison.controls)
        ],
    }


def shape_figure(shapes: Mapping[str, HingeShapes], models: Sequence[str], people: Sequence[str]) -> Figure:
    """Cumulative distributions of the numbers of hinge shapes, for each surface and for a random net."""
    net = net_at_chance([shapes[name] for name in people])
    assert net is not None  # the hinges of a person are not so dense
    random_numbers = HingeShapes(np.arange(len(net)), net, np.full(len(net), "Y"), 1.0, 1.0).numbers()
    number_names = list(random_numbers)
    with new_figure(13.2, 4.2, 1, len(number_names), sharey=True) as (plot, panels):
        style_by_name: dict[str, Any] = {}
        for style_index, name in enumerate([*models, *people]):
            style_by_name[name] = {**line_style(style_index), "linewidth": 2.6 if name in people else 1.5}
            for ax, number_name in zip(panels[0], number_names):
                _cumulative(ax, shapes[name].numbers()[number_name], style_by_name[name])
        style_by_name[RANDOM_NET_NAME] = {"color": GREY, "linewidth": 1.2}
        for ax, number_name in zip(panels[0], number_names):
            _cumulative(ax, random_numbers[number_name], style_by_name[RANDOM_NET_NAME])
            ax.set(xlabel=number_name)
        panels[0][0].set(ylabel="share of hinges below", ylim=(0, 1))
        legend_of_figure(plot, style_by_name, panels[0][0], columns=6)
    return plot


def _cumulative(ax: Axes, values: np.ndarray, style: Mapping[str, Any]) -> None:
    if np.isfinite(values).all() and len(values):
        ax.plot(np.sort(values), (np.arange(len(values)) + 0.5) / len(values), **style)
