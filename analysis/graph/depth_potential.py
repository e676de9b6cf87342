"""Depth potential of a folded surface, here high on gyral crowns and low in sulci, and the width of its gyri.

It is the height of a nearly flat sheet with the mean curvature of the surface. It inverts the Laplacian, so noise of
the vertices enters as height in mm and not as curvature. It needs no hull, no inflation and no sphere.
"""

import numpy as np
from scipy import sparse

from morphofold import geometry
from morphofold.analysis.diffusion import diffusion
from morphofold.analysis.graph.watershed import Watershed
from morphofold.frozen_arrays import Array, Bools
from morphofold.surface import Faces, PerVertex, Verts
from morphofold.validators import check_mesh, positive

COTANGENT_BOUNDS = (-5.0, 20.0)  # bounds: in needle triangles cotangents have no limit
SOLVER_TOLERANCE = 1e-7  # 0.000003 mm in a brain
N_HEAT_STEPS = 3  # implicit Euler steps of one heat flow
# of the root of the area: scale at which the width is measured, 2 mm for a hemisphere
FIRST_SCALE_PER_ROOT_AREA = 0.007
# reach of the depth potential and persistence of its basins, in units of that scale
FIRST_REACH_IN_SCALES, FIRST_PERSISTENCE_IN_SCALES = 7.0, 0.7
TIE_DIRECTION = np.array([1e-5, 0.6, 0.8])  # (3,); hardly along x, in which hemispheres are mirrored
REACH_IN_WIDTHS, SMOOTHING_IN_WIDTHS = 1.5, 0.2  # reach and smoothing of the depth potential, in crown widths
LARGEST_PERSISTENCE_SHARE = 0.2  # of the range of the depth potential: the largest persistence that is used
LOW_QUANTILE, HIGH_QUANTILE = 0.05, 0.98  # quantiles that define this range


class SurfaceOperators:
    """Operators of one surface, and the fields computed with them.

    Parameters
    ----------
    verts, faces : (N, 3) float64, (M, 3) int64
        Closed surface, or one with a natural border [mm].

    Attributes
    ----------
    verts, faces, normals : as given; (N, 3) vertex normals
    edges, lengths : (E, 2) int64, (E,) float64
        Edges, and their lengths [mm].
    mean_edge, area : float
        Mean edge [mm], area [mm^2].
    local_edges : (N,) float64
        Mean of the edges at each vertex [mm].
    """

    def __init__(self, verts: Verts, faces: Faces):
        self.verts, self.faces = verts, faces
        self.normals = geometry.vertex_normals(verts, faces, "max")
        self.edges = geometry.edges(faces)
        self.lengths = geometry.edge_lengths(verts, faces)
        self.mean_edge = float(self.lengths.mean())
        edge_ends = self.edges.ravel()
        n_edges = np.maximum(np.bincount(edge_ends, minlength=len(verts)), 1)
        self.local_edges = np.bincount(edge_ends, np.repeat(self.lengths, 2), len(verts)) / n_edges
        self._diffusion = diffusion(verts, faces, COTANGENT_BOUNDS)
        self._stiffness, self._mass = self._diffusion.stiffness, self._diffusion.mass
        self.area = float(self._mass.sum())
        self._piece = geometry.components(len(verts), faces)[1]
        self._H_sums = 0.5 * np.sum((self._stiffness @ verts) * self.normals, axis=1)  # integral of H at each vertex

    def smooth(self, values: PerVertex, scale: float) -> PerVertex:
        """Heat flow of values (N,) with a kernel of standard deviation ``scale`` [mm]."""
        return self.spread(self._mass * values, scale, values, SOLVER_TOLERANCE)

    def spread(self, integrals: Array, scale: float, first_guess: Array, rtol: float) -> Array:
        """Density of a measure (the integral of a quantity at each vertex) after heat flow; (N,) or (N, K) of several.

        A measure is defined also at vertices without area, and its sum does not change. The solver begins at
        ``first_guess`` and ends at a residual of ``rtol``.
        """
        time, mass = 0.5 * scale**2 / N_HEAT_STEPS, self._mass
        density = self._diffusion.solve(time, integrals, first_guess, rtol)
        for _ in range(N_HEAT_STEPS - 1):
            density = self._diffusion.solve(time, (mass * density.T).T, density, rtol)
        return density

    def depth_potential(self, reach: float, scale: float) -> PerVertex:
        """Depth potential (N,) [mm], positive on crowns, mean 0 on each piece, smoothed over ``scale`` [mm].

        ``(L + M / reach^2) D = 2 M (H - mean H)`` with the cotangent stiffness L and the vertex areas M. This is the
        depth potential of Boucher, Whitesides, Evans 2009 (Medical Image Analysis 13), with the opposite sign. Folds
        wider than a few ``reach`` [mm] count as the shape of the body.
        """
        return self.depth_and_curvature(reach, scale)[0]

    def depth_and_curvature(self, reach: float, scale: float) -> tuple[PerVertex, PerVertex]:
        """``depth_potential``, and mean curvature (N,) [1/mm], of which only the sign is used, smoothed over ``scale``.

        Curvature is smoothed over at least a mean edge, since it shows the noise of single vertices; the depth
        potential is not, so that it hardly depends on the mesh.
        """
        piece_group = self._piece + 1  # group 0 for vertices that no face uses
        mean_H = geometry.ratio(np.bincount(piece_group, self._H_sums), np.bincount(piece_group, self._mass))[
            piece_group
        ]  # H over the piece of each vertex
        right_side = 2 * reach**2 * (self._H_sums - self._mass * mean_H)
        D = self._diffusion.solve(reach**2, right_side, np.zeros(len(right_side)), SOLVER_TOLERANCE)
        H = geometry.ratio(self._H_sums, self._mass)
        if scale < self.mean_edge:
            return self.smooth(D, scale), self.smooth(H, self.mean_edge)
        fields = np.column_stack([D, H])
        D, H = self.spread((self._mass * fields.T).T, scale, fields, SOLVER_TOLERANCE).T.copy()
        return D, H

    def watershed(self, D: PerVertex) -> Watershed:
        """Basins of a depth potential. On the planes of symmetry of simulated bodies the side with the larger y and z
        is taken, which a mirrored hemisphere shares."""
        return Watershed(self.edges, self.lengths, D, self.verts @ TIE_DIRECTION)

    def gyral_width(self, is_inside: Bools | None = None) -> float:
        """Width of the gyri [mm] from inflection to inflection across the crests, used as a scale for the graph.

        It is twice the median distance along edges from a first net of crests to where H changes its sign. Both are
        found at a scale of 0.7 % of the root of the area, for any mesh. The width grows with the scale, and is not the
        gyral *thickness*. NaN if there are no crests. ``inside`` (N,): vertices to use.
        """
        scale = max(FIRST_SCALE_PER_ROOT_AREA * self.area**0.5, self.mean_edge)
        D, H = self.depth_and_curvature(FIRST_REACH_IN_SCALES * scale, scale)
        basin = self.watershed(D).basins(persistence(D, FIRST_PERSISTENCE_IN_SCALES * scale))
        crests = np.unique(self.edges[basin[self.edges[:, 0]] != basin[self.edges[:, 1]]])
        crests = crests[(D[crests] > 0) & (H[crests] > 0) & (True if is_inside is None else is_inside[crests])]
        half_widths = self._distance_to_inflection(H)[crests]
        return 2 * float(np.median(half_widths[np.isfinite(half_widths)])) if np.isfinite(half_widths).any() else np.nan

    def wavelength(self, values: PerVertex) -> float:
        """``2 pi`` divided by the root mean square wavenumber of values (N,) [mm]."""
        values = values - np.average(values, weights=self._mass)
        return float(2 * np.pi * np.sqrt(values @ (self._mass * values) / (values @ (self._stiffness @ values))))

    def _distance_to_inflection(self, H: PerVertex) -> PerVertex:
        """Shortest distance (N,) [mm] along edges to a point of an edge where H, linear on it, is 0."""
        n = len(H)
        start, end = self.edges.T
        is_cut = (H[start] > 0) != (H[end] > 0)
        fraction = H[start[is_cut]] / (H[start[is_cut]] - H[end[is_cut]])
        cut_distance = np.full(n, np.inf)
        np.minimum.at(cut_distance, start[is_cut], fraction * self.lengths[is_cut])
        np.minimum.at(cut_distance, end[is_cut], (1 - fraction) * self.lengths[is_cut])
        cut_vertices = np.flatnonzero(np.isfinite(cut_distance))
        edges = np.concatenate([self.edges, np.column_stack([np.full(len(cut_vertices), n), cut_vertices])])
        graph = geometry.symmetric(n + 1, edges, np.r_[self.lengths, np.maximum(cut_distance[cut_vertices], 1e-12)])
        distance: PerVertex = sparse.csgraph.dijkstra(graph, indices=n)[:n]
        return distance


def wavelength(verts: Verts, faces: Faces, width: float | None = None) -> float:
    """Wavelength of the folds along the surface, from the mean of its Laplace-Beltrami spectrum.

    Parameters
    ----------
    verts, faces : (N, 3) float64, (M, 3) int64
        Closed surface, or one with a natural border [mm].
    width : float, optional
        Crown width [mm]. It sets the reach and smoothing of the depth potential as in
        :func:`morphofold.analysis.gyral_graph`. None: measured.

    Returns
    -------
    float
        ``2 pi (D.MD / D.LD)^1/2`` [mm] with the depth potential D, and L and M the stiffness and mass of the surface;
        NaN if it has no folds.

    Raises
    ------
    ValueError
        If the arrays are not a mesh, or ``width`` is not positive.

    Notes
    -----
    ``D.LD / D.MD`` is the mean of the eigenvalues of the Laplacian, weighted by the power of D in their eigenfunctions
    (the spectrum of Germanaud and others 2012, NeuroImage 63, who use the curvature). No eigenfunction has to be
    computed. A harmonic of degree l on a sphere gives 2 pi R / (l (l + 1))^1/2.
    """
    check_mesh(verts, faces)
    if width is not None:
        positive(width, "width")
    operators = SurfaceOperators(verts, faces)
    width = operators.gyral_width() if width is None else width
    if np.isnan(width):
        return np.nan
    return operators.wavelength(operators.depth_potential(REACH_IN_WIDTHS * width, SMOOTHING_IN_WIDTHS * width))


def persistence(D: PerVertex, height: float) -> float:
    """Persistence ``height`` [mm], but at most 0.2 of the range of the depth potential, to keep shallow folds."""
    low_depth, high_depth = np.quantile(D, [LOW_QUANTILE, HIGH_QUANTILE])
    return min(height, LARGEST_PERSISTENCE_SHARE * float(high_depth - low_depth))
