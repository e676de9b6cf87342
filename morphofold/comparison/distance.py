"""Distance between two surfaces."""

from __future__ import annotations

from typing import Any

import numpy as np

from morphofold.surface import Surface


def distance(surface: Surface, other: Surface) -> float:
    """Mean distance [mm] of the vertices of one surface to the nearest point of the other; mean of both directions."""
    import pyvista as pv

    one_way = []
    for start, end in ((surface, other), (other, surface)):
        mesh: Any = pv.PolyData.from_regular_faces(end.verts, end.faces)  # type: ignore[arg-type]
        _, nearest = mesh.find_closest_cell(start.verts, return_closest_point=True)
        one_way.append(float(np.linalg.norm(start.verts - nearest, axis=1).mean()))
    return 0.5 * sum(one_way)
