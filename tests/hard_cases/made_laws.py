"""Bodies of the laws: turned, scaled, mirrored; and an account of the energy of a run."""

import dataclasses

import numpy as np
from hard_cases.made_solver import body_of
from scipy.sparse.linalg import LinearOperator, cg
from skfem import MeshHex

from morphofold.sim.body import Body
from morphofold.sim.dynamics import Dynamics
from morphofold.sim.effects import Effect, contact
from morphofold.sim.effects.contact import Contact
from morphofold.sim.effects.perturbation import Perturbation
from morphofold.sim.effects.plane_strain import PlaneStrain
from morphofold.sim.effects.symmetry import Symmetry
from morphofold.sim.elements import brick_kernels
from morphofold.sim.elements.lanes import LANES
from morphofold.sim.elements.surface_filter import SurfaceFilter
from morphofold.sim.mesh.brick_mesh import bilayer_patch, bilayer_sphere


def moved(bilayer, rotation, shift):
    """The same mesh without planes, turned and shifted."""
    mesh = MeshHex(np.ascontiguousarray((bilayer.mesh.p.T @ rotation.T + shift).T), bilayer.mesh.t, validate=False)
    mesh = mesh.with_subdomains(bilayer.mesh.subdomains)
    return dataclasses.replace(
        bilayer, mesh=mesh, radial=bilayer.radial @ rotation.T, foot=bilayer.foot @ rotation.T + shift
    )


def sphere(portion="full", n=6, law="isotropic", move=None):
    """The dynamics of a sphere of thick cortex, before or after a ``move`` (rotation, shift)."""
    bilayer = bilayer_sphere(50, 5, 25, portion, n, 2)
    if move is not None:
        bilayer = moved(bilayer, *move)
    body = body_of(bilayer, mu_cortex=2.0, law=law)
    return Dynamics(body, [Contact()], steps_per_unit=180 * body.crossing)


def strip(length=1.0, modulus=1.0, effects=()):
    """The dynamics of a strip that folds, all lengths and all moduli times a number."""
    bilayer = bilayer_patch((28 * length, 0.0), 12 * length, 2.5 * length, length, 3)
    X = Perturbation(0.05 * length, 10 * length, seed=0).reshape(bilayer, bilayer.mesh.p.T)
    body = Body(bilayer, mu_cortex=2 * modulus, mu_core=modulus, kappa_ratio=50.0, law="isotropic", X=X)
    return Dynamics(body, [PlaneStrain(), Contact(), Symmetry(), *effects], steps_per_unit=180 * body.crossing)


def momentum(body, v):
    """Momentum (N, 3) of the nodes at velocities ``v``, with the mass of the coarse levels: that which gives v."""
    moves = body.free.ravel()

    def of_all(p):
        full = np.zeros(v.size)
        full[moves] = p
        return full.reshape(v.shape)

    velocity = lambda p: body.levels.accelerations(of_all(p), body.mass).ravel()[moves]
    p, failed = cg(LinearOperator((moves.sum(),) * 2, velocity), v.ravel()[moves], rtol=1e-10)
    assert not failed
    return of_all(p)


class Account(Effect):
    """Where the work of growth goes, step by step; the last of the effects.

    Growth works at fixed positions: what the strain energy W rises by as G does is the integral of dW/dG : dG. Between
    positions x_n, forces work by the trapezoid, f_n (x_n+1 - x_n-1) / 2 = f_n (v_n + v_n+1) / 2.
    """

    name = "account"

    def prepare(self, body):
        self.body, self.before = body, 0.0
        self.growth = self.strain = self.damped = self.contact = 0.0

    def refresh(self, run):
        self.run, self.damping = run, run.damping
        run.body.update_levels(sum(effect.springs(run.body, run.state.x) for effect in run.effects))
        self.momentum = momentum(run.body, run.state.v)
        self.kinetic = 0.5 * float(np.sum(self.momentum * run.state.v))

    def _energy(self, x):
        self.body.elements.measure(x)
        return float(self.body.elements.state()["energy"].sum()) + self.body.filter.energy(x)

    def add_forces(self, body, x, v, extra):
        now = self._energy(x)
        self.growth += now - self.before
        self.before, self.v = now, v.copy()
        self.pushed = extra - body.filter.forces(x)

    def after_step(self, x, v):
        mean, n = 0.5 * (self.v + v), len(self.pushed)
        self.damped += self.damping * float(np.sum(self.momentum * mean))
        self.momentum = (1 - self.damping) * self.momentum + self.run._forces
        self.contact += float(np.sum(self.pushed * mean[:n]))
        now = self._energy(x)
        self.strain += now - self.before
        self.before = now

    def gap(self):
        """What is missing, over the work of growth."""
        return abs(self.strain + self.kinetic + self.damped - self.contact) / self.growth


# guards, taken away


def filter_across_z_only(patch):
    """The surface filter holds two of three components."""
    forces = SurfaceFilter.forces

    def two(self, x, out=None):
        out = forces(self, x, out)
        out[:, 2] = 0.0
        return out

    patch.setattr(SurfaceFilter, "forces", two)


def gap_in_mm(patch):
    """Contact's gap and search radius are lengths in mm, typed by hand."""
    refresh = Contact.refresh

    def typed(self, run):
        cell, run.body.cell = run.body.cell, 1.0
        refresh(self, run)
        run.body.cell = cell

    patch.setattr(Contact, "refresh", typed)


def volume_not_grown(patch):
    """Growth forgets the volume that the pressure is measured by."""
    grow = brick_kernels.grow

    def forgetful(point, point0, radial, modulus, *arguments):
        volume = modulus[:, 2 * LANES :].copy()
        grow(point, point0, radial, modulus, *arguments)
        modulus[:, 2 * LANES :] = volume

    patch.setattr(brick_kernels, "grow", forgetful)


def no_reaction(patch):
    """Contact pushes a node, and not the triangle that it lies on."""

    def action(tri, partner, push, weight, depth, extra):
        extra += push * (depth > 0)[:, None]

    patch.setattr(contact, "add_pushes", action)
