"""Geometry for kernels: points and vectors have three numbers; results are tuples of three; nothing is allocated.

Three functions find the nearest point of a triangle. Their results differ by rounding, by 1e-9 on needle triangles, so
each caller keeps its function.
"""

import numpy as np
from numba import njit

from morphofold.kernels import kernel


@njit(inline="always")
def position(points, i):
    """Point i of an array (P, 3)."""
    return points[i, 0], points[i, 1], points[i, 2]


@njit(inline="always")
def corners(verts, faces, f):
    """The three corners of face f."""
    return position(verts, faces[f, 0]), position(verts, faces[f, 1]), position(verts, faces[f, 2])


@kernel
def less(a, b):
    """a - b."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@kernel
def dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@kernel
def cross(a, b):
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@kernel
def area_vector(a, b, c):
    """Normal of the triangle abc, outward if it is counter-clockwise; its length is twice the area."""
    return cross(less(b, a), less(c, a))


@njit(inline="always")
def nearest_weights(p, a, b, c):
    """Barycentric weights of the point of triangle abc nearest to p (Ericson 2005, section 5.1.5); not for needles."""
    ab, ac, ap, bp, cp = less(b, a), less(c, a), less(p, a), less(p, b), less(p, c)
    d1, d2, d3, d4, d5, d6 = dot(ab, ap), dot(ac, ap), dot(ab, bp), dot(ac, bp), dot(ab, cp), dot(ac, cp)
    if d1 <= 0 and d2 <= 0:
        return 1.0, 0.0, 0.0
    if d3 >= 0 and d4 <= d3:
        return 0.0, 1.0, 0.0
    vc = d1 * d4 - d3 * d2
    if vc <= 0 and d1 >= 0 and d3 <= 0:
        t = d1 / (d1 - d3)
        return 1 - t, t, 0.0
    if d6 >= 0 and d5 <= d6:
        return 0.0, 0.0, 1.0
    vb = d5 * d2 - d1 * d6
    if vb <= 0 and d2 >= 0 and d6 <= 0:
        t = d2 / (d2 - d6)
        return 1 - t, 0.0, t
    va = d3 * d6 - d5 * d4
    if va <= 0 and d4 - d3 >= 0 and d5 - d6 >= 0:
        t = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        return 0.0, 1 - t, t
    total = va + vb + vc
    return va / total, vb / total, vc / total


@njit(inline="always")
def _clamp(x):
    return min(max(x, 0.0), 1.0)


@kernel
def closest_in_triangle(p, a, b, c):
    """Barycentric coordinates (of b, of c) of the point of triangle abc nearest to p, also for needle triangles."""
    u, v, w = less(b, a), less(c, a), less(p, a)
    uu, vv, uv, uw, vw = dot(u, u), dot(v, v), dot(u, v), dot(u, w), dot(v, w)
    det = uu * vv - uv * uv  # 4 x squared area
    if det > 1e-14 * uu * vv:
        s, t = (vv * uw - uv * vw) / det, (uu * vw - uv * uw) / det
        if s >= 0 and t >= 0 and s + t <= 1:
            return s, t
    # Outside (or a sliver): the nearest of the three edges' nearest points, compared without constants.
    s = _clamp(uw / uu) if uu > 0 else 0.0
    bs, bt, low = s, 0.0, s * s * uu - 2 * s * uw
    t = _clamp(vw / vv) if vv > 0 else 0.0
    value = t * t * vv - 2 * t * vw
    if value < low:
        bs, bt, low = 0.0, t, value
    ee = uu + vv - 2 * uv  # edge from b to c
    t = _clamp((vw - uw + uu - uv) / ee) if ee > 0 else 0.0
    value = (1 - t) ** 2 * uu + t * t * vv + 2 * t * (1 - t) * uv - 2 * (1 - t) * uw - 2 * t * vw
    if value < low:
        bs, bt = 1 - t, t
    return bs, bt


@kernel
def distance_from_triangle(p, a, b, c):
    """Distance of p from the triangle abc: from its plane if p lies over it (exactly 0 on it), else from a side."""
    n, over, nearest = area_vector(a, b, c), True, np.inf
    for x, y in ((a, b), (b, c), (c, a)):
        along, to = less(y, x), less(p, x)
        over &= dot(cross(along, to), n) >= 0.0
        t = min(max(dot(along, to) / max(dot(along, along), 1e-300), 0.0), 1.0)
        rest = to[0] - t * along[0], to[1] - t * along[1], to[2] - t * along[2]
        nearest = min(nearest, dot(rest, rest))
    square = dot(n, n)
    return abs(dot(less(p, a), n)) / square**0.5 if over and square > 0.0 else nearest**0.5


@kernel
def morton(unit, bits):
    """As ``morphofold.geometry.morton_codes``."""
    code, cells = np.zeros(len(unit), dtype=np.int64), 2**bits
    for k in range(len(unit)):
        for r in range(3):
            cell = min(int(unit[k, r] * cells), cells - 1)
            for bit in range(bits):
                code[k] |= ((cell >> bit) & 1) << (3 * bit + r)
    return code
