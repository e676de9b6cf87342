"""Conjugate gradients."""

import numba
import numpy as np
import pytest
from scipy import sparse
from scipy.sparse.linalg import spsolve

from morphofold.analysis._mesh import cotangent_laplacian, vertex_areas
from morphofold.analysis.solver import solve
from morphofold.shapes import irregular_sphere


@pytest.fixture
def system(rng):
    verts, faces = irregular_sphere(4, rng=2)
    areas = vertex_areas(verts, faces)
    matrix = (cotangent_laplacian(verts, faces, clip=(-5.0, 20.0)) + sparse.diags_array(30 * areas)).tocsr()
    return matrix, rng.standard_normal(len(verts))


def test_the_solution_is_that_of_a_direct_solver(system, rng):
    matrix, right = system
    start = rng.standard_normal(len(right))
    kept = start.copy()
    np.testing.assert_allclose(solve(matrix, right, start, 1e-12), spsolve(matrix.tocsc(), right), atol=1e-8)
    np.testing.assert_array_equal(start, kept)
    rough = solve(matrix, right, start, 1e-2)
    assert 0 < np.linalg.norm(matrix @ rough - right) <= 1e-2 * np.linalg.norm(right)


@pytest.mark.skipif(numba.get_num_threads() < 2, reason="needs two threads")
def test_one_and_two_threads_give_the_same_bytes(system):
    found = []
    for threads in (1, 2):
        numba.set_num_threads(threads)
        found.append(solve(*system, np.zeros(len(system[1])), 1e-8))
    np.testing.assert_array_equal(*found)


def test_what_does_not_converge_is_refused():
    scale = np.logspace(-12, 12, 400)
    matrix = sparse.diags_array([np.full(399, -1.0), np.full(400, 2.0), np.full(399, -1.0)], offsets=[-1, 0, 1])
    matrix = (sparse.diags_array(scale) @ matrix @ sparse.diags_array(scale)).tocsr()
    matrix.data[:] = np.nan
    with pytest.raises(RuntimeError, match="did not converge in 3000 iterations on 400 vertices"):
        solve(matrix, np.ones(400), np.zeros(400), 1e-6)
