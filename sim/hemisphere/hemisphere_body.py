"""The body under a person's unfolded cortex: a cortex on a core with a hole, in bricks.

Cells: a smooth surface stretches its sphere unevenly, so straight directions of a cubed sphere give large and small
cells. They are shifted by a small expansion, found once on a coarse lattice, that makes no edge long or short and no
corner sharp. It is the same on every lattice, so meshes can be refined.

Core: straight columns from a folded or hollow white surface to the hole may cross. So their nodes are moved until all
bricks are well shaped. Bricks are compared with their target size: f = (|A|^2 / 3)^(3/2) / det A is 1 for a brick of
the right proportions and grows without bound as a corner turns over; sums of powers of f are made small by L-BFGS.
While corners are turned over, det A is replaced by (det A + sqrt(det A^2 + eps^2)) / 2 (Escobar and others 2003), with
a smaller eps from search to search.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.optimize import minimize
from scipy.spatial import cKDTree

from morphofold.errors import ImpossibleBody
from morphofold.frozen_arrays import Array, Bools, Ints
from morphofold.geometry import cross, dot, less, position, unit
from morphofold.kernels import kernel
from morphofold.sim.hemisphere.subject_maps import (
    Subject,
    digests_of,
    files_of_subject,
    subject_of_cortex,
    thickness_factor,
)
from morphofold.sim.mesh.brick_mesh import Bilayer, core_layer_fractions, cube_directions, cube_grids, layered_bricks
from morphofold.sim.scene.geometries import UnfoldedCortex, map_files
from morphofold.threads import one_blas_thread
from morphofold.unfolding.harmonics import Expansion, Frame, SmoothSurface, fit, harmonics, tangents
from morphofold.unfolding.unfold import LEAST_RADIUS_OVER_T, quadrature, surface_radius

FADE_OVER_RADIUS = 0.12  # distance from the medial wall at which the cortex grows fully, over the radius of the body
HOLE_SMOOTHING = 0.3  # of heat flow: the hole has the shape of a smoother body
LEAST_GAP_OVER_T = 2.0  # between the hole and the white surface, over the thickness of the cortex
LEAST_SCALED_JACOBIANS = {"cortex": 0.3, "core": 0.1}

SHIFT_CELLS, SHIFT_DEGREE = 24, 12  # cells along an edge of the cube, and degree of the shift
#: edges over the root of the mean cell area, and the sine of corners, that the search aims at
LONGEST_EDGE, SHORTEST_EDGE, SHARPEST_CORNER = 1.35, 0.60, 0.75
SHIFT_POWERS = (2, 4, 8, 16)  # of what exceeds these aims, one search after the other
SHIFT_ITERATIONS = 100
SINE_ROUNDING = 0.05  # sine below which a corner counts as sharp but not yet turned over

CORE_CELLS = 16  # along an edge of the cube, of the mesh on which the nodes of the core are moved
#: searches one after the other: power of f, eps, and iterations
CORE_SEARCHES = ((1, 0.5, 60), (1, 0.1, 60), (1, 0.02, 60), (2, 0.02, 60), (4, 0.02, 60))
MOVES_DEGREE, MOVES_PENALTY = 16, 1e-4  # of the expansion of the moves

#: thickness of the cortex [mm], or a function that returns it (P,) at points (P, 3) of the unit sphere
Thickness = float | Callable[[Array], Array]
#: how far the nodes of columns are moved (L, S, 3) [mm] at directions (S, 3) and depths (L,) over that of the core
CoreMoves = Callable[[Array, Array], Array]


def bilayer_of_cortex(geometry: UnfoldedCortex, n: int, cortex_layers: int) -> Bilayer:
    """The body of a subject with ``n`` cells along an edge of the cube.

    Its pial surface is the unfolded surface; regions and cortex are those of the nearest vertex on the sphere. With
    ``held = "medial wall"`` columns of nodes below the wall are held at all depths, and growth rises from 0 at its rim
    to its full value at ``FADE_OVER_RADIUS`` from it.

    Raises
    ------
    FileNotFoundError, ValueError
        If the subject cannot be read or unfolded, has no medial wall to hold, or the cortex does not fit.
    """
    subject, files = subject_of_cortex(geometry), files_of_subject(geometry)
    if geometry.thickness_map is not None:
        files |= map_files(geometry.thickness_map, geometry, "thickness_map")
    body = _smooth_body(geometry.model_copy(update={"held": "hole"}), digests_of(files))
    holds_wall = geometry.held == "medial wall"
    tree = cKDTree(subject.unfolding.points)
    nearest_vertex_of: Callable[[Array], Ints] = lambda s: tree.query(s)[1]
    bilayer = body.bricks(n, cortex_layers, (lambda s: ~subject.cortex[nearest_vertex_of(s)]) if holds_wall else None)
    assert bilayer.sphere is not None
    nearest_vertices, regions = nearest_vertex_of(bilayer.sphere), subject.mended.cortex.regions
    is_cortex = subject.cortex[nearest_vertices]
    return replace(
        bilayer,
        hemi=geometry.hemi,
        cortex=is_cortex,
        growing=_growing(subject, is_cortex, bilayer, FADE_OVER_RADIUS * geometry.radius) if holds_wall else None,
        regions=None if regions is None else replace(regions, labels=regions.labels[nearest_vertices]),
    )


@lru_cache(maxsize=8)
def _smooth_body(geometry: UnfoldedCortex, digests: tuple[str, ...]) -> "SmoothBody":
    surface, T = subject_of_cortex(geometry).unfolding.surface, geometry.cortex_thickness
    if geometry.thickness_map is None:
        return smooth_body(surface, T, T, geometry.hole_share)
    factor_at = thickness_factor(geometry.thickness_map, geometry)
    return smooth_body(surface, lambda points: T * factor_at(points), T, geometry.hole_share)


def _growing(subject: Subject, is_cortex: Bools, bilayer: Bilayer, fade_distance: float) -> Array:
    """Share of the growth at each node (N,): 0 below the medial wall, 1 below what is ``fade_distance`` [mm] away."""
    unfolding, n_surface = subject.unfolding, bilayer.n_surface
    wall_tree = cKDTree(unfolding.surface(unfolding.points[~subject.cortex]))
    distance_over_fade = np.minimum(wall_tree.query(bilayer.mesh.p.T[:n_surface])[0] / fade_distance, 1.0)
    growth_share = np.where(is_cortex, 0.5 - 0.5 * np.cos(np.pi * distance_over_fade), 0.0)
    return np.tile(growth_share, len(bilayer.share) // n_surface)


class _Layers(NamedTuple):
    """Surfaces of a mesh (S, 3) [mm], the normals of the first, its longest edge, and the fractions of the core."""

    pial: Array
    white: Array
    hole: Array
    normal: Array
    edge: float
    fractions: Array


@dataclass(frozen=True, eq=False)
class SmoothBody:
    """What all meshes of a body have in common.

    Attributes
    ----------
    surface, hole : SmoothSurface
    thickness : float or callable
        Of the cortex [mm], or a function that returns it (P,) at points (P, 3) of the unit sphere.
    shift : Expansion
        Of directions of a cubed sphere, so that cells are even.
    moves : CoreMoves
        Without any, columns are straight.
    """

    surface: SmoothSurface
    hole: SmoothSurface
    thickness: Thickness
    shift: Expansion
    moves: CoreMoves | None = None

    def points(self, directions: Array) -> Array:
        """Points (S, 3) of the unit sphere of directions (S, 3) of a cubed sphere."""
        return unit(directions + self.shift(directions))

    def layers(self, points: Array, quads: Ints, cortex_layers: int) -> _Layers:
        """The surfaces at points (S, 3) of the unit sphere."""
        frame = self.surface.frame(points)
        T = _fitting_thickness(frame, self.thickness, points)
        white, hole = frame.position - T[:, None] * frame.normal, self.hole(points)
        edge = float(np.linalg.norm(frame.position[quads] - frame.position[np.roll(quads, -1, axis=1)], axis=2).max())
        mean_depth = float(np.linalg.norm(white - hole, axis=1).mean())
        core_fractions = core_layer_fractions(float(T.mean()) / cortex_layers, mean_depth, edge)
        return _Layers(frame.position, white, hole, frame.normal, edge, core_fractions)

    def bricks(self, n_cells: int, cortex_layers: int, is_held: Callable[[Array], Bools] | None = None) -> Bilayer:
        """Bricks with ``n_cells`` along an edge of the cube; ``is_held`` marks points (S, 3) of the sphere to be held.

        Raises
        ------
        ImpossibleBody
            If a brick is too badly shaped.
        """
        directions, quads = cube_directions(n_cells)
        points = self.points(directions)
        layers = self.layers(points, quads, cortex_layers)
        core_nodes = _straight_columns(layers.white, layers.hole, layers.fractions)
        if self.moves is not None:
            core_nodes += self.moves(directions, layers.fractions)
        cortex_nodes = _straight_columns(layers.pial, layers.white, np.arange(cortex_layers) / cortex_layers)
        levels = np.concatenate([cortex_nodes, core_nodes])
        _check_shapes(levels, quads, cortex_layers)
        bilayer = layered_bricks(levels, quads, layers.normal, cortex_layers, layers.edge)
        bilayer = replace(bilayer, sphere=points, grids=cube_grids(n_cells))
        if is_held is None:
            return bilayer
        held_nodes = np.flatnonzero(is_held(points)) + len(points) * np.arange(len(levels))[:, None]
        return replace(bilayer, held=np.union1d(bilayer.held, held_nodes))


def _straight_columns(outer: Array, inner: Array, fractions: Array) -> Array:
    """Nodes (L, S, 3) on straight lines from ``outer`` to ``inner`` (S, 3)."""
    return outer + fractions[:, None, None] * (inner - outer)


def _check_shapes(layer_nodes: Array, quads: Ints, cortex_layers: int) -> None:
    jacobians = scaled_jacobians(layer_nodes, quads)
    for (layer, limit), jacobian in zip(LEAST_SCALED_JACOBIANS.items(), np.split(jacobians, [cortex_layers])):
        if jacobian.min() < limit:
            raise ImpossibleBody(
                f"{int((jacobian < limit).sum()):,} bricks of the {layer} have a scaled Jacobian below {limit:g}, the "
                f"least {jacobian.min():.3g}. Make the surface smoother, the cortex thinner or the hole smaller."
            )


def _fitting_thickness(frame: Frame, thickness: Thickness, points: Array) -> Array:
    """Thickness (S,) [mm] at ``points`` (S, 3); raises where the surface bends too sharply for it."""
    T = np.broadcast_to(thickness(points) if callable(thickness) else thickness, len(points))
    radii = 1 / np.maximum(frame.curvature[:, 1], 1e-300)
    if (radii < LEAST_RADIUS_OVER_T * T).any():
        worst = int(np.argmin(radii / T))
        raise ImpossibleBody(
            f"the cortex is {T[worst]:.3g} mm thick where the surface bends with a radius of "
            f"{radii[worst]:.3g} mm; the radius must be at least {LEAST_RADIUS_OVER_T:g} times the thickness. Make "
            "the cortex thinner or the surface smoother."
        )
    return T


@one_blas_thread()
def smooth_body(surface: SmoothSurface, thickness: Thickness, mean_thickness: float, hole_share: float) -> SmoothBody:
    """Prepare the meshes of a body: some seconds, for any number of meshes.

    Parameters
    ----------
    surface : SmoothSurface
        The pial surface before growth [mm].
    thickness : float or callable
        See :class:`SmoothBody`.
    mean_thickness : float
        [mm]
    hole_share : float
        Size of the hole over that of the body: the ratio of the radii of spheres of their areas.

    Raises
    ------
    ImpossibleBody
        If the surface bends too sharply for the cortex, or the hole comes too near to it.
    """
    points = quadrature(3 * surface.shape.degree)[0]
    _fitting_thickness(surface.frame(points), thickness, points)  # before the searches, which take some seconds
    hole = SmoothSurface(surface.shape.smoothed(HOLE_SMOOTHING))
    hole = hole.scaled(hole_share * surface_radius(surface) / surface_radius(hole))
    body = SmoothBody(surface, hole, thickness, even_cells(surface, mean_thickness))
    directions, quads = cube_directions(CORE_CELLS)
    sphere = body.points(directions)
    layers = body.layers(sphere, quads, 3)
    hole = _centred(hole, sphere, layers.white, mean_thickness)
    return replace(body, hole=hole, moves=core_moves(layers.white, hole(sphere), directions, quads, layers.fractions))


def _centred(hole: SmoothSurface, sphere_points: Array, white: Array, thickness: float) -> SmoothSurface:
    """The hole where it is farthest from the white surface."""
    white_tree, hole_points = cKDTree(white), hole(sphere_points)
    gap_at = lambda centre: float(white_tree.query(hole_points + centre)[0].min())
    simplex = thickness * np.vstack([np.zeros(3), np.eye(3)])
    options = {"initial_simplex": simplex, "xatol": 0.01 * thickness, "fatol": 0.01 * thickness}
    centre = minimize(lambda centre: -gap_at(centre), np.zeros(3), method="Nelder-Mead", options=options).x
    if gap_at(centre) < LEAST_GAP_OVER_T * thickness:
        raise ImpossibleBody(
            f"the hole comes within {gap_at(centre):.3g} mm of the white surface; at least {LEAST_GAP_OVER_T:g} "
            f"thicknesses of the cortex ({LEAST_GAP_OVER_T * thickness:.3g} mm) must lie between. Make the hole "
            "smaller or the cortex thinner."
        )
    coefficients = hole.shape.coefficients.copy()
    coefficients[0] += centre * np.sqrt(4 * np.pi)
    return SmoothSurface(Expansion(coefficients))


def even_cells(surface: SmoothSurface, thickness: float) -> Expansion:
    """The shift of directions that makes the cells of a surface even, and those of the one ``thickness`` [mm] below."""
    excess_of = _excess(surface, thickness, *cube_directions(SHIFT_CELLS))
    coefficients = np.zeros(3 * (SHIFT_DEGREE + 1) ** 2)
    options = {"maxiter": SHIFT_ITERATIONS, "maxcor": 20}
    for power in SHIFT_POWERS:
        coefficients = minimize(excess_of, coefficients, args=(power,), jac=True, method="L-BFGS-B", options=options).x
    return Expansion(coefficients.reshape(-1, 3))


def _excess(
    surface: SmoothSurface, thickness: float, directions: Array, quads: Ints
) -> Callable[[Array, int], tuple[float, Array]]:
    """What the search makes small: the logarithm of a power mean of edges and corners over what is aimed at, and its
    derivatives by the coefficients of the shift."""
    harmonic_values = harmonics(directions, SHIFT_DEGREE)
    cell_size = float(np.sqrt(4 * np.pi / len(quads))) * surface_radius(surface)
    depth_in_cells = thickness / cell_size

    def excess(coefficients: Array, power: int) -> tuple[float, Array]:
        shifted_directions = directions + harmonic_values @ coefficients.reshape(-1, 3)
        length = np.linalg.norm(shifted_directions, axis=1, keepdims=True)
        unit_points = shifted_directions / length
        frame = surface.frame(unit_points)
        outer = frame.position / cell_size
        inner = outer - depth_in_cells * frame.normal
        outer_slopes, inner_slopes, normal_slopes = np.zeros((3, *unit_points.shape))
        total = _power_sum(outer, inner, frame.normal, quads, float(power), outer_slopes, inner_slopes, normal_slopes)
        surface_tangents = frame.along / cell_size
        tangent_slopes = np.einsum("pkc,pc->pk", surface_tangents, outer_slopes)
        tangent_slopes += np.einsum("pkc,pc->pk", surface_tangents - depth_in_cells * frame.turning, inner_slopes)
        tangent_slopes += np.einsum("pkc,pc->pk", frame.turning, normal_slopes)
        shifted_slopes = np.einsum("pk,pkr->pr", tangent_slopes, tangents(unit_points)) / length
        return float(np.log(total)) / power, (harmonic_values.T @ shifted_slopes / (total * power)).ravel()

    return excess


@kernel
def _power_sum(outer, inner, normal, quads, power, outer_slopes, inner_slopes, normal_slopes):
    """Sum of edges (of ``outer``) and corners (of both surfaces) over what is aimed at, to the 2 ``power``-th.

    Positions are in cells (S, 3). Adds the derivatives by positions and normals to the last three.
    """
    total = 0.0
    for quad in range(len(quads)):
        for corner in range(4):
            vertex, after, prior = quads[quad, corner], quads[quad, (corner + 1) % 4], quads[quad, (corner + 3) % 4]
            edge = less(position(outer, after), position(outer, vertex))
            edge_squared = dot(edge, edge)
            long_term = 0.5 * (edge_squared / LONGEST_EDGE**2) ** power  # each edge belongs to two cells
            short_term = 0.5 * (SHORTEST_EDGE**2 / edge_squared) ** power
            total += long_term + short_term
            for axis in range(3):
                slope = 2.0 * power * (long_term - short_term) / edge_squared * edge[axis]
                outer_slopes[after, axis] += slope
                outer_slopes[vertex, axis] -= slope
            n = position(normal, vertex)
            for x, x_slopes in ((outer, outer_slopes), (inner, inner_slopes)):
                u, v = less(position(x, after), position(x, vertex)), less(position(x, prior), position(x, vertex))
                uu, vv, edge_cross, vn, nu = dot(u, u), dot(v, v), cross(u, v), cross(v, n), cross(n, u)
                lengths = (uu * vv) ** 0.5
                sine = (edge_cross[0] * n[0] + (edge_cross[1] * n[1] + edge_cross[2] * n[2])) / lengths
                smooth_sine = (sine * sine + SINE_ROUNDING * SINE_ROUNDING) ** 0.5
                sharp_term = 0.25 * (2.0 * SHARPEST_CORNER / (sine + smooth_sine)) ** (2.0 * power)
                total += sharp_term
                slope = -2.0 * power * sharp_term / smooth_sine  # by the sine
                for axis in range(3):
                    u_slope = slope * (vn[axis] / lengths - sine * u[axis] / uu)
                    v_slope = slope * (nu[axis] / lengths - sine * v[axis] / vv)
                    x_slopes[after, axis] += u_slope
                    x_slopes[prior, axis] += v_slope
                    x_slopes[vertex, axis] -= u_slope + v_slope
                    normal_slopes[vertex, axis] += slope * edge_cross[axis] / lengths
    return total


def core_moves(white: Array, hole: Array, directions: Array, quads: Ints, core_fractions: Array) -> CoreMoves:
    """Moves of the inner nodes of a coarse mesh that shape its bricks well, smooth in direction and depth."""
    straight = _straight_columns(white, hole, core_fractions)
    cell_sizes = np.linalg.norm(straight[:, quads] - straight[:, np.roll(quads, -1, axis=1)], axis=3).mean(axis=(1, 2))
    brick_heights = np.diff(core_fractions)[:, None] * np.linalg.norm(white - hole, axis=1)
    layer_nodes, derivatives = straight.copy(), np.zeros(straight.shape)
    inner_nodes, inner_derivatives = layer_nodes[1:-1], derivatives[1:-1]

    def misshape(inner_flat_nodes: Array, power: float, eps: float) -> tuple[float, Array]:
        inner_nodes[:] = inner_flat_nodes.reshape(inner_nodes.shape)
        misshape_sum = _sum_misshape(layer_nodes, quads, cell_sizes, brick_heights, power, eps, derivatives)
        return float(np.log(misshape_sum)) / power, inner_derivatives.ravel() / (misshape_sum * power)

    for power, eps, max_steps in CORE_SEARCHES:
        options = {"maxiter": max_steps, "maxcor": 10}
        found_x = minimize(misshape, inner_nodes.ravel(), (float(power), eps), "L-BFGS-B", jac=True, options=options).x
        inner_nodes[:] = found_x.reshape(inner_nodes.shape)
    equal_weights = np.ones(len(directions))
    layer_fits = [fit(directions, move, equal_weights, MOVES_DEGREE, MOVES_PENALTY) for move in layer_nodes - straight]

    def moves(directions: Array, depths: Array) -> Array:
        layer_moves = np.stack([layer_fit(directions) for layer_fit in layer_fits])
        layer_moves[0] = layer_moves[-1] = 0.0
        return np.asarray(PchipInterpolator(core_fractions, layer_moves, axis=0)(depths))

    return moves


@kernel
def _corner(levels, quads, layer, quad, corner):
    """A corner of a brick: its level and vertex, those along the surface, and the edges there and outwards."""
    level, side = layer + 1 - corner // 4, corner % 4  # levels are numbered from outside in
    vertex, after, prior = quads[quad, side], quads[quad, (side + 1) % 4], quads[quad, (side + 3) % 4]
    x = levels[level]
    u, v = less(position(x, after), position(x, vertex)), less(position(x, prior), position(x, vertex))
    return level, vertex, after, prior, u, v, less(position(levels[layer], vertex), position(levels[layer + 1], vertex))


@kernel
def _over(u, length):
    return u[0] / length, u[1] / length, u[2] / length


@kernel
def _sum_misshape(levels, quads, sizes, heights, power, eps, slopes):
    """Sum of f^power over all corners; writes its derivatives by ``levels`` to ``slopes``."""
    misshape_sum = 0.0
    slopes[:] = 0.0
    for layer in range(len(levels) - 1):
        for quad in range(len(quads)):
            for corner in range(8):
                level, vertex, after, prior, u, v, w = _corner(levels, quads, layer, quad, corner)
                size, height = sizes[level], heights[layer, vertex]
                u, v, w = _over(u, size), _over(v, size), _over(w, height)
                mean_square = 0.0
                for axis in range(3):
                    mean_square += (u[axis] * u[axis] + v[axis] * v[axis] + w[axis] * w[axis]) / 3.0
                uv, vw, wu = cross(u, v), cross(v, w), cross(w, u)
                det = dot(uv, w)
                smooth_det = (det * det + eps * eps) ** 0.5
                f = (mean_square**1.5 / (0.5 * (det + smooth_det))) ** power
                misshape_sum += f
                square_slope, det_slope = power * f / mean_square, -power * f / smooth_det
                opposite_level, sign = (layer + 1, 1.0) if level == layer else (layer, -1.0)
                for axis in range(3):
                    u_slope = (square_slope * u[axis] + det_slope * vw[axis]) / size
                    v_slope = (square_slope * v[axis] + det_slope * wu[axis]) / size
                    w_slope = (square_slope * w[axis] + det_slope * uv[axis]) / height
                    slopes[level, after, axis] += u_slope
                    slopes[level, prior, axis] += v_slope
                    slopes[level, vertex, axis] -= u_slope + v_slope - sign * w_slope
                    slopes[opposite_level, vertex, axis] -= sign * w_slope
    return misshape_sum


@kernel
def scaled_jacobians(levels, quads):
    """Least scaled Jacobian (L - 1, Q) of the corners of bricks between ``levels`` (L, S, 3): 1 for right angles."""
    jacobians = np.full((len(levels) - 1, len(quads)), np.inf)
    for layer in range(len(levels) - 1):
        for quad in range(len(quads)):
            for corner in range(8):
                u, v, w = _corner(levels, quads, layer, quad, corner)[4:]
                edge_product = (dot(u, u) * dot(v, v) * dot(w, w)) ** 0.5
                jacobians[layer, quad] = min(jacobians[layer, quad], dot(cross(u, v), w) / edge_product)
    return jacobians
