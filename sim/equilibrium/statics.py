"""Equilibrium of a growing body by Newton's method, and its loss of stability from the stiffness matrix.

Forces are those of the explicit solver (:meth:`Body.forces` and the surface filter), the stiffness is exact
(:mod:`morphofold.sim.equilibrium.tangent`): nothing here is a model of its own. What the explicit solver sees as the
onset of folds is the growth at which the lowest eigenvalue of the stiffness meets zero. Perturbations and contact have
no place here: an imperfect body has no bifurcation, and nothing touches before it. A perfect body does not leave its
smooth path by itself: Newton's method follows it, stable or not.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import LinearOperator, cg, eigsh

from morphofold.arrays import Array
from morphofold.sim.body import Body
from morphofold.sim.build import build_body
from morphofold.sim.equilibrium.sparse_factor import Dissection, Factor
from morphofold.sim.equilibrium.tangent import Tangent
from morphofold.sim.scene import Scene, in_double
from morphofold.sim.sphere_theory.smooth_sphere import ConvergenceError as NoState

Look = Callable[[float, float], None]

SMALLEST = 1e-4         # increment of growth at which to give up
FURTHEST = 5.0          # extrapolation of the path, over the last increment
CLOSE = 1e-6            # change of position, over the surface edge, that counts as none: the next is its square
TOLERANCE = 1e-8        # of linear solves, relative
PATIENCE = 30           # iterations of such a solve with an old factor, before a new one is made
ITERATIONS = 15         # of Newton's method
HALVINGS = 6            # of a Newton step
ROUND_OFF = 1e-13       # of forces, over the largest of any element
MODES = 12              # eigenvalues to look for at most
PRECISION = 1e-5        # of the critical growth
EVEN = 1e-9             # unevenness of a level, over the surface edge, or of radii, that is round-off
NEAR = 2e-3             # distance to the critical growth within which a line is good enough


class ConvergenceError(NoState):
    """No equilibrium was found; ``x`` (N, 3) and ``growth`` are the last one."""

    def __init__(self, message: str, x: Array, growth: float):
        super().__init__(message)
        self.x, self.growth = x, growth


@dataclass(frozen=True)
class Stability:
    """How stable an equilibrium is.

    Attributes
    ----------
    eigenvalue : float
        Lowest eigenvalue of the stiffness over the nodal volumes of the reference body [Pa/mm^2]: the mesh does not
        enter its unit. Its sign does not depend on the volumes. NaN if more than ten are negative.
    mode : (N, 3) float64
        Its displacement, the largest of a node 1.
    negative : int
        How many eigenvalues are negative, 0 if the equilibrium is stable.
    """

    eigenvalue: float
    mode: Array
    negative: int


@dataclass(frozen=True)
class BodyBifurcation:
    """Where the smooth path of a body loses its stability.

    Attributes
    ----------
    g_crit : float
        Growth at which the lowest eigenvalue of the stiffness is zero; NaN if it is not up to ``g_max``.
    rounded : bool
        True if there is no such growth because the path itself bends into folds, as that of an uneven body may: g_crit
        is then where the eigenvalue was heading before it turned, by a line, and no longer a sharp number.
    mode : (N, 3) float64
        Displacement that grows there, the largest of a node 1.
    wavelength : float
        Of the mode on the reference pial surface [mm]: 2 pi / k with k^2 the mean square slope of its radial
        displacement over the mean square, which holds for a sine.
    degree : float
        l of k^2 = l (l + 1) / C^2 on a sphere of radius C, not rounded; NaN on other bodies.
    history : (K, 2) float64
        Growth and lowest eigenvalue [Pa/mm^2] of the states that were looked at, in that order; NaN for eigenvalues far
        beyond the first.
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
    """Positions (N, 3) at rest at growth ``g``; the body is left grown to it.

    Parameters
    ----------
    body : Body
    g : float
        Growth stretch of the cortex.
    x : (N, 3) float64, optional
        Equilibrium at the body's present growth; without it the way begins at the reference positions and g = 1.

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
    return _Path(body, x).grown(g).x


def stability(body: Body, x: Array) -> Stability:
    """Lowest eigenvalue and mode of the stiffness at an equilibrium ``x`` (N, 3) of the body's present growth.

    By inverse iteration on an exact factor, whose inertia gives the count of negative ones.
    """
    return _Path(body, x).stability()


def bifurcation_of_body(
    body: Body, g_max: float = 3.0, step: float = 0.05, g_min: float = 1.0, look: Look = lambda g, eigenvalue: None
) -> BodyBifurcation:
    """Follow the smooth path of a body until it is unstable, and find the growth at which it becomes so.

    Parameters
    ----------
    body : Body
        Without imperfections. It is left grown to the last growth that was looked at.
    g_max : float
        Growth up to which to look.
    step : float
        The path is looked at each time g has grown by this, or less: what comes and goes within one step is not seen.
    g_min : float
        Growth up to which the body is known to be stable, below g_max.
    look : callable
        Called with growth and lowest eigenvalue of each state that was looked at, about equally long after each other.

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
    On a sphere, patch or strip of even thickness each level of nodes stays at one height on the smooth path: that is
    imposed. The nodes of a real mesh are not all alike, so its own equilibrium bends a little, which rounds the
    bifurcation off just as an imperfection does (by a limit point in coarse spheres), and vanishes as the mesh is
    refined. Other bodies follow their own equilibrium, and what is uneven in their shape acts on modes of the same
    symmetry as an imperfection: these don't lose stability but grow gradually, see ``rounded``. In an octant of an
    ellipsoid all modes are of that kind.
    """
    if not 1 <= g_min < g_max < np.inf or not 0 < step < np.inf:
        raise ValueError(f"need 1 <= g_min < g_max and a positive step, got {g_min}, {g_max} and {step}.")
    body.grow(1.0)
    stable, high, g = _Path(body, body.X, _levels(body)).grown(g_min), np.inf, g_min + step
    mode: Array | None = None
    seen: list[tuple[float, float]] = []
    while high - stable.growth > PRECISION and stable.growth < g_max:
        path = stable.grown(min(g, g_max))
        found = path.stability()
        seen.append((path.growth, found.eigenvalue))
        look(*seen[-1])
        if found.negative:
            high = path.growth
        elif mode is not None and len(falling := _before_turn(np.array(seen))):
            return _found(body, _zero(falling), True, mode, np.array(seen), stable.x)
        else:
            stable, mode = path, found.mode
        g = _next(np.array(seen), stable.growth, high, stable.growth + step)
    if mode is None:
        raise ValueError(f"the body is unstable at g_min = {g_min:g} already; begin below.")
    g_crit = _zero(np.array(seen)) if high < np.inf else float("nan")
    return _found(body, g_crit, False, mode, np.array(seen), stable.x)


def bifurcation_of_scene(
    scene: Scene, g_max: float = 3.0, step: float = 0.05, g_min: float = 1.0, look: Look = lambda g, eigenvalue: None
) -> BodyBifurcation:
    """:func:`bifurcation_of_body` for the body of a scene, as its geometry, material, growth law and accuracy say, but
    always in double precision.

    Its effects are left out: a perturbed body has no bifurcation, and nothing touches before one. A body cut by
    symmetry planes has the modes alone that they allow, of even degree in an octant.

    Raises
    ------
    ValueError
        For a scene without a mesh (radial: ``theory.bifurcation`` is its own), and as above.
    ConvergenceError
        As above.
    """
    return bifurcation_of_body(build_body(in_double(scene)), g_max, step, g_min, look)


def _found(body: Body, g_crit: float, rounded: bool, mode: Array, history: Array, x: Array) -> BodyBifurcation:
    if np.isnan(g_crit):
        return BodyBifurcation(g_crit, rounded, mode, np.nan, np.nan, history, x)
    wave, radius = _wave_number(body, mode), np.linalg.norm(body.X[: body.n_surface], axis=1)
    sphere = np.ptp(radius) < EVEN * radius.mean()
    degree = np.sqrt((wave * radius.mean()) ** 2 + 0.25) - 0.5 if sphere else np.nan
    return BodyBifurcation(g_crit, rounded, mode, 2 * np.pi / wave, float(degree), history, x)


def _before_turn(seen: Array) -> Array:
    """The stable ones of the states seen (K, 2) but the last, if the eigenvalue fell by half and rises there; or none.

    An unstable state beyond is then one that a long step reached on another path.
    """
    stable = seen[seen[:, 1] > 0]
    stable = stable[np.argsort(stable[:, 0])]
    eigenvalue = stable[:, 1]
    turned = len(stable) > 2 and eigenvalue[-1] > eigenvalue[-2] and eigenvalue[-3] > eigenvalue[-2]
    return stable[:-1] if turned and eigenvalue[-2] < 0.5 * eigenvalue.max() else stable[:0]


def _next(seen: Array, low: float, high: float, furthest: float) -> float:
    """Growth to look at next, between the stable ``low`` and the unstable ``high`` and not beyond ``furthest``."""
    zero = _zero(seen)
    if not low < zero < high:                                           # nothing says where it is
        return furthest if furthest < high else (low + high) / 2
    if zero - low > NEAR:                                               # stop short: close to it the line is better
        return min(low + 0.9 * (zero - low), furthest)
    at = zero + (0.4 if high - zero > zero - low else -0.4) * PRECISION
    return at if low < at < high else (low + high) / 2


def _zero(seen: Array) -> float:
    """Growth of eigenvalue 0 by the line through two of the equilibria seen (K, 2); NaN if they don't tell."""
    stable, unstable = (seen[where][np.argsort(seen[where, 0])] for where in (seen[:, 1] > 0, seen[:, 1] <= 0))
    two = np.concatenate([stable[-1:], unstable[:1]]) if len(unstable) else stable[-2:]
    if len(two) < 2 or two[1, 1] >= two[0, 1]:
        return float("nan")
    (g0, e0), (g1, e1) = two
    return float(g0 + (g1 - g0) * e0 / (e0 - e1))


def _wave_number(body: Body, mode: Array) -> float:
    """Root of the mean square slope over the mean square of the mode's radial displacement, on the reference surface.

    Linear on triangles, of each diagonal of a quad in turn; second order.
    """
    faces, n = body.bilayer.faces, body.n_surface
    splits = [[0, 1, 2], [0, 2, 3], [0, 1, 3], [1, 2, 3]] if faces.shape[1] == 4 else [[0, 1, 2]]
    triangles = np.concatenate([faces[:, split] for split in splits])
    height = np.einsum("ij,ij->i", mode[:n], body.bilayer.radial[:n])[triangles]
    p = body.X[triangles]
    sides = np.roll(p, 1, axis=1) - np.roll(p, -1, axis=1)              # opposite to each corner
    twice = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    slope = np.einsum("tc,tci->ti", height, sides)                      # turned by a right angle, times twice the area
    square = (height**2).sum(axis=1) + height.sum(axis=1) ** 2
    return float(np.sqrt(np.sum(slope**2, axis=1) @ (1 / twice) / (twice @ square / 12)))


def _levels(body: Body) -> sparse.csr_matrix | None:
    """One displacement along the thickness for each level of nodes, as (3 N, levels); None where levels are not even.

    They are even if all nodes of a level are alike but for a turn or a shift, on a sphere about the origin or flat, and
    all grow alike.
    """
    bilayer, X = body.bilayer, body.X
    if np.ptp(body.pattern) > 0:
        return None
    n, count = len(X), -(-len(X) // body.n_surface)
    level = np.arange(n) // body.n_surface
    height = np.einsum("ij,ij->i", X, bilayer.radial)
    aside = np.linalg.norm(X - height[:, None] * bilayer.radial, axis=1)
    first = height[::body.n_surface]
    if count * body.n_surface != n or np.abs(height - first[level]).max() > EVEN * bilayer.edge:
        return None
    if np.ptp(bilayer.radial, axis=0).max() > EVEN and aside.max() > EVEN * bilayer.edge:
        return None
    return sparse.csr_matrix((bilayer.radial.ravel(), (np.arange(3 * n), np.repeat(level, 3))), shape=(3 * n, count))


class _Path:
    """A state of a body at rest, and the way from it to others; ``levels`` as from :func:`_levels`, or None."""

    def __init__(self, body: Body, x: Array, levels: sparse.csr_matrix | None = None):
        if body.free.all():
            raise ValueError(
                "nothing holds the body: it floats away at no cost in energy, so its stability can't be told. Hold its "
                "inner surface (geometry.held), or cut it by symmetry planes."
            )
        if body.single:
            raise ValueError(
                "the forces of the body are of single precision, too rough to tell a state at rest. Build it with "
                'accuracy.precision = "double".'
            )
        self.body, self.x, self.growth = body, x, body.growth
        self._before: tuple[float, Array] | None = None                 # the equilibrium that it came from
        self._rows = np.flatnonzero(body.free)
        self._tangent = Tangent(body)
        self._dissection = Dissection(body.X, self._tangent.graph(), self._rows, self._stiffness(x))
        self._factor: list[Factor] = []                                 # the last one, shared along the path
        self._volume = np.repeat(body.nodal_volumes(), 3)[self._rows]
        self._levels = None
        if levels is not None:
            moving = levels[self._rows]
            self._levels = sparse.csr_matrix(moving[:, np.flatnonzero(moving.getnnz(axis=0))])

    def grown(self, g: float) -> _Path:
        """The equilibrium at growth ``g`` of the cortex; increments halve when Newton's method fails."""
        here, step = self, g - self.growth
        while here.growth != g:
            step = np.sign(step) * min(abs(step), abs(g - here.growth))
            try:
                here = here._next(g if step == g - here.growth else here.growth + step)
            except FloatingPointError as error:
                step /= 2
                if abs(step) < SMALLEST:
                    self.body.grow(here.growth)
                    raise ConvergenceError(
                        f"no equilibrium found beyond g = {here.growth:.6g}: {error}. The smooth path may end there: "
                        "look at the stability of the last state.",
                        here.x, here.growth,
                    ) from None
        self.body.grow(g)
        return here

    def _next(self, g: float) -> _Path:
        path = copy(self)
        x = self.x
        if self._before is not None and abs(g - self.growth) < FURTHEST * abs(self.growth - self._before[0]):
            x = x + (g - self.growth) / (self.growth - self._before[0]) * (x - self._before[1])
        path.body.grow(g)
        path._before, path.growth = (self.growth, self.x), g
        path.x = path._newton(x)
        return path

    def _newton(self, x: Array) -> Array:
        residual = self._residual(x)
        for _ in range(ITERATIONS):
            change = np.zeros(x.shape)
            change.ravel()[self._rows] = self._solve(self._stiffness(x), residual)
            size = np.abs(change).max()
            x, residual = self._damped(x, change, residual)
            if size < CLOSE * self.body.bilayer.edge:
                return x
        raise FloatingPointError(f"Newton's method has not converged in {ITERATIONS} steps")

    def _damped(self, x: Array, change: Array, residual: Array) -> tuple[Array, Array]:
        """The first of the whole step, half of it, ... that makes the residual smaller; round-off counts as smaller."""
        floor = ROUND_OFF * np.abs(self.body.elements.blocks.force).max() * len(residual) ** 0.5
        for share in 0.5 ** np.arange(HALVINGS):
            trial = x + share * change
            with np.errstate(over="ignore", invalid="ignore"):          # far off it is infinite, and so not smaller
                after = self._residual(trial)
                size = np.linalg.norm(after)
            if size < max(np.linalg.norm(residual), floor):
                return trial, after
        raise FloatingPointError("no part of a Newton step brings the body closer to rest")

    def _residual(self, x: Array) -> Array:
        forces = self.body.forces(x)
        forces[: self.body.n_surface] += self.body.filter.forces(x)
        free = forces.ravel()[self._rows]
        return free if self._levels is None else self._levels.T @ free

    def _stiffness(self, x: Array) -> sparse.csr_matrix:
        stiffness = self._tangent.at(x)
        return sparse.csr_matrix(stiffness[self._rows][:, self._rows])

    def _solve(self, stiffness: sparse.csr_matrix, b: Array) -> Array:
        """By conjugate gradients with the last factor, as long as that is close enough; else with a new one.

        Where levels are even the work is as good as done: their stiffness is a small matrix.
        """
        if self._levels is not None:
            return self._levels @ np.linalg.solve((self._levels.T @ (stiffness @ self._levels)).toarray(), b)
        if self._factor and not self._factor[0].negative:
            inverse = LinearOperator(stiffness.shape, matvec=self._factor[0].solve)
            x, failed = cg(stiffness, b, rtol=TOLERANCE, maxiter=PATIENCE, M=inverse)
            if not failed:
                return x
        return self._factorise(stiffness).solve(b)

    def _factorise(self, stiffness: sparse.csr_matrix) -> Factor:
        self._factor[:] = []                                            # two would not fit a large body
        self._factor.append(Factor(self._dissection, stiffness))
        return self._factor[0]

    def stability(self) -> Stability:
        """Of this equilibrium."""
        stiffness = self._stiffness(self.x)
        factor = self._factorise(stiffness)
        negative = min(factor.negative, MODES)                          # 1/eigenvalue is what eigsh sorts
        values, vectors = eigsh(
            stiffness, max(negative, 1), sparse.diags(self._volume), sigma=0.0, which="SA" if negative else "LA",
            tol=1e-6, v0=np.cos(np.arange(len(self._rows)) ** 2.0),
            OPinv=LinearOperator(stiffness.shape, matvec=factor.solve),
        )  # fmt: skip
        lowest = int(np.argmin(values))
        eigenvalue = float(values[lowest]) if negative == factor.negative else float("nan")
        mode = np.zeros(self.x.shape)
        mode.ravel()[self._rows] = vectors[:, lowest]
        mode /= np.linalg.norm(mode, axis=1).max()
        return Stability(eigenvalue, mode, factor.negative)
