"""The renderer: what it covers, hides and lights."""

import numpy as np
import pytest

from morphofold.report.pictures import raster
from morphofold.shapes import icosphere


def test_the_renderer_finds_the_exact_silhouette_of_a_sphere():
    verts, faces = icosphere(4, radius=10.0)
    xyz = np.stack([100 + 8 * verts[:, 0], 100 - 8 * verts[:, 1], verts[:, 2]], axis=1)
    face, b0, b1 = raster.rasterise(xyz, faces, 200, 200, False)
    assert (face >= 0).sum() == pytest.approx(np.pi * 80**2, rel=5e-3)
    front = verts[faces[face[face >= 0]]].mean(axis=1)
    assert front[:, 2].min() > -1  # the far side is hidden
    weights = np.stack([b0, b1, 1 - b0 - b1])[:, face >= 0]
    assert weights.min() > -1e-6


def test_paint_matches_its_formula(rng):
    """The kernel against the same lights written with arrays."""
    verts, faces = icosphere(2, radius=10.0)
    xyz = np.stack([20 + 1.5 * verts[:, 0], 20 - 1.5 * verts[:, 1], verts[:, 2]], axis=1)
    face, b0, b1 = (
        a.astype(np.float64) if a.dtype.kind == "f" else a for a in raster.rasterise(xyz, faces, 40, 40, True)
    )
    rgb = rng.integers(0, 256, verts.shape, dtype=np.uint8)
    got = raster.coloured((face, b0, b1), faces, verts / 10, rgb, 1)
    seen = face >= 0
    weight = np.stack([b0, b1, 1 - b0 - b1], axis=-1)[seen][:, :, None]
    n = (verts[faces[face[seen]]] * weight).sum(axis=1)
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    n *= np.sign(n[:, 2:])
    base = (rgb[faces[face[seen]]] / 255 * weight).sum(axis=1)
    light = 0.26 + 0.44 * np.clip(n @ raster.KEY_LIGHT, 0, None) + 0.36 * n[:, 2]
    want = base * light[:, None] + 0.06 * np.clip(n @ raster.HIGHLIGHT, 0, None)[:, None] ** 24
    image = np.ones((40, 40, 3))
    image[seen] = np.minimum(want, 1)
    np.testing.assert_array_equal(got, np.round(255 * image))
    halved = raster.coloured((face, b0, b1), faces, verts / 10, rgb, 2)
    np.testing.assert_array_equal(halved, np.round(255 * image.reshape(20, 2, 20, 2, 3).mean(axis=(1, 3))))


def test_of_two_triangles_the_nearer_is_seen_in_either_order():
    near = np.array([[2.0, 2, 1], [18, 2, 1], [10, 18, 1]])
    both = np.concatenate([near, near - [0, 0, 5]])
    for faces, nearer in (([[0, 1, 2], [3, 4, 5]], 0), ([[3, 4, 5], [0, 1, 2]], 1)):
        face, _, _ = raster.rasterise(both, np.array(faces), 20, 20, False)
        assert set(np.unique(face)) == {-1, nearer}


def test_faces_that_are_turned_away_change_nothing_on_a_closed_surface():
    verts, faces = icosphere(4, radius=10.0)
    verts = verts * (1 + 0.3 * np.sin(verts[:, :1]))
    xyz = np.stack([40 + 2.5 * verts[:, 0], 40 - 2.5 * verts[:, 1], verts[:, 2]], axis=1)
    for part, whole in zip(*(raster.rasterise(xyz, faces, 80, 80, closed) for closed in (True, False)), strict=True):
        np.testing.assert_array_equal(part, whole)
