"""Pictures of maps on the template of a study."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from morphofold.arrays import Array
from morphofold.errors import MissingPart
from morphofold.inference.spaces import Space
from morphofold.quantities import Quantity
from morphofold.report.pictures.sheet import halved, png_bytes
from morphofold.report.pictures.surfaces import Row, figure
from morphofold.surface import Surface

SIDES = {"lh": "left", "rh": "right"}


def picture(
    space: Space, folder: Path, what: Quantity, maps: Mapping[str, Array], limits: tuple[float, float], words: str
) -> dict[str, Any]:
    """Write ``folder/figures/KEY.png`` of maps (N,) by hemisphere on the template; return its entry for a page."""
    rows = [
        Row(f"{SIDES[hemi]} hemisphere", _shown_surface(space, hemi), values, space.side(hemi))
        for hemi, values in maps.items()
    ]
    image = figure(rows, what, limits)
    (folder / "figures" / f"{what.key}.png").write_bytes(png_bytes(image))
    small = base64.b64encode(png_bytes(halved(image))).decode()
    return {"key": what.key, "title": what.title, "words": words, "data": small}


def _shown_surface(space: Space, hemi: str) -> Surface:
    try:
        return space.surface(hemi, "inflated")
    except MissingPart:
        return space.surface(hemi)
