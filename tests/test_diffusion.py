"""Implicit diffusion on a surface."""

import numba
import numpy as np
import pytest
from scipy import sparse
from scipy.sparse.linalg import spsolve

from morphofold.analysis.diffusion import Diffusion, diffusion
from morphofold.geometry import cotangent_laplacian, vertex_areas
from morphofold.shapes import icosphere, irregular_sphere
from morphofold.studies.shapes import sphere

CLIP = (-5.0, 20.0)


def on(verts, faces):
    return Diffusion(vertex_areas(verts, faces), cotangent_laplacian(verts, faces, clip=CLIP))


@pytest.fixture
def solver():
    return on(*irregular_sphere(4, rng=2))


@pytest.mark.parametrize("time", [0.0, 0.03, 1e3])
@pytest.mark.parametrize("columns", [1, 3])
def test_the_solution_is_that_of_a_direct_solver(solver, time, columns, rng):
    n = len(solver.mass)
    right, start = (rng.standard_normal((n, columns)).squeeze() for _ in range(2))
    right *= solver.mass if columns == 1 else solver.mass[:, None]
    start_before = start.copy()
    matrix = (time * solver.stiffness + sparse.diags_array(solver.mass)).tocsc()
    found = solver.solve(time, right, start, 1e-13)
    np.testing.assert_allclose(found, spsolve(matrix, right), atol=1e-9 * np.abs(found).max())
    np.testing.assert_array_equal(start, start_before)
    rough = solver.solve(time, right, start, 1e-2)
    off = np.linalg.norm(matrix @ rough - right, axis=0) / np.linalg.norm(right, axis=0)
    assert (off <= 1e-2).all()


def test_a_harmonic_of_a_sphere_falls_by_its_eigenvalue():
    verts, faces = icosphere(6, radius=3.0)
    solver, wave = on(verts, faces), verts[:, 0] * verts[:, 1]  # degree 2: L = 6 / r^2
    found = solver.solve(2.0, solver.mass * wave, wave, 1e-12)
    np.testing.assert_allclose(found, wave / (1 + 2.0 * 6 / 9), atol=5e-3 * np.abs(wave).max())


@pytest.mark.slow
def test_the_number_of_iterations_hardly_grows_with_the_mesh(monkeypatch):
    counts = []
    for level in (4, 5, 6):  # 2,562 to 40,962 vertices; the time is 9 to 150 squared edges
        verts, faces = irregular_sphere(level, radius=50.0, rng=2)
        solver, most = on(verts, faces), 1
        while True:
            monkeypatch.setattr("morphofold.analysis.diffusion.MOST_ITERATIONS", most)
            try:
                solver.solve(225.0, solver.mass * verts[:, 0], 0 * verts[:, 0], 1e-6)
                break
            except RuntimeError:
                most += 1
        counts.append(most)
    assert max(counts) <= 20  # without multigrid it doubles with each level
    assert counts[2] <= counts[1] + 3


def test_a_vertex_without_triangles_keeps_its_start_and_pieces_do_not_mix(rng):
    verts, faces = icosphere(2)
    n = len(verts)
    both = np.concatenate([verts, [[9.0, 9.0, 9.0]], verts + 5.0])
    solver = on(both, np.concatenate([faces, faces + n + 1]))
    start = rng.standard_normal(2 * n + 1)
    found = solver.solve(10.0, solver.mass * np.r_[np.ones(n), 7.0, np.full(n, 2.0)], start, 1e-12)
    np.testing.assert_allclose(found, np.r_[np.ones(n), start[n], np.full(n, 2.0)], atol=1e-9)


def test_a_column_that_is_there_before_the_others_stays(solver, rng):
    right = solver.mass * rng.standard_normal(len(solver.mass))
    found = solver.solve(1.0, np.stack([0 * right, right, right], axis=1), np.zeros((len(right), 3)), 1e-8)
    assert (found[:, 0] == 0).all()
    np.testing.assert_array_equal(found[:, 1], found[:, 2])
    np.testing.assert_array_equal(found[:, 1], solver.solve(1.0, right, np.zeros(len(right)), 1e-8))


@pytest.mark.skipif(numba.get_num_threads() < 2, reason="needs two threads")
def test_one_and_two_threads_give_the_same_bytes(solver, rng):
    right, found = rng.standard_normal((len(solver.mass), 3)), []
    for threads in (1, 2):
        numba.set_num_threads(threads)
        found.append(solver.solve(0.5, right, np.zeros(right.shape), 1e-8))
    np.testing.assert_array_equal(*found)


def test_the_levels_of_a_surface_are_built_once():
    surface = sphere(2).surface
    assert diffusion(surface.verts, surface.faces, CLIP) is diffusion(surface.verts, surface.faces, CLIP)
    assert diffusion(surface.verts, surface.faces, (0.0, 3.0)) is not diffusion(surface.verts, surface.faces, CLIP)


def test_what_does_not_converge_is_refused(solver):
    right = np.full(len(solver.mass), np.nan)
    with pytest.raises(RuntimeError, match=r"\b300\b.*\b2562\b"):
        solver.solve(1.0, right, np.zeros(len(right)), 1e-6)
