"""Checks of every stage: rest, volume, self-intersections and overall shape, independent of the solver."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from morphofold.errors import InsideOut, OpenSurface
from morphofold.frozen_arrays import Array, Ints
from morphofold.geometry import position
from morphofold.intersections.box_tree import box_tree, ray_hits
from morphofold.intersections.intersection import self_intersections
from morphofold.kernels import kernel, reading
from morphofold.shapes import even_directions
from morphofold.sim.dynamics import restlessness
from morphofold.surface import Faces, Surface
from morphofold.threads import in_blocks

if TYPE_CHECKING:
    from morphofold.sim.scene import Scene

NUMBER_OF_RAYS = 10_000
TOUCHING_LENGTH_SHARE = 1e-9  # segments of a ray shorter than this share of its length are ignored

#: allowed depth of a self-intersection [mean edges]: less than the gap at which contact begins to act
CROSSING_TOLERANCE = 0.1

#: the bound of rest, and its value for a healthy stage: less than between the folds of two seeds, 0.7 to 1.3
REST_BOUND, LARGEST_REST_DISTANCE_OVER_T = "distance_over_T", 0.4

#: largest values of a healthy stage, and what to change if a value is larger: keys of ``cures``
BOUNDS: dict[str, tuple[float | int, tuple[str, ...]]] = {
    REST_BOUND: (LARGEST_REST_DISTANCE_OVER_T, ("patience", "stages")),
    "cell_over_T": (0.8, ("finer",)),  # meshes that were compared with finer ones have 0.77 at most (docs/accuracy.md)
    "cell_over_wave": (0.125, ("finer",)),  # linear elements miss (2 pi cell / wave)^2 / 12 of its energy, here 5 %
    "kinetic_over_strain": (1e-2, ("slower",)),
    "overlap": (2e-3, ("contact", "finer")),
    "winding_max": (1, ("contact", "slower")),
    "crossings": (0, ("contact", "corners", "finer")),
    "deepest_crossing": (CROSSING_TOLERANCE, ("contact", "corners", "slower", "finer")),
    "volume_drift": (3e-2, ("slower", "kappa", "finer")),
    "bending": (0.1, ("hold",)),
    "unstable_modes": (0, ("slower", "stages")),
}
LEAST_J = 0.05  # smallest volume ratio of any Gauss point at any time; below 0.1 the material is frozen


#: advice by key
CURES = {
    "slower": "slow the growth down (growth.rate)",
    "patience": "hold stages for longer (output.patience)",
    "stages": "let the body rest more often (output.stages)",
    "contact": "add [effects.contact]",
    "corners": "add [effects.corner_barrier]",
    "finer": "refine the mesh (accuracy.level)",
    "kappa": "raise material.kappa_ratio",
    "hold": "cut the body by symmetry planes (geometry.portion)",
}


def cures(scene: Scene | None = None) -> dict[str, str]:
    """Advice by key; for a ``scene``, only what it does not do yet and what its geometry allows."""
    advice = dict(CURES)
    if scene is None:
        return advice
    geometry, effects = scene.geometry, scene.effects
    is_mesh_file = geometry.shape == "mesh"
    if "contact" in effects:
        del advice["contact"]
    if "contact" not in effects or "corner_barrier" in effects or is_mesh_file:
        del advice["corners"]
    if scene.real_time:
        advice["slower"] = "slow the growth down (effects.inertia.duration)"
        del advice["stages"]
    if geometry.shape == "cortex":
        wall_names = ("skull", "midline") if geometry.held == "medial wall" else ("skull",)
        walls_text = " and ".join(f"[effects.{name}]" for name in wall_names if name not in effects)
        advice["hold"] = f"add {walls_text}" if walls_text else "use a thinner cortex (geometry.cortex_thickness)"
    if is_mesh_file:
        advice |= {"finer": "use a finer mesh (geometry.file)", "hold": "hold the inner surface (geometry.held)"}
    elif scene.accuracy.level in ("fine", "finest") or scene.accuracy.edge is not None:
        advice["finer"] = "refine the mesh (accuracy.edge)"
    return advice


def check_surface(pial: Surface, closed: bool = True, n_tested: int | None = None) -> dict[str, float | int]:
    """Health numbers of the pial surface of a stage; overlap and winding number only if it is ``closed``.

    Only the first ``n_tested`` vertices are tested for having passed through it: the others are their mirror images.

    Returns
    -------
    dict
        ``overlap`` and ``winding_max`` (:func:`cover`); ``crossings``, the number of edges and vertices that have
        passed through the surface by more than CROSSING_TOLERANCE; ``deepest_crossing``, the depth of the deepest
        crossing in mean edges; ``mean_edge_mm``.
    """
    crossings = self_intersections(pial, n_tested=n_tested)
    return {
        **(dict(zip(("overlap", "winding_max"), cover(pial))) if closed else {}),
        "crossings": crossings.deeper_than(CROSSING_TOLERANCE),
        "deepest_crossing": crossings.deepest_share,
        "mean_edge_mm": crossings.mean_edge,
    }


def cover(surface: Surface, rays: int = NUMBER_OF_RAYS) -> tuple[float, int]:
    """How often a closed surface winds around the points of radial rays; the solver's contact is not used.

    Returns the length inside the surface twice or more, over the length inside it once or more; and the largest winding
    number on any ray, 1 if the surface does not self-intersect.

    Rays start at the centroid of the vertices. Their directions are a Fibonacci lattice. A ray that meets an edge or a
    vertex counts as turned by an infinitesimal angle, in the same direction for all faces
    (:func:`morphofold.intersections.box_tree.ray_hits`). A segment shorter than 1e-9 of the ray, as between walls that
    touch, is not counted.

    Raises
    ------
    ValueError
        If the surface has a hole (the winding number at the centroid differs between rays), or nothing is inside.
    """
    centred_verts = surface.verts - surface.verts.mean(axis=0)
    twice_lengths, once_lengths, max_windings, centre = along_rays(centred_verts, surface.faces, even_directions(rays))
    if (centre != centre[0]).any():
        raise OpenSurface(
            f"{surface.name}: is not closed: its winding number at the centroid is {centre.min()} to {centre.max()}, "
            "depending on the direction of the ray. Close its holes."
        )
    if once_lengths.sum() == 0:
        raise InsideOut(
            f"{surface.name}: none of {rays} rays from its centroid runs inside it. Reverse its faces: seen from "
            "outside they must run counter-clockwise."
        )
    return float(twice_lengths.sum() / once_lengths.sum()), int(max_windings.max())


def along_rays(verts: Array, faces: Faces, directions: Array) -> tuple[Array, Array, Ints, Ints]:
    """Length of each ray from the origin inside twice or more, and once or more; largest winding number, and that at
    the origin, (R,) each."""
    tree, (twice_lengths, once_lengths) = box_tree(verts, faces), np.zeros((2, len(directions)))
    winding = np.zeros((len(directions), 2), dtype=np.int64)
    kernel_inputs = reading(verts, faces, tree.bounds, tree.order, directions)
    in_blocks(_cover_along_rays, len(directions), *kernel_inputs, twice_lengths, once_lengths, winding)
    return twice_lengths, once_lengths, *winding.T


def enclosed_volume(surface: Surface) -> float:
    """Volume inside a closed surface with outward faces [mm^3], by the divergence theorem."""
    a, b, c = (surface.verts[surface.faces[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


def bending(X: Array, x: Array) -> float:
    """How much a body has bent or warped as a whole; folds and size do not count.

    Parameters
    ----------
    X, x : (N, 3) float64
        Positions of its surface before and after [mm].

    Returns
    -------
    float
        Rms of the quadratic part of the least-squares quadratic map from X to x, over the rms distance of x from its
        centre. 0 for any affine map, and for a sphere whose shells grow differently.
    """
    centred_X = X - X.mean(axis=0)
    i, j = np.triu_indices(3)
    affine_terms = np.column_stack([np.ones(len(X)), centred_X])
    quadratic_terms = centred_X[:, i] * centred_X[:, j]
    quadratic_terms -= affine_terms @ np.linalg.lstsq(affine_terms, quadratic_terms, rcond=None)[0]
    bent_displacement = quadratic_terms @ np.linalg.lstsq(quadratic_terms, x - x.mean(axis=0), rcond=None)[0]
    return float(np.sqrt(np.sum(bent_displacement**2) / np.sum((x - x.mean(axis=0)) ** 2)))


def not_at_rest(stages: Sequence[Mapping[str, Any]]) -> list[str]:
    """One text, if any of the stages is known not to be at rest: which, how far from it, and which leave a saddle, of
    which no motion tells how far they will go."""
    saddle_text = lambda row: ", leaving a saddle" if row.get("leaving_saddle") else ""
    texts = [
        f"{row['growth']:.2f} ({row['distance_over_T']:.2f} T{saddle_text(row)})"
        for row in stages
        if row.get("at_rest") is False
    ]
    return [f"not at rest at g = {', '.join(texts)}"] if texts else []


def broken_bounds(stage: dict[str, Any], scene: Scene | None = None) -> list[str]:
    """One sentence for each bound that the numbers of a stage exceed; empty if the stage is healthy.

    Only numbers that the stage has are checked: a stage written by an earlier version has fewer, and None was not
    measured. The kinetic energy is checked by its :func:`~morphofold.sim.dynamics.restlessness`. The advice is for the
    ``scene``.
    """
    texts = cures(scene)
    advise = lambda keys: " or ".join(texts[key] for key in keys if key in texts) or "the solver does not resolve it"
    sentences, growth_text = [], f"g = {stage['growth']:.2f}"
    for name, (bound, keys) in BOUNDS.items():
        value = stage.get(name)
        if value is not None and name == "kinetic_over_strain":
            value = restlessness(stage["growth"], value)
        if value is not None and not value <= bound:
            value_text = f"{value:,}" if isinstance(value, int) else f"{value:.2g}"
            sentences.append(f"{name} {value_text} at {growth_text} exceeds {bound:g}: {advise(keys)}")
    if not (J := stage["lowest_J"]) >= LEAST_J:
        sentences.append(f"lowest J {J:.2g} up to {growth_text} is below {LEAST_J:g}: {advise(('finer', 'slower'))}")
    return sentences


@kernel
def _cover_along_rays(start, stop, verts, faces, box_bounds, order, directions, twice_lengths, once_lengths, winding):
    """As ``along_rays``; the winding numbers are (R, 2)."""
    hit_distances, hit_signs = np.empty(64), np.empty(64)
    origin = (0.0, 0.0, 0.0)
    for ray in range(start, stop):
        direction = position(directions, ray)
        n_hits, winding[ray, 1] = ray_hits(verts, faces, box_bounds, order, origin, direction, hit_distances, hit_signs)
        if n_hits > len(hit_distances):
            hit_distances, hit_signs = np.empty(n_hits), np.empty(n_hits)
            ray_hits(verts, faces, box_bounds, order, origin, direction, hit_distances, hit_signs)
        for hit in range(1, n_hits):  # sorted outwards
            for place in range(hit, 0, -1):
                if hit_distances[place - 1] <= hit_distances[place]:
                    break
                hit_distances[place - 1], hit_distances[place] = hit_distances[place], hit_distances[place - 1]
                hit_signs[place - 1], hit_signs[place] = hit_signs[place], hit_signs[place - 1]
        winding_number = 0
        for hit in range(n_hits - 1, -1, -1):
            winding_number += int(hit_signs[hit])
            segment_length = hit_distances[hit] - (hit_distances[hit - 1] if hit > 0 else 0.0)
            if segment_length > TOUCHING_LENGTH_SHARE * hit_distances[n_hits - 1]:
                winding[ray, 0] = max(winding[ray, 0], winding_number)
                once_lengths[ray] += segment_length if winding_number >= 1 else 0.0
                twice_lengths[ray] += segment_length if winding_number >= 2 else 0.0
