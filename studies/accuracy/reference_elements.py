"""Growth tensors, and energy and stress of a brick and of a patch of tetrahedra, as in the equations.

Readable reference: the kernels of the explicit solver compute these energies and their gradients in another form; tests
and the study of accuracy compare the two. Everything here is plain NumPy with trailing 3x3 axes.
"""

import numpy as np

from morphofold.frozen_arrays import Array
from morphofold.sim.elements.tet_kernels import OWN_GRADIENT_SHARE
from morphofold.sim.growth_laws import check_law
from morphofold.sim.materials import Material
from morphofold.sim.materials.elastic import cofactor, energy, isochoric_energy, isochoric_stress, stress
from morphofold.sim.materials.neo_hookean import NEO_HOOKEAN


def growth_tensor(g: Array | float, radial: Array, law: str) -> Array:
    """Growth tensor G in F = A G (Razavi et al. 2015, Eq. 1).

    Parameters
    ----------
    g : float or (...) float64
        Growth stretch, a ratio of lengths; 1 means no growth.
    radial : (..., 3) float64
        Unit reference direction N; tangential growth adds nothing along it.
    law : {"isotropic", "tangential"}
        ``g I`` (paper, before Eq. 2), or ``g (I - N N) + N N`` (before Eq. 3).

    Returns
    -------
    G : (..., 3, 3) float64

    Raises
    ------
    UnknownName
        For another law.
    """
    check_law(law)
    g = np.asarray(g, dtype=np.float64)[..., None, None]
    if law == "isotropic":
        return g * np.broadcast_to(np.eye(3), radial.shape + (3,))
    NN = radial[..., :, None] * radial[..., None, :]
    return g * (np.eye(3) - NN) + NN


def brick_energy(A: Array, w: Array, mu: Array, kappa: Array, material: Material = NEO_HOOKEAN) -> Array:
    """Energy of Q1P0 bricks from their Gauss points.

    Parameters
    ----------
    A : (E, 8, 3, 3) float64
        Elastic tensor at the Gauss points.
    w : (E, 8) float64
        Grown volume of each Gauss point [mm^3].
    mu, kappa : (E,) float64
        Moduli of each element.
    material : Material

    Returns
    -------
    (E,) float64
        ``sum_q w_q W(A_q; mu, 2 mu) + kappa/2 V (v/V - 1)^2`` with V = sum w, v = sum w J. The pressure of
        modulus kappa depends only on the mean volume ratio, so the brick does not lock. The weak local term of
        modulus 2 mu keeps single points from collapsing. Both resist uniform compression: the bulk modulus of a body
        is kappa + 2 mu.
    """
    V = w.sum(axis=1)
    volume_ratio = (w * np.linalg.det(A)).sum(axis=1) / V
    local_energy = energy(A, mu[:, None], 2 * mu[:, None], material)
    return (w * local_energy).sum(axis=1) + 0.5 * kappa * V * (volume_ratio - 1) ** 2


def brick_stress(A: Array, w: Array, mu: Array, kappa: Array, material: Material = NEO_HOOKEAN) -> Array:
    """dE/dA / w of :func:`brick_energy` at each Gauss point, (E, 8, 3, 3) [Pa]."""
    volume_ratio = (w * np.linalg.det(A)).sum(axis=1) / w.sum(axis=1)
    pressure = (kappa * (volume_ratio - 1))[:, None, None, None]
    return stress(A, mu[:, None], 2 * mu[:, None], material) + pressure * cofactor(A)


def patch_energy(A: Array, w: Array, mu: Array, kappa: Array, material: Material = NEO_HOOKEAN) -> Array:
    """Energy of patches of tetrahedra.

    Parameters
    ----------
    A : (P, T, 3, 3) float64
        Elastic tensor of each tetrahedron.
    w : (P, T) float64
        Its grown volume [mm^3]; 0 where a patch has fewer than T.
    mu, kappa : (P,) float64
        Moduli of each patch.
    material : Material

    Returns
    -------
    (P,) float64
        ``OWN_GRADIENT_SHARE sum_t w_t U(A_t) + (1 - OWN_GRADIENT_SHARE) V U(Am) + kappa/2 V (v/V - 1)^2`` with U the
        :func:`isochoric_energy`, V = sum w, v = sum w J, Am = sum w A / V. One pressure per patch avoids locking (de
        Souza Neto et al. 2005, F-bar patch). The term of the mean gradient removes most of the other excess stiffness
        of linear tetrahedra. The term of each tetrahedron keeps it from collapsing.
    """
    V = w.sum(axis=1)
    v_over_V = (w * np.linalg.det(A)).sum(axis=1) / V
    own_part = (w * isochoric_energy(A, mu[:, None], material)).sum(axis=1)
    mean_part = V * isochoric_energy(_volume_mean(A, w), mu, material)
    return OWN_GRADIENT_SHARE * own_part + (1 - OWN_GRADIENT_SHARE) * mean_part + 0.5 * kappa * V * (v_over_V - 1) ** 2


def patch_stress(A: Array, w: Array, mu: Array, kappa: Array, material: Material = NEO_HOOKEAN) -> Array:
    """dE/dA / w of :func:`patch_energy` for each tetrahedron, (P, T, 3, 3) [Pa]."""
    volume_ratio = (w * np.linalg.det(A)).sum(axis=1) / w.sum(axis=1)
    pressure = (kappa * (volume_ratio - 1))[:, None, None, None]
    mean_stress = isochoric_stress(_volume_mean(A, w), mu, material)[:, None]
    own_stress = isochoric_stress(A, mu[:, None], material)
    return OWN_GRADIENT_SHARE * own_stress + (1 - OWN_GRADIENT_SHARE) * mean_stress + pressure * cofactor(A)


def _volume_mean(A: Array, w: Array) -> Array:
    return np.einsum("pt,ptij->pij", w, A) / w.sum(axis=1)[:, None, None]
