"""The page of an unfolding."""

from collections.abc import Sequence
from pathlib import Path

from morphofold.quantities import Quantity
from morphofold.report.pages.page_writer import SIDES, write_page, write_picture
from morphofold.report.pictures.surfaces import Row, figure
from morphofold.results.unfolding import TableRows, UnfoldedSide, log_ratio

AREA_RATIO = Quantity("log2_area_ratio", "Area, folded over smooth, log₂", signed=True, limits=(-1.5, 1.5))


def unfold_report(unfolded: Sequence[UnfoldedSide], rows: TableRows, regions: TableRows, folder: Path) -> Path:
    """Write ``folder/report.html`` and ``folder/figures/area_ratio.png``; returns the path of the page."""
    surface_rows = []
    for side in unfolded:
        hemi, folded_surface = side.cortex.hemi, side.unfolding.folded
        for surface, surface_name in ((folded_surface, folded_surface.name), (side.unfolding.smooth(), "unfolded")):
            surface_rows.append(Row(f"{SIDES[hemi]}, {surface_name}", surface, log_ratio(side), hemi))
    image = figure(surface_rows, AREA_RATIO, AREA_RATIO.limits)
    return write_page(
        folder / "report.html",
        "unfold.html",
        title=unfolded[0].cortex.name,
        rows=rows,
        regions=regions,
        picture=write_picture(folder / "figures" / "area_ratio.png", image, "Folded and smooth surfaces"),
        inputs=[input_record for side in unfolded for input_record in side.cortex.inputs],
    )
