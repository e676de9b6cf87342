"""Errors of the solver as the study measures them, on bodies whose error is known beforehand."""

import numpy as np
import pytest

from morphofold.shapes import icosphere
from morphofold.sim import theory
from morphofold.sim.scene import LEVELS
from morphofold.studies.accuracy.assembly import SKFEM_METHOD, assembly_points
from morphofold.studies.accuracy.error_points import OUR_CODE
from morphofold.studies.accuracy.errors_from_theory import (
    INCOMPRESSIBLE,
    SMOOTH_GROWTH,
    radius_error,
    smooth_points,
    stress_error,
    theory_of,
    theory_points,
)
from morphofold.studies.accuracy.folds_by_mesh import (
    FINEST_MESH,
    LIMIT_AXES,
    NUMBER_NAMES,
    OWN_LIMIT,
    Folds,
    fold_points,
    pairs,
    simulated_folds,
)
from morphofold.studies.accuracy.solver_settings import FINEST_SETTING, NESTED, Setting, axes
from morphofold.surface import Surface

COARSE = Setting("mesh", "h = 2.4 T", 2.4, edge=2.4)


@pytest.fixture(scope="module")
def body():
    return COARSE.dynamics(with_folds=False).body


def smooth_positions(body):
    """Positions of the nodes in the smooth state, each moved along its radius."""
    exact, C = theory_of(50.0), 50.0
    R = np.linalg.norm(body.X, axis=1)
    r, in_core = np.empty_like(R), R <= 47.0 + 1e-9
    for layer, part, low, high in (("core", in_core, 0.5, 0.94), ("cortex", ~in_core, 0.94, 1.0)):
        r[part] = C * exact.at(np.clip(R[part] / C, low, high), layer).r
    return body.X * (r / R)[:, None]


def test_the_theory_of_the_study_is_that_of_the_paper():
    r = theory_of(np.inf).at(1.0, "cortex").r[0]
    assert r == pytest.approx(47 / 50 * float(theory.deformed_radius(SMOOTH_GROWTH, 50 / 47)), rel=1e-9)
    assert theory_of(50.0).at(1.0, "cortex").r[0] > r > 1  # the cortex pulls at a core that can give way


@pytest.mark.parametrize("fraction", [0.0, -0.3, 0.01])
def test_a_displacement_too_large_by_a_share_has_that_error(body, fraction):
    x = smooth_positions(body)
    assert radius_error(body, x + fraction * (x - body.X), theory_of(50.0)) == pytest.approx(abs(fraction), abs=1e-12)


def test_the_stress_of_the_right_displacement_is_nearly_right_and_that_of_another_growth_is_not(body):
    x = smooth_positions(body)
    body.grow(SMOOTH_GROWTH)
    assert stress_error(body, x, theory_of(50.0)) < 0.02  # of bricks a T long and half as wide
    body.grow(1.05)
    assert stress_error(body, x, theory_of(50.0)) > 0.5
    body.grow(1.0)


@pytest.mark.slow
def test_a_smooth_body_errs_less_on_a_finer_mesh():
    points = [smooth_points(Setting("mesh", f"{e}", e, edge=e)) for e in (2.4, 1.6)]
    coarse, fine = ({(p.quantity, p.against): p for p in each} for each in points)
    assert 0 < fine["radius", "theory"].error < 0.7 * coarse["radius", "theory"].error < 0.01
    assert fine["radius", "theory"].size > coarse["radius", "theory"].size
    assert fine["radius", INCOMPRESSIBLE].error > fine["radius", "theory"].error
    assert {p.preset for p in points[1]} == {""}


def test_presets_are_recognised_by_their_mesh_alone():
    assert {s.preset for name in ("mesh", NESTED) for s in axes()[name]} == {"", *LEVELS}
    assert Setting("mesh", "", 0.6, edge=0.6).preset == "draft"
    assert Setting("layers", "", 4, edge=0.6, n_layers=4).preset == ""
    assert all(any(s.preset == "standard" for s in along) for name, along in axes().items() if name in LIMIT_AXES)


def test_settings_of_one_name_are_the_same_run_and_others_are_not():
    names = {}
    for s in [FINEST_SETTING, *(s for along in axes().values() for s in along)]:
        parameters = s.edge, s.through, s.kappa_ratio, s.rate, s.element, s.contact_factor, s.precision, s.nested
        assert names.setdefault(s.name, parameters) == parameters
    assert len(set(names.values())) == len(names)


def sphere(radius, level=4):
    return Surface(*icosphere(level, radius), name="pial")


def folds(gi, wavelength, energy, radius=10.0):
    numbers = dict(zip(NUMBER_NAMES, (gi, wavelength, energy), strict=True))
    return {2.0: Folds(sphere(radius), numbers, 100, 1000, 5.0, -0.04)}


def test_folds_are_compared_with_the_finest_mesh_or_with_the_last_of_their_axis():
    few, many = (Setting("layers", f"{n} layers", n, n_layers=n) for n in (1, 3))
    coarse, finest = (Setting("mesh", f"h = {h}", h, edge=h) for h in (1.0, 0.5))
    runs = {
        few.name: folds(1.2, 11.0, 90.0),
        many.name: folds(1.5, 10.0, 100.0),
        finest.name: folds(2.0, 10.0, 80.0),
        coarse.name: folds(1.8, 10.5, 90.0, 10.6),
    }
    errors = {
        (s.label, p.against, p.quantity.removesuffix(", g = 2")): p.error
        for s, better, against in pairs([few, many, coarse], finest)
        for p in fold_points(s, runs[s.name], runs[better.name], against)
    }
    assert {key[:2] for key in errors} == {("1 layers", "3 layers"), ("h = 1.0", FINEST_MESH), ("h = 1.0", OWN_LIMIT)}
    assert errors["h = 1.0", OWN_LIMIT, "gyrification index"] == 0.04
    assert errors["h = 1.0", FINEST_MESH, "gyrification index"] == pytest.approx(0.1)
    assert errors["h = 1.0", FINEST_MESH, "strain energy"] == pytest.approx(0.125)
    assert errors["h = 1.0", FINEST_MESH, "pial distance"] == pytest.approx(0.6 / 3.0, rel=0.01)  # T = 3
    assert errors["1 layers", "3 layers", "gyrification index"] == pytest.approx(0.2)
    assert errors["1 layers", "3 layers", "wavelength"] == pytest.approx(0.1)


@pytest.mark.slow
def test_folds_are_grown_once_and_read_again(tmp_path):
    coarse = Setting("mesh", "h = 4 T", 4.0, edge=4.0, n_layers=1)
    file = tmp_path / "folds.npz"
    first = simulated_folds(coarse, file)
    written = file.read_bytes()
    again = simulated_folds(coarse, file)
    assert file.read_bytes() == written
    assert again[2.0].measures == first[2.0].measures
    assert first[2.0].measures["gyrification index"] >= 1
    assert first[2.0].measures["strain energy"] > first[1.5].measures["strain energy"] > 0
    assert (first[2.0].n_steps, first[2.0].n_elements) == (first[1.5].n_steps, coarse.bilayer().mesh.nelements)


def test_forces_are_timed_on_both_sides_and_agree():
    ours, theirs = assembly_points(4)
    assert (ours.method, theirs.method) == (OUR_CODE, SKFEM_METHOD)
    assert ours.error == theirs.error < 1e-10
    assert ours.size == theirs.size
    assert theirs.repeats >= 5


@pytest.mark.slow
def test_the_two_routes_of_the_theory_agree_far_beyond_what_meshes_reach():
    errors = {p.quantity: p.error for p in theory_points()}
    assert errors.keys() == {"radius", "onset"}
    assert all(0 <= error < 1e-6 for error in errors.values())
