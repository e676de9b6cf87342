"""Shares of hinges or crests that subjects have in common, by region, beside what is there by chance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from markupsafe import Markup

from morphofold.report.plots.charts import WIDE_CHART_SIZE_PX, new_chart
from morphofold.report.plots.line_plots import GREY
from morphofold.words import number

COLOURS = {"lh": "#1f5fa8", "rh": "#b3472b"}
ROW_PX = 15.0
NAMES_PX = 190.0


def share_plot(what: str, rows: Sequence[Mapping[str, Any]]) -> Markup | None:
    """A mark for each hemisphere in each region, and a grey line for the middle 95 % by chance; None without rows.

    Parameters
    ----------
    what : str
        For the title.
    rows : sequence of mapping
        Of :class:`morphofold.inference.overlap.Overlap`.
    """
    shown = [row for row in rows if row.get("share") is not None]
    if not shown:
        return None
    regions = sorted({row["region"] for row in shown}, key=lambda region: _mean_share(shown, region))
    place = {region: k for k, region in enumerate(regions)}
    size = (WIDE_CHART_SIZE_PX[0], 60.0 + ROW_PX * len(regions))
    title = f"{what} that another subject has, too"
    limits = (0.0, 1.0), (-0.7, len(regions) - 0.3)
    with new_chart(title, "share, and by chance (grey)", "", *limits, size=size, left=NAMES_PX) as chart:
        chart.ax.set_yticks(range(len(regions)), regions)
        for row in shown:
            y = place[row["region"]] + (0.17 if row["hemi"] == "lh" else -0.17)
            chart.line([row["chance_low"], row["chance_high"]], [y, y], "chance", color=GREY, linewidth=3, alpha=0.5)
            share, chance, p = (number(row[key]) for key in ("share", "chance", "p"))
            words = f"{row['hemi']} {row['region']}: {share}, by chance {chance}, p {p}"
            chart.line([row["share"]], [y], "share", words, color=COLOURS[row["hemi"]], marker="o", markersize=5)
        return chart.svg()


def _mean_share(rows: Sequence[Mapping[str, Any]], region: str) -> float:
    shares = [row["share"] for row in rows if row["region"] == region]
    return float(sum(shares) / len(shares))
