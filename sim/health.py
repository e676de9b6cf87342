"""Independent checks of a result: does the pial surface overlap itself, does the cortex keep its grown volume."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit, prange

from morphofold.sim.dynamics import EARLY
from morphofold.surface import Surface

RAYS = 600

#: greatest values that a healthy stage has, and what to change beyond them
BOUNDS = {
    "kinetic_over_strain": (2e-2, "slow the growth down (growth.rate)"),
    "overlap": (2e-3, "refine the mesh (accuracy.level), and check that the scene has [effects.contact]"),
    "volume_drift": (3e-2, "slow the growth down (growth.rate), raise material.kappa_ratio or refine the mesh"),
}
LEAST_J = 0.05          # smallest volume ratio of any Gauss point at any time; below 0.1 the material is frozen


def overlap(surface: Surface, rays: int = RAYS) -> float:
    """Share of the enclosed length of radial rays where a closed surface covers space twice (winding number >= 2).

    Rays start at the centroid in directions of a Fibonacci lattice. Zero for a surface that does not intersect
    itself; the solver's own contact is not asked.
    """
    verts = surface.verts - surface.verts.mean(axis=0)
    k = np.arange(rays) + 0.5
    z, angle = 1 - 2 * k / rays, np.pi * (1 + 5**0.5) * k
    rho = np.sqrt(1 - z * z)
    directions = np.column_stack([rho * np.cos(angle), rho * np.sin(angle), z])
    twice, once = _double_cover(verts, surface.faces, directions)
    return float(twice.sum() / once.sum())


def enclosed_volume(surface: Surface) -> float:
    """Volume inside a closed surface with outward faces [mm^3], by the divergence theorem."""
    a, b, c = (surface.verts[surface.faces[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


def broken_bounds(stage: dict[str, Any]) -> list[str]:
    """One sentence for each bound that the numbers of a stage break; empty when it is healthy.

    The kinetic energy is judged from g = 1.2 on: before, there is too little strain energy to compare it with.
    """
    told = [
        f"{name} {stage[name]:.2g} at g = {stage['growth']:.2f} exceeds {bound:g}: {cure}"
        for name, (bound, cure) in BOUNDS.items()
        if not (stage[name] <= bound or (name == "kinetic_over_strain" and stage["growth"] < EARLY))
    ]
    if not stage["lowest_J"] >= LEAST_J:
        told.append(
            f"lowest J {stage['lowest_J']:.2g} up to g = {stage['growth']:.2f} is below {LEAST_J:g}: refine the mesh "
            "(accuracy.level) or slow the growth down (growth.rate)"
        )
    return told


@njit(parallel=True, cache=True)
def _double_cover(verts, faces, directions):
    """Length of each ray inside the surface twice or more, and inside it at all."""
    twice, once = np.zeros(len(directions)), np.zeros(len(directions))
    for r in prange(len(directions)):
        d0, d1, d2 = directions[r]
        at, sign = np.empty(256), np.empty(256)
        n = 0
        for f in range(len(faces)):
            a, b, c = verts[faces[f, 0]], verts[faces[f, 1]], verts[faces[f, 2]]
            # signed volumes of the ray with the three edges: all of one sign where it passes through
            u = d0 * (b[1] * c[2] - b[2] * c[1]) + d1 * (b[2] * c[0] - b[0] * c[2]) + d2 * (b[0] * c[1] - b[1] * c[0])
            v = d0 * (c[1] * a[2] - c[2] * a[1]) + d1 * (c[2] * a[0] - c[0] * a[2]) + d2 * (c[0] * a[1] - c[1] * a[0])
            w = d0 * (a[1] * b[2] - a[2] * b[1]) + d1 * (a[2] * b[0] - a[0] * b[2]) + d2 * (a[0] * b[1] - a[1] * b[0])
            if not ((u >= 0 and v >= 0 and w >= 0) or (u <= 0 and v <= 0 and w <= 0)):
                continue
            det = u + v + w
            if det == 0.0:
                continue
            t = 0.0
            for k in range(3):
                t += (u * a[k] + v * b[k] + w * c[k]) / det * directions[r, k]
            if t > 0 and n < 256:
                at[n], sign[n] = t, (1.0 if det > 0 else -1.0)          # leaving a layer outwards, or entering one
                n += 1
        order = np.argsort(at[:n])
        winding = 0.0
        for k in range(n - 1, -1, -1):                                  # from outside in
            winding += sign[order[k]]
            inner = at[order[k - 1]] if k > 0 else 0.0
            if winding >= 1:
                once[r] += at[order[k]] - inner
            if winding >= 2:
                twice[r] += at[order[k]] - inner
    return twice, once
