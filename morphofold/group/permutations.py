"""A linear model at every vertex, and what of it remains when subjects are exchanged at random."""

from dataclasses import dataclass
from itertools import groupby
from math import factorial, prod

import numpy as np
from scipy import stats

from morphofold.arrays import Array, Bools, Ints
from morphofold.errors import DoesNotApply, WrongShape
from morphofold.group.clusters import Mesh, by_size, clusters, enhanced, tfce
from morphofold.kernels import kernel, reading
from morphofold.progress import Progress, silent
from morphofold.provenance import Row
from morphofold.threads import in_blocks, one_blas_thread
from morphofold.validators import positive

FORMING_P = 0.001  # two-sided p of the height above which clusters are formed
PERMUTATIONS_AT_ONCE = 64  # bounds the memory
ROUND_OFF = 1e-9  # relative
CONSTANT = 1e-9
LEAST_FREEDOM = 1e-6  # of a residual that tells a variance


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
        Of :func:`variance_trend`.
    half_width : (N,) float64
        Of the 95 % interval of the effect at one vertex alone, if errors are normal.
    r : (N,) float64
        Size of the effect without a unit: t / sqrt(t^2 + df), the partial correlation of the map with what is tested.
    """

    effect: Array
    t: Array
    df: int
    flipped: bool
    p: Array
    p_height: Array
    p_tfce: Array
    threshold: float
    cluster: Ints
    clusters: list[Row]
    null_height: Array
    null_area: Array
    null_tfce: Array
    degrees: Array
    at_peak: Array
    possible: int
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
        self._groups = np.array([] if groups is None else [groups == g for g in np.unique(groups)], dtype=np.float64)
        if len(self._groups) and (self._groups @ self.freedom).min() < 1 - CONSTANT:
            raise DoesNotApply(
                "the residuals of a variance group have less than one degree of freedom. Merge it with another group."
            )

    def __repr__(self) -> str:
        return f"Model({len(self._tested)} subjects, {self.df} degrees of freedom)"

    @property
    def tests_a_mean(self) -> bool:
        """Whether what is tested is left of a constant map, so that exchanging subjects could not tell it from none."""
        return bool(np.abs(self.residuals(np.ones(len(self._tested)))).max() > CONSTANT)

    def unchanged(self, rows: Ints, signs: Array) -> int:
        """How many exchanges (P, S) leave what is tested as it is, but for its sign."""
        changed = self._tested[rows] * signs
        return int((np.abs(changed @ self._tested) >= 1 - CONSTANT).sum())

    def residuals(self, maps: Array) -> Array:
        """Maps (S, N) less what the columns explain that are not tested."""
        return maps - self._nuisance @ (self._nuisance.T @ maps)

    def effect(self, residuals: Array) -> Array:
        """The contrast of the coefficients (N,)."""
        return (self._tested @ residuals) / self._length

    def errors(self, residuals: Array) -> Array:
        """Residuals (S, N) of the whole model from those of the columns that are not tested."""
        return residuals - np.outer(self._tested, self._tested @ residuals)

    def t(self, residuals: Array, rows: Ints, signs: Array) -> Array:
        """t (P, N) after P exchanges (P, S): the row that comes to each place, its own with groups, and its sign.

        The squares of residuals sum to the same for every exchange, so the residuals of the model need not be computed:
        what they lose to the model is known from products of its few columns with the residuals.
        """
        if len(self._groups):
            return np.array([self.welch(residuals * sign[:, None])[0] for sign in signs])
        (P, S), N = rows.shape, residuals.shape[1]
        exchanged = np.empty((P, self._columns.shape[1], S))
        exchanged[np.arange(P)[:, None], :, rows] = self._columns * signs[..., None]
        parts = (exchanged.reshape(-1, S) @ residuals).reshape(P, -1, N)
        squares = np.einsum("sn,sn->n", residuals, residuals)
        variance = (squares - np.einsum("pkn,pkn->pn", parts, parts)) / self.df
        return _over_error(parts[:, 0], variance, squares / self.df)

    def welch(self, residuals: Array) -> tuple[Array, Array]:
        """t (N,) with the residual variance of each group, and its degrees of freedom (Welch and Satterthwaite)."""
        products = self._columns.T @ residuals
        squares = (residuals - self._columns @ products) ** 2
        df, weights = self._groups @ self.freedom, self._groups @ self._tested**2
        parts = (self._groups @ squares) * (weights / df)[:, None]
        variance, bottom = parts.sum(axis=0), (parts**2 / df[:, None]).sum(axis=0)
        degrees = np.divide(variance**2, bottom, out=np.full(len(bottom), float(self.df)), where=bottom > 0)
        return _over_error(products[0], variance, np.einsum("sn,sn->n", residuals, residuals) / self.df), degrees


def _over_error(product: Array, variance: Array, most: Array) -> Array:
    """A product over its standard error; 0 where its variance is round-off of the largest that it could have."""
    small = variance <= ROUND_OFF * most
    return np.where(small, 0.0, product / np.sqrt(np.where(small, 1.0, variance)))


def exchanges(
    subjects: int, count: int, seed: int, *, flip: bool = False, blocks: Ints | None = None, whole: bool = False
) -> tuple[Ints, Array, int]:
    """Random exchanges: the subject that comes to each place, and its sign (count, subjects); and how many exist.

    ``flip``: signs are random and subjects stay, where a mean is tested. ``blocks`` (subjects,): subjects
    are exchanged within blocks only, or each block has one sign. ``whole``: blocks change places with blocks of their
    size, and subjects keep their order within them.

    Raises
    ------
    DoesNotApply
        If nothing can be exchanged: every block has one subject, or no two blocks have the same size.
    """
    random = np.random.default_rng(seed)
    rows = np.tile(np.arange(subjects), (count, 1))
    if blocks is None:
        blocks = rows[0] * flip
    block = np.unique(blocks, return_inverse=True)[1]
    members = [np.flatnonzero(block == b) for b in range(block.max() + 1)]
    if flip:
        return rows, random.choice([-1.0, 1.0], (count, len(members)))[:, block], 2 ** len(members)
    sets = [inside[:, None] for inside in members]  # of members that change places: subjects, or blocks of one size
    if whole:
        sets = [np.array([*same]) for _, same in groupby(sorted(members, key=len), key=len)]
    if max(map(len, sets)) < 2:
        why = "no two blocks have the same size" if whole else "every block has one subject"
        raise DoesNotApply(f"nothing can be exchanged among {len(members)} blocks: {why}.")
    for row in rows:
        for same in sets:
            row[same] = same[random.permutation(len(same))]
    return rows, np.ones((count, subjects)), prod(factorial(len(same)) for same in sets)


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
    positive(permutations, "the number of permutations", "number")
    finite: Bools = np.asarray(np.isfinite(Y).all(axis=0))
    if not finite.any():
        raise DoesNotApply("no vertex has a value in all subjects. Leave out subjects without maps.")
    flip = model.tests_a_mean or groups is not None
    rows, signs, possible = exchanges(len(Y), permutations, seed, flip=flip, blocks=blocks, whole=whole)
    if (unchanged := model.unchanged(rows, signs)) == permutations:
        raise DoesNotApply(
            "no exchange changes what is tested: it is the same within every block, so exchange whole blocks "
            "(--whole-blocks); or it differs only within blocks, so don't."
        )
    threshold, residuals = float(stats.t.isf(FORMING_P / 2, model.df)), model.residuals(Y[:, finite])
    t, effect, degrees = np.full((3, len(finite)), np.nan)
    none = np.arange(len(Y))[None], np.ones((1, len(Y)))  # the exchange that changes nothing
    t[finite], effect[finite] = model.t(residuals, *none)[0], model.effect(residuals)
    degrees[finite] = model.df if groups is None else model.welch(residuals)[1]

    height, area, enhancement = _null(model, residuals, finite, rows, signs, mesh, threshold, progress).T
    cluster, rows_of_clusters = _cluster_table(t, effect, threshold, mesh, area)
    ratio, variance_p = variance_trend(model.errors(residuals), model.freedom, model.regressor)
    return Inference(
        effect=effect,
        t=t,
        df=model.df,
        flipped=flip,
        p=2 * stats.t.sf(np.abs(t), degrees),
        p_height=share_above(np.abs(t), height),
        p_tfce=share_above(np.where(finite, np.abs(tfce(t, mesh)), np.nan), enhancement),
        threshold=threshold,
        cluster=cluster,
        clusters=rows_of_clusters,
        null_height=height,
        null_area=area,
        null_tfce=enhancement,
        degrees=degrees,
        at_peak=Y[:, np.nanargmax(np.abs(t))],
        possible=possible,
        least_p=(1 + unchanged) / (1 + permutations),
        variance_ratio=ratio,
        variance_p=variance_p,
    )


def _null(
    model: Model,
    residuals: Array,
    finite: Bools,
    rows: Ints,
    signs: Array,
    mesh: Mesh,
    threshold: float,
    progress: Progress,
) -> Array:
    """Of each exchange: the largest abs(t), the area of the largest cluster, and the largest TFCE (P, 3)."""
    largest = np.empty((len(rows), 3))
    for start in range(0, len(rows), PERMUTATIONS_AT_ONCE):
        part = slice(start, start + PERMUTATIONS_AT_ONCE)
        t = np.zeros((len(rows[part]), len(finite)))
        t[:, finite] = model.t(residuals, rows[part], signs[part])
        in_blocks(_largest, len(t), *reading(t, by_size(t), mesh.ring, mesh.areas), threshold, largest[part])
        progress((start + len(t)) / len(rows), f"{start + len(t)} of {len(rows)} permutations")
    return largest


@kernel
def _largest(start, stop, t, order, indptr, indices, areas, threshold, largest):
    for k in range(start, stop):
        enhancement, area = enhanced(t[k], order[k], indptr, indices, areas, threshold)
        largest[k, 0], largest[k, 1], largest[k, 2] = np.abs(t[k]).max(), area, np.abs(enhancement).max()


def share_above(values: Array, null: Array) -> Array:
    """p (N,): the share of the null (P,) that is at least as large, the value itself among them; NaN stays NaN."""
    above = len(null) - np.searchsorted(np.sort(null), values - ROUND_OFF * np.abs(values), side="left")
    return np.where(np.isfinite(values), (1 + above) / (1 + len(null)), np.nan)


def _cluster_table(t: Array, effect: Array, threshold: float, mesh: Mesh, null: Array) -> tuple[Ints, list[Row]]:
    """The row of each vertex's cluster (N,), -1 for none, and the rows, the largest cluster first."""
    members, rows = [], []
    for sign in (1.0, -1.0):
        cluster, areas = clusters(sign * t, threshold, mesh)
        members += [(area, np.flatnonzero(cluster == k)) for k, area in enumerate(areas)]
    number = np.full(len(t), -1)
    for k, (area, inside) in enumerate(sorted(members, key=lambda each: -each[0])):
        number[inside] = k
        peak = int(inside[np.abs(t[inside]).argmax()])
        p = float(share_above(np.array([area]), null)[0])
        rows.append({"peak": peak, "t": t[peak], "effect": effect[peak], "area_mm2": area, "p": p})
    return number, rows


def variance_trend(errors: Array, freedom: Array, regressor: Array) -> tuple[float, float]:
    """Largest over smallest residual variance along a regressor, and p that it does not depend on it.

    Parameters
    ----------
    errors : (S, N) float64
        Residuals of the whole model.
    freedom : (S,) float64
        Degrees of freedom of each subject's residuals, between 0 and 1.
    regressor : (S,) float64

    Returns
    -------
    ratio, p : float
        NaN if the regressor has one value.

    Notes
    -----
    Squared residuals over their mean at each vertex are averaged over the vertices: a number for each subject. Their
    logarithms are fitted by the regressor and its square, and p is that of the F test, as Breusch and Pagan 1979
    (Econometrica 47) do for one variable. Subjects are the units, so vertices may depend on each other.
    """
    usable = freedom > LEAST_FREEDOM
    scale = (errors**2).mean(axis=0)
    relative = (errors[:, scale > 0] ** 2 / scale[scale > 0]).mean(axis=1)[usable] / freedom[usable]
    logs, x = np.log(np.maximum(relative, np.finfo(float).tiny)), regressor[usable]
    x = (x - x.mean()) / (np.ptp(x) or 1.0)
    df = min(len(np.unique(x.round(9))), 3) - 1
    left_df = len(x) - df - 1
    if df < 1 or left_df < 1:
        return np.nan, np.nan
    fitted = np.polynomial.Polynomial.fit(x, logs, df)(x)
    explained, left = ((fitted - logs.mean()) ** 2).sum(), ((logs - fitted) ** 2).sum()
    return float(np.exp(np.ptp(fitted))), float(stats.f.sf(explained / df * left_df / max(left, 1e-300), df, left_df))
