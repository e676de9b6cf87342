"""Agreement of sulci and gyri, and of the directions of folds, between two surfaces on one sphere."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from morphofold.arrays import Array, Ints
from morphofold.comparison.person.spins import Statistic


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
    found = np.zeros(len(values))
    if known.any():
        found[known] = np.sign(values[known] - weighted_median(values[known], weights[known]))
    return found


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
        there = person[nearest]
        area = size @ np.abs(there)
        return 0.5 + 0.5 * (signed @ there) / area if area > 0 else np.full(len(signed), 0.5)

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
        there = person[0][nearest] @ turn.T
        there = there - np.einsum("pi,pi->p", there, points)[:, None] * points  # the nearest vertex is a little off
        length = np.einsum("pi,pi->p", there, there)
        clear = weights * both * person[1][nearest]
        found = []
        for axes, strength in bodies:
            cosine = np.einsum("pi,pi->p", there, axes) ** 2
            share = np.divide(cosine, length, out=np.full(len(length), 0.5), where=length > 0)
            area = clear * strength
            found.append((area @ (2 * share - 1)) / area.sum() if area.sum() > 0 else 0.0)
        return np.array(found)

    return statistic
