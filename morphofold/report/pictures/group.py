"""Pictures of outliers of a group: the pial surface beside that of the subject nearest to the median."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from morphofold.cohort.statistics import HEMIS, Outlier, Scalars
from morphofold.quantities import MAP_OF_SCALAR, common_limits, quantity
from morphofold.report.pages.templates import write_picture
from morphofold.report.pictures.sheet import Picture
from morphofold.report.pictures.surfaces import Row, figure
from morphofold.results import read_pial

SIDE_WORDS = {"lh": "left", "rh": "right"}
DEFAULT_MAP = "H"  # the map for measures that have no map
FIGURE_WIDTH_PX = 860  # [pixels]
MOST_EMBEDDED_CHARACTERS = 1_500_000  # most characters of pictures inside a page; further pictures are files only


@dataclass(frozen=True)
class Drawn:
    """The picture of a subject's farthest outlier: its file and its data in the page, or why there is none."""

    outlier: Outlier
    file: str = ""
    data: str = ""
    typical: str = ""
    reason: str = ""

    @property
    def map(self) -> str:
        return quantity(map_of(self.outlier.measure)).label


def map_of(measure: str) -> str:
    """The map that shows a measure, or mean curvature (the folds)."""
    return MAP_OF_SCALAR.get(measure, DEFAULT_MAP)


def draw_outliers(
    far: Sequence[Outlier], subjects: Sequence[str], scalars: Scalars, results: Mapping[str, Path], folder: Path
) -> list[Drawn]:
    """Write ``folder/outlier-01.png`` and so on, one for each of ``far``; return an entry for each."""
    drawn: list[Drawn] = []
    for k, one in enumerate(far, start=1):
        typical = nearest_to_median(one, subjects, scalars)
        try:
            image = _outlier_picture(one, typical, results)
        except (OSError, ValueError) as error:
            drawn.append(Drawn(one, reason=" ".join(str(error).split())))
            continue
        folder.mkdir(exist_ok=True)
        entry = write_picture(folder / f"outlier-{k:02}.png", image, one.subject)
        fits = sum(len(other.data) for other in drawn) + len(entry["data"]) <= MOST_EMBEDDED_CHARACTERS
        drawn.append(Drawn(one, entry["file"], entry["data"] if fits else "", typical))
    return drawn


def nearest_to_median(one: Outlier, subjects: Sequence[str], scalars: Scalars) -> str:
    """The first subject whose value of an outlier's measure, on its side, is nearest to the median."""
    apart = np.abs(scalars[one.measure][:, HEMIS.index(one.hemi)] - one.median)
    return subjects[int(np.nanargmin(apart))]


def _outlier_picture(one: Outlier, typical: str, results: Mapping[str, Path]) -> Picture:
    """Lateral and medial view of both subjects, in the same colours and at one scale."""
    key = map_of(one.measure)
    rows = []
    for label, subject in ((one.subject, one.subject), (f"{typical}, at the median", typical)):
        surface, values = read_pial(results[subject], one.hemi, key)
        rows.append(Row(label, surface, np.full(len(surface.verts), np.nan) if values is None else values, one.hemi))
    known = [row.values for row in rows]
    what = quantity(key, known)
    return figure(rows, what, common_limits(what, known), ("lateral", "medial"), FIGURE_WIDTH_PX)
