"""Unfolding, spherical harmonics and the command: exact bodies, laws of motion, files, refusals."""

import json
import shutil

import numpy as np
import pytest
from commands import refused
from scipy.spatial.transform import Rotation
from scipy.special import sph_harm_y
from threadpoolctl import threadpool_limits

from morphofold import shapes
from morphofold.cli import main
from morphofold.errors import BadMesh, Handles, Mismatch, OpenSurface, OutOfRange, SeveralPieces, WrongShape
from morphofold.geometry import face_areas, vertex_areas
from morphofold.io import read_morph, read_surface, sample_path, write_surface
from morphofold.studies.known_shapes import torus
from morphofold.surface import Surface
from morphofold.tables import read_table
from morphofold.unfolding.harmonics import Expansion, SmoothSurface, degrees, fit, harmonics, tangents
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
    rotated = Surface(white.verts @ turn.T, white.faces, name="turned")
    np.testing.assert_allclose(unfold(rotated, sphere).smooth().verts, smooth @ turn.T, atol=1e-8)
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


FAULTS = {"open": OpenSurface, "torus": Handles, "two equal": SeveralPieces, "point": BadMesh, "nearly flat": BadMesh}


@pytest.mark.parametrize(("name", "kind"), FAULTS.items())
def test_what_does_not_unfold_is_refused_with_its_own_code(name, kind):
    surface = made(name)
    directions = surface.verts - [1.0, 2.0, 3.0]
    sphere = Surface(directions / np.maximum(np.linalg.norm(directions, axis=1, keepdims=True), 1e-9), surface.faces)
    for work in (lambda: unfold(surface, sphere), lambda: sphere_of(surface)):
        with pytest.raises(kind) as caught:
            work()
        assert type(caught.value) is kind


def test_a_surface_with_too_few_vertices_is_refused():
    coarse = Surface(*shapes.icosphere(2), name="coarse")
    with pytest.raises(BadMesh, match="too few"):
        unfold(ellipsoid(coarse), coarse)


@pytest.fixture
def points(rng):
    s = np.vstack([rng.standard_normal((300, 3)), np.eye(3), -np.eye(3)])  # poles and axes, too
    return s / np.linalg.norm(s, axis=1, keepdims=True)


def test_harmonics_are_those_of_scipy(points):
    theta, phi = np.arccos(points[:, 2]), np.arctan2(points[:, 1], points[:, 0])
    ours = harmonics(points, 9)
    for l in range(10):
        for m in range(l + 1):
            theirs = (-1) ** m * sph_harm_y(l, m, theta, phi) * (1 if m == 0 else np.sqrt(2))
            np.testing.assert_allclose(ours[:, l * l + l + m], theirs.real, atol=1e-13)
            if m:
                np.testing.assert_allclose(ours[:, l * l + l - m], theirs.imag, atol=1e-13)


def test_the_gradient_of_a_solid_harmonic_polynomial_is_exact(points):
    """x y z is solid of degree 3, x^2 - y^2 of degree 2, z of degree 1."""
    x, y, z = points.T
    function = fit(points, np.column_stack([x * y * z + x**2 - y**2, z]), np.ones(len(points)), 4)
    gradient = function.gradient()(points).reshape(-1, 2, 3)
    first = np.column_stack([y * z + 2 * x, x * z - 2 * y, x * y])
    np.testing.assert_allclose(gradient[:, 0], first, atol=1e-12)
    np.testing.assert_allclose(gradient[:, 1], np.broadcast_to([0, 0, 1], first.shape), atol=1e-12)
    assert not Expansion(np.ones((1, 2))).gradient()(points).any()  # of a constant


def test_a_fit_returns_the_expansion_that_it_was_given(points, rng):
    expansion = Expansion(rng.standard_normal((49, 3)))
    fitted = fit(points, expansion(points), rng.uniform(0.5, 2, len(points)), 6)
    np.testing.assert_allclose(fitted.coefficients, expansion.coefficients, atol=1e-10)


def test_heat_flow_lets_each_degree_decay_at_its_own_rate(rng):
    expansion = Expansion(rng.standard_normal((36, 1)))
    ratio = expansion.smoothed(0.03).coefficients / expansion.coefficients
    l = degrees(5)
    np.testing.assert_allclose(ratio[:, 0], np.exp(-0.03 * l * (l + 1)), rtol=1e-13)


def test_too_few_points_are_refused(points):
    with pytest.raises(WrongShape):
        fit(points[:20], points[:20], np.ones(20), 6)


def test_fits_and_values_have_the_same_bits_for_any_number_of_threads(rng):
    s = rng.standard_normal((20_000, 3))
    s /= np.linalg.norm(s, axis=1, keepdims=True)
    results = []
    for threads in (1, 2):
        with threadpool_limits(threads, "blas"):
            shape = fit(s, s**2, np.ones(len(s)), 20)
            results.append((shape.coefficients, shape(s)))
    for first, second in zip(*results):
        np.testing.assert_array_equal(first, second)


EGG = [3.0, 2.0, 2.0]


@pytest.fixture
def subject(cwd):
    """A copy of the sample with the files that unfolding reads."""
    source = sample_path("fsaverage5")
    for folder, names in (("surf", ("white", "sphere")), ("label", ("aparc.annot", "cortex.label"))):
        (cwd / "subject" / folder).mkdir(parents=True)
        for name in names:
            shutil.copy(source / folder / f"lh.{name}", cwd / "subject" / folder)
    return cwd / "subject"


def test_an_unfolding_has_surfaces_maps_tables_and_a_page_the_same_each_time(subject, cwd, capsys):
    argv = ["unfold", "subject", "--level", "0.05", "--radius", "50", "-q"]
    assert main([*argv, "-o", "out"]) == 0
    printed, out = capsys.readouterr().out, cwd / "out"
    assert main([*argv, "-o", "again"]) == 0
    files = {str(p.relative_to(out)): p.read_bytes() for p in out.rglob("*") if p.is_file()}
    assert files == {name: (cwd / "again" / name).read_bytes() for name in files}
    assert set(files) == {
        *(f"surf/lh.{name}" for name in ("smooth", "sphere", "area_ratio")),
        *("unfold.tsv", "regions.tsv", "report.html", "figures/area_ratio.png", "summary.json", ".morphofold"),
    }
    white, sphere = (read_surface(subject / "surf" / f"lh.{name}") for name in ("white", "sphere"))
    unfolded = unfold(white, sphere, 0.05, radius=50)
    smooth = read_surface(out / "surf" / "lh.smooth")
    np.testing.assert_allclose(smooth.verts, unfolded.smooth().verts, atol=1e-4)
    np.testing.assert_array_equal(smooth.faces, white.faces)
    np.testing.assert_allclose(read_morph(out / "surf" / "lh.area_ratio"), unfolded.area_ratio(), rtol=1e-6)
    assert np.linalg.norm(read_surface(out / "surf" / "lh.sphere").verts, axis=1) == pytest.approx(100, abs=1e-4)
    (row,) = read_table(out / "unfold.tsv", ["hemi"])
    assert row["radius_mm"] == pytest.approx(50)
    assert row["area_mm2"] == pytest.approx(vertex_areas(smooth.verts, smooth.faces).sum(), rel=1e-6)
    assert row["crossings"] == 0
    assert f"{row['folded_area_mm2']:,.0f} mm2" in printed
    summary = json.loads((out / "summary.json").read_text())
    assert set(summary["hemispheres"][0]) == set(summary["columns"])
    assert {record["path"].rpartition("/")[2] for record in summary["inputs"]} == {
        *("lh.white", "lh.sphere", "lh.aparc.annot", "lh.cortex.label")
    }
    rows = read_table(out / "regions.tsv", ["hemi", "region"])
    for column in ("folded_percent", "smooth_percent"):
        assert sum(row[column] for row in rows) <= 100 + 1e-3  # but for vertices without a region
    ratios = [row["folded_percent"] / row["smooth_percent"] for row in rows]
    assert [row["area_ratio"] for row in rows] == pytest.approx(ratios, rel=1e-5)


def test_a_closed_surface_without_a_sphere_gets_one_and_its_name_steers_no_terminal(cwd, capsys):
    verts, faces = shapes.icosphere(4)
    write_surface(cwd / "a\x1b[31m\nb.off", Surface(verts * EGG, faces))
    assert main(["unfold", "a\x1b[31m\nb.off", "-o", "o\nut", "-q", "--level", "0.01"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert (len(lines), all(line.isprintable() for line in lines)) == (2, True)
    out = cwd / "o\nut"
    assert not (out / "regions.tsv").exists()
    assert json.loads((out / "summary.json").read_text())["notes"] == {"lh": {}}  # none on a medial wall
    np.testing.assert_allclose(np.linalg.norm(read_surface(out / "surf/lh.sphere").verts, axis=1), 100, atol=1e-4)
    size = np.ptp(read_surface(out / "surf/lh.smooth").verts, axis=0)
    assert size[0] / size[1] == pytest.approx(1.5, rel=0.05)


@pytest.mark.slow
def test_both_hemispheres_of_the_sample(cwd):
    assert main(["unfold", str(sample_path("fsaverage5")), "-o", "out", "-q", "--json"]) == 0
    assert [row["hemi"] for row in read_table(cwd / "out" / "unfold.tsv", ["hemi"])] == ["lh", "rh"]


def with_island(path, centre, radius):
    """A surface with a ball beside it, in the same file."""
    surface, (verts, faces) = read_surface(path), shapes.icosphere(2)
    faces = np.concatenate([surface.faces, faces + len(surface.verts)])
    write_surface(path, Surface(np.concatenate([surface.verts, radius * verts + centre]), faces))


def test_a_speck_is_left_out_and_changes_no_number(subject):
    (subject / "label" / "lh.cortex.label").rename(subject / "label" / "other")
    (subject / "label" / "lh.aparc.annot").unlink()
    assert main(["unfold", "subject", "-o", "one", "-q"]) == 0
    with_island(subject / "surf" / "lh.white", [150.0, 0, 0], 2.0)
    with_island(subject / "surf" / "lh.sphere", [0.0, 0, 0], 100.0)
    assert main(["unfold", "subject", "-o", "two", "-q"]) == 0
    clean, specked = (json.loads((subject.parent / name / "summary.json").read_text()) for name in ("one", "two"))
    assert clean["hemispheres"] == specked["hemispheres"]
    assert "repair" in specked["notes"]["lh"]
    assert "repair" not in clean["notes"]["lh"]
    n = 10242
    ratio, before = (read_morph(subject.parent / name / "surf" / "lh.area_ratio") for name in ("two", "one"))
    assert len(before) == n < len(ratio)  # at the vertices of the file
    np.testing.assert_array_equal(ratio[:n], before)
    assert (ratio[n:] == 0).all()
    smooth, before = (read_surface(subject.parent / name / "surf" / "lh.smooth") for name in ("two", "one"))
    np.testing.assert_array_equal(smooth.verts[:n], before.verts)
    np.testing.assert_array_equal(smooth.faces, before.faces)


def without_sphere(subject):
    for file in ("surf/lh.sphere", "label/lh.aparc.annot", "label/lh.cortex.label"):
        (subject / file).unlink()
    return subject / "surf" / "lh.white"


@pytest.mark.parametrize(
    ("spoil", "options", "word"),
    [
        (lambda s: with_island(without_sphere(s), [200.0, 0, 0], 20.0), "-o out", "[several-pieces]"),
        (lambda s: None, "-o out --sphere sphere.reg", "lh.sphere.reg"),
        (lambda s: shutil.copy(s / "surf" / "lh.white", s / "surf" / "lh.sphere"), "-o out", "from the origin"),
        (lambda s: None, "-o out --radius=-2", "radius"),
        (lambda s: None, "-o subject", "subject"),
    ],
)
def test_bad_input_is_refused_in_one_line_and_nothing_is_written(subject, cwd, capsys, spoil, options, word):
    spoil(subject)
    before = sorted(cwd.rglob("*"))
    refused(capsys, ["unfold", "subject", "-q", *options.split()], word)
    assert sorted(cwd.rglob("*")) == before
