"""Spins: random rotations of a sphere, the null hypothesis for maps whose neighbouring values are alike.

A rotation keeps how smooth a map is, and breaks its place (Alexander-Bloch and others 2018 [1]_). Points that are
turned onto the medial wall have no value and are left out.

References
----------
.. [1] Alexander-Bloch, Shou, Liu, Satterthwaite, Glahn, Shinohara, Vandekar, Raznahan. On testing for spatial
   correspondence between maps of human brain structure and function. NeuroImage 178, 540 (2018).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from morphofold.arrays import Array, Ints
from morphofold.spheres.spins import NearestTable
from morphofold.threads import one_blas_thread

SPINS = 500
LEVEL_OF_SIGNIFICANCE = 0.05
ROUND_OFF = 1e-12

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
        return self.p < LEVEL_OF_SIGNIFICANCE and (
            self.difference_p is None or self.difference_p < LEVEL_OF_SIGNIFICANCE
        )


@one_blas_thread()
def spun(statistic: Statistic, points: Array, table: NearestTable, turns: Array) -> Array:
    """A statistic (T, K) under T rotations (T, 3, 3) of the source below the target points (N, 3).

    Under the rotation R the target point s lies over the source point R^T s. Sums run in one thread: they are short,
    and the same on every machine.
    """
    return np.stack([statistic(table(points @ turn), turn) for turn in turns])


def beside_null(value: float, null: Array, control: float | None = None, control_null: Array | None = None) -> Tested:
    """Set a number beside its values (T,) under spins, and beside a control and its values under the same spins.

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
    kept = null[np.isfinite(null)]
    mean, sd = (float(kept.mean()), float(kept.std())) if len(kept) else (float("nan"), float("nan"))
    found = Tested(value, mean, sd, p_value(value, kept))
    if control is None or control_null is None or not np.isfinite(control):
        return found
    apart = null - control_null
    apart = apart[np.isfinite(apart)]
    if not (np.isfinite(value) and len(apart)):
        return replace(found, control=control)
    difference = value - control
    low, high = difference - (np.percentile(apart, [97.5, 2.5]) - apart.mean())
    return replace(
        found,
        control=control,
        difference=difference,
        low=float(low),
        high=float(high),
        difference_p=p_value(difference, apart),
    )


def p_value(value: float, null: Array) -> float:
    """(1 + values under spins at least as large) / (1 + spins); 1 for a number that is NaN."""
    return float((1 + np.count_nonzero(null >= value - ROUND_OFF)) / (1 + len(null))) if np.isfinite(value) else 1.0
