"""The page of a model that was tested at every vertex: effect, corrected p, subjects, and the table of clusters."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from morphofold.inference.study import Result, cluster_rows, split
from morphofold.quantities import Quantity, quantity
from morphofold.report.pages.space_pictures import SIDES, picture
from morphofold.report.pages.templates import write_page

SIGNIFICANT = 0.05
CLUSTERS_SHOWN = 20


def stats_report(result: Result, summary: Mapping[str, Any], folder: Path) -> Path:
    """Write ``folder/report.html`` and ``folder/figures/``: effect, r, p_tfce, p_height and subjects; returns the path
    of the page."""
    (folder / "figures").mkdir()
    found, unit = result.inference, "" if result.asymmetry == "index" else quantity(result.map).unit
    largest = float(np.nanpercentile(np.abs(found.effect), 99.5)) or 1.0
    pictures = [
        picture(
            result.space,
            folder,
            Quantity("effect", f"Effect of {result.contrast} on {_map_words(result)}", unit, signed=True),
            split(result, found.effect),
            (-largest, largest),
            f"The contrast {result.contrast} of the coefficients, per unit of the regressor.",
        )
    ]
    pictures.append(
        picture(
            result.space,
            folder,
            Quantity("r", "Partial correlation", signed=True),
            split(result, found.r),
            (-1.0, 1.0),
            "The size of the effect without a unit: t / sqrt(t² + degrees of freedom).",
        )
    )
    for key, words in (
        ("p_tfce", "by threshold-free cluster enhancement"),
        ("p_height", "of single vertices, by height"),
    ):
        p = getattr(found, key)
        shown = np.where(p <= SIGNIFICANT, -np.log10(p) * np.sign(found.t), np.nan)
        most = float(-np.log10(1 / (1 + result.permutations)))
        pictures.append(
            picture(
                result.space,
                folder,
                Quantity(key, "−log10 p, with the sign of the effect", signed=True),
                split(result, shown),
                (-most, most),
                f"Corrected for all vertices that are tested, {words}. Grey: p above {SIGNIFICANT}, or not tested.",
            )
        )
    counts = result.counts.astype(np.float64)
    pictures.append(
        picture(
            result.space,
            folder,
            Quantity("subjects", "Subjects with a value"),
            split(result, counts),
            (0.0, float(len(result.design.subjects))),
            "Only vertices where all subjects have a value are tested.",
        )
    )
    return write_page(
        folder / "report.html",
        "stats.html",
        title=f"{result.shown} ~ {result.formula}",
        result=result,
        summary=summary,
        unit=unit,
        pictures=pictures,
        clusters=cluster_rows(result)[:CLUSTERS_SHOWN],
        sides=SIDES,
        smallest=1 / (1 + result.permutations),
    )


def _map_words(result: Result) -> str:
    words = quantity(result.map).label.lower()
    return {None: words, "difference": f"{words}, left − right", "index": f"asymmetry of {words}"}[result.asymmetry]
