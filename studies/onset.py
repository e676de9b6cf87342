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
    g_end = scene.growth.final
    if not (1 <= start < g_end and 0 < rate < np.inf):
        raise OutOfRange(
            f"{scene.name}: need 1 <= start < growth.final = {g_end:g} and a positive rate, got {start:g} and {rate:g}."
        )
    scene = in_double(scene)  # differences decay to round-off
    scene = scene.without(*(effect for effect, options in scene.effects.items() if not options.at_onset))
    thickness = scene.geometry.cortex_thickness
    pair = _Twins(scene, rate, bilayer)
    pair.grow(start)
    X = pair.body.X
    kick = Perturbation(KICK * thickness, DEFAULT_WAVELENGTH_OVER_T * thickness, seed).reshape(pair.body.bilayer, X) - X

    growth, difference, mode = pair.part(kick, LARGE_RISE)
    kick_growth, g_min = _late(growth, difference, LARGE_RISE, start), np.inf
    for _ in range(MAX_PAIRS):
        mode *= KICK * thickness / _rms(mode)
        pair.grow(kick_growth)
        growth, difference, mode = pair.part(mode, MIN_RISE, mode=mode)
        if difference.argmin() == 0:
            raise NoSolution(f"{scene.name}: folds already at g = {growth[0]:g}; set start to less than {start:g}.")
        last_g, g_min = g_min, _least(growth, difference)
        if abs(g_min - last_g) < ONSET_TOL:
            return Onset(g_min, growth, difference)
        kick_growth = _late(growth, difference, MIN_RISE, kick_growth)
    raise NoSolution(
        f"{scene.name}: the onset still moves, from g = {last_g:.4f} to {g_min:.4f} between two kicks; reduce the rate."
    )


class _Twins:
    """A run at some growth, and a second run that is kicked there; both have the given pace."""

    def __init__(self, scene: Scene, rate: float, bilayer: Bilayer | None):
        self.scene, self._bilayer = scene, bilayer
        self.plain, self.kicked = self._run(), self._run()
        self.body = self.plain.body
        self.growth_step = STEPS_PER_MEASUREMENT * rate / scene.steps_per_unit(self.body.crossing)
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
            self.plain.grow_to(min(self.plain.state.growth + self.growth_step, g))
        self._start = self.plain.save()

    def part(self, kick: Array, rise_factor: float, mode: Array | None = None) -> tuple[Array, Array, Array]:
        """Kick the second run by (N, 3); grow until the difference is ``rise_factor`` times its minimum, or to the end.

        Returns growth and rms difference (M,), in total or along ``mode``, and the last difference (N, 3).
        """
        plain_run, kicked_run, g_final = self.plain, self.kicked, self.scene.growth.final
        kicked_run.load(self._start)
        kicked_run.state.x += np.where(self.body.free, kick, 0.0)
        growth: list[float] = []
        difference: list[float] = []
        displacement = kick
        while plain_run.state.growth < g_final and not (difference and difference[-1] > rise_factor * min(difference)):
            g = min(plain_run.state.growth + self.growth_step, g_final)
            for run in (plain_run, kicked_run):
                run.grow_to(g)
            displacement = kicked_run.state.x - plain_run.state.x
            growth.append(g)
            difference.append(_rms(displacement if mode is None else self._part_along(displacement, mode) * mode))
        if difference[-1] <= MIN_RISE * min(difference):
            raise NoSolution(
                f"{self.scene.name}: no onset between g = {growth[0]:g} and {g_final:g}; increase growth.final."
            )
        return np.array(growth), np.array(difference), displacement

    def _part_along(self, displacement: Array, mode: Array) -> float:
        """Share of a mode in a displacement: modes are orthogonal with the mass as weight."""
        weighted_mode = self.body.mass[:, None] * mode
        return float(np.sum(weighted_mode * displacement) / np.sum(weighted_mode * mode))


def _rms(displacement: Array) -> float:
    return float(np.sqrt(np.mean(np.sum(displacement**2, axis=1))))


def _late(growth: Array, difference: Array, rise_factor: float, start_growth: float) -> float:
    """The last growth with a decaying difference of more than ``rise_factor`` times its minimum, or ``start_growth``.

    A kick at that growth cannot decay so far that the rest of other waves hides it.
    """
    late_steps = np.flatnonzero(difference[: difference.argmin()] > rise_factor * difference.min())
    return float(growth[late_steps[-1]]) if late_steps.size else start_growth


def _least(growth: Array, difference: Array) -> float:
    """Growth of the smallest difference, by a parabola through its logarithms within a factor of e^1/2."""
    k = int(np.argmin(difference))
    is_near = np.log(difference / difference[k]) < 0.5
    fit_start = k - np.argmin(is_near[k::-1]) + 1 if not is_near[: k + 1].all() else 0
    fit_stop = k + np.argmin(is_near[k:]) if not is_near[k:].all() else len(is_near)
    if fit_stop - fit_start < 4:
        return float(growth[k])
    a, b, _ = np.polyfit(growth[fit_start:fit_stop] - growth[k], np.log(difference[fit_start:fit_stop]), 2)
    return float(np.clip(growth[k] - b / (2 * a), growth[fit_start], growth[fit_stop - 1]))
