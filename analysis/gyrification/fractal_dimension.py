"""Fractal dimension: how fast the number of boxes that cover a surface grows as the boxes get smaller."""

import math

import numpy as np

from morphofold.arrays import Array, Ints
from morphofold.errors import OutOfRange
from morphofold.geometry import edges, face_areas, mean_edge_length
from morphofold.surface import Faces, Verts
from morphofold.validators import check_mesh

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
    edge, size = mean_edge_length(verts, faces), math.sqrt(float(face_areas(verts, faces).sum()))
    fine = FINEST_BOX_IN_EDGES * edge if finest is None else float(finest)
    coarse = COARSEST_BOX_PER_ROOT_AREA * size if coarsest is None else float(coarsest)
    if not (math.isfinite(coarse) and FINEST_BOX_IN_EDGES * edge * (1 - 1e-9) <= fine <= coarse / 2):
        raise OutOfRange(
            f"boxes must range from {FINEST_BOX_IN_EDGES * edge:.3g} or more (two mean edges) to a size at least twice "
            f"as large, got {fine:.3g} to {coarse:.3g}."
        )
    pairs = edges(faces)
    points = np.concatenate([verts[np.unique(faces)], verts[pairs].mean(axis=1), verts[faces].mean(axis=1)])
    sizes = fine * BOX_SIZE_RATIO ** np.arange(math.floor(math.log(coarse / fine, BOX_SIZE_RATIO) + 1e-9) + 1)
    rng, counts = np.random.default_rng(seed), []
    for s in sizes:
        points = points[np.unique(_box_numbers(points, s / CELLS_PER_BOX_EDGE, np.zeros(3)), return_index=True)[1]]
        counts.append(
            np.mean([len(np.unique(_box_numbers(points, s, rng.uniform(0, s, 3)))) for _ in range(GRIDS_PER_SIZE)])
        )
    return np.asarray(sizes, dtype=np.float64), np.array(counts, dtype=np.float64)


def _box_numbers(points: Array, size: float, offset: Array) -> Ints:
    """Number of the box of each point."""
    cells = np.floor((points - points.min(axis=0) + offset) / size).astype(np.int64)
    span = cells.max(axis=0) + 1
    numbers: Ints = (cells[:, 0] * span[1] + cells[:, 1]) * span[2] + cells[:, 2]
    return numbers
