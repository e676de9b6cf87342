"""Pictures of outliers of a group: the pial surface beside that of the subject nearest to the median."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from morphofold.cohort.statistics import HEMIS, Outlier, Scalars
from morphofold.quantities import MAP_OF_SCALAR, common_limits, quantity
from morphofold.report.pages.templates import write_picture
from morphofold.report.pictures.sheet import Picture
from morphofold.report.pictures.surfaces import Row, figure
from morphofold.results import read_pial
from morphofold.words import in_one_line

DEFAULT_MAP = "H"  # the map for measures that have no map
FIGURE_WIDTH_PX = 860  # [pixels]
MOST_EMBEDDED_CHARACTERS = 1_500_000  # most characters of pictures inside a page; further pictures are files only


def draw_outliers(
    far: Sequence[Outlier], subjects: Sequence[str], scalars: Scalars, results: Mapping[str, Path], folder: Path
) -> list[dict[str, Any]]:
    """Write ``folder/outlier-01.png`` and so on, one for each of ``far``.

    Returns an entry for each, for the page: the ``outlier``, the ``typical`` subject beside it, the ``map``, and the
    ``file`` and its ``data``, or the ``reason`` why there is none.
    """
    entries: list[dict[str, Any]] = []
    for k, outlier in enumerate(far, start=1):
        typical = nearest_to_median(outlier, subjects, scalars)
        key = MAP_OF_SCALAR.get(outlier.measure, DEFAULT_MAP)
        entry = {"outlier": outlier, "typical": typical, "map": quantity(key).label, "data": ""}
        entries.append(entry)
        try:
            image = _outlier_picture(outlier, typical, key, results)
        except (OSError, ValueError) as error:
            entry["reason"] = in_one_line(error)
            continue
        folder.mkdir(exist_ok=True)
        entry |= write_picture(folder / f"outlier-{k:02}.png", image, outlier.subject)
        if sum(len(other["data"]) for other in entries) > MOST_EMBEDDED_CHARACTERS:
            entry["data"] = ""
    return entries


def nearest_to_median(outlier: Outlier, subjects: Sequence[str], scalars: Scalars) -> str:
    """The first subject whose value of an outlier's measure, on its side, is nearest to the median."""
    difference = np.abs(scalars[outlier.measure][:, HEMIS.index(outlier.hemi)] - outlier.median)
    return subjects[int(np.nanargmin(difference))]


def _outlier_picture(outlier: Outlier, typical: str, key: str, results: Mapping[str, Path]) -> Picture:
    """Lateral and medial view of both subjects, in the same colours and at one scale."""
    rows, hemi = [], outlier.hemi
    for subject, label in {outlier.subject: outlier.subject, typical: f"{typical}, at the median"}.items():
        surface, values = read_pial(results[subject], hemi, key)
        rows.append(Row(label, surface, np.full(len(surface.verts), np.nan) if values is None else values, hemi))
    measured = [row.values for row in rows]
    what = quantity(key, measured)
    return figure(rows, what, common_limits(what, measured), ("lateral", "medial"), FIGURE_WIDTH_PX)
