"""Exact signs: on which side of a plane a point lies, independent of rounding.

A determinant in floating point decides nearly always. If its error bound does not allow that, the products are
summed without error as an expansion of doubles (Shewchuk 1997, Figs. 1 and 7 and Theorems 6, 10 and 18). A true
zero is decided as if the vertices were displaced by tiny lengths along the direction ``TIE_BREAKING_DIRECTION``: a
vertex of lower index always by infinitely more than the next (after Edelsbrunner and Muecke 1990). So an edge that runs
exactly through another edge, or through a vertex, crosses exactly one of the triangles there.

Signs are exact if products of three coordinates do not overflow and do not lose digits by underflow: for zeros and
lengths between 1e-70 and 1e90.

References
----------
J. R. Shewchuk, Adaptive precision floating-point arithmetic and fast robust geometric predicates. Discrete Comput.
Geom. 18, 305 (1997). H. Edelsbrunner, E. P. Muecke, Simulation of simplicity. ACM Trans. Graphics 9, 66 (1990).
"""

import numpy as np

from morphofold.geometry import position
from morphofold.kernels import kernel

#: direction of the displacements that decide ties: no plane of a mesh contains it, except by chance
TIE_BREAKING_DIRECTION = (0.5319718735123841, 0.3247217563401897, 0.7818417265489173)

_UNIT_ROUNDOFF = 2.0**-53
# error of the determinant over its permanent: Shewchuk 1997, Fig. 21
_DETERMINANT_ERROR_BOUND = (7 + 56 * _UNIT_ROUNDOFF) * _UNIT_ROUNDOFF
_SPLITTING_FACTOR = 2.0**27 + 1
_CYCLIC_ORDERS = ((0, 1, 2), (1, 2, 0), (2, 0, 1))


@kernel
def plane_sign(a, b, c, d, weight):
    """Exact sign, 1, -1 or 0, of (d - weight a) . ((b - a) x (c - a)).

    All four are tuples of three. With weight 1, d is a point: 1 means in front of the plane of abc, where abc appears
    counter-clockwise. With weight 0, d is a direction. The sign is minus that of the determinant of the rows (a, 1),
    (b, 1), (c, 1), (d, weight).
    """
    sign = clear_sign(a, b, c, d, weight)
    return sign if sign != 0 else _exact_sign(a, b, c, d, weight)


@kernel
def clear_sign(a, b, c, d, weight):
    """The sign of :func:`plane_sign` if that is beyond the rounding of the determinant, else 0."""
    a0, a1, a2 = a[0] - c[0], a[1] - c[1], a[2] - c[2]
    b0, b1, b2 = b[0] - c[0], b[1] - c[1], b[2] - c[2]
    d0, d1, d2 = d[0] - weight * c[0], d[1] - weight * c[1], d[2] - weight * c[2]
    x0, y0, x1, y1, x2, y2 = a1 * b2, a2 * b1, a2 * b0, a0 * b2, a0 * b1, a1 * b0
    det = d0 * (x0 - y0) + d1 * (x1 - y1) + d2 * (x2 - y2)
    permanent = abs(d0) * (abs(x0) + abs(y0)) + abs(d1) * (abs(x1) + abs(y1)) + abs(d2) * (abs(x2) + abs(y2))
    if det > _DETERMINANT_ERROR_BOUND * permanent:
        return 1
    if -det > _DETERMINANT_ERROR_BOUND * permanent:
        return -1
    return 0


@kernel
def side(verts, i, j, k, p):
    """Sign of vertex p against the triangle ijk: 1 in front, -1 behind; 0 only if all four lie on one line."""
    sign = plane_sign(position(verts, i), position(verts, j), position(verts, k), position(verts, p), 1.0)
    return sign if sign != 0 else _displaced_sign(verts, i, j, k, p)


@kernel
def _displaced_sign(verts, i, j, k, p):
    """Sign of a determinant that is zero, once the vertex of lowest index that can change it is displaced.

    A displaced row contributes the determinant with TIE_BREAKING_DIRECTION, of weight 0, in its place. Two such rows
    are equal and contribute nothing, so nothing else is neglected.
    """
    vertices = (i, j, k, p)
    new_sign, lowest = 0, max(i, j, k, p) + 1
    for row in range(4):
        x, y, z = vertices[0 if row > 0 else 1], vertices[1 if row > 1 else 2], vertices[2 if row > 2 else 3]
        if vertices[row] < lowest:
            sign = plane_sign(position(verts, x), position(verts, y), position(verts, z), TIE_BREAKING_DIRECTION, 0.0)
            if sign != 0:
                new_sign, lowest = (sign if row % 2 == 1 else -sign), vertices[row]  # row r was moved after the others
    return new_sign


@kernel
def _exact_sign(a, b, c, d, weight):
    """The 24 products of three coordinates (18 if weight is 0), summed without error."""
    rows = np.empty((4, 3))
    for axis in range(3):
        rows[0, axis], rows[1, axis], rows[2, axis], rows[3, axis] = a[axis], b[axis], c[axis], d[axis]
    expansion, n = np.empty(96), 0
    for row in range(4):
        if row == 3 and weight == 0.0:  # its minor is that of a, b, c, times weight
            break
        x, y, z = rows[0 if row > 0 else 1], rows[1 if row > 1 else 2], rows[2 if row > 2 else 3]
        sign = -1.0 if row % 2 == 1 else 1.0
        for axis, axis1, axis2 in _CYCLIC_ORDERS:
            n = _add_product(expansion, n, sign * x[axis], y[axis1], z[axis2])
            n = _add_product(expansion, n, -sign * x[axis], y[axis2], z[axis1])
    return 0 if n == 0 else (1 if expansion[n - 1] > 0 else -1)  # the last component is larger than all others together


@kernel
def _add_product(expansion, n_terms, x, y, z):
    """Add x y z to ``expansion[:n]``; returns its new length."""
    high, low = _two_product(x, y)
    for factor in (low, high):
        large, small = _two_product(factor, z)
        n_terms = _add_to_expansion(expansion, n_terms, small)
        n_terms = _add_to_expansion(expansion, n_terms, large)
    return n_terms


@kernel
def _add_to_expansion(expansion, n_terms, term):
    """Grow-expansion without zeros: add x to components of rising magnitude that don't overlap."""
    n_kept = 0
    for k in range(n_terms):
        total = term + expansion[k]
        virtual = total - term
        rounding_error = (term - (total - virtual)) + (expansion[k] - virtual)
        if rounding_error != 0.0:
            expansion[n_kept] = rounding_error
            n_kept += 1
        term = total
    if term != 0.0:
        expansion[n_kept] = term
        n_kept += 1
    return n_kept


@kernel
def _two_product(x, y):
    """x y as a rounded product and its error."""
    product = x * y
    split = _SPLITTING_FACTOR * x
    x_high = split - (split - x)
    x_low = x - x_high
    split = _SPLITTING_FACTOR * y
    y_high = split - (split - y)
    y_low = y - y_high
    return product, x_low * y_low - (((product - x_high * y_high) - x_low * y_high) - x_high * y_low)
