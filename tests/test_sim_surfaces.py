import numpy as np
import pytest

from morphofold.shapes import icosphere
from morphofold.sim.body import Body
from morphofold.sim.mesh.brick_mesh import SYMMETRY_AXES, bilayer_sphere
from morphofold.sim.output.stage_surfaces import smooth_diagonals, whole_surfaces
from morphofold.sim.stage_checks import cover, enclosed_volume
from morphofold.surface import Surface

#: the triangles of a quad, cut from corner 0 to 2 and from 1 to 3
SPLITS = [[[0, 1, 2], [0, 2, 3]], [[0, 1, 3], [1, 2, 3]]]


@pytest.mark.parametrize("portion", SYMMETRY_AXES)
def test_every_portion_gives_the_whole_closed_sphere(portion):
    body = Body(bilayer_sphere(50, 3, 25, portion, 12), mu_cortex=1.0, mu_core=1.0, kappa_ratio=50.0, law="isotropic")
    white, pial, _ = whole_surfaces(body, body.X)
    V, F = len(pial.verts), pial.faces
    edges = np.sort(np.concatenate([F[:, [0, 1]], F[:, [1, 2]], F[:, [2, 0]]]), axis=1)
    unique, counts = np.unique(edges, axis=0, return_counts=True)
    assert (counts == 2).all()  # closed, every seam welded
    assert V - len(unique) + len(F) == 2
    assert np.array_equal(white.faces, pial.faces)
    assert 0.97 < enclosed_volume(pial) / (4 / 3 * np.pi * 50**3) < 1  # outward everywhere
    np.testing.assert_allclose(np.linalg.norm(white.verts, axis=1), 47.0)


@pytest.mark.parametrize("side", [1, -1])
def test_diagonals_run_along_the_folds(side):
    n = 12
    u, v = np.meshgrid(np.arange(n), np.arange(n), indexing="ij")
    number = u * n + v
    quads = np.stack([number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]], axis=-1).reshape(-1, 4)
    x = np.column_stack([u.ravel(), v.ravel(), 2 * np.cos(0.7 * (u - side * v)).ravel()]).astype(float)
    faces = smooth_diagonals(x, quads)
    steps = np.concatenate([x[faces[:, (k + 1) % 3]] - x[faces[:, k]] for k in range(3)])[:, :2]
    slanted = steps[np.abs(steps).min(axis=1) > 0]  # each diagonal, from both its triangles
    assert len(slanted) == 2 * len(quads)
    assert (slanted @ (1, -side) == 0).mean() > 0.95


def test_a_deep_dent_overlaps_nothing_and_two_bodies_in_one_place_do():
    verts, faces = icosphere(4, radius=10.0)
    dent = np.exp(-((verts[:, :2] / 2.5) ** 2).sum(axis=1)) * (verts[:, 2] > 0)
    dented = verts.copy()
    dented[:, 2] -= 15 * dent
    assert cover(Surface(dented, faces))[0] == 0.0
    both = Surface(np.concatenate([verts, verts + [12.0, 0, 0]]), np.concatenate([faces, faces + len(verts)]))
    assert cover(both)[0] > 0.02


def test_no_other_diagonal_of_a_single_quad_would_bend_the_surface_less(rng):
    """By brute force: squared angles between the normals of neighbours, summed over all inner edges."""
    n = 9
    u, v = np.meshgrid(np.arange(n), np.arange(n), indexing="ij")
    number = u * n + v
    quads = np.stack([number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]], axis=-1).reshape(-1, 4)
    quads = np.array([np.roll(quad, rng.integers(4)) for quad in quads])  # any corner may be the first
    x = np.column_stack([u.ravel(), v.ravel(), 0.4 * rng.standard_normal(n * n)])

    def bent(choice):
        faces = np.concatenate([quad[c] for quad, c in zip(quads, np.array(SPLITS)[choice])])
        normal = np.cross(x[faces[:, 1]] - x[faces[:, 0]], x[faces[:, 2]] - x[faces[:, 0]])
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        sides = {}
        for f, face in enumerate(faces.tolist()):
            for k in range(3):
                sides.setdefault(frozenset((face[k], face[k - 1])), []).append(f)
        pairs = np.array([both for both in sides.values() if len(both) == 2])
        assert len(pairs) == 3 * n * n - 4 * n + 1 - 4 * (n - 1)
        return np.sum(np.arccos(np.clip(np.sum(normal[pairs[:, 0]] * normal[pairs[:, 1]], axis=1), -1, 1)) ** 2)

    first = smooth_diagonals(x, quads)[: len(quads)]
    choice = np.where((first == quads[:, [0, 1, 2]]).all(axis=1), 0, 1)
    least = bent(choice)
    assert 0.3 < choice.mean() < 0.7
    for q in range(len(quads)):
        flipped = choice.copy()
        flipped[q] = 1 - flipped[q]
        assert bent(flipped) > least - 1e-9
