"""Distance between two surfaces."""

from __future__ import annotations

from typing import Any

import numpy as np

from morphofold.surface import Surface


def distance(one: Surface, other: Surface) -> float:
    """Mean distance [mm] of the vertices of one surface to the nearest point of the other; mean of both directions."""
    return 0.5 * (_mean_one_way_distance(one, other) + _mean_one_way_distance(other, one))


def _mean_one_way_distance(points: Surface, surface: Surface) -> float:
    import pyvista as pv

    mesh: Any = pv.PolyData.from_regular_faces(surface.verts, surface.faces)  # type: ignore[arg-type]
    _, nearest = mesh.find_closest_cell(points.verts, return_closest_point=True)
    return float(np.linalg.norm(points.verts - nearest, axis=1).mean())
