"""Agreement of folds against heterogeneity of growth, for several hemispheres: the table and curve of a page.

``python -m morphofold.studies.person.inferences docs/hemisphere.md FOLDER...`` reads folders of ``morphofold infer``
(three seeds each for the page) and writes the table between the marks ``inferences``. Beside the page it writes all
rows, ``hemisphere-inferences.tsv``, and the curve, ``inferences.png``.
"""

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from morphofold.report.plots.figure_style import GREY, legend_of_figure, line_style, new_figure, save
from morphofold.studies.markdown import table_with_tsv, update_page

BANDS = ("folds_7_11", "folds_12_16", "folds_17_22", "folds_23_30")
HEADS = (
    "hemisphere | growth | folds, of each seed | p, more than deepened | "
    "degrees 7 to 11, 12 to 16, 17 to 22, 23 to 30 | between seeds | "
    "valleys, by chance | crests, by chance | gyrification"
)
SHOWN_GROWTHS = ("none: sulci deepened", "even", "30 %", "30 %, map turned")  # of the first hemisphere, in the page
Results = Mapping[str, Any]  # of inference.json


def rows_of(results: Results) -> list[list[str]]:
    """A row for each kind of body of a hemisphere: controls first, then by heterogeneity, then turned maps."""
    name, runs = f"{results['subject']} {results['hemi']}", results["runs"]
    rows = [
        [name, f"none: {text}", f"{results['controls'][key]:.2f}", *[""] * 6]
        for key, text in (("before growth", "unfolded"), ("sulci deepened", "sulci deepened"))
    ]
    kinds: dict[tuple[float, bool], list[Any]] = {}
    for run in runs:
        kinds.setdefault((run["spread"], bool(run["turned"])), []).append(run)
    for (spread, is_turned), members in kinds.items():
        mean = {key: np.mean([run[key] for run in members]) for key in (*BANDS, "valleys", "valleys_by_chance")}
        mean |= {key: np.nanmean([run[key] or np.nan for run in members]) for key in ("crests", "crests_by_chance")}
        growth = "even" if not spread else f"{100 * spread:.0f} %" + (", map turned" if is_turned else "")
        between = None if is_turned else results["between_seeds"].get(f"{spread:g}")
        rows.append(
            [
                name,
                growth,
                ", ".join(f"{run['folds']:.2f}" for run in members),
                ", ".join(f"{run['p_above_deepened']:.2g}" for run in members) if spread else "",
                ", ".join(f"{mean[key]:.2f}" for key in BANDS),
                "" if between is None else f"{between:.2f}",
                f"{100 * mean['valleys']:.0f}, {100 * mean['valleys_by_chance']:.0f} %",
                f"{100 * mean['crests']:.0f}, {100 * mean['crests_by_chance']:.0f} %",
                f"{np.mean([run['gyrification_index'] for run in members]):.2f}",
            ]
        )
    return [[cell.replace("-", "−") if k > 1 else cell for k, cell in enumerate(row)] for row in rows]


def summary_of(results: list[Results]) -> str:
    """How many runs, how many of them valid or left out."""
    runs = [run for result in results for run in result["runs"]]
    n_valid, n_left_out = sum(run["healthy"] for run in runs), sum(len(result["not_grown"]) for result in results)
    left_out = f"; {n_left_out} more could not be grown to the end" if n_left_out else ""
    return f"{len(runs)} runs, {n_valid} of them within all limits of the solver{left_out}."


def draw(results: list[Results], file: Path) -> None:
    """The curves of all hemispheres; grey: maps turned away; dotted: sulci deepened, without growth."""
    with new_figure(7.2, 4.4) as (figure, ((ax,),)):
        style_by_label = {}
        for k, result in enumerate(results):
            style = style_by_label[f"{result['subject']} {result['hemi']}"] = line_style(k)
            runs = [run for run in result["runs"] if not run["turned"]]
            spreads = sorted({run["spread"] for run in runs})
            means = [np.mean([run["folds"] for run in runs if run["spread"] == spread]) for spread in spreads]
            ax.plot(spreads, means, **style)
            ax.plot([run["spread"] for run in runs], [run["folds"] for run in runs], ".", color=style["color"])
            ax.axhline(result["controls"]["sulci deepened"], color=style["color"], linestyle=":", linewidth=1)
            turned = [run for run in result["runs"] if run["turned"]]
            ax.plot([run["spread"] for run in turned], [run["folds"] for run in turned], "x", color=GREY)
        ax.set_xlabel("standard deviation of growth over its mean")
        ax.set_ylabel("correlation of the heights of folds")
        legend_of_figure(figure, style_by_label, ax, 4)
        save(figure, file)


def main(page: Path, folders: list[Path]) -> None:
    results = [json.loads((folder / "result" / "inference.json").read_text("utf-8")) for folder in folders]
    rows = [row for result in results for row in rows_of(result)]
    is_shown = lambda row: row[0] == rows[0][0] and row[1] in SHOWN_GROWTHS
    update_page(page, {"inferences": [table_with_tsv(page, "inferences", HEADS, rows, is_shown), summary_of(results)]})
    draw(results, page.with_name("inferences.png"))


if __name__ == "__main__":
    main(Path(sys.argv[1]), [Path(text) for text in sys.argv[2:]])
