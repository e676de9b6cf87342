"""Unfolding: exact bodies, laws of motion, the bounds of a template's hemispheres, refusals."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from morphofold import shapes
from morphofold.errors import BadMesh, Handles, Mismatch, OpenSurface, OutOfRange, SeveralPieces
from morphofold.geometry import face_areas, vertex_areas
from morphofold.io import read_surface, sample_path
from morphofold.studies.shapes import torus
from morphofold.surface import Surface
from morphofold.unfolding.harmonics import SmoothSurface, fit, tangents
from morphofold.unfolding.spheres import sphere_of
from morphofold.unfolding.unfold import quadrature, unfold

AXES = np.array([60.0, 45.0, 40.0])


@pytest.fixture(scope="module")
def sphere():
    return Surface(*shapes.icosphere(4), name="sphere")


@pytest.fixture(scope="module")
def average():
    return tuple(read_surface(sample_path(f"fsaverage5/surf/lh.{name}")) for name in ("white", "sphere"))


def ellipsoid(sphere):
    return Surface(sphere.verts * AXES, sphere.faces, name="ellipsoid")


def test_the_frame_of_an_ellipsoid_is_exact(rng):
    s = rng.standard_normal((500, 3))
    s /= np.linalg.norm(s, axis=1, keepdims=True)
    frame = SmoothSurface(fit(s, s * AXES, np.ones(len(s)), 3)).frame(s)
    normal = s / AXES
    length = np.linalg.norm(normal, axis=1)
    np.testing.assert_allclose(frame.normal, normal / length[:, None], atol=1e-13)
    np.testing.assert_allclose(frame.stretch, AXES.prod() * length, rtol=1e-12)
    gauss = 1 / (AXES.prod() * np.sum((s / AXES) ** 2, axis=1)) ** 2
    np.testing.assert_allclose(frame.curvature.prod(axis=1), gauss, rtol=1e-11)
    assert (frame.curvature > 0).all()  # convex is positive


def test_derivatives_of_position_and_normal_are_those_of_nearby_points(average, rng):
    surface = unfold(*average, 0.03).surface
    s = rng.standard_normal((50, 3))
    s /= np.linalg.norm(s, axis=1, keepdims=True)
    frame, h = surface.frame(s), 1e-5
    for k in range(2):
        t = tangents(s)[:, k]
        ahead, behind = (surface.frame(np.cos(h) * s + side * np.sin(h) * t) for side in (1, -1))
        np.testing.assert_allclose((ahead.position - behind.position) / (2 * h), frame.along[:, k], atol=1e-4)
        np.testing.assert_allclose((ahead.normal - behind.normal) / (2 * h), frame.turning[:, k], atol=1e-4)


def test_an_ellipsoid_unfolds_to_an_ellipsoid(sphere):
    """Its positions have degree 1 alone, which decays by exp(-2 w)."""
    unfolding = unfold(ellipsoid(sphere), sphere, 0.1)
    np.testing.assert_allclose(unfolding.smooth().verts, np.exp(-0.2) * sphere.verts * AXES, atol=1e-9)
    np.testing.assert_allclose(unfolding.area_ratio(), 1, atol=1e-9)


def test_the_radius_is_that_of_the_sphere_of_equal_area(sphere):
    unfolding = unfold(ellipsoid(sphere), sphere, radius=50.0)
    s, weights = quadrature(60)
    assert weights @ unfolding.surface.frame(s).stretch == pytest.approx(4 * np.pi * 50**2, rel=1e-9)
    assert face_areas(unfolding.smooth().verts, sphere.faces).sum() == pytest.approx(4 * np.pi * 50**2, rel=0.01)


def test_quadrature_is_exact_up_to_its_degree():
    s, weights = quadrature(8)
    assert weights.sum() == pytest.approx(4 * np.pi, rel=1e-13)
    assert weights @ (s[:, 2] ** 8) == pytest.approx(4 * np.pi / 9, rel=1e-13)
    assert weights @ (s[:, 0] ** 4 * s[:, 1] ** 4) == pytest.approx(4 * np.pi / 105, rel=1e-12)  # 3!! 3!! / 9!!


def test_a_turned_cortex_unfolds_to_the_turned_surface(average):
    white, sphere = average
    turn = Rotation.from_euler("xyz", [0.3, -1.0, 2.0]).as_matrix()
    smooth = unfold(white, sphere).smooth().verts
    turned = Surface(white.verts @ turn.T, white.faces, name="turned")
    np.testing.assert_allclose(unfold(turned, sphere).smooth().verts, smooth @ turn.T, atol=1e-8)
    other_sphere = Surface(sphere.verts @ turn.T, sphere.faces, name="turned sphere")
    np.testing.assert_allclose(unfold(white, other_sphere).smooth().verts, smooth, atol=1e-6)


@pytest.mark.parametrize("hemi", ["lh", pytest.param("rh", marks=pytest.mark.slow)])
def test_a_template_unfolds_further_from_level_to_level(hemi):
    """Bounds for fsaverage5 with some room: least convex radius over R, and sd of the logarithm of areas."""
    white, sphere = (read_surface(sample_path(f"fsaverage5/surf/{hemi}.{name}")) for name in ("white", "sphere"))
    s, _ = quadrature(60)
    sharpest = []
    for level in (0.02, 0.03, 0.05, 0.08):
        unfolding = unfold(white, sphere, level)
        sharpest.append(1 / unfolding.surface.frame(s).curvature.max() / unfolding.radius)
        area = vertex_areas(unfolding.smooth().verts, white.faces)
        assert np.average(unfolding.area_ratio(), weights=area) == pytest.approx(1, abs=1e-12)
        logarithm = np.log(unfolding.area_ratio())
        spread = np.sqrt(np.average((logarithm - np.average(logarithm, weights=area)) ** 2, weights=area))
        assert 0.28 < spread < 0.37
    assert (np.diff(sharpest) > 0).all()
    assert sharpest[0] > 0.045
    assert sharpest[-1] > 0.13


@pytest.mark.parametrize(("options", "word"), [({"level": 0.001}, "0.001"), ({"radius": -1.0}, "-1")])
def test_values_out_of_range_are_refused(sphere, options, word):
    with pytest.raises(OutOfRange, match=word):
        unfold(ellipsoid(sphere), sphere, **options)


def test_what_is_not_the_sphere_of_the_surface_is_refused(sphere, average):
    white, own = average
    with pytest.raises(Mismatch, match="10,242"):
        unfold(ellipsoid(sphere), own)
    with pytest.raises(BadMesh, match="from the origin"):
        unfold(white, Surface(white.verts, white.faces, name="no sphere"))
    inside_out = white.faces[:, ::-1]
    with pytest.raises(BadMesh, match="clockwise"):
        unfold(Surface(white.verts, inside_out, name="white"), Surface(own.verts, inside_out, name="turned"))
    with pytest.raises(BadMesh):
        unfold(white, Surface(0 * own.verts, white.faces, name="zeros"))
    folded_over = own.coordinates
    folded_over[:, 0] = np.abs(folded_over[:, 0])
    with pytest.raises(BadMesh, match="inside out"):
        unfold(white, Surface(folded_over, white.faces, name="half a sphere"))


def made(name):
    """Surfaces that do not unfold, and why."""
    verts, faces = shapes.icosphere(4)
    if name == "torus":
        ring = torus(40, 20)
        verts, faces = ring.verts, ring.faces
    if name == "two equal":
        verts, faces = np.concatenate([verts, verts + [3.0, 0, 0]]), np.concatenate([faces, faces + len(verts)])
    if name == "open":
        faces = faces[1:]
    shape = {"point": [0, 0, 0], "nearly flat": [40, 40, 1e-3]}
    return Surface(verts * shape.get(name, [40, 30, 30]) + [1.0, 2.0, 3.0], faces, name=name)


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("open", OpenSurface),
        ("torus", Handles),
        ("two equal", SeveralPieces),
        *((name, BadMesh) for name in ("point", "nearly flat")),
    ],
)
def test_what_does_not_unfold_is_refused_with_its_own_code(name, kind):
    surface = made(name)
    directions = surface.verts - [1.0, 2.0, 3.0]
    sphere = Surface(directions / np.maximum(np.linalg.norm(directions, axis=1, keepdims=True), 1e-9), surface.faces)
    for work in (lambda: unfold(surface, sphere), lambda: sphere_of(surface)):
        with pytest.raises(kind) as caught:
            work()
        assert type(caught.value) is kind


def test_torn_and_coarse_surfaces_are_refused(average):
    white, own = average
    with pytest.raises(OpenSurface):
        unfold(Surface(white.verts, white.faces[:-1], name="torn"), Surface(own.verts, white.faces[:-1], name="sphere"))
    coarse = Surface(*shapes.icosphere(2), name="coarse")
    with pytest.raises(BadMesh, match="too few"):
        unfold(ellipsoid(coarse), coarse)
