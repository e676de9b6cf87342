import numpy as np
import pytest

from morphofold.sim.mesh import BINARY_CORNERS, PLANES, bilayer_sphere, layer_radii


@pytest.mark.parametrize("portion", PLANES)
def test_every_portion_fills_its_share_of_the_shell(portion):
    bilayer = bilayer_sphere(50, 3, 25, portion, 16)
    corners = bilayer.mesh.p.T[bilayer.mesh.t[BINARY_CORNERS].T]
    edges = np.stack([corners[:, c] - corners[:, 0] for c in (4, 2, 1)], axis=-1)
    assert np.linalg.det(edges).min() > 0                              # corner order is right-handed everywhere
    exact = 4 / 3 * np.pi * (50**3 - 25**3) * bilayer.portion
    from skfem import Basis, ElementHex1

    assert Basis(bilayer.mesh, ElementHex1()).dx.sum() == pytest.approx(exact, rel=5e-3)


def test_portions_are_parts_of_one_mesh():
    counts = {p: bilayer_sphere(50, 3, 25, p, 12).mesh.nelements for p in PLANES}
    assert counts["full"] == 2 * counts["half"] == 4 * counts["quarter"] == 8 * counts["octant"]


def test_layers_hold_the_radii_they_name():
    bilayer = bilayer_sphere(50, 2, 25, "octant", 8)
    r = np.linalg.norm(bilayer.mesh.p, axis=0)
    np.testing.assert_allclose(r[bilayer.layer(0)], 50.0)
    np.testing.assert_allclose(r[bilayer.layer(bilayer.cortex_layers)], 48.0)
    assert len(r) == bilayer.n_surface * len(bilayer.radii)
    cortex = bilayer.mesh.t[:, bilayer.mesh.subdomains["cortex"]]
    assert r[cortex].min() == pytest.approx(48.0)


def test_boundaries_lie_where_they_say():
    bilayer = bilayer_sphere(50, 2, 25, "quarter", 8)
    mesh = bilayer.mesh
    for name, radius in (("pial", 50), ("hole", 25)):
        nodes = np.unique(mesh.facets[:, mesh.boundaries[name]])
        np.testing.assert_allclose(np.linalg.norm(mesh.p[:, nodes], axis=0), radius)
    for axis in bilayer.planes:
        nodes = np.unique(mesh.facets[:, mesh.boundaries[f"plane{axis}"]])
        assert np.array_equal(mesh.p[axis, nodes], np.zeros(len(nodes)))   # exactly: mirrored copies must weld
    assert sum(map(len, mesh.boundaries.values())) == len(mesh.boundary_facets())


def test_core_layers_grow_inwards_and_end_at_the_hole():
    radii = layer_radii(50, 47, 25, 3, edge=2.0)
    steps = -np.diff(radii)
    np.testing.assert_allclose(steps[:3], 1.0)
    assert (np.diff(steps[3:]) >= -1e-12).all()
    assert radii[-1] == pytest.approx(25)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((50, 2, 48, "half", 8), "make hole_radius smaller than 48"),
        ((50, 60, 25, "half", 8), "must lie inside the core"),
        ((50, 2, 25, "half", 7), "even number of cells"),
        ((50, 2, 25, "third", 8), "portion must be one of full, half, quarter, octant"),
    ],
)
def test_impossible_geometry_is_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        bilayer_sphere(*arguments)
