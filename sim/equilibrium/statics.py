"""Equilibrium of a growing body by Newton's method, and its loss of stability from the stiffness matrix.

Forces are those of the explicit solver (:meth:`Body.forces` and the surface filter), the stiffness is exact
(:mod:`morphofold.sim.equilibrium.tangent`): the model is the same. The onset of folds in the explicit solver
corresponds to the growth at which the lowest eigenvalue of the stiffness reaches zero. Perturbations and contact are
left out: an imperfect body has no bifurcation, and nothing touches before it. A perfect body does not leave its smooth
path by itself: Newton's method follows it, stable or not.

Residual forces do not distinguish stable from unstable states: they are small in both. The number of negative
eigenvalues of the stiffness does; a symmetric factorisation counts them exactly (Sylvester's law of inertia).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from copy import copy
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import LinearOperator, cg, eigsh

from morphofold.errors import DoesNotApply, NoSolution, OutOfRange
from morphofold.frozen_arrays import Array
from morphofold.sim.body import Body
from morphofold.sim.build import build_body
from morphofold.sim.equilibrium.rest_distance import SOFT_MODE_W2
from morphofold.sim.equilibrium.sparse_factor import Dissection, Factor
from morphofold.sim.equilibrium.tangent import Tangent
from morphofold.sim.scene import Scene, in_double
from morphofold.sim.sphere_theory.smooth_sphere import ConvergenceError as NoState
from morphofold.threads import one_blas_thread

if TYPE_CHECKING:
    from morphofold.sim.dynamics import Dynamics

Look = Callable[[float, float], None]

GROWTH_PRECISION = 1e-5  # precision of the critical growth
LINEAR_RANGE_OF_GROWTH = 2e-3  # distance to the critical growth within which linear interpolation is accurate enough
SMALLEST_INCREMENT = 1e-4  # smallest increment of growth: below it the search ends
LONGEST_EXTRAPOLATION = 5.0  # largest extrapolation of the path, over the last increment
NEWTON_TOLERANCE = 1e-6  # change of position, over the surface edge, that counts as none: the next one is its square
LINEAR_TOLERANCE = 1e-8  # relative tolerance of linear solves
MOST_LINEAR_ITERATIONS = 30  # most iterations of a linear solve with an old factor, before a new one is computed
MOST_NEWTON_ITERATIONS = 15  # most iterations of Newton's method
MOST_TRIAL_LENGTHS = 6  # most trial lengths of a Newton step, each half of the last
FORCE_ROUND_OFF = 1e-13  # round-off of forces, over the largest force of any element
MOST_EIGENVALUES = 12  # most eigenvalues to compute
LAYER_UNEVENNESS_TOLERANCE = 1e-9  # unevenness of a level, over the surface edge, or of radii, that is round-off


class ConvergenceError(NoState):
    """No equilibrium was found; ``x`` (N, 3) and ``growth`` are those of the last equilibrium."""

    def __init__(self, message: str, x: Array, growth: float):
        super().__init__(message)
        self.x, self.growth = x, growth


@dataclass(frozen=True)
class Stability:
    """Stability of an equilibrium.

    Attributes
    ----------
    eigenvalue : float
        Lowest eigenvalue of the stiffness over the nodal volumes of the reference body [Pa/mm^2]; its unit does not
        depend on the mesh. Its sign does not depend on the volumes. NaN if more than 12 eigenvalues are negative.
    mode : (N, 3) float64
        Its displacement, scaled so that the largest of a node is 1.
    negative : int
        Number of negative eigenvalues, 0 if the equilibrium is stable.
    """

    eigenvalue: float
    mode: Array
    negative: int


class Equilibrium:
    """An equilibrium of a body, from which others can be reached; ``levels`` as from :func:`even_levels`, or None."""

    def __init__(self, body: Body, x: Array, levels: sparse.csr_matrix | None = None):
        if body.free.all():
            raise NoSolution(
                "nothing holds the body: it can move without energy, so its stability can't be computed. Hold its "
                "inner surface (geometry.held), or cut it by symmetry planes."
            )
        if body.single:
            raise DoesNotApply(
                "the forces of the body have single precision, too low to find an equilibrium. Build it with "
                'accuracy.precision = "double".'
            )
        self.body, self.x, self.growth = body, x, body.growth
        self._before = math.nan, x  # growth and positions of the previous equilibrium on the path
        self._rows = np.flatnonzero(body.free)
        self._tangent = Tangent(body)
        self._dissection = Dissection(body.X, self._tangent.graph(), self._rows, self._stiffness(x))
        self._factor: list[Factor] = []  # the last one, shared along the path
        self._volume = np.repeat(body.nodal_volumes(), 3)[self._rows]
        self._levels = levels
        if levels is not None:
            movable_levels = levels[self._rows]
            self._levels = sparse.csr_matrix(movable_levels[:, np.flatnonzero(movable_levels.getnnz(axis=0))])

    @one_blas_thread()
    def grown(self, g: float) -> Equilibrium:
        """The equilibrium at growth ``g`` of the cortex; increments halve when Newton's method fails."""
        state, increment = self, g - self.growth
        while state.growth != g:
            increment = np.sign(increment) * min(abs(increment), abs(g - state.growth))
            try:
                state = state._next(g if increment == g - state.growth else state.growth + increment)
            except FloatingPointError as error:
                increment /= 2
                if abs(increment) < SMALLEST_INCREMENT:
                    self.body.grow(state.growth)
                    raise ConvergenceError(
                        f"no equilibrium found beyond g = {state.growth:.6g}: {error}. The smooth path may end there: "
                        "check the stability of the last state.",
                        state.x,
                        state.growth,
                    ) from None
        self.body.grow(g)
        return state

    @one_blas_thread()
    def relaxed(self) -> Array:
        """The equilibrium (N, 3) nearest to the positions given, at the present growth, by Newton's method.

        Raises ``FloatingPointError`` if it is not found.
        """
        return self._newton(self.x)

    def _next(self, g: float) -> Equilibrium:
        next_state, x, (previous_g, previous_x) = copy(self), self.x, self._before
        increment, last_increment = g - self.growth, self.growth - previous_g
        if abs(increment) < LONGEST_EXTRAPOLATION * abs(last_increment):
            x = x + increment / last_increment * (x - previous_x)
        next_state.body.grow(g)
        next_state._before, next_state.growth = (self.growth, self.x), g
        next_state.x = next_state._newton(x)
        return next_state

    def _newton(self, x: Array) -> Array:
        residual = self._residual(x)
        for _ in range(MOST_NEWTON_ITERATIONS):
            displacement = np.zeros(x.shape)
            displacement.ravel()[self._rows] = self._solve(self._stiffness(x), residual)
            largest_displacement = np.abs(displacement).max()
            x, residual = self._damped(x, displacement, residual)
            if largest_displacement < NEWTON_TOLERANCE * self.body.bilayer.edge:
                return x
        raise FloatingPointError(f"Newton's method has not converged in {MOST_NEWTON_ITERATIONS} steps")

    def _damped(self, x: Array, displacement: Array, residual: Array) -> tuple[Array, Array]:
        """The longest of the whole step, half of it, ... that reduces the residual; round-off counts as smaller."""
        force_round_off = FORCE_ROUND_OFF * np.abs(self.body.elements.blocks.force).max() * len(residual) ** 0.5
        for step_share in 0.5 ** np.arange(MOST_TRIAL_LENGTHS):
            trial_x = x + step_share * displacement
            with np.errstate(over="ignore", invalid="ignore"):  # if it overflows, it is not smaller
                trial_residual = self._residual(trial_x)
                residual_size = np.linalg.norm(trial_residual)
            if residual_size < max(np.linalg.norm(residual), force_round_off):
                return trial_x, trial_residual
        raise FloatingPointError("no part of a Newton step reduces the residual")

    def _residual(self, x: Array) -> Array:
        free_forces = self.body.all_forces(x).ravel()[self._rows]
        return free_forces if self._levels is None else self._levels.T @ free_forces

    def _stiffness(self, x: Array) -> sparse.csr_matrix:
        return sparse.csr_matrix(self._tangent.at(x)[self._rows][:, self._rows])

    def _solve(self, stiffness: sparse.csr_matrix, b: Array) -> Array:
        """Solve by conjugate gradients with the last factor, if that is close enough; else with a new factor.

        If levels are even their stiffness is a small matrix, which is solved directly.
        """
        if self._levels is not None:
            return self._levels @ np.linalg.solve((self._levels.T @ (stiffness @ self._levels)).toarray(), b)
        if self._factor and not self._factor[0].negative:
            preconditioner = LinearOperator(stiffness.shape, matvec=self._factor[0].solve)
            x, cg_status = cg(stiffness, b, rtol=LINEAR_TOLERANCE, maxiter=MOST_LINEAR_ITERATIONS, M=preconditioner)
            if not cg_status:
                return x
        return self._factorise(stiffness).solve(b)

    def _factorise(self, stiffness: sparse.csr_matrix) -> Factor:
        self._factor.clear()  # for a large body two factors would not fit into memory
        self._factor.append(Factor(self._dissection, stiffness))
        return self._factor[0]

    @one_blas_thread()
    def stability(self) -> Stability:
        """Stability of this equilibrium."""
        stiffness = self._stiffness(self.x)
        factor = self._factorise(stiffness)
        n_negative = min(factor.negative, MOST_EIGENVALUES)  # eigsh sorts by 1/eigenvalue
        eigenvalues, eigenvectors = eigsh(
            stiffness,
            max(n_negative, 1),
            sparse.diags(self._volume),
            sigma=0.0,
            which="SA" if n_negative else "LA",
            tol=1e-6,
            v0=np.cos(np.arange(len(self._rows)) ** 2.0),
            OPinv=LinearOperator(stiffness.shape, matvec=factor.solve),
        )
        lowest_index = int(np.argmin(eigenvalues))
        eigenvalue = float(eigenvalues[lowest_index]) if n_negative == factor.negative else float("nan")
        mode = np.zeros(self.x.shape)
        mode.ravel()[self._rows] = eigenvectors[:, lowest_index]
        mode /= np.linalg.norm(mode, axis=1).max()
        return Stability(eigenvalue, mode, factor.negative)


def even_levels(body: Body) -> sparse.csr_matrix | None:
    """One displacement along the thickness for each level of nodes, as (3 N, levels); None if levels are not even.

    Levels are even if all nodes of a level are equal except for a rotation or a shift (a sphere about the origin, or a
    flat body), and growth is uniform.
    """
    bilayer, X = body.bilayer, body.X
    if np.ptp(body.pattern) > 0 or body.changing:
        return None
    n, radial, limit = len(X), bilayer.radial, LAYER_UNEVENNESS_TOLERANCE * bilayer.edge
    level = np.arange(n) // body.n_surface
    height = np.einsum("ij,ij->i", X, radial)
    heights = height[:: body.n_surface]
    offset = np.linalg.norm(X - height[:, None] * radial, axis=1)
    is_flat = np.ptp(radial, axis=0).max() <= LAYER_UNEVENNESS_TOLERANCE
    if n % body.n_surface or np.abs(height - heights[level]).max() > limit or not (is_flat or offset.max() <= limit):
        return None
    return sparse.csr_matrix((radial.ravel(), (np.arange(3 * n), np.repeat(level, 3))), shape=(3 * n, len(heights)))


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
    stable_state, high_g, next_g = Equilibrium(body, body.X, even_levels(body)).grown(g_min), np.inf, g_min + step
    mode: Array | None = None
    history, before_turn = np.empty((0, 2)), np.empty((0, 2))
    while high_g - stable_state.growth > GROWTH_PRECISION and stable_state.growth < g_max and not len(before_turn):
        trial_state = stable_state.grown(min(next_g, g_max))
        trial_stability = trial_state.stability()
        history = np.vstack([history, (trial_state.growth, trial_stability.eigenvalue)])
        look(trial_state.growth, trial_stability.eigenvalue)
        if trial_stability.negative:
            high_g = trial_state.growth
        elif mode is None or not len(before_turn := _states_before_turn(history)):
            stable_state, mode = trial_state, trial_stability.mode
        next_g = _next_growth(history, stable_state.growth, high_g, stable_state.growth + step)
    if mode is None:
        raise NoSolution(f"the body is already unstable at g_min = {g_min:g}; choose a smaller g_min.")
    rounded = len(before_turn) > 0
    g_crit = _growth_at_zero_eigenvalue(before_turn if rounded else history) if rounded or high_g < np.inf else math.nan
    wave_number = math.nan if math.isnan(g_crit) else _wave_number(body, mode)
    node_radii = np.linalg.norm(body.X[: body.n_surface], axis=1)
    is_sphere = np.ptp(node_radii) < LAYER_UNEVENNESS_TOLERANCE * node_radii.mean()
    degree = float(np.sqrt((wave_number * node_radii.mean()) ** 2 + 0.25) - 0.5) if is_sphere else math.nan
    return BodyBifurcation(g_crit, rounded, mode, 2 * np.pi / wave_number, degree, history, stable_state.x)


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


def _states_before_turn(states: Array) -> Array:
    """All but the last of the stable states seen (K, 2), if the eigenvalue fell by half and rises at the last; or none.

    An unstable state beyond was then reached on another path, by a long step.
    """
    stable_states = states[states[:, 1] > 0]
    stable_states = stable_states[np.argsort(stable_states[:, 0])]
    eigenvalues = stable_states[:, 1]
    has_turned = len(stable_states) > 2 and eigenvalues[-1] > eigenvalues[-2] and eigenvalues[-3] > eigenvalues[-2]
    return stable_states[:-1] if has_turned and eigenvalues[-2] < 0.5 * eigenvalues.max() else stable_states[:0]


def _next_growth(states: Array, stable_g: float, unstable_g: float, furthest_g: float) -> float:
    """Growth to compute next, between ``stable_g`` and ``unstable_g`` and not beyond ``furthest_g``."""
    zero_g = _growth_at_zero_eigenvalue(states)
    if not stable_g < zero_g < unstable_g:  # the states do not give an estimate
        return furthest_g if furthest_g < unstable_g else (stable_g + unstable_g) / 2
    if zero_g - stable_g > LINEAR_RANGE_OF_GROWTH:  # stop short of it: closer to it the line is more accurate
        return min(stable_g + 0.9 * (zero_g - stable_g), furthest_g)
    next_g = zero_g + (0.4 if unstable_g - zero_g > zero_g - stable_g else -0.4) * GROWTH_PRECISION
    return next_g if stable_g < next_g < unstable_g else (stable_g + unstable_g) / 2


def _growth_at_zero_eigenvalue(states: Array) -> float:
    """Growth of eigenvalue 0 on the line through two of the equilibria seen (K, 2); NaN if that is not defined."""
    stable, unstable = (states[mask][np.argsort(states[mask, 0])] for mask in (states[:, 1] > 0, states[:, 1] <= 0))
    two_states = np.concatenate([stable[-1:], unstable[:1]]) if len(unstable) else stable[-2:]
    if len(two_states) < 2 or two_states[1, 1] >= two_states[0, 1]:
        return float("nan")
    (g0, e0), (g1, e1) = two_states
    return float(g0 + (g1 - g0) * e0 / (e0 - e1))


def _wave_number(body: Body, mode: Array) -> float:
    """Root of the mean square slope over the mean square of the mode's radial displacement, on the reference surface.

    The displacement is linear on triangles; quads are split along each diagonal in turn; second order.
    """
    faces, n_surface = body.bilayer.faces, body.n_surface
    corner_triples = [[0, 1, 2], [0, 2, 3], [0, 1, 3], [1, 2, 3]] if faces.shape[1] == 4 else [[0, 1, 2]]
    triangles = np.concatenate([faces[:, triple] for triple in corner_triples])
    corner_heights = np.einsum("ij,ij->i", mode[:n_surface], body.bilayer.radial[:n_surface])[triangles]
    corners = body.X[triangles]
    sides = np.roll(corners, 1, axis=1) - np.roll(corners, -1, axis=1)  # opposite to each corner
    double_areas = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    slopes = np.einsum("tc,tci->ti", corner_heights, sides)  # turned by a right angle, times twice the area
    squared_heights = (corner_heights**2).sum(axis=1) + corner_heights.sum(axis=1) ** 2
    return float(np.sqrt(np.sum(slopes**2, axis=1) @ (1 / double_areas) / (double_areas @ squared_heights / 12)))


def unstable_modes(run: Dynamics, softer_than: float = -SOFT_MODE_W2) -> int:
    """Number of modes of a run's state with less stiffness over mass than ``softer_than`` [1/tick^2].

    By default these are modes that grow e-fold within 36 ticks, in which growth would rise by 0.2. Slower modes are
    left out: some of them are held by contact at the edge of its range.

    Notes
    -----
    Contact is included with the pairs that press now, those beside them, and the stiffness of its penalty; the rotation
    of its forces with the surface is left out. The time is that of 200 (strips) to 1,500 steps (octants). Memory grows
    as the number of nodes on the surface, times its logarithm, times the square of the number of nodes below each.
    """
    body, x = run.body, run.state.x
    free_rows = np.flatnonzero(body.free)
    tangent = Tangent(body)
    pair_matrix = sparse.csr_matrix((x.size, x.size))
    for effect in run.effects:
        pair_matrix = pair_matrix + effect.stiffness(body, x)
    shift = sparse.diags(np.repeat(body.smooth_mass, 3) * softer_than / body.crossing**2)
    matrix = sparse.csr_matrix(sparse.csr_matrix(tangent.at(x) + pair_matrix - shift)[free_rows][:, free_rows])
    entries = sparse.coo_matrix(pair_matrix)
    pair_graph = sparse.csr_matrix((np.ones(entries.nnz), (entries.row // 3, entries.col // 3)), shape=(len(x), len(x)))
    pair_graph.data[:] = 1.0
    graph = sparse.csr_matrix(tangent.graph().maximum(pair_graph))
    return Factor(Dissection(x, graph, free_rows, matrix), matrix).negative
