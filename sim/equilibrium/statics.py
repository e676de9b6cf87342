"""Equilibrium of a growing body by Newton's method, and its loss of stability from the stiffness matrix.

Forces are those of the explicit solver (:meth:`Body.forces` and the surface filter), the stiffness is exact
(:mod:`morphofold.sim.equilibrium.tangent`): the model is the same. The onset of folds in the explicit solver
corresponds to the growth at which the lowest eigenvalue of the stiffness reaches zero. Perturbations and contact are
left out: an imperfect body has no bifurcation, and nothing touches before it. A perfect body does not leave its smooth
path by itself: Newton's method follows it, stable or not.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from morphofold.arrays import Array
from morphofold.errors import NoSolution, OutOfRange
from morphofold.sim.body import Body
from morphofold.sim.build import build_body
from morphofold.sim.equilibrium.path import (
    LAYER_UNEVENNESS_TOLERANCE,
    ConvergenceError,
    Equilibrium,
    Stability,
    even_levels,
)
from morphofold.sim.scene import Scene, in_double

__all__ = [
    "BodyBifurcation",
    "ConvergenceError",
    "Look",
    "Stability",
    "bifurcation_of_body",
    "bifurcation_of_scene",
    "equilibrium",
    "stability",
]

Look = Callable[[float, float], None]

GROWTH_PRECISION = 1e-5  # precision of the critical growth
LINEAR_RANGE_OF_GROWTH = 2e-3  # distance to the critical growth within which linear interpolation is accurate enough


@dataclass(frozen=True)
class BodyBifurcation:
    """Loss of stability of the smooth path of a body.

    Attributes
    ----------
    g_crit : float
        Growth at which the lowest eigenvalue of the stiffness is zero; NaN if this is not reached up to ``g_max``.
    rounded : bool
        True if there is no such growth because the path itself bends into folds, which can happen in an uneven body.
        Then g_crit is approximate: the linear extrapolation to zero of the eigenvalue before it turned.
    mode : (N, 3) float64
        Displacement that grows there, scaled so that the largest of a node is 1.
    wavelength : float
        Wavelength of the mode on the reference pial surface [mm]: 2 pi / k with k^2 the mean square slope of its radial
        displacement over the mean square, which is exact for a sine.
    degree : float
        l from k^2 = l (l + 1) / C^2 on a sphere of radius C, not rounded; NaN for other bodies.
    history : (K, 2) float64
        Growth and lowest eigenvalue [Pa/mm^2] of the states that were computed, in that order; the eigenvalue is NaN
        far beyond the bifurcation.
    x : (N, 3) float64
        The last stable equilibrium [mm].
    """

    g_crit: float
    rounded: bool
    mode: Array
    wavelength: float
    degree: float
    history: Array
    x: Array


def equilibrium(body: Body, g: float, x: Array | None = None) -> Array:
    """Positions (N, 3) at rest at growth ``g``; the body stays at this growth.

    Parameters
    ----------
    body : Body
    g : float
        Growth stretch of the cortex.
    x : (N, 3) float64, optional
        Equilibrium at the body's present growth; without it the path begins at the reference positions and g = 1.

    Raises
    ------
    ValueError
        If nothing holds the body.
    ConvergenceError
        If the path of equilibria could not be followed to g.
    """
    if x is None:
        body.grow(1.0)
        x = body.X
    return Equilibrium(body, x).grown(g).x


def stability(body: Body, x: Array) -> Stability:
    """Lowest eigenvalue and mode of the stiffness at an equilibrium ``x`` (N, 3) of the body's present growth.

    By inverse iteration with an exact factor; its inertia gives the number of negative eigenvalues.
    """
    return Equilibrium(body, x).stability()


def bifurcation_of_body(
    body: Body, g_max: float = 3.0, step: float = 0.05, g_min: float = 1.0, look: Look = lambda g, eigenvalue: None
) -> BodyBifurcation:
    """Follow the smooth path of a body until it is unstable, and find the growth at which stability is lost.

    Parameters
    ----------
    body : Body
        Without imperfections. It stays at the last growth that was computed.
    g_max : float
        Growth at which the search ends.
    step : float
        Largest increment of g between states; an instability that begins and ends within one step is not found.
    g_min : float
        Growth up to which the body is known to be stable, below g_max.
    look : callable
        Called with growth and lowest eigenvalue of each state that is computed, at about equal intervals of time.

    Returns
    -------
    BodyBifurcation
        g_crit lies between a stable and an unstable state, at most 1e-5 apart in g.

    Raises
    ------
    ValueError
        If g_min, g_max and step are not in order, nothing holds the body, or it is unstable at g_min.
    ConvergenceError
        If the path ends before g_max, and before it is unstable.

    Notes
    -----
    On a sphere, patch or strip of even thickness each level of nodes stays at one height on the smooth path; this is
    imposed. The nodes of a real mesh are not all equivalent, so its own equilibrium bends a little. This would round
    the bifurcation off like an imperfection (by a limit point in coarse spheres); it vanishes as the mesh is refined.
    Other bodies follow their own equilibrium. Their uneven shape acts like an imperfection on modes of the same
    symmetry: these do not lose stability but grow gradually, see ``rounded``. In an octant of an ellipsoid all modes
    are of this kind.
    """
    if not 1 <= g_min < g_max < np.inf or not 0 < step < np.inf:
        raise OutOfRange(f"need 1 <= g_min < g_max and a positive step, got {g_min}, {g_max} and {step}.")
    body.grow(1.0)
    stable, high, g = Equilibrium(body, body.X, even_levels(body)).grown(g_min), np.inf, g_min + step
    mode: Array | None = None
    seen: list[tuple[float, float]] = []
    while high - stable.growth > GROWTH_PRECISION and stable.growth < g_max:
        path = stable.grown(min(g, g_max))
        found = path.stability()
        seen.append((path.growth, found.eigenvalue))
        look(*seen[-1])
        if found.negative:
            high = path.growth
        elif mode is not None and len(falling := _states_before_turn(np.array(seen))):
            return _describe_bifurcation(
                body, _growth_at_zero_eigenvalue(falling), True, mode, np.array(seen), stable.x
            )
        else:
            stable, mode = path, found.mode
        g = _next_growth(np.array(seen), stable.growth, high, stable.growth + step)
    if mode is None:
        raise NoSolution(f"the body is already unstable at g_min = {g_min:g}; choose a smaller g_min.")
    g_crit = _growth_at_zero_eigenvalue(np.array(seen)) if high < np.inf else float("nan")
    return _describe_bifurcation(body, g_crit, False, mode, np.array(seen), stable.x)


def bifurcation_of_scene(
    scene: Scene, g_max: float = 3.0, step: float = 0.05, g_min: float = 1.0, look: Look = lambda g, eigenvalue: None
) -> BodyBifurcation:
    """:func:`bifurcation_of_body` for the body of a scene (its geometry, material, growth law and accuracy), always in
    double precision.

    Its effects are left out: a perturbed body has no bifurcation, and nothing touches before one. A body cut by
    symmetry planes has only the modes that they allow, in an octant those of even degree.

    Raises
    ------
    ValueError
        For a scene without a mesh (for radial scenes see ``theory.bifurcation``), and as above.
    ConvergenceError
        As above.
    """
    return bifurcation_of_body(build_body(in_double(scene)), g_max, step, g_min, look)


def _describe_bifurcation(
    body: Body, g_crit: float, rounded: bool, mode: Array, history: Array, x: Array
) -> BodyBifurcation:
    if np.isnan(g_crit):
        return BodyBifurcation(g_crit, rounded, mode, np.nan, np.nan, history, x)
    wave, radius = _wave_number(body, mode), np.linalg.norm(body.X[: body.n_surface], axis=1)
    sphere = np.ptp(radius) < LAYER_UNEVENNESS_TOLERANCE * radius.mean()
    degree = np.sqrt((wave * radius.mean()) ** 2 + 0.25) - 0.5 if sphere else np.nan
    return BodyBifurcation(g_crit, rounded, mode, 2 * np.pi / wave, float(degree), history, x)


def _states_before_turn(seen: Array) -> Array:
    """All but the last of the stable states seen (K, 2), if the eigenvalue fell by half and rises at the last; or none.

    An unstable state beyond was then reached on another path, by a long step.
    """
    stable = seen[seen[:, 1] > 0]
    stable = stable[np.argsort(stable[:, 0])]
    eigenvalue = stable[:, 1]
    turned = len(stable) > 2 and eigenvalue[-1] > eigenvalue[-2] and eigenvalue[-3] > eigenvalue[-2]
    return stable[:-1] if turned and eigenvalue[-2] < 0.5 * eigenvalue.max() else stable[:0]


def _next_growth(seen: Array, low: float, high: float, furthest: float) -> float:
    """Growth to compute next, between the stable ``low`` and the unstable ``high`` and not beyond ``furthest``."""
    zero = _growth_at_zero_eigenvalue(seen)
    if not low < zero < high:  # the states do not give an estimate
        return furthest if furthest < high else (low + high) / 2
    if zero - low > LINEAR_RANGE_OF_GROWTH:  # stop short of it: closer to it the line is more accurate
        return min(low + 0.9 * (zero - low), furthest)
    at = zero + (0.4 if high - zero > zero - low else -0.4) * GROWTH_PRECISION
    return at if low < at < high else (low + high) / 2


def _growth_at_zero_eigenvalue(seen: Array) -> float:
    """Growth of eigenvalue 0 on the line through two of the equilibria seen (K, 2); NaN if that is not defined."""
    stable, unstable = (seen[where][np.argsort(seen[where, 0])] for where in (seen[:, 1] > 0, seen[:, 1] <= 0))
    two = np.concatenate([stable[-1:], unstable[:1]]) if len(unstable) else stable[-2:]
    if len(two) < 2 or two[1, 1] >= two[0, 1]:
        return float("nan")
    (g0, e0), (g1, e1) = two
    return float(g0 + (g1 - g0) * e0 / (e0 - e1))


def _wave_number(body: Body, mode: Array) -> float:
    """Root of the mean square slope over the mean square of the mode's radial displacement, on the reference surface.

    The displacement is linear on triangles; quads are split along each diagonal in turn; second order.
    """
    faces, n = body.bilayer.faces, body.n_surface
    splits = [[0, 1, 2], [0, 2, 3], [0, 1, 3], [1, 2, 3]] if faces.shape[1] == 4 else [[0, 1, 2]]
    triangles = np.concatenate([faces[:, split] for split in splits])
    height = np.einsum("ij,ij->i", mode[:n], body.bilayer.radial[:n])[triangles]
    p = body.X[triangles]
    sides = np.roll(p, 1, axis=1) - np.roll(p, -1, axis=1)  # opposite to each corner
    twice = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    slope = np.einsum("tc,tci->ti", height, sides)  # turned by a right angle, times twice the area
    square = (height**2).sum(axis=1) + height.sum(axis=1) ** 2
    return float(np.sqrt(np.sum(slope**2, axis=1) @ (1 / twice) / (twice @ square / 12)))
