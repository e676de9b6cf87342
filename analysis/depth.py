"""Sulcal depth: from a folded surface to one distance per vertex."""

from __future__ import annotations

import numpy as np

from morphofold.analysis.gyrification import hull
from morphofold.surface import Faces, PerVertex, Verts, check_mesh

CHUNK = 4096        # vertices times planes are formed in pieces of this many vertices


def sulcal_depth(verts: Verts, faces: Faces) -> PerVertex:
    """Distance from each vertex straight to the convex hull of the surface.

    Parameters
    ----------
    verts : (N, 3) float64
        Vertex positions [mm], usually of the pial surface.
    faces : (M, 3) int64
        Triangles.

    Returns
    -------
    depth : (N,) float64
        [mm], >= 0, and 0 on the hull. NaN at a vertex that no face uses.

    Raises
    ------
    ValueError
        If the arrays do not describe a triangle mesh, or all vertices lie in one plane.

    Notes
    -----
    Exact: seen from inside a convex body the nearest point of its boundary is the foot on the nearest of its
    planes, so depth is the least distance to any of them. It runs through the tissue in its way, and also counts
    the large hollows of the brain (temporal pole, medial wall) as deep. It is neither FreeSurfer's ``sulc``, a signed
    displacement during inflation with zero mean, nor a distance along the surface.
    """
    check_mesh(verts, faces)
    planes = hull(verts, faces).equations            # n . x + d <= 0 inside; coplanar triangles repeat theirs
    _, first = np.unique(np.round(planes, 12), axis=0, return_index=True)
    normal, offset = planes[first, :3], planes[first, 3]
    depth = np.full(len(verts), np.nan)
    used = np.unique(faces)
    for start in range(0, len(used), CHUNK):
        some = used[start : start + CHUNK]
        depth[some] = -np.max(verts[some] @ normal.T + offset, axis=1)
    return np.maximum(depth, 0)                      # round-off on the hull itself
