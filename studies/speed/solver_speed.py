"""Speed of this machine: the force kernels, whole steps, and the time that each effect adds to a step."""

import itertools
import time
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any

import numba
import numpy as np
from skfem import MeshTet

from morphofold.errors import UnknownName
from morphofold.sim.body import Body
from morphofold.sim.build import build_body
from morphofold.sim.dynamics import STEPS_PER_MEASUREMENT, Dynamics
from morphofold.sim.effects import build_effects
from morphofold.sim.elements.bricks import CORNERS_IN_KERNEL_ORDER
from morphofold.sim.mesh.brick_mesh import Bilayer, bilayer_sphere
from morphofold.sim.scene import Scene
from morphofold.sim.scene.effect_registry import effects_of, options_of
from morphofold.sim.scene.scene_files import load_scene

FOLDED_GROWTH = 1.7  # growth at which contact is active

#: surface cells along a quarter circle of the timed half spheres
CELL_COUNTS = {"brick": (16, 32, 56), "tet": (16, 24, 36)}
NOISE_MM = 0.05  # standard deviation of the positions for timing from the reference [mm]

#: where and how the speeds of the peers were measured (Python 3.11, numpy 2.4, numba 0.68, gcc 12; 6,761 nodes with
#: nodal-averaged J)
PEERS_SOURCE = (
    "noted on 2026-11-21 on another machine of 2 cores: whole steps of both programs on BrainGrowth's demo ellipsoid, "
    "35,497 tet4. Wall times, but the quiet one, are upper bounds: the machine had other work"
)
#: their whole steps, noted then on another machine: design, threads, ms, million tet-steps per second, how it was timed
PEER_SPEEDS = (
    ("BrainGrowth (Python, numba)", "1", "51.3", "0.69", "wall, quiet machine"),
    ("BrainGrowth (Python, numba)", "1", "49.6", "0.72", "CPU time, mean of steps 0 to 3,500"),
    ("BrainGrowth (Python, numba)", "1", "55.5", "0.64", "CPU time, steps 3,500 to 4,500 (folds form)"),
    ("BrainGrowth (Python, numba)", "2", "73.2", "0.48", "wall, taken once, other jobs not excluded: no speed-up seen"),
    ("BrainGrowthModel (C++, -Ofast)", "1", "10.1", "3.5", "wall, its own phase timers"),
    ("BrainGrowthModel (C++, -Ofast)", "1", "~7", "~5", "CPU time, whole run of about 6,000 steps"),
    ("BrainGrowthModel (C++, -Ofast)", "2", "5.6 to 6.6", "5.4 to 6.3", "wall, best stretch"),
)


def cut_bricks(bilayer: Bilayer) -> Bilayer:
    """A layered cubed sphere with each brick cut into six tetrahedra, conforming: the same nodes, layers and surface.

    The six tetrahedra of a brick lie around its diagonal away from the middle of a face of the cube, so neighbours cut
    their shared quad in the same way. They form one full patch of ``elements.tets``; other meshes do not everywhere.
    """
    nodes = bilayer.mesh.p
    corners = bilayer.mesh.t[CORNERS_IN_KERNEL_ORDER].T.reshape(-1, 2, 2, 2)
    norm_ratio = np.abs(nodes).sum(axis=0) / np.abs(nodes).max(axis=0)  # smallest in the middle of a face of the cube
    nearest_corner = norm_ratio[corners[..., 0]].reshape(-1, 4).argmin(axis=1)
    corners = np.where((nearest_corner >= 2)[:, None, None, None], corners[:, ::-1], corners)
    corners = np.where((nearest_corner % 2)[:, None, None, None], corners[:, :, ::-1], corners)
    edge_paths = [np.cumsum(np.eye(3, dtype=int)[list(axes)], axis=0) for axes in itertools.permutations(range(3))]
    tet_nodes = np.stack([[corners[:, 0, 0, 0], *(corners[:, i, j, k] for i, j, k in path)] for path in edge_paths])
    tets = tet_nodes.transpose(2, 0, 1).reshape(-1, 4)
    n_cortex_tets = 6 * len(bilayer.mesh.subdomains["cortex"])
    tet_mesh = MeshTet(nodes.copy(), np.ascontiguousarray(tets.T), validate=False).with_subdomains(
        {"cortex": np.arange(n_cortex_tets), "core": np.arange(n_cortex_tets, len(tets))}
    )
    quads = bilayer.faces  # the bricks below them come first, in order
    is_cut_1_to_3 = np.isin(nearest_corner[: len(quads)], (1, 2))[:, None]  # cut from corner 1 to 3, else from 0 to 2
    quads = np.where(is_cut_1_to_3, np.roll(quads, -1, axis=1), quads)
    return replace(bilayer, mesh=tet_mesh, faces=np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]))


def speed_body(element: str, n_cells: int, portion: str = "half", *, single: bool = True) -> Body:
    """The ungrown bilayer sphere that is timed, with one modulus, C = 50, T = 3 and A = 25 mm.

    Parameters
    ----------
    element : {"brick", "tet"}
        Tetrahedra are cut from the bricks, six from each (:func:`cut_bricks`).
    n_cells : int
        Surface cells along a quarter circle; 32 on half a sphere give 27,648 bricks.
    portion : str
        See :func:`morphofold.sim.mesh.brick_mesh.bilayer_sphere`.
    single : bool
        As in :class:`Body`; the default of scenes.

    Raises
    ------
    ValueError
        If the element, portion or number of cells is unknown.
    """
    if element not in CELL_COUNTS:
        raise UnknownName(f"element must be one of {', '.join(CELL_COUNTS)}, got {element!r}.")
    bilayer = bilayer_sphere(50, 3, 25, portion, n_cells)
    if element == "tet":
        bilayer = cut_bricks(bilayer)
    return Body(bilayer, mu_cortex=1.0, mu_core=1.0, kappa_ratio=50.0, law="isotropic", single=single)


def element_speed(body: Body, threads: Iterable[int] = (1,), seconds: float = 2.0) -> list[dict[str, Any]]:
    """Speed of the force kernel of a body, shaken by ``NOISE_MM``, and of its whole steps from rest.

    Parameters
    ----------
    body : Body
        It is unchanged afterwards, except for its last computed values.
    threads : iterable of int
        Numbers of threads, used one after the other.
    seconds : float
        Duration of the repeats of each.

    Returns
    -------
    list of dict
        Per number of threads: ``element`` ("brick", of 8 Gauss points, or "tet"), ``elements``, ``threads``, and
        million element-steps per second: ``best`` and ``median`` of the kernel over the repeats, ``steps`` of whole
        steps, including all measurements (median).
    """
    positions = body.X + NOISE_MM * np.random.default_rng(0).standard_normal(body.X.shape)
    mega_elements = body.elements.n / 1e6
    threads_before = numba.get_num_threads()
    rows = []
    try:
        for n_threads in threads:
            numba.set_num_threads(n_threads)
            run = Dynamics(body, steps_per_unit=1e5)
            kernel_seconds = _repeat(lambda: body.elements.compute_forces(positions), seconds)
            step_times = _repeat(lambda run=run: run.relax(run.state.relaxed + STEPS_PER_MEASUREMENT), seconds)  # type: ignore[misc]
            rows.append(
                {
                    "element": "tet" if isinstance(body.bilayer.mesh, MeshTet) else "brick",
                    "elements": body.elements.n,
                    "threads": n_threads,
                    "best": mega_elements / min(kernel_seconds),
                    "median": mega_elements / float(np.median(kernel_seconds)),
                    "steps": STEPS_PER_MEASUREMENT * mega_elements / float(np.median(step_times)),
                }
            )
    finally:
        numba.set_num_threads(threads_before)
    return rows


def effect_costs(n_threads: int = 1, seconds: float = 2.0) -> list[dict[str, Any]]:
    """Time that each effect adds to a step of an octant of ``demo``; contact also on the folded body.

    Returns
    -------
    list of dict
        ``effect``, ``ms`` per step, ``share`` of a step without effects.
    """
    threads_before = numba.get_num_threads()
    numba.set_num_threads(n_threads)
    try:
        bare_phase_ms = _per_step([], 1.05, seconds)
        bare_ms = sum(bare_phase_ms.values())
        rows = [{"effect": "none", "ms": bare_ms, "share": 1.0}]
        for effect in effects_of("sphere"):
            phase_ms = _per_step([effect], 1.05, seconds)
            added_ms = phase_ms.get(effect, 0.0) + phase_ms.get("grow", 0.0) - bare_phase_ms.get("grow", 0.0)
            rows.append({"effect": effect, "ms": added_ms, "share": added_ms / bare_ms})
        folded_ms = _per_step(["contact", "perturbation"], FOLDED_GROWTH, seconds)
        added_ms = folded_ms["contact"] + folded_ms["symmetry"]
        rows.append({"effect": f"contact, folded (g = {FOLDED_GROWTH:g})", "ms": added_ms, "share": added_ms / bare_ms})
    finally:
        numba.set_num_threads(threads_before)
    return rows


def effect_scene(effect_names: Iterable[str]) -> Scene:
    """The scene in which effects are timed: the demo's body, as an octant, with these effects and no other."""
    effect_settings = [f"effects.{effect}={options_of(effect).example}" for effect in effect_names]
    base_settings = ["geometry.portion=octant", "effects={}", "output.stages=[]"]
    return load_scene("demo", [*base_settings, *effect_settings])


def _per_step(effect_names: list[str], growth: float, seconds: float) -> dict[str, float]:
    """Milliseconds per step by phase, during slow growth from this growth."""
    scene = effect_scene(effect_names)
    built_effects = build_effects(scene)
    body = build_body(scene, built_effects)
    dynamics = Dynamics.of(scene, body, built_effects)
    dynamics.grow_to(growth)
    dynamics.seconds.clear()
    first_step = dynamics.state.step
    deadline = time.perf_counter() + seconds
    while time.perf_counter() < deadline:
        dynamics.grow_to(dynamics.state.growth + 1e-6)
    return {phase: 1e3 * secs / (dynamics.state.step - first_step) for phase, secs in dynamics.seconds.items()}


def _repeat(work: Callable[[], object], seconds: float) -> list[float]:
    """Times of repeated work, after one run for the compiler."""
    work()
    times: list[float] = []
    deadline = time.perf_counter() + seconds
    while time.perf_counter() < deadline or len(times) < 5:
        start_time = time.perf_counter()
        work()
        times.append(time.perf_counter() - start_time)
    return times
