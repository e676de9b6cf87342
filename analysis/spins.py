"""Spin test: whether two maps of one hemisphere are more alike than smooth maps are by chance."""

import math
from dataclasses import dataclass

import numpy as np
from scipy.stats import rankdata

from morphofold.arrays import Array, Bools
from morphofold.errors import DoesNotApply, OutOfRange
from morphofold.geometry import adjacency, dot, position
from morphofold.kernels import kernel, reading
from morphofold.spheres.spins import NearestTable, cell_of, p_value, rotations, turned
from morphofold.surface import Surface
from morphofold.threads import in_blocks
from morphofold.unfolding.unfold import points_on_sphere
from morphofold.validators import one_of, same_length

LEAST_VERTICES = 10  # that both maps know, for a correlation


@dataclass(frozen=True, eq=False)
class SpinTest:
    """A correlation beside its values under random rotations.

    Attributes
    ----------
    value : float
        Correlation of the two maps.
    p : float
        Two-sided: (1 + spins with a correlation at least as strong) / (1 + spins).
    p_greater : float
        One-sided, for a positive correlation.
    null : (S,) float64
        Correlations under the spins; NaN where a spin leaves fewer than ten vertices that both maps know.
    """

    value: float
    p: float
    p_greater: float
    null: Array

    def __repr__(self) -> str:
        return f"SpinTest({self.value:.3g}, p {self.p:.3g}, one-sided {self.p_greater:.3g}, {len(self.null):,} spins)"


def spin_test(
    x: Array,
    y: Array,
    sphere: Surface,
    *,
    spins: int = 1000,
    seed: int = 0,
    method: str = "pearson",
    inside: Bools | None = None,
) -> SpinTest:
    """Correlation of two maps, tested against rotations of one of them.

    Neighbouring values of a map are alike, so a hemisphere has far fewer independent values than vertices, and the p
    value of the correlation itself is far too small. A rotation keeps how smooth a map is, and breaks its place.

    Parameters
    ----------
    x, y : (N,) float64
        Maps at the vertices of one hemisphere; NaN where unknown (on the medial wall).
    sphere : Surface
        ``?h.sphere`` of the hemisphere, or ``?h.sphere.reg`` of a template.
    spins : int
        Number of random rotations.
    seed : int
    method : {"pearson", "spearman"}
        Spearman's correlation is that of the ranks over each whole map.
    inside : (N,) bool, optional
        Vertices that count, such as the cortex; None: where both are known.

    Returns
    -------
    SpinTest

    Raises
    ------
    ValueError
        If the maps have another length than the sphere, know too few vertices in common, or are constant; if ``sphere``
        is none, ``spins`` is not positive, or the method is unknown.

    Notes
    -----
    The test is that of Alexander-Bloch and others 2018 (NeuroImage 178): under each rotation a vertex gets the value of
    x at the vertex nearest to where it comes from. Values that come from the medial wall are left out of that
    correlation. The nearest vertex is found from a table and by walking to nearer neighbours, which is exact on a
    Delaunay mesh such as FreeSurfer's templates.
    """
    points = points_on_sphere(sphere, sphere)
    for values in (x, y):
        same_length(values, len(points), "a map")
    if spins < 1:
        raise OutOfRange(f"spins must be a positive number, got {spins!r}.")
    one_of(method, ("pearson", "spearman"), "method")
    maps = np.array([x, y], dtype=np.float64)
    if inside is not None:
        maps[:, ~np.asarray(inside, dtype=bool)] = np.nan
    known = np.isfinite(maps).all(axis=0)
    if known.sum() < LEAST_VERTICES or not np.ptp(maps[:, known], axis=1).all():
        raise DoesNotApply(
            f"the maps have {known.sum()} vertices in common, and both must vary there; {LEAST_VERTICES} are needed."
        )
    turns = np.concatenate([np.eye(3)[None], rotations(spins, seed).transpose(0, 2, 1)])
    table, ring, correlations = NearestTable(points), adjacency(len(points), sphere.faces), np.empty(len(turns))
    read = reading(points, turns, *table.arrays, ring, *_prepared(maps, method))
    in_blocks(_correlations, len(turns), *read, correlations)
    value, null = float(correlations[0]), correlations[1:]
    counted = null[np.isfinite(null)]
    return SpinTest(value, p_value(abs(value), np.abs(counted)), p_value(value, counted), null)


def _prepared(maps: Array, method: str) -> Array:
    """Maps (2, N), or the ranks of their known values, less their mean, over their standard deviation."""
    for values in maps:
        known = np.isfinite(values)
        some = rankdata(values[known]) if method == "spearman" else values[known]
        values[known] = (some - some.mean()) / np.std(some)
    return maps


@kernel
def _correlations(start, stop, points, turns, vertex, n, indptr, indices, x, y, correlations):
    """Write the correlation (T,) of x, under each rotation (T, 3, 3), with y."""
    for t in range(start, stop):
        count, sx, sy, sxx, syy, sxy = 0, 0.0, 0.0, 0.0, 0.0, 0.0
        for i in range(len(points)):
            if not math.isfinite(y[i]):
                continue
            q = turned(turns[t], position(points, i))
            a, b = x[_nearest(points, q, vertex[cell_of(q, n)], indptr, indices)], y[i]
            if math.isfinite(a):
                count += 1
                sx, sy, sxx, syy, sxy = sx + a, sy + b, sxx + a * a, syy + b * b, sxy + a * b
        correlations[t] = np.nan
        if count >= LEAST_VERTICES:
            xx, yy, xy = sxx - sx * sx / count, syy - sy * sy / count, sxy - sx * sy / count
            if xx > 0.0 and yy > 0.0:
                correlations[t] = xy / math.sqrt(xx * yy)


@kernel
def _nearest(points, q, v, indptr, indices):
    """The vertex nearest to a point, by walking from v to nearer neighbours."""
    most, nearer = dot(q, position(points, v)), True
    while nearer:
        nearer = False
        for e in range(indptr[v], indptr[v + 1]):
            w = indices[e]
            near = dot(q, position(points, w))
            if near > most:
                v, most, nearer = np.int64(w), near, True
                break
    return v
