from types import SimpleNamespace

import numpy as np
import pytest

from morphofold.sim.body import Body
from morphofold.sim.effects.contact import GAP, Contact, _nearest_weights, find_facing, node_normals, triangles
from morphofold.sim.effects.symmetry import Symmetry
from morphofold.sim.meshes.bilayer import bilayer_sphere


def make_body(portion="full", n=16):
    return Body(bilayer_sphere(50, 3, 25, portion, n), mu_cortex=1.0, mu_core=1.0, kappa_ratio=50.0, law="isotropic")


def pinched(body, distance):
    """The sphere pressed flat towards z = 0, so that its two poles lie ``distance`` apart and face away."""
    x = body.X.copy()
    x[:, 2] *= 0.5 * distance / 50
    return x


def test_facing_nodes_are_those_of_brute_force():
    body = make_body()
    n = body.n_surface
    x = pinched(body, 3.0)[:n]
    tri = triangles(body.bilayer.faces)
    normals = -node_normals(x, tri, n)                                   # inwards: the two sheets face each other
    found = np.empty(n, dtype=np.int64)
    find_facing(x, body.X[:n], normals, n, 4.0, 20.0, found)
    d = np.linalg.norm(x[:, None] - x[None], axis=-1)
    reference = np.linalg.norm(body.X[:n, None] - body.X[None, :n], axis=-1)
    d[(normals @ normals.T > -0.2) | (reference < 20) | (d >= 4.0)] = np.inf
    want = np.where(np.isfinite(d.min(axis=1)), d.argmin(axis=1), -1)
    assert (want >= 0).sum() > 50
    chosen, best = found >= 0, want >= 0
    assert np.array_equal(chosen, best)
    rows = np.flatnonzero(best)
    np.testing.assert_allclose(d[rows, found[rows]], d[rows, want[rows]])


def test_weights_name_the_nearest_point_of_the_triangle(rng):
    grid = np.array([(i, j, 40 - i - j) for i in range(41) for j in range(41 - i)]) / 40
    for _ in range(50):
        a, b, c = rng.standard_normal((3, 3))
        p = 2 * rng.standard_normal(3)
        w = np.array(_nearest_weights(p, a, b, c))
        assert w.min() >= 0
        assert w.sum() == pytest.approx(1)
        best = np.linalg.norm(grid @ [a, b, c] - p, axis=1).min()
        assert np.linalg.norm(w @ [a, b, c] - p) <= best + 1e-12


def standing(body, x):
    """What an effect sees of a run that stands at ``x``."""
    return SimpleNamespace(body=body, state=SimpleNamespace(x=x, v=np.zeros_like(x)))


def two_sheets(distance):
    """A body whose surface is turned inside out and pressed flat: upper and lower sheet face each other."""
    body = make_body()
    contact = Contact()
    contact.prepare(body)
    contact._tri = contact._tri[:, ::-1].copy()
    x = pinched(body, distance)
    body.update_state(body.X)
    contact.refresh(standing(body, x))
    extra = np.zeros((body.n_surface, 3))
    contact.add_forces(body, x, np.zeros_like(x), extra)
    return contact, x, extra


def test_sheets_within_the_gap_are_pushed_apart_and_others_left_alone():
    _, x, extra = two_sheets(distance=0.4)
    near = np.abs(x[: len(extra), 2]) > 0.17                             # the flat middle of each sheet
    assert (np.sign(extra[near, 2]) == np.sign(x[: len(extra), 2])[near]).mean() > 0.9
    _, _, extra = two_sheets(distance=12.0)
    assert not extra[np.abs(x[: len(extra), 2]) > 0.17].any()


def test_contact_keeps_momentum_and_angular_momentum():
    _, x, extra = two_sheets(distance=0.4)
    size = np.abs(extra).sum()
    assert size > 0
    assert np.abs(extra.sum(axis=0)).max() < 1e-12 * size
    # the reaction acts at the foot point on the triangle, the action at the node: their arm is the gap
    torque = np.cross(x[: len(extra)], extra).sum(axis=0)
    assert np.abs(torque).max() < 1e-3 * np.linalg.norm(np.cross(x[: len(extra)], extra), axis=1).sum()


def test_contact_energy_is_that_of_its_springs_and_ends_with_them():
    contact, x, _ = two_sheets(distance=0.4)
    springs = 0.5 * np.linalg.norm(contact._push, axis=1) * contact._depth   # at rest, force = stiffness times depth
    assert springs.sum() > 0
    assert contact.energy() == pytest.approx(springs.sum(), rel=1e-12)
    assert contact.record()["pairs"] == np.count_nonzero(contact._depth)
    body = make_body()
    body.update_state(body.X)
    contact.refresh(standing(body, body.X))                                  # a sphere again: nothing faces anything
    contact.add_forces(body, body.X, np.zeros_like(x), np.zeros((body.n_surface, 3)))
    assert contact.record()["pairs"] == 0
    assert contact.energy() == 0.0


def test_contact_never_attracts():
    contact, x, _ = two_sheets(distance=0.4)
    body = make_body()
    body.update_state(body.X)
    v = np.zeros_like(x)
    v[:, 2] = 10 * np.sign(x[:, 2])                                      # flying apart
    extra = np.zeros((body.n_surface, 3))
    contact.add_forces(body, x, v, extra)
    assert not extra.any()


def test_a_symmetry_plane_acts_as_the_mirror_image():
    body = make_body("octant")
    planes = Symmetry()
    planes.prepare(body)
    body.update_state(body.X)
    x, extra = body.X.copy(), np.zeros((body.n_surface, 3))
    node = int(np.argmin(np.abs(body.X[: body.n_surface] - 50 / 3**0.5).sum(axis=1)))
    x[node, 0] = -0.5
    planes.add_forces(body, x, np.zeros_like(x), extra)
    assert extra[node, 0] > 0
    assert np.count_nonzero(extra) == 1
    assert planes.record()["pressed"] == 1
    assert planes.energy() == pytest.approx(0.5 * extra[node, 0] * (0.5 + 0.5 * GAP * body.filter.h))
