"""Gyrification index and sulcal depth: a folded surface and its convex hull."""

import numpy as np
from scipy.spatial import ConvexHull, QhullError, cKDTree

from morphofold import geometry
from morphofold.analysis.geodesics import path_graph, shorten
from morphofold.arrays import Array, memoized
from morphofold.errors import BadMesh, OptionsClash, OutOfRange
from morphofold.geometry import dot, face_areas, mean_edge_length, position, used
from morphofold.kernels import kernel, reading
from morphofold.surface import Faces, PerVertex, Verts
from morphofold.threads import in_blocks
from morphofold.validators import check_mesh, one_of


def gyrification_index(verts: Verts, faces: Faces) -> float:
    """Area of the surface divided by the area of its convex hull.

    Parameters
    ----------
    verts : (N, 3) float64
        Vertex positions [mm], usually of the pial surface.
    faces : (M, 3) int64
        Triangles.

    Returns
    -------
    float
        1 for a convex surface, larger when folded: 1.65 for the left pial surface of fsaverage5, an average brain, and
        2.66 for that of the sample S1, one person.

    Raises
    ------
    ValueError
        If the arrays do not describe a triangle mesh, or all vertices lie in one plane.

    Notes
    -----
    This is the three-dimensional index with the convex hull as outer surface. It is not the ratio of contours in
    coronal slices (Zilles 1988). It is also not the index whose outer surface is a closing of radius 15 mm, which
    follows the brain into its large hollows (Schaer 2008). An open surface is compared with a closed hull, so missing
    parts lower the index.
    """
    check_mesh(verts, faces)
    return float(face_areas(verts, faces).sum() / hull(verts, faces).area)


@memoized
def hull(verts: Verts, faces: Faces) -> ConvexHull:
    """Convex hull of the vertices that faces use, from scipy."""
    try:
        return ConvexHull(verts[used(len(verts), faces)])
    except QhullError as error:
        raise BadMesh(
            f"the {len(np.unique(faces))} vertices in use span no volume, because they lie (nearly) in one plane, so "
            "they have no convex hull. Is this a flat patch?"
        ) from error


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
    one_of(mode, ("hull", "geodesic"), "mode")
    if touching is not None and not (mode == "geodesic" and touching >= 0):
        raise (OutOfRange if mode == "geodesic" else OptionsClash)(
            f"touching is for mode 'geodesic' only, a distance in mm; got {touching!r} with mode {mode!r}."
        )
    planes = hull(verts, faces).equations  # n . x + d <= 0 inside; coplanar triangles repeat theirs
    _, first = np.unique(np.round(planes, 12), axis=0, return_index=True)
    depth = np.full(len(verts), np.nan)
    used = np.flatnonzero(geometry.used(len(verts), faces))
    size, points, bundled = _bundle_planes(np.asarray(verts[used], dtype=np.float64), planes[first])
    inside = np.empty(len(used))
    in_blocks(_distance_to_planes, len(used), *reading(points, *bundled), inside)
    depth[used] = size * inside
    return depth if mode == "hull" else _geodesic_depth(verts, faces, depth, touching)


def _geodesic_depth(verts: Verts, faces: Faces, depth: PerVertex, touching: float | None) -> PerVertex:
    bound = mean_edge_length(verts, faces) if touching is None else touching
    distance = np.full(len(verts), np.inf)
    shorten(path_graph(verts, faces), distance, np.flatnonzero(depth <= bound), np.isfinite(depth))
    return np.where(np.isfinite(distance), distance, np.nan)


def _bundle_planes(points: Array, planes: Array) -> tuple[float, Array, list[Array]]:
    """Size of the body [mm]; in that unit, the points (N, 3) relative to their middle, and planes.

    The planes (P, 4), similar ones next to each other; for each 16 and each 256 of them the middle (., 4), and the
    distance (.,) of the farthest from it.
    """
    middle = points.mean(axis=0)
    points = points - middle
    size = float(np.linalg.norm(points, axis=1).max())
    planes = np.column_stack([planes[:, :3], (planes[:, 3] + planes[:, :3] @ middle) / size])
    planes = planes[cKDTree(planes, leafsize=PLANES_PER_BUNDLE).indices]  # similar planes next to each other
    planes = np.concatenate([planes, np.repeat(planes[-1:], -len(planes) % PLANES_PER_BUNDLE**2, axis=0)])
    bundled = [planes]
    for many in (PLANES_PER_BUNDLE, PLANES_PER_BUNDLE**2):
        members = planes.reshape(-1, many, 4)
        centre = members.mean(axis=1)
        bundled += [centre, np.linalg.norm(members - centre[:, None], axis=2).max(axis=1)]
    return size, points / size, bundled


@kernel
def _height_over(planes, k, p):
    """Height of a point over plane k."""
    return dot(position(planes, k), p) + planes[k, 3]


@kernel
def _distance_to_planes(start, stop, points, each, centre, spread, middle, reach, depth):
    """Write the least distance (N,) from points inside to the planes, 0 where round-off puts a point outside."""
    nearest = 0  # of the previous point, so a good first guess
    for i in range(start, stop):
        p = position(points, i)
        far = np.sqrt(dot(p, p) + 1.0)
        highest = _height_over(each, nearest, p)
        for a in range(len(middle)):
            if _height_over(middle, a, p) + reach[a] * far <= highest:
                continue  # none of these can be nearer
            for b in range(a * PLANES_PER_BUNDLE, (a + 1) * PLANES_PER_BUNDLE):
                if _height_over(centre, b, p) + spread[b] * far <= highest:
                    continue
                for k in range(b * PLANES_PER_BUNDLE, (b + 1) * PLANES_PER_BUNDLE):
                    height = _height_over(each, k, p)
                    if height > highest:
                        highest, nearest = height, k
        depth[i] = max(-highest, 0.0)
