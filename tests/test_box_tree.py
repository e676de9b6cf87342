from functools import partial

import numpy as np
import pytest

from morphofold.intersections.box_tree import LEAF_SIZE, box_tree, following, meets, meets_ray
from morphofold.shapes import icosphere


def needles(rng, n):
    """Triangles each of which may be a thousand times longer than the next, none connected."""
    at = rng.uniform(0, 100, (n, 1, 3))
    corners = at + rng.standard_normal((n, 3, 3)) * 10.0 ** rng.uniform(-2, 1.5, (n, 1, 1))
    return corners.reshape(-1, 3), np.arange(3 * n).reshape(-1, 3)


def walk(tree, touches):
    """Triangles of the leaves that a walk comes to, and how many boxes it looks at."""
    leaves, k, visited, triangles = len(tree.bounds) // 2, 1, 0, []
    while k > 0:
        visited += 1
        if touches(tree.bounds[k]):
            if k < leaves:
                k *= 2
                continue
            triangles.extend(tree.order[LEAF_SIZE * (k - leaves) : LEAF_SIZE * (k - leaves + 1)])
        k = following(k)
    return triangles, visited


@pytest.mark.parametrize("n", [1, 4, 5, 8, 63, 64, 65])
def test_a_walk_that_turns_nothing_away_comes_to_each_triangle_once_and_to_each_box(rng, n):
    tree = box_tree(*needles(rng, n))
    triangles, visited = walk(tree, lambda box: True)
    assert sorted(triangles) == list(range(n))
    assert visited == len(tree.bounds) - 1


def test_every_box_holds_those_below_it_and_its_triangles(rng):
    verts, faces = needles(rng, 200)
    tree = box_tree(verts, faces)
    leaves = len(tree.bounds) // 2
    for k in range(2, 2 * leaves):
        above, box = tree.bounds[k // 2], tree.bounds[k]
        assert (above[:3] <= box[:3]).all()
        assert (above[3:] >= box[3:]).all()
    for position, f in enumerate(tree.order):
        box = tree.bounds[leaves + position // LEAF_SIZE]
        assert (box[:3] < verts[faces[f]]).all()
        assert (box[3:] > verts[faces[f]]).all()


def test_no_triangle_that_meets_a_box_is_missed(rng):
    tree = box_tree(*needles(rng, 500))
    for _ in range(50):
        low = rng.uniform(0, 100, 3)
        box = np.concatenate([low, low + 10 ** rng.uniform(-1, 2, 3)])
        brute = np.flatnonzero([meets(face_box, box) for face_box in tree.face_boxes])
        triangles, _ = walk(tree, partial(meets, box))
        assert set(brute) <= set(triangles)


def test_no_triangle_that_a_ray_meets_is_missed(rng):
    verts, faces = needles(rng, 500)
    tree = box_tree(verts, faces)
    for f in range(0, 500, 5):
        origin = np.round(rng.uniform(0, 100, 3))
        through = rng.dirichlet(np.ones(3)) @ verts[faces[f]]
        if f % 2:
            origin[f % 3] = through[f % 3]  # no component along one axis
        for direction in (through - origin, origin - through):
            triangles, _ = walk(tree, lambda node, o=origin, d=direction: meets_ray(node, o, d))
            assert {g for g in range(500) if meets_ray(tree.face_boxes[g], origin, direction)} <= set(triangles)
        assert meets_ray(tree.face_boxes[f], origin, through - origin)


@pytest.mark.parametrize("stretch", [1, 1000])
def test_a_small_box_asks_for_few_of_the_boxes_however_stretched_the_surface(stretch):
    verts, faces = icosphere(5)
    tree = box_tree(verts * [1, 1, stretch], faces)
    assert len(tree.bounds) <= len(faces)
    visited = [walk(tree, partial(meets, box))[1] for box in tree.face_boxes[::500]]
    assert max(visited) < 400  # of 16,000
