"""The path of equilibria of a growing body, followed by Newton's method from one growth to the next.

Forces are those of the explicit solver (:meth:`Body.all_forces`), the stiffness is exact
(:mod:`morphofold.sim.equilibrium.tangent`). The stability of each state on the path can be computed.
"""

from copy import copy
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import LinearOperator, cg, eigsh

from morphofold.arrays import Array
from morphofold.errors import DoesNotApply, NoSolution
from morphofold.sim.body import Body
from morphofold.sim.equilibrium.sparse_factor import Dissection, Factor
from morphofold.sim.equilibrium.tangent import Tangent
from morphofold.sim.sphere_theory.smooth_sphere import ConvergenceError as NoState
from morphofold.threads import one_blas_thread

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
        self._before: tuple[float, Array] | None = None  # the previous equilibrium on the path
        self._rows = np.flatnonzero(body.free)
        self._tangent = Tangent(body)
        self._dissection = Dissection(body.X, self._tangent.graph(), self._rows, self._stiffness(x))
        self._factor: list[Factor] = []  # the last one, shared along the path
        self._volume = np.repeat(body.nodal_volumes(), 3)[self._rows]
        self._levels = None
        if levels is not None:
            moving = levels[self._rows]
            self._levels = sparse.csr_matrix(moving[:, np.flatnonzero(moving.getnnz(axis=0))])

    @one_blas_thread()
    def grown(self, g: float) -> "Equilibrium":
        """The equilibrium at growth ``g`` of the cortex; increments halve when Newton's method fails."""
        here, step = self, g - self.growth
        while here.growth != g:
            step = np.sign(step) * min(abs(step), abs(g - here.growth))
            try:
                here = here._next(g if step == g - here.growth else here.growth + step)
            except FloatingPointError as error:
                step /= 2
                if abs(step) < SMALLEST_INCREMENT:
                    self.body.grow(here.growth)
                    raise ConvergenceError(
                        f"no equilibrium found beyond g = {here.growth:.6g}: {error}. The smooth path may end there: "
                        "check the stability of the last state.",
                        here.x,
                        here.growth,
                    ) from None
        self.body.grow(g)
        return here

    @one_blas_thread()
    def relaxed(self) -> Array:
        """The equilibrium (N, 3) nearest to the positions given, at the present growth, by Newton's method.

        Raises ``FloatingPointError`` if it is not found.
        """
        return self._newton(self.x)

    def _next(self, g: float) -> "Equilibrium":
        path = copy(self)
        x = self.x
        if self._before is not None and abs(g - self.growth) < LONGEST_EXTRAPOLATION * abs(
            self.growth - self._before[0]
        ):
            x = x + (g - self.growth) / (self.growth - self._before[0]) * (x - self._before[1])
        path.body.grow(g)
        path._before, path.growth = (self.growth, self.x), g
        path.x = path._newton(x)
        return path

    def _newton(self, x: Array) -> Array:
        residual = self._residual(x)
        for _ in range(MOST_NEWTON_ITERATIONS):
            change = np.zeros(x.shape)
            change.ravel()[self._rows] = self._solve(self._stiffness(x), residual)
            size = np.abs(change).max()
            x, residual = self._damped(x, change, residual)
            if size < NEWTON_TOLERANCE * self.body.bilayer.edge:
                return x
        raise FloatingPointError(f"Newton's method has not converged in {MOST_NEWTON_ITERATIONS} steps")

    def _damped(self, x: Array, change: Array, residual: Array) -> tuple[Array, Array]:
        """The longest of the whole step, half of it, ... that reduces the residual; round-off counts as smaller."""
        floor = FORCE_ROUND_OFF * np.abs(self.body.elements.blocks.force).max() * len(residual) ** 0.5
        for share in 0.5 ** np.arange(MOST_TRIAL_LENGTHS):
            trial = x + share * change
            with np.errstate(over="ignore", invalid="ignore"):  # if it overflows, it is not smaller
                after = self._residual(trial)
                size = np.linalg.norm(after)
            if size < max(np.linalg.norm(residual), floor):
                return trial, after
        raise FloatingPointError("no part of a Newton step reduces the residual")

    def _residual(self, x: Array) -> Array:
        free = self.body.all_forces(x).ravel()[self._rows]
        return free if self._levels is None else self._levels.T @ free

    def _stiffness(self, x: Array) -> sparse.csr_matrix:
        stiffness = self._tangent.at(x)
        return sparse.csr_matrix(stiffness[self._rows][:, self._rows])

    def _solve(self, stiffness: sparse.csr_matrix, b: Array) -> Array:
        """Solve by conjugate gradients with the last factor, if that is close enough; else with a new factor.

        If levels are even their stiffness is a small matrix, which is solved directly.
        """
        if self._levels is not None:
            return self._levels @ np.linalg.solve((self._levels.T @ (stiffness @ self._levels)).toarray(), b)
        if self._factor and not self._factor[0].negative:
            inverse = LinearOperator(stiffness.shape, matvec=self._factor[0].solve)
            x, failed = cg(stiffness, b, rtol=LINEAR_TOLERANCE, maxiter=MOST_LINEAR_ITERATIONS, M=inverse)
            if not failed:
                return x
        return self._factorise(stiffness).solve(b)

    def _factorise(self, stiffness: sparse.csr_matrix) -> Factor:
        self._factor[:] = []  # for a large body two factors would not fit into memory
        self._factor.append(Factor(self._dissection, stiffness))
        return self._factor[0]

    @one_blas_thread()
    def stability(self) -> Stability:
        """Stability of this equilibrium."""
        stiffness = self._stiffness(self.x)
        factor = self._factorise(stiffness)
        negative = min(factor.negative, MOST_EIGENVALUES)  # eigsh sorts by 1/eigenvalue
        values, vectors = eigsh(
            stiffness,
            max(negative, 1),
            sparse.diags(self._volume),
            sigma=0.0,
            which="SA" if negative else "LA",
            tol=1e-6,
            v0=np.cos(np.arange(len(self._rows)) ** 2.0),
            OPinv=LinearOperator(stiffness.shape, matvec=factor.solve),
        )
        lowest = int(np.argmin(values))
        eigenvalue = float(values[lowest]) if negative == factor.negative else float("nan")
        mode = np.zeros(self.x.shape)
        mode.ravel()[self._rows] = vectors[:, lowest]
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
    n, count = len(X), -(-len(X) // body.n_surface)
    level = np.arange(n) // body.n_surface
    height = np.einsum("ij,ij->i", X, bilayer.radial)
    aside = np.linalg.norm(X - height[:, None] * bilayer.radial, axis=1)
    first = height[:: body.n_surface]
    if count * body.n_surface != n or np.abs(height - first[level]).max() > LAYER_UNEVENNESS_TOLERANCE * bilayer.edge:
        return None
    if (
        np.ptp(bilayer.radial, axis=0).max() > LAYER_UNEVENNESS_TOLERANCE
        and aside.max() > LAYER_UNEVENNESS_TOLERANCE * bilayer.edge
    ):
        return None
    return sparse.csr_matrix((bilayer.radial.ravel(), (np.arange(3 * n), np.repeat(level, 3))), shape=(3 * n, count))
