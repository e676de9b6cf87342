"""The figure of the experiment of Fig. 8: changes of width against thickness, and slopes of all pairs and controls."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from morphofold.quantities import CATEGORICAL_COLOURS
from morphofold.report.plots.figure_style import BLACK, GREY, legend_of_figure, new_figure, save
from morphofold.studies.person.slope_intervals import interval
from morphofold.studies.person.thickness_pairs import N_SPINS, grow_pair, hemispheres, pair_rows, slope_rows
from morphofold.studies.runs import Runs, run_record
from morphofold.tables import write_table

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SAMPLE_SUBJECT = "fsaverage5"
NORMAL_95 = 1.96  # of a normal deviate, standard deviations that hold 95 %
SEEDS, DRAFT_SEEDS = (0, 1, 2, 3, 4), (0, 1)
FILE_NAMES = ("fig8-grown.png", "fig8-grown.tsv", "fig8-grown-parcels.tsv")
COLUMN_NOTES = {
    "kind": "pair: with the map against even, one seed; control: even, next seed against this one; mean of seeds: of "
    "the changes of all pairs of a hemisphere; all: mean over the pairs, or controls, of all hemispheres",
    "slope": "of the logarithm of gyral thickness on that of thickness before growth, least squares over parcels",
    "standard_error": "parcels taken as independent, which neighbours are not",
    "spin_p": f"share of {N_SPINS} rotations of the map with a slope at least as far from 0",
    "low": "of all pairs: 95 % bounds of the mean, by Student's t; of all controls: bounds about 0 that hold 95 % of "
    "single controls, by their root mean square; high is the other",
}


def reproduce_pairs(folder: Path, runs: Runs, subjects: Sequence[str] = (SAMPLE_SUBJECT,)) -> dict[str, Any]:
    """Write the figure and its tables into ``folder``; returns their entry for an index."""
    seeds = DRAFT_SEEDS if runs.draft else SEEDS
    sides = hemispheres(subjects)[: 1 if runs.draft else None]
    parcel_rows, slope_table = [], []
    for hemisphere in sides:
        side_rows = [row for seed in seeds for row in pair_rows(hemisphere, seed, runs)]
        parcel_rows += side_rows
        slope_table += slope_rows(hemisphere, seeds, side_rows, runs)
    slope_table += [_over_pairs(slope_table), _over_controls(slope_table)]
    write_table(folder / FILE_NAMES[1], ("subject", "hemi", "kind", "seed", "n", "slope"), slope_table)
    write_table(folder / FILE_NAMES[2], tuple(parcel_rows[0]), parcel_rows)
    save(pairs_figure(parcel_rows, slope_table), folder / FILE_NAMES[0])
    simulations = [run for hemisphere in sides for seed in seeds for run in grow_pair(hemisphere, seed, runs).values()]
    return {
        "shows": "gyral thickness against thickness by experiment: hemispheres with an even cortex, or their own map",
        "files": list(FILE_NAMES),
        "columns": COLUMN_NOTES,
        "parameters": {"subjects": [hemisphere.name for hemisphere in sides], "seeds": list(seeds)},
        "simulations": [run_record(run) for run in simulations],
    }


def _over_pairs(slope_table: Sequence[dict[str, Any]]) -> dict[str, Any]:
    slope_interval = interval([row["slope"] for row in slope_table if row["kind"] == "pair"])
    key_columns = {"subject": "all", "hemi": "both", "kind": "pair", "seed": None, "n": slope_interval.n}
    return {**key_columns, "slope": slope_interval.mean, "low": slope_interval.low, "high": slope_interval.high}


def _over_controls(slope_table: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Which of two seeds comes first is arbitrary, so the mean of controls says nothing; their spread does."""
    controls = np.array([row["slope"] for row in slope_table if row["kind"] == "control" and np.isfinite(row["slope"])])
    bound = NORMAL_95 * float(np.sqrt(np.mean(controls**2))) if len(controls) else np.nan
    key_columns = {"subject": "all", "hemi": "both", "kind": "control", "seed": None, "n": len(controls)}
    return {**key_columns, "slope": 0.0, "low": -bound, "high": bound}


def pairs_figure(parcel_rows: Sequence[dict[str, Any]], slopes: Sequence[dict[str, Any]]) -> Figure:
    """Left: change of width against thickness, mean over seeds, a point per parcel. Right: slopes of all pairs."""
    names = list(dict.fromkeys((row["subject"], row["hemi"]) for row in parcel_rows))
    colour_of = {name: CATEGORICAL_COLOURS[k % 6] for k, name in enumerate(names)}
    with new_figure(10.5, 4.9, 1, 2) as (figure, panels):
        for name in names:
            side_rows = [row for row in parcel_rows if (row["subject"], row["hemi"]) == name]
            mean_row = next(r for r in slopes if (r["subject"], r["hemi"], r["kind"]) == (*name, "mean of seeds"))
            _draw_parcels(panels[0][0], side_rows, mean_row, colour_of[name])
        panels[0][0].set(
            xlabel="thickness before growth, with the map over even", ylabel="gyral thickness, map over even"
        )
        _draw_slopes(panels[0][1], slopes, names, colour_of)
        legend_entries: dict[str, Any] = {
            " ".join(name): {"color": colour_of[name], "marker": "o", "linestyle": "-"} for name in names
        }
        legend_of_figure(figure, legend_entries, panels[0][0], min(len(names), 4))
    return figure


def _draw_parcels(ax: Axes, rows: Sequence[dict[str, Any]], slope_row: dict[str, Any], colour: Any) -> None:
    n_parcels = 1 + max(row["parcel"] for row in rows)
    ratios = np.array([row["width_map_mm"] / row["width_even_mm"] for row in rows], dtype=float).reshape(-1, n_parcels)
    thickness_factors = np.array([row["thickness_factor"] for row in rows], dtype=float).reshape(-1, n_parcels)[0]
    is_finite = np.isfinite(ratios).any(axis=0) & np.isfinite(thickness_factors)
    with np.errstate(all="ignore"):
        mean_ratio = np.exp(np.nanmean(np.log(ratios[:, is_finite]), axis=0))
    ax.scatter(thickness_factors[is_finite], mean_ratio, s=18, color=colour, alpha=0.75)
    line_x = np.array([thickness_factors[is_finite].min(), thickness_factors[is_finite].max()])
    centre = np.exp(np.mean(np.log(thickness_factors[is_finite]))), np.exp(np.mean(np.log(mean_ratio)))
    ax.plot(line_x, centre[1] * (line_x / centre[0]) ** slope_row["slope"], color=colour)
    ax.axhline(1, color=GREY, linewidth=0.8)


def _draw_slopes(ax: Axes, slopes: Sequence[dict[str, Any]], names: Sequence[Any], colour_of: dict[Any, Any]) -> None:
    for kind_x, kind in enumerate(("pair", "control")):
        for name in names:
            dot_slopes = [row["slope"] for row in slopes if (row["subject"], row["hemi"], row["kind"]) == (*name, kind)]
            dot_x = kind_x + 0.09 * (names.index(name) - 0.5 * (len(names) - 1))
            ax.scatter(np.full(len(dot_slopes), dot_x), dot_slopes, s=22, color=colour_of[name], alpha=0.8)
        mean_row = next(row for row in slopes if (row["subject"], row["kind"]) == ("all", kind))
        if np.isfinite(mean_row["low"]):
            ax.plot([kind_x + 0.32] * 2, [mean_row["low"], mean_row["high"]], color=BLACK)
        ax.plot([kind_x + 0.32], [mean_row["slope"]], "s", color=BLACK)
    ax.axhline(0, color=GREY, linewidth=0.8)
    ax.set(xlim=(-0.5, 1.6), ylabel="slope of log width on log thickness")
    ax.set_xticks([0, 1], ["map against even,\nsame seed", "even against even,\nother seed"])
