"""How fast this machine is: the force kernels, whole steps, and what each effect adds to a step."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numba
import numpy as np

from morphofold.sim.body import Body
from morphofold.sim.dynamics import Dynamics
from morphofold.sim.effects import build_effects
from morphofold.sim.geometry import build_body
from morphofold.sim.meshes.bilayer import bilayer_sphere
from morphofold.sim.scene import load_scene

#: settings that call for each effect
EFFECTS = {
    "contact": "{}", "perturbation": "{}", "ramp": '{shape = "smooth"}', "enclosure": "{gap = 0.5}", "inertia": "{}",
    "core_growth": "{}", "regional_growth": "{spots = [{centre = [0, 0, 50], radius = 20, factor = 0.5}]}",
    "bulk_viscosity": "{}",
}  # fmt: skip
FOLDED = 1.7            # growth at which contact is awake


def element_speed(cells: int = 32, portion: str = "half", threads: int = 1, seconds: float = 2.0) -> dict[str, Any]:
    """Speed of the brick force kernel and of whole steps on a deformed bilayer sphere.

    Parameters
    ----------
    cells : int
        Surface cells along a quarter circle; 32 on half a sphere makes 30,720 bricks.
    portion : str
        See :func:`morphofold.sim.meshes.bilayer.bilayer_sphere`.
    threads : int
        Threads to use.
    seconds : float
        How long to repeat each.

    Returns
    -------
    dict
        ``bricks``, ``threads``, and million brick-steps per second: ``best`` and ``median`` of the kernel over the
        repeats, ``steps`` of whole steps, all measuring included (median). A brick has 8 Gauss points.
    """
    bilayer = bilayer_sphere(50, 3, 25, portion, cells)
    body = Body(bilayer, mu_cortex=1.0, mu_core=1.0, kappa_ratio=50.0, law="isotropic")
    x = body.X + 0.05 * np.random.default_rng(0).standard_normal(body.X.shape)
    run = Dynamics(body, steps_per_unit=1e5)
    before = numba.get_num_threads()
    numba.set_num_threads(threads)
    try:
        kernel = _repeat(lambda: body.elements.compute_forces(x), seconds)
        ten_steps = _repeat(lambda: run.relax(run.state.relaxed + 10), seconds)
    finally:
        numba.set_num_threads(before)
    millions = body.elements.n / 1e6
    return {
        "bricks": body.elements.n,
        "threads": threads,
        "best": millions / min(kernel),
        "median": millions / float(np.median(kernel)),
        "steps": 10 * millions / float(np.median(ten_steps)),
    }


def effect_costs(threads: int = 1, seconds: float = 2.0) -> list[dict[str, Any]]:
    """What each effect adds to a step of a draft octant (demo), and contact once more when it is folded.

    Returns
    -------
    list of dict
        ``effect``, ``ms`` per step, ``share`` of a step without effects.
    """
    before = numba.get_num_threads()
    numba.set_num_threads(threads)
    try:
        bare = _per_step([], 1.05, seconds)
        whole = sum(bare.values())
        rows = [{"effect": "none", "ms": whole, "share": 1.0}]
        for name in EFFECTS:
            added = _per_step([name], 1.05, seconds)
            ms = added.get(name, 0.0) + added.get("grow", 0.0) - bare.get("grow", 0.0) * (name != "grow")
            rows.append({"effect": name, "ms": ms, "share": ms / whole})
        folded = _per_step(["contact", "perturbation"], FOLDED, seconds)
        ms = folded["contact"] + folded["symmetry"]
        rows.append({"effect": f"contact, folded (g = {FOLDED:g})", "ms": ms, "share": ms / whole})
    finally:
        numba.set_num_threads(before)
    return rows


def _per_step(effects: list[str], g: float, seconds: float) -> dict[str, float]:
    """Milliseconds per step by phase, at growth g and slow growth from there."""
    settings = [f"effects.{name}={EFFECTS[name]}" for name in effects]
    plain = ["geometry.portion=octant", "accuracy.level=draft", "effects={}", "output.stages=[]"]
    scene = load_scene("demo", [*plain, *settings])
    built = build_effects(scene)
    body = build_body(scene, built)
    run = Dynamics(body, built, steps_per_unit=scene.steps_per_unit(body.crossing))
    run.grow_to(g)
    run.seconds.clear()
    first = run.state.step
    end = time.perf_counter() + seconds
    while time.perf_counter() < end:
        run.grow_to(run.state.growth + 1e-6)
    return {phase: 1e3 * s / (run.state.step - first) for phase, s in run.seconds.items()}


def _repeat(work: Callable[[], object], seconds: float) -> list[float]:
    """Times of repeated work, after once for the compiler."""
    work()
    times: list[float] = []
    end = time.perf_counter() + seconds
    while time.perf_counter() < end or len(times) < 5:
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return times
