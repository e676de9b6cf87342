"""The folder that ``morphofold unfold`` writes: smooth surfaces, maps, tables, page."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from morphofold import __version__
from morphofold.io import atomic_folder, write_morph, write_surface
from morphofold.io.folded import Folded
from morphofold.provenance import strict_json
from morphofold.surface import Surface
from morphofold.tables import write_table
from morphofold.unfolding.numbers import COLUMNS, region_rows, unfolding_numbers
from morphofold.unfolding.unfold import Unfolding

SPHERE_RADIUS_MM = 100.0  # of the spheres that FreeSurfer writes
REGION_COLUMNS = {
    "hemi": COLUMNS["hemi"],
    "region": "Region of the parcellation",
    "folded_percent": "Its share of the area of the folded surface",
    "smooth_percent": "Its share of the area of the smooth surface",
    "area_ratio": "The first over the second",
}


class Unfolded(NamedTuple):
    """A hemisphere as it was read, and as it was unfolded."""

    folded: Folded
    found: Unfolding


DrawPage = Callable[[Sequence[Unfolded], Sequence[Mapping[str, Any]], Sequence[Mapping[str, Any]], Path], object]


def write_unfolding(unfolded: Sequence[Unfolded], out: str | Path, draw: DrawPage) -> dict[str, Any]:
    """Write an unfolding, completely or not at all; returns the content of summary.json.

    Parameters
    ----------
    unfolded : sequence of Unfolded
        One hemisphere, or a left and a right one.
    out : str or path
        Folder to write. A folder of an earlier run is replaced; any other folder that is not empty is refused.
    draw : callable
        Writes the page and its pictures: :func:`morphofold.report.pages.unfold_page.unfold_report`.
    """
    rows = [{"hemi": one.folded.hemi, **unfolding_numbers(one.found)} for one in unfolded]
    regions = [
        {"hemi": one.folded.hemi, **row}
        for one in unfolded
        if one.folded.regions is not None
        for row in region_rows(one.found, one.folded.regions)
    ]
    summary = {
        "morphofold": __version__,
        "name": unfolded[0].folded.name,
        "hemispheres": rows,
        "columns": COLUMNS,
        "inputs": [record for one in unfolded for record in one.folded.inputs],
    }
    with atomic_folder(out) as folder:
        (folder / "surf").mkdir()
        for one in unfolded:
            place, faces = folder / "surf" / one.folded.hemi, one.found.folded.faces
            sphere = Surface(SPHERE_RADIUS_MM * one.found.points, faces, name=f"{one.folded.hemi}.sphere")
            write_surface(f"{place}.smooth", one.found.smooth())
            write_surface(f"{place}.sphere", sphere)
            write_morph(f"{place}.area_ratio", one.found.area_ratio(), nan=0.0)
        write_table(folder / "unfold.tsv", list(COLUMNS), rows)
        if regions:
            write_table(folder / "regions.tsv", list(REGION_COLUMNS), regions)
        draw(unfolded, rows, regions, folder)
        (folder / "summary.json").write_text(strict_json(summary), encoding="utf-8")
    return summary


def log_ratio(one: Unfolded) -> np.ndarray:
    """Logarithm to base 2 of the ratio of areas (N,); NaN outside of the cortex label."""
    ratio = one.found.area_ratio()
    with np.errstate(divide="ignore", invalid="ignore"):
        values = np.where(ratio > 0, np.log2(ratio), np.nan)
    return values if one.folded.cortex is None else np.where(one.folded.cortex, values, np.nan)
