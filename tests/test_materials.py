import numpy as np
import pytest
from made_bodies import block
from scipy.optimize import brentq

from morphofold.errors import DoesNotApply, OutOfRange, UnknownName
from morphofold.sim.build import build_body
from morphofold.sim.dynamics import Dynamics
from morphofold.sim.equilibrium import statics
from morphofold.sim.materials.elastic import cofactor, energy, stress
from morphofold.sim.materials.mooney_rivlin import MooneyRivlin
from morphofold.sim.materials.neo_hookean import NeoHookean
from morphofold.sim.scene.effect_registry import material_names
from morphofold.sim.scene.scene_files import load_scene, to_toml
from morphofold.studies.accuracy.reference_elements import brick_energy, brick_stress

MU, KAPPA = 1.7, 40.0
EACH = pytest.mark.parametrize("material", [NeoHookean(), MooneyRivlin(0.4)], ids=str)


def near_identity(rng, *shape):
    return np.eye(3) + 0.2 * rng.standard_normal((*shape, 3, 3))


def taylor_order(W, slope, h):
    """Order at which the energy leaves its tangent."""
    rest = [np.abs(W(s) - W(0.0) - s * slope).max() for s in h]
    return np.polyfit(np.log(h), np.log(rest), 1)[0]


@EACH
def test_stress_is_the_derivative_of_the_energy(material, rng):
    A, dA = near_identity(rng, 5), rng.standard_normal((5, 3, 3))
    slope = np.sum(stress(A, MU, KAPPA, material) * dA, axis=(1, 2))
    order = taylor_order(lambda s: energy(A + s * dA, MU, KAPPA, material), slope, 2.0 ** -np.arange(6, 13))
    assert order == pytest.approx(2.0, abs=0.05)


@EACH
def test_brick_stress_is_the_derivative_of_the_brick_energy(material, rng):
    A, dA, w = near_identity(rng, 4, 8), rng.standard_normal((4, 8, 3, 3)), rng.uniform(0.5, 1.0, (4, 8))
    mu, kappa = np.full(4, MU), np.full(4, KAPPA)
    slope = np.einsum("eq,eqij,eqij->e", w, brick_stress(A, w, mu, kappa, material), dA)
    order = taylor_order(lambda s: brick_energy(A + s * dA, w, mu, kappa, material), slope, 2.0 ** -np.arange(7, 13))
    assert order == pytest.approx(2.0, abs=0.05)


@EACH
def test_energy_does_not_see_rotations(material, rng):
    A = near_identity(rng, 5)
    R = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    R *= np.sign(np.linalg.det(R))
    np.testing.assert_allclose(energy(R @ A, MU, KAPPA, material), energy(A, MU, KAPPA, material), rtol=1e-12)
    rotated = R @ stress(A, MU, KAPPA, material)
    np.testing.assert_allclose(stress(R @ A, MU, KAPPA, material), rotated, rtol=1e-10, atol=1e-10)


def test_volume_preserving_stretch_has_the_energy_of_equation_4():
    stretch = np.array([1.3, 0.9, 1 / (1.3 * 0.9)])
    assert energy(np.diag(stretch), MU, KAPPA) == pytest.approx(MU / 2 * (np.sum(stretch**2) - 3), rel=1e-12)


@EACH
def test_small_strain_moduli_are_mu_and_kappa(material):
    e = 1e-5
    shear = np.eye(3)
    shear[0, 1] = e
    assert stress(shear, MU, KAPPA, material)[0, 1] == pytest.approx(MU * e, rel=1e-4)
    assert stress(np.eye(3) * (1 + e), MU, KAPPA, material)[0, 0] == pytest.approx(3 * KAPPA * e, rel=1e-3)


@EACH
def test_a_crushed_element_still_gives_finite_forces(material):
    A = np.diag([1.0, 1.0, 0.0])
    assert np.isfinite(energy(A, MU, KAPPA, material))
    assert np.isfinite(stress(A, MU, KAPPA, material)).all()
    assert stress(A, MU, KAPPA, material)[2, 2] < 0  # it pushes back open


def test_cofactor_is_det_times_inverse_transpose(rng):
    A = near_identity(rng, 6)
    want = np.linalg.det(A)[:, None, None] * np.linalg.inv(A).swapaxes(1, 2)
    np.testing.assert_allclose(cofactor(A), want, atol=1e-12)


def test_mooney_rivlin_without_a_second_share_is_neo_hookean(rng):
    A = near_identity(rng, 6)
    np.testing.assert_allclose(energy(A, MU, KAPPA, MooneyRivlin(0.0)), energy(A, MU, KAPPA), rtol=1e-14)


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("stretch", [0.6, 1.7])
def test_pulling_takes_the_force_of_mooneys_formula(share, stretch):
    """Uniaxial, incompressible: 2 (l - l^-2) (C1 + C2 / l), with mu = 2 (C1 + C2)."""
    A = np.diag([stretch, stretch**-0.5, stretch**-0.5])
    P = stress(A, MU, 0.0, MooneyRivlin(share))
    pulled = P[0, 0] - P[1, 1] * A[1, 1] / A[0, 0]  # the pressure that leaves the sides free
    c1, c2 = MU / 2 * (1 - share), MU / 2 * share
    assert pulled == pytest.approx(2 * (stretch - stretch**-2) * (c1 + c2 / stretch), rel=1e-12)


@pytest.mark.parametrize("kind", ["bricks", "tetrahedra"])
@pytest.mark.parametrize("material", [NeoHookean(), pytest.param(MooneyRivlin(0.4), marks=pytest.mark.slow)], ids=str)
def test_a_held_block_grows_as_high_as_its_energy_says(kind, material):
    """Between symmetry planes all of it is stretched alike, and its top is free: no stress along its height. By
    Newton's method, and by the dynamics."""
    g, kappa, depth = 1.15, 50.0, 6.0
    body = block((2.0, 2.0), depth, 1.0, kind=kind, kappa_ratio=kappa, material=material)
    body.core_share = 1.0
    height = brentq(lambda l: stress(np.diag([1 / g, 1 / g, l / g]), 1.0, kappa, material)[2, 2], 1.0, 3.0)
    top = slice(0, body.n_surface)
    sunk = statics.equilibrium(body, g)[top, 2] - body.X[top, 2]
    np.testing.assert_allclose(sunk, depth * (height - 1), rtol=1e-6)
    body.grow(1.0)
    run = Dynamics(body, steps_per_unit=3000)
    run.grow_to(g)
    run.relax(6000)
    np.testing.assert_allclose(run.state.x[top, 2] - body.X[top, 2], depth * (height - 1), rtol=1e-3)


@pytest.mark.slow
def test_a_scene_names_its_material_and_theory_is_told_of_none_but_its_own():
    assert material_names() == ("neo-hookean", "mooney-rivlin")
    usual = load_scene("demo", ['material.model="neo-hookean"'])
    assert to_toml(usual) == to_toml(load_scene("demo"))  # folders of before are still its own
    assert usual.beyond_theory == ""
    other = load_scene("demo", ["material.model=mooney-rivlin", "material.second_share=0.5"])
    assert other.beyond_theory
    assert load_scene(other) == other
    body = build_body(load_scene(other, ["geometry.portion=octant", "accuracy.edge=9.82"]))
    assert body.elements.material == MooneyRivlin(0.5)


@pytest.mark.parametrize(
    ("settings", "kind", "named"),
    [
        (["material.model=rubber"], UnknownName, r"material\.model: .*neo-hookean, mooney-rivlin\b.*'rubber'"),
        (["material.second_share=0.5"], UnknownName, r"\bmaterial\.second_share: "),
        (["material.model=mooney-rivlin", "material.second_share=1.5"], OutOfRange, r"second_share: .*\b1\.5\b"),
        (["material.model=mooney-rivlin", "material.second=0.5"], UnknownName, r"\bsecond: .*\bsecond_share\b"),
        (["material.mu_ratio=0"], OutOfRange, r"material\.mu_ratio: .*\b0\.0001\b"),
    ],
)
def test_what_a_material_is_not_is_refused(settings, kind, named):
    with pytest.raises(kind, match=named):
        load_scene("demo", settings)


def test_a_radial_scene_is_neo_hookean():
    with pytest.raises(DoesNotApply, match=r"\bmaterial\.model\b.*'radial'"):
        load_scene("radial", ["material.model=mooney-rivlin"])
