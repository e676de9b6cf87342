"""Small scenes of the solver's hard cases, what is asked of all of them, and the guards that are taken away."""

import dataclasses
import hashlib
from typing import Any

import meshio
import numpy as np
from scipy.sparse import csr_matrix
from skfem import MeshHex

from morphofold.sim import dynamics
from morphofold.sim.body import Body
from morphofold.sim.build import build_bilayer, build_body
from morphofold.sim.dynamics import Dynamics
from morphofold.sim.effects import build_effects
from morphofold.sim.effects.contact import Contact
from morphofold.sim.effects.corner_barrier import CornerBarrier
from morphofold.sim.effects.perturbation import Perturbation
from morphofold.sim.effects.symmetry import Symmetry
from morphofold.sim.elements import brick_kernels
from morphofold.sim.elements.bricks import Bricks
from morphofold.sim.elements.lanes import LANES
from morphofold.sim.elements.surface_filter import SurfaceFilter
from morphofold.sim.mesh.brick_mesh import bilayer_patch, bilayer_sphere
from morphofold.sim.multilevel_acceleration import CoarseLevels
from morphofold.sim.output.stage_surfaces import whole_surfaces
from morphofold.sim.scene.scene_files import load_scene
from morphofold.sim.stage_checks import BOUNDS, LEAST_J, check_surface
from morphofold.studies.accuracy.radial_finite_elements import radial_equilibrium
from morphofold.studies.speed.solver_speed import cut_bricks

#: tiny scenes: a strip that folds, and an octant for what is known of a sphere before it folds
STRIP = ("strip", "geometry.length=16", "geometry.depth=12", "accuracy.edge=1.0", "accuracy.elements_through_cortex=3")
OCTANT = ("demo", "geometry.portion=octant", "accuracy.edge=9.82", "accuracy.precision=double")

MESH = 0.03  # error of the displacement that three elements through the cortex are allowed: docs/accuracy.md
STILL = 1e-9  # kinetic over strain energy, with forces in 64 bits,
MOST_REST = 1000  # or crossings of the cortex


def start(scene, *settings, mesh=lambda bilayer: bilayer):
    """The dynamics of a scene, as a run of it would build them; on what ``mesh`` makes of its mesh."""
    scene = load_scene(scene, ["output.stages=[]", *settings])
    effects = build_effects(scene)
    body = build_body(scene, effects, mesh(build_bilayer(scene)))
    return Dynamics(body, effects, steps_per_unit=scene.steps_per_unit(body.crossing))


def run_to_rest(run, g):
    """The run at growth g, at rest as a stage of a scene is."""
    run.grow_to(g)
    run.settle()
    return run


def at_rest(run, g):
    """The run at growth g, once it is still: a stiff cortex on a soft core creeps for far longer than a scene waits."""
    run.grow_to(g)
    while run.state.record["kinetic_over_strain"] > STILL:
        run.relax(run.state.relaxed + int(10 * run.body.crossing))
        if run.state.relaxed > MOST_REST * run.body.crossing:
            break
    return run


def digest(x):
    """What two arrays share only if they are bitwise the same."""
    return hashlib.sha256(np.ascontiguousarray(x)).hexdigest()[:12]


def imbalance(forces):
    """The sum of forces (N, 3), over the sum of their sizes."""
    return float(np.abs(forces.sum(axis=0)).max() / np.abs(forces).sum())


def drift(run):
    """How far the cortex is from its grown volume, as health.json tells it."""
    elements, free = run.body.elements, run.body.grown_volumes()
    return abs(float(np.sum(free * elements.state()["volume_ratio"][: elements.n_cortex])) / float(free.sum()) - 1)


def healthy(holds, run, leave=()):
    """Every bound that health.json is judged by, but for those to ``leave``."""
    stage = check_surface(whole_surfaces(run.body, run.state.x)[1], run.body.bilayer.closed)
    stage |= {"kinetic_over_strain": run.state.record["kinetic_over_strain"], "volume_drift": drift(run)}
    for name in BOUNDS:
        if name in stage and name not in leave:
            holds(name, stage[name], at_most=BOUNDS[name][0])
    holds("lowest J", run.state.lowest_J, at_least=LEAST_J)


def off_the_smooth_state(run, *settings):
    """Mean error of the pial displacement of an ``OCTANT`` with settings, over that of the exact smooth state."""
    scene = load_scene(OCTANT[0], ["output.stages=[]", *OCTANT[1:], *settings])
    C, material = scene.geometry.radius, scene.material
    ratios = {"mu_ratio": material.mu_ratio, "kappa_ratio": material.kappa_ratio}
    T, A = scene.geometry.cortex_thickness / C, scene.geometry.hole_radius / C
    exact = radial_equilibrium(run.state.growth, T, A_over_C=A, law=scene.growth.law, **ratios)
    n = run.body.n_surface
    moved = np.linalg.norm(run.state.x[:n], axis=1) - np.linalg.norm(run.body.X[:n], axis=1)
    return float(np.abs(moved / (C * (exact.at(1.0, "cortex").r[0] - 1)) - 1).mean())


def facing_patches(size=(4.0, 4.0), depth=8.0, thickness=2.0, edge=0.8, gap=1.6, layers=2):
    """Two bodies, patches whose pial surfaces face each other across ``gap`` [mm], each held at its own base."""
    patch = bilayer_patch(size, depth, thickness, edge, layers)
    S, cortex = patch.n_surface, len(patch.mesh.subdomains["cortex"])
    N, E = patch.mesh.nvertices, patch.mesh.nelements
    turn = np.array([1.0, -1.0, -1.0])  # about x, so bricks stay right-handed
    points = np.concatenate([patch.mesh.p.T, patch.mesh.p.T * turn + [0.0, size[1], gap]])
    old = np.concatenate([np.arange(S), N + np.arange(S), np.arange(S, N), N + np.arange(S, N)])
    new = np.argsort(old)  # pial nodes of both come first,
    two_layers = np.repeat([0, 1], [cortex, E - cortex])  # and both cortices
    bricks = np.argsort(np.tile(two_layers, 2), kind="stable")
    t = new[np.concatenate([patch.mesh.t, patch.mesh.t + N], axis=1)][:, bricks]
    mesh = MeshHex(np.ascontiguousarray(points[old].T), np.ascontiguousarray(t), validate=False)
    layers = {"cortex": np.arange(2 * cortex), "core": np.arange(2 * cortex, 2 * E)}
    white = new[np.concatenate([patch.white.indices, patch.white.indices + N])]
    return dataclasses.replace(
        patch,
        mesh=mesh.with_subdomains(layers),
        white=csr_matrix((np.ones(2 * S), (np.arange(2 * S), white)), (2 * S, 2 * N)),
        faces=new[np.concatenate([patch.faces, patch.faces + N])],
        n_surface=2 * S,
        radial=np.concatenate([patch.radial, patch.radial * turn])[old],
        share=np.tile(patch.share, 2)[old],
        foot=np.concatenate([patch.foot, patch.foot * turn + [0.0, size[1], gap]])[old],
        held=new[np.concatenate([patch.held, patch.held + N])],
    )


def body_of(bilayer, *, mu_cortex=1.0, kappa_ratio=50.0, law="isotropic", X=None):
    return Body(bilayer, mu_cortex=mu_cortex, mu_core=1.0, kappa_ratio=kappa_ratio, law=law, X=X)


def shell_file(path, thickness, squash=0.0):
    """Writes a shell in tetrahedra, 50 mm out and 25 mm in, its cortex labelled; and returns their worst aspect.

    ``squash`` is how far one node in a hundred within, if it can be, is moved to the middle of a face opposite to it.
    The aspect is the longest edge over the least height.
    """
    bilayer = cut_bricks(bilayer_sphere(50.0, thickness, 25.0, "full", 8, 3))
    x, tets = bilayer.mesh.p.T.copy(), bilayer.mesh.t.T
    inside = np.setdiff1d(np.arange(bilayer.n_surface, len(x)), bilayer.held)
    for node in inside[::100] if squash else ():
        star = tets[(tets == node).any(axis=1)]
        for face in (tet[tet != node] for tet in star):
            moved = x.copy()
            moved[node] += squash * (x[face].mean(axis=0) - x[node])
            if (np.linalg.det(_edges(moved, star)) * np.linalg.det(_edges(x, star)) > 0).all():
                x = moved
                break
    cortex = (np.arange(len(tets)) < len(bilayer.mesh.subdomains["cortex"])).astype(int)
    meshio.Mesh(x, [("tetra", tets)], cell_data={"layer": [cortex]}).write(path)
    sides = np.stack([x[tets[:, i]] - x[tets[:, j]] for i in range(4) for j in range(i)])
    heights = np.linalg.inv(_edges(x, tets))  # columns, and minus their sum: 1 / heights along them
    heights = np.concatenate([heights, -heights.sum(axis=2, keepdims=True)], axis=2)
    longest = np.linalg.norm(sides, axis=2).max(axis=0)
    return float((longest * np.linalg.norm(heights, axis=1).max(axis=1)).max())


def _edges(x, tets):
    return x[tets[:, 1:]] - x[tets[:, :1]]


def facing(gap, size, noise=0.0, depth=8.0):
    """The dynamics of two patches ``gap`` [mm] apart; perturbed by ``noise`` [mm] they fold."""
    bilayer = facing_patches((size, size), depth, gap=gap)
    X = Perturbation(noise, 8.0, seed=3).reshape(bilayer, bilayer.mesh.p.T) if noise else None
    body = body_of(bilayer, X=X)
    return Dynamics(body, [Contact(), Symmetry()], steps_per_unit=180 * body.crossing)


# guards, taken away


def mass_of_cubes(patch):
    """Every body has the mass that suffices for bricks about as thick as wide."""
    patch.setattr(Body, "fastest_wave", lambda *arguments: 0.0)


def levels_without_limit(patch):
    """Coarse levels make smooth motions as light in every body."""
    patch.setattr(Body, "_limit_levels", Body.update_levels)


def levels_blind_to_creases(patch):
    """Coarse levels have the mass of their nodes, crushed or not."""
    update = CoarseLevels.update
    patch.setattr(
        CoarseLevels, "update", lambda self, mass, crushed, springs: update(self, mass, np.ones(len(mass)), springs)
    )


def _then(patch, owner, method, change):
    """``change`` follows on every call of a method."""
    call = getattr(owner, method)

    def both(self, *arguments):
        result = call(self, *arguments)
        change(self)
        return result

    patch.setattr(owner, method, both)


def mass_of_the_first_step(patch):
    """A fixed time step: the mass is measured once."""
    first = lambda body: vars(body).setdefault("first_mass", body.mass)
    _then(patch, Body, "update_state", lambda body: setattr(body, "mass", first(body)))


def mass_without_pressure(patch):
    """The mass forgets the stiffness of the pressure."""
    _mass_by(patch, lambda mu, kappa: (mu, 0.02 * kappa))


def no_filter(patch):
    patch.setattr("morphofold.sim.body.FILTER_STRENGTH", {4: 0.0, 3: 0.0})


def no_waiting(patch):
    """Growth never slows down, nor stands still at a stage."""
    patch.setattr(Dynamics, "_pace", lambda self: 1.0)
    patch.setattr(Dynamics, "settle", lambda self, after=None: False)


def no_contact(patch):
    patch.setattr(Contact, "add_forces", lambda self, body, x, v, extra: None)


def no_corner_barrier(patch):
    patch.setattr(CornerBarrier, "add_element_forces", lambda self, body, x, v: None)


def mass_of_the_core(patch):
    """The mass takes every element for core: modulus 1."""
    _mass_by(patch, lambda mu, kappa: (np.minimum(mu, 1), kappa / np.where(mu > 0, mu, 1)))


def _mass_by(patch, moduli):
    """The mass is measured with other moduli than the forces have."""
    measure = Bricks.measure

    def otherwise(self, x):
        before = self.modulus.copy()
        own = self.modulus[:, :LANES], self.modulus[:, LANES : 2 * LANES]
        for rows, other in zip(own, moduli(*(rows.copy() for rows in own))):
            rows[:] = other
        mass = measure(self, x)
        self.modulus[:] = before
        measure(self, x)
        return mass

    patch.setattr(Bricks, "measure", otherwise)


def mass_of_the_volume(patch):
    """The same mass in all, spread by volume: one density."""

    def lump(body):
        volume = body.nodal_volumes()
        body.mass = body.mass.sum() * volume / volume.sum()

    _then(patch, Body, "update_state", lump)


def isotropic_kernel(patch):
    """Tangential growth is isotropic in the kernel."""
    grow = brick_kernels.grow
    patch.setattr(brick_kernels, "grow", lambda *arguments: grow(*arguments[:-2], False, arguments[-1]))


def only_upwards(patch):
    """Growth below 1 is no growth."""
    grow_to = Dynamics.grow_to
    patch.setattr(Dynamics, "grow_to", lambda self, g, *after: grow_to(self, max(g, self.state.growth), *after))


def mass_times(patch, factor):
    """A mass too small for a step of one, or too large."""
    _then(patch, Body, "update_state", lambda body: setattr(body, "mass", factor * body.mass))


class BlindNumpy:
    """NumPy that finds all numbers finite and none that is wanted."""

    isfinite = staticmethod(lambda x: np.ones(np.shape(x), dtype=bool))
    flatnonzero = staticmethod(lambda where: np.empty(0, dtype=np.int64))

    def __getattr__(self, name):
        return getattr(np, name)


def no_checks(patch):
    """Nothing looks whether positions are finite and elements have volume."""
    step = CoarseLevels.step
    patch.setattr(CoarseLevels, "step", lambda self, *arguments: step(self, *arguments) and 0)
    patch.setattr(dynamics, "np", BlindNumpy())
    summary = Bricks.summary
    patch.setattr(Bricks, "summary", lambda self: summary(self)._replace(min_volume_ratio=1.0, max_J=1.0))


def no_images(patch):
    """The filter of a surface that symmetry planes cut ends at them."""
    begin = SurfaceFilter.__init__

    def cut(self, bilayer, X, strength, cell):
        begin(self, dataclasses.replace(bilayer, planes=()), X, strength, cell)

    patch.setattr(SurfaceFilter, "__init__", cut)


def softer_pressure(patch):
    """Forces are no gradient of the energy: their pressure is a twentieth less."""
    compute = Bricks.compute_forces

    def less(self, x, follow=0.0):
        kappa = self.modulus[:, LANES : 2 * LANES].copy()
        self.modulus[:, LANES : 2 * LANES] *= 0.95
        compute(self, x, follow)
        self.modulus[:, LANES : 2 * LANES] = kappa

    patch.setattr(Bricks, "compute_forces", less)


def lost_row(patch):
    """The sum of forces loses what one block adds to one node, as two threads at one sum would."""
    lose = lambda bricks: bricks.blocks.force[len(bricks.blocks.force) // 3].fill(0.0)
    _then(patch, Bricks, "compute_forces", lose)


def near_is_no_contact(patch):
    """What is near in the reference is never contact, across a gap or not."""
    _then(patch, Contact, "prepare", lambda contact: contact._N.fill(0.0))


def pressure_of_fifty(patch):
    """Every body has κ/μ = 50."""
    begin = Body.__init__
    patch.setattr(Body, "__init__", lambda self, *a, kappa_ratio, **k: begin(self, *a, kappa_ratio=50.0, **k))


# what the tests of one guard have in common, and what peers do


def _unstable_without(guard, without) -> dict[str, Any]:
    return {"guard": guard, "without": without, "fails": dynamics.UnstableError}


PRESSURE = _unstable_without("the mass knows the pressure's stiffness", mass_without_pressure)
FIRST_STEP = _unstable_without("the mass is measured anew every 12 steps", mass_of_the_first_step)
DENSITY = _unstable_without("the mass is of the stiffness, not of the volume", mass_of_the_volume)
LUMPED_MASS = "Tallinen: lumped mass ρV, one step from the mesh spacing (read)"
FIXED_STEP = "BrainGrowth: a fixed step ends a run at t = 0.62 (measured)"
