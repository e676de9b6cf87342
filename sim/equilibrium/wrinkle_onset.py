"""Growth at which theory predicts the first wrinkles of a scene, and how slowly growth has to pass there.

A fold begins with a very small amplitude, and its rate of increase rises from zero at the bifurcation. If growth goes
on too fast, shorter waves overtake those that came first. So growth slows down where theory predicts the first
wrinkles. It slows down more for a stiffer cortex, whose wrinkles must move a relatively slow core.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from morphofold.sim.scene import Scene

THIN_SHELL_T_OVER_C = 0.005  # T/C of the sphere that represents a body without a radius
LARGEST_GROWTH = 4.0  # growth at which the search ends: the largest of a scene
#: growth is slow in this range of g before and after the first wrinkles
SLOW_GROWTH_BEFORE, SLOW_GROWTH_AFTER = 0.01, 0.02
SLOW_PACE = 0.27  # pace there over that of growth.rate = 1, times the mu ratio: wrinkles come 0.01 late


class Wrinkles(NamedTuple):
    """The first wrinkles of a scene by theory: their growth stretch, and their wavelength on the ungrown surface over
    the thickness of the cortex; NaN if theory finds none."""

    growth: float
    wavelength_over_T: float


class Slow(NamedTuple):
    """Growth stretches between which the ``pace``, a share of the full one, is not exceeded."""

    start: float
    end: float
    pace: float


def first_wrinkles(scene: Scene) -> Wrinkles:
    """First wrinkles where the cortex grows most, by the theory of a sphere as large as the body.

    A body without a size is replaced by a sphere with a thin cortex (``THIN_SHELL_T_OVER_C``). The sphere is
    incompressible, of even thickness: :func:`morphofold.sim.theory.bifurcation`. If growth changes the thickness
    (``growth.thickness``), it changes the wavelength in proportion, as in a flat cortex.
    """
    from morphofold.sim.sphere_theory.smooth_sphere import ConvergenceError
    from morphofold.sim.theory import bifurcation

    if not scene.material.theory:
        return Wrinkles(math.nan, math.nan)
    geometry, thickness = scene.geometry, scene.geometry.cortex_thickness
    semi_axes = getattr(geometry, "semi_axes", None)
    T_over_C = round(thickness / math.prod(semi_axes) ** (1 / 3) if semi_axes and thickness else THIN_SHELL_T_OVER_C, 4)
    try:
        theory_bifurcation = bifurcation(T_over_C, scene.material.mu_ratio, scene.growth.law, g_max=LARGEST_GROWTH)
    except (ValueError, ConvergenceError):  # a sphere outside the range of the theory
        return Wrinkles(math.nan, math.nan)
    growth = theory_bifurcation.g_crit
    for effect_options in scene.effects.values():
        growth = effect_options.first_wrinkles(growth, scene)
    return Wrinkles(growth, theory_bifurcation.wavelength / T_over_C * scene.growth.thickening(growth))


def slow_growth(scene: Scene) -> Slow | None:
    """Growth range of the first wrinkles, and the pace there; None if growth need not slow down, or time is real."""
    slow_pace = SLOW_PACE / (scene.material.mu_ratio * scene.growth.rate)
    if slow_pace >= 1 or scene.real_time:
        return None
    growth = first_wrinkles(scene).growth
    return None if math.isnan(growth) else Slow(growth - SLOW_GROWTH_BEFORE, growth + SLOW_GROWTH_AFTER, slow_pace)
