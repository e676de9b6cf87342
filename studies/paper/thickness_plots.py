"""The plots of Fig. 8b: gyral against cortical thickness of brains, of models, of both, and without units."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from morphofold.analysis import Measures
from morphofold.analysis.thickness.robust_slope import robust_line
from morphofold.report.plots.figure_style import BLACK, GREY, legend_of_figure, line_style, new_figure
from morphofold.sim.scene import Scene
from morphofold.sim.theory import deformed_radius
from morphofold.studies.folds.fold_measures import expected, film_wavelength, sphere

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Style = dict[str, Any]
PRE, POST = "#d55e00", "#0072b2"
GYRUS_RGB = {"precentral": PRE, "postcentral": POST}
GYRUS_LABELS = {"precentral": "PreCG", "postcentral": "PostCG"}


def region_points(measures: Measures, column: str = "cortical_thickness_mm") -> dict[str, tuple[float, float]]:
    """Cortical and gyral thickness [mm] of each region that has both."""
    return {
        row["region"]: (float(row[column]), float(row["gyral_thickness_mm"]))
        for row in measures.regions
        if row.get(column) is not None and row.get("gyral_thickness_mm") is not None
    }


def best_points(measures: Measures) -> dict[str, tuple[float, float]]:
    """Points of regions with the thickness from the file of the subject if it exists, else from its surfaces."""
    return region_points(measures, "thickness_file_mm") or region_points(measures)


def crest_points(measures: Measures) -> np.ndarray:
    """Cortical and gyral thickness (P, 2) [mm] of the crests that have both."""
    thickness_pairs = [(row["cortical_thickness_mm"], row["gyral_thickness_mm"]) for row in measures.crests]
    return np.array([pair for pair in thickness_pairs if None not in pair], dtype=np.float64).reshape(-1, 2)


def both_thicknesses(measures: Measures) -> tuple[float, float]:
    """Mean cortical and median gyral thickness of a surface [mm]."""
    scalars = measures.scalars
    return float(scalars["mean_cortical_thickness_mm"] or np.nan), float(scalars["median_gyral_thickness_mm"] or np.nan)


def onset_line(scenes: Sequence[Scene]) -> np.ndarray:
    """Thickness of the cortex and wavelength of the first wrinkles (S, 2) [mm] of bilayer spheres, when they form.

    From linear stability of the whole sphere (:func:`morphofold.sim.theory.bifurcation`), converted from the reference
    to the deformed state by Eq. (11): the core keeps its volume, so the cortex is c - B thick and its waves are
    stretched by c / C.
    """
    line_points = []
    for scene in scenes:
        theory, C, T = expected(scene), sphere(scene).radius, sphere(scene).cortex_thickness
        grown_radius = (C - T) * float(deformed_radius(theory["theory_g"], C / (C - T), scene.growth.law))
        line_points.append((grown_radius - (C - T), theory["theory_wavelength_mm"] * grown_radius / C))
    return np.array(line_points)


def thickness_figure(
    models: Mapping[str, Measures],
    brains: Mapping[str, Measures],
    people: Mapping[str, Measures],
    scenes: Sequence[Scene],
) -> Figure:
    """Four panels: regions of brains, bodies, both, and the ratio of the two thicknesses within each surface."""
    medians = np.array([both_thicknesses(measures) for measures in models.values()])
    styles = {name: {"color": line_style(k)["color"], "marker": "D", "linestyle": ""} for k, name in enumerate(models)}
    for k, name in enumerate({**brains, **people}):
        styles[name] = {"color": line_style(k + 3)["color"], "marker": "os^v"[k % 4], "linestyle": ""}
    with new_figure(12.0, 10.2, 2, 2) as (plot, ((region_axes, body_axes), (both_axes, ratio_axes))):
        _regions(region_axes, brains, styles)
        _bodies(body_axes, models, styles, medians)
        theory_entries = [
            entry for ax in (body_axes, both_axes) for entry in _theory(ax, scenes, 1.12 * medians[:, 0].max()).items()
        ]
        _both(both_axes, {**models, **brains, **people}, styles)
        _without_units(ratio_axes, {**models, **brains, **people}, styles)
        for ax in (region_axes, body_axes, both_axes):
            ax.set(xlabel="cortical thickness [mm]", ylabel="gyral thickness [mm]", ylim=(0, None))
        body_axes.set_xlim(0, None)
        both_axes.set_xlim(0, None)
        model_entries = {f"model, {n}" if n in models else n: {**style, "markersize": 8} for n, style in styles.items()}
        line_entry = {"line through points of its colour": {"color": BLACK, "linewidth": 1.5}}
        legend_of_figure(plot, {**model_entries, **line_entry, **dict(theory_entries)}, region_axes, columns=4)
    return plot


def _regions(ax: Axes, brains: Mapping[str, Measures], styles: Mapping[str, Style]) -> None:
    for brain_index, (name, measures) in enumerate(brains.items()):
        points = best_points(measures)
        cortical, gyral = np.array(list(points.values())).reshape(-1, 2).T
        ax.plot(cortical, gyral, **styles[name], markersize=5)
        _straight(ax, cortical, gyral, color=styles[name]["color"])
        for region in GYRUS_RGB:
            if region in points:
                ax.plot(*points[region], marker=styles[name]["marker"], color=GYRUS_RGB[region], markersize=9, zorder=3)
                label, text_offset = f"{GYRUS_LABELS[region]} {measures.cortex.hemi}", (8, 2 - 12 * (brain_index % 2))
                ax.annotate(label, points[region], xytext=text_offset, textcoords="offset points", fontsize=9)
    ax.set_title("regions of brains", loc="left")


def _bodies(ax: Axes, models: Mapping[str, Measures], styles: Mapping[str, Style], all_medians: np.ndarray) -> None:
    for (name, measures), medians in zip(models.items(), all_medians):
        ax.plot(*crest_points(measures).T, ".", color=styles[name]["color"], alpha=0.25, markersize=4)
        ax.plot(*medians, **styles[name], markersize=8, zorder=3)
    _straight(ax, *all_medians.T, color=BLACK)
    ax.set_title("models, crests and medians", loc="left")


def _theory(ax: Axes, scenes: Sequence[Scene], max_thickness: float) -> dict[str, Style]:
    """Draw the wavelengths of theory up to a thickness [mm]; returns their legend entries."""
    film_thickness, onset_points = np.array([0.0, max_thickness]), onset_line(scenes)
    style_by_label: dict[str, Style] = {
        "film formula, wavelength": {"color": GREY, "linestyle": (0, (6, 2))},
        "first wrinkles, wavelength": {"color": GREY, "marker": "x", "linestyle": (0, (1.2, 1.4))},
    }
    curves = (film_thickness, film_wavelength(1.0, scenes[0].material.mu_ratio) * film_thickness), tuple(onset_points.T)
    for style, (x, y) in zip(style_by_label.values(), curves):
        ax.plot(x, y, **style)
    return style_by_label


def _both(ax: Axes, measures_by_name: Mapping[str, Measures], styles: Mapping[str, Style]) -> None:
    for name, measures in measures_by_name.items():
        ax.plot(*both_thicknesses(measures), **styles[name], markersize=8)
    right_limit, y_limit = ax.get_xlim()[1], ax.get_ylim()[1]
    for slope in (2.5, 4.0):
        x = np.array([0.0, min(right_limit, y_limit / slope)])
        ax.plot(x, slope * x, color="#cccccc", linewidth=1, zorder=0)
        ax.annotate(f"{slope:g} times", (x[1], slope * x[1]), color=GREY, ha="right", va="bottom", fontsize=9)
    ax.set_title("medians of both", loc="left")


def _without_units(ax: Axes, measures_by_name: Mapping[str, Measures], styles: Mapping[str, Style]) -> None:
    """Gyral over cortical thickness of crests, against cortical thickness over the mean of the surface."""
    x_limit, y_limit, n_outside = 1.9, 8.0, 0
    for name, measures in measures_by_name.items():
        cortical, gyral = crest_points(measures).T
        over_mean, ratio = cortical / both_thicknesses(measures)[0], gyral / cortical
        ax.plot(over_mean, ratio, **styles[name], alpha=0.3, markersize=3)
        ax.axhline(float(np.median(ratio)), color=styles[name]["color"], linewidth=1.2)
        n_outside += int(((over_mean > x_limit) | (ratio > y_limit)).sum())
    ax.set(xlabel="cortical thickness over its mean", ylabel="gyral over cortical thickness")
    ax.set(xlim=(0, x_limit), ylim=(0, y_limit))
    ax.set_title(f"without units, crests ({n_outside} outside), medians", loc="left")


def _straight(ax: Axes, x: np.ndarray, y: np.ndarray, **style: Any) -> None:
    if len(x) > 2 and np.ptp(x) > 0 and np.ptp(y) > 0:
        robust_fit = robust_line(x, y)
        x_ends = np.array([x.min(), x.max()])
        ax.plot(x_ends, np.median(y - robust_fit.robust * x) + robust_fit.robust * x_ends, linewidth=1.5, **style)
