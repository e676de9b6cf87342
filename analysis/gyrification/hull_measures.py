"""Gyrification index and sulcal depth: a folded surface and its convex hull."""

import numpy as np
from scipy.spatial import ConvexHull, QhullError, cKDTree

from morphofold import geometry
from morphofold.analysis.shortest_paths import path_graph, shorten
from morphofold.errors import BadMesh, OptionsClash, OutOfRange
from morphofold.frozen_arrays import Array, memoized
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
    _, first_rows = np.unique(np.round(planes, 12), axis=0, return_index=True)
    depth = np.full(len(verts), np.nan)
    used_vertices = np.flatnonzero(geometry.used(len(verts), faces))
    body_size, points, bundles = _bundle_planes(np.asarray(verts[used_vertices], dtype=np.float64), planes[first_rows])
    scaled_depth = np.empty(len(used_vertices))
    in_blocks(_distance_to_planes, len(used_vertices), *reading(points, *bundles), scaled_depth)
    depth[used_vertices] = body_size * scaled_depth
    return depth if mode == "hull" else _geodesic_depth(verts, faces, depth, touching)


def _geodesic_depth(verts: Verts, faces: Faces, depth: PerVertex, touching: float | None) -> PerVertex:
    touching_depth = mean_edge_length(verts, faces) if touching is None else touching
    distance = np.full(len(verts), np.inf)
    shorten(path_graph(verts, faces), distance, np.flatnonzero(depth <= touching_depth), np.isfinite(depth))
    return np.where(np.isfinite(distance), distance, np.nan)


def _bundle_planes(points: Array, planes: Array) -> tuple[float, Array, list[Array]]:
    """Size of the body [mm]; in that unit, the points (N, 3) relative to their middle, and planes.

    The planes (P, 4), similar ones next to each other; for each 16 and each 256 of them the middle (., 4), and the
    distance (.,) of the farthest from it.
    """
    points_centre = points.mean(axis=0)
    points = points - points_centre
    body_size = float(np.linalg.norm(points, axis=1).max())
    planes = np.column_stack([planes[:, :3], (planes[:, 3] + planes[:, :3] @ points_centre) / body_size])
    planes = planes[cKDTree(planes, leafsize=PLANES_PER_BUNDLE).indices]  # similar planes next to each other
    planes = np.concatenate([planes, np.repeat(planes[-1:], -len(planes) % PLANES_PER_BUNDLE**2, axis=0)])
    bundles = [planes]
    for bundle_size in (PLANES_PER_BUNDLE, PLANES_PER_BUNDLE**2):
        bundle_planes = planes.reshape(-1, bundle_size, 4)
        bundle_centre = bundle_planes.mean(axis=1)
        bundles += [bundle_centre, np.linalg.norm(bundle_planes - bundle_centre[:, None], axis=2).max(axis=1)]
    return body_size, points / body_size, bundles


@kernel
def _height_over(planes, plane, point):
    """Height of a point over a plane, by number."""
    return dot(position(planes, plane), point) + planes[plane, 3]


@kernel
def _distance_to_planes(start, stop, points, planes, fine_centre, fine_radius, coarse_centre, coarse_radius, depth):
    """Write the least distance (N,) from points inside to the planes, 0 where round-off puts a point outside."""
    nearest_plane = 0  # of the previous point, so a good first guess
    for i in range(start, stop):
        point = position(points, i)
        point_norm = np.sqrt(dot(point, point) + 1.0)
        largest_height = _height_over(planes, nearest_plane, point)
        for coarse in range(len(coarse_centre)):
            if _height_over(coarse_centre, coarse, point) + coarse_radius[coarse] * point_norm <= largest_height:
                continue  # none of these can be nearer
            for fine in range(coarse * PLANES_PER_BUNDLE, (coarse + 1) * PLANES_PER_BUNDLE):
                if _height_over(fine_centre, fine, point) + fine_radius[fine] * point_norm <= largest_height:
                    continue
                for plane in range(fine * PLANES_PER_BUNDLE, (fine + 1) * PLANES_PER_BUNDLE):
                    height = _height_over(planes, plane, point)
                    if height > largest_height:
                        largest_height, nearest_plane = height, plane
        depth[i] = max(-largest_height, 0.0)
