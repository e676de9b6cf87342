"""The page of what subjects have in common: densities of hinges and crests, and shared ones by region."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from morphofold.inference.overlap import WHOLE, Overlap
from morphofold.inference.overlap_files import DENSITY_MAPS
from morphofold.inference.spaces import Space
from morphofold.quantities import Quantity
from morphofold.report.pages.space_pictures import SIDES, picture
from morphofold.report.pages.templates import write_page
from morphofold.report.plots.charts import share_plot

SIGNIFICANT = 0.05
UNITS = {"hinges": "1/cm²", "crests": "mm/cm²"}


def overlap_report(space: Space, found: Sequence[Overlap], summary: Mapping[str, Any], folder: Path) -> Path:
    """Write ``folder/report.html`` and ``folder/figures/``: density and p of each kind; returns the page's path."""
    (folder / "figures").mkdir()
    pictures = []
    for one in found:
        words = one.kind.capitalize()
        largest = float(max(np.nanpercentile(values, 99.5) for values in one.density.values())) or 1.0
        density = Quantity(DENSITY_MAPS[one.kind], f"{words} per area", UNITS[one.kind])
        text = f"Of a subject, smoothed over {summary['density_fwhm_mm']:g} mm."
        pictures.append(picture(space, folder, density, one.density, (0.0, largest), text))
        shown = {
            hemi: np.where(p <= SIGNIFICANT, -np.log10(p) * np.sign(one.density[hemi] - one.chance[hemi]), np.nan)
            for hemi, p in one.p.items()
        }
        most = float(-np.log10(1 / (1 + summary["rotations"])))
        unlike = Quantity(f"{DENSITY_MAPS[one.kind]}_p", f"{words} unlike chance, −log10 p", signed=True)
        text = f"Positive: more than chance, negative: fewer. Grey: corrected p above {SIGNIFICANT}."
        pictures.append(picture(space, folder, unlike, shown, (-most, most), text))
    return write_page(
        folder / "report.html",
        "overlap.html",
        title="Hinges and crests that subjects share",
        summary=summary,
        found=[(one, UNITS[one.kind], share_plot(one.kind.capitalize(), one.rows)) for one in found],
        pictures=pictures,
        sides=SIDES,
        whole=WHOLE,
        smallest=1 / (1 + summary["rotations"]),
    )
