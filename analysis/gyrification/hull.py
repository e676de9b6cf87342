"""Gyrification index: from a folded surface to one ratio of areas."""

from __future__ import annotations

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from morphofold.errors import BadMesh
from morphofold.geometry import face_areas
from morphofold.surface import Faces, Verts, check_mesh


def gyrification_index(verts: Verts, faces: Faces) -> float:
    """Area of the surface over the area of its convex hull.

    Parameters
    ----------
    verts : (N, 3) float64
        Vertex positions [mm], usually of the pial surface.
    faces : (M, 3) int64
        Triangles.

    Returns
    -------
    float
        1 for a convex surface, larger when folded: 1.65 for the left pial surface of fsaverage5, an average, and
        2.66 for that of the sample S1, one person.

    Raises
    ------
    ValueError
        If the arrays do not describe a triangle mesh, or all vertices lie in one plane.

    Notes
    -----
    The three-dimensional index with the convex hull as outer surface. It is not the ratio of contours in coronal
    slices (Zilles 1988), nor the one whose outer surface is a closing of radius 15 mm (Schaer 2008) and follows the
    brain into its large hollows. An open surface is compared with the hull of a
    closed one, so cut-off parts lower it.
    """
    check_mesh(verts, faces)
    return float(face_areas(verts, faces).sum() / hull(verts, faces).area)


def hull(verts: Verts, faces: Faces) -> ConvexHull:
    """Convex hull of the vertices that faces use, as scipy gives it."""
    try:
        return ConvexHull(verts[np.unique(faces)])
    except QhullError as error:
        raise BadMesh(
            f"the {len(np.unique(faces))} vertices in use span no volume (they lie in one plane, or nearly), so they "
            "have no convex hull. Is this a flat patch?"
        ) from error
