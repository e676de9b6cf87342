"""A rigid skull: a shell around the body's first shape, which the pial surface cannot leave."""

from collections.abc import Callable
from typing import Annotated

import numpy as np
from pydantic import Field
from scipy.optimize import brentq

from morphofold.arrays import Array
from morphofold.errors import ImpossibleBody
from morphofold.sim.body import Body
from morphofold.sim.effects import need_growth
from morphofold.sim.growth import volume
from morphofold.sim.health import enclosed_volume
from morphofold.sim.mesh.brick_mesh import Plane
from morphofold.sim.output.stage_surfaces import whole_surfaces
from morphofold.sim.rigid_walls import RigidWalls, medial_plane
from morphofold.sim.scene import Scene
from morphofold.sim.scene.geometries import Ellipsoid, Sphere
from morphofold.sim.scene.keys import LONGEST_LENGTH_MM, EffectOptions, key
from morphofold.sim.shells import EllipsoidShell, HullShell, Shell

Gap = Annotated[float, Field(ge=0, le=LONGEST_LENGTH_MM)]

PENALTY_STIFFNESS, PENALTY_DAMPING = 0.1, 0.5  # as in contact: force per mass and depth, per mass and speed
CHECKS = 32  # growths at which the body must fit
MOST_CELLS = 16  # of the grid of a wide gap, along it


class Options(EffectOptions):
    """A rigid shell around the body, of the shape of its first surface, ``gap`` [mm] outside of it.

    Around a sphere or an ellipsoid it is an ellipsoid. Around a cortex or a mesh it is at this distance from the convex
    hull of the surface, so that it bridges hollows. With ``gap_final`` the gap changes linearly with the growth of the
    cortex, as a skull grows.
    """

    shapes = ("sphere", "ellipsoid", "cortex", "mesh")
    at_onset = False
    example = "{gap = 13}"

    gap: Annotated[Gap, key("between the body at first and a rigid shell around it; the grown body must fit", "mm")] = (
        2.0
    )
    gap_final: Annotated[
        Gap | None, key("gap at the final growth; it changes linearly with growth, or by default does not change", "mm")
    ] = None

    def check(self, scene: Scene) -> None:
        if self.gap_final is not None:
            need_growth(scene, "effects.skull.gap_final")

    def gap_at(self, g: float, scene: Scene) -> float:
        """Gap [mm] at growth g of the cortex."""
        if self.gap_final is None:
            return self.gap
        return self.gap + (self.gap_final - self.gap) * (g - 1) / (scene.growth.final - 1)


def build(options: Options, scene: Scene) -> "Skull":
    gap = lambda g: options.gap_at(g, scene)
    final, geometry = scene.growth.final, scene.geometry
    if isinstance(geometry, Sphere | Ellipsoid):
        shell = EllipsoidShell(np.array(geometry.semi_axes))
        holding = lambda most: shell.volume
        check_room(lambda g: grown_volume(scene, shell.semi_axes, g), shell.volume, gap, final, holding)
        return Skull(shell, gap)
    midline = scene.effects.get("midline")
    return HullSkull(gap, final, None if midline is None else midline.gap)


def grown_volume(scene: Scene, axes: Array, g: float) -> float:
    """Volume [mm^3] within the pial surface of an incompressible ellipsoid at growth g, spots and regions aside."""
    whole, inside = 4 / 3 * np.pi * np.prod(axes), 4 / 3 * np.pi * np.prod(axes - scene.geometry.cortex_thickness)
    core = 1 + (g - 1) * scene.effects["core_growth"].share(scene) if "core_growth" in scene.effects else 1.0
    geometry = scene.geometry
    assert isinstance(geometry, Sphere | Ellipsoid)
    hollow = geometry.hole_share**3 * whole
    swelling = volume(g, scene.growth.law) * scene.growth.thickening(g)
    return float(swelling * (whole - inside) + core**3 * (inside - hollow) + hollow)


def grown_volume_of(body: Body) -> Callable[[float], float]:
    """Volume [mm^3] within the pial surface of an incompressible body at a growth: of its elements and its hole."""
    portion, first, n = body.bilayer.portion, body.elements.volume, body.elements.n_cortex
    hollow = enclosed_volume(whole_surfaces(body, body.X)[1]) - float(first.sum()) / portion
    core = lambda g: (1 + (g - 1) * body.core_share) ** 3 * first[n:].sum()
    return lambda g: float(body.grown_volumes(g).sum() + core(g)) / portion + hollow


def check_room(
    fills: Callable[[float], float],
    holds: Callable[[float], float],
    gap: Callable[[float], float],
    final: float,
    holding: Callable[[float], Callable[[float], float]],
) -> None:
    """Check that the body fits in the skull at any growth up to the final one.

    Parameters
    ----------
    fills, gap : callable
        Volume of the body [mm^3] and gap [mm] at a growth g.
    holds : callable
        Volume [mm^3] that a shell holds, at a gap [mm].
    final : float
    holding : callable
        Returns ``holds`` for gaps up to the one that is given.

    Raises
    ------
    ImpossibleBody
    """
    g = max(np.linspace(1, final, CHECKS + 1)[1:], key=lambda g: fills(g) - holds(gap(g)))
    needs, has = fills(g), holds(gap(g))
    if final == 1 or needs <= has:
        return
    reach = 2 * (3 * needs / (4 * np.pi)) ** (1 / 3)  # half a ball of this radius has room enough
    room = _gap_that_holds(needs, reach, holding(reach))
    room = _gap_that_holds(needs, 1.2 * room, holding(1.2 * room))
    raise ImpossibleBody(
        f"effects.skull: at g = {g:g} the body fills {needs:,.0f} mm3, the skull holds {has:,.0f}; make the gap there "
        f"more than {room:.3g} mm, or growth.final smaller."
    )


def _gap_that_holds(needs: float, most: float, holds: Callable[[float], float]) -> float:
    """Gap [mm], up to ``most``, of the shell that holds the volume ``needs``."""
    if not holds(0) < needs < holds(most):
        return most
    return float(brentq(lambda gap: holds(gap) - needs, 0, most, xtol=1e-6 * most))


class Skull(RigidWalls):
    """A shell that the surface nodes stay inside of, without friction.

    Parameters
    ----------
    shell : Shell
    gap : callable
        Distance [mm] of the shell from the body's first surface at a growth g of the cortex.
    """

    penalty = PENALTY_STIFFNESS, PENALTY_DAMPING

    def __init__(self, shell: Shell, gap: Callable[[float], float] = lambda g: 0.0):
        self.shells, self._gap = [shell], gap

    def gap(self, body: Body) -> float:
        return self._gap(body.growth)


class HullSkull(Skull):
    """A skull at a distance from the convex hull of the first surface of any body, beside a midline if there is one.

    Parameters
    ----------
    gap : callable
        As of :class:`Skull`.
    final : float
        Final growth of the cortex.
    gap_of_midline : float, optional
        [mm]

    Raises
    ------
    ImpossibleBody
        By ``prepare``, if the grown body has no room in the skull, on its side of the midline.
    """

    def __init__(self, gap: Callable[[float], float], final: float, gap_of_midline: float | None = None):
        self._gap, self._final, self._gap_of_midline = gap, final, gap_of_midline

    def prepare(self, body: Body) -> None:
        bilayer = body.bilayer
        plane = None if self._gap_of_midline is None else medial_plane(bilayer, self._gap_of_midline)
        first = whole_surfaces(body, np.ascontiguousarray(bilayer.mesh.p.T))[1].verts
        shell = HullShell(first, max(self._gap(1.0), self._gap(self._final)))
        self.shells = [shell]
        check_room(
            grown_volume_of(body),
            lambda gap: shell.volume(gap, plane),
            self._gap,
            self._final,
            lambda most: _holding(first, most, plane),
        )


def _holding(first: Array, most: float, plane: Plane | None) -> Callable[[float], float]:
    """Volume [mm^3] of shells with gaps up to ``most``; the wider, the less exact."""
    shell = HullShell(first, most, least_spacing=most / MOST_CELLS)
    return lambda gap: shell.volume(gap, plane)
