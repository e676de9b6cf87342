"""Independent checks of a result: does the pial surface pass through itself, does the cortex keep its grown volume."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit, prange

from morphofold.crossings.boxes import box_tree
from morphofold.crossings.intersection import self_intersections
from morphofold.crossings.rays import ray_hits
from morphofold.shapes import even_directions
from morphofold.sim.dynamics import restlessness
from morphofold.surface import Surface

RAYS = 10_000
TOUCHING = 1e-9             # stretches of a ray shorter than this share of its length are none

#: how deep the surface may pass through itself [mean edges]: half the gap at which contact begins to act
CROSSING_TOLERANCE = 0.1

#: greatest values that a healthy stage has, and what to change beyond them
BOUNDS = {
    "kinetic_over_strain": (1e-2, "slow the growth down (growth.rate)"),
    "overlap": (2e-3, "refine the mesh (accuracy.level), and check that the scene has [effects.contact]"),
    "winding_max": (1, "check that the scene has [effects.contact], and slow the growth down (growth.rate)"),
    "crossings": (0, "check that the scene has [effects.contact], and refine the mesh (accuracy.level)"),
    "deepest_crossing": (CROSSING_TOLERANCE, "slow the growth down (growth.rate), or refine the mesh (accuracy.level)"),
    "volume_drift": (3e-2, "slow the growth down (growth.rate), raise material.kappa_ratio or refine the mesh"),
}
LEAST_J = 0.05          # smallest volume ratio of any Gauss point at any time; below 0.1 the material is frozen


class Cover(NamedTuple):
    """How often a closed surface covers the space along radial rays."""

    twice: float        # share of the length inside the surface at all that is inside it twice or more
    most: int           # largest winding number on any ray: 1 if the surface doesn't pass through itself


def check_surface(pial: Surface, closed: bool = True) -> dict[str, float | int]:
    """What the health of a stage says of its pial surface; how often it covers space only if that is ``closed``.

    Returns
    -------
    dict
        ``overlap`` and ``winding_max`` (:func:`cover`); ``crossings``, how many edges and vertices have passed through
        the surface by more than CROSSING_TOLERANCE; ``deepest_crossing``, the depth of the deepest in mean edges;
        ``mean_edge_mm``.
    """
    found = self_intersections(pial)
    space = cover(pial)._asdict() if closed else {}
    return {
        **{name: space[key] for name, key in (("overlap", "twice"), ("winding_max", "most")) if space},
        "crossings": found.deeper_than(CROSSING_TOLERANCE),
        "deepest_crossing": found.deepest_share,
        "mean_edge_mm": found.mean_edge,
    }


def overlap(surface: Surface, rays: int = RAYS) -> float:
    """Share of the enclosed length of radial rays that a closed surface covers twice: see :func:`cover`."""
    return cover(surface, rays).twice


def cover(surface: Surface, rays: int = RAYS) -> Cover:
    """How often a closed surface winds around the points of radial rays; the solver's own contact is not asked.

    Rays start at the centroid of the vertices in directions of a Fibonacci lattice. A ray that meets an edge or a
    vertex counts as turned by next to nothing, the same way for all faces
    (:func:`morphofold.crossings.rays.ray_hits`), and a stretch shorter than 1e-9 of the ray, as between walls that
    touch, isn't counted.

    Raises
    ------
    ValueError
        If the surface has a hole (the winding number at the centroid differs between rays), or nothing is inside.
    """
    verts, faces = surface.verts - surface.verts.mean(axis=0), surface.faces.copy()
    tree = box_tree(verts, faces)
    twice, once, most, centre = _along_rays(verts, faces, tree.bounds, tree.order, even_directions(rays))
    if (centre != centre[0]).any():
        raise ValueError(
            f"{surface.name}: isn't closed: it winds {centre.min()} to {centre.max()} times around its centroid, "
            "depending on the direction in which that is counted. Close its holes."
        )
    if once.sum() == 0:
        raise ValueError(
            f"{surface.name}: none of {rays} rays from its centroid runs inside it. Turn its faces: seen from outside "
            "they run counter-clockwise."
        )
    return Cover(float(twice.sum() / once.sum()), int(most.max()))


def _told(value: float | int) -> str:
    return f"{value:,}" if isinstance(value, int) else f"{value:.2g}"


def enclosed_volume(surface: Surface) -> float:
    """Volume inside a closed surface with outward faces [mm^3], by the divergence theorem."""
    a, b, c = (surface.verts[surface.faces[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


def broken_bounds(stage: dict[str, Any]) -> list[str]:
    """One sentence for each bound that the numbers of a stage break; empty when it is healthy.

    Judged are the numbers that the stage has: one written by an earlier version has fewer.
    The kinetic energy is judged by its :func:`~morphofold.sim.dynamics.restlessness`.
    """
    judged = dict(stage)
    if "kinetic_over_strain" in stage:
        judged["kinetic_over_strain"] = restlessness(stage["growth"], stage["kinetic_over_strain"])
    told = [
        f"{name} {_told(judged[name])} at g = {stage['growth']:.2f} exceeds {bound:g}: {cure}"
        for name, (bound, cure) in BOUNDS.items()
        if name in judged and not judged[name] <= bound
    ]
    if not stage["lowest_J"] >= LEAST_J:
        told.append(
            f"lowest J {stage['lowest_J']:.2g} up to g = {stage['growth']:.2f} is below {LEAST_J:g}: refine the mesh "
            "(accuracy.level) or slow the growth down (growth.rate)"
        )
    return told


@njit(parallel=True, cache=True)
def _along_rays(verts, faces, bounds, order, directions):
    """Length of each ray inside the surface twice or more, and at all; winding number, at most and at its origin."""
    rays = len(directions)
    twice, once = np.zeros(rays), np.zeros(rays)
    most, centre = np.zeros(rays, dtype=np.int64), np.zeros(rays, dtype=np.int64)
    for r in prange(rays):
        at, sign = np.empty(64), np.empty(64)
        hits, centre[r] = ray_hits(verts, faces, bounds, order, np.zeros(3), directions[r], at, sign)
        if hits > len(at):
            at, sign = np.empty(hits), np.empty(hits)
            ray_hits(verts, faces, bounds, order, np.zeros(3), directions[r], at, sign)
        twice[r], once[r], most[r] = _lengths(at[:hits], sign[:hits])
    return twice, once, most, centre


@njit(cache=True)
def _lengths(at, sign):
    """Length of a ray inside twice or more, and at all, and the largest winding number, from outside in."""
    order = np.argsort(at)
    twice, once, most, winding = 0.0, 0.0, 0, 0
    for k in range(len(at) - 1, -1, -1):
        winding += int(sign[order[k]])
        length = at[order[k]] - (at[order[k - 1]] if k > 0 else 0.0)
        if length > TOUCHING * at[order[-1]]:
            most = max(most, winding)
            once += length if winding >= 1 else 0.0
            twice += length if winding >= 2 else 0.0
    return twice, once, most
