"""Conjugate gradients."""

import numba
import numpy as np
import pytest
from scipy import sparse
from scipy.sparse.linalg import spsolve

from morphofold.analysis.conjugate_gradients import solve
from morphofold.errors import WrongShape
from morphofold.geometry import cotangent_laplacian, vertex_areas
from morphofold.shapes import irregular_sphere


@pytest.fixture
def system(rng):
    verts, faces = irregular_sphere(4, rng=2)
    areas = vertex_areas(verts, faces)
    matrix = (cotangent_laplacian(verts, faces, clip=(-5.0, 20.0)) + sparse.diags_array(30 * areas)).tocsr()
    return matrix, rng.standard_normal(len(verts))


@pytest.mark.parametrize("shape", [(2562,), (2562, 3)])
def test_the_solution_is_that_of_a_direct_solver(system, shape, rng):
    matrix, right = system[0], rng.standard_normal(shape)
    start = rng.standard_normal(shape)
    kept = start.copy()
    np.testing.assert_allclose(solve(matrix, right, start, 1e-13), spsolve(matrix.tocsc(), right), atol=1e-8)
    np.testing.assert_array_equal(start, kept)
    rough = solve(matrix, right, start, 1e-2)
    off, all_of_it = np.linalg.norm(matrix @ rough - right, axis=0), np.linalg.norm(right, axis=0)
    assert (off > 0).all()
    assert (off <= 1e-2 * all_of_it).all()


def test_a_column_that_is_there_before_the_others_stays(system):
    matrix, right = system
    found = solve(matrix, np.stack([0 * right, right, right], axis=1), np.zeros((len(right), 3)), 1e-8)
    assert (found[:, 0] == 0).all()
    np.testing.assert_array_equal(found[:, 1], found[:, 2])
    np.testing.assert_allclose(found[:, 1], solve(matrix, right, np.zeros(len(right)), 1e-8), atol=1e-10)


@pytest.mark.skipif(numba.get_num_threads() < 2, reason="needs two threads")
@pytest.mark.parametrize("columns", [1, 3])
def test_one_and_two_threads_give_the_same_bytes(system, columns):
    matrix, right = system
    right = right if columns == 1 else np.stack([right, right**2, np.sin(right)], axis=1)
    found = []
    for threads in (1, 2):
        numba.set_num_threads(threads)
        found.append(solve(matrix, right, np.zeros(right.shape), 1e-8))
    np.testing.assert_array_equal(*found)


@pytest.mark.parametrize("shapes", [((2562, 2), (2562, 2)), ((2562, 1), (2562, 1)), ((2562,), (2562, 3)), ((9,), (9,))])
def test_other_shapes_are_refused(system, shapes):
    with pytest.raises(WrongShape, match=r"\bN = 2562\b"):
        solve(system[0], np.ones(shapes[0]), np.zeros(shapes[1]), 1e-6)


def test_what_does_not_converge_is_refused():
    scale = np.logspace(-12, 12, 400)
    matrix = sparse.diags_array([np.full(399, -1.0), np.full(400, 2.0), np.full(399, -1.0)], offsets=[-1, 0, 1])
    matrix = (sparse.diags_array(scale) @ matrix @ sparse.diags_array(scale)).tocsr()
    matrix.data[:] = np.nan
    with pytest.raises(RuntimeError, match=r"\b3000\b.*\b400\b"):
        solve(matrix, np.ones(400), np.zeros(400), 1e-6)
