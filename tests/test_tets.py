import re

import numba
import numpy as np
import pytest
from scipy.spatial import Delaunay
from skfem import Basis, ElementTetP1, ElementVector, LinearForm, MeshTet

from morphofold.errors import BadMesh, OutOfRange, UnknownName
from morphofold.sim.body import LARGEST_MASS, Body
from morphofold.sim.dynamics import Dynamics
from morphofold.sim.elements import tet_kernels
from morphofold.sim.elements.tet_grouping import cluster
from morphofold.sim.elements.tets import Tets
from morphofold.sim.materials import elastic
from morphofold.sim.materials.mooney_rivlin import MooneyRivlin
from morphofold.sim.materials.neo_hookean import NEO_HOOKEAN
from morphofold.sim.mesh.brick_mesh import bilayer_sphere
from morphofold.studies.accuracy import reference_elements
from morphofold.studies.accuracy.radial_finite_elements import radial_equilibrium
from morphofold.studies.accuracy.reference_elements import growth_tensor
from morphofold.studies.speed.solver_speed import cut_bricks

LAWS = ("isotropic", "tangential")
MOONEY_RIVLIN = pytest.param(0.9, MooneyRivlin(0.4), marks=pytest.mark.slow)


def scattered(rng, n=5):
    """Delaunay tetrahedra of points strewn in a unit cube, its corners in random order: no structure at all."""
    lattice = np.stack(np.meshgrid(*[np.linspace(0, 1, n + 1)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    inside = (lattice > 0) & (lattice < 1)
    centres = lattice[(lattice < 1).all(axis=1)] + 0.5 / n
    points = np.concatenate(
        [
            lattice + 0.25 / n * rng.uniform(-1, 1, lattice.shape) * inside,
            centres + 0.2 / n * rng.uniform(-1, 1, centres.shape),
        ]
    )
    tets = Delaunay(points).simplices
    volume = np.abs(np.linalg.det(points[tets[:, 1:]] - points[tets[:, :1]])) / 6
    tets = rng.permuted(tets[volume > 1e-3 / n**3], axis=1)
    used, tets = np.unique(tets, return_inverse=True)
    return MeshTet(points[used].T.copy(), np.ascontiguousarray(tets.reshape(-1, 4).T))


def make_tets(kind, rng, law="isotropic", kappa=50.0, n=6, material=NEO_HOOKEAN):
    """Tetrahedra with a cortex of twice the core's modulus."""
    if kind == "cut bricks":
        bilayer = cut_bricks(bilayer_sphere(50, 3, 25, "octant", n))
        mesh, radial = bilayer.mesh, bilayer.radial
        cortex = np.arange(mesh.nelements) < len(mesh.subdomains["cortex"])
    else:
        mesh = scattered(rng, n)
        radial = np.tile([0.0, 0.6, 0.8], (mesh.nvertices, 1)) + 0.2 * rng.standard_normal((mesh.nvertices, 3))
        cortex = mesh.p[2, mesh.t].mean(axis=0) > 0.6
    tets = Tets(
        mesh,
        np.ascontiguousarray(mesh.p.T),
        radial,
        cortex,
        np.where(cortex, 2.0, 1.0),
        np.full(mesh.nelements, kappa),
        law,
        material,
    )
    tets.mesh, tets.X, tets.radial, tets.cortex = mesh, np.ascontiguousarray(mesh.p.T), radial, cortex
    return tets


def forces(tets, x):
    tets.compute_forces(x)
    return tets.blocks.nodal_forces()


def energy(tets, x):
    tets.measure(x)
    return tets.state()["energy"].sum()


def shaken(tets, rng, amount):
    """Positions deformed at random, in shares of a short edge."""
    a, b = tets.mesh.edges
    edge = np.quantile(np.linalg.norm(tets.X[a] - tets.X[b], axis=1), 0.02)
    return tets.X + amount * edge * rng.standard_normal(tets.X.shape)


class Twin:
    """The same forms on scikit-fem's basis: patches and moduli are those of the tetrahedra, all else is its own."""

    def __init__(self, tets, stretch, core):
        self.tets = tets
        self.basis = Basis(tets.mesh, ElementVector(ElementTetP1()), intorder=0)
        g = np.full(tets.n, core)
        g[tets.cortex] = stretch
        normal = tets.radial[tets.mesh.t].mean(axis=0)
        G = growth_tensor(g, normal / np.linalg.norm(normal, axis=1, keepdims=True), tets.law)
        G[~tets.cortex] = core * np.eye(3)
        self.G_inverse, self.det_G = np.linalg.inv(G), np.linalg.det(G)
        self.w = self.basis.dx[:, 0] * self.det_G

    def elastic(self, x):
        """A (E, 3, 3)."""
        u = np.zeros(self.basis.N)
        u[self.basis.nodal_dofs] = (x - self.tets.X).T
        return (np.eye(3) + np.moveaxis(self.basis.interpolate(u).grad[..., 0], -1, 0)) @ self.G_inverse

    def on_patches(self, x):
        patches = self.tets.patches
        mu, kappa = (np.where(self.tets.cortex, 2.0, 1.0), np.full(self.tets.n, 50.0))
        w = np.where(patches >= 0, self.w[patches], 0.0)
        return self.elastic(x)[patches], w, mu[patches[:, 0]], kappa[patches[:, 0]]

    def forces(self, x):
        S = np.empty((self.tets.n, 3, 3))
        filled = self.tets.patches >= 0
        S[self.tets.patches[filled]] = reference_elements.patch_stress(*self.on_patches(x), self.tets.material)[filled]
        return self.forces_of(self.det_G[:, None, None] * S @ np.swapaxes(self.G_inverse, -1, -2))

    def forces_of(self, P):
        """Nodal forces of the first Piola-Kirchhoff stress P (E, 3, 3) per reference volume."""
        form = LinearForm(lambda v, w: np.einsum("ij...,ij...", w["P"], v.grad))
        return -form.assemble(self.basis, P=np.moveaxis(P, 0, -1)[..., None])[self.basis.nodal_dofs].T


# the energy, and the forces as its gradient


@pytest.mark.parametrize("kind", ["cut bricks", "scattered"])
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize(("core", "material"), [(0.9, NEO_HOOKEAN), MOONEY_RIVLIN])
def test_kernel_forces_equal_scikit_fems_assembly(kind, law, core, material, rng):
    tets = make_tets(kind, rng, law, material=material)
    stretch = rng.uniform(0.9, 1.5, tets.n_cortex)
    tets.grow(stretch, core)
    twin = Twin(tets, stretch, core)
    for amount in (0.01, 0.1, 0.4):
        x = shaken(tets, rng, amount)
        want = twin.forces(x)
        assert np.abs(forces(tets, x) - want).max() <= 1e-10 * np.abs(want).max()
        tets.measure(x)
        state, J = tets.state(), np.linalg.det(twin.elastic(x))
        np.testing.assert_allclose(state["J_min"], J, rtol=1e-10, atol=1e-12)
        assert np.array_equal(state["J_min"], state["J_max"])
        for patch, E in zip(tets.patches, reference_elements.patch_energy(*twin.on_patches(x), material)):
            members = patch[patch >= 0]
            assert state["energy"][members].sum() == pytest.approx(E, rel=1e-10, abs=1e-12)
            assert state["volume_ratio"][members] == pytest.approx(
                (twin.w * J)[members].sum() / twin.w[members].sum(), rel=1e-9
            )
    assert J.min() < 0 < 2 < J.max()  # the last positions crush and burst some


@pytest.mark.parametrize(("core", "material"), [(1.0, NEO_HOOKEAN), MOONEY_RIVLIN])
def test_forces_are_minus_the_gradient_of_the_energy(core, material, rng):
    tets = make_tets("scattered", rng, "tangential", material=material)
    tets.grow(np.full(tets.n_cortex, 1.3), core)
    x = shaken(tets, rng, 0.1)
    d = rng.standard_normal(x.shape)
    slope = -np.sum(forces(tets, x) * d)
    h = 2.0 ** -np.arange(14, 20)
    rest = [abs(energy(tets, x + s * d) - energy(tets, x) - s * slope) for s in h]
    assert np.polyfit(np.log(h), np.log(rest), 1)[0] == pytest.approx(2.0, abs=0.1)


def test_patch_stress_is_the_derivative_of_the_patch_energy(rng):
    A = np.eye(3) + 0.3 * rng.standard_normal((4, 6, 3, 3))
    dA, w = rng.standard_normal(A.shape), rng.uniform(0.5, 1.0, (4, 6)) * (rng.random((4, 6)) < 0.8)
    A[0, 0] @= np.diag([1.0, 1.0, -0.1 / np.linalg.det(A[0, 0])])  # one of them is inside out
    mu, kappa, h = np.full(4, 1.7), np.full(4, 40.0), 1e-5
    W = lambda s: reference_elements.patch_energy(A + s * dA, w, mu, kappa)
    slope = np.einsum("pt,ptij,ptij->p", w, reference_elements.patch_stress(A, w, mu, kappa), dA)
    np.testing.assert_allclose((W(h) - W(-h)) / (2 * h), slope, rtol=1e-6)


def test_uniform_deformation_gives_the_stress_of_the_material_everywhere(rng):
    """The patch test: with one A everywhere, patches and blend make no difference."""
    tets = make_tets("scattered", rng)
    twin = Twin(tets, 1.0, 1.0)
    F = np.eye(3) + 0.2 * rng.standard_normal((3, 3))
    P = elastic.stress(np.tile(F, (tets.n, 1, 1)), np.where(tets.cortex, 2.0, 1.0), 50.0)
    want = twin.forces_of(P)
    assert np.abs(forces(tets, tets.X @ F.T) - want).max() < 1e-12 * np.abs(want).max() * tets.n
    same = make_tets("scattered", rng)
    inside = (np.abs(same.X - 0.5) < 0.5).all(axis=1) & (np.abs(same.X[:, 2] - 0.6) > 0.3)
    f = forces(same, same.X @ F.T)
    assert inside.sum() > 20
    assert np.abs(f[inside]).max() < 1e-12 * np.abs(f).max() * tets.n


def test_free_tangential_growth_of_a_flat_layer_is_stress_free(rng):
    mesh = scattered(rng)
    X, all_ = np.ascontiguousarray(mesh.p.T), np.ones(mesh.nelements)
    tets = Tets(mesh, X, np.tile([0.0, 0.0, 1.0], (len(X), 1)), all_ > 0, all_, 50 * all_, "tangential")
    tets.grow(1.4 * all_)
    assert np.abs(forces(tets, X * [1.4, 1.4, 1.0])).max() < 1e-10
    assert np.abs(forces(tets, X * 1.4)).max() > 1


def test_without_growth_forces_are_round_off_also_after_growing_and_shrinking(rng):
    tets = make_tets("cut bricks", rng, "tangential")
    at_rest = forces(tets, tets.X)
    assert np.abs(at_rest).max() < 1e-10
    tets.grow(np.full(tets.n_cortex, 1.7), 1.1)
    assert np.abs(forces(tets, tets.X)).max() > 1
    tets.grow(np.ones(tets.n_cortex))
    assert np.array_equal(forces(tets, tets.X), at_rest)


def test_a_tetrahedron_that_is_flattened_resists_ever_more_also_inside_out():
    squeeze = np.linspace(1.0, -1.0, 400)
    A = np.stack([np.diag([1.0, 1.0, s]) for s in squeeze])
    slope = elastic.isochoric_stress(A, 1.0)[:, 2, 2]
    assert (np.diff(elastic.isochoric_energy(A, 1.0)) > 0).all()
    assert (slope < 1e-12).all()
    J = tet_kernels.CRUSHED_BELOW_J
    below, above = (elastic.isochoric_stress(np.diag([1.0, 1.0, J + d]), 1.0) for d in (-1e-9, 1e-9))
    np.testing.assert_allclose(below, above, rtol=1e-6)  # no step where the tangent takes over


def test_inverse_cube_root_is_exact_over_its_range():
    J = np.geomspace(0.02, 50, 500)
    y = np.array([tet_kernels._inverse_cube_root(v) for v in J])
    np.testing.assert_allclose(y, J ** (-1 / 3), rtol=1e-12)


# the element in use


def exact_energy(g, law):
    """Energy of the whole grown sphere in its radial equilibrium, T = 3, C = 50, A = 25, kappa/mu = 50 [mu mm^3]."""
    state = radial_equilibrium(g, 3 / 50, 1.0, law, 50.0, A_over_C=0.5)
    R, w = np.polynomial.legendre.leggauss(30)
    total = 0.0
    for layer, low, high in (("core", 25.0, 47.0), ("cortex", 47.0, 50.0)):
        at = state.at((low + high) / 100 + (high - low) / 100 * R, layer)
        radial, tangential = {"core": (1, 1), "cortex": (g if law == "isotropic" else 1, g)}[layer]
        beta = at.r / (at.R * tangential)
        A = np.stack([np.diag(a) for a in np.column_stack([at.J / beta**2, beta, beta])])
        W = elastic.energy(A, 1.0, 50.0) * radial * tangential**2
        total += (high - low) / 2 * w @ (4 * np.pi * (50 * at.R) ** 2 * W)
    return total


@pytest.mark.parametrize(("law", "g"), [("isotropic", 1.2), ("tangential", 1.25)])
def test_energy_of_a_grown_sphere_before_it_folds_nears_that_of_the_radial_equilibrium_at_second_order(law, g):
    error = []
    for n in (8, 12):
        bilayer = cut_bricks(bilayer_sphere(50, 3, 25, "octant", n))
        body = Body(bilayer, mu_cortex=1.0, mu_core=1.0, kappa_ratio=50.0, law=law)
        run = Dynamics(body, steps_per_unit=1000)
        run.grow_to(g)
        run.relax(800)
        error.append(abs(8 * run.state.record["strain_energy"] / exact_energy(g, law) - 1))
    assert error[1] < 7e-3
    assert np.log(error[0] / error[1]) / np.log(12 / 8) == pytest.approx(2.0, abs=0.2)


@pytest.mark.parametrize(
    ("kind", "kappa"),
    [("scattered", 50.0), *(pytest.param("cut bricks", kappa, marks=pytest.mark.slow) for kappa in (5.0, 500.0))],
)
def test_measured_stiffness_keeps_the_unit_step_stable(kind, kappa, rng):
    # a step of one is stable while the largest eigenvalue of M^-1 K is below 4: power iteration on the forces
    tets = make_tets(kind, rng, kappa=kappa)
    tets.grow(np.full(tets.n_cortex, 1.3))
    stretches = (1.05, [0.4, 0.8, 1.5], [0.5, 1.5, 1.4])
    for x in (*(tets.X * s for s in stretches), shaken(tets, rng, 0.05), shaken(tets, rng, 0.2)):
        mass = 0.25 * LARGEST_MASS * tets.measure(x)[:, None]
        v, value = rng.standard_normal(x.shape), 0.0
        for _ in range(80):
            v /= np.sqrt(np.sum(mass * v**2))
            h = 1e-6 * np.cbrt(tets.volume.min()) / np.abs(v).max()
            Kv = -(forces(tets, x + h * v) - forces(tets, x - h * v)) / (2 * h)
            value = np.sum(v * Kv)
            v = Kv / mass
        assert 4 / LARGEST_MASS / 4 < value < 4 / LARGEST_MASS, "the step is unstable, or the mass wastefully large"


@pytest.mark.skipif(numba.get_num_threads() < 2, reason="needs two threads")
def test_forces_and_stiffness_are_bitwise_equal_for_one_and_two_threads(rng):
    tets = make_tets("scattered", rng)
    x = shaken(tets, rng, 0.1)
    results = []
    for threads in (1, 2):
        numba.set_num_threads(threads)
        tets.grow(np.full(tets.n_cortex, 1.3))
        results.append((forces(tets, x), tets.measure(x), tets.state()["energy"]))
    for first, second in zip(*results):
        assert np.array_equal(first, second)


# patches


def test_patches_of_cut_bricks_are_the_bricks():
    for n in (6, 14):
        mesh = cut_bricks(bilayer_sphere(50, 3, 25, "half", n)).mesh
        patches = cluster(mesh, mesh.p.T, np.zeros(mesh.nelements, dtype=int))
        assert np.array_equal(np.sort(patches.ravel()), np.arange(mesh.nelements))
        assert (patches // 6 == patches[:, :1] // 6).all()


def test_patches_are_connected_of_one_material_and_rarely_small(rng):
    mesh = scattered(rng, 8)
    layer = (mesh.p[2, mesh.t].mean(axis=0) > 0.6).astype(int)
    patches = cluster(mesh, np.ascontiguousarray(mesh.p.T), layer)
    filled = patches >= 0
    assert np.array_equal(np.sort(patches[filled]), np.arange(mesh.nelements))
    assert filled.mean() > 0.88
    assert (filled.sum(axis=1) <= 2).mean() < 0.05
    for patch in patches:
        members = patch[patch >= 0]
        assert len(np.unique(layer[members])) == 1
        assert len(np.unique(mesh.t[:, members])) <= 8
        reached, faces = {members[0]}, mesh.t2f[:, members]
        for _ in members:
            reached |= {m for m, f in zip(members, faces.T) if np.isin(f, mesh.t2f[:, list(reached)]).any()}
        assert len(reached) == len(members)


def test_six_tetrahedra_that_fan_out_from_an_edge_of_the_surface_have_too_many_nodes_for_a_patch():
    angle = np.linspace(0, np.pi, 7)
    points = np.concatenate([[[0, 0, 0], [0, 0, 3]], np.column_stack([np.cos(angle), np.sin(angle), 1.5 + 0 * angle])])
    mesh = MeshTet(points.T.copy(), np.array([[0, 1, 2 + k, 3 + k] for k in range(6)]).T.copy())
    patches = cluster(mesh, points, np.zeros(6, dtype=int))
    assert sorted((patches >= 0).sum(axis=1)) == [1, 5]


def test_patches_do_not_depend_on_how_corners_are_ordered(rng):
    mesh = scattered(rng)
    other = MeshTet(mesh.p, np.ascontiguousarray(rng.permuted(mesh.t, axis=0)))
    both = [cluster(m, mesh.p.T, np.zeros(m.nelements, dtype=int)) for m in (mesh, other)]
    assert np.array_equal(*both)


def test_corners_of_tetrahedra_are_found_among_the_nodes_of_their_patch(rng):
    tets = make_tets("scattered", rng)
    count, b = len(tets.patches), tets.blocks
    nodes = b.from_lanes(b.nodes[b.start[:-1, None] + b.local])
    corner = b.from_lanes(tets.corner)
    got = np.take_along_axis(nodes, corner.astype(int), axis=1).reshape(count, 6, 4)
    want = tets.mesh.t.T[np.where(tets.patches >= 0, tets.patches, tets.patches[:, :1])]
    assert (tets.patches < 0).any()
    np.testing.assert_array_equal(np.sort(got, axis=-1), np.sort(want, axis=-1))


# refusals


def test_tetrahedra_that_are_flat_or_inside_out_are_refused_with_numbers(rng):
    mesh = scattered(rng)
    X, all_ = np.ascontiguousarray(mesh.p.T), np.ones(mesh.nelements)
    build = lambda X: Tets(mesh, X, X, all_ > 0, all_, all_, "isotropic")
    bad = X.copy()
    bad[mesh.t[0, 7]] = 2 * X[mesh.t[1:, 7]].mean(axis=0) - X[mesh.t[0, 7]]
    with pytest.raises(BadMesh, match=rf"^\d+ of {mesh.nelements:,} .* -\d"):
        build(bad)
    bad[mesh.t[0, 7]] = X[mesh.t[1:, 7]].mean(axis=0)
    with pytest.raises(BadMesh, match=rf"^\d+ of {mesh.nelements:,} "):
        build(bad)


@pytest.mark.parametrize("stretch", [0.0, np.inf])
def test_growth_that_is_no_stretch_is_refused(stretch, rng):
    tets = make_tets("scattered", rng, n=3)
    cortex = np.ones(tets.n_cortex)
    cortex[5] = stretch
    with pytest.raises(OutOfRange, match=re.escape(f" {stretch:g}")):
        tets.grow(cortex)
    with pytest.raises(UnknownName, match="'radial'"):
        make_tets("scattered", rng, law="radial", n=3)


def test_tangential_growth_without_a_thickness_direction_is_refused_where_the_cortex_is(rng):
    mesh = scattered(rng, 3)
    X, all_ = np.ascontiguousarray(mesh.p.T), np.ones(mesh.nelements)
    up = np.tile([0.0, 0.0, 1.0], (len(X), 1))
    cortex = X[mesh.t.T, 2].mean(axis=1) > 0.6
    up[X[:, 2] < 0.1] = np.nan  # the core has none, and needs none
    tets = Tets(mesh, X, up, cortex, all_, all_, "tangential")
    tets.grow(np.full(tets.n_cortex, 1.2), 1.1)
    assert np.isfinite(forces(tets, X)).all()
    up[mesh.t[:, np.flatnonzero(cortex)[2]]] = [[0, 0, 1], [0, 0, -1], [0, 1, 0], [0, -1, 0]]
    with pytest.raises(BadMesh, match=rf"\b\d+ of {cortex.sum():,} .*\[0\.0, 0\.0, 0\.0\]"):
        Tets(mesh, X, up, cortex, all_, all_, "tangential")


def test_two_triangles_of_the_surface_make_one_cell():
    """The cell size, by which contact and filter go, is that of the bricks that the tetrahedra were cut from."""
    bricks = bilayer_sphere(50, 3, 25, "octant", 8)
    h = [
        Body(bilayer, mu_cortex=1.0, mu_core=1.0, kappa_ratio=50.0, law="isotropic").cell
        for bilayer in (bricks, cut_bricks(bricks))
    ]
    assert h[1] == pytest.approx(h[0], rel=5e-3)
    assert h[0] == pytest.approx((4 * np.pi * 50**2 / (6 * 8**2)) ** 0.5, rel=0.01)
