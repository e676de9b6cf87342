"""The stiffness matrix of a body: the derivative of the forces that the kernels give, for both elements."""

import numpy as np
import pytest
from made_bodies import body_of, sphere
from scipy import sparse

from morphofold.sim.equilibrium.sparse_factor import Dissection, Factor
from morphofold.sim.equilibrium.tangent import Tangent, cauchy_stress, stress_of_elements
from morphofold.sim.materials.mooney_rivlin import MooneyRivlin
from morphofold.sim.materials.neo_hookean import NEO_HOOKEAN
from morphofold.sim.mesh.brick_mesh import bilayer_patch

KINDS = ("bricks", "tetrahedra")


def make_body(kind="bricks", law="isotropic", portion="octant", n=4, material=NEO_HOOKEAN):
    return sphere(n, kind, 6, portion, mu_cortex=2.0, law=law, material=material)


def all_forces(body, x):
    forces = body.forces(x)
    forces[: body.n_surface] += body.filter.forces(x)
    return forces


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("law", ["isotropic", "tangential"])
@pytest.mark.parametrize(
    ("amount", "material"),
    [(0.1, NEO_HOOKEAN), (0.8, NEO_HOOKEAN), pytest.param(0.8, MooneyRivlin(0.4), marks=pytest.mark.slow)],
)
def test_the_tangent_is_the_derivative_of_the_forces(kind, law, amount, material, rng):
    body = make_body(kind, law, material=material)
    body.pattern = rng.uniform(0.5, 1.0, body.elements.n_cortex)
    body.grow(1.4)
    x, d = body.X + amount * rng.standard_normal(body.X.shape), rng.standard_normal(body.X.shape)
    K, h = Tangent(body).at(x), 1e-5
    want = (all_forces(body, x - h * d) - all_forces(body, x + h * d)) / (2 * h)
    assert np.abs((K @ d.ravel()).reshape(-1, 3) - want).max() < 1e-6 * np.abs(want).max()
    assert abs(K - K.T).max() < 1e-13 * abs(K).max()


@pytest.mark.parametrize("material", [NEO_HOOKEAN, pytest.param(MooneyRivlin(0.4), marks=pytest.mark.slow)])
@pytest.mark.parametrize("kind", KINDS)
def test_the_tangent_holds_where_elements_are_crushed(kind, material, rng):
    body = make_body(kind, material=material)
    x, d = body.X + 3.0 * rng.standard_normal(body.X.shape), rng.standard_normal(body.X.shape)
    body.update_state(x)
    assert body.elements.state()["J_min"].min() < 0.01
    K, h = Tangent(body).at(x), 1e-7
    want = (all_forces(body, x - h * d) - all_forces(body, x + h * d)) / (2 * h)
    assert np.abs((K @ d.ravel()).reshape(-1, 3) - want).max() < 1e-5 * np.abs(want).max()


@pytest.mark.parametrize("kind", KINDS)
def test_moving_and_turning_a_body_at_rest_costs_nothing_and_all_else_does(kind):
    body = make_body(kind, portion="full")
    K = Tangent(body).at(body.X)
    eye = np.eye(3)
    rigid = [np.tile(e, (len(body.X), 1)).ravel() for e in eye] + [np.cross(e, body.X).ravel() for e in eye]
    scale = abs(K).max()
    assert max(np.abs(K @ u).max() / np.abs(u).max() for u in rigid) < 1e-12 * scale
    for small, count in ((1e-9, 6), (-1e-9, 0), (1e-5, 6)):  # nothing else is as soft
        shifted = sparse.csr_matrix(K - small * scale * sparse.identity(K.shape[0]))
        nodes = sparse.csr_matrix((np.ones(K.nnz), (K.tocoo().row // 3, K.tocoo().col // 3)))
        assert Factor(Dissection(body.X, nodes, np.arange(K.shape[0]), shifted), shifted).negative == count


@pytest.mark.parametrize("kind", KINDS)
def test_entries_of_the_pattern_stay_whatever_their_values(kind, rng):
    body = make_body(kind)
    tangent = Tangent(body)
    rest = tangent.at(body.X)
    body.grow(1.2)
    strained = tangent.at(body.X + 0.1 * rng.standard_normal(body.X.shape))
    np.testing.assert_array_equal(rest.indices, strained.indices)
    np.testing.assert_array_equal(rest.indptr, strained.indptr)


@pytest.mark.parametrize("share", [0.0, pytest.param(0.4, marks=pytest.mark.slow)])
@pytest.mark.parametrize("kind", KINDS)
def test_cauchy_stress_of_a_uniform_deformation_is_the_closed_form(kind, share, rng):
    body = make_body(kind, material=MooneyRivlin(share) if share else NEO_HOOKEAN)
    F = np.eye(3) + 0.1 * rng.standard_normal((3, 3))
    body.grow(1.1)
    sigma = cauchy_stress(body, body.X @ F.T)
    cortex = body.bilayer.mesh.subdomains["cortex"]
    for name, g, mu in (("cortex", 1.1, 2.0), ("core", 1.0, 1.0)):
        A = F / g
        J, B = np.linalg.det(A), A @ A.T
        deviator = lambda T: T - np.trace(T) / 3 * np.eye(3)
        I1 = np.trace(B)
        want = mu * (1 - share) * J ** (-5 / 3) * deviator(B) + 50 * mu * (J - 1) * np.eye(3)
        want += mu * share * J ** (-7 / 3) * deviator(I1 * B - B @ B)
        first = body.elements.patches[:, 0] if kind == "tetrahedra" else np.arange(len(sigma))
        of_layer = sigma[np.isin(first, cortex) == (name == "cortex")]
        np.testing.assert_allclose(of_layer, np.broadcast_to(want, of_layer.shape), atol=1e-11 * np.abs(want).max())
        each = stress_of_elements(body, body.X @ F.T)[np.isin(np.arange(body.elements.n), cortex) == (name == "cortex")]
        want = want[[0, 1, 2, 0, 1, 0], [0, 1, 2, 1, 2, 2]]
        np.testing.assert_allclose(each, np.broadcast_to(want, each.shape), atol=1e-11 * np.abs(want).max())


def test_cauchy_stress_is_the_virial_of_the_nodal_forces(rng):
    bilayer = bilayer_patch((4.0, 3.0), 5.0, 1.0, 1.0)
    body = body_of(bilayer, mu_cortex=2.0, law="tangential")
    body.grow(1.3)
    x = body.X + 0.05 * rng.standard_normal(body.X.shape)
    sigma = cauchy_stress(body, x)
    body.update_state(x)
    V = 1.3**2 * body.elements.volume
    V[body.elements.n_cortex :] = body.elements.volume[body.elements.n_cortex :]
    v = V * body.elements.state()["volume_ratio"]
    virial = -np.einsum("ni,nj->ij", body.forces(x) + body.rest, x)
    np.testing.assert_allclose(np.einsum("e,eij->ij", v, sigma), virial, atol=1e-10 * np.abs(virial).max())
