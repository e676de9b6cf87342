"""A linear model at every vertex, and what of it remains when subjects are exchanged at random."""

from collections.abc import Callable
from dataclasses import dataclass, field
from math import factorial, prod
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from morphofold.arrays import Array, Ints
from morphofold.errors import DoesNotApply, OutOfRange, WrongShape
from morphofold.group.clusters import Mesh, clusters, components, enhanced, tfce
from morphofold.group.variances import variance_trend
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
    degrees : (N,) float64
        Degrees of freedom of each t: ``df``, or Welch's with variance groups.
    at_peak : (S,) float64
        The maps at the vertex with the largest abs(t).
    possible : int
        Number of exchanges that exist.
    least_p : float
        The smallest corrected p that these permutations can give: the share of them, the data as they are among them,
        that leave what is tested as it is.
    variance_ratio, variance_p : float
        Of :func:`morphofold.group.variances.variance_trend`.
    half_width : (N,) float64
        Of the 95 % interval of the effect at one vertex alone, if errors are normal.
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
    degrees: Array = field(repr=False)
    at_peak: Array = field(repr=False)
    possible: int = field(repr=False)
    least_p: float
    variance_ratio: float
    variance_p: float

    @property
    def r(self) -> Array:
        return self.t / np.sqrt(self.t**2 + self.degrees)

    @property
    def half_width(self) -> Array:
        error = np.divide(self.effect, self.t, out=np.full(len(self.t), np.nan), where=self.t != 0)
        return np.abs(error) * stats.t.ppf(0.975, self.degrees)

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
    groups : (S,) int64, optional
        Subjects of one number have one residual variance; without it, all have.

    Attributes
    ----------
    df : int
        Degrees of freedom.
    freedom : (S,) float64
        Degrees of freedom of each residual, whose sum is ``df``.
    regressor : (S,) float64
        What is tested, before the other columns are taken out of it.

    Raises
    ------
    ValueError
        If the design has as many columns as rows or more, columns that depend on each other, or a contrast of zeros, or
        the residuals of a group have less than one degree of freedom.

    Notes
    -----
    With groups, t is the effect over its standard error from the residual variance of each group. For two means that is
    Welch's t, and the square root of G of Winkler and others 2014 (NeuroImage 92); where groups share columns, G takes
    the standard error of the weighted fit instead, which is not that of this effect.
    """

    def __init__(self, design: Array, contrast: Array, groups: Ints | None = None):
        X, c = np.asarray(design, dtype=np.float64), np.asarray(contrast, dtype=np.float64)
        if X.ndim != 2 or c.shape != X.shape[1:]:
            raise WrongShape(f"design {X.shape} and contrast {c.shape} must be (S, K) and (K,).")
        if not c.any():
            raise DoesNotApply("the contrast is 0 for every column of the design: it tests nothing.")
        subjects, columns = X.shape
        size = np.maximum(np.linalg.norm(X, axis=0), np.finfo(float).tiny)  # a unit changes neither rank nor space
        rank = int(np.linalg.matrix_rank(X / size))
        if rank < columns:
            raise DoesNotApply(
                f"of the {columns} columns of the design only {rank} are independent: a column is constant, repeats "
                "another or is a sum of others. Leave it out."
            )
        if subjects <= columns:
            raise DoesNotApply(f"{subjects} subjects can't determine {columns} columns and an error. Add subjects.")
        others = X / size @ np.linalg.svd((c / size)[None])[2][1:].T  # what the contrast does not weigh of the columns
        self._nuisance = np.linalg.qr(others)[0]
        self.regressor: Array = X @ c / (c @ c)
        tested = self.regressor - self._nuisance @ (self._nuisance.T @ self.regressor)
        self._length = float(np.linalg.norm(tested))
        self._tested = tested / self._length
        self._columns = np.column_stack([self._tested, self._nuisance])
        self.df = subjects - columns
        self.freedom: Array = 1 - (self._columns**2).sum(axis=1)
        self._groups = [] if groups is None else [groups == g for g in np.unique(groups)]
        self._group_df = np.array([self.freedom[inside].sum() for inside in self._groups])
        if (self._group_df < 1 - CONSTANT).any():
            raise DoesNotApply(
                "the residuals of a variance group have less than one degree of freedom. Merge it with another group."
            )

    def __repr__(self) -> str:
        return f"Model({len(self._tested)} subjects, {self.df} degrees of freedom)"

    @property
    def tests_a_mean(self) -> bool:
        """Whether what is tested is left of a constant map, so that exchanging subjects could not tell it from none."""
        return bool(np.abs(self.residuals(np.ones(len(self._tested)))).max() > CONSTANT)

    def unchanged(self, exchanges: Array) -> int:
        """How many exchanges (P, S, 2) leave what is tested as it is, but for its sign."""
        turned = self._tested[exchanges[..., 0].astype(np.int64)] * exchanges[..., 1]
        return int((np.abs(turned @ self._tested) >= 1 - CONSTANT).sum())

    def residuals(self, maps: Array) -> Array:
        """Maps (S, N) less what the columns explain that are not tested."""
        return maps - self._nuisance @ (self._nuisance.T @ maps)

    def effect(self, residuals: Array) -> Array:
        """The contrast of the coefficients (N,)."""
        return (self._tested @ residuals) / self._length

    def errors(self, residuals: Array) -> Array:
        """Residuals (S, N) of the whole model from those of the columns that are not tested."""
        return residuals - np.outer(self._tested, self._tested @ residuals)

    def degrees(self, residuals: Array, own: Array) -> Array | int:
        """Degrees of freedom of t: (N,) with groups (Welch and Satterthwaite), else one number; ``own`` changes
        nothing (1, S, 2)."""
        if not self._groups:
            return self.df
        parts = self._spread(residuals, own)[1][:, 0]
        bottom = np.einsum("gn,g->n", parts**2, 1 / self._group_df)
        return np.divide(parts.sum(axis=0) ** 2, bottom, out=np.full(len(bottom), float(self.df)), where=bottom > 0)

    def t(self, residuals: Array, exchanges: Array) -> Array:
        """t (P, N) after P exchanges (P, S, 2): the row that comes to each place, its own with groups, and its sign."""
        tested, variances = self._spread(residuals, exchanges)
        variance, total = variances.sum(axis=0), np.einsum("sn,sn->n", residuals, residuals)
        small = variance <= ROUND_OFF * total / self.df
        return np.divide(
            tested,
            np.sqrt(variance, where=~small, out=np.ones_like(variance)),
            where=~small,
            out=np.zeros_like(variance),
        )

    def _spread(self, residuals: Array, exchanges: Array) -> tuple[Array, Array]:
        """After P exchanges, the product (P, N) of what is tested, and its variance (G, P, N) from each group.

        The squares of residuals sum to the same for every exchange, so the residuals of the model need not be computed:
        what they lose to the model is found from products of its few columns with the residuals.
        """
        rows, signs = exchanges[..., 0].astype(np.int64), exchanges[..., 1]

        def products(columns: Array) -> Array:
            turned = np.zeros((len(rows), *columns.T.shape))
            places = np.broadcast_to(rows[:, None], turned.shape)
            np.put_along_axis(turned, places, columns.T[None] * signs[:, None], axis=2)
            return (turned.reshape(-1, len(columns)) @ residuals).reshape(len(rows), columns.shape[1], -1)

        parts = products(self._columns)
        if not self._groups:
            total = np.einsum("sn,sn->n", residuals, residuals)
            return parts[:, 0], (total - np.einsum("pkn,pkn->pn", parts, parts))[None] / self.df
        variances = []
        for inside, df in zip(self._groups, self._group_df):
            total = np.einsum("sn,sn->n", residuals[inside], residuals[inside])
            own = self._columns[inside].T @ self._columns[inside]
            lost = 2 * products(self._columns * inside[:, None]) - own @ parts
            left = np.maximum(total - np.einsum("pkn,pkn->pn", lost, parts), 0.0)
            variances.append(left / df * (self._tested[inside] ** 2).sum())
        return parts[:, 0], np.array(variances)


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
    alike, block = _alike(subjects, blocks, whole)
    if not flip and max(map(len, alike)) < 2:
        what = "no two blocks have the same size" if whole else "every block has one subject"
        raise DoesNotApply(f"nothing can be exchanged among {block.max() + 1} blocks: {what}.")
    found = np.empty((count, subjects, 2))
    for k in range(count):
        rows, signs = np.arange(subjects), np.ones(subjects)
        if flip:
            signs = random.choice([-1.0, 1.0], subjects if blocks is None else block.max() + 1)
            signs = signs if blocks is None else signs[block]
        else:
            for same in alike:
                rows[same] = same[random.permutation(len(same))]
        found[k] = np.column_stack([rows, signs])
    return found


def possible_exchanges(subjects: int, flip: bool, blocks: Ints | None = None, whole: bool = False) -> int:
    """How many different exchanges there are."""
    alike, block = _alike(subjects, blocks, whole)
    return (
        2 ** (subjects if blocks is None else int(block.max()) + 1) if flip else prod(factorial(len(a)) for a in alike)
    )


def _alike(subjects: int, blocks: Ints | None, whole: bool) -> tuple[list[Ints], Ints]:
    """Sets (M, B) of M members that change places, single subjects (B = 1) or with ``whole`` blocks of B subjects, and
    the block of each subject (subjects,)."""
    block = np.unique(np.zeros(subjects) if blocks is None else blocks, return_inverse=True)[1]
    members = [np.flatnonzero(block == b) for b in range(block.max() + 1)]
    if not whole:
        return [inside[:, None] for inside in members], block
    sizes = sorted({len(inside) for inside in members})
    return [np.array([inside for inside in members if len(inside) == size]) for size in sizes], block


def largest(t_of: Callable[[Array], Array], shuffled: Array, mesh: Mesh, threshold: float, show: Progress) -> Array:
    """Of each exchange (P, S, 2), whose t (P, N) ``t_of`` gives: the largest abs(t), the area of the largest cluster,
    and the largest TFCE (P, 3)."""
    found = np.empty((len(shuffled), 3))
    for start in range(0, len(shuffled), PERMUTATIONS_AT_ONCE):
        stop = min(start + PERMUTATIONS_AT_ONCE, len(shuffled))
        t = t_of(shuffled[start:stop])
        order = np.argsort(-np.abs(t), axis=1, kind="stable")
        in_blocks(_largest, len(t), *reading(t, order, *mesh.arrays), threshold, found[start:stop])
        show(stop / len(shuffled), f"{stop} of {len(shuffled)} permutations")
    return found


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
    groups: Ints | None = None,
    forming_p: float = FORMING_P,
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
    groups : (S,) int64, optional
        Groups that differ in residual variance: t is Welch's, and signs of residuals are changed, which asks for
        symmetric errors and not for equal ones.
    forming_p : float
        Two-sided p at the height above which clusters are formed.
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
    model, Y = Model(design, contrast, groups), np.asarray(maps, dtype=np.float64)
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
    own = np.column_stack([np.arange(len(Y), dtype=np.float64), np.ones(len(Y))])[None]
    t, effect, degrees = np.full((3, len(known)), np.nan)
    residuals = model.residuals(Y[:, known])
    t[known], effect[known] = model.t(residuals, own)[0], model.effect(residuals)
    degrees[known] = model.degrees(residuals, own)
    flip = model.tests_a_mean or groups is not None
    shuffled = exchanges(len(Y), permutations, seed, flip=flip, blocks=blocks, whole=whole)
    if (unchanged := model.unchanged(shuffled)) == permutations:
        raise DoesNotApply(
            "no exchange changes what is tested: it is the same within every block, so exchange whole blocks "
            "(--whole-blocks); or it differs only within blocks, so don't."
        )

    def t_of(part: Array) -> Array:
        found = np.zeros((len(part), len(known)))
        found[:, known] = model.t(residuals, part)
        return found

    null = largest(t_of, shuffled, mesh, threshold, progress)
    ratio, variance_p = variance_trend(model.errors(residuals), model.freedom, model.regressor)
    cluster, rows = _cluster_table(t, effect, threshold, mesh, null[:, 1])
    return Inference(
        effect=effect,
        t=t,
        df=model.df,
        flipped=flip,
        p=2 * stats.t.sf(np.abs(t), degrees),
        p_height=share_above(np.abs(t), null[:, 0]),
        p_tfce=share_above(np.where(known, np.abs(tfce(t, mesh)), np.nan), null[:, 2]),
        threshold=threshold,
        cluster=cluster,
        clusters=rows,
        null_height=null[:, 0],
        null_area=null[:, 1],
        null_tfce=null[:, 2],
        degrees=degrees,
        at_peak=Y[:, np.nanargmax(np.abs(t))],
        possible=possible_exchanges(len(Y), flip, blocks, whole),
        least_p=(1 + unchanged) / (1 + permutations),
        variance_ratio=ratio,
        variance_p=variance_p,
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
