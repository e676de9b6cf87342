"""A linear model at every vertex, and what of it remains when subjects are exchanged at random."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from morphofold.arrays import Array, Ints
from morphofold.errors import DoesNotApply, OutOfRange, WrongShape
from morphofold.inference.clusters import Mesh, clusters, components, enhanced, tfce
from morphofold.kernels import kernel, reading
from morphofold.progress import Progress, silent
from morphofold.threads import in_blocks, one_blas_thread

FORMING_P = 0.001  # two-sided p of the height above which clusters are formed
PERMUTATIONS_AT_ONCE = 64  # bounds the memory
ROUND_OFF = 1e-9  # relative
CONSTANT = 1e-9


@dataclass(frozen=True, eq=False)
class Inference:
    """An effect at every vertex of N, tested over the whole surface. NaN where a subject has no value.

    Attributes
    ----------
    effect : (N,) float64
        The contrast of the coefficients, in the unit of the map per unit of the regressor.
    t : (N,) float64
    df : int
        Degrees of freedom.
    flipped : bool
        Whether signs were changed, because a mean is tested; else subjects or blocks were exchanged.
    p : (N,) float64
        Two-sided, of one vertex alone, if errors are normal.
    p_height : (N,) float64
        Two-sided, corrected for the whole surface: share of permutations whose largest abs(t) is at least as large.
    p_tfce : (N,) float64
        The same of threshold-free cluster enhancement.
    threshold : float
        The abs(t) above which clusters are formed.
    cluster : (N,) int64
        Row of ``clusters`` in which each vertex lies; -1: none.
    clusters : list of dict
        ``peak`` (vertex), ``t`` and ``effect`` there, ``area_mm2``, ``p`` (share of permutations whose largest cluster
        is at least as large), the largest first.
    null_height, null_area, null_tfce : (P,) float64
        The largest of each permutation.
    r : (N,) float64
        Size of the effect without a unit: t / sqrt(t^2 + df), the partial correlation of the map with what is tested.
    """

    effect: Array = field(repr=False)
    t: Array = field(repr=False)
    df: int
    flipped: bool
    p: Array = field(repr=False)
    p_height: Array = field(repr=False)
    p_tfce: Array = field(repr=False)
    threshold: float
    cluster: Ints = field(repr=False)
    clusters: list[dict[str, Any]] = field(repr=False)
    null_height: Array = field(repr=False)
    null_area: Array = field(repr=False)
    null_tfce: Array = field(repr=False)

    @property
    def r(self) -> Array:
        return self.t / np.sqrt(self.t**2 + self.df)

    def __repr__(self) -> str:
        tested = np.count_nonzero(np.isfinite(self.p))
        smallest = float(np.nanmin(self.p_tfce)) if tested else np.nan
        vertices = f"{tested:,} of {len(self.p):,} vertices tested"
        return (
            f"Inference({vertices}, df {self.df}, smallest corrected p {smallest:.3g}, {len(self.clusters)} clusters)"
        )


class Model:
    """Ordinary least squares of maps on a design, for one contrast; factorised once for all vertices.

    Parameters
    ----------
    design : (S, K) float64
        A row for each subject.
    contrast : (K,) float64
        Weights of the coefficients.

    Raises
    ------
    ValueError
        If the design has as many columns as rows or more, columns that depend on each other, or a contrast of zeros.
    """

    def __init__(self, design: Array, contrast: Array):
        X, c = np.asarray(design, dtype=np.float64), np.asarray(contrast, dtype=np.float64)
        if X.ndim != 2 or c.shape != X.shape[1:]:
            raise WrongShape(f"design {X.shape} and contrast {c.shape} must be (S, K) and (K,).")
        if not c.any():
            raise DoesNotApply("the contrast is 0 for every column of the design: it tests nothing.")
        subjects, columns = X.shape
        rank = int(np.linalg.matrix_rank(X))
        if rank < columns:
            raise DoesNotApply(
                f"of the {columns} columns of the design only {rank} are independent: a column is constant, repeats "
                "another or is a sum of others. Leave it out."
            )
        if subjects <= columns:
            raise DoesNotApply(f"{subjects} subjects can't determine {columns} columns and an error. Add subjects.")
        others = X @ np.linalg.svd(c[None])[2][1:].T  # the columns' combinations that the contrast does not weigh
        self._nuisance = np.linalg.qr(others)[0]
        tested = X @ c / (c @ c)
        tested = tested - self._nuisance @ (self._nuisance.T @ tested)
        self._length = float(np.linalg.norm(tested))
        self._tested = tested / self._length
        self.df = subjects - columns

    def __repr__(self) -> str:
        return f"Model({len(self._tested)} subjects, {self.df} degrees of freedom)"

    @property
    def tests_a_mean(self) -> bool:
        """Whether what is tested is left of a constant map, so that exchanging subjects could not tell it from none."""
        return bool(np.abs(self.residuals(np.ones(len(self._tested)))).max() > CONSTANT)

    def changes(self, exchanges: Array) -> bool:
        """Whether an exchange (P, S, 2) changes what is tested, but for its sign."""
        turned = self._tested[exchanges[..., 0].astype(np.int64)] * exchanges[..., 1]
        return bool((np.abs(turned @ self._tested) < 1 - CONSTANT).any())

    def residuals(self, maps: Array) -> Array:
        """Maps (S, N) less what the columns explain that are not tested."""
        return maps - self._nuisance @ (self._nuisance.T @ maps)

    def effect(self, residuals: Array) -> Array:
        """The contrast of the coefficients (N,)."""
        return (self._tested @ residuals) / self._length

    def t(self, residuals: Array, exchanges: Array) -> Array:
        """t (P, N) after P exchanges (P, S, 2): the row that comes to each place, and its sign.

        The squares of residuals sum to the same for every exchange, so the residuals of the model need not be computed:
        what they lose to the model is found from products of its few columns with the residuals.
        """
        rows, signs = exchanges[..., 0].astype(np.int64), exchanges[..., 1]
        columns = np.column_stack([self._tested, self._nuisance]).T  # (K, S)
        turned = np.zeros((len(rows), len(columns), columns.shape[1]))
        np.put_along_axis(turned, np.broadcast_to(rows[:, None], turned.shape), columns[None] * signs[:, None], axis=2)
        parts = (turned.reshape(-1, columns.shape[1]) @ residuals).reshape(len(rows), len(columns), -1)
        total = np.einsum("sn,sn->n", residuals, residuals)
        left = total - np.einsum("pkn,pkn->pn", parts, parts)
        small = left <= ROUND_OFF * total
        return np.divide(
            parts[:, 0],
            np.sqrt(left / self.df, where=~small, out=np.ones_like(left)),
            where=~small,
            out=np.zeros_like(left),
        )


def exchanges(
    subjects: int, count: int, seed: int, *, flip: bool = False, blocks: Ints | None = None, whole: bool = False
) -> Array:
    """Random exchanges (count, subjects, 2): the subject that comes to each place, and its sign.

    ``flip``: signs are random and subjects stay, where a mean is tested. ``blocks`` (subjects,): subjects
    are exchanged within blocks only, or each block has one sign. ``whole``: blocks change places with blocks of their
    size, and subjects keep their order within them.

    Raises
    ------
    DoesNotApply
        If nothing can be exchanged: every block has one subject, or no two blocks have the same size.
    """
    random = np.random.default_rng(seed)
    names, block = np.unique(np.zeros(subjects, dtype=np.int64) if blocks is None else blocks, return_inverse=True)
    members = [np.flatnonzero(block == b) for b in range(len(names))]
    sizes = np.array([len(inside) for inside in members])
    alike = [[members[b] for b in np.flatnonzero(sizes == size)] for size in np.unique(sizes)] if whole else []
    if not flip and max(map(len, alike if whole else members)) < 2:
        what = "no two blocks have the same size" if whole else "every block has one subject"
        raise DoesNotApply(f"nothing can be exchanged among {len(names)} blocks: {what}.")
    found = np.empty((count, subjects, 2))
    for k in range(count):
        rows, signs = np.arange(subjects), np.ones(subjects)
        if flip:
            signs = random.choice([-1.0, 1.0], subjects if blocks is None else len(names))
            signs = signs if blocks is None else signs[block]
        elif whole:
            for same in alike:
                for place, one in zip(same, random.permutation(len(same))):
                    rows[place] = same[one]
        else:
            for inside in members:
                rows[inside] = random.permutation(inside)
        found[k] = np.column_stack([rows, signs])
    return found


@dataclass(frozen=True, eq=False)
class Null:
    """All exchanges (P, S, 2) of a model's residuals (S, n) at the n known vertices of a mesh."""

    model: Model
    residuals: Array
    known: NDArray[np.bool_]
    mesh: Mesh
    threshold: float
    exchanges: Array

    @one_blas_thread()
    def largest(self, first: int, last: int, progress: Progress = silent) -> Array:
        """Of each exchange from ``first`` to ``last`` (last - first, 3): the largest abs(t), the area of the largest
        cluster, and the largest TFCE."""
        found = np.empty((last - first, 3))
        for start in range(first, last, PERMUTATIONS_AT_ONCE):
            stop = min(start + PERMUTATIONS_AT_ONCE, last)
            t = np.zeros((stop - start, len(self.known)))
            t[:, self.known] = self.model.t(self.residuals, self.exchanges[start:stop])
            order = np.argsort(-np.abs(t), axis=1, kind="stable")
            out = found[start - first : stop - first]
            in_blocks(_largest, len(t), *reading(t, order, *self.mesh.arrays), self.threshold, out)
            progress((stop - first) / (last - first), f"{stop} of {len(self.exchanges)} permutations")
        return found


def here(null: Null, progress: Progress) -> Array:
    """The largest statistics of all exchanges (P, 3), computed on this machine."""
    return null.largest(0, len(null.exchanges), progress)


@one_blas_thread()
def infer(
    maps: Array,
    design: Array,
    contrast: Array,
    mesh: Mesh,
    *,
    permutations: int = 1000,
    seed: int = 0,
    blocks: Ints | None = None,
    whole: bool = False,
    forming_p: float = FORMING_P,
    largest: Callable[[Null, Progress], Array] = here,
    progress: Progress = silent,
) -> Inference:
    """Test a contrast of a linear model at every vertex, corrected for the whole surface by permutations.

    Parameters
    ----------
    maps : (S, N) array
        A map of each subject; vertices that a subject does not know (NaN) are not tested.
    design, contrast : (S, K), (K,) float64
    mesh : Mesh
        Of the N vertices.
    permutations : int
    seed : int
    blocks : (S,) int64, optional
        Subjects are exchanged within blocks only (repeated measures).
    whole : bool
        Exchange blocks as wholes, each with one of its size.
    forming_p : float
        Two-sided p at the height above which clusters are formed.
    largest : callable
        Where the exchanges are computed: :func:`here`, or :func:`morphofold.cohort.permuting.on_workers`.
    progress : callable

    Returns
    -------
    Inference

    Raises
    ------
    ValueError
        If the arrays do not fit each other, the design is not of full rank or has too few subjects, the contrast is
        empty, or no vertex is known in all subjects.

    Notes
    -----
    Freedman and Lane 1983 (J. Bus. Econ. Stat. 1), the best of the approximate tests for models with further regressors
    (Winkler and others 2014, NeuroImage 92): residuals of the columns that are not tested are exchanged, and the whole
    model is fitted to them again. The largest statistic of each exchange over the surface gives p values that hold for
    all vertices together.

    A mean, such as the intercept of covariates about their mean, or one group's, is tested by signs instead: each
    subject, or block, has its residuals times 1 or -1, since exchanging subjects leaves a mean as it is. It is a mean
    if the other columns can't make a constant.
    """
    model, Y = Model(design, contrast), np.asarray(maps, dtype=np.float64)
    if Y.ndim != 2 or Y.shape != (len(design), len(mesh.areas)):
        raise WrongShape(f"maps {Y.shape} must be ({len(design)}, {len(mesh.areas)}): subjects and vertices.")
    if permutations < 1 or not 0 < forming_p < 1 or seed < 0:
        raise OutOfRange(
            "permutations must be positive, forming_p within 0 to 1 and the seed not negative, got "
            f"{permutations}, {forming_p} and {seed}."
        )
    known: NDArray[np.bool_] = np.asarray(np.isfinite(Y).all(axis=0))
    if not known.any():
        raise DoesNotApply("no vertex has a value in all subjects. Leave out subjects without maps.")
    threshold = float(stats.t.isf(forming_p / 2, model.df))
    residuals = model.residuals(Y[:, known])
    own = np.column_stack([np.arange(len(Y), dtype=np.float64), np.ones(len(Y))])[None]
    t, effect = np.full((2, len(known)), np.nan)
    t[known], effect[known] = model.t(residuals, own)[0], model.effect(residuals)
    shuffled = exchanges(len(Y), permutations, seed, flip=model.tests_a_mean, blocks=blocks, whole=whole)
    if not model.changes(shuffled):
        raise DoesNotApply(
            "no exchange changes what is tested: it is the same within every block, so exchange whole blocks "
            "(--whole-blocks); or it differs only within blocks, so don't."
        )
    null = largest(Null(model, residuals, known, mesh, threshold, shuffled), progress)
    cluster, rows = _cluster_table(t, effect, threshold, mesh, null[:, 1])
    return Inference(
        effect=effect,
        t=t,
        df=model.df,
        flipped=model.tests_a_mean,
        p=2 * stats.t.sf(np.abs(t), model.df),
        p_height=share_above(np.abs(t), null[:, 0]),
        p_tfce=share_above(np.where(known, np.abs(tfce(t, mesh)), np.nan), null[:, 2]),
        threshold=threshold,
        cluster=cluster,
        clusters=rows,
        null_height=null[:, 0],
        null_area=null[:, 1],
        null_tfce=null[:, 2],
    )


@kernel
def _largest(start, stop, t, order, indptr, indices, areas, threshold, found):
    """Write the largest abs(t), cluster area and TFCE (P, 3) of maps (P, N)."""
    for k in range(start, stop):
        found[k, 0], found[k, 1], found[k, 2] = np.abs(t[k]).max(), 0.0, 0.0
        for sign in (1.0, -1.0):
            height = sign * t[k]
            found[k, 2] = max(found[k, 2], enhanced(height, order[k], indptr, indices, areas).max())
            cluster = components(height > threshold, indptr, indices)
            size = np.zeros(cluster.max() + 1)
            for v in range(len(cluster)):
                if cluster[v] >= 0:
                    size[cluster[v]] += areas[v]
            if len(size) > 0:
                found[k, 1] = max(found[k, 1], size.max())


def share_above(values: Array, null: Array) -> Array:
    """p (N,): the share of the null (P,) that is at least as large, the value itself among them; NaN stays NaN."""
    above = len(null) - np.searchsorted(np.sort(null), values - ROUND_OFF * np.abs(values), side="left")
    return np.where(np.isfinite(values), (1 + above) / (1 + len(null)), np.nan)


def _cluster_table(
    t: Array, effect: Array, threshold: float, mesh: Mesh, null: Array
) -> tuple[Ints, list[dict[str, Any]]]:
    where, rows = np.full(len(t), -1, dtype=np.int64), []
    for sign in (1.0, -1.0):
        cluster, areas = clusters(sign * t, threshold, mesh)
        for k, area in enumerate(areas):
            inside = np.flatnonzero(cluster == k)
            peak = int(inside[np.argmax(sign * t[inside])])
            p = float(share_above(np.array([area]), null)[0])
            rows.append(({"peak": peak, "t": t[peak], "effect": effect[peak], "area_mm2": area, "p": p}, inside))
    rows.sort(key=lambda row: -row[0]["area_mm2"])
    for k, (_, inside) in enumerate(rows):
        where[inside] = k
    return where, [row for row, _ in rows]
