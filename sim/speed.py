"""How many bricks per second the kernels do on this machine."""

from __future__ import annotations

import time
from typing import Any

import numba
import numpy as np

from morphofold.sim.body import Body
from morphofold.sim.mesh import bilayer_sphere


def element_speed(cells: int = 32, portion: str = "half", threads: int = 1, seconds: float = 2.0) -> dict[str, Any]:
    """Speed of the force kernel on a deformed bilayer sphere.

    Parameters
    ----------
    cells : int
        Surface cells along a quarter circle; 32 on half a sphere makes 27,648 bricks.
    portion : str
        See :func:`morphofold.sim.mesh.bilayer_sphere`.
    threads : int
        Threads to use.
    seconds : float
        How long to repeat.

    Returns
    -------
    dict
        ``bricks``, ``threads``, and million brick-steps per second: ``best`` and ``median`` over the repeats.
        A brick has 8 Gauss points.
    """
    bilayer = bilayer_sphere(50, 3, 25, portion, cells)
    body = Body(bilayer, mu_cortex=1.0, mu_core=1.0, kappa_ratio=50.0, law="isotropic")
    x = body.X + 0.05 * np.random.default_rng(0).standard_normal(body.X.shape)
    before = numba.get_num_threads()
    numba.set_num_threads(threads)
    try:
        body.elements.compute_forces(x)
        times: list[float] = []
        end = time.perf_counter() + seconds
        while time.perf_counter() < end or len(times) < 5:
            start = time.perf_counter()
            body.elements.compute_forces(x)
            times.append(time.perf_counter() - start)
    finally:
        numba.set_num_threads(before)
    millions = body.elements.n / 1e6
    return {
        "bricks": body.elements.n,
        "threads": threads,
        "best": millions / min(times),
        "median": millions / float(np.median(times)),
    }
