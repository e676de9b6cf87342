"""Clusters on a mesh, and threshold-free cluster enhancement."""

import numpy as np
import pytest

from morphofold.analysis import smooth
from morphofold.errors import WrongShape
from morphofold.geometry import vertex_areas
from morphofold.group.clusters import Mesh, clusters, tfce
from morphofold.shapes import icosphere, irregular_sphere


@pytest.fixture(scope="module")
def ball():
    verts, faces = irregular_sphere(4, radius=50.0, rng=1)
    noise = np.random.default_rng(2).standard_normal(len(verts))
    values = smooth(verts, faces, noise, 15.0)
    return Mesh(faces, vertex_areas(verts, faces)), values / values.std()


def by_steps(values, mesh, steps):
    """The integral as a sum over thresholds, in the middle of each step."""
    top, found = values.max(), np.zeros(len(values))
    for h in (np.arange(steps) + 0.5) * top / steps:
        cluster, areas = clusters(values, h, mesh)
        inside = cluster >= 0
        found[inside] += areas[cluster[inside]] * h**2 * top / steps
    return found


def test_it_is_the_limit_of_sums_over_thresholds(ball):
    mesh, values = ball
    exact = tfce(values, mesh)
    errors = [
        np.abs(by_steps(values, mesh, steps) - np.maximum(exact, 0)).max() / exact.max() for steps in (50, 100, 200)
    ]
    assert errors[2] < 0.01
    assert errors[2] < 0.7 * errors[1] < 0.5 * errors[0]


def test_a_single_cluster_of_one_height_has_its_closed_form():
    verts, faces = icosphere(4, radius=50.0)
    mesh = Mesh(faces, vertex_areas(verts, faces))
    cap = verts[:, 2] > 30
    found = tfce(np.where(cap, 2.5, 0.0), mesh)
    np.testing.assert_allclose(found[cap], mesh.areas[cap].sum() * 2.5**3 / 3, rtol=1e-12)
    assert (found[~cap] == 0).all()


def test_two_peaks_share_what_is_below_their_pass():
    verts, faces = icosphere(4, radius=50.0)
    mesh = Mesh(faces, vertex_areas(verts, faces))
    z = verts[:, 2]
    values = np.where(z > 30, 3.0, np.where(z > 0, 1.0, np.where(z > -20, 2.0, 0.0)))
    total = mesh.areas[z > -20].sum() / 3
    found = tfce(values, mesh)
    np.testing.assert_allclose(found[z > 30], total + mesh.areas[z > 30].sum() * (27 - 1) / 3, rtol=1e-12)
    np.testing.assert_allclose(found[(z <= 30) & (z > 0)], total, rtol=1e-12)
    low = (z <= 0) & (z > -20)
    np.testing.assert_allclose(found[low], total + mesh.areas[low].sum() * (8 - 1) / 3, rtol=1e-12)


def test_signs_order_and_unknown_values(ball, rng):
    mesh, values = ball
    found = tfce(values, mesh)
    np.testing.assert_allclose(tfce(-values, mesh), -found, atol=1e-12 * found.max())
    np.testing.assert_array_equal(found > 0, values > 0)
    gaps = rng.random(len(values)) < 0.1
    np.testing.assert_array_equal(tfce(np.where(gaps, np.nan, values), mesh), tfce(np.where(gaps, 0.0, values), mesh))
    np.testing.assert_allclose(tfce(3 * values, mesh), 27 * found, atol=1e-11 * found.max())


def test_it_depends_little_on_the_mesh():
    of = lambda verts: np.exp(-((verts[:, 2] - 50.0) ** 2) / 200.0)
    tops = []
    for verts, faces in (icosphere(4, radius=50.0), icosphere(5, radius=50.0), irregular_sphere(5, radius=50.0, rng=3)):
        tops.append(tfce(of(verts), Mesh(faces, vertex_areas(verts, faces))).max())
    np.testing.assert_allclose(tops, tops[1], rtol=0.03)


def test_clusters_are_connected_and_have_their_areas():
    verts, faces = icosphere(4, radius=50.0)
    mesh = Mesh(faces, vertex_areas(verts, faces))
    values = np.abs(verts[:, 2]) / 50.0  # two caps
    cluster, areas = clusters(values, 0.5, mesh)
    assert len(areas) == 2
    np.testing.assert_allclose(areas, 2 * np.pi * 50.0**2 * 0.5, rtol=0.05)
    assert (cluster[values <= 0.5] == -1).all()
    assert len(set(cluster[verts[:, 2] > 26])) == 1
    values[verts[:, 2] > 0] = np.nan
    assert len(clusters(values, 0.5, mesh)[1]) == 1
    assert len(clusters(values, 2.0, mesh)[1]) == 0


def test_a_map_of_another_mesh_is_refused(ball):
    with pytest.raises(WrongShape):
        tfce(np.zeros(5), ball[0])
