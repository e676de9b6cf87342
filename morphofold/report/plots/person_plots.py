"""Regions of a grown cortex against those of the person it grew from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from markupsafe import Markup

from morphofold.report.plots.charts import CHART_SIZE_PX, Look, limits_around, new_chart
from morphofold.report.plots.line_plots import GREY
from morphofold.words import number


def region_plot(
    rows: Sequence[Mapping[str, Any]], key: str, label: str, unit: str, person: Look, grown: Look
) -> Markup | None:
    """A measure of the regions of the grown cortex, and of the smooth body in grey, against the person's.

    Parameters
    ----------
    rows : sequence of mapping
        Regions with ``person_KEY``, ``grown_KEY`` and perhaps ``smooth_KEY``.
    key, label, unit : str
    person, grown : Look

    Returns
    -------
    svg : Markup, or None if fewer than two regions have both.
    """
    x_of, y_of, s_of = (f"{body}_{key}" for body in ("person", "grown", "smooth"))
    known = [row for row in rows if row[x_of] is not None and row[y_of] is not None]
    if len(known) < 2:
        return None
    smooth = [row for row in known if row.get(s_of) is not None]
    in_unit = f" [{unit}]" if unit else ""
    across = limits_around([row[x_of] for row in known])
    up = limits_around([*(row[y_of] for row in known), *(row[s_of] for row in smooth)])
    with new_chart(
        f"{label}, {grown.name} against {person.name}",
        f"{label} of {person.name}{in_unit}",
        grown.name,
        across,
        up,
        CHART_SIZE_PX,
    ) as chart:
        for row in smooth:
            text = f"{row['region']}: {number(row[s_of])} before growth, {number(row[x_of])} {person.name}"
            chart.line([row[x_of]], [row[s_of]], "point", text, color=GREY, marker="o", markersize=5, fillstyle="none")
        words = [
            f"{row['region']}: {number(row[y_of])} {grown.name}, {number(row[x_of])} {person.name}" for row in known
        ]
        chart.points([row[x_of] for row in known], [row[y_of] for row in known], words, grown, big=False)
        return chart.svg()
