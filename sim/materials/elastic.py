"""Energy and stress of a material as functions of the elastic tensor A: plain NumPy with trailing 3x3 axes."""

from typing import NamedTuple

import numpy as np

from morphofold.frozen_arrays import Array
from morphofold.sim.elements.brick_kernels import FROZEN_BELOW_J
from morphofold.sim.elements.tet_kernels import CRUSHED_BELOW_J
from morphofold.sim.materials import Material
from morphofold.sim.materials.neo_hookean import NEO_HOOKEAN


def cofactor(A: Array) -> Array:
    """Cofactor matrix det(A) A^-T of A (..., 3, 3), defined for singular A too."""
    col0, col1, col2 = A[..., 0], A[..., 1], A[..., 2]
    return np.stack([np.cross(col1, col2), np.cross(col2, col0), np.cross(col0, col1)], axis=-1)


class Factor(NamedTuple):
    """Factor that makes an invariant volume-preserving, a function of J, and its first two derivatives."""

    value: Array
    slope: Array
    curvature: Array


def frozen(J: Array, power: float) -> Factor:
    """J^-power for bricks, constant below ``FROZEN_BELOW_J``, so that the force of a crushed element stays finite."""
    clamped_J = np.maximum(J, FROZEN_BELOW_J)
    value, is_falling = clamped_J**-power, J > FROZEN_BELOW_J
    return Factor(
        value,
        np.where(is_falling, -power * value / clamped_J, 0.0),
        np.where(is_falling, power * (power + 1) * value / clamped_J**2, 0.0),
    )


def continued(J: Array, power: float) -> Factor:
    """J^-power for tetrahedra, continued by its tangent below ``CRUSHED_BELOW_J``: this keeps one from collapsing."""
    clamped = np.maximum(J, CRUSHED_BELOW_J)
    value = clamped**-power
    slope = -power * value / clamped
    falls = J > CRUSHED_BELOW_J
    return Factor(value + slope * (J - clamped), slope, np.where(falls, power * (power + 1) * value / clamped**2, 0.0))


def invariants(A: Array) -> tuple[Array, Array, Array]:
    """I1 = tr(A^T A), I2 = (I1^2 - tr((A^T A)^2)) / 2, (...), and b = A A^T, (..., 3, 3)."""
    b = A @ A.swapaxes(-1, -2)
    I1 = np.trace(b, axis1=-2, axis2=-1)
    return I1, 0.5 * (I1**2 - np.einsum("...ij,...ij->...", b, b)), b


def isochoric_energy(A: Array, mu: Array | float, material: Material = NEO_HOOKEAN, factor_of=continued) -> Array:
    """Volume-preserving energy per grown volume [Pa], ``mu u(i1, i2)``, with ``i1 = f(J, 2/3) I1`` and
    ``i2 = f(J, 4/3) I2``; f is ``frozen`` or ``continued``."""
    J = np.linalg.det(A)
    I1, I2, _ = invariants(A)
    return mu * material.energy(factor_of(J, 2 / 3).value * I1, factor_of(J, 4 / 3).value * I2)


def isochoric_stress(A: Array, mu: Array | float, material: Material = NEO_HOOKEAN, factor_of=continued) -> Array:
    """First Piola-Kirchhoff stress dU/dA [Pa] of :func:`isochoric_energy`, (..., 3, 3)."""
    J = np.linalg.det(A)
    I1, I2, b = invariants(A)
    factor1, factor2 = factor_of(J, 2 / 3), factor_of(J, 4 / 3)
    u1, u2 = material.slopes(factor1.value * I1, factor2.value * I2)
    weight_of_A = 2 * mu * (u1 * factor1.value + u2 * factor2.value * I1)
    weight_of_bA = 2 * mu * u2 * factor2.value
    weight_of_cofactor = mu * (u1 * factor1.slope * I1 + u2 * factor2.slope * I2)
    expand = lambda weight: np.asarray(weight)[..., None, None]
    return expand(weight_of_A) * A - expand(weight_of_bA) * (b @ A) + expand(weight_of_cofactor) * cofactor(A)


def energy(A: Array, mu: Array | float, kappa: Array | float, material: Material = NEO_HOOKEAN) -> Array:
    """Energy per grown volume [Pa], ``mu u(i1, i2) + kappa/2 (J - 1)^2``.

    Parameters
    ----------
    A : (..., 3, 3) float64
        Elastic part of the deformation gradient, F = A G (Razavi et al. 2015, Eq. 1).
    mu, kappa : float or (...) float64
        Shear and bulk modulus [Pa].
    material : Material
        Neo-Hookean by default, u = (i1 - 3) / 2.

    Returns
    -------
    W : (...) float64

    Notes
    -----
    Eq. (4) of the paper, ``mu/2 (tr(A^T A) - 3)`` with det A = 1, is the limit kappa/mu -> infinity of the neo-Hookean
    energy. The split into a volume-preserving factor and a volumetric term is that of the finite-element program that
    the paper used. Where J < 0.1 the factors J^-2/3 and J^-4/3 keep their values at 0.1.
    """
    return isochoric_energy(A, mu, material, frozen) + 0.5 * kappa * (np.linalg.det(A) - 1) ** 2


def stress(A: Array, mu: Array | float, kappa: Array | float, material: Material = NEO_HOOKEAN) -> Array:
    """First Piola-Kirchhoff stress dW/dA [Pa] of :func:`energy`, (..., 3, 3)."""
    volumetric = np.asarray(kappa * (np.linalg.det(A) - 1))[..., None, None]
    return isochoric_stress(A, mu, material, frozen) + volumetric * cofactor(A)
