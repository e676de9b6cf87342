"""A rigid skull: a shell around the body's first shape, which the pial surface cannot leave."""

from collections.abc import Callable
from typing import Annotated

import numpy as np
from pydantic import Field
from scipy.optimize import brentq

from morphofold.errors import ImpossibleBody
from morphofold.frozen_arrays import Array
from morphofold.sim.body import Body
from morphofold.sim.effects import need_growth
from morphofold.sim.mesh.brick_mesh import Plane
from morphofold.sim.output.stage_surfaces import whole_surfaces
from morphofold.sim.rigid_shells import EllipsoidShell, HullShell
from morphofold.sim.rigid_walls import RigidWalls, medial_plane
from morphofold.sim.scene import Scene
from morphofold.sim.scene.geometries import Ellipsoid, Sphere
from morphofold.sim.scene.table_bases import LONGEST_LENGTH_MM, EffectOptions, key
from morphofold.sim.stage_checks import enclosed_volume

Gap = Annotated[float, Field(ge=0, le=LONGEST_LENGTH_MM)]

PENALTY_STIFFNESS, PENALTY_DAMPING = 0.1, 0.5  # as in contact: force per mass and depth, per mass and speed
N_CHECKED_GROWTHS = 32  # growths at which the body must fit
MOST_GAP_CELLS = 16  # of the grid of a wide gap, along it


class Options(EffectOptions):
    """A rigid shell around the body, of the shape of its first surface, ``gap`` [mm] outside of it.

    Around a sphere or an ellipsoid it is an ellipsoid. Around a cortex or a mesh it is at this distance from the convex
    hull of the surface, so that it bridges hollows. With ``gap_final`` the gap changes linearly with the growth of the
    cortex, as a skull grows.
    """

    shapes = ("sphere", "ellipsoid", "cortex", "mesh")
    at_onset = False
    example = "{gap = 13}"

    gap: Annotated[Gap, key("between the body at first and a rigid shell; the grown body must fit", "mm")] = 2.0
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
    gap_of_growth = lambda g: options.gap_at(g, scene)
    final_growth, geometry, midline = scene.growth.final, scene.geometry, scene.effects.get("midline")
    if isinstance(geometry, Sphere | Ellipsoid):
        return Skull(EllipsoidShell(np.array(geometry.semi_axes)), gap_of_growth, final_growth)
    return HullSkull(gap_of_growth, final_growth, None if midline is None else midline.gap)


def grown_volume_of(body: Body) -> Callable[[float], float]:
    """Volume [mm^3] within the pial surface of an incompressible body at a growth: of its elements and its hole."""
    portion, ungrown_volumes, n_cortex = body.bilayer.portion, body.elements.volume, body.elements.n_cortex
    hollow_volume = enclosed_volume(whole_surfaces(body, body.X)[1]) - float(ungrown_volumes.sum()) / portion
    core_volume = lambda g: (1 + (g - 1) * body.core_share) ** 3 * ungrown_volumes[n_cortex:].sum()
    return lambda g: float(body.grown_volumes(g).sum() + core_volume(g)) / portion + hollow_volume


def _gap_that_holds(needed_volume: float, max_gap: float, volume_at_gap: Callable[[float], float]) -> float:
    """Gap [mm], up to ``max_gap``, of the shell that holds ``needed_volume``."""
    if not volume_at_gap(0) < needed_volume < volume_at_gap(max_gap):
        return max_gap
    return float(brentq(lambda gap: volume_at_gap(gap) - needed_volume, 0, max_gap, xtol=1e-6 * max_gap))


class Skull(RigidWalls):
    """A shell that the surface nodes stay inside of, without friction.

    Parameters
    ----------
    shell : Shell
    gap : callable
        Distance [mm] of the shell from the body's first surface at a growth g of the cortex.
    final : float
        Final growth of the cortex.

    Raises
    ------
    ImpossibleBody
        By ``prepare``, if the grown body has no room in the skull, on its side of a midline.
    """

    penalty = PENALTY_STIFFNESS, PENALTY_DAMPING

    def __init__(self, shell: EllipsoidShell, gap: Callable[[float], float] = lambda g: 0.0, final: float = 1.0):
        self.shells, self._volume, self._gap, self._final = [shell], shell.volume, gap, final

    def prepare(self, body: Body) -> None:
        self._check_room(body, self._volume, lambda max_gap: self._volume)

    def gap(self, body: Body) -> float:
        return self._gap(body.growth)

    def _check_room(
        self, body: Body, volume_at: Callable[[float], float], volume_up_to: Callable[[float], Callable[[float], float]]
    ) -> None:
        """Check that the body fits in the skull at any growth up to the final one.

        ``volume_at`` is the volume [mm^3] that the shell holds at a gap [mm]; ``volume_up_to`` returns that
        for gaps up to the one that is given.
        """
        if self._final == 1:
            return
        body_volume = grown_volume_of(body)
        checked_growths = np.linspace(1, self._final, N_CHECKED_GROWTHS + 1)[1:]
        g = max(checked_growths, key=lambda g: body_volume(g) - volume_at(self._gap(g)))
        fills, room = body_volume(g), volume_at(self._gap(g))
        if fills <= room:
            return
        widest_gap = 2 * (3 * fills / (4 * np.pi)) ** (1 / 3)  # half a ball of this radius has room enough
        least_gap = _gap_that_holds(fills, widest_gap, volume_up_to(widest_gap))
        least_gap = _gap_that_holds(fills, 1.2 * least_gap, volume_up_to(1.2 * least_gap))
        raise ImpossibleBody(
            f"effects.skull: at g = {g:g} the body fills {fills:,.0f} mm3, the skull holds {room:,.0f}; make the gap "
            f"there more than {least_gap:.3g} mm, or growth.final smaller."
        )


class HullSkull(Skull):
    """A skull at a distance from the convex hull of the first surface of any body, beside a midline if there is one.

    ``gap`` and ``final`` as of :class:`Skull`; ``gap_of_midline`` [mm].
    """

    def __init__(self, gap: Callable[[float], float], final: float, gap_of_midline: float | None = None):
        self._gap, self._final, self._gap_of_midline = gap, final, gap_of_midline

    def prepare(self, body: Body) -> None:
        bilayer = body.bilayer
        plane = None if self._gap_of_midline is None else medial_plane(bilayer, self._gap_of_midline)
        pial = whole_surfaces(body, np.ascontiguousarray(bilayer.mesh.p.T))[1].verts
        shell = HullShell(pial, max(self._gap(1.0), self._gap(self._final)))
        self.shells = [shell]
        self._check_room(body, lambda gap: shell.volume(gap, plane), lambda max_gap: _holding(pial, max_gap, plane))


def _holding(ungrown_verts: Array, max_gap: float, plane: Plane | None) -> Callable[[float], float]:
    """Volume [mm^3] of shells with gaps up to ``max_gap``; the wider, the less exact."""
    shell = HullShell(ungrown_verts, max_gap, least_spacing=max_gap / MOST_GAP_CELLS)
    return lambda gap: shell.volume(gap, plane)
