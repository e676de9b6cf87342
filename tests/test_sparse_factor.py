"""Nested dissection: the same solutions and the same inertia as dense algebra."""

import numpy as np
import pytest
from scipy import sparse

from morphofold.sim.equilibrium import sparse_factor
from morphofold.sim.equilibrium.sparse_factor import Dissection, Factor


def lattice(shape, rng):
    """Nodes of a lattice that couple to their 26 neighbours, and a random symmetric matrix of three rows a node."""
    points = np.stack(np.meshgrid(*[np.arange(float(n)) for n in shape], indexing="ij"), axis=-1).reshape(-1, 3)
    near = np.abs(points[:, None] - points).max(axis=-1) < 1.5
    graph = sparse.csr_matrix(near.astype(float))
    noise = rng.standard_normal((3 * len(points), 3 * len(points)))
    full = np.kron(near, np.ones((3, 3))) * (noise + noise.T)
    rows = np.flatnonzero(rng.uniform(size=len(full)) < 0.9)  # some coordinates are held
    return points, graph, rows, full[np.ix_(rows, rows)]


@pytest.fixture
def small_leaves(monkeypatch):
    monkeypatch.setattr(sparse_factor, "MOST_LEAF_NODES", 8)


@pytest.mark.parametrize("shape", [(7, 5, 3), (40, 2, 1), (1, 1, 1)])
@pytest.mark.parametrize("shift", [100.0, 20.0, -100.0])
def test_solutions_and_inertia_are_those_of_dense_algebra(shape, shift, rng, small_leaves):
    points, graph, rows, A = lattice(shape, rng)
    A += shift * np.eye(len(A))
    pattern = sparse.csr_matrix(A)
    factor = Factor(Dissection(points, graph, rows, pattern), pattern)
    b = rng.standard_normal(len(A))
    np.testing.assert_allclose(factor.solve(b), np.linalg.solve(A, b), rtol=1e-8, atol=1e-9)
    assert factor.negative == np.sum(np.linalg.eigvalsh(A) < 0)


def test_a_body_in_two_pieces_is_solved_too(rng, small_leaves):
    points, graph, rows, A = lattice((9, 3, 2), rng)
    along = points[rows // 3, 0]
    A[np.not_equal.outer(along < 4.5, along < 4.5)] = 0.0
    A += 100 * np.eye(len(A))
    nodes = points[:, 0] < 4.5
    graph = sparse.csr_matrix(graph.multiply(np.equal.outer(nodes, nodes)))
    pattern = sparse.csr_matrix(A)
    b = rng.standard_normal(len(A))
    solution = Factor(Dissection(points, graph, rows, pattern), pattern).solve(b)
    np.testing.assert_allclose(solution, np.linalg.solve(A, b), rtol=1e-10)


def test_one_dissection_serves_matrices_of_one_pattern(rng, small_leaves):
    points, graph, rows, A = lattice((6, 4, 2), rng)
    pattern = sparse.csr_matrix(A)
    plan = Dissection(points, graph, rows, pattern)
    for scale in (1.0, -2.0):
        b = rng.standard_normal(len(A))
        np.testing.assert_allclose(Factor(plan, scale * pattern).solve(b), np.linalg.solve(scale * A, b), rtol=1e-7)


def test_a_singular_matrix_is_refused(rng, small_leaves):
    points, graph, rows, A = lattice((5, 3, 2), rng)
    pattern = sparse.csr_matrix(A)
    with pytest.raises(ZeroDivisionError, match="singular"):
        Factor(Dissection(points, graph, rows, pattern), 0.0 * pattern)


def test_separators_are_thin(rng, small_leaves):
    """A row of 40 x 2 nodes falls apart by cuts of two; the largest front holds a leaf and its two neighbours."""
    points, graph, rows, A = lattice((40, 2, 1), rng)
    plan = Dissection(points, graph, rows, sparse.csr_matrix(A))
    assert max(front.stop - front.start + len(front.border) for front in plan.fronts) <= 3 * (8 + 4)
