"""The growth at which a growing body starts to fold, from its dynamics in the limit of small noise.

Two runs of the same body grow with the same steps. One of them is kicked once by a small displacement. While the grown
state is stable, the difference between the runs decays; past the bifurcation it grows. The onset is the growth at which
the difference is smallest. It needs no threshold, and dents of the mesh cancel in the difference. Two effects would
disturb it. An oscillating difference is smallest when it passes through zero: so the runs are damped until waves as
long as the wrinkles creep. After a random kick, waves that decay slowly hide growing waves for a long time: so the last
difference becomes the kick of the next pair, at a later growth, and only the part of the new difference along that kick
counts. This is repeated until the onset stays constant. For slower growth it tends to the bifurcation of the same mesh.
"""

from dataclasses import dataclass

import numpy as np

from morphofold.errors import NoSolution, OutOfRange
from morphofold.frozen_arrays import Array
from morphofold.sim.build import build_body
from morphofold.sim.dynamics import STEPS_PER_MEASUREMENT, Dynamics
from morphofold.sim.effects import build_effects
from morphofold.sim.effects.perturbation import DEFAULT_WAVELENGTH_OVER_T, Perturbation
from morphofold.sim.mesh.brick_mesh import Bilayer
from morphofold.sim.scene import Scene, in_double

KICK = 1e-3  # rms of the kick over the cortical thickness
MIN_RISE = 3.0  # the difference counts as rising when it is this many times its minimum
LARGE_RISE = 30.0  # almost only its growing part is left when it is this many times its minimum
ONSET_TOL = 1e-3  # the onset is constant if it moves by less growth between two pairs,
MAX_PAIRS = 8  # of which there are at most so many
CREEP_SHARE = 1.0  # share of the velocity that is lost over as many steps as a wave needs to cross a wrinkle, about


@dataclass(frozen=True)
class Onset:
    """Onset of folding.

    Attributes
    ----------
    g : float
        Growth at which the difference between the two runs is smallest.
    growth, difference : (M,) float64
        Growth after the kick, and the rms over the nodes of the difference along the critical mode [mm].
    """

    g: float
    growth: Array
    difference: Array


def onset(
    scene: Scene, *, start: float = 1.1, rate: float = 1.0, seed: int = 0, bilayer: Bilayer | None = None
) -> Onset:
    """Grow a scene until it starts to fold.

    Parameters
    ----------
    scene : Scene
        It is run in double precision, without its perturbation, notch, contact, skull, inertia and ramp. Growth
        continues until the onset is passed, at most to ``growth.final``.
    start : float
        Growth at which the first kick is applied, well before the onset.
    rate : float
        Pace of growth over that of the scene; it is constant, independent of the balance of the body.
    seed : int
        Seed of the kick, a random smooth field with waves as long as the wrinkles.
    bilayer : Bilayer, optional
        A mesh of the body that replaces that of the scene.

    Raises
    ------
    ValueError
        If 1 <= start < growth.final or rate > 0 does not hold; if the difference does not rise before ``growth.final``,
        rises from the start, or has its minimum at another growth after every kick.
    """
    final = scene.growth.final
    if not (1 <= start < final and 0 < rate < np.inf):
        raise OutOfRange(
            f"{scene.name}: need 1 <= start < growth.final = {final:g} and a positive rate, got {start:g} and {rate:g}."
        )
    scene = in_double(scene)  # differences decay to round-off
    scene = scene.without(*(name for name, options in scene.effects.items() if not options.at_onset))
    thickness = scene.geometry.cortex_thickness
    twins = _Twins(scene, rate, bilayer)
    twins.grow(start)
    X = twins.body.X
    kick = (
        Perturbation(KICK * thickness, DEFAULT_WAVELENGTH_OVER_T * thickness, seed).reshape(twins.body.bilayer, X) - X
    )

    growth, difference, mode = twins.part(kick, LARGE_RISE)
    kick_growth, g_min = _late(growth, difference, LARGE_RISE, start), np.inf
    for _ in range(MAX_PAIRS):
        mode *= KICK * thickness / _rms(mode)
        twins.grow(kick_growth)
        growth, difference, mode = twins.part(mode, MIN_RISE, along=mode)
        if difference.argmin() == 0:
            raise NoSolution(f"{scene.name}: folds already at g = {growth[0]:g}; set start to less than {start:g}.")
        old_g, g_min = g_min, _least(growth, difference)
        if abs(g_min - old_g) < ONSET_TOL:
            return Onset(g_min, growth, difference)
        kick_growth = _late(growth, difference, MIN_RISE, kick_growth)
    raise NoSolution(
        f"{scene.name}: the onset still moves, from g = {old_g:.4f} to {g_min:.4f} between two kicks; reduce the rate."
    )


class _Twins:
    """A run at some growth, and a second run that is kicked there; both have the given pace."""

    def __init__(self, scene: Scene, rate: float, bilayer: Bilayer | None):
        self.scene, self._bilayer = scene, bilayer
        self.plain, self.kicked = self._run(), self._run()
        self.body = self.plain.body
        self.step = STEPS_PER_MEASUREMENT * rate / scene.steps_per_unit(self.body.crossing)
        self._start = self.plain.save()

    def _run(self) -> Dynamics:
        effects = build_effects(self.scene)
        body = build_body(self.scene, effects, self._bilayer)
        wrinkle_length = DEFAULT_WAVELENGTH_OVER_T * self.scene.geometry.cortex_thickness
        damping = CREEP_SHARE * body.bilayer.edge / wrinkle_length * body.levels.lightness**0.5  # light waves are fast
        # one step per unit of growth would be far too fast, but each call of grow_to makes only one increment
        return Dynamics(body, effects, steps_per_unit=1.0, damping=damping)

    def grow(self, g: float) -> None:
        """Grow from the start, or from the last saved growth, to ``g``; both runs continue from there."""
        self.plain.load(self._start)
        while self.plain.state.growth < g:
            self.plain.grow_to(min(self.plain.state.growth + self.step, g))
        self._start = self.plain.save()

    def part(self, kick: Array, rise: float, along: Array | None = None) -> tuple[Array, Array, Array]:
        """Kick the second run by (N, 3) and grow until the difference is ``rise`` times its minimum, or to the end.

        Returns growth and rms difference (M,), in total or ``along`` a mode, and the last difference (N, 3).
        """
        plain, kicked, final = self.plain, self.kicked, self.scene.growth.final
        kicked.load(self._start)
        kicked.state.x += np.where(self.body.free, kick, 0.0)
        growth: list[float] = []
        difference: list[float] = []
        displacement = kick
        while plain.state.growth < final and not (difference and difference[-1] > rise * min(difference)):
            g = min(plain.state.growth + self.step, final)
            for run in (plain, kicked):
                run.grow_to(g)
            displacement = kicked.state.x - plain.state.x
            growth.append(g)
            difference.append(_rms(displacement if along is None else self._part_along(displacement, along) * along))
        if difference[-1] <= MIN_RISE * min(difference):
            raise NoSolution(
                f"{self.scene.name}: no onset between g = {growth[0]:g} and {final:g}; increase growth.final."
            )
        return np.array(growth), np.array(difference), displacement

    def _part_along(self, offset: Array, mode: Array) -> float:
        """Share of a mode in a displacement: modes are orthogonal with the mass as weight."""
        weighted_mode = self.body.mass[:, None] * mode
        return float(np.sum(weighted_mode * offset) / np.sum(weighted_mode * mode))


def _rms(displacement: Array) -> float:
    return float(np.sqrt(np.mean(np.sum(displacement**2, axis=1))))


def _late(growth: Array, difference: Array, times: float, start: float) -> float:
    """The last growth at which the decaying difference is more than ``times`` its minimum, or ``start``.

    A kick at that growth cannot decay so far that the rest of other waves hides it.
    """
    late_states = np.flatnonzero(difference[: difference.argmin()] > times * difference.min())
    return float(growth[late_states[-1]]) if late_states.size else start


def _least(growth: Array, difference: Array) -> float:
    """Growth of the smallest difference, by a parabola through its logarithms within a factor of e^1/2."""
    k = int(np.argmin(difference))
    is_near = np.log(difference / difference[k]) < 0.5
    start = k - np.argmin(is_near[k::-1]) + 1 if not is_near[: k + 1].all() else 0
    stop = k + np.argmin(is_near[k:]) if not is_near[k:].all() else len(is_near)
    if stop - start < 4:
        return float(growth[k])
    a, b, _ = np.polyfit(growth[start:stop] - growth[k], np.log(difference[start:stop]), 2)
    return float(np.clip(growth[k] - b / (2 * a), growth[start], growth[stop - 1]))
