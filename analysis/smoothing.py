"""Smoothing of maps along a surface, by a Gaussian kernel of a given full width at half maximum."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from morphofold.analysis.diffusion import diffusion
from morphofold.analysis.graph.depth_potential import COTANGENT_BOUNDS
from morphofold.arrays import Array
from morphofold.errors import OutOfRange, WrongShape
from morphofold.surface import Faces, Verts, check_mesh

FWHM_PER_DEVIATION = math.sqrt(8 * math.log(2))
STEPS = 8  # of the heat flow; with these the width of the kernel is right to 1 % up to 11 edges
GAMMA = 1 - math.sqrt(0.5)  # of each step's two stages
TOLERANCE = 1e-6  # of a stage
LEAST_SHARE = 1e-3  # of a kernel that lies on known values, below which there is no value


def smooth(
    verts: Verts,
    faces: Faces,
    values: Array,
    fwhm: float,
    inside: NDArray[np.bool_] | None = None,
    *,
    fill: float | None = None,
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
    solved with linear elements in eight steps of the two-stage scheme of Alexander 1977 (SIAM J. Numer. Anal. 14). It
    is of second order and damps the shortest waves. Without unknown values, the integral of a map stays the same.
    """
    check_mesh(verts, faces)
    if not (math.isfinite(fwhm) and fwhm > 0):
        raise OutOfRange(f"fwhm must be a positive length in mm, got {fwhm!r}.")
    if np.ndim(values) not in (1, 2) or len(values) != len(verts):
        raise WrongShape(f"values must be ({len(verts)},) or ({len(verts)}, K), got {np.shape(values)}.")
    maps = np.asarray(values, dtype=np.float64).reshape(len(verts), -1)
    there = np.ones((len(verts), 1), dtype=bool) if inside is None else np.asarray(inside, dtype=bool)[:, None]
    known = np.isfinite(maps) & there
    held, which = np.unique(known, axis=1, return_inverse=True)  # maps with the same known vertices share their weights
    both = _flow(verts, faces, np.concatenate([np.where(known, maps, 0.0), held.astype(np.float64)], axis=1), fwhm)
    total, share = both[:, : maps.shape[1]], both[:, maps.shape[1] :][:, which.ravel()]
    found = np.full(maps.shape, np.nan)
    filled = np.zeros_like(known) if fill is None else there & (share >= max(fill, LEAST_SHARE))
    np.divide(total, share, out=found, where=(known & (share > LEAST_SHARE)) | filled)
    return found.reshape(np.shape(values))


def _flow(verts: Verts, faces: Faces, fields: Array, fwhm: float) -> Array:
    solver = diffusion(verts, faces, COTANGENT_BOUNDS)
    step = (fwhm / FWHM_PER_DEVIATION) ** 2 / 2 / STEPS
    mass = solver.mass[:, None]
    for _ in range(STEPS):
        once = solver.solve(GAMMA * step, mass * fields, fields, TOLERANCE)
        twice = solver.solve(GAMMA * step, mass * once, once, TOLERANCE)
        fields = (1 + math.sqrt(2)) * twice - math.sqrt(2) * once
    return fields
