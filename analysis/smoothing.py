"""Smoothing of maps along a surface, by a Gaussian kernel of a given full width at half maximum."""

import math

import numpy as np
from scipy import sparse
from scipy.special import ive

from morphofold.analysis.diffusion import diffusion
from morphofold.analysis.graph.depth_potential import COTANGENT_BOUNDS
from morphofold.errors import WrongShape
from morphofold.frozen_arrays import Array, Bools
from morphofold.geometry import cotangent_laplacian, vertex_areas
from morphofold.kernels import kernel, reading
from morphofold.surface import Faces, Verts
from morphofold.threads import in_blocks
from morphofold.validators import check_mesh, positive

FWHM_PER_DEVIATION = math.sqrt(8 * math.log(2))
LEAST_TERMS, MOST_TERMS_PER_ROOT = 20, 10.0  # of the series: those beyond are below TERM_TOLERANCE
TERM_TOLERANCE = 1e-10  # of its terms
MOST_TERMS = 300  # with more, steps are faster
N_STEPS = 8  # with these the width of the kernel is right to 1 % up to 11 edges
GAMMA = 1 - math.sqrt(0.5)  # of each step's two stages
TOLERANCE_OF_STAGE = 1e-6
LEAST_SHARE = 1e-3  # of a kernel that lies on known values, below which there is no value


def smooth(
    verts: Verts, faces: Faces, values: Array, fwhm: float, inside: Bools | None = None, *, fill: float | None = None
) -> Array:
    """Smooth maps by heat flow along the surface.

    Parameters
    ----------
    verts, faces : (N, 3) float64, (M, 3) int64
        Surface along which distances count [mm].
    values : (N,) or (N, K) float64
        One map, or several. NaN where unknown.
    fwhm : float
        Full width at half maximum of the kernel [mm]; 2.355 of its standard deviations.
    inside : (N,) bool, optional
        Vertices to smooth, such as the cortex; None: all.
    fill : float, optional
        Give a value also where it is unknown, inside, if at least this share of the kernel lies on known values.

    Returns
    -------
    array like ``values``
        NaN outside, and where a value is unknown and not filled. Values from outside, or unknown ones, have no
        influence: the kernel is divided by its share on known values.

    Raises
    ------
    ValueError
        If the arrays do not fit each other or are not a mesh, or ``fwhm`` is not a positive length.

    Notes
    -----
    The heat equation ``du/dt = div grad u`` over the time fwhm^2 / (16 ln 2) has a Gaussian kernel in the plane. It is
    solved with linear elements in space and exactly in time, by a Chebyshev series of the exponential (Tal-Ezer,
    Kosloff 1984, J. Chem. Phys. 81). Where tiny triangles make the series long, it is solved in eight steps of the
    two-stage scheme of Alexander 1977 (SIAM J. Numer. Anal. 14), which is of second order; the two agree to 0.5 % of
    the largest value. Without unknown values, the integral of a map stays the same.
    """
    check_mesh(verts, faces)
    positive(fwhm, "fwhm")
    if np.ndim(values) not in (1, 2) or len(values) != len(verts):
        raise WrongShape(f"values must be ({len(verts)},) or ({len(verts)}, K), got {np.shape(values)}.")
    maps = np.asarray(values, dtype=np.float64).reshape(len(verts), -1)
    is_inside = np.ones((len(verts), 1), dtype=bool) if inside is None else np.asarray(inside, dtype=bool)[:, None]
    is_known = np.isfinite(maps) & is_inside
    masks, mask_index = np.unique(
        is_known, axis=1, return_inverse=True
    )  # maps with the same known vertices share their weights
    flows = _flow(verts, faces, np.concatenate([np.where(is_known, maps, 0.0), masks.astype(np.float64)], axis=1), fwhm)
    weighted_sums, known_weight = flows[:, : maps.shape[1]], flows[:, maps.shape[1] :][:, mask_index.ravel()]
    smoothed = np.full(maps.shape, np.nan)
    is_filled = np.zeros_like(is_known) if fill is None else is_inside & (known_weight >= max(fill, LEAST_SHARE))
    np.divide(weighted_sums, known_weight, out=smoothed, where=(is_known & (known_weight > LEAST_SHARE)) | is_filled)
    return smoothed.reshape(np.shape(values))


def _flow(verts: Verts, faces: Faces, fields: Array, fwhm: float) -> Array:
    """The fields (N, K) after the heat flow."""
    time = (fwhm / FWHM_PER_DEVIATION) ** 2 / 2
    mass, stiffness = vertex_areas(verts, faces), cotangent_laplacian(verts, faces, clip=COTANGENT_BOUNDS)
    if mass.all():
        eigenvalue_bound = float(np.max(abs(stiffness).sum(axis=1) / mass))  # at least the largest eigenvalue
        bessel_arg = time * eigenvalue_bound / 2
        terms = 2 * ive(np.arange(LEAST_TERMS + math.ceil(MOST_TERMS_PER_ROOT * math.sqrt(bessel_arg))), bessel_arg)
        terms = terms[: max(2, np.flatnonzero(terms > TERM_TOLERANCE)[-1] + 1)]
        if len(terms) <= MOST_TERMS:
            return _by_series(mass, stiffness, fields, terms, eigenvalue_bound)
    return _by_steps(verts, faces, fields, time)


def _by_series(mass: Array, stiffness: sparse.csr_array, fields: Array, coefficients: Array, eig_bound: float) -> Array:
    """A Chebyshev series of ``exp(-time M^-1/2 L M^-1/2)``; the matrix is symmetric, its eigenvalues 0 to 1."""
    mass_root = np.sqrt(mass)
    scaled_stiffness = sparse.diags_array(1 / mass_root) @ stiffness @ sparse.diags_array(1 / mass_root)
    step_matrix = sparse.csr_array(sparse.eye_array(len(mass)) - (2 / eig_bound) * scaled_stiffness)
    previous = mass_root[:, None] * fields
    current = step_matrix @ previous
    series_sum = 0.5 * coefficients[0] * previous + coefficients[1] * current
    for coefficient in coefficients[2:]:
        in_blocks(_add_term, len(mass), *reading(step_matrix, current), coefficient, previous, series_sum)
        previous, current = current, previous
    return series_sum / mass_root[:, None]


@kernel
def _add_term(start, stop, indptr, indices, data, current, coefficient, previous, series_sum):
    """Replace ``previous`` (N, K) by 2 step current - previous, the next polynomial; add ``coefficient`` of it."""
    for i in range(start, stop):
        for k in range(current.shape[1]):
            previous[i, k] = -previous[i, k]
        for e in range(indptr[i], indptr[i + 1]):
            neighbour, weight = indices[e], 2.0 * data[e]
            for k in range(current.shape[1]):
                previous[i, k] += weight * current[neighbour, k]
        for k in range(current.shape[1]):
            series_sum[i, k] += coefficient * previous[i, k]


def _by_steps(verts: Verts, faces: Faces, fields: Array, time: float) -> Array:
    """Implicit steps of two stages, for meshes with triangles so small that the series is long."""
    solver, time_step = diffusion(verts, faces, COTANGENT_BOUNDS), time / N_STEPS
    mass = solver.mass[:, None]
    for _ in range(N_STEPS):
        stage_one = solver.solve(GAMMA * time_step, mass * fields, fields, TOLERANCE_OF_STAGE)
        stage_two = solver.solve(GAMMA * time_step, mass * stage_one, stage_one, TOLERANCE_OF_STAGE)
        fields = (1 + math.sqrt(2)) * stage_two - math.sqrt(2) * stage_one
    return fields
