"""The medial wall of surfaces without a label: a large patch where white and pial nearly meet."""

import numpy as np
from scipy.sparse import csgraph

from morphofold import geometry
from morphofold.arrays import Bools, memoized
from morphofold.surface import Cortex, Faces, Verts

# of the median distance of white and pial: below it a vertex is not cortex (0.5 mm in adults)
WALL_DISTANCE_OVER_MEDIAN = 0.2
# shares of the white area: least of one patch, most of all patches; walls have 0.03 to 0.1
LEAST_PATCH_SHARE, LARGEST_WALL_SHARE = 0.01, 0.2


def wall_of_thickness(cortex: Cortex) -> Bools:
    """True (N,) in the wall, where the thickness that came with the surfaces is 0 or NaN; nowhere without one."""
    given = cortex.maps.get("thickness")
    if given is None:
        return np.zeros(cortex.n_vertices, dtype=bool)
    return _wall_patches(cortex.white.verts, cortex.faces, ~(np.asarray(given) > 0))


def wall_of_geometry(cortex: Cortex) -> Bools:
    """True (N,) in the wall, where white and pial are closer than ``WALL_DISTANCE_OVER_MEDIAN`` times their median
    distance.

    The step from white to pial is first averaged over a vertex and its neighbours. Noise of the vertices differs
    between the two surfaces, and without the average it would tear the patch. The bound is relative: it is the same in
    any unit, and a cortex that is thin everywhere has no wall.
    """
    return _wall_between(cortex.white.verts, cortex.pial.verts, cortex.faces)


@memoized
def _wall_between(white: Verts, pial: Verts, faces: Faces) -> Bools:
    step = pial - white
    ring = geometry.adjacency(len(white), faces).astype(np.float64)
    mean = (step + ring @ step) / (1 + np.diff(ring.indptr))[:, None]
    thin = geometry.norms(mean) < WALL_DISTANCE_OVER_MEDIAN * np.median(geometry.norms(step))
    return _wall_patches(white, faces, thin)


def _wall_patches(white: Verts, faces: Faces, thin: Bools) -> Bools:
    """The thin vertices in connected patches as large as a wall; none if these cover too much of the surface."""
    at = np.flatnonzero(thin)
    area = geometry.vertex_areas(white, faces)
    joined = geometry.adjacency(len(white), faces)[at][:, at]
    _, patch = csgraph.connected_components(joined, directed=False)
    large = np.bincount(patch, area[at]) >= LEAST_PATCH_SHARE * area.sum()
    found = np.zeros(len(white), dtype=bool)
    found[at[large[patch]]] = True
    return found & (area[found].sum() <= LARGEST_WALL_SHARE * area.sum())
