"""Local gyrification: area of the pial surface around a point relative to a smooth envelope of the brain."""

import math
from functools import partial
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage
from scipy.spatial import cKDTree

from morphofold.errors import OpenSurface, TooLarge
from morphofold.frozen_arrays import Array, Bools, Ints
from morphofold.geometry import face_areas, in_use, is_closed, mean_edge_length, split, vertex_areas
from morphofold.kernels import kernel
from morphofold.surface import Faces, PerVertex, Verts
from morphofold.threads import in_blocks, run_parallel
from morphofold.validators import check_mesh, positive

CLOSING_RADIUS_MM, REGION_RADIUS_MM = 15.0, 25.0  # [mm], of Schaer and others 2008
VOXELS_PER_CLOSING_RADIUS = 12.0  # per radius of the closing, by default
BINS_PER_REGION_RADIUS = 12.0  # per radius of the region
LARGEST_EDGE_OVER_REGION = 0.4  # mean edge over the radius of the region, above which triangles are split into four
SMOOTHING_IN_VOXELS = 1.0  # standard deviation in voxels for smoothing the distances, whose steps change the area
MOST_VOXELS = 3e8  # voxels
FAR = np.int32(2**30)  # squared distance [voxels^2], more than any
VERTICES_PER_LEAF = 64  # of the envelope in the tree of nearest vertices, which are far from the bottom of a sulcus


def local_gyrification_index(
    verts: Verts,
    faces: Faces,
    *,
    closing: float = CLOSING_RADIUS_MM,
    region: float = REGION_RADIUS_MM,
    voxel: float | None = None,
) -> PerVertex:
    """Area of the surface divided by that of its envelope, within a ball around the nearest point of the envelope.

    Parameters
    ----------
    verts, faces : (N, 3) float64, (M, 3) int64
        Closed surface [mm], usually the pial one.
    closing : float
        Radius of the ball that rolls around the surface [mm]. The envelope bridges places that the ball cannot enter.
    region : float
        Radius of the ball in which areas are counted [mm].
    voxel : float, optional
        Edge of the voxels for the closing [mm]; None: a twelfth of ``closing``.

    Returns
    -------
    index : (N,) float64
        1 on a convex surface, more where it is folded; NaN at a vertex that no face uses.

    Raises
    ------
    ValueError
        If the arrays do not describe a closed mesh, a length is not positive, or more than 3e8 voxels are needed.

    Notes
    -----
    The defaults are those of Schaer and others 2008 (IEEE TMI 27). Their region is a connected patch. Here all surface
    in the ball counts, also that on the other side of a thin part, so the two agree where the region is small compared
    with the brain. The closing uses distances on voxels. The area within a ball comes from a convolution, with area
    binned to a twelfth of its radius. On a sphere the index is between 0.985 and 1.02.
    """
    check_mesh(verts, faces)
    if not is_closed(faces):
        raise OpenSurface("the surface has a border, so it has no inside. Close its holes.")
    voxel = closing / VOXELS_PER_CLOSING_RADIUS if voxel is None else float(voxel)
    for name, length in (("closing", closing), ("region", region), ("voxel", voxel)):
        positive(length, name)
    local_index = np.full(len(verts), np.nan)
    used_vertices, verts, faces = in_use(verts, faces)
    # grids have their middle at 0: a mirror changes nothing
    verts = verts - (verts.min(axis=0) + verts.max(axis=0)) / 2
    span = np.ptp(verts, axis=0) + 2 * closing
    if np.prod(span / voxel) > MOST_VOXELS:
        raise TooLarge(
            f"voxels of {voxel:g} mm would give {np.prod(span / voxel):.1e} voxels for a body of {span.max():.0f} mm; "
            f"use voxels of {(np.prod(span) / MOST_VOXELS) ** (1 / 3):.2g} mm or more. Are the coordinates in mm?"
        )
    while mean_edge_length(verts, faces) > LARGEST_EDGE_OVER_REGION * region:  # area is assigned to the vertices
        verts, faces = split(verts, faces)
    points, env_faces = envelope(verts, faces, closing, voxel)
    bin_size = region / BINS_PER_REGION_RADIUS
    n_bins = _odd_sizes(np.concatenate([verts, points]), region, bin_size)
    corner = np.multiply(-0.5 * bin_size, n_bins, dtype=np.float64)
    triangle_centres, areas = points[env_faces].mean(axis=1), face_areas(points, env_faces)
    folded, smooth = run_parallel(
        partial(_area_within_radius, verts, vertex_areas(verts, faces), corner, n_bins, bin_size, region),
        partial(_area_within_radius, triangle_centres, areas, corner, n_bins, bin_size, region),
    )
    ratio = _values_at_points(folded, points, corner, bin_size) / _values_at_points(smooth, points, corner, bin_size)
    tree = cKDTree(points, leafsize=VERTICES_PER_LEAF, compact_nodes=False)
    nearest_vertex = tree.query(verts[: len(used_vertices)], workers=numba.get_num_threads())[1]
    local_index[used_vertices] = ratio[nearest_vertex]  # after splitting, the original vertices come first
    return local_index


def envelope(verts: Verts, faces: Faces, closing: float, voxel: float) -> tuple[Verts, Faces]:
    """Surface of the morphological closing of the inside by a ball of radius ``closing`` [mm]; 0 is a voxel centre."""
    grid_shape = _odd_sizes(verts, closing + 3 * voxel, voxel)
    grid, is_inside = voxels(verts, faces, grid_shape, voxel, -0.5 * voxel * (grid_shape - 1))
    is_inside = is_inside.reshape(grid_shape, order="F")
    # distances are between voxel centres; the surface lies half a voxel from the centres on both sides
    is_dilated = _squared_distances(~is_inside) <= (closing / voxel + 0.5) ** 2
    depth = (np.sqrt(_squared_distances(is_dilated)) - 0.5) * voxel
    grid.point_data["depth"] = ndimage.gaussian_filter(depth, SMOOTHING_IN_VOXELS).ravel(order="F")
    level_set = grid.contour([closing], scalars="depth").triangulate()
    return np.asarray(level_set.points, dtype=np.float64), np.asarray(level_set.regular_faces, dtype=np.int64)


def voxels(verts: Verts, faces: Faces, grid_shape: Ints, voxel: float, corner: np.ndarray) -> tuple[Any, Bools]:
    """A ``pyvista.ImageData`` of voxels from ``corner`` (3,) on, and which of them are inside a closed surface."""
    import pyvista

    grid = pyvista.ImageData(dimensions=grid_shape.tolist(), spacing=3 * (voxel,), origin=corner.tolist())
    return grid, polydata(verts, faces).voxelize_binary_mask(reference_volume=grid).point_data["mask"] > 0


def polydata(verts: Verts, faces: Faces) -> Any:
    """A surface as a ``pyvista.PolyData``."""
    import pyvista

    return pyvista.PolyData.from_regular_faces(verts, faces.astype(int))


def _odd_sizes(points: Array, margin: float, cell_size: float) -> Ints:
    """Numbers (3,) of cells, ``cell_size`` wide, that hold points (P, 3) and a margin if their middle is at 0."""
    return 2 * np.ceil((np.abs(points).max(axis=0) + margin) / cell_size).astype(np.int64) + 1


def _squared_distances(is_inside: Bools) -> NDArray[np.int32]:
    """Squared distance [voxels^2] of each voxel to the nearest one that is not inside."""
    squares = np.where(is_inside, FAR, np.int32(0))
    for _ in range(3):  # along each axis, which becomes the last one
        squares = np.ascontiguousarray(np.moveaxis(squares, 0, -1))
        lines = squares.reshape(-1, squares.shape[-1])
        in_blocks(_add_squares_along, len(lines), lines)
    return squares


@kernel
def _add_squares_along(start, stop, lines):
    """Each value of some rows of ``lines`` (L, n) becomes the least of its row, each plus its squared distance.

    Exact, by the lower envelope of parabolas (Felzenszwalb and Huttenlocher 2012, Theory of Computing 8, 415).
    """
    n = lines.shape[1]
    heights, lowest, begins = np.empty(n, np.int64), np.empty(n, np.int64), np.zeros(n, np.int64)
    for line in range(start, stop):
        is_even = True
        for x in range(n):
            heights[x] = lines[line, x]
            is_even = is_even and heights[x] == heights[0]
        if is_even:
            continue
        last = lowest[0] = 0
        for j in range(1, n):
            begin = 0  # where the parabola of j begins to be the lowest
            while last >= 0:
                i = lowest[last]
                rise = heights[j] + j * j - heights[i] - i * i  # few enough digits for an exact floor
                begin = math.floor(rise / (2 * (j - i))) + 1
                if begin > begins[last]:
                    break
                last -= 1
            if begin < n:
                last += 1
                lowest[last], begins[last] = j, max(begin, 0)
        for x in range(n - 1, -1, -1):
            while begins[last] > x:
                last -= 1
            lines[line, x] = heights[lowest[last]] + (x - lowest[last]) ** 2


def _area_within_radius(points: Array, areas: Array, low: Array, n_bins: Ints, bin_size: float, radius: float) -> Array:
    """Area within ``radius`` of the centre of each bin of a grid."""
    lower_bins = np.floor(positions := (points - low) / bin_size - 0.5)
    bin_areas = np.zeros(n_bins)
    for corner_step in np.ndindex(2, 2, 2):  # each area is divided among eight bins, so that it moves steadily
        fraction = np.prod(np.where(corner_step, positions - lower_bins, 1 - (positions - lower_bins)), axis=1)
        bin_numbers = np.ravel_multi_index((lower_bins + corner_step).astype(np.int64).T, n_bins)
        np.add.at(bin_areas.reshape(-1), bin_numbers, fraction * areas)
    n_reach = math.ceil(radius / bin_size)
    offsets = np.arange(-n_reach, n_reach + 1) * bin_size
    distance = np.sqrt(sum(np.meshgrid(*3 * [offsets**2], indexing="ij")))
    ball_share = np.clip((radius - distance) / bin_size + 0.5, 0, 1)
    fft_shape = [fft.next_fast_len(size + 2 * n_reach, real=True) for size in bin_areas.shape]
    ball_areas: Array = fft.irfftn(fft.rfftn(bin_areas, fft_shape) * fft.rfftn(ball_share, fft_shape), fft_shape)
    return ball_areas[tuple(slice(n_reach, n_reach + size) for size in bin_areas.shape)]


def _values_at_points(values: Array, points: Array, corner: Array, bin_size: float) -> Array:
    return ndimage.map_coordinates(values, ((points - corner) / bin_size - 0.5).T, order=1)
