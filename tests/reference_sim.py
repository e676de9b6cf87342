"""Readable twin of the fast kernels: the same forms, assembled by scikit-fem."""

import numpy as np
from skfem import Basis, ElementHex1, ElementVector, LinearForm

from morphofold.sim.body import Body
from morphofold.sim.elements.bricks import GAUSS, GAUSS_WEIGHT
from morphofold.sim.growth import growth_tensor
from morphofold.sim.material import brick_energy, brick_stress


class Twin:
    """Forces and energies of a ``Body``, from scikit-fem's basis on its reference positions and ``sim.material``."""

    def __init__(self, body: Body):
        self.body = body
        mesh = type(body.bilayer.mesh)(np.ascontiguousarray(body.X.T), body.bilayer.mesh.t)
        self.basis = Basis(mesh, ElementVector(ElementHex1()), quadrature=(GAUSS, np.full(8, GAUSS_WEIGHT)))
        shape = np.stack([ElementHex1().lbasis(GAUSS, i)[0] for i in range(8)])
        at = np.einsum("iq,iej->eqj", shape, body.bilayer.radial[mesh.t])
        stretch = np.ones(mesh.nelements)
        stretch[body.bilayer.mesh.subdomains["cortex"]] = body.growth
        radial = at / np.linalg.norm(at, axis=-1, keepdims=True)
        G = growth_tensor(np.repeat(stretch[:, None], 8, axis=1), radial, body.law)
        self.G_inverse, self.det_G = np.linalg.inv(G), np.linalg.det(G)

    def elastic(self, x):
        """A (E, 8, 3, 3) at the Gauss points, for positions x (N, 3)."""
        u = np.zeros(self.basis.N)
        u[self.basis.nodal_dofs] = (x - self.body.X).T
        F = np.eye(3) + np.moveaxis(self.basis.interpolate(u).grad, (0, 1), (-2, -1))
        return F @ self.G_inverse

    def energy(self, x):
        return brick_energy(self.elastic(x), self.basis.dx * self.det_G, self.body.mu, self.body.kappa)

    def forces(self, x):
        S = brick_stress(self.elastic(x), self.basis.dx * self.det_G, self.body.mu, self.body.kappa)
        P = self.det_G[..., None, None] * S @ np.swapaxes(self.G_inverse, -1, -2)    # per reference volume
        P = np.moveaxis(P, (-2, -1), (0, 1))
        form = LinearForm(lambda v, w: np.einsum("ij...,ij...", w["P"], v.grad))
        return -form.assemble(self.basis, P=P)[self.basis.nodal_dofs].T
