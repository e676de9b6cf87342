"""The folder that ``morphofold unfold`` writes: smooth surfaces, maps, tables, page."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from morphofold import __version__
from morphofold.analysis.notes import of_cortex_mask
from morphofold.io import atomic_folder, write_morph, write_surface
from morphofold.mesh_quality.checks import cortex_label
from morphofold.mesh_quality.repair import Mended
from morphofold.provenance import strict_json
from morphofold.surface import Cortex, Surface
from morphofold.tables import write_table
from morphofold.unfolding.numbers import COLUMNS, region_rows, unfolding_numbers
from morphofold.unfolding.unfold import Unfolding

SPHERE_RADIUS_MM = 100.0  # of the spheres that FreeSurfer writes
#: of a region: its shares of the area of the folded and of the smooth surface, and the first over the second
REGION_COLUMNS = ("hemi", "region", "folded_percent", "smooth_percent", "area_ratio")


class Unfolded(NamedTuple):
    """A hemisphere as it was read and repaired, and as it was unfolded."""

    mended: Mended
    found: Unfolding

    @property
    def cortex(self) -> Cortex:
        return self.mended.cortex

    def at_given_vertices(self, values: np.ndarray, unknown: float) -> np.ndarray:
        """Values at the vertices of the file; ``unknown`` at those that were left out."""
        place = self.mended.place
        left_out = (place < 0).reshape(-1, *[1] * (values.ndim - 1))
        return np.where(left_out, unknown, values[place])


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
        Writes the page and its pictures: :func:`morphofold.report.pages.study_pages.unfold_report`.
    """
    rows = [{"hemi": side.cortex.hemi, **unfolding_numbers(side.found)} for side in unfolded]
    regions = [
        {"hemi": side.cortex.hemi, **row}
        for side in unfolded
        if side.cortex.regions is not None
        for row in region_rows(side.found, side.cortex.regions)
    ]
    summary = {
        "morphofold": __version__,
        "name": unfolded[0].cortex.name,
        "hemispheres": rows,
        "columns": COLUMNS,
        "cortex_mask": {side.cortex.hemi: cortex_label(side.cortex)[1] for side in unfolded},
        "notes": {side.cortex.hemi: side.mended.notes | of_cortex_mask(side.cortex) for side in unfolded},
        "inputs": [record for side in unfolded for record in side.cortex.inputs],
    }
    with atomic_folder(out) as folder:
        (folder / "surf").mkdir()
        for side in unfolded:
            hemi, faces = side.cortex.hemi, side.mended.source[side.cortex.faces]
            for name, verts in (
                ("smooth", side.found.smooth().verts),
                ("sphere", SPHERE_RADIUS_MM * side.found.points),
            ):
                surface = Surface(side.at_given_vertices(verts, 0.0), faces, name=f"{hemi}.{name}")
                write_surface(folder / "surf" / surface.name, surface)
            ratio = side.at_given_vertices(side.found.area_ratio(), np.nan)
            write_morph(folder / "surf" / f"{hemi}.area_ratio", ratio, nan=0.0)
        write_table(folder / "unfold.tsv", list(COLUMNS), rows)
        if regions:
            write_table(folder / "regions.tsv", REGION_COLUMNS, regions)
        draw(unfolded, rows, regions, folder)
        (folder / "summary.json").write_text(strict_json(summary), encoding="utf-8")
    return summary


def log_ratio(side: Unfolded) -> np.ndarray:
    """Logarithm to base 2 of the ratio of areas (N,) of the repaired surface; NaN outside of the cortex."""
    ratio = side.found.area_ratio()
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where((ratio > 0) & cortex_label(side.cortex)[0], np.log2(ratio), np.nan)
