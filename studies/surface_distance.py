"""Distance between two surfaces, by which studies tell folds apart."""

from typing import Any

import numpy as np

from morphofold.surface import Surface


def distance(surface: Surface, other: Surface) -> float:
    """Mean distance [mm] of the vertices of one surface to the nearest point of the other; mean of both directions."""
    import pyvista

    mean_distances = []
    for from_surface, to_surface in ((surface, other), (other, surface)):
        mesh: Any = pyvista.PolyData.from_regular_faces(to_surface.verts, to_surface.faces)  # type: ignore[arg-type]
        _, nearest = mesh.find_closest_cell(from_surface.verts, return_closest_point=True)
        mean_distances.append(np.linalg.norm(from_surface.verts - nearest, axis=1).mean())
    return 0.5 * sum(mean_distances)
