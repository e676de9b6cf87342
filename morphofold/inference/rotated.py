"""What subjects have in common, and what by chance: their hinges and crests on a template, turned at random."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from morphofold.arrays import Array
from morphofold.kernels import kernel, reading
from morphofold.progress import Progress, silent
from morphofold.spheres.spins import NearestTable, cell_of, rotations
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
    """What the subjects have and share as they are: (K, 2, N).

    The first is the sum of all subjects' amounts at each vertex. The second is the part of it that another subject has
    within the radius, the mean over the other subjects.
    """
    others = marks.near.sum(axis=1, keepdims=True) - marks.near
    shared = marks.amounts * others / max(marks.amounts.shape[1] - 1, 1)
    return np.stack([marks.amounts.sum(axis=1), shared.sum(axis=1)], axis=1)


def common_by_chance(marks: Landmarks, spins: int, seed: int, progress: Progress = silent) -> Array:
    """The same under random rotations, (spins, K, 2, N) float32; each subject is turned by a rotation of its own.

    Notes
    -----
    A vertex gets what lies under it after the rotation, for each area of the sphere, times its area on the cortex; then
    a subject's amounts are divided by their sum and multiplied by what it has. So by chance amounts are spread over
    the cortex in proportion to its area, and neither the medial wall nor the distortion of the sphere changes them.
    """
    table, (K, S, N) = NearestTable(marks.points), marks.amounts.shape
    dense = np.divide(marks.amounts, marks.on_sphere, out=np.zeros((K, S, N)), where=marks.on_sphere > 0)
    total = marks.amounts.sum(axis=2)
    found: Array = np.zeros((spins, K, 2, N), dtype=np.float32)
    turns = rotations(spins * S, seed).reshape(spins, S, 3, 3)
    for start in range(0, spins, ROTATIONS_AT_ONCE):
        part = slice(start, min(start + ROTATIONS_AT_ONCE, spins))
        given = reading(marks.points, table.vertex, dense, marks.near, marks.areas, total, turns[part])
        in_blocks(_turned, part.stop - part.start, *given, table.n, found[part])
        progress(part.stop / spins, f"{part.stop} of {spins} rotations")
    return found


@kernel
def _turned(start, stop, points, vertex, dense, near, areas, total, turns, n, sums):
    """Write (T, K, 2, N): all subjects' amounts after rotations (T, S, 3, 3), and what of them is shared."""
    K, S, N = dense.shape
    under = np.empty((S, N), np.int64)
    for t in range(start, stop):
        for s in range(S):
            turn = turns[t, s]
            for i in range(N):
                a, b, c = points[i, 0], points[i, 1], points[i, 2]
                under[s, i] = vertex[
                    cell_of(
                        turn[0, 0] * a + turn[0, 1] * b + turn[0, 2] * c,
                        turn[1, 0] * a + turn[1, 1] * b + turn[1, 2] * c,
                        turn[2, 0] * a + turn[2, 1] * b + turn[2, 2] * c,
                        n,
                    )
                ]
        for k in range(K):
            others = np.zeros(N)
            for s in range(S):
                for i in range(N):
                    others[i] += 1.0 if near[k, s, under[s, i]] else 0.0
            for s in range(S):
                whole = 0.0
                for i in range(N):
                    whole += dense[k, s, under[s, i]] * areas[i]
                if whole == 0.0:
                    continue
                share = total[k, s] / whole
                for i in range(N):
                    u = under[s, i]
                    amount = dense[k, s, u] * areas[i] * share
                    if amount > 0.0:
                        sums[t, k, 0, i] += amount
                        sums[t, k, 1, i] += amount * (others[i] - (1.0 if near[k, s, u] else 0.0)) / max(S - 1, 1)
