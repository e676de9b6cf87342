"""Sulcal depth of a folded surface: one distance per vertex."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from morphofold.analysis.geodesics import path_graph, shorten
from morphofold.analysis.gyrification.hull import hull
from morphofold.errors import OptionsClash, OutOfRange, UnknownName
from morphofold.geometry import mean_edge_length
from morphofold.surface import Faces, PerVertex, Verts, check_mesh
from morphofold.threads import BLOCKS

PLANES_PER_BUNDLE = 16  # planes that are skipped together


def sulcal_depth(verts: Verts, faces: Faces, mode: str = "hull", *, touching: float | None = None) -> PerVertex:
    """Distance from each vertex to the convex hull, or along the surface to the nearest vertex that touches the hull.

    Parameters
    ----------
    verts : (N, 3) float64
        Vertex positions [mm], usually of the pial surface.
    faces : (M, 3) int64
        Triangles.
    mode : {"hull", "geodesic"}
        ``"hull"``: straight line to the hull. ``"geodesic"``: shortest path along the surface to a vertex that touches
        the hull.
    touching : float, optional
        In geodesic mode, the distance to the hull [mm] up to which a vertex counts as touching it; None: a mean edge.

    Returns
    -------
    depth : (N,) float64
        [mm], >= 0, and 0 on the hull. NaN at a vertex that no face uses, or on a piece that does not touch the hull.

    Raises
    ------
    ValueError
        If the arrays do not describe a triangle mesh, all vertices lie in one plane, or an option has no meaning.

    Notes
    -----
    The straight distance is exact. From inside a convex body, the nearest point of its boundary is the foot on the
    nearest of its planes, so depth is the least distance to any plane. The line may run through tissue, and large
    hollows of the brain (temporal pole, medial wall) also count as deep. This depth is not FreeSurfer's ``sulc``, which
    is a signed displacement during inflation with zero mean, and it is not a distance along the surface.

    The geodesic distance uses paths along edges and straight across pairs of triangles, which are about 4 % too long.
    """
    check_mesh(verts, faces)
    if mode not in ("hull", "geodesic"):
        raise UnknownName(f"mode must be 'hull' or 'geodesic', got {mode!r}.")
    if touching is not None and not (mode == "geodesic" and touching >= 0):
        raise (OutOfRange if mode == "geodesic" else OptionsClash)(
            f"touching is for mode 'geodesic' only, a distance in mm; got {touching!r} with mode {mode!r}."
        )
    planes = hull(verts, faces).equations  # n . x + d <= 0 inside; coplanar triangles repeat theirs
    _, first = np.unique(np.round(planes, 12), axis=0, return_index=True)
    depth = np.full(len(verts), np.nan)
    used = np.unique(faces)
    size, points, bundled = _bundle_planes(np.asarray(verts[used], dtype=np.float64), planes[first])
    depth[used] = size * _distance_to_planes(points, bundled)
    return depth if mode == "hull" else _geodesic_depth(verts, faces, depth, touching)


def _geodesic_depth(verts: Verts, faces: Faces, depth: PerVertex, touching: float | None) -> PerVertex:
    bound = mean_edge_length(verts, faces) if touching is None else touching
    way = np.full(len(verts), np.inf)
    shorten(path_graph(verts, faces), way, np.flatnonzero(depth <= bound), np.isfinite(depth))
    return np.where(np.isfinite(way), way, np.nan)


def _bundle_planes(
    points: NDArray[np.float64], planes: NDArray[np.float64]
) -> tuple[float, NDArray[np.float64], _BundledPlanes]:
    """Size of the body [mm]; in that unit, the points (N, 3) relative to their middle, and the planes (P, 4)."""
    middle = points.mean(axis=0)
    points = points - middle
    size = float(np.linalg.norm(points, axis=1).max())
    planes = np.column_stack([planes[:, :3], (planes[:, 3] + planes[:, :3] @ middle) / size])
    planes = planes[cKDTree(planes, leafsize=PLANES_PER_BUNDLE).indices]  # similar planes next to each other
    planes = np.concatenate([planes, np.repeat(planes[-1:], -len(planes) % PLANES_PER_BUNDLE**2, axis=0)])
    bundled = []
    for many in (PLANES_PER_BUNDLE, PLANES_PER_BUNDLE**2):
        members = planes.reshape(-1, many, 4)
        centre = members.mean(axis=1)
        bundled += [centre, np.linalg.norm(members - centre[:, None], axis=2).max(axis=1)]
    return size, points / size, _BundledPlanes(planes, *bundled)


class _BundledPlanes(NamedTuple):
    """Planes (P, 4), similar ones next to each other; for each 16 and each 256 of them the middle (., 4), and the
    distance (.,) of the farthest from it."""

    each: NDArray[np.float64]
    centre: NDArray[np.float64]
    spread: NDArray[np.float64]
    middle: NDArray[np.float64]
    reach: NDArray[np.float64]


@njit(cache=True, parallel=True)
def _distance_to_planes(points, planes):
    """Least distance (N,) from points inside to the planes, 0 where round-off puts a point outside."""
    n, depth = len(points), np.empty(len(points))
    for block in prange(BLOCKS):
        nearest = 0  # of the previous point, so a good first guess
        for i in range(block * n // BLOCKS, (block + 1) * n // BLOCKS):
            x, y, z = points[i]
            far = np.sqrt(x * x + y * y + z * z + 1.0)
            p = planes.each[nearest]
            highest = p[0] * x + p[1] * y + p[2] * z + p[3]
            for a in range(len(planes.middle)):
                c = planes.middle[a]
                if c[0] * x + c[1] * y + c[2] * z + c[3] + planes.reach[a] * far <= highest:
                    continue  # none of these can be nearer
                for b in range(a * PLANES_PER_BUNDLE, (a + 1) * PLANES_PER_BUNDLE):
                    c = planes.centre[b]
                    if c[0] * x + c[1] * y + c[2] * z + c[3] + planes.spread[b] * far <= highest:
                        continue
                    for k in range(b * PLANES_PER_BUNDLE, (b + 1) * PLANES_PER_BUNDLE):
                        p = planes.each[k]
                        here = p[0] * x + p[1] * y + p[2] * z + p[3]
                        if here > highest:
                            highest, nearest = here, k
            depth[i] = max(-highest, 0.0)
    return depth
