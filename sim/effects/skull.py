"""A rigid skull: a shell of the body's first shape, which the pial surface cannot leave."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from numba import njit
from scipy import sparse
from scipy.optimize import brentq

from morphofold.arrays import Array
from morphofold.errors import ImpossibleBody
from morphofold.sim.body import Body
from morphofold.sim.effects import Effect
from morphofold.sim.growth import volume
from morphofold.sim.scene.geometries import Ellipsoid, Sphere
from morphofold.sim.scene.tables import LONGEST_LENGTH_MM, EffectOptions, key

if TYPE_CHECKING:
    from morphofold.sim.scene import Scene

PENALTY_STIFFNESS, PENALTY_DAMPING = 0.1, 0.5  # as in contact: force per mass and depth, per mass and speed


@njit(cache=True)
def press_shell(x, v, mass, semi_axes, extra):
    """Push the surface nodes outside the ellipsoid back in; returns how many, and their energy.

    The depth is taken along the gradient of the level function |x / a| - 1: exact on a sphere, first order otherwise.
    """
    count, energy = 0, 0.0
    for i in range(len(extra)):
        level, slope = 0.0, 0.0
        for r in range(3):
            level += (x[i, r] / semi_axes[r]) ** 2
            slope += (x[i, r] / semi_axes[r] ** 2) ** 2
        level, slope = np.sqrt(level), np.sqrt(slope)
        if level <= 1.0:
            continue
        depth, speed = (level - 1.0) * level / slope, 0.0
        for r in range(3):
            speed += v[i, r] * x[i, r] / semi_axes[r] ** 2 / slope
        force = mass[i] * (PENALTY_STIFFNESS * depth + PENALTY_DAMPING * speed)
        if force > 0.0:
            for r in range(3):
                extra[i, r] -= force * x[i, r] / semi_axes[r] ** 2 / slope
            count += 1
            energy += 0.5 * mass[i] * PENALTY_STIFFNESS * depth * depth
    return count, energy


class Options(EffectOptions):
    """A rigid shell around the body, of the shape of its first surface, ``gap`` [mm] outside of it."""

    shapes = ("sphere", "ellipsoid")
    at_onset = False
    example = "{gap = 13}"

    gap: Annotated[
        float,
        key(
            "between the body at first and a rigid shell around it; the grown body must fit",
            "mm",
            ge=0,
            le=LONGEST_LENGTH_MM,
        ),
    ] = 2.0


def build(options: Options, scene: Scene) -> Skull:
    assert isinstance(scene.geometry, Sphere | Ellipsoid)
    axes = np.array(scene.geometry.semi_axes)
    fills, holds = grown_volume(scene, axes), 4 / 3 * np.pi * float(np.prod(axes + options.gap))
    if fills > holds:
        room = brentq(lambda gap: 4 / 3 * np.pi * float(np.prod(axes + gap)) - fills, 0, 10 * axes.max())
        raise ImpossibleBody(
            f"effects.skull: at g = {scene.growth.final:g} the body fills {fills:,.0f} mm3, the skull holds "
            f"{holds:,.0f}; make gap more than {room:.3g} mm, or growth.final smaller."
        )
    return Skull(axes + options.gap)


def grown_volume(scene: Scene, axes: Array) -> float:
    """Volume [mm^3] within the pial surface of an incompressible body at its final growth, spots and regions aside."""
    whole, inside = 4 / 3 * np.pi * np.prod(axes), 4 / 3 * np.pi * np.prod(axes - scene.geometry.cortex_thickness)
    core = scene.effects["core_growth"].final if "core_growth" in scene.effects else 1.0
    geometry = scene.geometry
    assert isinstance(geometry, Sphere | Ellipsoid)
    hollow = geometry.hole_share**3 * whole
    swelling = volume(scene.growth.final, scene.growth.law)
    return float(swelling * (whole - inside) + core**3 * (inside - hollow) + hollow)


class Skull(Effect):
    """An ellipsoid that the surface nodes stay inside of, without friction.

    Parameters
    ----------
    semi_axes : (3,) float64
        Of the skull [mm].
    """

    name = "skull"

    def __init__(self, semi_axes: Array):
        self._semi_axes = np.asarray(semi_axes, dtype=np.float64)
        self._pressed, self._energy = 0, 0.0

    def add_forces(self, body: Body, x: Array, v: Array, extra: Array) -> None:
        self._pressed, self._energy = press_shell(x, v, body.mass, self._semi_axes, extra)

    def springs(self, body: Body, x: Array) -> Array:
        return np.where(self._level(body, x) > 1, PENALTY_STIFFNESS, 0.0)

    def _level(self, body: Body, x: Array) -> Array:
        """1 at surface nodes (S,) on the shell, more outside."""
        return np.sqrt(np.sum((x[: body.n_surface] / self._semi_axes) ** 2, axis=1))

    def stiffness(self, body: Body, x: Array) -> sparse.csr_matrix:
        """Of the nodes outside: a spring along each one's normal of the shell."""
        n, level = body.n_surface, self._level(body, x)
        normal = x[:n] / self._semi_axes**2
        normal /= np.linalg.norm(normal, axis=1)[:, None]
        springs = PENALTY_STIFFNESS * body.mass[:n] * (level > 1)
        blocks = springs[:, None, None] * normal[:, :, None] * normal[:, None, :]
        diagonal = sparse.bsr_matrix((blocks, np.arange(n), np.arange(n + 1)), shape=(3 * n, 3 * n))
        return sparse.csr_matrix(sparse.block_diag([diagonal, sparse.csr_matrix((x.size - 3 * n, x.size - 3 * n))]))

    def energy(self) -> float:
        return self._energy

    def record(self) -> dict[str, Any]:
        return {"pressed": self._pressed}
