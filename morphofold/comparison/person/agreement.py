"""Agreement of two surfaces on one sphere, tested by spins: of sulci and gyri, of directions of folds, and of regions.

Spins are random rotations of a sphere, the null hypothesis for maps whose neighbouring values are alike. A rotation
keeps how smooth a map is, and breaks its place (Alexander-Bloch and others 2018 [1]_). Points that are turned onto the
medial wall have no value and are left out.

References
----------
.. [1] Alexander-Bloch, Shou, Liu, Satterthwaite, Glahn, Shinohara, Vandekar, Raznahan. On testing for spatial
   correspondence between maps of human brain structure and function. NeuroImage 178, 540 (2018).
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.stats import rankdata

from morphofold.analysis.curvatures import curvature
from morphofold.analysis.graph.hinges import counts
from morphofold.analysis.multiple_tests import SIGNIFICANCE, holm
from morphofold.arrays import Array, Bools, Ints
from morphofold.comparison.person.bodies import Bodies, Body, centred
from morphofold.geometry import face_areas, unit, vertex_areas
from morphofold.mesh_quality.checks import is_no_cortex
from morphofold.provenance import json_value
from morphofold.quantities import find
from morphofold.spheres.spins import NearestTable, p_value
from morphofold.surface import Faces, Surface
from morphofold.threads import one_blas_thread
from morphofold.unfolding.smooth_surface import SmoothSurface, tangents

FORWARD = np.array([0.0, 1.0, 0.0])  # to the front of the head, in the coordinates of FreeSurfer

SPINS = 500
LEAST_REGIONS = 5  # for a correlation
LEAST_COVERED_SHARE = 0.5  # of the points of a region that must be cortex after a spin

#: columns of a table of regions
REGION_MEASURES = (
    "gyrification_index",
    "sulcal_depth_mm",
    "gyral_thickness_mm",
    "cortical_thickness_mm",
    "hinges_per_cm2",
    "area_expansion",
)
#: those that the smooth body has, too, and its map of each
SMOOTH_MAPS = {"gyrification_index": "local_gyrification_index", "sulcal_depth_mm": "sulcal_depth"}
#: map that a body was given -> measure of regions that it has from it
MEASURES_OF_GIVEN_MAPS = {"thickness_map": "cortical_thickness_mm", "growth_map": "area_expansion"}

#: numbers (K,) from the source vertex (N,) at each target point and the rotation (3, 3) that took it there
Statistic = Callable[[Ints, Array], Array]
Axes = tuple[Array, Array]  # fold axes (N, 3) without sign, and how clear they are (N,)


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


def agreement_with_controls(
    what: str, values: Array, null: Array, maps: Sequence[str | None] = (None,), **more: Any
) -> Agreement:
    """Test the first of the values (1 + 2C,), with their values (T, 1 + 2C) under spins, against two sets of controls.

    These are the next C values, of the smooth body, and the last C, of the deepened one, each of C ``maps``. The
    control of a set is the largest.
    """
    tests, best_maps = [], []
    for controls in np.arange(1, len(values)).reshape(2, -1):
        best = int(values[controls].argmax())
        at = controls[best]
        tests.append(compare_with_null(float(values[0]), null[:, 0], float(values[at]), null[:, at]))
        best_maps.append(maps[best])
    return Agreement(what, tests[0], tests[1], best_maps[0], best_maps[1], **more)


def compare_with_null(
    value: float, null: Array, control: float = np.nan, control_null: Array | float = np.nan
) -> Tested:
    """Compare a number with its values (T,) under spins, and with a control and its values under the same spins.

    The control is NaN if the body has none.

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
    of_spins, differences = (v[np.isfinite(v)] for v in (null, null - control_null))
    mean, sd = (float(of_spins.mean()), float(of_spins.std())) if len(of_spins) else (np.nan, np.nan)
    tested = Tested(value, mean, sd, p_value(value, of_spins), control if np.isfinite(control) else None)
    difference = value - control
    if not (np.isfinite(difference) and len(differences)):
        return tested
    low, high = (difference - (np.percentile(differences, [97.5, 2.5]) - differences.mean())).tolist()
    p = p_value(difference, differences)
    return replace(tested, difference=difference, low=low, high=high, difference_p=p)


def classes(values: Array, weights: Array) -> Array:
    """1 where values (N,) are above their weighted median (gyrus), -1 below (sulcus), 0 where a value is NaN.

    The median and not 0, because a smooth body is convex nearly everywhere and has no sulcus by the sign of a number.
    With the median half of the area of each surface is gyrus, so that chance agrees on half of it.
    """
    return np.nan_to_num(np.sign(centred(values, weights))) * (weights > 0)


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


def agreement_of_axes(bodies: Sequence[Axes], person: Axes, weights: Array, points: Array) -> Statistic:
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


def fold_axes(surface: Surface, points: Array, scale: float, cortex: Bools) -> Axes:
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


def smooth_axes(surface: SmoothSurface, points: Array) -> Axes:
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


# regions -----------------------------------------------------------------------------------------------------


#: what the numbers of regions are made of, by measure: a pair (N,), (N,) whose sums in a region are divided, or values
#: (N,) of which a region has the median, NaN where there is none
Fields = Mapping[str, Array | tuple[Array, Array]]


@dataclass(frozen=True, eq=False)
class RegionNumbers:
    """Numbers of R regions in a person, the smooth and the grown body.

    Attributes
    ----------
    names : tuple of str
    labels : (N,) int64
        Regions of the person's vertices, -1 off the cortex and where there is none.
    numbers : mapping of "person", "smooth" and "grown" to (K, R) float64
        The :data:`REGION_MEASURES` of each; NaN where a body does not have one.
    fields : sequence of Fields
        Of the grown, the smooth and the deepened smooth body.
    """

    names: tuple[str, ...]
    labels: Ints
    numbers: Mapping[str, Array]
    fields: Sequence[Fields]

    def correlations(self, weights: Array) -> Statistic:
        """Rank correlations over regions of the person with each of the three bodies, under spins of the labels.

        Bodies that have a measure get the same regions.

        Parameters
        ----------
        weights : (P,) float64
            Area of the target points, 0 off the cortex.

        Returns
        -------
        function of (nearest, turn) to (3, K) float64
            Regions with less than half of their points on the cortex are left out, as in a spin onto the medial wall.
        """
        count = len(self.names)

        def statistic(nearest: Ints, turn: Array) -> Array:
            labels = self.labels[nearest]
            on_cortex = np.where(weights > 0, labels, -1)
            points, covered = (np.bincount(at[at >= 0], minlength=count) for at in (labels, on_cortex))
            enough = np.where(covered >= LEAST_COVERED_SHARE * points, 0.0, np.nan)
            numbers = np.stack([region_numbers(on_cortex, count, fields) for fields in self.fields]) + enough
            known = np.isfinite(numbers)
            unshared = (~known & known.any(axis=2, keepdims=True)).any(axis=0)
            numbers[:, unshared] = np.nan
            return np.array([list(map(spearman, self.numbers["person"], body)) for body in numbers])

        return statistic

    def agreements(self, values: Array, null: Array, maps: Collection[str]) -> tuple[Agreement, ...]:
        """Correlations (3, K) with their values (T, 3, K) under spins, of the measures that person and grown body have.

        Holm's correction is over these, without those that the grown body has from ``maps`` of the person.
        """
        given = {MEASURES_OF_GIVEN_MAPS.get(name) for name in maps}
        both = np.isfinite(self.numbers["person"] + self.numbers["grown"]).sum(axis=1).tolist()
        rows = [
            agreement_with_controls(key, values[:, k], null[:, :, k], n=both[k], given=key in given)
            for k, key in enumerate(REGION_MEASURES)
            if np.isfinite(values[0, k])
        ]
        corrected = iter(holm(np.array([row.tested.p for row in rows if not row.given])).tolist())
        return tuple(replace(row, p_corrected=row.tested.p if row.given else next(corrected)) for row in rows)

    def table(self, hemi: str) -> tuple[dict[str, Any], ...]:
        """A row for each region of the person that has vertices: each measure of person, smooth and grown body."""
        columns = {
            f"{body}_{key}": numbers[k].tolist()
            for k, key in enumerate(REGION_MEASURES)
            for body, numbers in self.numbers.items()
            if body != "smooth" or key in SMOOTH_MAPS
        }
        return tuple(
            {"hemi": hemi, "region": self.names[r]} | {column: json_value(v[r]) for column, v in columns.items()}
            for r in np.unique(self.labels[self.labels >= 0]).tolist()
        )


def numbers_of_bodies(bodies: Bodies) -> RegionNumbers | None:
    """Numbers of the person's regions in all bodies; None without regions."""
    regions, person, grown = bodies.person.measures.cortex.regions, bodies.person, bodies.grown
    if regions is None:
        return None
    no_cortex = [k for k, name in enumerate(regions.names) if is_no_cortex(name)]
    labels = np.where(person.cortex & ~np.isin(regions.labels, no_cortex), regions.labels, -1)
    at_grown = np.where(grown.cortex, bodies.to_grown.of_nearest(labels), -1)
    smooth, deepened = (
        {key: mean_field(maps[name], grown.weights) for key, name in SMOOTH_MAPS.items() if name in maps}
        for maps in bodies.smooth_maps.values()
    )
    of_grown = region_fields(grown)
    fields = {"person": (labels, region_fields(person)), "smooth": (at_grown, smooth), "grown": (at_grown, of_grown)}
    numbers = {body: region_numbers(at, len(regions.names), own) for body, (at, own) in fields.items()}
    return RegionNumbers(regions.names, labels, numbers, (of_grown, smooth, deepened))


def mean_field(values: Array, weights: Array) -> tuple[Array, Array]:
    """The weighted mean of values (N,) over the vertices that have one."""
    known = np.isfinite(values)
    return np.where(known, values, 0.0) * weights, known * weights


def region_fields(body: Body) -> Fields:
    """The fields of a measured cortex for which it has maps.

    ``gyrification_index`` and ``sulcal_depth_mm`` are means over pial area, ``cortical_thickness_mm`` is one over
    vertices, as in the table of regions; ``gyral_thickness_mm`` is the median over vertices. ``hinges_per_cm2`` counts
    hinges without doubtful ones per area midway between white and pial; ``area_expansion`` is this area over that of
    the smooth body, 1 for the whole cortex.
    """
    m, cortex, scale, flat = body.measures, body.cortex, body.scale, body.weights
    white, pial = (vertex_areas(s.verts, s.faces) * cortex for s in (m.cortex.white, m.cortex.pial))
    middle = 0.5 * scale**2 * (white + pial)
    fields: dict[str, Any] = {"area_expansion": (middle / middle.sum(), flat / flat.sum())}
    for key, name, factor, weights in (
        ("gyrification_index", "local_gyrification_index", 1.0, pial),
        ("sulcal_depth_mm", "sulcal_depth", scale, pial),
        ("cortical_thickness_mm", "cortical_thickness", scale, cortex.astype(np.float64)),
    ):
        if (values := find(m.maps, name)) is not None:
            fields[key] = mean_field(factor * values, weights)
    if (widths := find(m.maps, "gyral_thickness")) is not None:
        fields["gyral_thickness_mm"] = np.where(cortex, scale * widths, np.nan)
    if m.graph is not None or m.hinges:
        vertices = np.array([row["vertex"] for row in m.hinges if counts(row)], dtype=np.int64)
        hinges = np.bincount(vertices, minlength=len(cortex)).astype(np.float64)
        fields["hinges_per_cm2"] = 100 * hinges * cortex, middle
    return fields


def region_numbers(labels: Ints, count: int, fields: Fields, keys: Sequence[str] = REGION_MEASURES) -> Array:
    """Numbers (K, count) of regions by their labels (N,), -1 for none; NaN for a field or a region that is empty."""
    inside, numbers = labels >= 0, np.full((len(keys), count), np.nan)
    for row, field in zip(numbers, map(fields.get, keys)):
        if isinstance(field, tuple):
            over, under = (np.bincount(labels[inside], part[inside], count) for part in field)
            np.divide(over, under, out=row, where=under > 0)
        elif field is not None:
            known = np.isfinite(field) & inside
            at = labels[known].astype(np.int16)
            order = np.argsort(at, kind="stable")  # by radix, which is fast
            parts = np.split(field[known][order], np.cumsum(np.bincount(at, minlength=count))[:-1])
            row[:] = [np.median(part) if len(part) else np.nan for part in parts]
    return numbers


def spearman(x: Array, y: Array) -> float:
    """Rank correlation of two samples (R,) where both are known; NaN for fewer than five or no spread."""
    both = np.isfinite(x) & np.isfinite(y)
    if both.sum() < LEAST_REGIONS:
        return float("nan")
    a, b = (rankdata(v[both]) for v in (x, y))
    a, b = a - a.mean(), b - b.mean()
    size = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / size if size > 0 else float("nan")
