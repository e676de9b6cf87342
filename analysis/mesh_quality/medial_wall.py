"""The medial wall of surfaces without a label: a large patch where white and pial nearly meet."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csgraph

from morphofold import geometry
from morphofold.surface import Cortex

# of the median distance of white and pial: below it a vertex is not cortex (0.5 mm in adults)
WALL_DISTANCE_OVER_MEDIAN = 0.2
# shares of the white area: least of one patch, most of all patches; walls have 0.03 to 0.1
LEAST_PATCH_SHARE, LARGEST_WALL_SHARE = 0.01, 0.2


def wall_of_thickness(cortex: Cortex) -> NDArray[np.bool_]:
    """True (N,) in the wall, where the thickness that came with the surfaces is 0 or NaN; nowhere without one."""
    given = cortex.maps.get("thickness")
    if given is None:
        return np.zeros(cortex.n_vertices, dtype=bool)
    return _wall_patches(cortex, ~(np.asarray(given) > 0))


def wall_of_geometry(cortex: Cortex) -> NDArray[np.bool_]:
    """True (N,) in the wall, where white and pial are closer than ``WALL_DISTANCE_OVER_MEDIAN`` times their median
    distance.

    The step from white to pial is first averaged over a vertex and its neighbours. Noise of the vertices differs
    between the two surfaces, and without the average it would tear the patch. The bound is relative: it is the same in
    any unit, and a cortex that is thin everywhere has no wall.
    """
    step = cortex.pial.verts - cortex.white.verts
    ring = geometry.adjacency(cortex.n_vertices, cortex.faces).astype(np.float64)
    mean = (step + ring @ step) / (1 + np.diff(ring.indptr))[:, None]
    return _wall_patches(
        cortex, np.linalg.norm(mean, axis=1) < WALL_DISTANCE_OVER_MEDIAN * np.median(np.linalg.norm(step, axis=1))
    )


def _wall_patches(cortex: Cortex, thin: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The thin vertices in connected patches as large as a wall; none if these cover too much of the surface."""
    at = np.flatnonzero(thin)
    area = geometry.vertex_areas(cortex.white.verts, cortex.faces)
    joined = geometry.adjacency(cortex.n_vertices, cortex.faces)[at][:, at]
    _, patch = csgraph.connected_components(joined, directed=False)
    large = np.bincount(patch, area[at]) >= LEAST_PATCH_SHARE * area.sum()
    found = np.zeros(cortex.n_vertices, dtype=bool)
    found[at[large[patch]]] = True
    return found & (area[found].sum() <= LARGEST_WALL_SHARE * area.sum())
