"""Gyrification index of a folded surface, a ratio of areas."""

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from morphofold.arrays import memoized
from morphofold.errors import BadMesh
from morphofold.geometry import face_areas, used
from morphofold.surface import Faces, Verts
from morphofold.validators import check_mesh


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
