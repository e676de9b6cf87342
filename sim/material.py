"""Neo-Hookean energy and stress in the elastic tensor A, and its form on a brick and on a patch of tetrahedra.

Readable twins: the kernels of the explicit solver evaluate ``brick_energy``, ``patch_energy`` and their gradients in
another arrangement; tests hold them together. Everything here is plain NumPy with trailing 3x3 axes.
"""

from __future__ import annotations

import numpy as np

from morphofold.arrays import Array
from morphofold.sim.elements.brick_kernels import J_MIN
from morphofold.sim.elements.tet_kernels import BLEND, CRUSHED


def cofactor(A: Array) -> Array:
    """Cofactor matrix det(A) A^-T of (..., 3, 3), defined for singular A too."""
    a, b, c = A[..., 0], A[..., 1], A[..., 2]
    return np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=-1)


def energy(A: Array, mu: Array | float, kappa: Array | float) -> Array:
    """Neo-Hookean energy per grown volume [Pa], ``mu/2 (J^-2/3 tr(A^T A) - 3) + kappa/2 (J - 1)^2``.

    Parameters
    ----------
    A : (..., 3, 3) float64
        Elastic part of the deformation gradient, F = A G (Razavi et al. 2015, Eq. 1).
    mu, kappa : float or (...) float64
        Shear and bulk modulus [Pa].

    Returns
    -------
    W : (...) float64

    Notes
    -----
    Eq. (4) of the paper, ``mu/2 (tr(A^T A) - 3)`` with det A = 1, is the limit kappa/mu -> infinity. The split
    into a volume-preserving factor and a volumetric term is the one of the finite-element program that the
    paper used. Where J < 0.1 the factor J^-2/3 is frozen at its value there, so that a crushed element
    gives a finite force.
    """
    J = np.linalg.det(A)
    I1 = np.einsum("...ij,...ij->...", A, A)
    return 0.5 * mu * (np.maximum(J, J_MIN) ** (-2 / 3) * I1 - 3) + 0.5 * kappa * (J - 1) ** 2


def stress(A: Array, mu: Array | float, kappa: Array | float) -> Array:
    """First Piola-Kirchhoff stress dW/dA [Pa] of :func:`energy`, (..., 3, 3)."""
    J = np.linalg.det(A)
    held = np.maximum(J, J_MIN)
    I1 = np.einsum("...ij,...ij->...", A, A)
    iso = mu * held ** (-2 / 3)
    volumetric = kappa * (J - 1) - np.where(J > J_MIN, iso * I1 / (3 * held), 0.0)
    return np.asarray(iso)[..., None, None] * A + np.asarray(volumetric)[..., None, None] * cofactor(A)


def brick_energy(A: Array, w: Array, mu: Array, kappa: Array) -> Array:
    """Energy of Q1P0 bricks from their Gauss points.

    Parameters
    ----------
    A : (E, 8, 3, 3) float64
        Elastic tensor at the Gauss points.
    w : (E, 8) float64
        Grown volume of each Gauss point [mm^3].
    mu, kappa : (E,) float64
        Moduli of each element.

    Returns
    -------
    (E,) float64
        ``sum_q w_q W(A_q; mu, 2 mu) + kappa/2 V (v/V - 1)^2`` with V = sum w, v = sum w J: the pressure of
        modulus kappa sees only the mean volume ratio, which keeps the brick from locking; the weak local
        term, modulus 2 mu, keeps single points from collapsing. Uniform compression meets both: the bulk modulus
        of a body is kappa + 2 mu.
    """
    V = w.sum(axis=1)
    ratio = (w * np.linalg.det(A)).sum(axis=1) / V
    local = energy(A, mu[:, None], 2 * mu[:, None])
    return (w * local).sum(axis=1) + 0.5 * kappa * V * (ratio - 1) ** 2


def brick_stress(A: Array, w: Array, mu: Array, kappa: Array) -> Array:
    """dE/dA / w of :func:`brick_energy` at each Gauss point, (E, 8, 3, 3) [Pa]."""
    ratio = (w * np.linalg.det(A)).sum(axis=1) / w.sum(axis=1)
    pressure = (kappa * (ratio - 1))[:, None, None, None]
    return stress(A, mu[:, None], 2 * mu[:, None]) + pressure * cofactor(A)


def isochoric_energy(A: Array, mu: Array | float) -> Array:
    """Volume-preserving energy of tetrahedra per grown volume [Pa], ``mu/2 (phi(J) tr(A^T A) - 3)``.

    That of :func:`energy` but for crushed ones: phi = J^-2/3 goes on as its tangent where J < 0.03, so that the
    stress is continuous and the resistance to collapse never gives way.
    """
    J = np.linalg.det(A)
    held = np.maximum(J, CRUSHED)
    phi = held ** (-2 / 3) - 2 / 3 * held ** (-5 / 3) * (J - held)
    return 0.5 * mu * (phi * np.einsum("...ij,...ij->...", A, A) - 3)


def isochoric_stress(A: Array, mu: Array | float) -> Array:
    """First Piola-Kirchhoff stress dU/dA [Pa] of :func:`isochoric_energy`, (..., 3, 3)."""
    J = np.linalg.det(A)
    held = np.maximum(J, CRUSHED)
    phi = held ** (-2 / 3) - 2 / 3 * held ** (-5 / 3) * (J - held)
    slope = -held ** (-5 / 3) / 3 * np.einsum("...ij,...ij->...", A, A)
    return np.asarray(mu * phi)[..., None, None] * A + np.asarray(mu * slope)[..., None, None] * cofactor(A)


def patch_energy(A: Array, w: Array, mu: Array, kappa: Array) -> Array:
    """Energy of patches of tetrahedra.

    Parameters
    ----------
    A : (P, T, 3, 3) float64
        Elastic tensor of each tetrahedron.
    w : (P, T) float64
        Its grown volume [mm^3]; 0 where a patch has fewer than T.
    mu, kappa : (P,) float64
        Moduli of each patch.

    Returns
    -------
    (P,) float64
        ``BLEND sum_t w_t U(A_t) + (1 - BLEND) V U(Am) + kappa/2 V (v/V - 1)^2`` with U the :func:`isochoric_energy`,
        V = sum w, v = sum w J, Am = sum w A / V. One pressure for a patch keeps it from locking (de Souza Neto et al.
        2005, F-bar patch); the share of the mean gradient takes away most of what else makes linear tetrahedra
        stiff, and the share of each tetrahedron's own keeps it from collapsing.
    """
    V = w.sum(axis=1)
    ratio = (w * np.linalg.det(A)).sum(axis=1) / V
    own = (w * isochoric_energy(A, mu[:, None])).sum(axis=1)
    common = V * isochoric_energy(_mean(A, w), mu)
    return BLEND * own + (1 - BLEND) * common + 0.5 * kappa * V * (ratio - 1) ** 2


def patch_stress(A: Array, w: Array, mu: Array, kappa: Array) -> Array:
    """dE/dA / w of :func:`patch_energy` for each tetrahedron, (P, T, 3, 3) [Pa]."""
    ratio = (w * np.linalg.det(A)).sum(axis=1) / w.sum(axis=1)
    pressure = (kappa * (ratio - 1))[:, None, None, None]
    common = isochoric_stress(_mean(A, w), mu)[:, None]
    return BLEND * isochoric_stress(A, mu[:, None]) + (1 - BLEND) * common + pressure * cofactor(A)


def _mean(A: Array, w: Array) -> Array:
    return np.einsum("pt,ptij->pij", w, A) / w.sum(axis=1)[:, None, None]
