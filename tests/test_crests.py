"""Crest lines: where symmetry puts them, and none on cyclides."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from morphofold.analysis import crests, curvature
from morphofold.analysis.crests import crest_lines
from morphofold.analysis.graph.curve_net import resampled
from morphofold.errors import OptionsClash
from morphofold.geometry import mean_edge_length, vertex_normals
from morphofold.studies.known_shapes import bumpy_sphere, cylinder, ellipsoid, sphere, torus, with_noise


def test_the_ridges_of_an_ellipsoid_lie_in_its_planes_of_symmetry():
    shape = ellipsoid(5, (60.0, 40.0, 25.0), rng=3)
    crest_set = crest_lines(shape.verts, shape.faces)
    assert crest_set.length("gyral") > 100
    for line in crest_set.of_kind("gyral"):
        away = np.abs(line.points / [60.0, 40.0, 25.0]).min(axis=1)
        assert np.median(away) < 0.01  # of a semi-axis
        assert line.mean_H > 0
        assert line.strength > 0
    assert crest_set.of_kind("sulcal") == []


def test_a_surface_turned_inside_out_has_its_ridges_as_valleys():
    shape = bumpy_sphere(4)
    out, reversed_lines = (crest_lines(shape.verts, faces) for faces in (shape.faces, shape.faces[:, ::-1]))
    for kind, other in (("gyral", "sulcal"), ("sulcal", "gyral")):
        assert 0 < out.length(kind) == pytest.approx(reversed_lines.length(other), rel=0.01)


@pytest.mark.parametrize("shape", [sphere(5, rng=1), torus(rng=1), cylinder()], ids=lambda shape: shape.name)
@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_cyclides_have_none(shape, noise):
    noisy = with_noise(shape, noise)
    edge = mean_edge_length(noisy.verts, noisy.faces)
    assert crest_lines(noisy.verts, noisy.faces, scale=4 * edge).lines == []


def test_extremality_is_the_derivative_of_the_curvature_along_its_direction():
    """On an ellipsoid, between vertices that lie along d1 of the first."""
    shape = ellipsoid(6, (60.0, 40.0, 25.0))
    curv = curvature(shape.verts, shape.faces)
    i, j = shape.faces[:, 0], shape.faces[:, 1]
    step = shape.verts[j] - shape.verts[i]
    length = np.linalg.norm(step, axis=1)
    along = np.sum(step * shape.d1[i], axis=1)
    straight = (np.abs(along) > 0.995 * length) & (shape.k1[i] - shape.k2[i] > 0.01)
    i, j, along = i[straight], j[straight], along[straight]
    turn = np.sign(np.sum(curv.d1[i] * shape.d1[i], axis=1))
    other = np.sign(np.sum(curv.d1[j] * shape.d1[i], axis=1))
    slope = (shape.k1[j] - shape.k1[i]) / along
    own = 0.5 * (turn * curv.e1[i] + other * curv.e1[j])
    assert len(slope) > 50
    assert np.corrcoef(slope, own)[0, 1] > 0.99
    assert np.polyfit(slope, own, 1)[0] == pytest.approx(1, abs=0.1)


@pytest.fixture(scope="module")
def exact():
    """Crest lines of the bumpy sphere from its exact curvature: points a fifth of a mm apart, by kind.

    Their own error is about a fifth of an edge of their mesh, so it is the finest here.
    """
    shape = bumpy_sphere(7, rng=77)
    d2 = np.cross(vertex_normals(shape.verts, shape.faces, "max"), shape.d1)
    i, j = np.concatenate([shape.faces[:, [a, b]] for a in range(3) for b in range(3) if a != b]).T
    points = {}
    for kind, k, other, along, across in (
        ("gyral", shape.k1, shape.k2, shape.d1, d2),
        ("sulcal", -shape.k2, -shape.k1, d2, shape.d1),
    ):
        step = shape.verts[j] - shape.verts[i]
        u = np.stack([np.sum(step * along[i], axis=1), np.sum(step * across[i], axis=1)], axis=1)
        normal, right = np.zeros((len(k), 2, 2)), np.zeros((len(k), 2))
        np.add.at(normal, i, u[:, :, None] * u[:, None, :])
        np.add.at(right, i, u * (k[j] - k[i])[:, None])
        e = np.linalg.solve(normal, right[:, :, None])[:, 0]
        distance = 6.0 if kind == "gyral" else -6.0
        lines = crests._trace_lines(shape.verts, shape.faces, k, other, along, e * along, distance)
        points[kind] = np.concatenate([resampled(line, 0.2) for line, length, _, _ in lines if length > 10])
    return points


@pytest.mark.slow
@pytest.mark.parametrize(("level", "noise", "scale"), [(5, 0.0, 6.0), (6, 0.0, 3.0), (6, 0.01, 5.0)])
def test_the_crests_of_a_bumpy_sphere_are_found_and_nothing_else(exact, level, noise, scale):
    """Of 10 mm and more; what is shorter is near the scale. Found within two edges of a coarse mesh."""
    shape = bumpy_sphere(level, rng=1)
    shape = with_noise(shape, noise) if noise else shape
    edge = mean_edge_length(shape.verts, shape.faces)
    crest_set = crest_lines(shape.verts, shape.faces, scale=scale)
    away, left = [], []
    for kind in crests.CREST_KINDS:
        own = np.concatenate([resampled(line.points, 0.2) for line in crest_set.of_kind(kind)])
        away.append(cKDTree(exact[kind]).query(own)[0])
        left.append(cKDTree(own).query(exact[kind])[0])
    away, left = np.concatenate(away), np.concatenate(left)
    assert np.mean(away > 4) < 0.04
    assert np.mean(left > 4) < 0.005
    assert np.median(away) < 0.2 * edge


def swept(edge, radius=2.0, wall=4.0, tilt=75.0, ridges=4, length=30.0):
    """Sheet of gyri and sulci that are arcs of ``tilt`` degrees to either side, with straight walls between: curvature
    is constant on the caps and 0 on the walls. Also the places across (x) of crowns and fundi."""
    half = np.radians(tilt)
    pieces = [(wall / 2, 0.0)]
    for sign in (-1.0, 1.0) * ridges:
        pieces += [(2 * half * radius, sign / radius), (wall, 0.0)]
    steps = [(size / n, bend) for size, bend in pieces for n in [round(size / edge)] for _ in range(n)]
    x, z, angle, curve = 0.0, 0.0, half, [(0.0, 0.0)]  # begins on a wall that climbs to a crown
    for step, bend in steps:
        x, z = x + step * np.cos(angle + 0.5 * bend * step), z + step * np.sin(angle + 0.5 * bend * step)
        angle += bend * step
        curve.append((x, z))
    curve = np.array(curve)
    y = np.linspace(0, length, round(length / edge) + 1)
    verts = np.column_stack([np.repeat(curve[:, 0], len(y)), np.tile(y, len(curve)), np.repeat(curve[:, 1], len(y))])
    i = np.arange(len(verts)).reshape(len(curve), len(y))
    a, b, c, d = (part.ravel() for part in (i[:-1, :-1], i[1:, :-1], i[1:, 1:], i[:-1, 1:]))
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    top = np.flatnonzero(np.diff(np.sign(np.diff(curve[:, 1]))))  # z turns there
    turns = curve[top + 1, 0]
    return verts, faces, {"gyral": turns[::2], "sulcal": turns[1::2]}


def test_round_caps_between_straight_walls_have_a_crest_along_their_middle(rng):
    """Their curvature does not fall away by its cube, but is gone a scale further on."""
    edge, length, noise = 0.5, 30.0, 0.01
    verts, faces, middles = swept(edge, length=length)
    crest_set = crest_lines(verts + noise * edge * rng.standard_normal(verts.shape), faces, scale=3.0)
    for kind, middle in middles.items():
        assert len(middle) == 4
        lines = crest_set.of_kind(kind)
        points = np.concatenate([resampled(line.points, 0.2) for line in lines])
        away = np.abs(points[:, :1] - middle).min(axis=1)
        inner = (points[:, 1] > 3) & (points[:, 1] < length - 3)
        assert np.quantile(away[inner], 0.95) < edge
        for x in middle:  # all along, but near the borders
            covered = points[np.abs(points[:, 0] - x) < 2 * edge, 1]
            assert np.diff(np.sort(np.concatenate([[3.0, length - 3], covered[(covered > 3)]]))).max() < 2


def test_vertices_without_curvature_do_not_make_crests_of_a_cylinder(rng):
    noisy = with_noise(cylinder(), 0.01)
    near = noisy.verts[::7] * [0.9, 0.9, 1.0]  # that no face uses
    verts = np.concatenate([noisy.verts, near])
    edge = mean_edge_length(noisy.verts, noisy.faces)
    assert crest_lines(verts, noisy.faces, scale=4 * edge).lines == []


def test_scale_and_curvature_are_not_both_taken():
    shape = sphere(3)
    with pytest.raises(OptionsClash, match=r"\bscale\b.*\bcurv\b"):
        crest_lines(shape.verts, shape.faces, scale=10.0, curv=curvature(shape.verts, shape.faces))
