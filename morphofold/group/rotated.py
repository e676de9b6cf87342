"""What subjects have in common, and what by chance: their hinges and crests on a template, turned at random."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from morphofold.arrays import Array
from morphofold.geometry import position
from morphofold.kernels import kernel, reading
from morphofold.progress import Progress, silent
from morphofold.spheres.spins import NearestTable, cell_of, rotations, turned
from morphofold.threads import in_blocks

ROTATIONS_AT_ONCE = 20


@dataclass(frozen=True, eq=False)
class Landmarks:
    """K kinds of landmarks, such as hinges and crests, of S subjects at the N vertices of a hemisphere of a template.

    Attributes
    ----------
    amounts : (K, S, N) float64
        Number of hinges, or length of crests [mm]; 0 outside the cortex.
    near : (K, S, N) bool
        Where a subject has one within the radius.
    points : (N, 3) float64
        The template's vertices on the unit sphere.
    on_sphere, areas : (N,) float64
        Area around each vertex on the unit sphere, and on the cortex [mm^2]; the second is 0 outside the cortex.
    """

    amounts: Array
    near: NDArray[np.bool_]
    points: Array
    on_sphere: Array
    areas: Array


def common(marks: Landmarks) -> Array:
    """What the subjects have and share as they are: (K, 3, N).

    The first is the sum of all subjects' amounts at each vertex. The second is the part of it that another subject has
    within the radius, the mean over the other subjects. The third is the part of the first with which the second is
    compared: all of it, unless no other subject has cortex there.
    """
    S = marks.amounts.shape[1]
    others = marks.near.sum(axis=1, keepdims=True) - marks.near
    have, shared = marks.amounts.sum(axis=1), (marks.amounts * others / max(S - 1, 1)).sum(axis=1)
    return np.stack([have, shared, have if S > 1 else np.zeros_like(have)], axis=1)


def common_by_chance(marks: Landmarks, spins: int, seed: int, progress: Progress = silent) -> Iterator[Array]:
    """The same under random rotations, a few at a time: (T, K, 3, N); each subject is turned by a rotation of its own.

    Notes
    -----
    A vertex gets what lies under it after the rotation, for each area of the sphere, times its area on the cortex; then
    a subject's amounts are divided by their sum and multiplied by what it has. So by chance amounts are spread over
    the cortex in proportion to its area. They are compared with the subjects whose cortex comes to lie there, not with
    those whose medial wall does. So neither the wall nor the distortion of the sphere changes the share.
    """
    table, (K, S, N) = NearestTable(marks.points), marks.amounts.shape
    dense = np.divide(marks.amounts, marks.on_sphere, out=np.zeros((K, S, N)), where=marks.on_sphere > 0)
    total = marks.amounts.sum(axis=2)
    turns = rotations(spins * S, seed).reshape(spins, S, 3, 3)
    for start in range(0, spins, ROTATIONS_AT_ONCE):
        part = turns[start : start + ROTATIONS_AT_ONCE]
        found = np.zeros((len(part), K, 3, N))
        read = reading(marks.points, *table.arrays, dense, marks.near, marks.areas, total, part)
        in_blocks(_common_after, len(part), *read, found)
        progress((start + len(part)) / spins, f"{start + len(part)} of {spins} rotations")
        yield found


@kernel
def _common_after(start, stop, points, vertex, n, dense, near, areas, total, turns, sums):
    """Write what is common (T, K, 3, N) after rotations (T, S, 3, 3)."""
    K, S, N = dense.shape
    under = np.empty((S, N), np.int64)
    for t in range(start, stop):
        compared, others = np.zeros(N), np.zeros((K, N))  # subjects with cortex there, and of these with one near
        for s in range(S):
            for i in range(N):
                u = vertex[cell_of(turned(turns[t, s], position(points, i)), n)]
                under[s, i] = u
                if areas[u] > 0.0:
                    compared[i] += 1.0
                    for k in range(K):
                        others[k, i] += near[k, s, u]
        for k in range(K):
            for s in range(S):
                amounts = dense[k, s][under[s]] * areas
                share = total[k, s] / amounts.sum()
                for i in np.flatnonzero(amounts):
                    amount = amounts[i] * share
                    sums[t, k, 0, i] += amount
                    if compared[i] > 1.0:
                        own = near[k, s, under[s, i]]
                        sums[t, k, 1, i] += amount * (others[k, i] - own) / (compared[i] - 1.0)
                        sums[t, k, 2, i] += amount
