"""A cortex at coarser and coarser scales: areas and thickness after everything narrower than a length has merged."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numba import njit, prange
from scipy import stats
from scipy.spatial import ConvexHull

from morphofold.analysis.gyrification.convex_hull import hull
from morphofold.analysis.gyrification.folding_law import ShapeTerms, shape_terms
from morphofold.arrays import Array
from morphofold.errors import OpenSurface, OutOfRange, TooLarge
from morphofold.geometry import components, face_areas, is_closed
from morphofold.kernels import kernel
from morphofold.surface import Cortex, Surface, Verts
from morphofold.threads import run_parallel
from morphofold.validators import check_kind

FINEST_OVER_T, SCALE_RATIO, SCALES = 0.2, 2**0.5, 9  # of the default scales: the first over the thickness
VOXELS_PER_SCALE = 3.0
POINTS_PER_VOXEL = 1.4  # along the edges of a triangle
VOXELS_AROUND = 1.75  # beyond the level, to which distances are computed
MARGIN = 5  # voxels around the surface
THINNED_IN_VOXELS = 0.4  # of points closer than this one is kept
MOST_VOXELS = 1.5e8
LEAST_FOLDING = 1.1  # total over exposed area of a surface that still has folds


@dataclass(frozen=True)
class AtScale:
    """A cortex at one ``scale`` [mm]; ``terms`` are its areas [mm^2], thickness [mm], K, I and S."""

    scale: float
    terms: ShapeTerms


@dataclass(frozen=True)
class LawAcrossScales:
    """How a cortex follows the folding law over its scales, by least squares, with intervals (95 %).

    The points of one trajectory are not independent, so the intervals are too narrow.

    Attributes
    ----------
    slope, slope_low, slope_high : float
        Slope of ``log(A_total T^(1/2))`` over ``log A_exposed``, lengths in units of the scale; the law has 5/4. Both
        axes are divided by the scale, so it is near 5/4 for any body.
    exponent, exponent_low, exponent_high : float
        Slope of ``log(A_total / A_exposed^(5/4))`` over ``log T``; the law has -1/2, a body without folds nearly 0.
    """

    slope: float
    slope_low: float
    slope_high: float
    exponent: float
    exponent_low: float
    exponent_high: float


def across_scales(cortex: Cortex, scales: Sequence[float] | None = None) -> list[AtScale]:
    """Areas, thickness and shape terms of a cortex at several scales.

    Parameters
    ----------
    cortex : Cortex
        Closed white and pial surface [mm].
    scales : sequence of float, optional
        Lengths [mm]; 0 is the cortex as it is. None: 0, and from 0.2 to 3.2 cortical thicknesses in steps of sqrt(2),
        without those that need too many voxels.

    Returns
    -------
    list of AtScale
        One for each scale at which white matter is left, in the order given.

    Raises
    ------
    ValueError
        If a surface is not one closed piece; or a scale is negative or not finite, or needs more than 1.5e8 voxels.

    Notes
    -----
    At the scale L, every ball of diameter L centred in gray matter is gray: the pial surface moves outward and the
    white surface inward by L/2, so sulci and gyral blades narrower than L merge. Wang and others 2024 (eLife 92080)
    coarse-grain on a grid of cubes. With balls no direction counts more than another, but numbers
    need not be theirs. The total area is that of the outer surface alone, without enclosed hollows; exposed is its
    convex hull; thickness is the volume between both surfaces over their mean area. Areas of a sphere are too small
    by up to 0.4 % at scales up to a quarter of its radius; those of a folded surface depend by 0.6 % on where the grid
    of distances lies. A hemisphere of 150,000 vertices takes a minute on two cores.
    """
    check_kind(cortex, Cortex, "across_scales: cortex")
    for name, surface in (("white", cortex.white), ("pial", cortex.pial)):
        if not is_closed(surface.faces) or components(len(surface.verts), surface.faces)[0] != 1:
            raise OpenSurface(f"{cortex.called}: {name} is not one closed piece, so nothing is inside it. Close it.")
    now = _as_it_is(cortex)
    if scales is None:
        those = FINEST_OVER_T * now.thickness * SCALE_RATIO ** np.arange(SCALES)
        scales = [0.0, *(scale for scale in those if np.prod(_grid(cortex.pial, scale)) <= MOST_VOXELS)]
    if wrong := [scale for scale in scales if not (math.isfinite(scale) and scale >= 0)]:
        raise OutOfRange(f"a scale must be 0 or a length in mm, got {wrong[0]!r}.")
    found = ((float(scale), _at(cortex, scale) if scale else now) for scale in scales)
    return [AtScale(scale, terms) for scale, terms in found if terms is not None]


def law_across_scales(rows: Sequence[AtScale], least_folding: float = LEAST_FOLDING) -> LawAcrossScales:
    """The folding law over the ``rows`` of :func:`across_scales`, as far as there are folds.

    Used are the scales that are not 0 and at which total over exposed area is at least ``least_folding``. Raises
    ``OutOfRange`` if these are fewer than three.
    """
    used = [row for row in rows if row.scale > 0 and row.terms.total >= least_folding * row.terms.exposed]
    if len(used) < 3:
        raise OutOfRange(
            f"the law across scales needs three scales with folds, total over exposed area at least {least_folding:g}; "
            f"got {len(used)} of {len(rows)}. Measure at more scales, or smaller ones."
        )
    scale = np.log([row.scale for row in used])
    total, exposed, thickness = np.log([(row.terms.total, row.terms.exposed, row.terms.thickness) for row in used]).T
    slope = _slope(exposed - 2 * scale, total + thickness / 2 - 2.5 * scale)
    return LawAcrossScales(*slope, *_slope(thickness, total - 1.25 * exposed))


def _slope(x: Array, y: Array) -> tuple[float, float, float]:
    """Slope by least squares, and its interval."""
    line = stats.linregress(x, y)
    half = stats.t.ppf(0.975, len(x) - 2) * line.stderr
    return float(line.slope), float(line.slope - half), float(line.slope + half)


def _as_it_is(cortex: Cortex) -> ShapeTerms:
    (pial, inside_pial), (white, inside_white) = (
        (float(face_areas(s.verts, s.faces).sum()), _polydata(s).volume) for s in (cortex.pial, cortex.white)
    )
    exposed = float(hull(cortex.pial.verts, cortex.faces).area)
    return shape_terms(pial, exposed, 2 * (inside_pial - inside_white) / (pial + white))


def _at(cortex: Cortex, scale: float) -> ShapeTerms | None:
    """The shape terms at a scale [mm]; None if no white matter is left."""
    outer, inner = run_parallel(partial(_moved, cortex.pial, scale, True), partial(_moved, cortex.white, scale, False))
    if inner.n_points == 0:
        return None
    exposed = float(ConvexHull(np.asarray(outer.points, dtype=np.float64)).area)
    return shape_terms(outer.area, exposed, 2 * (outer.volume - inner.volume) / (outer.area + inner.area))


def _moved(surface: Surface, scale: float, outward: bool) -> Any:
    """The surface moved by half a ``scale``, as a ``pyvista.PolyData``: the level of the distance from it."""
    import pyvista

    voxel, level = scale / VOXELS_PER_SCALE, 0.5 * VOXELS_PER_SCALE  # the level in voxels, like all that follows
    count = np.prod(_grid(surface, scale))
    if count > MOST_VOXELS:
        raise TooLarge(
            f"a scale of {scale:g} mm needs {count:.1e} voxels for a body of "
            f"{np.ptp(surface.verts, axis=0).max():.0f} mm; choose a larger one. Are the coordinates in mm?"
        )
    low = surface.verts.min(axis=0) - MARGIN * voxel
    shape = _grid(surface, scale).astype(int)
    grid = pyvista.ImageData(dimensions=shape, spacing=3 * (voxel,), origin=low)
    solid = _polydata(surface).voxelize_binary_mask(reference_volume=grid).point_data["mask"]
    points = _points(surface, voxel)
    points = (points - low) / voxel
    plane = np.floor(points[:, 0]).astype(np.int64)
    order = np.argsort(plane, kind="stable")
    first = np.searchsorted(plane[order], np.arange(shape[0] + 1))
    squared = np.empty(shape, np.float32)
    _squared_distances(points[order], first, level + VOXELS_AROUND, squared)
    squared = squared.ravel(order="F")
    squared[(solid > 0) == outward] = 0.0
    grid.point_data["distance"] = np.sqrt(squared)
    found = grid.contour([level], "distance", compute_normals=False, compute_scalars=False, method="flying_edges")
    return found.connectivity("largest") if outward and found.n_points else found  # without enclosed hollows


def _grid(surface: Surface, scale: float) -> Array:
    """Number of voxels (3,) around a surface along x, y and z, as float64, since their product may be large."""
    return np.ceil(np.ptp(surface.verts, axis=0) / scale * VOXELS_PER_SCALE) + 2 * MARGIN + 1


def _polydata(surface: Surface) -> Any:
    import pyvista

    return pyvista.PolyData.from_regular_faces(surface.verts, surface.faces.astype(int))


def _points(surface: Surface, voxel: float) -> Verts:
    """Points (P, 3) on the surface, so dense that distances of a voxel or more are found with them."""
    corners = surface.verts[surface.faces]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    parts = np.maximum(1, np.ceil(POINTS_PER_VOXEL * longest / voxel)).astype(int)
    found = [surface.verts]
    for n in np.unique(parts[parts > 1]):
        i, j = np.indices((n + 1, n + 1)).reshape(2, -1)
        weights = np.column_stack([i, j, n - i - j])[i + j <= n] / n
        found.append((weights @ corners[parts == n]).reshape(-1, 3))
    points = np.concatenate(found)
    cells = np.floor((points - points.min(axis=0)) / (THINNED_IN_VOXELS * voxel)).astype(np.int64)
    size = cells.max(axis=0) + 1
    kept = np.unique((cells[:, 0] * size[1] + cells[:, 1]) * size[2] + cells[:, 2], return_index=True)[1]
    return points[kept]


@njit(inline="always")
def _within(centre, reach, n):
    """The numbers 0 to n - 1 within ``reach`` of ``centre``: the first, and one more than the last."""
    return max(math.ceil(centre - reach), 0), min(math.floor(centre + reach), n - 1) + 1


@kernel(parallel=True)
def _squared_distances(points, first, reach, squared):
    """Squared distance of each voxel from the nearest point, at most ``reach`` squared [voxels^2].

    ``points`` (P, 3) are sorted by plane; those of plane i are ``first[i]:first[i + 1]``. Each thread fills planes of
    its own, so the result does not depend on their number.
    """
    most = reach * reach
    for i in prange(squared.shape[0]):
        squared[i] = most
        begin, end = max(i - int(reach) - 1, 0), min(i + int(reach) + 1, squared.shape[0] - 1)
        for k in range(first[begin], first[end + 1]):
            x = (points[k, 0] - i) ** 2
            if x >= most:
                continue
            y0, y1 = _within(points[k, 1], (most - x) ** 0.5, squared.shape[1])
            for j in range(y0, y1):
                xy = x + (points[k, 1] - j) ** 2
                if xy >= most:
                    continue
                z0, z1 = _within(points[k, 2], (most - xy) ** 0.5, squared.shape[2])
                for l in range(z0, z1):
                    squared[i, j, l] = min(squared[i, j, l], xy + (points[k, 2] - l) ** 2)
