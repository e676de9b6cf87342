"""Spheres for closed surfaces that have none: one-to-one, even, and refused where there is none."""

import numpy as np
import pytest

from morphofold import shapes
from morphofold.errors import OpenSurface
from morphofold.geometry import face_areas, face_vectors, vertex_areas
from morphofold.io import read_surface, sample_path
from morphofold.surface import Surface
from morphofold.unfolding import spheres
from morphofold.unfolding.spheres import _round, sphere_of
from morphofold.unfolding.unfold import unfold


def dumbbell():
    verts, faces = shapes.icosphere(4)
    return Surface(verts * (1 + 0.8 * verts[:, :1] ** 2) * [2.0, 1.0, 1.0], faces, name="dumbbell")


def covers_once(sphere):
    """Whether no face is turned over and the area is that of the sphere."""
    facing = np.einsum("fi,fi->f", face_vectors(sphere.verts, sphere.faces), sphere.verts[sphere.faces[:, 0]])
    area = face_areas(sphere.verts, sphere.faces).sum()
    return bool((facing > 0).all()) and area == pytest.approx(4 * np.pi, rel=0.01)


def test_a_sphere_stays_what_it_is_up_to_a_turn():
    verts, faces = shapes.icosphere(4)
    found = sphere_of(Surface(3 * verts + [1.0, 2.0, 3.0], faces, name="moved"))
    np.testing.assert_allclose(found.verts @ found.verts[0], verts @ verts[0], atol=0.02)


def test_the_limit_of_the_flow_is_conformal(monkeypatch):
    """Angles of triangles on the sphere are those of the ellipsoid, the nearer the finer its mesh is."""
    monkeypatch.setattr(spheres, "ROUND", 1e-5)
    monkeypatch.setattr(spheres, "STANDSTILL", 1.0)
    monkeypatch.setattr(spheres, "COTANGENTS", (-20.0, 20.0))  # positive ones, for safety, change angles a little
    errors = []
    for level in (3, 4, 5):
        verts, faces = shapes.icosphere(level)
        surface = Surface(verts * [1.6, 1.0, 0.8], faces, name="ellipsoid")
        before, after = (angles(x, faces) for x in (surface.verts, _round(surface, lambda *_: None)))
        errors.append(np.abs(after - before).mean())
    assert errors[2] < errors[1] < errors[0]
    assert errors[2] < 1  # degree


def angles(verts, faces):
    a, b, c = (verts[np.roll(faces, k, axis=1)] for k in range(3))
    u, v = b - a, c - a
    cosine = np.sum(u * v, axis=2) / np.linalg.norm(u, axis=2) / np.linalg.norm(v, axis=2)
    return np.degrees(np.arccos(cosine))


def test_a_dumbbell_gets_a_sphere_with_even_areas():
    surface = dumbbell()
    sphere = sphere_of(surface)
    assert covers_once(sphere)
    ratio = vertex_areas(surface.verts, surface.faces) / vertex_areas(sphere.verts, sphere.faces)
    assert np.std(np.log(ratio)) < 0.15
    flow = _round(surface, lambda *_: None)
    assert np.std(np.log(vertex_areas(surface.verts, surface.faces) / vertex_areas(flow, surface.faces))) > 0.3


@pytest.mark.slow
def test_a_cortex_unfolds_without_its_sphere_nearly_as_with_it():
    white, own = (read_surface(sample_path(f"fsaverage5/surf/lh.{name}")) for name in ("white", "sphere"))
    sphere = sphere_of(white)
    assert covers_once(sphere)
    one, other = (unfold(white, s, 0.05, radius=50.0) for s in (own, sphere))
    apart = np.linalg.norm(one.smooth().verts - other.smooth().verts, axis=1)
    assert np.median(apart) < 10


def test_an_open_surface_is_refused():
    surface = dumbbell()
    with pytest.raises(OpenSurface):
        sphere_of(Surface(surface.verts, surface.faces[1:], name="torn"))
