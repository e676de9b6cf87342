"""When theory lets the cortex of a scene wrinkle first, and how slowly growth has to pass there.

A fold that begins grows from next to nothing, at a rate that rises from zero at the bifurcation: growth that goes on
meanwhile leaves it behind, and then shorter waves are faster than those that came first. So growth slows down where
theory expects the first wrinkles, the more the stiffer the cortex: its wrinkles wait for a core that moves slowly.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from morphofold.sim.scene import Scene

THIN_SHELL = 0.005  # T/C of the sphere that stands for a body without a radius
MOST = 4.0  # growth up to which to look: the largest of a scene
BEFORE, AFTER = 0.01, 0.02  # growth before and after the first wrinkles in which growth is slow,
SLOW = 0.44  # and its pace there over that of growth.rate = 1, times the mu ratio: wrinkles come 0.01 late


class Wrinkles(NamedTuple):
    """The first wrinkles of a scene by theory: the growth stretch at which they come, and their wavelength on the
    ungrown surface, over the thickness of the cortex; NaN where theory finds none."""

    growth: float
    wavelength_over_T: float


class Slow(NamedTuple):
    """Growth stretches between which growth keeps to a ``pace``, a share of the full one."""

    start: float
    end: float
    pace: float


def first_wrinkles(scene: Scene) -> Wrinkles:
    """Of a scene's cortex where it grows most, on a sphere as large as the body, or a flat core where it has no size.

    Incompressible, of even thickness: :func:`morphofold.sim.theory.bifurcation`.
    """
    geometry = scene.geometry
    axes = getattr(geometry, "semi_axes", None)
    thickness = geometry.cortex_thickness
    T_over_C = thickness / math.prod(axes) ** (1 / 3) if axes and thickness else THIN_SHELL
    if not scene.material.theory:
        return Wrinkles(math.nan, math.nan)
    found = _of_sphere(round(T_over_C, 4), scene.material.mu_ratio, scene.growth.law)
    growth = found.growth
    for options in scene.effects.values():
        growth = options.first_wrinkles(growth, scene)
    return Wrinkles(growth, found.wavelength_over_T)


def slow_growth(scene: Scene) -> Slow | None:
    """Where growth slows down for the first wrinkles; None if they don't come, or time is real (inertia)."""
    pace = SLOW / (scene.material.mu_ratio * scene.growth.rate)
    if pace >= 1 or scene.real_time:
        return None
    growth = first_wrinkles(scene).growth
    return None if math.isnan(growth) else Slow(growth - BEFORE, growth + AFTER, pace)


@lru_cache(maxsize=256)
def _of_sphere(T_over_C: float, mu_ratio: float, law: str) -> Wrinkles:
    from morphofold.sim.sphere_theory.smooth_sphere import ConvergenceError
    from morphofold.sim.theory import bifurcation

    try:
        found = bifurcation(T_over_C, mu_ratio, law, g_max=MOST)
    except (ValueError, ConvergenceError):  # a sphere that theory does not know
        return Wrinkles(math.nan, math.nan)
    return Wrinkles(found.g_crit, found.wavelength / T_over_C)
