"""Nodes of the core between a folded or hollow white surface and the hole, moved until all bricks are well shaped.

Straight columns from the white surface to the hole may cross where the body is hollow. Bricks are compared with their
target size: f = (|A|^2 / 3)^(3/2) / det A is 1 for a brick of the right proportions and grows without bound as a corner
turns over; sums of powers of f are made small by L-BFGS. While corners are turned over, det A is replaced by
(det A + sqrt(det A^2 + eps^2)) / 2 (Escobar and others 2003), with a smaller eps from search to search.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.optimize import minimize

from morphofold.arrays import Array, Ints
from morphofold.kernels import kernel
from morphofold.unfolding.harmonics import Expansion, fit

#: searches one after the other: power of f, eps, and iterations
SEARCHES = ((1, 0.5, 60), (1, 0.1, 60), (1, 0.02, 60), (2, 0.02, 60), (4, 0.02, 60))
DEGREE, PENALTY = 16, 1e-4  # of the expansion of the moves


class CoreMoves(NamedTuple):
    """How far the nodes of columns are moved, as a smooth function of direction and depth.

    ``fractions`` (K + 1,) are depths over that of the core; ``moves`` has an expansion [mm] for each.
    """

    fractions: Array
    moves: Sequence[Expansion]

    def __call__(self, directions: Array, fractions: Array) -> Array:
        """Moves (L, S, 3) [mm] at directions (S, 3) and depths (L,)."""
        known = np.stack([move(directions) for move in self.moves])
        known[0] = known[-1] = 0.0
        return np.asarray(PchipInterpolator(self.fractions, known, axis=0)(fractions))


def straight_columns(white: Array, base: Array, fractions: Array) -> Array:
    """Nodes (L, S, 3) on straight lines from ``white`` to ``base`` (S, 3)."""
    return white + fractions[:, None, None] * (base - white)


def core_moves(white: Array, base: Array, directions: Array, quads: Ints, fractions: Array) -> CoreMoves:
    """Moves of the inner nodes of a coarse mesh that shape its bricks well."""
    straight = straight_columns(white, base, fractions)
    sizes = np.linalg.norm(straight[:, quads] - straight[:, np.roll(quads, -1, axis=1)], axis=3).mean(axis=(1, 2))
    heights = np.diff(fractions)[:, None] * np.linalg.norm(white - base, axis=1)
    levels, inner = straight.copy(), slice(1, len(fractions) - 1)
    slope = np.zeros(levels.shape)

    def misshape(flat: Array, power: float, eps: float) -> tuple[float, Array]:
        levels[inner] = flat.reshape(levels[inner].shape)
        total = _sum_misshape(levels, quads, sizes, heights, power, eps, slope)
        return float(np.log(total)) / power, slope[inner].ravel() / (total * power)

    for power, eps, iterations in SEARCHES:
        options = {"maxiter": iterations, "maxcor": 10}
        args = (float(power), eps)
        levels[inner] = minimize(
            misshape, levels[inner].ravel(), args=args, jac=True, method="L-BFGS-B", options=options
        ).x.reshape(levels[inner].shape)
    equal = np.ones(len(directions))
    return CoreMoves(fractions, [fit(directions, moved, equal, DEGREE, PENALTY) for moved in levels - straight])


def scaled_jacobians(levels: Array, quads: Ints) -> Array:
    """Least scaled Jacobian (L - 1, Q) of the corners of bricks between ``levels`` (L, S, 3): 1 for right angles."""
    out = np.empty((len(levels) - 1, len(quads)))
    _scaled_jacobians(levels, quads, out)
    return out


@kernel
def _corner(levels, quads, k, q, c, top, u, v, w):
    """Edges u, v along the surface and w outwards at a corner of brick (k, q); returns its level and vertices."""
    level, other = k + 1 - top, k + top  # levels are numbered from outside in
    o, i, j = quads[q, c], quads[q, (c + 1) % 4], quads[q, (c + 3) % 4]
    side = -1.0 if top == 1 else 1.0
    for r in range(3):
        u[r] = levels[level, i, r] - levels[level, o, r]
        v[r] = levels[level, j, r] - levels[level, o, r]
        w[r] = side * (levels[other, o, r] - levels[level, o, r])
    return level, other, o, i, j, side


@kernel
def _determinant(u, v, w):
    return (u[1] * v[2] - u[2] * v[1]) * w[0] + (u[2] * v[0] - u[0] * v[2]) * w[1] + (u[0] * v[1] - u[1] * v[0]) * w[2]


@kernel
def _sum_misshape(levels, quads, sizes, heights, power, eps, slope):
    """Sum of f^power over all corners; writes its derivatives by ``levels`` to ``slope``."""
    total = 0.0
    slope[:] = 0.0
    u, v, w = np.empty(3), np.empty(3), np.empty(3)
    for k in range(len(levels) - 1):
        for q in range(len(quads)):
            for corner in range(8):
                level, other, o, i, j, side = _corner(levels, quads, k, q, corner % 4, corner // 4, u, v, w)
                size, height = sizes[level], heights[k, o]
                square = 0.0
                for r in range(3):
                    u[r] /= size
                    v[r] /= size
                    w[r] /= height
                    square += (u[r] * u[r] + v[r] * v[r] + w[r] * w[r]) / 3.0
                det = _determinant(u, v, w)
                root = (det * det + eps * eps) ** 0.5
                held = 0.5 * (det + root)
                f = (square**1.5 / held) ** power
                total += f
                by_square, by_det = power * f / square, -power * f / root
                for r in range(3):
                    r1, r2 = (r + 1) % 3, (r + 2) % 3
                    by_u = (by_square * u[r] + by_det * (v[r1] * w[r2] - v[r2] * w[r1])) / size
                    by_v = (by_square * v[r] + by_det * (w[r1] * u[r2] - w[r2] * u[r1])) / size
                    by_w = side * (by_square * w[r] + by_det * (u[r1] * v[r2] - u[r2] * v[r1])) / height
                    slope[level, i, r] += by_u
                    slope[level, j, r] += by_v
                    slope[level, o, r] -= by_u + by_v + by_w
                    slope[other, o, r] += by_w
    return total


@kernel
def _scaled_jacobians(levels, quads, out):
    u, v, w = np.empty(3), np.empty(3), np.empty(3)
    for k in range(len(levels) - 1):
        for q in range(len(quads)):
            out[k, q] = np.inf
            for corner in range(8):
                _corner(levels, quads, k, q, corner % 4, corner // 4, u, v, w)
                length = (u @ u * (v @ v) * (w @ w)) ** 0.5
                out[k, q] = min(out[k, q], _determinant(u, v, w) / length)
