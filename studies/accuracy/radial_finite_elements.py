"""Equilibrium of the growing bilayer sphere, by finite elements in the radius.

Reference body: fixed hole at R = A, core A < R < B, cortex B < R < C, free surface at C; F = A_el G with
G = g_core I in the core, g I or diag(1, g, g) in the cortex. Energy, with the pressure p as a second unknown,

    E = int det G (mu/2 (J^-2/3 tr(A_el^T A_el) - 3) + p (J - 1) - p^2 / (2 kappa)) dV,    J = det A_el,

so that p = kappa (J - 1) gives ``materials.elastic.energy`` (except for its constant factors below J = 0.1), and
1/kappa = 0 is the incompressible body. Displacements are continuous polynomials of degree ``order``, pressures are
discontinuous and of one degree less. Lengths are in units of C, stresses in units of the core's shear modulus. The
closed forms of ``theory`` are not used: this is an independent method for the same numbers.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from skfem import Basis, ElementDG, ElementLinePp, MeshLine

from morphofold.frozen_arrays import Array, Bools, Ints
from morphofold.sim.growth_laws import volume
from morphofold.sim.sphere_theory.smooth_sphere import ConvergenceError, SmoothSphere

Growth = tuple[float, float]
LAYERS = ("core", "cortex")


@dataclass(frozen=True)
class RadialState:
    """Radial equilibrium at points: quadrature points from the hole outwards, or those given to :meth:`at`.

    Attributes
    ----------
    R, r : (Q,) float64
        Reference and deformed radius, in units of C.
    sigma_r, sigma_theta : (Q,) float64
        Radial and tangential Cauchy stress, in units of the core's shear modulus; tension is positive.
    p : (Q,) float64
        Mean Cauchy stress (tension positive), same unit; kappa (J - 1) where kappa is finite.
    J : (Q,) float64
        Elastic volume ratio det A_el.
    cortex : (Q,) bool
        Whether the point belongs to the cortex.
    """

    R: Array
    r: Array
    sigma_r: Array
    sigma_theta: Array
    p: Array
    J: Array
    cortex: Bools
    _solution: Any = field(repr=False, compare=False)

    def at(self, R: ArrayLike, layer: str) -> "RadialState":
        """The state at radii R (units of C) of one layer, "core" or "cortex", including its ends."""
        sphere, x, growth = self._solution
        return sphere.state(x, growth, sphere.points(np.ravel(np.asarray(R, dtype=np.float64)), layer))


def radial_equilibrium(
    g: float,
    T_over_C: float,
    mu_ratio: float = 1.0,
    law: str = "isotropic",
    kappa_ratio: float = np.inf,
    *,
    A_over_C: float = 0.5,
    g_core: float = 1.0,
    elements: int | None = None,
    order: int = 8,
) -> RadialState:
    """Radial equilibrium of the grown sphere, whether stable or not.

    Parameters
    ----------
    g : float
        Growth stretch of the cortex; 1 means no growth.
    T_over_C : float
        Thickness of the cortex over the outer radius, both ungrown.
    mu_ratio : float
        Shear modulus of the cortex over that of the core.
    law : {"isotropic", "tangential"}
        Growth of the cortex, ``g I`` or ``diag(1, g, g)`` in (r, theta, phi).
    kappa_ratio : float
        kappa / mu in both layers; ``inf`` is exactly incompressible.
    A_over_C, g_core : float
        Radius of the hole over C; growth stretch of the core.
    elements : int, optional
        Elements in each layer, graded; by default enough for an error below about 1e-8.
    order : int
        Degree of the displacement, 2 or more.

    Returns
    -------
    RadialState
        At the quadrature points.

    Raises
    ------
    ValueError
        As ``SmoothSphere``.
    ConvergenceError
        If the path of equilibria from g = 1 could not be followed to g.
    """
    sphere = SphereMesh(SmoothSphere(T_over_C, mu_ratio, law, kappa_ratio, A_over_C), 5, elements, order, g)
    return sphere.state(sphere.grow((g, g_core)), (g, g_core), sphere.quadrature)


class _ElementPoints(NamedTuple):
    """Points in elements, with values and slopes of the shape functions there, each (shapes, E, Q)."""

    element: Ints
    R: Array
    phi: Array
    slope: Array
    psi: Array


class SphereMesh:
    """Mesh, shape functions and moduli of one sphere, and the equations of its radial problem.

    The unknowns x are the displacements w = r - R, then the pressures. The mesh is graded to resolve a mode of degree l
    at growth g.
    """

    def __init__(self, sphere: SmoothSphere, l: int, elements: int | None, order: int, g: float):
        self.law, A, B = sphere.law, sphere.A_over_C, sphere.B
        self.edges = {
            "core": _graded_edges(A, B, l, elements),
            "cortex": _graded_edges(B, 1.0, l, elements, volume(max(g, 1.0), sphere.law)),
        }
        self.mesh = MeshLine(np.concatenate([self.edges["core"], self.edges["cortex"][1:]]))
        self.cortex = np.arange(self.mesh.nelements) >= len(self.edges["core"]) - 1
        self.mu = np.where(self.cortex, sphere.mu_ratio, 1.0)
        self.compliance = 1 / (sphere.kappa_ratio * self.mu)
        # the displacement, and the pressure
        self._elements = lambda: (ElementLinePp(order), ElementDG(ElementLinePp(order - 1)))
        self.u, self.q = (Basis(self.mesh, element, intorder=2 * order + 2) for element in self._elements())
        fixed_dofs = self.u.get_dofs(lambda R: np.isclose(R[0], A, rtol=0, atol=1e-12)).flatten()
        self.free = np.setdiff1d(np.arange(self.u.N), fixed_dofs)
        R = np.asarray(self.u.global_coordinates())[0]
        self.quadrature = _element_points(np.arange(self.mesh.nelements), R, self.u.basis, self.q.basis)

    def points(self, R: Array, layer: str) -> _ElementPoints:
        """Shape functions at given radii of one layer."""
        edges = self.edges[layer]
        layer_element = np.clip(np.searchsorted(edges, R, side="right") - 1, 0, len(edges) - 2)
        element = layer_element + (len(self.edges["core"]) - 1 if layer == "cortex" else 0)
        X = ((R - edges[layer_element]) / (edges[layer_element + 1] - edges[layer_element]))[None, :, None]
        u, q = (
            [shape.gbasis(self.u.mapping, X, k, tind=element) for k in range(basis.Nbfun)]
            # new elements, because ElementLinePp keeps its last values if only the positions of the points change
            for shape, basis in zip(self._elements(), (self.u, self.q))
        )
        return _element_points(element, R[:, None], u, q)

    def stretches(self, x: Array, growth: Growth, at: _ElementPoints) -> tuple[Array, ...]:
        """Radial and tangential growth (E, 1); radial and tangential elastic stretch, and pressure (E, Q)."""
        tangential = np.where(self.cortex, *growth)[at.element][:, None]
        radial = np.where(self.cortex, growth[0] if self.law == "isotropic" else 1.0, growth[1])[at.element][:, None]
        w = x[self.u.element_dofs[:, at.element]]
        alpha = (1 + np.einsum("ie,ieq->eq", w, at.slope)) / radial
        beta = (1 + np.einsum("ie,ieq->eq", w, at.phi) / at.R) / tangential
        p = np.einsum("ie,ieq->eq", x[self.u.N + self.q.element_dofs[:, at.element]], at.psi)
        return radial, tangential, alpha, beta, p

    def state(self, x: Array, growth: Growth, at: _ElementPoints) -> RadialState:
        _, tangential, alpha, beta, p = self.stretches(x, growth, at)
        J = alpha * beta**2
        shear = self.mu[at.element][:, None] * J ** (-5 / 3)
        mean_square = (alpha**2 + 2 * beta**2) / 3
        sigma_r, sigma_theta = shear * (alpha**2 - mean_square) + p, shear * (beta**2 - mean_square) + p
        r, cortex = at.R * beta * tangential, np.repeat(self.cortex[at.element], at.R.shape[1])
        R, r, sigma_r, sigma_theta, p, J = (values.ravel() for values in (at.R, r, sigma_r, sigma_theta, p, J))
        return RadialState(R, r, sigma_r, sigma_theta, p, J, cortex, (self, x, growth))

    def grow(self, end_growth: Growth, x: Array | None = None, start_growth: Growth = (1.0, 1.0)) -> Array:
        """Follow the radial equilibrium from x to another growth (g, g_core); increments halve when Newton fails."""
        x = np.zeros(self.u.N + self.q.N) if x is None else x
        log_start, log_change = np.log(start_growth), np.log(end_growth) - np.log(start_growth)
        fraction, step = 0.0, 1 / max(1.0, np.ceil(np.abs(log_change).max() / 0.2))
        while fraction < 1:
            try:
                next_growth = np.exp(log_start + min(fraction + step, 1.0) * log_change)
                x = self.newton(x, (next_growth[0], next_growth[1]))
                fraction += step
            except (FloatingPointError, np.linalg.LinAlgError) as error:
                step /= 2
                if step < 1e-4:
                    g, g_core = np.exp(log_start + fraction * log_change).tolist()
                    message = f"no radial equilibrium found beyond g = {g:.6g}, g_core = {g_core:.6g}: {error}."
                    raise ConvergenceError(message) from None
        return x

    def newton(self, x: Array, growth: Growth) -> Array:
        free_dofs = np.concatenate([self.free, self.u.N + np.arange(self.q.N)])
        unknown_scale = np.where(free_dofs < self.u.N, 1.0, self.mu.max())
        for _ in range(12):
            gradient, tangent = self.radial(x, growth)
            update = np.linalg.solve(tangent[np.ix_(free_dofs, free_dofs)], gradient[free_dofs])
            x = x.copy()
            x[free_dofs] -= update
            if np.abs(update / unknown_scale).max() < 1e-8:  # convergence is quadratic: what remains is round-off
                return x
        raise FloatingPointError("Newton's method does not converge")

    def radial(self, x: Array, growth: Growth) -> tuple[Array, Array]:
        """Gradient (N,) and tangent (N, N) of the energy over 4 pi by the unknowns of the radial problem."""
        points, mu, compliance = self.quadrature, self.mu[:, None], self.compliance[:, None]
        radial, tangential, alpha, beta, p = self.stretches(x, growth, points)
        J, I1 = alpha * beta**2, alpha**2 + 2 * beta**2
        if not J.min() > 0:
            raise FloatingPointError("the body turns inside out")
        shear = mu * J ** (-2 / 3)
        energy_slopes = np.stack(
            [
                shear * (alpha - I1 / (3 * alpha)) + p * beta**2,
                shear * (beta - I1 / (3 * beta)) + p * alpha * beta,
                J - 1 - p * compliance,
            ],
            axis=-1,
        )
        # derivatives of w in the radial stretch and in twice the tangential one, and the pressure
        slope, twice_tangential, psi = points.slope / radial, 2 * points.phi / (points.R * tangential), points.psi
        U, q = np.stack([slope, twice_tangential, 0 * slope]), np.stack([0 * psi, 0 * psi, psi])
        shape_table = np.concatenate([U, q], axis=1).transpose(2, 3, 0, 1)
        dofs = np.concatenate([self.u.element_dofs, self.u.N + self.q.element_dofs]).T
        weight = self.u.dx * points.R**2 * radial * tangential**2
        residual = np.zeros(self.u.N + self.q.N)
        np.add.at(residual, dofs, np.einsum("eqai,eqa,eq->ei", shape_table, energy_slopes, weight))
        return residual, assemble(shape_table, _radial_tangent(alpha, beta, p, mu, compliance), weight, dofs)


def shear_and_hydrostatic(alpha: Array, beta: Array, p: Array, mu: Array) -> tuple[Array, Array]:
    """Factors of |h|^2 and of the second derivative of J: mu J^-2/3, and p minus the part of J^-2/3."""
    J = alpha * beta**2
    shear = mu * J ** (-2 / 3)
    return shear, p - shear * (alpha**2 + 2 * beta**2) / (3 * J)


def _radial_tangent(alpha: Array, beta: Array, p: Array, mu: Array, compliance: Array) -> Array:
    """Second derivatives (E, Q, 3, 3) of the energy per grown volume, by the radial stretch, twice the tangential one,
    and the pressure.

    alpha, beta, p : (E, Q) radial and tangential elastic stretch, pressure; mu, compliance : (E, 1) shear modulus,
    1/kappa.
    """
    shear, hydrostatic = shear_and_hydrostatic(alpha, beta, p, mu)
    zero, I1 = 0 * alpha, alpha**2 + 2 * beta**2
    trace, stretch_row = np.stack([1 / alpha, 1 / beta, zero], axis=-1), np.stack([alpha, beta, zero], axis=-1)
    mixed = trace[..., :, None] * stretch_row[..., None, :]
    D = np.diag([1, 0.5, 0]) - 2 / 3 * (mixed + np.swapaxes(mixed, -1, -2))
    D = shear[..., None, None] * (D + (5 / 9 * I1)[..., None, None] * trace[..., :, None] * trace[..., None, :])
    D[..., 1, 1] += hydrostatic * alpha / 2
    for i, j, value in ((0, 1, hydrostatic * beta), (0, 2, beta**2), (1, 2, alpha * beta)):
        D[..., i, j] += value
        D[..., j, i] += value
    D[..., 2, 2] = -compliance
    return D


def assemble(table: Array, D: Array, weight: Array, dofs: Ints) -> Array:
    """Sum of table^T D table over the quadrature points, (N, N)."""
    E, Q, a, b = table.shape
    weighted_table = (D * weight[..., None, None] @ table).reshape(E, Q * a, b)
    M = np.zeros((dofs.max() + 1,) * 2)
    np.add.at(M, (dofs[:, :, None], dofs[:, None, :]), table.reshape(E, Q * a, b).swapaxes(1, 2) @ weighted_table)
    return M


def _graded_edges(inner: float, outer: float, l: int, elements: int | None, volume_factor: float = 1.0) -> Array:
    """Edges of the elements of a layer, finest at the interface and the surface.

    A mode of degree l decays within r/l or faster from its largest amplitude, and as a power of the deformed radius r.
    Therefore the edges divide the integral of 1/(1/l + distance) + 1/r evenly; the distance is from the interface and
    the outer surface. r is that of a layer whose volume is multiplied by ``volume_factor`` at constant inner radius.
    """
    R = np.linspace(inner**3, outer**3, 40001) ** (1 / 3)
    r = np.cbrt(inner**3 + volume_factor * (R**3 - inner**3))
    fine_radii = (r[-1],) if outer < 1 else (r[0], r[-1])
    density_integral = np.log(r / inner)
    for fine_radius in fine_radii:
        density_integral += np.sign(r - fine_radius) * np.log1p(l * np.abs(r - fine_radius))
    density_integral -= density_integral[0]
    n_elements = 1 + int(np.ceil(1.5 * density_integral[-1])) if elements is None else elements
    edges = np.interp(np.linspace(0, density_integral[-1], n_elements + 1), density_integral, R)
    edges[[0, -1]] = inner, outer
    return edges


def _element_points(element: Ints, R: Array, u: Iterable[Any], q: Iterable[Any]) -> _ElementPoints:
    """Points at radii R (E, Q), with the shape functions of displacement and pressure there."""
    phi, slope = np.array([np.asarray(shape) for (shape,) in u]), np.array([shape.grad[0] for (shape,) in u])
    return _ElementPoints(element, R, phi, slope, np.array([np.asarray(shape) for (shape,) in q]))
