from types import SimpleNamespace

import numpy as np
import pytest
from made_bodies import sphere, standing

from morphofold.geometry import vertex_normals
from morphofold.sim.effects.contact import (
    DEEPEST_NEAR_PAIR_IN_CELLS,
    DEEPEST_PENETRATION_SHARE,
    GAP_IN_CELLS,
    NEIGHBOUR_DISTANCE_IN_EDGES,
    PENALTY_DAMPING,
    PENALTY_STIFFNESS,
    SEARCH_RADIUS_IN_CELLS,
    WAIT_DEPTH_IN_CELLS,
    Contact,
    find_facing,
    triangles,
)
from morphofold.sim.effects.symmetry import Symmetry
from morphofold.sim.mesh.brick_mesh import Plane


def pinched(body, distance):
    """The sphere pressed flat towards z = 0, so that its two poles lie ``distance`` apart and face away."""
    x = body.X.copy()
    x[:, 2] *= 0.5 * distance / 50
    return x


def test_facing_nodes_are_those_of_brute_force():
    body = sphere(16, portion="full")
    n = body.n_surface
    x = pinched(body, 3.0)[:n]
    tri = triangles(body.bilayer.faces)
    normals = -vertex_normals(x, tri)  # inwards: the two sheets face each other
    facing = np.empty(n, dtype=np.int64)
    find_facing(x, body.X[:n], vertex_normals(body.X[:n], tri), normals, n, 4.0, np.full(n, 20.0), facing)
    d = np.linalg.norm(x[:, None] - x[None], axis=-1)
    reference = np.linalg.norm(body.X[:n, None] - body.X[None, :n], axis=-1)
    d[(normals @ normals.T > -0.2) | (reference < 20) | (d >= 4.0)] = np.inf
    expected = np.where(np.isfinite(d.min(axis=1)), d.argmin(axis=1), -1)
    assert (expected >= 0).sum() > 50
    chosen, best = facing >= 0, expected >= 0
    assert np.array_equal(chosen, best)
    rows = np.flatnonzero(best)
    np.testing.assert_allclose(d[rows, facing[rows]], d[rows, expected[rows]])


def two_sheets(distance):
    """A body whose surface is turned inside out and pressed flat: upper and lower sheet face each other."""
    body = sphere(16, portion="full")
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
    near = np.abs(x[: len(extra), 2]) > 0.17  # the flat middle of each sheet
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


def test_a_node_in_a_valley_is_held_by_both_of_its_walls():
    """Whichever of their triangles it touches at the moment."""
    contact, x, _ = two_sheets(distance=0.4)
    body = sphere(16, portion="full")
    body.update_state(body.X)
    middle = np.linalg.norm(x[: body.n_surface, :2], axis=1) + 1e3 * (contact._depth == 0)
    node = int(np.argmin(middle))
    other = contact._facing[node]
    lower = np.sign(x[:, 2]) == np.sign(x[other, 2])
    x[lower, 2] += 0.2 * np.sign(x[node, 2]) * np.abs(x[lower, 0] - x[other, 0])
    around = contact._ring[contact._ring_first[other] : contact._ring_first[other + 1]]
    left, right = (
        next(t for t in around if (side * (x[contact._tri[t], 0] - x[other, 0])).max() < 1e-9) for side in (1, -1)
    )
    stiffnesses = []
    for triangle in (left, right):
        contact._partner[:] = -1
        contact._partner[node] = triangle
        stiffnesses.append(contact.stiffness(body, x)[3 * node : 3 * node + 3, 3 * node : 3 * node + 3].toarray())
    np.testing.assert_allclose(stiffnesses[0], stiffnesses[1], atol=0.05 * stiffnesses[0].max())
    softer, stiffer = np.linalg.eigvalsh(stiffnesses[0])[1:]
    assert softer > 0.03 * stiffer  # across the valley: 0.2^2 by its slopes, 0 by one of them


def test_contact_energy_is_that_of_its_springs_and_ends_with_them():
    contact, x, _ = two_sheets(distance=0.4)
    springs = 0.5 * np.linalg.norm(contact._push, axis=1) * contact._depth  # at rest, force = stiffness times depth
    assert springs.sum() > 0
    assert contact.energy() == pytest.approx(springs.sum(), rel=1e-12)
    assert contact.record()["pairs"] == np.count_nonzero(contact._depth)
    body = sphere(16, portion="full")
    body.update_state(body.X)
    contact.refresh(standing(body, body.X))  # a sphere again: nothing faces anything
    contact.add_forces(body, body.X, np.zeros_like(x), np.zeros((body.n_surface, 3)))
    assert contact.record()["pairs"] == 0
    assert contact.energy() == 0.0


# two flat walls, face to face


def walls(distance, *, n=9, mass=1.0, aside=0.0, reference=40.0):
    """Walls of n x n nodes 1 mm apart at x = ``distance``/2, facing down, and its mirror image, ``distance`` apart.

    In the reference they are ``reference`` mm apart. The upper one comes first, ``aside`` mm along y.
    """
    u, v = np.meshgrid(np.arange(n), np.arange(n), indexing="ij")
    flat = np.column_stack([np.zeros(n * n), u.ravel(), v.ravel()])
    number = u * n + v
    quads = np.stack([number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]], axis=-1).reshape(-1, 4)
    up, shift = np.array([1.0, 0.0, 0.0]), np.array([0.0, aside, 0.0])

    def pair(apart):
        return np.concatenate([flat + 0.5 * apart * up, flat - 0.5 * apart * up])

    body = SimpleNamespace(
        bilayer=SimpleNamespace(
            faces=np.concatenate([quads, quads[:, ::-1] + n * n]), edge=1.0, planes=(Plane(0, 0.0, 1),)
        ),
        n_surface=2 * n * n,
        X=pair(reference),
        mass=np.broadcast_to(mass, 2 * n * n).astype(float),
        cell=1.0,
        is_split=False,
    )
    x = pair(distance)
    x[: n * n] += shift
    return body, x


def halved(body):
    """The upper wall alone."""
    n = body.n_surface // 2
    return SimpleNamespace(
        bilayer=SimpleNamespace(mesh=SimpleNamespace(p=body.X[:n].T), planes=body.bilayer.planes),
        n_surface=n,
        mass=body.mass[:n],
        cell=body.cell,
    )


def pushes(body, x, v=None):
    """Forces of contact on the walls, and the effect."""
    contact, extra = Contact(), np.zeros((body.n_surface, 3))
    contact.prepare(body)
    contact.refresh(standing(body, x))
    contact.add_forces(body, x, np.zeros_like(x) if v is None else v, extra)
    return extra, contact


@pytest.mark.parametrize(("gaps", "speed"), [(0.6, 0.0), (0.6, 0.02), (0.6, -0.02), (0.6, -1.0), (-0.4, 0.02)])
def test_a_wall_on_its_symmetry_plane_is_pushed_as_by_its_mirror_image(rng, gaps, speed):
    """Of the two walls one is the image of the other; ``speed`` is that towards the plane."""
    body, x = walls(gaps * GAP_IN_CELLS, mass=3.0)
    n = body.n_surface // 2
    v = 0.001 * rng.standard_normal((n, 3)) - [speed, 0, 0]
    by_image, contact = pushes(body, x, np.concatenate([v, v * [-1, 1, 1]]))
    plane, by_plane = Symmetry(), np.zeros((n, 3))
    plane.prepare(halved(body))
    plane.add_forces(halved(body), x[:n], v, by_plane)
    np.testing.assert_allclose(by_plane, by_image[:n], atol=1e-14)
    np.testing.assert_allclose(by_image[n:], by_image[:n] * [-1, 1, 1], atol=1e-14)
    assert 2 * plane.energy() == pytest.approx(contact.energy())
    assert (by_plane[:, 0] > 0).all() == (speed > -1)  # and nothing holds what flies off
    assert by_plane.any() == (speed > -1)


def test_what_comes_near_is_pushed_more_and_what_goes_away_less():
    body, x = walls(0.6 * GAP_IN_CELLS)
    v = np.zeros_like(x)
    push = []
    for speed in (-0.01, 0.0, 0.01):  # of the upper wall, down
        v[: len(x) // 2, 0] = -speed
        push.append(pushes(body, x, v)[0][: len(x) // 2, 0])
    depth = 0.4 * GAP_IN_CELLS
    np.testing.assert_allclose(push[1], 2 * PENALTY_STIFFNESS * depth)  # of its own springs, and those of the other
    np.testing.assert_allclose(push[2] - push[1], 2 * PENALTY_DAMPING * 0.01)
    np.testing.assert_allclose(push[0] - push[1], -2 * PENALTY_DAMPING * 0.01)


def test_the_push_is_the_gradient_of_the_energy_in_the_gap_and_through_the_surface():
    def pushed(gaps):
        body, x = walls(gaps * GAP_IN_CELLS)
        push, contact = pushes(body, x)
        return push[: len(x) // 2, 0], contact.energy()

    for gaps in (0.5, -0.5):
        push, _ = pushed(gaps)
        energy = pushed(gaps - 1e-4)[1] - pushed(gaps + 1e-4)[1]
        assert energy == pytest.approx(2e-4 * GAP_IN_CELLS * push.sum(), rel=1e-6)


@pytest.mark.parametrize("heavy", ["upper", "lower"])
def test_a_push_is_that_of_the_lighter_side(heavy):
    """Scaled by the heavier one it would need a smaller step."""
    body, x = walls(0.6 * GAP_IN_CELLS)
    n = len(x) // 2
    light, _ = pushes(body, x)
    body.mass[slice(n) if heavy == "upper" else slice(n, None)] = 1e6
    np.testing.assert_allclose(pushes(body, x)[0], light, rtol=1e-12)
    assert light.any()


@pytest.mark.parametrize(("depth", "pace"), [(-1.0, 1.0), (0.5, 1.0), (1.0, 1.0), (2.0, 1 / 2), (4.0, 1 / 4)])
def test_the_pace_falls_with_the_depth_beyond_its_limit_and_is_kept_in_a_checkpoint(depth, pace):
    body, x = walls(GAP_IN_CELLS - depth * WAIT_DEPTH_IN_CELLS)
    _, contact = pushes(body, x)
    assert contact.pace(1.5) == pytest.approx(pace)
    again = Contact()
    again.prepare(body)
    again.load(contact.save())
    assert again.pace(1.5) == contact.pace(1.5)


def test_contact_is_looked_for_within_its_radius_and_ends_at_its_depth():
    for distance, faces in ((0.99 * SEARCH_RADIUS_IN_CELLS, True), (1.01 * SEARCH_RADIUS_IN_CELLS, False)):
        body, x = walls(distance)
        assert (pushes(body, x)[1].save()["facing"] >= 0).any() == faces
    for depth, pushed in (
        (0.99 * DEEPEST_PENETRATION_SHARE * SEARCH_RADIUS_IN_CELLS, True),
        (1.01 * DEEPEST_PENETRATION_SHARE * SEARCH_RADIUS_IN_CELLS, False),
    ):
        body, x = walls(-depth)
        assert pushes(body, x)[0].any() == pushed


def test_neighbours_in_the_reference_are_no_contact_and_flanks_of_one_ridge_until_a_tenth_of_a_cell_deep():
    """Of a triangle the first corner counts, up to the diagonal of a cell aside of the node.

    Below zero the walls stand back to back in the reference; above, across a gap, and then they never are neighbours.
    """
    for reference, distance, pushed in (
        (-0.5, 0.5 * GAP_IN_CELLS, False),
        (-1.01 * NEIGHBOUR_DISTANCE_IN_EDGES, 0.5 * GAP_IN_CELLS, True),
        (-2.0 * NEIGHBOUR_DISTANCE_IN_EDGES, -0.99 * DEEPEST_NEAR_PAIR_IN_CELLS, True),
        (-2.0 * NEIGHBOUR_DISTANCE_IN_EDGES, -1.01 * DEEPEST_NEAR_PAIR_IN_CELLS, False),
        (-2.51 * NEIGHBOUR_DISTANCE_IN_EDGES, -1.01 * DEEPEST_NEAR_PAIR_IN_CELLS, True),
        (0.5, 0.5 * GAP_IN_CELLS, True),
        (2.0 * NEIGHBOUR_DISTANCE_IN_EDGES, -1.01 * DEEPEST_NEAR_PAIR_IN_CELLS, True),
    ):
        body, x = walls(distance, reference=reference)
        middle = len(x) // 4  # away from the edges of the walls
        assert pushes(body, x)[0][middle].any() == pushed, (reference, distance)


def test_walls_are_no_neighbours_because_edges_are_long_elsewhere():
    """Back to back and 1.5 times the distance of neighbours apart, beside a single quad with edges of 4 mm."""
    body, x = walls(0.5 * GAP_IN_CELLS, reference=-1.5 * NEIGHBOUR_DISTANCE_IN_EDGES)
    n, quad = body.n_surface, np.array([[90.0, 0.0, 0.0], [90.0, 4.0, 0.0], [90.0, 4.0, 4.0], [90.0, 0.0, 4.0]])
    body.bilayer.faces = np.concatenate([body.bilayer.faces, [n + np.arange(4)]])
    body.X, x = np.concatenate([body.X, quad]), np.concatenate([x, quad])
    body.mass, body.n_surface, body.bilayer.edge = np.append(body.mass, np.ones(4)), n + 4, 4.0
    assert pushes(body, x)[0][n // 4].any()


def test_a_node_that_slid_off_its_triangle_by_a_cell_is_pushed_no_more():
    """The walls overlap by the rows that are left."""
    for beyond, pushed in ((0.99, True), (1.01, False)):
        body, x = walls(0.5 * GAP_IN_CELLS, aside=8.0 + beyond)  # the first row of the upper wall lies beyond
        row = x[: len(x) // 2, 1] == 8.0 + beyond
        extra, contact = pushes(body, x)
        assert (contact.save()["facing"][: len(row)][row] >= 0).all()
        assert extra[: len(row)][row].any() == pushed


def test_the_pairing_is_renewed_once_the_surface_has_moved_by_a_fifth_of_the_radius():
    body, x = walls(GAP_IN_CELLS)
    contact = Contact()
    contact.prepare(body)
    for moved, searches in ((0.0, 1), (0.19, 1), (0.21, 2), (0.35, 2)):
        contact.refresh(standing(body, x + [0, 0, moved * SEARCH_RADIUS_IN_CELLS]))
        assert contact.record()["searches"] == searches


def test_a_wall_that_slides_by_a_cell_between_measurements_is_pushed_like_one_that_was_always_there():
    """Growth moves a wall by up to a cell in the twelve steps between two calls of refresh."""
    body, x = walls(0.5 * GAP_IN_CELLS)
    slid = walls(0.5 * GAP_IN_CELLS, aside=1.5)[1]
    contact = Contact()
    contact.prepare(body)
    contact.refresh(standing(body, x))
    for step in range(12):
        extra = np.zeros((body.n_surface, 3))
        contact.add_forces(body, x + min(step / 8, 1.0) * (slid - x), np.zeros_like(x), extra)
    fresh = pushes(body, slid)[0]
    assert np.abs(fresh).max() > 0
    np.testing.assert_allclose(extra, fresh, atol=1e-12 * np.abs(fresh).max())
