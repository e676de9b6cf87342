"""Hits of a ray on a surface: no hit is lost or doubled at an edge or a vertex."""

from morphofold.geometry.kernels import corners, cross, dot, less
from morphofold.intersections.boxes import TRIANGLES_PER_LEAF, following, meets_ray
from morphofold.intersections.signs import TIE_BREAKING_DIRECTION, plane_sign
from morphofold.kernels import kernel


@kernel
def ray_hits(verts, faces, bounds, order, origin, direction, at, sign):
    """Where and in which direction a ray crosses a surface: exact, also through edges and vertices.

    If it meets an edge or a vertex, the ray counts as turned towards TIE_BREAKING_DIRECTION by an infinitely small
    angle: it crosses the faces that a ray beside it would cross. A face that holds the origin is not crossed.

    Parameters
    ----------
    verts, faces, bounds, order
        The surface and its tree of boxes.
    origin, direction : tuple of three float
        Unit direction.
    at, sign : (S,) float64
        Output: distance [mm] and sign of each hit, 1 outwards and -1 inwards, unsorted, as many as fit.

    Returns
    -------
    hits, winding : int
        How many hits there are, and the sum of their signs: the winding number at the origin of a closed surface.
    """
    n, winding = 0, 0
    k, leaves = 1, len(bounds) // 2
    while k > 0:
        if meets_ray(bounds[k], origin, direction):
            if k < leaves:
                k *= 2
                continue
            for s in range(TRIANGLES_PER_LEAF * (k - leaves), min(TRIANGLES_PER_LEAF * (k - leaves + 1), len(order))):
                f = order[s]
                a, b, c = corners(verts, faces, f)
                hit = _ray_sign(a, b, c, origin, direction)
                if hit != 0:
                    if n < len(at):
                        at[n], sign[n] = _ray_distance(a, b, c, origin, direction), hit
                    n += 1
                    winding += hit
        k = following(k)
    return n, winding


@kernel
def ray_winding(verts, faces, origin, direction):
    """The winding as from ``ray_hits``, for few faces: each face is tested, so no tree is needed."""
    winding = 0
    for f in range(len(faces)):
        a, b, c = corners(verts, faces, f)
        winding += _ray_sign(a, b, c, origin, direction)
    return winding


@kernel
def _ray_sign(a, b, c, origin, direction):
    """1 if the ray leaves through the front of the triangle abc, -1 if it enters, 0 if it misses."""
    turn = _edge_sign(a, b, origin, direction)
    if turn == 0 or _edge_sign(b, c, origin, direction) != turn or _edge_sign(c, a, origin, direction) != turn:
        return 0
    return turn if plane_sign(a, b, c, origin, 1.0) == -turn else 0


@kernel
def _edge_sign(a, b, origin, direction):
    """The side of the line along a ray on which the edge ab passes."""
    sign = plane_sign(a, b, origin, direction, 0.0)
    return sign if sign != 0 else plane_sign(a, b, origin, TIE_BREAKING_DIRECTION, 0.0)


@kernel
def _ray_distance(a, b, c, origin, direction):
    """Distance along the ray to the point where it meets a triangle; the point is always in the triangle."""
    u, v, w = less(a, origin), less(b, origin), less(c, origin)
    at, bt, ct = dot(u, direction), dot(v, direction), dot(w, direction)
    weight_a, weight_b = abs(dot(cross(v, w), direction)), abs(dot(cross(w, u), direction))
    weight_c = abs(dot(cross(u, v), direction))
    total = weight_a + weight_b + weight_c
    if total == 0.0:  # the ray runs in the triangle's plane
        return (at + bt + ct) / 3
    return (weight_a * at + weight_b * bt + weight_c * ct) / total
