"""How well a grown cortex agrees with the person whose unfolded surface it grew from.

Agreement is tested against chance, by spins, and against two controls that did not grow: the unfolded (smooth) body,
and this body with its dents deepened. From a statistic and its values under spins comes an ``Agreement`` with p-values
and a verdict. The statistic of sulci and gyri is here; that of fold axes is in ``fold_axes``, that of regions in
``grown_regions``. ``compare_person`` puts the three together.

Spins are random rotations of a sphere, the null hypothesis for maps whose neighbouring values are alike. A rotation
keeps how smooth a map is, and breaks its place (Alexander-Bloch and others 2018 [1]_). Points that are turned onto the
medial wall have no value and are left out.

References
----------
.. [1] Alexander-Bloch, Shou, Liu, Satterthwaite, Glahn, Shinohara, Vandekar, Raznahan. On testing for spatial
   correspondence between maps of human brain structure and function. NeuroImage 178, 540 (2018).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from morphofold.analysis.multiple_tests import SIGNIFICANCE
from morphofold.comparison.person.common_sphere import centred
from morphofold.frozen_arrays import Array, Ints
from morphofold.spheres.spins import NearestTable, p_value, rotations
from morphofold.threads import one_blas_thread

SPINS = 500

#: numbers (K,) from the vertex of the source on which each target point (P,) falls, and the targets' rotation (3, 3)
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
    control_map : str or None
        The map of the control that agrees best with the person; None over regions.
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
    control_map: str | None = None

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
def null_values(statistics: Sequence[Statistic], points: Array, source: Array, spins: int, seed: int) -> list[Array]:
    """Each statistic (T, K) under T random rotations of the source vertices (N, 3) below the target points (P, 3).

    Under the rotation R the target point s lies over the source point R^T s. Sums run in one thread: they are short,
    and the same on every machine.
    """
    nearest_table, samples = NearestTable(source), []
    for rotation in rotations(spins, seed):
        nearest_vertices = nearest_table(points @ rotation)
        samples.append([statistic(nearest_vertices, rotation) for statistic in statistics])
    return [np.stack(spin_values) for spin_values in zip(*samples)]


def agreement_with_controls(
    what: str, values: Array, null: Array, map_keys: Sequence[str | None] = (None,), **other_fields: Any
) -> Agreement:
    """Test the first of the values (1 + 2C,), with their values (T, 1 + 2C) under spins, against two sets of controls.

    These are the next C values, of the smooth body, and the last C, of the deepened one, each of C ``map_keys``. The
    control of a set is the largest.
    """
    tests = []
    for control_columns in np.arange(1, len(values)).reshape(2, -1):
        best_index = int(values[control_columns].argmax())
        control_value, control_null = float(values[control_columns[best_index]]), null[:, control_columns[best_index]]
        tests.append(compare_with_null(float(values[0]), null[:, 0], control_value, control_null, map_keys[best_index]))
    return Agreement(what, tests[0], tests[1], **other_fields)


def compare_with_null(
    value: float, null: Array, control: float, control_null: Array, control_map: str | None = None
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
    spin_values, differences = (values[np.isfinite(values)] for values in (null, null - control_null))
    null_mean, null_sd = (float(spin_values.mean()), float(spin_values.std())) if len(spin_values) else (np.nan, np.nan)
    beside_null, difference = (value, null_mean, null_sd, p_value(value, spin_values)), value - control
    if not (np.isfinite(difference) and len(differences)):
        return Tested(*beside_null, control if np.isfinite(control) else None)
    low, high = (difference - (np.percentile(differences, [97.5, 2.5]) - differences.mean())).tolist()
    return Tested(*beside_null, control, difference, low, high, p_value(difference, differences), control_map)


def classes(values: Array, weights: Array) -> Array:
    """1 where values (N,) are above their weighted median (gyrus), -1 below (sulcus), 0 where a value is NaN.

    The median and not 0, because a smooth body is convex nearly everywhere and has no sulcus by the sign of a number.
    With the median half of the area of each surface is gyrus, so that chance agrees on half of it.
    """
    return np.nan_to_num(np.sign(centred(values, weights))) * (weights > 0)


def agreement_of_classes(body_classes: Sequence[Array], person: Array, weights: Array) -> Statistic:
    """Share of the area on which each of K bodies has the person's class.

    Parameters
    ----------
    body_classes : sequence of (P,) float64
        :func:`classes` at the target points. Points at which one of them is 0 are left out for all, so that shares are
        paired.
    person : (N,) float64
        Classes at the source vertices.
    weights : (P,) float64
        Area of the target points.

    Returns
    -------
    function of (nearest, rotation) to (K,) float64
        0.5, which is chance, if there is no area.
    """
    class_areas = np.stack(body_classes)
    class_areas = class_areas * (weights * (class_areas != 0).all(axis=0))
    point_areas = abs(class_areas[0])

    def statistic(nearest: Ints, rotation: Array) -> Array:
        spun_classes = person[nearest]
        area = point_areas @ abs(spun_classes)
        return 0.5 + 0.5 * (class_areas @ spun_classes) / area if area > 0 else np.full(len(class_areas), 0.5)

    return statistic
