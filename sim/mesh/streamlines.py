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
def _barycentric_weights(x, tet, point, weights):
    """Write barycentric ``weights`` (4,) of ``point`` in a tetrahedron."""
    a, b, c, d = x[tet[0]], x[tet[1]], x[tet[2]], x[tet[3]]
    whole_volume = _six_times_volume(a, b, c, d)
    weights[0] = _six_times_volume(point, b, c, d) / whole_volume
    weights[1] = _six_times_volume(a, point, c, d) / whole_volume
    weights[2] = _six_times_volume(a, b, point, d) / whole_volume
    weights[3] = 1.0 - weights[0] - weights[1] - weights[2]


@kernel
def _containing_tetrahedron(x, tets, neighbours, point, start_tet, weights):
    """The tetrahedron that contains ``point``, found from ``start_tet`` across faces; -1 if the path ends outside."""
    tet = start_tet
    for _ in range(MOST_TETS_PER_STEP):
        _barycentric_weights(x, tets[tet], point, weights)
        exit_face, least_weight = -1, -1e-9
        for face in range(4):
            if weights[face] < least_weight and neighbours[tet, face] >= 0:
                exit_face, least_weight = face, weights[face]
        if exit_face < 0:
            is_inside = min(min(weights[0], weights[1]), min(weights[2], weights[3])) >= -1e-9
            return tet if is_inside else -1
        tet = neighbours[tet, exit_face]
    return -1


@kernel
def _interpolate_level(tets, level, tet, weights):
    """The level at ``weights`` in ``tet``."""
    level_sum = 0.0
    for corner in range(4):
        level_sum += weights[corner] * level[tets[tet, corner]]
    return level_sum


@kernel
def _bisect_level(x, tets, neighbours, level, first_tet, above, below, weights):
    """Bisect from the point ``above`` level 0 to that ``below`` for level 0; it is written into ``below``."""
    point = np.empty(3)
    above_fraction, below_fraction, last_tet = 0.0, 1.0, first_tet
    for _ in range(HALVINGS_OF_LAST_STEP):
        fraction = 0.5 * (above_fraction + below_fraction)
        for axis in range(3):
            point[axis] = above[axis] + fraction * (below[axis] - above[axis])
        tet = _containing_tetrahedron(x, tets, neighbours, point, last_tet, weights)
        if tet >= 0 and _interpolate_level(tets, level, tet, weights) > 0.0:
            above_fraction, last_tet = fraction, tet
        else:
            below_fraction = fraction
    for axis in range(3):
        below[axis] = above[axis] + above_fraction * (below[axis] - above[axis])
    return _containing_tetrahedron(x, tets, neighbours, below, last_tet, weights)


@kernel
def descend(x, tets, neighbours, start_tets, radial, level, stride, n_steps, end_tets, end_weights):
    """Follow minus ``radial`` from each node i to where ``level`` becomes 0, or is smallest inside the mesh.

    x (N, 3); tets, neighbours (E, 4): corners, and the tetrahedron beyond the face opposite to each corner (-1: none);
    start_tets (S,): one at each of the first S nodes; radial (N, 3) and level (N,) are linear in a tetrahedron. A step
    has the length ``stride``. end_tets (S,) and end_weights (S, 4) get the last tetrahedron and the weights there.
    """
    weights, point, target = np.empty(4), np.empty(3), np.empty(3)
    for node in range(len(start_tets)):
        tet, this_level = start_tets[node], level[node]
        point[:] = x[node]
        _barycentric_weights(x, tets[tet], point, weights)
        end_tets[node], end_weights[node] = tet, weights
        for _ in range(n_steps):
            if this_level <= 0.0:
                break
            target[:] = 0.0
            for corner in range(4):
                for axis in range(3):
                    target[axis] += weights[corner] * radial[tets[tet, corner], axis]
            length = np.sqrt(target[0] * target[0] + target[1] * target[1] + target[2] * target[2])
            if length < 1e-6:
                break
            for axis in range(3):
                target[axis] = point[axis] - stride * target[axis] / length
            next_tet = _containing_tetrahedron(x, tets, neighbours, target, tet, weights)
            if next_tet < 0:
                break
            next_level = _interpolate_level(tets, level, next_tet, weights)
            if next_level >= this_level:
                break
            if next_level < 0.0:
                next_tet, next_level = _bisect_level(x, tets, neighbours, level, tet, point, target, weights), 0.0
            tet, this_level = next_tet, next_level
            point[:] = target
            end_tets[node], end_weights[node] = tet, weights
