"""The forces of bricks assembled by scikit-fem: a readable counterpart of the kernels, and a peer in speed."""

import numpy as np
from skfem import Basis, ElementHex1, ElementVector, LinearForm

from morphofold.frozen_arrays import Array
from morphofold.sim.body import Body
from morphofold.sim.elements.bricks import GAUSS_POINTS, GAUSS_WEIGHT
from morphofold.studies.accuracy.error_points import OTHER_PEER, OUR_CODE, Point, timed
from morphofold.studies.accuracy.reference_elements import brick_energy, brick_stress, growth_tensor
from morphofold.studies.speed.solver_speed import NOISE_MM, speed_body

CELL_COUNTS = (12, 24, 40)  # surface cells along a quarter circle of an octant
GROWTH = 1.2
SKFEM_METHOD = "scikit-fem assembly"


class Twin:
    """Forces and energies of a ``Body`` of bricks at its present growth, from the scikit-fem basis on its reference
    positions and :mod:`morphofold.sim.materials.elastic`."""

    def __init__(self, body: Body):
        self.body = body
        mesh = type(body.bilayer.mesh)(np.ascontiguousarray(body.X.T), body.bilayer.mesh.t)
        self.basis = Basis(mesh, ElementVector(ElementHex1()), quadrature=(GAUSS_POINTS, np.full(8, GAUSS_WEIGHT)))
        shape_values = np.stack([ElementHex1().lbasis(GAUSS_POINTS, node)[0] for node in range(8)])
        radial_sums = np.einsum("iq,iej->eqj", shape_values, body.bilayer.radial[mesh.t])
        growth_stretch = np.ones(mesh.nelements)
        growth_stretch[body.bilayer.mesh.subdomains["cortex"]] = body.growth
        radial = radial_sums / np.linalg.norm(radial_sums, axis=-1, keepdims=True)
        G = growth_tensor(np.repeat(growth_stretch[:, None], 8, axis=1), radial, body.law)
        self.G_inverse, self.det_G = np.linalg.inv(G), np.linalg.det(G)

    def elastic(self, x: Array) -> Array:
        """A (E, 8, 3, 3) at the Gauss points, for positions x (N, 3)."""
        u = np.zeros(self.basis.N)
        u[self.basis.nodal_dofs] = (x - self.body.X).T
        F = np.eye(3) + np.moveaxis(self.basis.interpolate(u).grad, (0, 1), (-2, -1))
        A: Array = F @ self.G_inverse
        return A

    def energy(self, x: Array) -> Array:
        """Energy of each brick (E,), for positions x (N, 3)."""
        body = self.body
        w = self.basis.dx * self.det_G
        return brick_energy(self.elastic(x), w, body.mu, body.kappa, body.elements.material)

    def forces(self, x: Array) -> Array:
        """Nodal forces (N, 3), minus the gradient of the energy, for positions x (N, 3)."""
        body, w = self.body, self.basis.dx * self.det_G
        S = brick_stress(self.elastic(x), w, body.mu, body.kappa, body.elements.material)
        P = self.det_G[..., None, None] * S @ np.swapaxes(self.G_inverse, -1, -2)  # per reference volume
        P = np.moveaxis(P, (-2, -1), (0, 1))
        form = LinearForm(lambda v, w: np.einsum("ij...,ij...", w["P"], v.grad))
        forces: Array = -form.assemble(self.basis, P=P)[self.basis.nodal_dofs].T
        return forces


def assembly_points(n_cells: int) -> list[Point]:
    """Forces of a grown, shaken octant by the kernels and by scikit-fem, in double precision; the error is their
    difference."""
    body = speed_body("brick", n_cells, "octant", single=False)
    body.grow(GROWTH)
    x = body.X + NOISE_MM * np.random.default_rng(0).standard_normal(body.X.shape)
    skfem_body = Twin(body)
    skfem_forces = skfem_body.forces(x)
    error = float(np.abs(body.forces(x) - skfem_forces).max() / np.abs(skfem_forces).max())
    error_fields = "solver", "shaken octant, double precision", "nodal forces", error, OTHER_PEER
    mesh_fields = "mesh", f"{body.elements.n:,} bricks", body.bilayer.edge, body.elements.n
    return [
        Point(*error_fields, *mesh_fields, *timed(compute)[1], method=method)
        for method, compute in ((OUR_CODE, lambda: body.forces(x)), (SKFEM_METHOD, lambda: skfem_body.forces(x)))
    ]
