import numba
import numpy as np
import pytest
from made_bodies import body_of, sphere

from morphofold.errors import ImpossibleBody
from morphofold.sim.dynamics import Dynamics
from morphofold.sim.effects.perturbation import Perturbation
from morphofold.sim.elements import brick_kernels
from morphofold.sim.elements.blocks import Columns
from morphofold.sim.materials.mooney_rivlin import MooneyRivlin
from morphofold.sim.materials.neo_hookean import NeoHookean
from morphofold.sim.mesh.brick_mesh import bilayer_sphere
from morphofold.studies.accuracy.assembly import Twin

MATERIALS = (NeoHookean(), pytest.param(MooneyRivlin(0.4), marks=pytest.mark.slow))


def make_body(law="isotropic", portion="octant", n=6, **options):
    return sphere(n, portion=portion, mu_cortex=2.0, law=law, **options)


def shaken(body, rng, amount=0.15):
    """Positions deformed at random, strongly enough for volume ratios of 0.5 to 2."""
    return body.X + amount * rng.standard_normal(body.X.shape)


@pytest.mark.parametrize("material", MATERIALS, ids=str)
@pytest.mark.parametrize("law", ["isotropic", "tangential"])
@pytest.mark.parametrize("g", [1.0, 1.4, 0.9])
def test_kernel_forces_equal_scikit_fems_assembly(law, g, material, rng):
    body = make_body(law, material=material)
    body.grow(g)
    twin = Twin(body)
    assert np.abs(body.rest).max() < 1e-9  # round-off, no more
    for amount in (0.01, 0.15):
        x = shaken(body, rng, amount)
        want = twin.forces(x)
        assert np.abs(body.forces(x) - want).max() <= 1e-10 * np.abs(want).max()
        body.update_state(x)
        np.testing.assert_allclose(body.elements.state()["energy"], twin.energy(x), rtol=1e-10, atol=1e-12)


def test_kernel_forces_of_a_perturbed_body_equal_scikit_fems_assembly(rng):
    bilayer = bilayer_sphere(50, 3, 25, "octant", 6)
    X = Perturbation(0.3, 31.4, seed=1).reshape(bilayer, bilayer.mesh.p.T)
    body = body_of(bilayer, mu_cortex=2.0, law="tangential", X=X)
    body.grow(1.3)
    x = shaken(body, rng)
    want = Twin(body).forces(x)
    assert np.abs(body.forces(x) - want).max() <= 1e-10 * np.abs(want).max()


def test_a_perturbation_that_turns_bricks_inside_out_is_refused():
    bilayer = bilayer_sphere(50, 3, 25, "octant", 12)
    X = Perturbation(4.5, 24.0, seed=0).reshape(bilayer, bilayer.mesh.p.T)
    counted = rf"\b\d+ of {bilayer.mesh.nelements:,} .*\beffects\.perturbation\.amplitude\b"
    with pytest.raises(ImpossibleBody, match=counted):
        body_of(bilayer, X=X)


@pytest.mark.parametrize("material", MATERIALS, ids=str)
def test_kernel_agrees_with_scikit_fem_where_bricks_are_crushed_and_frozen(material, rng):
    body = make_body(material=material)
    x = shaken(body, rng, 0.6)
    twin = Twin(body)
    J = np.linalg.det(twin.elastic(x))
    assert J.min() < 0.1 < 2 < J.max()  # both branches are taken
    want = twin.forces(x)
    assert np.abs(body.forces(x) - want).max() <= 1e-10 * np.abs(want).max()


@pytest.mark.parametrize("material", MATERIALS, ids=str)
def test_forces_are_minus_the_gradient_of_the_energy(material, rng):
    body = make_body("tangential", material=material)
    body.grow(1.3)
    x, d = shaken(body, rng), rng.standard_normal(body.X.shape)

    def energy(s):
        body.update_state(x + s * d)
        return body.elements.state()["energy"].sum()

    slope = -np.sum(body.forces(x) * d)
    h = 2.0 ** -np.arange(12, 18)
    rest = [abs(energy(s) - energy(0.0) - s * slope) for s in h]
    assert np.polyfit(np.log(h), np.log(rest), 1)[0] == pytest.approx(2.0, abs=0.1)


def test_rigid_motion_makes_no_force(rng):
    body = make_body()
    R = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    R *= np.sign(np.linalg.det(R))
    stiff = np.abs(body.forces(body.X * 1.01)).max()
    assert np.abs(body.forces(body.X @ R.T + [3.0, -2.0, 7.0])).max() < 1e-10 * stiff


def test_free_isotropic_growth_of_everything_is_stress_free():
    body = make_body()
    body.core_share, g = 1.0, 1.25
    body.grow(g)
    assert np.abs(body.forces(g * body.X)).max() < 1e-9


def test_a_body_that_does_not_grow_has_exactly_no_force():
    for portion in ("octant", "full"):
        body = make_body(portion=portion)
        assert np.array_equal(body.forces(body.X), np.zeros_like(body.X))
        assert np.array_equal(body.filter.forces(body.X), np.zeros((body.n_surface, 3)))


@pytest.mark.slow
@pytest.mark.parametrize(("law", "portion", "n"), [("isotropic", "octant", 6), ("tangential", "full", 36)])
def test_forces_in_single_precision_are_good_to_a_hundred_thousandth_of_the_largest(law, portion, n, rng):
    """On a whole sphere whose faces do not divide into blocks, too: some blocks then reach around it."""
    double, single = (make_body(law, portion, n=n, single=single) for single in (False, True))
    for body in (double, single):
        body.core_share = 0.1
        body.grow(1.3)
    x = shaken(double, rng)
    exact, rounded = double.forces(x), single.forces(x)
    assert 1e-8 < np.abs(rounded - exact).max() / np.abs(exact).max() < 1e-5  # nor is it 64 bits after all
    far = np.array([500.0, -300.0, 800.0])  # differences are taken in 64 bits
    assert np.abs(single.forces(x + far) - rounded).max() < 1e-5 * np.abs(exact).max()


@pytest.mark.slow
def test_a_body_of_single_precision_that_does_not_grow_stays_where_it_is():
    body = make_body(portion="full", single=True)
    run = Dynamics(body, [], steps_per_unit=1e4)
    run.relax(50)
    assert np.array_equal(run.state.x, body.X)


@pytest.mark.skipif(numba.get_num_threads() < 2, reason="needs two threads")
def test_forces_are_bitwise_equal_for_one_and_two_threads(rng):
    body = make_body(portion="half", n=12)
    body.grow(1.3)
    x = shaken(body, rng)
    results = []
    for threads in (1, 2):
        numba.set_num_threads(threads)
        body.update_state(x)
        results.append((body.forces(x), body.filter.forces(x).copy(), body.mass.copy()))
    for first, second in zip(*results):
        assert np.array_equal(first, second)


def test_inverse_cube_root_is_exact_over_its_range():
    J = np.geomspace(0.1, 8, 500)
    y = np.array([brick_kernels._inverse_cube_root(v) for v in J])
    np.testing.assert_allclose(y, J ** (-1 / 3), rtol=1e-12)


def test_measured_mass_keeps_the_unit_step_stable(rng):
    # a step of one is stable while the largest eigenvalue of M^-1 K is below 4: power iteration on the forces
    body = make_body(n=8)
    body.grow(1.3)
    for x in (1.05 * body.X, shaken(body, rng, 0.1)):
        body.update_state(x)
        v, value = rng.standard_normal(x.shape), 0.0
        for _ in range(60):
            v /= np.sqrt(np.sum(body.mass[:, None] * v**2))
            h = 1e-5 / np.abs(v).max()
            Kv = -(body.forces(x + h * v) - body.forces(x - h * v)) / (2 * h)
            Kv[: body.n_surface] -= (body.filter.forces(x + h * v) - body.filter.forces(x)) / h
            value = np.sum(v * Kv)
            v = Kv / body.mass[:, None]
        assert 1.0 < value < 2.8, "the step is unstable, or the mass wastefully large"


def test_the_surface_filter_is_calm_on_smooth_fields(rng):
    body = make_body(portion="half", n=16)
    factor = 0.05 * np.sin(body.X[:, :1] / 12)
    smooth, zigzag = body.X * (1 + factor), body.X * (1 + np.abs(factor).mean() * rng.choice([-1, 1], factor.shape))
    assert body.filter.energy(smooth) < 0.03 * body.filter.energy(zigzag)


def test_surface_filter_of_a_part_is_that_of_the_whole(rng):
    """Mirror images stand in beyond a symmetry plane: forces inside and on the plane are those of the closed sphere."""
    part, whole = make_body(portion="octant", n=8), make_body(portion="full", n=8)
    n = part.n_surface
    number = {tuple(p): i for i, p in enumerate(np.round(whole.X[: whole.n_surface], 9))}
    u = rng.standard_normal((n, 3)) * part.free[:n]
    both = np.zeros((whole.n_surface, 3))
    for signs in np.ndindex(2, 2, 2):
        sign = 1.0 - 2.0 * np.array(signs)
        for i in range(n):
            both[number[tuple(np.round(sign * part.X[i], 9) + 0.0)]] = sign * u[i]
    x, y = part.X.copy(), whole.X.copy()
    x[:n] += u
    y[: whole.n_surface] += both
    forces, expected = part.filter.forces(x), whole.filter.forces(y)
    inside = [number[tuple(np.round(p, 9) + 0.0)] for p in part.X[:n]]
    halved = 0.5 ** part.on_plane[:n].sum(axis=1, keepdims=True)  # a node on a plane belongs to both halves
    np.testing.assert_allclose(forces * part.free[:n], halved * expected[inside] * part.free[:n], atol=1e-9)
    assert part.filter.energy(x) == pytest.approx(whole.filter.energy(y) / 8)


def test_faces_whose_keys_agree_in_32_bits_stay_apart():
    """Scikit-fem numbers nodes in 32 bits, in which the products that tell faces apart overflow: a column was lost."""
    n = 2**17 + 1
    faces = [
        [[0, 1, 2, 2**15 + 5], [10, 11, 12, 13]],
        [[2**15, 3, 4, 5], [20, 21, 22, 23]],
    ]  # of two columns, downwards
    keys = np.array([face[0] * n + face[3] for face in (faces[0][0], faces[1][0])])
    assert keys[0] != keys[1]
    assert keys[0] % 2**32 == keys[1] % 2**32
    bricks = [(faces[0][0], faces[0][1]), ([30, 31, 32, 33], faces[1][0]), (faces[0][1], [40, 41, 42, 43]), faces[1]]
    corners = np.empty((4, 8), dtype=np.int32)
    for k, (upper, lower) in enumerate(bricks):
        corners[k, 1::2], corners[k, ::2] = upper, lower
    columns = Columns(corners, n)
    assert columns.layers == 2
    assert sorted(columns.nodes) == sorted(set(corners.ravel()))
