"""A linear model at every vertex, and what of it remains when subjects are exchanged at random."""

from dataclasses import dataclass
from itertools import groupby
from math import factorial, prod

import numpy as np
from scipy import stats

from morphofold.digests_and_json import Row
from morphofold.errors import DoesNotApply, WrongShape
from morphofold.frozen_arrays import Array, Bools, Ints
from morphofold.group.clusters import Mesh, by_size, clusters, enhanced, tfce
from morphofold.kernels import kernel, reading
from morphofold.progress_callbacks import Progress, logged
from morphofold.threads import in_blocks, one_blas_thread
from morphofold.validators import positive

FORMING_P = 0.001  # two-sided p of the height above which clusters are formed
PERMUTATIONS_AT_ONCE = 64  # bounds the memory
ROUND_OFF = 1e-9  # relative
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
    by_signs : bool
        Whether signs were changed, because a mean is tested; else subjects or blocks were exchanged.
    p : (N,) float64
        Two-sided, of one vertex alone, if errors are normal.
    p_height : (N,) float64
        Two-sided, corrected for the whole surface: share of permutations whose largest abs(t) is at least as large.
    p_tfce : (N,) float64
        The same of threshold-free cluster enhancement.
    threshold : float
        The abs(t) above which clusters are formed.
    cluster_of : (N,) int64
        Row of ``clusters`` in which each vertex lies; -1: none.
    clusters : list of dict
        ``peak`` (vertex), ``t`` and ``effect`` there, ``area_mm2``, ``p`` (share of permutations whose largest cluster
        is at least as large), the largest first.
    null_height, null_area, null_tfce : (P,) float64
        The largest of each permutation.
    df_map : (N,) float64
        Degrees of freedom of each t: ``df``, or Welch's with variance groups.
    peak_values : (S,) float64
        The maps at the vertex with the largest abs(t).
    n_possible : int
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
    by_signs: bool
    p: Array
    p_height: Array
    p_tfce: Array
    threshold: float
    cluster_of: Ints
    clusters: list[Row]
    null_height: Array
    null_area: Array
    null_tfce: Array
    df_map: Array
    peak_values: Array
    n_possible: int
    least_p: float
    variance_ratio: float
    variance_p: float

    @property
    def r(self) -> Array:
        return self.t / np.sqrt(self.t**2 + self.df_map)

    @property
    def half_width(self) -> Array:
        standard_error = np.divide(self.effect, self.t, out=np.full(len(self.t), np.nan), where=self.t != 0)
        return np.abs(standard_error) * stats.t.ppf(0.975, self.df_map)

    def __repr__(self) -> str:
        n_tested = np.count_nonzero(np.isfinite(self.p))
        smallest_p = np.nanmin(self.p_tfce) if n_tested else np.nan
        tested = f"{n_tested:,} of {len(self.p):,} vertices tested"
        return (
            f"Inference({tested}, df {self.df}, smallest corrected p {smallest_p:.3g}, {len(self.clusters)} clusters)"
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
    subject_df : (S,) float64
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
        n_subjects, n_columns = X.shape
        norms = np.maximum(np.linalg.norm(X, axis=0), np.finfo(float).tiny)  # a unit changes neither rank nor space
        rank = int(np.linalg.matrix_rank(X / norms))
        if rank < n_columns:
            raise DoesNotApply(
                f"of the {n_columns} columns of the design only {rank} are independent: a column is constant, repeats "
                "another or is a sum of others. Leave it out."
            )
        if n_subjects <= n_columns:
            raise DoesNotApply(f"{n_subjects} subjects can't determine {n_columns} columns and an error. Add subjects.")
        nuisance = X / norms @ np.linalg.svd((c / norms)[None])[2][1:].T  # what the contrast does not weigh of columns
        self._nuisance = np.linalg.qr(nuisance)[0]
        self.regressor: Array = X @ c / (c @ c)
        tested_regressor = self.residuals(self.regressor)
        self._length = np.linalg.norm(tested_regressor)
        self._tested = tested_regressor / self._length
        self._columns = np.column_stack([self._tested, self._nuisance])
        self.df = n_subjects - n_columns
        self.subject_df: Array = 1 - (self._columns**2).sum(axis=1)
        self._groups = np.array([] if groups is None else [groups == g for g in np.unique(groups)], dtype=np.float64)
        if len(self._groups) and (self._groups @ self.subject_df).min() < 1 - ROUND_OFF:
            raise DoesNotApply(
                "the residuals of a variance group have less than one degree of freedom. Merge it with another group."
            )

    def __repr__(self) -> str:
        return f"Model({len(self._tested)} subjects, {self.df} degrees of freedom)"

    @property
    def tests_a_mean(self) -> bool:
        """Whether what is tested is left of a constant map, so that exchanging subjects could not tell it from none."""
        return bool(np.abs(self.residuals(np.ones(len(self._tested)))).max() > ROUND_OFF)

    def unchanged(self, orders: Ints, signs: Array) -> int:
        """How many exchanges (P, S) leave what is tested as it is, but for its sign."""
        exchanged_regressor = self._tested[orders] * signs
        return int((np.abs(exchanged_regressor @ self._tested) >= 1 - ROUND_OFF).sum())

    def residuals(self, maps: Array) -> Array:
        """Maps (S, N) less what the columns explain that are not tested."""
        return maps - self._nuisance @ (self._nuisance.T @ maps)

    def effect(self, residuals: Array) -> Array:
        """The contrast of the coefficients (N,)."""
        return (self._tested @ residuals) / self._length

    def errors(self, residuals: Array) -> Array:
        """Residuals (S, N) of the whole model from those of the columns that are not tested."""
        return residuals - np.outer(self._tested, self._tested @ residuals)

    def t(self, residuals: Array, orders: Ints, signs: Array) -> Array:
        """t (P, N) after P exchanges (P, S): the row that comes to each place, its own with groups, and its sign.

        The squares of residuals sum to the same for every exchange, so the residuals of the model need not be computed:
        what they lose to the model is known from products of its few columns with the residuals.
        """
        if len(self._groups):
            return np.array([self.welch(residuals * subject_signs[:, None])[0] for subject_signs in signs])
        (n_exchanges, n_subjects), n_vertices = orders.shape, residuals.shape[1]
        exchanged_columns = np.empty((n_exchanges, self._columns.shape[1], n_subjects))
        exchanged_columns[np.arange(n_exchanges)[:, None], :, orders] = self._columns * signs[..., None]
        column_products = (exchanged_columns.reshape(-1, n_subjects) @ residuals).reshape(n_exchanges, -1, n_vertices)
        residual_squares = np.einsum("sn,sn->n", residuals, residuals)
        variance = (residual_squares - np.einsum("pkn,pkn->pn", column_products, column_products)) / self.df
        return _over_error(column_products[:, 0], variance, residual_squares / self.df)

    def welch(self, residuals: Array) -> tuple[Array, Array]:
        """t (N,) with the residual variance of each group, and its degrees of freedom (Welch and Satterthwaite)."""
        column_products = self._columns.T @ residuals
        squared_residuals = (residuals - self._columns @ column_products) ** 2
        group_df, group_weights = self._groups @ self.subject_df, self._groups @ self._tested**2
        group_variances = (self._groups @ squared_residuals) * (group_weights / group_df)[:, None]
        variance, divisor = group_variances.sum(axis=0), (group_variances**2 / group_df[:, None]).sum(axis=0)
        df_map = np.divide(variance**2, divisor, out=np.full(len(divisor), float(self.df)), where=divisor > 0)
        return _over_error(column_products[0], variance, np.einsum("sn,sn->n", residuals, residuals) / self.df), df_map


def _over_error(product: Array, variance: Array, largest_variance: Array) -> Array:
    """A product over its standard error; 0 where its variance is round-off of the largest that it could have."""
    is_round_off = variance <= ROUND_OFF * largest_variance
    return np.where(is_round_off, 0.0, product / np.sqrt(np.where(is_round_off, 1.0, variance)))


def exchanges(
    n_subjects: int, n_exchanges: int, seed: int, *, flip: bool = False, blocks: Ints | None = None, whole: bool = False
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
    generator = np.random.default_rng(seed)
    orders = np.tile(np.arange(n_subjects), (n_exchanges, 1))
    if blocks is None:
        blocks = orders[0] * flip
    block_numbers = np.unique(blocks, return_inverse=True)[1]
    members = [np.flatnonzero(blocks == block) for block in np.unique(blocks)]
    if flip:
        return orders, generator.choice([-1.0, 1.0], (n_exchanges, len(members)))[:, block_numbers], 2 ** len(members)
    place_sets = [block[:, None] for block in members]  # of members that change places: subjects, or blocks of one size
    if whole:
        place_sets = [np.array([*places]) for _, places in groupby(sorted(members, key=len), key=len)]
    if max(map(len, place_sets)) < 2:
        reason = "no two blocks have the same size" if whole else "every block has one subject"
        raise DoesNotApply(f"nothing can be exchanged among {len(members)} blocks: {reason}.")
    for order in orders:
        for places in place_sets:
            order[places] = places[generator.permutation(len(places))]
    return orders, np.ones((n_exchanges, n_subjects)), prod(factorial(len(places)) for places in place_sets)


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
    progress: Progress = logged,
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
    if Y.shape != (len(design), len(mesh.areas)):
        raise WrongShape(f"maps {Y.shape} must be ({len(design)}, {len(mesh.areas)}): subjects and vertices.")
    positive(permutations, "the number of permutations", "number")
    is_tested = np.all(np.isfinite(Y), axis=0)
    if not is_tested.any():
        raise DoesNotApply("no vertex has a value in all subjects. Leave out subjects without maps.")
    flips_signs = model.tests_a_mean or groups is not None
    orders, signs, n_possible = exchanges(len(Y), permutations, seed, flip=flips_signs, blocks=blocks, whole=whole)
    if (n_unchanged := model.unchanged(orders, signs)) == permutations:
        raise DoesNotApply(
            "no exchange changes what is tested: it is the same within every block, so exchange whole blocks "
            "(--whole-blocks); or it differs only within blocks, so don't."
        )
    threshold, residuals = float(stats.t.isf(FORMING_P / 2, model.df)), model.residuals(Y[:, is_tested])
    t, effect, vertex_df = np.full((3, len(is_tested)), np.nan)
    t[is_tested] = model.t(residuals, np.arange(len(Y))[None], np.ones((1, len(Y))))[0]  # nothing is exchanged
    effect[is_tested] = model.effect(residuals)
    vertex_df[is_tested] = model.df if groups is None else model.welch(residuals)[1]

    null_heights, null_areas, null_tfce = _null(model, residuals, is_tested, orders, signs, mesh, threshold, progress).T
    cluster_of, cluster_rows = _cluster_table(t, effect, threshold, mesh, null_areas)
    variance_ratio, variance_p = variance_trend(model.errors(residuals), model.subject_df, model.regressor)
    return Inference(
        effect=effect,
        t=t,
        df=model.df,
        by_signs=flips_signs,
        p=2 * stats.t.sf(np.abs(t), vertex_df),
        p_height=share_above(np.abs(t), null_heights),
        p_tfce=share_above(np.where(is_tested, np.abs(tfce(t, mesh)), np.nan), null_tfce),
        threshold=threshold,
        cluster_of=cluster_of,
        clusters=cluster_rows,
        null_height=null_heights,
        null_area=null_areas,
        null_tfce=null_tfce,
        df_map=vertex_df,
        peak_values=Y[:, np.nanargmax(np.abs(t))],
        n_possible=n_possible,
        least_p=(1 + n_unchanged) / (1 + permutations),
        variance_ratio=variance_ratio,
        variance_p=variance_p,
    )


def _null(
    model: Model,
    residuals: Array,
    is_tested: Bools,
    orders: Ints,
    signs: Array,
    mesh: Mesh,
    threshold: float,
    progress: Progress,
) -> Array:
    """Of each exchange: the largest abs(t), the area of the largest cluster, and the largest TFCE (P, 3)."""
    null_largest = np.empty((len(orders), 3))
    for first in range(0, len(orders), PERMUTATIONS_AT_ONCE):
        batch = slice(first, first + PERMUTATIONS_AT_ONCE)
        t = np.zeros((len(orders[batch]), len(is_tested)))
        t[:, is_tested] = model.t(residuals, orders[batch], signs[batch])
        in_blocks(_largest, len(t), *reading(t, by_size(t), mesh.ring, mesh.areas), threshold, null_largest[batch])
        progress((first + len(t)) / len(orders), f"{first + len(t)} of {len(orders)} permutations")
    return null_largest


@kernel
def _largest(start, stop, t, order, indptr, indices, areas, threshold, largest):
    for row in range(start, stop):
        tfce_map, largest_area = enhanced(t[row], order[row], indptr, indices, areas, threshold)
        largest[row, 0], largest[row, 1], largest[row, 2] = np.abs(t[row]).max(), largest_area, np.abs(tfce_map).max()


def share_above(values: Array, null_values: Array) -> Array:
    """p (N,): the share of the null (P,) that is at least as large, the value itself among them; NaN stays NaN."""
    n_above = len(null_values) - np.searchsorted(np.sort(null_values), values - ROUND_OFF * np.abs(values), side="left")
    return np.where(np.isfinite(values), (1 + n_above) / (1 + len(null_values)), np.nan)


def _cluster_table(t: Array, effect: Array, threshold: float, mesh: Mesh, null_areas: Array) -> tuple[Ints, list[Row]]:
    """The row of each vertex's cluster (N,), -1 for none, and the rows, the largest cluster first."""
    sized_clusters, rows = [], []
    for sign in (1.0, -1.0):
        cluster_of, areas = clusters(sign * t, threshold, mesh)
        sized_clusters += [(area, np.flatnonzero(cluster_of == number)) for number, area in enumerate(areas)]
    row_of_vertex = np.full(len(t), -1)
    for number, (area, vertices) in enumerate(sorted(sized_clusters, key=lambda sized_cluster: -sized_cluster[0])):
        row_of_vertex[vertices] = number
        peak = int(vertices[np.abs(t[vertices]).argmax()])
        p = share_above(np.array([area]), null_areas)[0]
        rows.append({"peak": peak, "t": t[peak], "effect": effect[peak], "area_mm2": area, "p": p})
    return row_of_vertex, rows


def variance_trend(errors: Array, subject_df: Array, regressor: Array) -> tuple[float, float]:
    """Largest over smallest residual variance along a regressor, and p that it does not depend on it.

    Parameters
    ----------
    errors : (S, N) float64
        Residuals of the whole model.
    subject_df : (S,) float64
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
    is_usable = subject_df > LEAST_FREEDOM
    mean_sq = (errors**2).mean(axis=0)
    variance = (errors[:, mean_sq > 0] ** 2 / mean_sq[mean_sq > 0]).mean(axis=1)[is_usable] / subject_df[is_usable]
    log_variance, x = np.log(np.maximum(variance, np.finfo(float).tiny)), regressor[is_usable]
    x = (x - x.mean()) / (np.ptp(x) or 1.0)
    df = min(len(np.unique(x.round(9))), 3) - 1
    error_df = len(x) - df - 1
    if df < 1 or error_df < 1:
        return np.nan, np.nan
    fitted = np.polynomial.Polynomial.fit(x, log_variance, df)(x)
    fit_ss, rest_ss = ((fitted - log_variance.mean()) ** 2).sum(), ((log_variance - fitted) ** 2).sum()
    return float(np.exp(np.ptp(fitted))), float(stats.f.sf(fit_ss / df * error_df / max(rest_ss, 1e-300), df, error_df))
