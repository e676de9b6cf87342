"""A ball folded like half a brain, with a given number of vertices: the body for timing."""

import numpy as np

from morphofold.errors import OutOfRange
from morphofold.geometry import vertex_normals
from morphofold.shapes import even_directions
from morphofold.shapes.spherical_nets import SphericalNet, irregular_net
from morphofold.studies.irregular_spheres import spherical_delaunay
from morphofold.studies.ridged_nets import ridged_net
from morphofold.surface import Cortex, Surface

RIDGE_NET_CELLS = 60  # of the net: 116 hinges, about as many as half a brain has
RIDGE_WIDTH_MM, RIDGE_HEIGHT_MM, SPHERE_RADIUS_MM, CORTICAL_THICKNESS_MM = 9.0, 8.0, 65.0, 1.8


def folded_ball(n_vertices: int, net: SphericalNet | None = None) -> Cortex:
    """Cortex of ``n_vertices``, evenly spread before folding: ridges 9 mm wide and 8 mm high on a sphere of 65 mm,
    along a net, by default an irregular one of 60 cells. White lies 1.8 mm deeper along the normals. Vertices are
    numbered in slices of 1 mm, as in surfaces from a voxel image.

    Raises
    ------
    OutOfRange
        If there are fewer than 1,000 vertices.
    """
    if n_vertices < 1000:
        raise OutOfRange(f"the folded ball needs at least 1,000 vertices, got {n_vertices:,}.")
    verts = even_directions(n_vertices)
    verts = verts[np.lexsort((verts[:, 2], *np.round(SPHERE_RADIUS_MM * verts[:, :2].T)))]
    faces = spherical_delaunay(verts)
    pial = ridged_net(
        net or irregular_net(RIDGE_NET_CELLS),
        (verts, faces),
        RIDGE_WIDTH_MM,
        height=RIDGE_HEIGHT_MM,
        radius=SPHERE_RADIUS_MM,
    )
    white = Surface(pial.verts - CORTICAL_THICKNESS_MM * vertex_normals(pial.verts, faces), faces)
    return Cortex(white, pial, name=f"folded ball of {n_vertices:,}")
