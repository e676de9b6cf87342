"""Prominent highs and lows of a function on a surface, such as gyri and sulci of a height."""

import math

import numpy as np

from morphofold import geometry
from morphofold.arrays import Ints
from morphofold.errors import NotFinite, OutOfRange, WrongShape
from morphofold.kernels import kernel
from morphofold.surface import Faces, PerVertex


def prominent_peaks(faces: Faces, values: PerVertex, least: float) -> Ints:
    """Vertices of the peaks that rise by ``least`` or more above the pass to higher ground.

    Parameters
    ----------
    faces : (M, 3) int64
        Triangles; vertices that no triangle uses are left out.
    values : (N,) float64
        Height, in any unit. Pass ``-values`` for the pits.
    least : float
        Least prominence of a peak, in the unit of the values; >= 0.

    Returns
    -------
    peaks : (P,) int64
        Vertices, the most prominent first, ties by height and then by number. The highest vertex of every connected
        piece is always among them. A piece of constant height has one peak.

    Raises
    ------
    ValueError
        If a used vertex has no finite height, there are too few values, or ``least`` is negative or NaN.

    Notes
    -----
    Imagine a flooded surface and a falling water level. A peak appears as an island, and islands join at passes. The
    prominence of a peak is its height above the pass at which its island joins one with a higher peak (its
    *persistence* in topology). If two heights on one mesh differ by e at most everywhere, then every peak of the first
    with prominence p > 2 e has its own partner of p - 2 e or more in the second (Cohen-Steiner, Edelsbrunner, Harer
    2007, Discrete Comput. Geom. 37, 103). So ripples of the mesh do not count, and the number of peaks changes only if
    prominences are near ``least``.
    """
    values = np.asarray(values, dtype=np.float64)
    if not least >= 0:
        raise OutOfRange(f"least must be a prominence of 0 or more, got {least}.")
    if len(values) <= faces.max():
        raise WrongShape(f"faces name vertex {faces.max()}, but there are {len(values)} values.")
    used = np.flatnonzero(geometry.used(len(values), faces))
    if not np.isfinite(values[used]).all():
        missing = np.count_nonzero(~np.isfinite(values[used]))
        raise NotFinite(f"{missing} of {len(used)} vertices have no finite height. Remove their faces.")
    graph = geometry.adjacency(len(values), faces)
    order = used[np.argsort(-values[used], kind="stable")]
    prominence = _prominence(graph.indptr, graph.indices, values, order)
    peaks = order[(prominence[order] >= least) & (prominence[order] > 0)]  # 0: a corner of a plateau
    return peaks[np.argsort(-prominence[peaks], kind="stable")]


@kernel
def _find_tree_root(parent, i):
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@kernel
def _prominence(indptr, indices, values, order):
    """Prominence of each vertex (N,): inf for the highest vertex of a piece, -1 where there is no peak.

    ``order``: vertices from the highest down. Islands are trees; the root of each is its peak.
    """
    parent, rank = np.full(len(values), -1), np.empty(len(values), np.int64)
    prominence = np.full(len(values), -1.0)
    for k in range(len(order)):
        v = order[k]
        parent[v], rank[v] = v, k
        prominence[v] = math.inf
        for e in range(indptr[v], indptr[v + 1]):
            if parent[indices[e]] < 0:
                continue
            a, b = _find_tree_root(parent, v), _find_tree_root(parent, indices[e])
            if a == b:
                continue
            high, low = (a, b) if rank[a] < rank[b] else (b, a)
            parent[low] = high
            prominence[low] = values[low] - values[v] if low != v else -1.0
    return prominence
