"""The body under a smooth surface: a cortex on a core with a hole, in bricks; ungrown, a person's own hemisphere."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize
from scipy.spatial import cKDTree

from morphofold.arrays import Array, Bools, Ints
from morphofold.errors import ImpossibleBody
from morphofold.sim.hemisphere.core_nodes import CoreMoves, core_moves, scaled_jacobians, straight_columns
from morphofold.sim.hemisphere.even_cells import even_cells, shifted
from morphofold.sim.mesh.brick_mesh import Bilayer, core_layer_fractions, cube_directions, layered_bricks
from morphofold.threads import one_blas_thread
from morphofold.unfolding.harmonics import Expansion
from morphofold.unfolding.numbers import LEAST_RADIUS_OVER_T
from morphofold.unfolding.smooth_surface import Frame, SmoothSurface
from morphofold.unfolding.unfold import quadrature, surface_radius

CORE_CELLS = 16  # along an edge of the cube, of the mesh on which the nodes of the core are moved
HOLE_LEVEL = 0.3  # of heat flow: the hole has the shape of a smoother body
LEAST_GAP_OVER_T = 2.0  # between the hole and the white surface, over the thickness of the cortex
LEAST_SCALED_JACOBIAN_OF_CORTEX, LEAST_SCALED_JACOBIAN_OF_CORE = 0.3, 0.1


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
    """

    surface: SmoothSurface
    hole: SmoothSurface
    thickness: float | Callable[[Array], Array]
    shift: Expansion
    moves: CoreMoves

    def points(self, directions: Array) -> Array:
        """Points (S, 3) of the unit sphere of directions (S, 3) of a cubed sphere."""
        return shifted(directions, self.shift)

    def bricks(self, n: int, cortex_layers: int, held: Callable[[Array], Bools] | None = None) -> Bilayer:
        """Bricks with ``n`` cells along an edge of the cube; ``held`` marks points (S, 3) of the sphere to be held.

        Raises
        ------
        ImpossibleBody
            If a brick is too badly shaped.
        """
        directions, quads = cube_directions(n)
        s = self.points(directions)
        layers = _layers(self.surface, self.hole, self.thickness, s, quads, cortex_layers)
        core = straight_columns(layers.white, layers.base, layers.fractions)
        core += self.moves(directions, layers.fractions)
        cortex = layers.pial + (np.arange(cortex_layers) / cortex_layers)[:, None, None] * (layers.white - layers.pial)
        levels = np.concatenate([cortex, core])
        _check_shapes(levels, quads, cortex_layers)
        bilayer = replace(layered_bricks(levels, quads, layers.normal, cortex_layers, layers.edge), sphere=s)
        if held is None:
            return bilayer
        columns = np.flatnonzero(held(s)) + len(s) * np.arange(len(levels))[:, None]
        return replace(bilayer, held=np.union1d(bilayer.held, columns))


@dataclass(frozen=True, eq=False)
class _Layers:
    """Surfaces of a mesh (S, 3) [mm], the normals of the first, its longest edge, and the fractions of the core."""

    pial: Array
    white: Array
    base: Array
    normal: Array
    edge: float
    fractions: Array


def _layers(
    surface: SmoothSurface,
    hole: SmoothSurface,
    thickness: float | Callable[[Array], Array],
    s: Array,
    quads: Ints,
    cortex_layers: int,
) -> _Layers:
    frame = surface.frame(s)
    T = _fitting_thickness(frame, thickness, s)
    white, base = frame.position - T[:, None] * frame.normal, hole(s)
    edge = float(np.linalg.norm(frame.position[quads] - frame.position[np.roll(quads, -1, axis=1)], axis=2).max())
    depth = float(np.linalg.norm(white - base, axis=1).mean())
    fractions = core_layer_fractions(float(T.mean()) / cortex_layers, depth, edge)
    return _Layers(frame.position, white, base, frame.normal, edge, fractions)


def _fitting_thickness(frame: Frame, thickness: float | Callable[[Array], Array], s: Array) -> Array:
    """Thickness (S,) [mm] at points ``s`` (S, 3); raises where the surface bends too sharply for it."""
    T = np.broadcast_to(thickness(s) if callable(thickness) else thickness, len(s))
    least = 1 / np.maximum(frame.curvature[:, 1], 1e-300)
    if (least < LEAST_RADIUS_OVER_T * T).any():
        worst = int(np.argmin(least / T))
        raise ImpossibleBody(
            f"the cortex is {T[worst]:.3g} mm thick where the surface bends with a radius of {least[worst]:.3g} mm; "
            f"the radius must be at least {LEAST_RADIUS_OVER_T:g} times the thickness. Make the cortex thinner or the "
            "surface smoother."
        )
    return T


@one_blas_thread()
def smooth_body(
    surface: SmoothSurface, thickness: float | Callable[[Array], Array], mean_thickness: float, hole_share: float
) -> SmoothBody:
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
    places = quadrature(3 * surface.shape.degree)[0]
    _fitting_thickness(surface.frame(places), thickness, places)  # before the searches, which take some seconds
    shift = even_cells(surface, mean_thickness)
    directions, quads = cube_directions(CORE_CELLS)
    s = shifted(directions, shift)
    hole = SmoothSurface(surface.shape.smoothed(HOLE_LEVEL))
    hole = hole.scaled(hole_share * surface_radius(surface) / surface_radius(hole))
    layers = _layers(surface, hole, thickness, s, quads, 3)
    hole = _centred(hole, s, layers.white, mean_thickness)
    moves = core_moves(layers.white, hole(s), directions, quads, layers.fractions)
    return SmoothBody(surface, hole, thickness, shift, moves)


def _centred(hole: SmoothSurface, s: Array, white: Array, thickness: float) -> SmoothSurface:
    """The hole where it is farthest from the white surface."""
    tree, wall = cKDTree(white), hole(s)
    nearest = lambda centre: float(tree.query(wall + centre)[0].min())
    found = minimize(
        lambda centre: -nearest(centre),
        np.zeros(3),
        method="Nelder-Mead",
        options={
            "initial_simplex": thickness * np.vstack([np.zeros(3), np.eye(3)]),
            "xatol": 0.01 * thickness,
            "fatol": 0.01 * thickness,
        },
    )
    if nearest(found.x) < LEAST_GAP_OVER_T * thickness:
        raise ImpossibleBody(
            f"the hole comes within {nearest(found.x):.3g} mm of the white surface; at least {LEAST_GAP_OVER_T:g} "
            f"thicknesses of the cortex ({LEAST_GAP_OVER_T * thickness:.3g} mm) must lie between. Make the hole "
            "smaller or the cortex thinner."
        )
    coefficients = hole.shape.coefficients.copy()
    coefficients[0] += found.x * np.sqrt(4 * np.pi)
    return SmoothSurface(Expansion(coefficients))


def _check_shapes(levels: Array, quads: Ints, cortex_layers: int) -> None:
    shapes = scaled_jacobians(levels, quads)
    for layer, found, least in (
        ("cortex", shapes[:cortex_layers], LEAST_SCALED_JACOBIAN_OF_CORTEX),
        ("core", shapes[cortex_layers:], LEAST_SCALED_JACOBIAN_OF_CORE),
    ):
        if found.min() < least:
            raise ImpossibleBody(
                f"{int((found < least).sum()):,} bricks of the {layer} have a scaled Jacobian below {least:g}, the "
                f"least {found.min():.3g}. Make the surface smoother, the cortex thinner or the hole smaller."
            )
