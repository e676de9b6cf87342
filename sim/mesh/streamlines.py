"""Paths from nodes down through a mesh of tetrahedra along a direction field, to where a level falls to zero."""

import numpy as np
from numba import njit

from morphofold.geometry import cross, dot, less
from morphofold.kernels import kernel

MOST_TETS_PER_STEP = 200  # most tetrahedra that one step may cross
HALVINGS_OF_LAST_STEP = 30  # halvings of the last step: level has a kink at 0, so linear interpolation can't find it


@njit(inline="always")
def _six_times_volume(a, b, c, d):
    """Six times the signed volume of the tetrahedron a, b, c, d."""
    return dot(less(b, a), cross(less(c, a), less(d, a)))


@kernel
def _barycentric_weights(x, tet, p, w):
    """Write barycentric weights of ``p`` in a tetrahedron into ``w`` (4,)."""
    a, b, c, d = x[tet[0]], x[tet[1]], x[tet[2]], x[tet[3]]
    whole_volume = _six_times_volume(a, b, c, d)
    w[0] = _six_times_volume(p, b, c, d) / whole_volume
    w[1] = _six_times_volume(a, p, c, d) / whole_volume
    w[2] = _six_times_volume(a, b, p, d) / whole_volume
    w[3] = 1.0 - w[0] - w[1] - w[2]


@kernel
def _containing_tetrahedron(x, tets, across, p, start, w):
    """The tetrahedron that contains ``p``, found from ``start`` across faces; -1 if the path leaves the mesh."""
    e = start
    for _ in range(MOST_TETS_PER_STEP):
        _barycentric_weights(x, tets[e], p, w)
        exit_face, least_weight = -1, -1e-9
        for k in range(4):
            if w[k] < least_weight and across[e, k] >= 0:
                exit_face, least_weight = k, w[k]
        if exit_face < 0:
            is_inside = min(min(w[0], w[1]), min(w[2], w[3])) >= -1e-9
            return e if is_inside else -1
        e = across[e, exit_face]
    return -1


@kernel
def _interpolate_level(tets, level, e, w):
    """The level at weights ``w`` of tetrahedron ``e``."""
    level_sum = 0.0
    for k in range(4):
        level_sum += w[k] * level[tets[e, k]]
    return level_sum


@kernel
def _bisect_level_crossing(x, tets, across, level, e, p, q, w):
    """Bisect from ``p`` (level above 0) to ``q`` (below) for level 0; the point is written into ``q``."""
    point = np.empty(3)
    above_fraction, below_fraction, last_tet = 0.0, 1.0, e
    for _ in range(HALVINGS_OF_LAST_STEP):
        fraction = 0.5 * (above_fraction + below_fraction)
        for r in range(3):
            point[r] = p[r] + fraction * (q[r] - p[r])
        element = _containing_tetrahedron(x, tets, across, point, last_tet, w)
        if element >= 0 and _interpolate_level(tets, level, element, w) > 0.0:
            above_fraction, last_tet = fraction, element
        else:
            below_fraction = fraction
    for r in range(3):
        q[r] = p[r] + above_fraction * (q[r] - p[r])
    return _containing_tetrahedron(x, tets, across, q, last_tet, w)


@kernel
def descend(x, tets, across, start, radial, level, stride, steps, where, weights):
    """Follow minus ``radial`` from each node i to where ``level`` becomes 0, or is smallest inside the mesh.

    x (N, 3); tets, across (E, 4): corners, and the tetrahedron beyond the face opposite to each corner (-1: none);
    start (S,): a tetrahedron at each of the first S nodes; radial (N, 3) and level (N,) are linear in a tetrahedron.
    A step has the length ``stride``. where (S,) and weights (S, 4) get the last tetrahedron and the weights there.
    """
    w, p, q = np.empty(4), np.empty(3), np.empty(3)
    for i in range(len(start)):
        e, this_level = start[i], level[i]
        p[:] = x[i]
        _barycentric_weights(x, tets[e], p, w)
        where[i], weights[i] = e, w
        for _ in range(steps):
            if this_level <= 0.0:
                break
            q[:] = 0.0
            for k in range(4):
                for r in range(3):
                    q[r] += w[k] * radial[tets[e, k], r]
            length = np.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2])
            if length < 1e-6:
                break
            for r in range(3):
                q[r] = p[r] - stride * q[r] / length
            next_tet = _containing_tetrahedron(x, tets, across, q, e, w)
            if next_tet < 0:
                break
            next_level = _interpolate_level(tets, level, next_tet, w)
            if next_level >= this_level:
                break
            if next_level < 0.0:
                next_tet, next_level = _bisect_level_crossing(x, tets, across, level, e, p, q, w), 0.0
            e, this_level = next_tet, next_level
            p[:] = q
            where[i], weights[i] = e, w
