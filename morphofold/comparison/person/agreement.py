"""Agreement of two surfaces on one sphere, of sulci and gyri and of directions of folds, tested by spins.

Spins are random rotations of a sphere, the null hypothesis for maps whose neighbouring values are alike. A rotation
keeps how smooth a map is, and breaks its place (Alexander-Bloch and others 2018 [1]_). Points that are turned onto the
medial wall have no value and are left out.

References
----------
.. [1] Alexander-Bloch, Shou, Liu, Satterthwaite, Glahn, Shinohara, Vandekar, Raznahan. On testing for spatial
   correspondence between maps of human brain structure and function. NeuroImage 178, 540 (2018).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from morphofold.analysis.curvatures import curvature
from morphofold.analysis.multiple_tests import SIGNIFICANCE
from morphofold.arrays import Array, Bools, Ints
from morphofold.geometry import face_areas, unit
from morphofold.spheres.spins import NearestTable, p_value
from morphofold.surface import Faces, Surface
from morphofold.threads import one_blas_thread
from morphofold.unfolding.smooth_surface import SmoothSurface, tangents

FORWARD = np.array([0.0, 1.0, 0.0])  # to the front of the head, in the coordinates of FreeSurfer

SPINS = 500

#: numbers (K,) from the source vertex (N,) at each target point and the rotation (3, 3) that took it there
Statistic = Callable[[Ints, Array], Array]


@dataclass(frozen=True)
class Tested:
    """A number beside its values under spins, and beside the same number of a control.

    Attributes
    ----------
    value : float
    null_mean, null_sd : float
        Of its values under spins.
    p : float
        One-sided: (1 + spins with a value at least as large) / (1 + spins).
    control : float or None
        The same number of the control; None if the control has none.
    difference, low, high : float or None
        Value minus control, and its 95 % interval by spins.
    difference_p : float or None
        One-sided, of the difference under the same spins.
    """

    value: float
    null_mean: float
    null_sd: float
    p: float
    control: float | None = None
    difference: float | None = None
    low: float | None = None
    high: float | None = None
    difference_p: float | None = None

    @property
    def beats(self) -> bool:
        """Whether it is above spins and, if there is a control, also above the control, each with p < 0.05."""
        return max(self.p, self.difference_p or 0.0) < SIGNIFICANCE


@dataclass(frozen=True)
class Agreement:
    """An agreement of a grown cortex with the person: over the cortex, or of a measure over regions.

    Attributes
    ----------
    what : str
        ``depth`` and ``curvature`` are shares of area, ``axes`` is a mean cos 2 delta; any other is the measure of
        regions of which this is the rank correlation.
    tested, deepened : Tested
        With the smooth body as control, and with the smooth body whose dents are deepened.
    control_map, deepened_map : str or None
        Maps of these that agree best with the person; None over regions.
    n : int or None
        Number of regions.
    p_corrected : float or None
        Over regions, by Holm.
    given : bool
        Whether the body got the measure from the person, so that agreement is no result.
    """

    what: str
    tested: Tested
    deepened: Tested
    control_map: str | None = None
    deepened_map: str | None = None
    n: int | None = None
    p_corrected: float | None = None
    given: bool = False

    @property
    def verdict(self) -> str:
        """``"above control"``; ``"deepened"`` if it is no better than deepened dents of the smooth body; ``"above
        spins"`` where the smooth body can't have the measure; ``"given"``; ``"none"``."""
        if self.given:
            return "given"
        if not self.tested.beats or (self.p_corrected or 0.0) >= SIGNIFICANCE:
            return "none"
        if self.tested.difference is None:
            return "above spins"
        return "above control" if self.deepened.beats else "deepened"


@one_blas_thread()
def null_values(statistics: Sequence[Statistic], points: Array, table: NearestTable, turns: Array) -> list[Array]:
    """Each statistic (T, K) under T rotations (T, 3, 3) of the source below the target points (N, 3).

    Under the rotation R the target point s lies over the source point R^T s. Sums run in one thread: they are short,
    and the same on every machine.
    """
    samples = []
    for turn in turns:
        nearest = table(points @ turn)
        samples.append([statistic(nearest, turn) for statistic in statistics])
    return [np.stack(sample) for sample in zip(*samples)]


def best_controls(values: Array, null: Array) -> list[tuple[Tested, int]]:
    """Test the first of the values (1 + 2C,), with their values (T, 1 + 2C) under spins, against two sets of controls.

    These are the next C values and the last C. The control of a set is the largest; its number comes with the test.
    """
    tests = []
    for controls in np.arange(1, len(values)).reshape(2, -1):
        best = int(values[controls].argmax())
        at = controls[best]
        tests.append((compare_with_null(float(values[0]), null[:, 0], float(values[at]), null[:, at]), best))
    return tests


def compare_with_null(value: float, null: Array, control: float = np.nan, control_null: Array | None = None) -> Tested:
    """Compare a number with its values (T,) under spins, and with a control and its values under the same spins.

    Notes
    -----
    The difference D of two agreements with one person is paired: where grown and smooth body are in one class, both
    agree or neither does, so D counts only the vertices that growth moved to the other class, as in McNemar's test. If
    growth is ignorant of the person, these are as often right as wrong, or less often right where the smooth body was
    right before. The spins of the person turn the same map below both bodies, so they keep the smoothness of all three
    maps and the likeness of the two bodies, which gives D its spread about 0. The interval is D minus the percentiles
    of its null about their mean.

    On random maps 4.5 % of differences have p < 0.05, and 0 to 1.5 % if person and grown body share the smooth body and
    nothing else: D then varies less than under spins, so the test errs on the side of no result. A bootstrap over
    regions would be sharper, but needs regions that are independent, and there are only some thirty.

    Spins that leave no number (NaN) are not counted.
    """
    known = null[np.isfinite(null)]
    mean, sd = (float(known.mean()), float(known.std())) if len(known) else (np.nan, np.nan)
    against_spins = (value, mean, sd, p_value(value, known))
    if control_null is None or not np.isfinite(control):
        return Tested(*against_spins)
    differences = null - control_null
    differences = differences[np.isfinite(differences)]
    if not (np.isfinite(value) and len(differences)):
        return Tested(*against_spins, control)
    difference = value - control
    low, high = (difference - (np.percentile(differences, [97.5, 2.5]) - differences.mean())).tolist()
    return Tested(*against_spins, control, difference, low, high, p_value(difference, differences))


def weighted_median(values: Array, weights: Array) -> float:
    """Middle between the two values (N,) beside which half of the weight (N,) lies, so that no value is on it."""
    order = np.argsort(values, kind="stable")
    total = np.cumsum(weights[order])
    k = int(np.searchsorted(total, 0.5 * total[-1]))
    return float(0.5 * (values[order[k]] + values[order[min(k + 1, len(order) - 1)]]))


def classes(values: Array, weights: Array) -> Array:
    """1 where values (N,) are above their weighted median (gyrus), -1 below (sulcus), 0 where a value is NaN.

    The median and not 0, because a smooth body is convex nearly everywhere and has no sulcus by the sign of a number.
    With the median half of the area of each surface is gyrus, so that chance agrees on half of it.
    """
    known = np.isfinite(values) & (weights > 0)
    signs = np.zeros(len(values))
    if known.any():
        signs[known] = np.sign(values[known] - weighted_median(values[known], weights[known]))
    return signs


def agreement_of_classes(bodies: Sequence[Array], person: Array, weights: Array) -> Statistic:
    """Share of the area on which each of K bodies has the person's class.

    Parameters
    ----------
    bodies : sequence of (P,) float64
        :func:`classes` at the target points. Points at which one of them is 0 are left out for all, so that shares are
        paired.
    person : (N,) float64
        Classes at the source vertices.
    weights : (P,) float64
        Area of the target points.

    Returns
    -------
    function of (nearest, turn) to (K,) float64
        0.5, which is chance, if there is no area.
    """
    signed = np.stack(bodies)
    signed = signed * (weights * (signed != 0).all(axis=0))
    size = np.abs(signed[0])

    def statistic(nearest: Ints, turn: Array) -> Array:
        person_classes = person[nearest]
        area = size @ np.abs(person_classes)
        return 0.5 + 0.5 * (signed @ person_classes) / area if area > 0 else np.full(len(signed), 0.5)

    return statistic


def agreement_of_axes(
    bodies: Sequence[tuple[Array, Array]], person: tuple[Array, Array], weights: Array, points: Array
) -> Statistic:
    """Mean of cos 2 delta, with the angle delta between the fold axes of each of K bodies and the person.

    Parameters
    ----------
    bodies : sequence of (axes (P, 3), strengths (P,))
        Unit vectors along the sphere at the target points, without sign, and how clear they are, 0 to 1.
    person : axes (N, 3), strengths (N,)
        At the source vertices.
    weights : (P,) float64
        Area of the target points.
    points : (P, 3) float64
        Target points on the unit sphere.

    Returns
    -------
    function of (nearest, turn) to (K,) float64
        1 where axes are the same, 0 by chance, -1 at right angles. Weights are area times both strengths.
    """
    both = np.prod([strength > 0 for _, strength in bodies], axis=0)

    def statistic(nearest: Ints, turn: Array) -> Array:
        turned = person[0][nearest] @ turn.T
        turned = turned - np.einsum("pi,pi->p", turned, points)[:, None] * points  # the nearest vertex is a little off
        length = np.einsum("pi,pi->p", turned, turned)
        clear = weights * both * person[1][nearest]
        means = []
        for axes, strength in bodies:
            cosine = np.einsum("pi,pi->p", turned, axes) ** 2
            share = np.divide(cosine, length, out=np.full(len(length), 0.5), where=length > 0)
            area = clear * strength
            means.append((area @ (2 * share - 1)) / area.sum() if area.sum() > 0 else 0.0)
        return np.array(means)

    return statistic


def fold_axes(surface: Surface, points: Array, scale: float, cortex: Bools) -> tuple[Array, Array]:
    """Fold axes of a surface on its sphere.

    Parameters
    ----------
    surface : Surface
        N vertices [mm].
    points : (N, 3) float64
        The same vertices on the unit sphere.
    scale : float
        Radius of the neighbourhood of curvature [mm].
    cortex : (N,) bool
        Elsewhere the strength is 0.

    Returns
    -------
    axes : (N, 3) float64
        Unit vectors along the sphere, without sign.
    strengths : (N,) float64
        ``(|ka| - |kb|) / (|ka| + |kb|)`` of the larger and the smaller principal curvature: 1 on a cylinder, 0 on a
        sphere or a symmetric saddle.

    Notes
    -----
    The axis is the direction of the principal curvature that is smaller in size: the curvature is small along a fold
    and large across it, be it a gyrus or a sulcus.
    """
    bent = curvature(surface.verts, surface.faces, scale)
    along = np.where((np.abs(bent.k1) >= np.abs(bent.k2))[:, None], bent.d2, bent.d1)
    known = np.isfinite(along).all(axis=1) & np.isfinite(bent.k1 + bent.k2) & cortex
    axes = pulled_back(np.where(known[:, None], along, 0.0), surface.verts, surface.faces, points)
    return axes, np.where(known & axes.any(axis=1), _strength(bent.k1, bent.k2), 0.0)


def smooth_axes(surface: SmoothSurface, points: Array) -> tuple[Array, Array]:
    """As :func:`fold_axes`, of a smooth surface at points (N, 3) of the unit sphere, where they are exact."""
    frame = surface.frame(points)
    metric = frame.along @ frame.along.swapaxes(1, 2)
    bend = np.einsum("pki,pmi->pkm", frame.turning, frame.along)
    inverse = np.linalg.inv(np.linalg.cholesky(metric))
    k, turned = np.linalg.eigh(inverse @ (0.5 * (bend + bend.swapaxes(1, 2))) @ inverse.swapaxes(1, 2))
    smaller = np.abs(k).argmin(axis=1)
    mixed = np.einsum("pkm,pk->pm", inverse, turned[np.arange(len(points)), :, smaller])
    return unit(np.einsum("pm,pmi->pi", mixed, tangents(points))), _strength(k[:, 1], k[:, 0])


def pulled_back(vectors: Array, verts: Array, faces: Faces, points: Array) -> Array:
    """Directions (N, 3) at the vertices of a surface, on its sphere with vertices ``points`` (N, 3): unit vectors.

    Each triangle is mapped linearly to its triangle on the sphere; a vertex has the mean of its triangles by area on
    the surface. Zero where no triangle has area.
    """
    ones, twos = (verts[faces[:, k]] - verts[faces[:, 0]] for k in (1, 2))
    on_sphere = [points[faces[:, k]] - points[faces[:, 0]] for k in (1, 2)]
    a, b, c = (np.einsum("fi,fi->f", *pair) for pair in ((ones, ones), (ones, twos), (twos, twos)))
    whole, area = a * c - b * b, face_areas(verts, faces)
    weight = np.divide(area, whole, out=np.zeros(len(faces)), where=whole > 0)
    total = np.zeros_like(points)
    for k in range(3):
        v = vectors[faces[:, k]]
        p, q = np.einsum("fi,fi->f", v, ones), np.einsum("fi,fi->f", v, twos)
        image = (c * p - b * q)[:, None] * on_sphere[0] + (a * q - b * p)[:, None] * on_sphere[1]
        for axis in range(3):
            total[:, axis] += np.bincount(faces[:, k], weight * image[:, axis], len(points))
    return unit(total - np.einsum("ni,ni->n", total, points)[:, None] * points)


def forwardness(axes: Array, strengths: Array, surface: SmoothSurface, points: Array, weights: Array) -> float:
    """Mean of cos 2a on the smooth body, with the angle a between the fold axis and the front-back axis.

    1: folds run from front to back, -1: across, 0: no preferred direction. Weights are area times strength times the
    length of the front-back axis along the surface, which is 0 at the poles of the brain.
    """
    frame = surface.frame(points)
    mixed = np.einsum("pmi,pi->pm", tangents(points), axes)
    along = unit(np.einsum("pm,pmi->pi", mixed, frame.along))
    ahead = FORWARD - (frame.normal @ FORWARD)[:, None] * frame.normal
    weight = weights * strengths * np.linalg.norm(ahead, axis=1)
    cosine = np.einsum("pi,pi->p", along, unit(ahead))
    return float(weight @ (2 * cosine**2 - 1) / weight.sum()) if weight.sum() > 0 else float("nan")


def _strength(k1: Array, k2: Array) -> Array:
    """Difference over sum of the sizes of two curvatures; 0 where both are 0 or one is NaN."""
    large, small = np.maximum(np.abs(k1), np.abs(k2)), np.minimum(np.abs(k1), np.abs(k2))
    return np.divide(large - small, large + small, out=np.zeros(len(k1)), where=large + small > 0)
