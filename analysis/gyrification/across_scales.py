"""A surface at many scales: boxes that cover it, and a cortex after everything narrower than a length has merged."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats
from scipy.spatial import ConvexHull

from morphofold.analysis.gyrification.folding_indices import ShapeTerms, shape_terms
from morphofold.analysis.gyrification.hull_measures import hull
from morphofold.analysis.gyrification.local_gyrification import polydata, voxels
from morphofold.errors import OpenSurface, OutOfRange, TooLarge
from morphofold.frozen_arrays import Array, Ints
from morphofold.geometry import components, edges, face_areas, is_closed, mean_edge_length
from morphofold.surface import Cortex, Faces, Surface, Verts
from morphofold.threads import run_parallel
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


FINEST_OVER_T, SCALE_RATIO, N_SCALES = 0.2, 2**0.5, 9  # of the default scales: the first over the thickness
VOXELS_PER_SCALE = 3.0
VOXELS_AROUND = 1.75  # beyond the level, to which distances are computed
MARGIN_VOXELS = 5  # voxels around the surface
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
    original_terms = _as_it_is(cortex)
    if scales is None:
        all_scales = FINEST_OVER_T * original_terms.thickness * SCALE_RATIO ** np.arange(N_SCALES)
        scales = [0.0, *(scale for scale in all_scales if np.prod(_grid(cortex.pial, scale)) <= MOST_VOXELS)]
    if wrong_scales := [scale for scale in scales if not (math.isfinite(scale) and scale >= 0)]:
        raise OutOfRange(f"a scale must be 0 or a length in mm, got {wrong_scales[0]!r}.")
    terms_by_scale = ((float(scale), _at(cortex, scale) if scale else original_terms) for scale in scales)
    return [AtScale(scale, terms) for scale, terms in terms_by_scale if terms is not None]


def law_across_scales(rows: Sequence[AtScale], least_folding: float = LEAST_FOLDING) -> LawAcrossScales:
    """The folding law over the ``rows`` of :func:`across_scales`, as far as there are folds.

    Used are the scales that are not 0 and at which total over exposed area is at least ``least_folding``. Raises
    ``OutOfRange`` if these are fewer than three.
    """
    folded = [row for row in rows if row.scale > 0 and row.terms.total >= least_folding * row.terms.exposed]
    if len(folded) < 3:
        raise OutOfRange(
            f"the law across scales needs three scales with folds, total over exposed area at least {least_folding:g}; "
            f"got {len(folded)} of {len(rows)}. Measure at more scales, or smaller ones."
        )
    log_scale = np.log([row.scale for row in folded])
    log_A, log_hull, log_T = np.log([(row.terms.total, row.terms.exposed, row.terms.thickness) for row in folded]).T
    slope_bounds = _slope(log_hull - 2 * log_scale, log_A + log_T / 2 - 2.5 * log_scale)
    return LawAcrossScales(*slope_bounds, *_slope(log_T, log_A - 1.25 * log_hull))


def _slope(x: Array, y: Array) -> tuple[float, float, float]:
    """Slope by least squares, and its interval."""
    regression = stats.linregress(x, y)
    half_interval = stats.t.ppf(0.975, len(x) - 2) * regression.stderr
    return float(regression.slope), float(regression.slope - half_interval), float(regression.slope + half_interval)


def _as_it_is(cortex: Cortex) -> ShapeTerms:
    (pial_area, pial_volume), (white_area, white_volume) = (
        (float(face_areas(surface.verts, surface.faces).sum()), polydata(surface.verts, surface.faces).volume)
        for surface in (cortex.pial, cortex.white)
    )
    exposed_area = float(hull(cortex.pial.verts, cortex.faces).area)
    return shape_terms(pial_area, exposed_area, 2 * (pial_volume - white_volume) / (pial_area + white_area))


def _at(cortex: Cortex, scale: float) -> ShapeTerms | None:
    """The shape terms at a scale [mm]; None if no white matter is left."""
    outer, inner = run_parallel(partial(_moved, cortex.pial, scale, True), partial(_moved, cortex.white, scale, False))
    if inner.n_points == 0:
        return None
    exposed = float(ConvexHull(np.asarray(outer.points, dtype=np.float64)).area)
    return shape_terms(outer.area, exposed, 2 * (outer.volume - inner.volume) / (outer.area + inner.area))


def _moved(surface: Surface, scale: float, is_outward: bool) -> Any:
    """The surface moved by half a ``scale``, as a ``pyvista.PolyData``: the level of the distance from it."""
    n_voxels, voxel_size = _grid(surface, scale), scale / VOXELS_PER_SCALE
    if np.prod(n_voxels) > MOST_VOXELS:
        raise TooLarge(
            f"a scale of {scale:g} mm needs {np.prod(n_voxels):.1e} voxels for a body of "
            f"{np.ptp(surface.verts, axis=0).max():.0f} mm; choose a larger one. Are the coordinates in mm?"
        )
    lower_corner = surface.verts.min(axis=0) - MARGIN_VOXELS * voxel_size
    grid, is_solid = voxels(surface.verts, surface.faces, n_voxels.astype(int), voxel_size, lower_corner)
    distances = _distances(surface, grid, scale / 2 + VOXELS_AROUND * voxel_size)
    distances[is_solid == is_outward] = 0.0
    grid.point_data["distance"] = distances
    options = {"compute_normals": False, "compute_scalars": False, "method": "flying_edges"}
    level_set = grid.contour([scale / 2], "distance", **options)
    return level_set.connectivity("largest") if is_outward and level_set.n_points else level_set  # no enclosed hollows


def _grid(surface: Surface, scale: float) -> Array:
    """Number of voxels (3,) around a surface along x, y and z, as float64, since their product may be large."""
    return np.ceil(np.ptp(surface.verts, axis=0) / scale * VOXELS_PER_SCALE) + 2 * MARGIN_VOXELS + 1


def _distances(surface: Surface, grid: Any, reach: float) -> NDArray[np.float32]:
    """Distance [mm] of each voxel of a ``pyvista.ImageData`` from a surface, if it is within ``reach`` [mm]."""
    from vtkmodules.util.numpy_support import vtk_to_numpy
    from vtkmodules.vtkFiltersHybrid import vtkImplicitModeller

    model = vtkImplicitModeller()
    model.SetInputData(polydata(surface.verts, surface.faces))
    model.SetSampleDimensions(grid.dimensions)
    model.SetModelBounds(grid.bounds)
    model.AdjustBoundsOff()
    model.CappingOff()
    model.SetOutputScalarTypeToFloat()
    model.SetMaximumDistance(reach / np.ptp(np.reshape(grid.bounds, (3, 2)), axis=1).max())
    model.Update()
    distances: NDArray[np.float32] = vtk_to_numpy(model.GetOutput().GetPointData().GetScalars())
    return distances
