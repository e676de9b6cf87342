"""Bulk viscosity, linear and quadratic, as in the explicit program that the paper used (0.06 and 1.2).

A pressure against the rate of volume, b1 rho c L e + rho (b2 L e)^2 [only where e < 0], with e the volumetric strain
rate, rho the density, c the speed of pressure waves, rho c^2 = kappa + 4/3 mu, and L the brick's smallest width: its
volume over the largest of its three middle sections. (With the cube root of the volume, the damping of flat bricks
would be unstable at this step.) The density is the present nodal mass, fictitious or real, over the volume before
growth.
"""

from typing import Annotated

import numpy as np
from numba import njit, prange

from morphofold.errors import DoesNotApply
from morphofold.kernels import kernel
from morphofold.sim.body import Body
from morphofold.sim.effects import Effect
from morphofold.sim.elements import brick_kernels
from morphofold.sim.elements.bricks import Bricks
from morphofold.sim.elements.lanes import _FAST_MATH, _LANES, _UINT, LANES, add_level, read_level
from morphofold.sim.scene.keys import EffectOptions, key

LOCAL_BULK_OVER_MU = Bricks.LOCAL


@njit(forceinline=True, fastmath=_FAST_MATH)
def _scaled_cofactors(p, d):
    k = brick_kernels._cofactor(*d)
    return (p * k[0], p * k[1], p * k[2], p * k[3], p * k[4], p * k[5], p * k[6], p * k[7], p * k[8])


@njit(forceinline=True, fastmath=_FAST_MATH)
def _half_mean_edges(xs, l):
    """Half the mean edges along i, j and k for the coordinate of ``xs`` (in eighths) that starts at ``l``."""
    n0, n1, n2, n3 = xs[l], xs[l + _UINT(3) * _LANES], xs[l + _UINT(6) * _LANES], xs[l + _UINT(9) * _LANES]
    n4, n5, n6, n7 = (
        xs[l + _UINT(12) * _LANES],
        xs[l + _UINT(15) * _LANES],
        xs[l + _UINT(18) * _LANES],
        xs[l + _UINT(21) * _LANES],
    )
    return (
        n4 + n5 + n6 + n7 - n0 - n1 - n2 - n3,
        n2 + n3 + n6 + n7 - n0 - n1 - n4 - n5,
        n1 + n3 + n5 + n7 - n0 - n2 - n4 - n6,
    )


@njit(forceinline=True, fastmath=_FAST_MATH)
def _width_squared(xs, l, v):
    """Square of the smallest width of a brick of volume ``v``."""
    a0, b0, c0 = _half_mean_edges(xs, l)
    a1, b1, c1 = _half_mean_edges(xs, l + _LANES)
    a2, b2, c2 = _half_mean_edges(xs, l + _UINT(2) * _LANES)
    k = brick_kernels._cofactor(a0, a1, a2, b0, b1, b2, c0, c1, c2)
    largest = max(
        k[0] * k[0] + k[1] * k[1] + k[2] * k[2],
        max(k[3] * k[3] + k[4] * k[4] + k[5] * k[5], k[6] * k[6] + k[7] * k[7] + k[8] * k[8]),
    )
    return v * v / (16.0 * largest)  # 4 squared: a section has four times the area of the half edges


@njit(forceinline=True, fastmath=_FAST_MATH, error_model="numpy")
def _block_viscous_forces(now, last, m, rho, linear, quadratic, f):
    """Forces of the viscous pressure on the corners of the bricks of a block, from positions now and a step ago."""
    for l in range(_LANES):
        v = brick_kernels._brick_volume(now, l)
        rate = 1.0 - brick_kernels._brick_volume(last, l) / v
        wave = m[l + _LANES] + (LOCAL_BULK_OVER_MU + 4.0 / 3.0) * m[l]  # rho c^2
        size = _width_squared(now, l, v)
        p = linear * np.sqrt(rho[l] * wave * size) * rate
        p -= quadratic * quadratic * rho[l] * size * rate * rate if rate < 0.0 else 0.0
        p = p if wave > 0.0 else 0.0  # lanes that only fill the last block
        d = brick_kernels._gauss_point_jacobians(now, l)
        q = (
            _scaled_cofactors(p, d[0]),
            _scaled_cofactors(p, d[1]),
            _scaled_cofactors(p, d[2]),
            _scaled_cofactors(p, d[3]),
            _scaled_cofactors(p, d[4]),
            _scaled_cofactors(p, d[5]),
            _scaled_cofactors(p, d[6]),
            _scaled_cofactors(p, d[7]),
        )
        for r in range(3):
            brick_kernels._store_corner_values(f, l + _UINT(r) * _LANES, brick_kernels._corner_forces(q, r))


@kernel(parallel=True, fastmath=_FAST_MATH)
def add_viscous_forces(x, before, density, nodes, start, local, layers, modulus, linear, quadratic, force):
    """Add the forces of the viscous pressure to ``force`` (R, 3); ``before`` (N, 3): positions of the last step."""
    for g in prange(len(local)):
        now, last, f, held = np.zeros(24 * LANES), np.zeros(24 * LANES), np.zeros(24 * LANES), np.zeros(12 * LANES)
        at, origins, moved = np.empty((4 * LANES, 3)), np.zeros((2, 3 * LANES)), np.empty(3 * LANES)
        mine, width, rho = local[g], (start[g + 1] - start[g]) // (layers + 1), np.empty(LANES)
        for k in range(layers + 1):
            level = start[g] + k * width
            here = nodes[level : level + width]
            read_level(x, here, mine, at, origins[0], moved, now)
            read_level(before, here, mine, at, origins[1], moved, last)
            if k > 0:
                over = nodes[level - width : level]
                rho[:] = 0.0
                for i in range(4 * LANES):
                    rho[i % LANES] += 0.125 * (density[here[mine[i]]] + density[over[mine[i]]])
                _block_viscous_forces(now, last, modulus[g * layers + k - 1], rho, linear, quadratic, f)
                add_level(f, held, mine, force[level - width : level])
        f[:] = 0.0
        add_level(f, held, mine, force[start[g + 1] - width : start[g + 1]])


class Options(EffectOptions):
    """Viscous pressure against the rate of volume, as in the program that the paper used."""

    shapes = ("sphere", "ellipsoid", "patch", "strip")
    theory = True

    linear: Annotated[float, key("coefficient of the linear term", ge=0, le=0.5)] = 0.06
    quadratic: Annotated[float, key("coefficient of the quadratic term", ge=0, le=2)] = 1.2


class BulkViscosity(Effect):
    """Viscous pressure of the bricks; ``linear`` (b1) and ``quadratic`` (b2) are dimensionless."""

    def __init__(self, linear: float, quadratic: float):
        self._linear, self._quadratic = linear, quadratic

    def prepare(self, body: Body) -> None:
        if not isinstance(body.elements, Bricks):
            raise DoesNotApply("effects.bulk_viscosity needs bricks, but this body has tetrahedra; leave it out.")
        self._volume = body.nodal_volumes()
        body.viscosity = self._linear
        self._before = np.empty_like(body.X)

    def refresh(self, run) -> None:
        self._density = run.body.mass / self._volume

    def add_element_forces(self, body: Body, x, v) -> None:
        np.subtract(x, v, out=self._before)
        assert isinstance(body.elements, Bricks)
        b, modulus = body.elements.blocks, body.elements.modulus
        connected = self._density, b.nodes, b.start, b.local, b.layers, modulus
        add_viscous_forces(x, self._before, *connected, self._linear, self._quadratic, b.force)
