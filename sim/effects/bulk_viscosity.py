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
from morphofold.sim.elements.lanes import FAST_MATH, LANES, ROW, UINT, add_level, inlined, read_level
from morphofold.sim.elements.tensor3 import cofactor, dot, scaled, transposed
from morphofold.sim.scene.table_bases import EffectOptions, key

LOCAL_BULK_OVER_MU = Bricks.LOCAL


@inlined
def _half_edges(corners, lane):
    """Half the mean edges along i, j and k for the coordinate of ``corners`` (in eighths) from ``lane`` on."""
    x0, x1, x2, x3, x4, x5, x6, x7 = brick_kernels.corner_values(corners, lane)
    return (
        x4 + x5 + x6 + x7 - x0 - x1 - x2 - x3,
        x2 + x3 + x6 + x7 - x0 - x1 - x4 - x5,
        x1 + x3 + x5 + x7 - x0 - x2 - x4 - x6,
    )


@inlined
def _width_squared(corners, lane, volume):
    """Square of the smallest width of a brick of that ``volume``."""
    edges = _half_edges(corners, lane) + _half_edges(corners, lane + ROW) + _half_edges(corners, lane + UINT(2) * ROW)
    areas = cofactor(transposed(edges))
    largest_section = max(dot(areas, areas), max(dot(areas[3:6], areas[3:6]), dot(areas[6:9], areas[6:9])))
    return volume * volume / (16.0 * largest_section)  # 4 squared: a section has four times the area of the half edges


@njit(forceinline=True, fastmath=FAST_MATH, error_model="numpy")
def _block_viscous_forces(corners, corners_before, moduli, rho, linear, quadratic, f):
    """Forces of the viscous pressure on the corners of the bricks of a block, from positions now and a step ago."""
    for lane in range(ROW):
        volume = brick_kernels.brick_volume(corners, lane)
        rate = 1.0 - brick_kernels.brick_volume(corners_before, lane) / volume
        wave_modulus = moduli[lane + ROW] + (LOCAL_BULK_OVER_MU + 4.0 / 3.0) * moduli[lane]  # rho c^2
        width_squared = _width_squared(corners, lane, volume)
        pressure = linear * np.sqrt(rho[lane] * wave_modulus * width_squared) * rate
        pressure -= quadratic * quadratic * rho[lane] * width_squared * rate * rate if rate < 0.0 else 0.0
        pressure = pressure if wave_modulus > 0.0 else 0.0  # lanes that only fill the last block
        jacobians = brick_kernels.gauss_point_jacobians(corners, lane)
        stresses = (
            scaled(pressure, cofactor(jacobians[0])),
            scaled(pressure, cofactor(jacobians[1])),
            scaled(pressure, cofactor(jacobians[2])),
            scaled(pressure, cofactor(jacobians[3])),
            scaled(pressure, cofactor(jacobians[4])),
            scaled(pressure, cofactor(jacobians[5])),
            scaled(pressure, cofactor(jacobians[6])),
            scaled(pressure, cofactor(jacobians[7])),
        )
        for axis in range(3):
            brick_kernels.store_corner_values(f, lane + UINT(axis) * ROW, brick_kernels.corner_forces(stresses, axis))


@kernel(parallel=True, fastmath=FAST_MATH)
def add_viscous_forces(x, x_before, density, nodes, start, local, layers, modulus, linear, quadratic, force):
    """Add the forces of the viscous pressure to ``force`` (R, 3); ``x_before`` (N, 3): positions of the last step."""
    for group in prange(len(local)):
        new_x, old_x, f, face_f = np.zeros(24 * LANES), np.zeros(24 * LANES), np.zeros(24 * LANES), np.zeros(12 * LANES)
        nodal_x, origins, origin_shift = np.empty((4 * LANES, 3)), np.zeros((2, 3 * LANES)), np.empty(3 * LANES)
        corner_row, level_width, rho = local[group], (start[group + 1] - start[group]) // (layers + 1), np.empty(LANES)
        for level in range(layers + 1):
            level_row = start[group] + level * level_width
            level_nodes = nodes[level_row : level_row + level_width]
            read_level(x, level_nodes, corner_row, nodal_x, origins[0], origin_shift, new_x)
            read_level(x_before, level_nodes, corner_row, nodal_x, origins[1], origin_shift, old_x)
            if level > 0:
                above = nodes[level_row - level_width : level_row]
                rho[:] = 0.0
                for i in range(4 * LANES):
                    rho[i % LANES] += 0.125 * (density[level_nodes[corner_row[i]]] + density[above[corner_row[i]]])
                _block_viscous_forces(new_x, old_x, modulus[group * layers + level - 1], rho, linear, quadratic, f)
                add_level(f, face_f, corner_row, force[level_row - level_width : level_row])
        f[:] = 0.0
        add_level(f, face_f, corner_row, force[start[group + 1] - level_width : start[group + 1]])


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
        self._before_x = np.empty_like(body.X)

    def refresh(self, run) -> None:
        self._density = run.body.mass / self._volume

    def add_element_forces(self, body: Body, x, v) -> None:
        np.subtract(x, v, out=self._before_x)
        assert isinstance(body.elements, Bricks)
        blocks, modulus = body.elements.blocks, body.elements.modulus
        layout = self._density, blocks.nodes, blocks.start, blocks.local, blocks.layers, modulus
        add_viscous_forces(x, self._before_x, *layout, self._linear, self._quadratic, blocks.force)
