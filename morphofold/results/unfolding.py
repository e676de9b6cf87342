"""The folder that ``morphofold unfold`` writes: smooth surfaces, maps, tables, page."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from morphofold import __version__
from morphofold.analysis.notes import of_cortex_mask
from morphofold.digests_and_json import Row
from morphofold.io import atomic_folder, write_morph, write_surface
from morphofold.io.json_files import write_json
from morphofold.mesh_quality.cortex_checks import cortex_label
from morphofold.mesh_quality.repair import Mended
from morphofold.surface import Cortex, Surface
from morphofold.tables import write_table
from morphofold.unfolding.unfold import COLUMNS, Unfolding, region_rows, unfolding_numbers

SPHERE_RADIUS_MM = 100.0  # of the spheres that FreeSurfer writes


class UnfoldedSide(NamedTuple):
    """A hemisphere as it was read and repaired, and its unfolding."""

    mended: Mended
    unfolding: Unfolding

    @property
    def cortex(self) -> Cortex:
        return self.mended.cortex

    def at_file_vertices(self, values: np.ndarray, fill_value: float) -> np.ndarray:
        """Values at the vertices of the file; ``fill_value`` at those that were left out."""
        all_values = values[self.mended.target]
        all_values[self.mended.target < 0] = fill_value
        return all_values


TableRows = Sequence[Row]
#: writes the page: called as ``page(unfolded, rows, regions, folder)``
DrawPage = Callable[..., object]


def write_unfolding(unfolded_sides: Sequence[UnfoldedSide], out: str | Path, draw: DrawPage) -> Row:
    """Write an unfolding, completely or not at all; returns the content of summary.json.

    Parameters
    ----------
    unfolded_sides : sequence of UnfoldedSide
        One hemisphere, or a left and a right one.
    out : str or path
        Folder to write. A folder of an earlier run is replaced; any other folder that is not empty is refused.
    draw : callable
        Writes the page and its pictures: :func:`morphofold.report.pages.unfold_page.unfold_report`.
    """
    hemi_rows, region_table = [], []
    for side in unfolded_sides:
        side_column = {"hemi": side.cortex.hemi}
        hemi_rows.append(side_column | unfolding_numbers(side.unfolding))
        if side.cortex.regions is not None:
            region_table += [side_column | row for row in region_rows(side.unfolding, side.cortex.regions)]
    summary = {
        "morphofold": __version__,
        "name": unfolded_sides[0].cortex.name,
        "hemispheres": hemi_rows,
        "columns": COLUMNS,
        "cortex_mask": {side.cortex.hemi: cortex_label(side.cortex)[1] for side in unfolded_sides},
        "notes": {side.cortex.hemi: side.mended.notes | of_cortex_mask(side.cortex) for side in unfolded_sides},
        "inputs": [record for side in unfolded_sides for record in side.cortex.inputs],
    }
    with atomic_folder(out) as folder:
        (folder / "surf").mkdir()
        for side in unfolded_sides:
            unfolding, hemi = side.unfolding, side.cortex.hemi
            faces = side.mended.source[side.cortex.faces]
            for name, verts in (("smooth", unfolding.smooth().verts), ("sphere", SPHERE_RADIUS_MM * unfolding.points)):
                surface = Surface(side.at_file_vertices(verts, 0.0), faces, f"{hemi}.{name}")
                write_surface(folder / "surf" / surface.name, surface)
            area_ratio = side.at_file_vertices(unfolding.area_ratio(), np.nan)
            write_morph(folder / f"surf/{hemi}.area_ratio", area_ratio, nan=0.0)
        write_table(folder / "unfold.tsv", [*COLUMNS], hemi_rows)
        if region_table:
            write_table(folder / "regions.tsv", ["hemi"], region_table)
        draw(unfolded_sides, hemi_rows, region_table, folder)
        write_json(folder / "summary.json", summary)
    return summary


def log_ratio(side: UnfoldedSide) -> np.ndarray:
    """Logarithm to base 2 of the ratio of areas (N,) of the repaired surface; NaN outside of the cortex."""
    area_ratio = side.unfolding.area_ratio()
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where((area_ratio > 0) & cortex_label(side.cortex)[0], np.log2(area_ratio), np.nan)
