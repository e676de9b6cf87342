"""Whether folds stand where the person's do: heights in a band of harmonic degrees, and the valleys between them.

Harmonics of degree 1 to 6 are the shape of the body, which a grown cortex has from the person it grew from: they are a
third to two thirds of the variance of the height, and say nothing about folds. So the height of folds is compared in
the degrees 7 to 30 of the sphere, whole and in bands. ``compare_person`` calls it.
"""

from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np
from scipy.spatial import cKDTree

from morphofold.comparison.person.common_sphere import Bodies
from morphofold.comparison.person.person_agreement import Statistic
from morphofold.digests_and_json import Row
from morphofold.frozen_arrays import Array, Bools, Ints
from morphofold.quantities import RELIEF
from morphofold.shapes import even_directions
from morphofold.spheres.spins import NearestTable
from morphofold.unfolding.harmonics import Expansion, degrees, fit, tangents

FOLD_DEGREES = (7, 30)
COMPARED = ("grown", "smooth", "deepened")  # bodies, with the person
BANDS = ((7, 11), (12, 16), (17, 22), (23, 30))
MOST_FITTED_VERTICES = 30_000  # more take longer and give the same 961 coefficients
HEIGHT_PENALTY = 1e-4  # of the harmonics, times l (l + 1): it bounds them on the medial wall, which has no height
VALLEY_POINTS = 20_000  # directions at which valleys are looked for: 1.25 mm apart on a body with a radius of 50 mm
LINE_PLACES = 40_000  # directions at which the distance to a line is known: 0.9 mm apart on such a body
VALLEY_DISTANCE_MM = 3.0  # of the person


def fold_heights(points: Array, heights: Array, weights: Array, degree: int = FOLD_DEGREES[1]) -> Expansion:
    """Harmonics up to ``degree`` of heights (N,), NaN where unknown, at points (N, 3) with weights (N,) of area."""
    rows = slice(None, None, -(-len(points) // MOST_FITTED_VERTICES))
    known = np.where(np.isfinite(heights), weights, 0.0)[rows]
    filled = np.nan_to_num(heights)[rows]
    mean = float(np.average(filled, weights=known)) if known.any() else 0.0
    return fit(points[rows], (filled - mean)[:, None], known, degree, HEIGHT_PENALTY)


def band(heights: Expansion, low: int = FOLD_DEGREES[0], high: int = FOLD_DEGREES[1]) -> Expansion:
    """The part of an expansion in the degrees from ``low`` to ``high``."""
    l = degrees(heights.degree)
    return Expansion(np.where((l >= low) & (l <= high), heights.coefficients.T, 0.0).T)


def heights_of_bodies(bodies: Bodies) -> dict[str, Expansion]:
    """Heights of the folds of person, grown, smooth and deepened body, in degrees up to 30."""
    grown, person = bodies.grown, bodies.person
    maps = {"grown": grown.measures.maps} | {name: control.maps for name, control in bodies.controls.items()}
    heights = {name: fold_heights(grown.points, each[RELIEF], grown.weights) for name, each in maps.items()}
    return {"person": fold_heights(person.points, person.measures.maps[RELIEF], person.weights)} | heights


def agreement_of_heights(bodies: Bodies, heights: Mapping[str, Expansion], low: int, high: int) -> Statistic:
    """Correlation over the cortex of heights in a band of degrees: of grown, smooth and deepened body with the person.

    Weighted by the area of the smooth body.
    """
    points, weights = bodies.grown.points, bodies.grown.weights
    bands = {name: band(expansion, low, high) for name, expansion in heights.items()}
    body_heights = np.stack([bands[name](points)[:, 0] for name in COMPARED])
    person_heights, is_person_cortex = bands["person"](bodies.person.points)[:, 0], bodies.person.cortex

    def statistic(nearest: Ints, rotation: Array) -> Array:
        return weighted_correlations(body_heights, person_heights[nearest], weights * is_person_cortex[nearest])

    return statistic


def bands_of(bodies: Bodies, heights: Mapping[str, Expansion]) -> tuple[Row, ...]:
    """Correlation of heights with the person in each band of degrees: of grown, smooth and deepened body."""
    nearest = bodies.to_grown.nearest
    return tuple(
        {"low": low, "high": high}
        | dict(zip(COMPARED, agreement_of_heights(bodies, heights, low, high)(nearest, np.eye(3)).tolist()))
        for low, high in BANDS
    )


def same_side(bodies: Bodies, heights: Mapping[str, Expansion]) -> Array:
    """1 where person and grown cortex are both gyrus or both sulcus, -1 where not, at the grown vertices (N,)."""
    grown, person = (band(heights[name])(bodies.grown.points)[:, 0] for name in ("grown", "person"))
    return np.where(bodies.grown.cortex, np.sign(grown * person), np.nan)


def weighted_correlations(x: Array, y: Array, weights: Array) -> Array:
    """Correlations (K,) of rows (K, P) with y (P,) by weights (P,); 0 for a row or a y without spread."""
    total = weights.sum()
    if not total > 0:
        return np.zeros(len(x))
    x, y = x - (x @ weights / total)[:, None], y - y @ weights / total
    norms = np.sqrt((x * x @ weights) * (y * y @ weights))
    correlations: Array = np.divide(x @ (weights * y), norms, out=np.zeros(len(x)), where=norms > 0)
    return correlations


def valley_directions(heights: Expansion) -> Array:
    """Unit directions (V, 3) in the valleys of a height: where it is least along the direction in which it bends most.

    Of ``VALLEY_POINTS`` even directions, those within half their spacing of such a line, so that its points are in
    proportion to its length. The bend there must be more than half of what a wave with this slope has at its bottom: on
    the flank of a wave hardly anything bends, and nothing is least.
    """
    points = even_directions(VALLEY_POINTS)
    first = heights.gradient()
    slopes, second = first(points), first.gradient()(points).reshape(-1, 3, 3)
    tangent_pairs = tangents(points)
    slope = np.einsum("pkr,pr->pk", tangent_pairs, slopes)
    hessian = np.einsum("pkq,pqr,pmr->pkm", tangent_pairs, second, tangent_pairs, optimize=True)
    hessian -= np.eye(2) * np.einsum("pr,pr->p", slopes, points)[:, None, None]
    bends, axes = np.linalg.eigh(hessian)
    strongest, across = bends[:, 1], axes[:, :, 1]
    offset = np.abs(np.einsum("pk,pk->p", slope, across)) / np.maximum(strongest, 1e-30)
    l, power = degrees(heights.degree), (heights.coefficients**2).sum(axis=1)
    slope_as_bend = np.sqrt(np.average(l * (l + 1), weights=power)) * np.linalg.norm(slopes, axis=1)
    is_valley = (strongest > np.abs(bends[:, 0])) & (offset < 0.5 * np.sqrt(4 * np.pi / VALLEY_POINTS))
    is_valley &= strongest > 0.5 * np.hypot(strongest, slope_as_bend)
    valleys: Array = points[is_valley & (heights(points)[:, 0] < 0)]
    return valleys


def agreement_of_lines(bodies: Bodies, lines: Sequence[Array], person_line: Array) -> Statistic:
    """Share of a line of the person that lies within 3 mm of the lines of K bodies; NaN for a body without a line.

    Parameters
    ----------
    lines : sequence of (V, 3) float64
        Unit directions of points of the line of each body.
    person_line : (W, 3) float64
        Of the person, on the cortex.

    Notes
    -----
    Distances are straight ones on the smooth body, at the size of the person's hull.
    """
    places, grown = even_directions(LINE_PLACES), bodies.grown
    is_cortex, positions = grown.cortex[cKDTree(grown.points).query(places)[1]], bodies.smooth(places)
    is_near = np.full((len(lines), len(places)), np.nan)
    for row, line in zip(is_near, lines):
        if len(line):
            row[:] = cKDTree(bodies.smooth(line)).query(positions)[0] <= VALLEY_DISTANCE_MM
    place_of = NearestTable(places)

    def statistic(nearest: Ints, rotation: Array) -> Array:
        turned = place_of(person_line @ rotation.T)
        turned = turned[is_cortex[turned]]
        return is_near[:, turned].mean(axis=1) if len(turned) else np.full(len(lines), np.nan)

    return statistic


def agreement_of_valleys(bodies: Bodies, heights: Mapping[str, Expansion]) -> Statistic:
    """Share of the person's valleys within 3 mm of those of grown, smooth and deepened body."""
    on_cortex = partial(_on_cortex, bodies.person.points, bodies.person.cortex)
    lines = {name: valley_directions(band(expansion)) for name, expansion in heights.items()}
    return agreement_of_lines(bodies, [lines[n] for n in COMPARED], on_cortex(lines["person"]))


def agreement_of_crests(bodies: Bodies) -> Statistic | None:
    """Share of the crests of the person's gyral net within 3 mm of those of the grown cortex; None without both nets.

    The smooth bodies have none.
    """
    crests = []
    for body in (bodies.person, bodies.grown):
        graph = body.measures.graph
        edges = [] if graph is None else [edge["vertices"] for *_, edge in graph.edges(data=True)]
        crests.append(body.points[np.unique(np.concatenate(edges))] if edges else np.empty((0, 3)))
    if not all(map(len, crests)):
        return None
    nothing = np.empty((0, 3))
    return agreement_of_lines(bodies, [crests[1], nothing, nothing], crests[0])


def _on_cortex(points: Array, cortex: Bools, directions: Array) -> Array:
    """Those of the directions (V, 3) whose nearest vertex is cortex."""
    nearest: Ints = cKDTree(points).query(directions)[1]
    return directions[cortex[nearest]]
