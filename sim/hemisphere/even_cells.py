"""Cells of about equal size on a smooth surface: how the directions of a cubed sphere are to be shifted.

A smooth surface stretches its sphere unevenly, so straight directions give large and small cells. The shift is a small
expansion, found once on a coarse lattice, that makes no edge long or short and no corner sharp. It is the same on every
lattice, so meshes can be refined.
"""

import numpy as np
from scipy.optimize import minimize

from morphofold.arrays import Array, Ints
from morphofold.geometry import unit
from morphofold.kernels import kernel
from morphofold.sim.mesh.brick_mesh import cube_directions
from morphofold.unfolding.harmonics import Expansion, harmonics
from morphofold.unfolding.smooth_surface import SmoothSurface, tangents
from morphofold.unfolding.unfold import surface_radius

CELLS, DEGREE = 24, 12  # cells along an edge of the cube, and degree of the shift
#: edges over the root of the mean cell area, and the sine of corners, that the search aims at
LONGEST_EDGE, SHORTEST_EDGE, SHARPEST_CORNER = 1.35, 0.60, 0.75
POWERS = (2, 4, 8, 16)  # of what exceeds these aims, one search after the other
ITERATIONS = 100
ROUNDING = 0.05  # sine below which a corner counts as sharp but not yet turned over


def shifted(directions: Array, shift: Expansion) -> Array:
    """Directions (P, 3) of the unit sphere, shifted."""
    return unit(directions + shift(directions))


def even_cells(surface: SmoothSurface, thickness: float) -> Expansion:
    """The shift of directions that makes the cells of a surface even, and those of the one ``thickness`` [mm] below."""
    directions, quads = cube_directions(CELLS)
    search = _Search(surface, thickness, directions, quads)
    shift = np.zeros(3 * (DEGREE + 1) ** 2)
    for power in POWERS:
        options = {"maxiter": ITERATIONS, "maxcor": 20}
        shift = minimize(search.excess, shift, args=(power,), jac=True, method="L-BFGS-B", options=options).x
    return Expansion(shift.reshape(-1, 3))


class _Search:
    """What the search makes small: the power mean of edges and corners over what is aimed at, and its gradient."""

    def __init__(self, surface: SmoothSurface, thickness: float, directions: Array, quads: Ints):
        self._surface, self._directions, self._quads = surface, directions, quads
        self._harmonics = harmonics(directions, DEGREE)
        self._cell = float(np.sqrt(4 * np.pi / len(quads))) * surface_radius(surface)
        self._depth = thickness / self._cell

    def excess(self, shift: Array, power: int) -> tuple[float, Array]:
        """Logarithm of the power mean, and its derivatives by the coefficients of the shift."""
        moved = self._directions + self._harmonics @ shift.reshape(-1, 3)
        length = np.linalg.norm(moved, axis=1, keepdims=True)
        s = moved / length
        frame = self._surface.frame(s)
        outer = frame.position / self._cell
        inner = outer - self._depth * frame.normal
        by_outer, by_inner, by_normal = np.zeros((3, *s.shape))
        total = _sum_edges_and_corners(
            outer, inner, frame.normal, self._quads, float(power), by_outer, by_inner, by_normal
        )
        along = frame.along / self._cell
        slopes = np.einsum("pkc,pc->pk", along, by_outer)
        slopes += np.einsum("pkc,pc->pk", along - self._depth * frame.turning, by_inner)
        slopes += np.einsum("pkc,pc->pk", frame.turning, by_normal)
        by_moved = np.einsum("pk,pkr->pr", slopes, tangents(s)) / length
        return float(np.log(total)) / power, (self._harmonics.T @ by_moved / (total * power)).ravel()


@kernel
def _sum_edges_and_corners(outer, inner, normal, quads, power, by_outer, by_inner, by_normal):
    """Sum of edges (of ``outer``) and corners (of both surfaces) over what is aimed at, to the 2 ``power``-th.

    Positions are in cells (S, 3). Adds the derivatives by positions and normals to the last three.
    """
    total = 0.0
    e, u, v = np.empty(3), np.empty(3), np.empty(3)
    for q in range(len(quads)):
        for c in range(4):
            o, i, j = quads[q, c], quads[q, (c + 1) % 4], quads[q, (c + 3) % 4]
            square = 0.0
            for r in range(3):
                e[r] = outer[i, r] - outer[o, r]
                square += e[r] * e[r]
            long = 0.5 * (square / LONGEST_EDGE**2) ** power  # each edge belongs to two cells
            short = 0.5 * (SHORTEST_EDGE**2 / square) ** power
            total += long + short
            for r in range(3):
                slope = 2.0 * power * (long - short) / square * e[r]
                by_outer[i, r] += slope
                by_outer[o, r] -= slope
            for layer in range(2):
                x, by_x = (outer, by_outer) if layer == 0 else (inner, by_inner)
                uu, vv = 0.0, 0.0
                for r in range(3):
                    u[r], v[r] = x[i, r] - x[o, r], x[j, r] - x[o, r]
                    uu += u[r] * u[r]
                    vv += v[r] * v[r]
                lengths = (uu * vv) ** 0.5
                n = normal[o]
                area = (u[1] * v[2] - u[2] * v[1]) * n[0]
                area += (u[2] * v[0] - u[0] * v[2]) * n[1] + (u[0] * v[1] - u[1] * v[0]) * n[2]
                sine = area / lengths
                root = (sine * sine + ROUNDING * ROUNDING) ** 0.5
                sharp = 0.25 * (2.0 * SHARPEST_CORNER / (sine + root)) ** (2.0 * power)
                total += sharp
                slope = -2.0 * power * sharp / root  # by the sine
                for r in range(3):
                    r1, r2 = (r + 1) % 3, (r + 2) % 3
                    by_u = slope * ((v[r1] * n[r2] - v[r2] * n[r1]) / lengths - sine * u[r] / uu)
                    by_v = slope * ((n[r1] * u[r2] - n[r2] * u[r1]) / lengths - sine * v[r] / vv)
                    by_x[i, r] += by_u
                    by_x[j, r] += by_v
                    by_x[o, r] -= by_u + by_v
                    by_normal[o, r] += slope * (u[r1] * v[r2] - u[r2] * v[r1]) / lengths
    return total
