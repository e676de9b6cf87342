"""Loss of stability of the growing bilayer sphere, by finite elements in the radius: a second method for the critical
growth of the theory, which shares only the energy with the first.

The radial state is that of ``radial_finite_elements.py``. A perturbation of degree l is
u = U(R) Y N + V(R) grad Y (spheroidal) or W(R) N x grad Y (toroidal), with N the radial direction, Y a spherical
harmonic and grad on the unit sphere. By Grad N = (I - N N)/R and Grad Y = grad Y/R,

    Grad u = U' Y N N + (U - V)/R N grad Y + V' grad Y N + (U Y P + V H)/R,    P = I - N N,  H = Hess Y,

and with n = l (l + 1), on the unit sphere, int Y^2 = 1, int |grad Y|^2 = n, tr H = -n Y, int |H|^2 = n (n - 1).
The energy to second order is then a quadratic form in six functions of R (:func:`_second_variation`). For n = 0 it
is the tangent of the radial problem.
"""

from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky, eigvalsh, solve_triangular
from scipy.optimize import brentq

from morphofold.errors import NoSolution, OutOfRange
from morphofold.frozen_arrays import Array
from morphofold.sim.sphere_theory.smooth_sphere import SmoothSphere
from morphofold.studies.accuracy.radial_finite_elements import Growth, SphereMesh, assemble, shear_and_hydrostatic
from morphofold.threads import one_blas_thread


@one_blas_thread()
def unstable_modes(
    g: float,
    l: int,
    T_over_C: float,
    mu_ratio: float = 1.0,
    law: str = "isotropic",
    kappa_ratio: float = np.inf,
    *,
    toroidal: bool = False,
    A_over_C: float = 0.5,
    g_core: float = 1.0,
    elements: int | None = None,
    order: int = 8,
) -> int:
    """Number of unstable spheroidal (or toroidal) modes of degree l >= 1 at growth g.

    Parameters and errors are those of ``radial_equilibrium``. The number is that of functions of R; each has 2 l + 1
    harmonics. The radial state is stable if the number is zero for all l, spheroidal and toroidal.
    """
    growth = (g, g_core)
    sphere = SphereModes(SmoothSphere(T_over_C, mu_ratio, law, kappa_ratio, A_over_C), l, elements, order, g)
    x = sphere.grow(growth)
    if toroidal:
        return int(np.sum(eigvalsh(sphere.toroidal(x, growth)) < 0))
    return int(np.sum(sphere.spheroidal(x, growth) < 0) - sphere.q.N)


@one_blas_thread()
def critical_growth_of_degree(
    l: int,
    T_over_C: float,
    mu_ratio: float = 1.0,
    law: str = "isotropic",
    kappa_ratio: float = np.inf,
    *,
    A_over_C: float = 0.5,
    g_core: float = 1.0,
    g_max: float = 4.0,
    step: float = 0.05,
    elements: int | None = None,
    order: int = 8,
) -> float:
    """Smallest growth g > 1 of the cortex at which a spheroidal mode of degree l becomes unstable.

    Parameters
    ----------
    T_over_C, mu_ratio, law, kappa_ratio, A_over_C, g_core, elements, order
        As in :func:`~morphofold.studies.accuracy.radial_finite_elements.radial_equilibrium`.
    l : int
        Degree of the spherical harmonic, 1 or more.
    g_max : float
        Growth at which the search ends.
    step : float
        Relative increment of g between states; an instability that begins and ends within one step is not found.

    Returns
    -------
    g : float
        NaN if degree l is stable at every step up to g_max.

    Raises
    ------
    ValueError
        For values out of range, or if core growth alone makes degree l unstable at g = 1.
    ConvergenceError
        If the radial path ends before g_max and before the instability.
    """
    if not 1 < g_max < np.inf or not 0 < step < np.inf:
        raise OutOfRange(f"g_max must be above 1 and step above 0, got g_max = {g_max}, step = {step}.")
    smooth_sphere, mesh_growth = SmoothSphere(T_over_C, mu_ratio, law, kappa_ratio, A_over_C), min(1.5, g_max)
    while True:
        g = SphereModes(smooth_sphere, l, elements, order, mesh_growth).first_instability(g_core, g_max, step)
        found_growth = g_max if np.isnan(g) else g
        if found_growth <= 1.2 * mesh_growth:
            return g
        mesh_growth = found_growth  # again, on a mesh graded for the growth that was found


class SphereModes(SphereMesh):
    """The mesh of a sphere, with the second variation of its energy for modes of degree l: U, V and pressures."""

    def __init__(self, sphere: SmoothSphere, l: int, elements: int | None, order: int, g: float):
        super().__init__(sphere, l, elements, order, g)
        self.n = l * (l + 1)

    def first_instability(self, g_core: float, g_max: float, step: float) -> float:
        """Smallest growth at which a mode becomes unstable, searched in steps from g = 1; NaN if there is none."""
        stable_growth = (1.0, g_core)
        x = self.grow(stable_growth)

        def softest(g: float) -> float:
            return self.softest(self.grow((g, g_core), x, stable_growth), (g, g_core))  # from the last stable step

        if softest(1.0) <= 0:
            raise NoSolution(f"the degree is unstable at g = 1 already, from core growth g_core = {g_core} alone.")
        while stable_growth[0] < g_max:
            next_growth = (min(stable_growth[0] * (1 + step), g_max), g_core)
            next_x = self.grow(next_growth, x, stable_growth)
            if self.softest(next_x, next_growth) < 0:
                return float(brentq(softest, stable_growth[0], next_growth[0], xtol=1e-13, rtol=1e-14))
            x, stable_growth = next_x, next_growth
        return float("nan")

    def second_variation(self, x: Array, growth: Growth) -> Array:
        """Quadratic form of twice the energy for one degree l in the free unknowns of U, V and pressure."""
        radial, tangential, alpha, beta, p = self.stretches(x, growth, self.quadrature)
        D = _second_variation(alpha, beta, p, self.mu[:, None], self.compliance[:, None], self.n)
        return self.quadratic(D, radial, tangential)

    @cached_property
    def scale(self) -> Array:
        """Cholesky factor of the norm ``int mu |Grad u|^2 + q^2 / mu dV``, which keeps eigenvalues of order one."""
        mu, no_growth = self.mu[:, None, None, None], np.ones((len(self.mu), 1))
        D = (
            mu * np.diag([1, 0.5, self.n, self.n, _traceless_hessian_mean(self.n), 0])
            + np.diag([0, 0, 0, 0, 0, 1]) / mu
        )
        return cholesky(self.quadratic(D, no_growth, no_growth), lower=True)

    def quadratic(self, D: Array, radial: Array, tangential: Array) -> Array:
        weight = self.u.dx * self.quadrature.R**2 * radial * tangential**2
        M = assemble(self.table(radial, tangential), D, weight, self.dofs(0, 1, 2))
        free_dofs = np.concatenate([self.free, self.u.N + self.free, 2 * self.u.N + np.arange(self.q.N)])
        return M[np.ix_(free_dofs, free_dofs)]

    def spheroidal(self, x: Array, growth: Growth, eigen_index: int | None = None) -> Array:
        """Eigenvalues of the second variation, or the one with the given index.

        The number of negative eigenvalues is that of the pressures plus that of the unstable modes (Sylvester's law of
        inertia). If kappa is finite the pressures complete a square. If it is infinite each pressure forms a pair of
        opposite signs with one displacement, and the second variation on the constraint remains.
        """
        half_scaled = solve_triangular(self.scale, self.second_variation(x, growth), lower=True)
        M = solve_triangular(self.scale, half_scaled.T, lower=True)
        return eigvalsh(M, subset_by_index=None if eigen_index is None else [eigen_index, eigen_index])

    def softest(self, x: Array, growth: Growth) -> float:
        """The eigenvalue that is negative if at least one spheroidal mode is unstable; 1 at rest if incompressible."""
        return float(self.spheroidal(x, growth, self.q.N)[0])

    def toroidal(self, x: Array, growth: Growth) -> Array:
        """Second variation in W, over n; there is no pressure, because the perturbation keeps volumes.

        grad of N x grad Y is the Hessian rotated by a right angle: its trace is 0, and n is the mean of twice its
        determinant.
        """
        points, mu = self.quadrature, self.mu[:, None]
        radial, tangential, alpha, beta, p = self.stretches(x, growth, points)
        shear, hydrostatic = shear_and_hydrostatic(alpha, beta, p, mu)
        D = np.empty((*alpha.shape, 2, 2))
        D[..., 0, 0] = shear
        D[..., 0, 1] = D[..., 1, 0] = hydrostatic * beta
        D[..., 1, 1] = self.n * shear + hydrostatic * alpha
        shape_table = np.stack([points.slope / radial, points.phi / (points.R * tangential)]).transpose(2, 3, 0, 1)
        weight = self.u.dx * points.R**2 * radial * tangential**2
        return assemble(shape_table, D, weight, self.dofs(0))[np.ix_(self.free, self.free)]

    def dofs(self, *field_indices: int) -> NDArray[np.int64]:
        """Unknowns of each element (E, shapes) for the fields U (0), V (1) and pressure (2), in one numbering."""
        field_dofs = [self.q.element_dofs if field == 2 else self.u.element_dofs for field in field_indices]
        return np.concatenate([element_dofs + k * self.u.N for k, element_dofs in enumerate(field_dofs)]).T

    def table(self, radial: Array, tangential: Array) -> Array:
        """The six functions of ``_second_variation`` for each shape function of U, V and pressure."""
        points = self.quadrature
        slope, phi, zero_phi, zero_psi = (
            points.slope / radial,
            points.phi / (points.R * tangential),
            0 * points.phi,
            0 * points.psi,
        )
        U = np.stack([slope, 2 * phi, phi, zero_phi, zero_phi, zero_phi])
        V = np.stack([zero_phi, -self.n * phi, -phi, slope, phi, zero_phi])
        q = np.stack([zero_psi, zero_psi, zero_psi, zero_psi, zero_psi, points.psi])
        return np.concatenate([U, V, q], axis=1).transpose(2, 3, 0, 1)


def _traceless_hessian_mean(eigenvalue: int) -> float:
    """Mean over the sphere of the square of the traceless part of Hess Y."""
    return eigenvalue * (eigenvalue - 2) / 2


def _second_variation(alpha: Array, beta: Array, p: Array, mu: Array, compliance: Array, n: int) -> Array:
    """Quadratic form (E, Q, 6, 6) of twice the energy per grown volume, averaged over the sphere.

    Parameters
    ----------
    alpha, beta, p : (E, Q) float64
        Radial and tangential elastic stretch, pressure.
    mu, compliance : (E, 1) float64
        Shear modulus and 1/kappa.
    n : int
        l (l + 1).

    Notes
    -----
    With h = Grad u G^-1 the six functions are the factors of Y in h_rr and in the trace of the tangential part h_t,
    of grad Y in h_rt and in h_tr, of the Hessian in h_t, and of Y in the pressure. Twice the energy is

        mu J^-2/3 (|h|^2 - 4/3 t (A:h) + 5/9 |A|^2 t^2) + (p - mu J^-2/3 |A|^2/(3 J)) J'' + 2 q J t - q^2/kappa,

    t = tr(h A^-1), J'' = 2 A : cof h. Means over the sphere: |h_t|^2 is (tr h_t)^2/2 + n (n - 2)/2 V^2 and twice
    det h_t is (tr h_t)^2/2 - n (n - 2)/2 V^2, where V stands for the fifth function.
    """
    shear, hydrostatic = shear_and_hydrostatic(alpha, beta, p, mu)
    zero, hessian_mean = 0 * alpha, _traceless_hessian_mean(n)
    trace = np.stack([1 / alpha, 1 / beta, zero, zero, zero, zero], axis=-1)
    stretch_row = np.stack([alpha, beta, zero, zero, zero, zero], axis=-1)
    I1 = alpha**2 + 2 * beta**2
    mixed = trace[..., :, None] * stretch_row[..., None, :]
    D = np.diag([1, 0.5, n, n, hessian_mean, 0]) - 2 / 3 * (mixed + np.swapaxes(mixed, -1, -2))
    D = D + (5 / 9 * I1)[..., None, None] * trace[..., :, None] * trace[..., None, :]
    D = shear[..., None, None] * D
    D[..., 1, 1] += hydrostatic * alpha / 2
    D[..., 4, 4] -= hydrostatic * alpha * hessian_mean
    for i, j, value in ((0, 1, hydrostatic * beta), (2, 3, -n * hydrostatic * beta)):
        D[..., i, j] += value
        D[..., j, i] += value
    D[..., 0, 5] = D[..., 5, 0] = beta**2
    D[..., 1, 5] = D[..., 5, 1] = alpha * beta
    D[..., 5, 5] = -compliance
    return D
