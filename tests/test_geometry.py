import numpy as np
import pytest
from skfem import Basis, ElementHex1

from morphofold.sim.elements.bricks import CORNERS_IN_KERNEL_ORDER
from morphofold.sim.mesh.brick_mesh import (
    CORE_LAYER_RATIO,
    SYMMETRY_AXES,
    THICKEST_CORE_LAYER_IN_EDGES,
    bilayer_ellipsoid,
    bilayer_patch,
    bilayer_sphere,
    core_layer_fractions,
    spot_factors,
)


@pytest.mark.parametrize("portion", SYMMETRY_AXES)
def test_every_portion_fills_its_share_of_the_shell(portion):
    bilayer = bilayer_sphere(50, 3, 25, portion, 16)
    corners = bilayer.mesh.p.T[bilayer.mesh.t[CORNERS_IN_KERNEL_ORDER].T]
    edges = np.stack([corners[:, c] - corners[:, 0] for c in (4, 2, 1)], axis=-1)
    assert np.linalg.det(edges).min() > 0  # corner order is right-handed everywhere
    exact = 4 / 3 * np.pi * (50**3 - 25**3) * bilayer.portion
    assert Basis(bilayer.mesh, ElementHex1()).dx.sum() == pytest.approx(exact, rel=5e-3)


def test_portions_are_parts_of_one_mesh():
    counts = {p: bilayer_sphere(50, 3, 25, p, 12).mesh.nelements for p in SYMMETRY_AXES}
    assert counts["full"] == 2 * counts["half"] == 4 * counts["quarter"] == 8 * counts["octant"]


def test_layers_hold_the_radii_they_name():
    bilayer = bilayer_sphere(50, 2, 25, "octant", 8)
    r = np.linalg.norm(bilayer.mesh.p, axis=0)
    np.testing.assert_allclose(r[bilayer.share == 1], 50.0)
    np.testing.assert_allclose(np.linalg.norm(bilayer.white @ bilayer.mesh.p.T, axis=1), 48.0)
    np.testing.assert_allclose(bilayer.share, np.clip((r - 48) / 2, 0, 1), atol=1e-12)
    np.testing.assert_allclose(r[bilayer.held], 25.0)
    np.testing.assert_allclose(bilayer.foot, 50 * bilayer.radial)
    cortex = bilayer.mesh.t[:, bilayer.mesh.subdomains["cortex"]]
    assert r[cortex].min() == pytest.approx(48.0)


def test_nodes_of_symmetry_planes_lie_on_them_exactly():
    for bilayer in (bilayer_sphere(50, 2, 25, "quarter", 8), bilayer_patch((30.0, 20.0), 12.0, 2.0, 1.7)):
        for axis, level, _ in bilayer.planes:
            near = np.abs(bilayer.mesh.p[axis] - level) < 1e-6
            assert np.array_equal(bilayer.mesh.p[axis, near], np.full(near.sum(), level))  # mirrored copies must weld
            assert near.sum() > 10


def test_the_cortex_of_an_ellipsoid_is_as_thick_as_asked_everywhere():
    axes = np.array([60.0, 45.0, 40.0])
    bilayer = bilayer_ellipsoid(axes, 2.5, 0.5, "octant", 12)
    pial, white = bilayer.mesh.p.T[: bilayer.n_surface], bilayer.white @ bilayer.mesh.p.T
    np.testing.assert_allclose(((pial / axes) ** 2).sum(axis=1), 1.0)
    np.testing.assert_allclose(np.linalg.norm(pial - white, axis=1), 2.5)
    gradient = pial / axes**2
    gradient /= np.linalg.norm(gradient, axis=1, keepdims=True)
    np.testing.assert_allclose((pial - white) / 2.5, gradient, atol=1e-12)


def test_a_spot_of_thin_cortex_is_thin_at_its_centre_and_nowhere_beyond():
    spots = [((0, 0, 50.0), 20.0, 0.5)]
    bilayer = bilayer_sphere(50, lambda points: 2 * spot_factors(points, spots), 25, "octant", 16)
    pial, white = bilayer.mesh.p.T[: bilayer.n_surface], bilayer.white @ bilayer.mesh.p.T
    thickness, away = np.linalg.norm(pial - white, axis=1), np.linalg.norm(pial - [0, 0, 50], axis=1)
    assert thickness[away.argmin()] == pytest.approx(1.0)
    np.testing.assert_allclose(thickness[away > 20], 2.0)
    assert (np.diff(thickness[np.argsort(away)]) > -1e-9).all()


def test_a_patch_is_a_block_and_a_strip_one_brick_deep():
    patch, strip = bilayer_patch((30.0, 20.0), 12.0, 2.0, 1.7), bilayer_patch((30.0, 0.0), 12.0, 2.0, 1.7)
    assert Basis(patch.mesh, ElementHex1()).dx.sum() == pytest.approx(30 * 20 * 12)
    assert patch.edge <= 1.7
    assert strip.mesh.p[1].max() == pytest.approx(30 / 18)
    assert len(strip.faces) == 18
    assert Basis(strip.mesh, ElementHex1()).dx.sum() == pytest.approx(30 * 30 / 18 * 12)


def test_core_layers_grow_inwards_and_end_at_the_base():
    shares = core_layer_fractions(1.0, 22.0, edge=0.5)
    steps = 22.0 * np.diff(shares)
    assert (shares[0], shares[-1]) == (0, 1)
    assert (np.diff(steps) >= -1e-12).all()
    assert steps.max() <= 0.5 * THICKEST_CORE_LAYER_IN_EDGES < 22.0 / 4
    assert (steps[1:] / steps[:-1]).max() <= CORE_LAYER_RATIO * (1 + 1e-12)


@pytest.mark.parametrize(
    ("arguments", "numbers"),
    [((50, 2, 48.5, "half", 8), r"\b0\.97\b.*\b0\.96\b.*\b2 mm\b"), ((50, 60, 25, "half", 8), r"\b0\.5\b.*\b60 mm\b")],
)
def test_impossible_geometry_is_refused(arguments, numbers):
    with pytest.raises(ValueError, match=numbers):
        bilayer_sphere(*arguments)
