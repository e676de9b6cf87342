"""The growth at which a growing body starts to fold, seen in its dynamics as noise vanishes.

Two runs grow side by side, one of them kicked once by a small displacement. While the grown state is stable
the difference between them dies away; past the bifurcation it grows. The onset is the growth at which the
difference is smallest. It needs no threshold, and being a difference it is blind to the dents of the mesh. Of a
random kick, waves that die slowly hide for long those that grow; so the kick of a second pass is what was left of the
first one at its least: the critical mode, nearly alone. The onset lags behind the bifurcation of the same mesh by what
the rate of growth costs, and tends to it as growth slows down.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from morphofold.sim.dynamics import REFRESH, Dynamics
from morphofold.sim.effects import build_effects
from morphofold.sim.effects.perturbation import WAVELENGTH, Perturbation
from morphofold.sim.geometry import build_body
from morphofold.sim.scene import Scene

Array = NDArray[np.float64]

SILENT = ("perturbation", "contact", "enclosure")   # effects that the difference leaves out: none acts on a smooth body
KICK = 1e-3             # of the cortical thickness, rms
RISE = 3.0             # the difference has turned for good when it is this many times its least


@dataclass(frozen=True)
class Onset:
    """Onset of folding.

    Attributes
    ----------
    g : float
        Growth at which the difference between the two runs is smallest.
    growth, difference : (M,) float64
        Growth after the kick, and the rms distance between the pial surfaces of the two runs [mm].
    """

    g: float
    growth: Array
    difference: Array


def onset(scene: Scene, *, start: float = 1.1, rate: float = 1.0, seed: int = 0) -> Onset:
    """Grow a scene until it starts to fold.

    Parameters
    ----------
    scene : Scene
        Its perturbation and contact are left out; growth goes on until the onset is passed, at most to
        ``growth.final``.
    start : float
        Growth at which one run is kicked, well before the onset.
    rate : float
        Pace of growth, times that of the scene.
    seed : int
        Of the kick, a random smooth field with waves of the wrinkles' size.

    Raises
    ------
    ValueError
        If the difference doesn't turn before ``growth.final``.
    """
    named = {name: None for name in SILENT}
    scene = scene.model_copy(update={"effects": scene.effects.model_copy(update=named)})
    thickness = scene.geometry.cortex_thickness
    field = Perturbation(KICK * thickness, WAVELENGTH * thickness, seed)
    run = _run(scene, rate)
    kick = field.reshape(run.body.bilayer, run.body.X) - run.body.X
    _, kick = _least_difference(scene, start, rate, kick)
    kick *= KICK * thickness / np.sqrt(np.mean(np.sum(kick[: run.body.n_surface] ** 2, axis=1)))
    found, _ = _least_difference(scene, start, rate, kick)
    return found


def _run(scene: Scene, rate: float) -> Dynamics:
    effects = build_effects(scene)
    body = build_body(scene, effects)
    return Dynamics(body, effects, steps_per_unit=scene.steps_per_unit(body.bilayer.cells) / rate)


def _least_difference(scene: Scene, start: float, rate: float, kick: Array) -> tuple[Onset, Array]:
    """The onset after one kick (N, 3), and the difference (N, 3) when it was least."""
    runs = [_run(scene, rate) for _ in range(2)]
    n = runs[0].body.n_surface
    for run in runs:
        run.grow_to(start)
    runs[1].state.x += np.where(runs[1].body.free, kick, 0.0)
    growth: list[float] = []
    difference: list[float] = []
    least = kick
    while runs[0].state.growth < scene.growth.final:
        g = min(runs[0].state.growth + REFRESH * runs[0].rate, scene.growth.final)
        for run in runs:
            run.grow_to(g)
        apart = runs[1].state.x - runs[0].state.x
        growth.append(g)
        difference.append(float(np.sqrt(np.mean(np.sum(apart[:n] ** 2, axis=1)))))
        if difference[-1] == min(difference):
            least = apart
        if difference[-1] > RISE * min(difference):
            return Onset(_least(np.array(growth), np.array(difference)), np.array(growth), np.array(difference)), least
    raise ValueError(f"{scene.name}: no onset between g = {start:g} and {scene.growth.final:g}; let it grow further.")


def _least(growth: Array, difference: Array) -> float:
    """Growth of the least difference, by a parabola through the logarithms within a factor of e^1/2."""
    k = int(np.argmin(difference))
    near = np.log(difference / difference[k]) < 0.5
    low = k - np.argmin(near[k::-1]) + 1 if not near[: k + 1].all() else 0
    high = k + np.argmin(near[k:]) if not near[k:].all() else len(near)
    if high - low < 4:
        return float(growth[k])
    a, b, _ = np.polyfit(growth[low:high] - growth[k], np.log(difference[low:high]), 2)
    return float(growth[k] - b / (2 * a))
