"""A surface at many scales: boxes that cover it, and a cortex made of cubes."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats
from scipy.spatial import ConvexHull

from morphofold.analysis.gyrification.folding_indices import ShapeTerms, shape_terms
from morphofold.analysis.gyrification.hull_measures import hull
from morphofold.analysis.gyrification.local_gyrification import polydata, voxels
from morphofold.errors import OpenSurface, OutOfRange, TooLarge
from morphofold.frozen_arrays import Array, Bools, Ints
from morphofold.geometry import components, edges, face_areas, is_closed, mean_edge_length
from morphofold.surface import Cortex, Faces, Surface, Verts
from morphofold.validators import check_kind, check_mesh

# sizes of boxes: from this many mean edges to this share of the root of the area
FINEST_BOX_IN_EDGES, COARSEST_BOX_PER_ROOT_AREA = 2.0, 0.25
BOX_SIZE_RATIO = 2**0.5  # ratio of each size to the one before
GRIDS_PER_SIZE = 8  # shifted grids for each size
CELLS_PER_BOX_EDGE = 6.0  # points are thinned to one per cell; this many cells make one edge of a box


def fractal_dimension(
    verts: Verts, faces: Faces, *, finest: float | None = None, coarsest: float | None = None, seed: int = 0
) -> float:
    """Slope of log(number of boxes that the surface meets) against log(1 / size of the boxes).

    Parameters and errors are those of :func:`box_counts`. The slope is 2 for a smooth surface, and at most 3. Folds
    have a dimension only between their thickness and their spacing: compare brains over the same range of sizes.

    Notes
    -----
    Box counting as in Madan and Kensinger 2016 (NeuroImage 134), but of the surface alone, not of the tissue inside it.
    """
    sizes, counts = box_counts(verts, faces, finest=finest, coarsest=coarsest, seed=seed)
    return float(-np.polyfit(np.log(sizes), np.log(counts), 1)[0])


def box_counts(
    verts: Verts, faces: Faces, *, finest: float | None = None, coarsest: float | None = None, seed: int = 0
) -> tuple[Array, Array]:
    """Sizes of boxes (B,) [mm], each sqrt(2) times the one before, and the number of boxes that the surface meets.

    Parameters
    ----------
    verts, faces : (N, 3) float64, (M, 3) int64
        Surface [mm].
    finest, coarsest : float, optional
        Sizes of the boxes [mm]. None: two mean edges, and a quarter of the root of the area.
    seed : int
        Seed of the random grid offsets; the number for each size is the mean over eight grids.

    Returns
    -------
    sizes, counts : (B,) float64

    Raises
    ------
    ValueError
        If the arrays do not describe a mesh, or the sizes are not ``2 edges <= finest <= coarsest / 2``.
    """
    check_mesh(verts, faces)
    mean_edge, root_area = mean_edge_length(verts, faces), math.sqrt(float(face_areas(verts, faces).sum()))
    fine = FINEST_BOX_IN_EDGES * mean_edge if finest is None else float(finest)
    coarse = COARSEST_BOX_PER_ROOT_AREA * root_area if coarsest is None else float(coarsest)
    if not (math.isfinite(coarse) and FINEST_BOX_IN_EDGES * mean_edge * (1 - 1e-9) <= fine <= coarse / 2):
        raise OutOfRange(
            f"boxes must range from {FINEST_BOX_IN_EDGES * mean_edge:.3g} or more (two mean edges) to a size at "
            f"least twice as large, got {fine:.3g} to {coarse:.3g}."
        )
    pairs = edges(faces)
    points = np.concatenate([verts[np.unique(faces)], verts[pairs].mean(axis=1), verts[faces].mean(axis=1)])
    sizes = fine * BOX_SIZE_RATIO ** np.arange(math.floor(math.log(coarse / fine, BOX_SIZE_RATIO) + 1e-9) + 1)
    rng, counts = np.random.default_rng(seed), []
    for s in sizes:
        points = points[np.unique(_box_numbers(points, s / CELLS_PER_BOX_EDGE), return_index=True)[1]]
        counts.append(
            np.mean([len(np.unique(_box_numbers(points, s, rng.uniform(0, s, 3)))) for _ in range(GRIDS_PER_SIZE)])
        )
    return np.asarray(sizes, dtype=np.float64), np.array(counts, dtype=np.float64)


def _box_numbers(points: Array, size: float, offset: Array | float = 0.0) -> Ints:
    """Number of the box of each point."""
    cells = np.floor((points - points.min(axis=0) + offset) / size).astype(np.int64)
    n_cells = cells.max(axis=0) + 1
    numbers: Ints = (cells[:, 0] * n_cells[1] + cells[:, 1]) * n_cells[2] + cells[:, 2]
    return numbers


# sizes of cubes [mm] of the source, and each times powers of two up to the largest
FIRST_SCALES_MM, LARGEST_SCALE_MM = tuple(0.225 + 0.025 * k for k in range(7)), 7.2
CORNERS_IN_WHITE, CORNERS_IN_PIAL = 8, 4  # of the eight corners of a cube, so many or more inside the surface
MARGIN_CUBES = 3  # cubes around the surface
MOST_CUBES = 3e8


@dataclass(frozen=True)
class AtScale:
    """A cortex at one ``scale`` [mm]; ``terms`` are its areas [mm^2], thickness [mm], K, I and S."""

    scale: float
    terms: ShapeTerms


@dataclass(frozen=True)
class LawAcrossScales:
    """How a cortex follows the folding law over its scales, by least squares, with intervals (95 %).

    The scales of one cortex are not independent, so the intervals only tell how straight the line is.

    Attributes
    ----------
    n_scales, finest, coarsest : int, float, float
        Number and range [mm] of the scales used.
    slope, slope_low, slope_high : float
        Slope of ``log(A_total T^(1/2))`` over ``log A_exposed``, lengths in units of the scale; the law has 5/4. Both
        axes are divided by the scale, so it is near 5/4 for any body: a shell has 1.17.
    exponent, exponent_low, exponent_high : float
        Slope of ``log(A_total / A_exposed^(5/4))`` over ``log T``; the law has -1/2, a body without folds nearly 0.
    """

    n_scales: int
    finest: float
    coarsest: float
    slope: float
    slope_low: float
    slope_high: float
    exponent: float
    exponent_low: float
    exponent_high: float


def across_scales(cortex: Cortex, scales: Sequence[float] | None = None) -> list[AtScale]:
    """Areas, thickness and shape terms of a cortex made of cubes, for several sizes of the cubes.

    Parameters
    ----------
    cortex : Cortex
        Closed white and pial surface [mm].
    scales : sequence of float, optional
        Sizes of the cubes [mm]; 0 is the cortex as it is. None: 0, and the 36 scales of the source from 0.225 to
        7.2 mm, without those that need too many cubes. A hemisphere then takes half a minute.

    Returns
    -------
    list of AtScale
        One for each scale at which gray matter is left, in the order given.

    Raises
    ------
    ValueError
        If a surface is not one closed piece; or a scale is negative or not finite, or needs more than 3e8 cubes.

    Notes
    -----
    The rule is that of Wang and others 2024 (eLife 92080). A cube is white matter if all of its eight corners are
    inside the white surface, and white or gray matter if four or more are inside the pial or the white surface. The
    total area is that of the level 1/2 of the cubes, between their centres, with enclosed hollows; some 10 % too large
    on smooth bodies, whatever the scale. Exposed is its convex hull. The thickness is the volume of gray cubes over
    the total area; at scale 0, the volume between the surfaces over the pial area.
    """
    check_kind(cortex, Cortex, "across_scales: cortex")
    for name, surface in (("white", cortex.white), ("pial", cortex.pial)):
        if not is_closed(surface.faces) or components(len(surface.verts), surface.faces)[0] != 1:
            raise OpenSurface(f"{cortex.called}: {name} is not one closed piece, so nothing is inside it. Close it.")
    if scales is None:
        doubled = {size * 2**k for size in FIRST_SCALES_MM for k in range(6) if size * 2**k < 1.001 * LARGEST_SCALE_MM}
        scales = [0.0, *(size for size in sorted(doubled) if np.prod(_grid(cortex.pial, size)) <= MOST_CUBES)]
    if wrong_scales := [scale for scale in scales if not (math.isfinite(scale) and scale >= 0)]:
        raise OutOfRange(f"a scale must be 0 or a length in mm, got {wrong_scales[0]!r}.")
    terms_by_scale = ((float(scale), _of_cubes(cortex, scale) if scale else _as_it_is(cortex)) for scale in scales)
    return [AtScale(scale, terms) for scale, terms in terms_by_scale if terms is not None]


def law_across_scales(rows: Sequence[AtScale]) -> LawAcrossScales:
    """The folding law over the ``rows`` of :func:`across_scales`, the first of which is scale 0.

    As in the source, scales are used at which the cortex is not thinner and, by its term I, not smaller than at scale
    0, and not less folded than its hull. Raises ``OutOfRange`` if these are fewer than three.
    """
    itself, *others = rows
    if itself.scale != 0:
        raise OutOfRange(f"the first row must be of scale 0, got {itself.scale:g}.")
    used = [
        row
        for row in others
        if row.terms.thickness >= itself.terms.thickness
        and row.terms.size >= itself.terms.size
        and row.terms.total >= row.terms.exposed
    ]
    if len(used) < 3:
        raise OutOfRange(
            f"the law across scales needs three scales at which the cortex is as thick and as large as at scale 0; got "
            f"{len(used)} of {len(others)}. Measure at more scales, or larger ones."
        )
    scale = np.array([row.scale for row in used])
    log_A, log_hull, log_T = np.log([(row.terms.total, row.terms.exposed, row.terms.thickness) for row in used]).T
    slopes = _slope(log_hull - 2 * np.log(scale), log_A + log_T / 2 - 2.5 * np.log(scale))
    return LawAcrossScales(
        len(used), float(scale.min()), float(scale.max()), *slopes, *_slope(log_T, log_A - 1.25 * log_hull)
    )


def _slope(x: Array, y: Array) -> tuple[float, float, float]:
    """Slope by least squares, and its interval."""
    regression = stats.linregress(x, y)
    half_interval = stats.t.ppf(0.975, len(x) - 2) * regression.stderr
    return float(regression.slope), float(regression.slope - half_interval), float(regression.slope + half_interval)


def _as_it_is(cortex: Cortex) -> ShapeTerms:
    pial, white = (polydata(surface.verts, surface.faces) for surface in (cortex.pial, cortex.white))
    return shape_terms(
        pial.area, float(hull(cortex.pial.verts, cortex.faces).area), (pial.volume - white.volume) / pial.area
    )


def _of_cubes(cortex: Cortex, scale: float) -> ShapeTerms | None:
    """The shape terms at a scale [mm]; None if no gray matter is left."""
    import pyvista

    n_corners = _grid(cortex.pial, scale)
    if np.prod(n_corners) > MOST_CUBES:
        raise TooLarge(
            f"a scale of {scale:g} mm needs {np.prod(n_corners):.1e} cubes for a body of "
            f"{np.ptp(cortex.pial.verts, axis=0).max():.0f} mm; choose a larger one. Are the coordinates in mm?"
        )
    first_corner = cortex.pial.verts.min(axis=0) - (MARGIN_CUBES - 0.5) * scale
    inside_white, inside_pial = (
        voxels(surface.verts, cortex.faces, n_corners.astype(int), scale, first_corner)[1].reshape(
            n_corners.astype(int), order="F"
        )
        for surface in (cortex.white, cortex.pial)
    )
    white_cubes = _corners_inside(inside_white) >= CORNERS_IN_WHITE
    cubes = _corners_inside(inside_pial | inside_white) >= CORNERS_IN_PIAL
    gray_volume = np.count_nonzero(cubes & ~white_cubes) * scale**3
    if gray_volume == 0:
        return None
    grid = pyvista.ImageData(dimensions=cubes.shape, spacing=3 * (scale,))
    grid.point_data["cube"] = cubes.ravel(order="F").astype(np.uint8)
    surface = grid.contour([0.5], "cube", compute_normals=False, compute_scalars=False, method="flying_edges")
    exposed_area = ConvexHull(np.asarray(surface.points, dtype=np.float64)).area
    return shape_terms(surface.area, float(exposed_area), gray_volume / surface.area)


def _corners_inside(is_inside: Bools) -> NDArray[np.uint8]:
    """Number of the corners of each cube that are inside, of a grid of corners."""
    counts = is_inside.astype(np.uint8)
    counts = counts[1:] + counts[:-1]
    counts = counts[:, 1:] + counts[:, :-1]
    return counts[:, :, 1:] + counts[:, :, :-1]


def _grid(surface: Surface, scale: float) -> Array:
    """Number of corners (3,) of cubes around a surface, as float64, since their product may be large."""
    return np.ceil(np.ptp(surface.verts, axis=0) / scale) + 2 * MARGIN_CUBES
