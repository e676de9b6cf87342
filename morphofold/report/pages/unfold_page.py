"""The page of an unfolding: folded and smooth surfaces in the colours of their ratio of areas, and the tables."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from morphofold.quantities import Quantity
from morphofold.report.pages.templates import write_page
from morphofold.report.pictures.sheet import halved, png_bytes
from morphofold.report.pictures.surfaces import Row, figure
from morphofold.results.unfolding import Unfolded, log_ratio

AREA_RATIO = Quantity("log2_area_ratio", "Area, folded over smooth, log₂", signed=True, limits=(-1.5, 1.5))
SIDES = {"lh": "left", "rh": "right"}


def unfold_report(
    unfolded: Sequence[Unfolded], rows: Sequence[Mapping[str, Any]], regions: Sequence[Mapping[str, Any]], folder: Path
) -> Path:
    """Write ``folder/report.html`` and ``folder/figures/area_ratio.png``; returns the path of the page."""
    (folder / "figures").mkdir()
    drawn = []
    for one in unfolded:
        values, hemi = log_ratio(one), one.cortex.hemi
        drawn.append(Row(f"{SIDES[hemi]}, {one.found.folded.name}", one.found.folded, values, hemi))
        drawn.append(Row(f"{SIDES[hemi]}, unfolded", one.found.smooth(), values, hemi))
    assert AREA_RATIO.limits is not None
    image = figure(drawn, AREA_RATIO, AREA_RATIO.limits)
    (folder / "figures" / "area_ratio.png").write_bytes(png_bytes(image))
    return write_page(
        folder / "report.html",
        "unfold.html",
        title=unfolded[0].cortex.name,
        rows=[{**row, "side": SIDES[row["hemi"]]} for row in rows],
        regions=sorted(regions, key=lambda row: -row["area_ratio"]),
        sides=SIDES,
        picture=base64.b64encode(png_bytes(halved(image))).decode(),
        inputs=[record for one in unfolded for record in one.cortex.inputs],
    )
