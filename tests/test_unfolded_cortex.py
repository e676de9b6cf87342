"""Bodies under smooth surfaces and of a subject: even cells, layers, held wall, regions, stages, sizes, refusals."""

import json

import numpy as np
import pytest
from made_subjects import AXES, cortex_of, scene_of, write_subject

import morphofold as mf
from morphofold.errors import ImpossibleBody, Mismatch, MissingPart, OpenSurface
from morphofold.forecasts.sizes import layers_of, sizes_by_rule, sizes_of
from morphofold.geometry import unit
from morphofold.io import read_annotation, read_label, read_surface, sample_path, write_surface
from morphofold.io.cortices import hemispheres
from morphofold.shapes import icosphere
from morphofold.sim.build import build_bilayer, build_body
from morphofold.sim.hemisphere import hemisphere_body
from morphofold.sim.hemisphere.hemisphere_body import scaled_jacobians, smooth_body
from morphofold.sim.mesh.brick_mesh import cube_directions
from morphofold.sim.scene.scene_files import load_scene
from morphofold.surface import Surface
from morphofold.unfolding.harmonics import SmoothSurface, fit
from morphofold.unfolding.unfold import unfold

T = 4.0

pytestmark = pytest.mark.usefixtures("quick_searches")


@pytest.fixture
def subject(tmp_path):
    return write_subject(tmp_path / "bert")


def scene_at(tmp_path, text):
    path = tmp_path / "own.toml"
    path.write_text(text)
    return load_scene(path)


def grow(tmp_path, text, **options):
    return mf.simulate(scene_at(tmp_path, text), tmp_path / "run", **options)


def semi_axes(scene):
    """The ellipsoid of harmonics up to degree 1, smoothed by the flow, and scaled to the area of the scene."""
    body = build_bilayer(scene)
    pial = body.mesh.p.T[: body.n_surface]
    return np.sqrt(1 / np.linalg.lstsq(pial**2, np.ones(len(pial)), rcond=None)[0])


def test_the_body_of_an_ellipsoid_is_that_ellipsoid_with_a_cortex_of_even_thickness(tmp_path, subject):
    scene = scene_at(tmp_path, scene_of(subject))
    bilayer = build_bilayer(scene)
    n = bilayer.n_surface
    pial, white = bilayer.mesh.p.T[:n], bilayer.white @ bilayer.mesh.p.T
    axes = semi_axes(scene)
    np.testing.assert_allclose(axes / axes[0], AXES / AXES[0], rtol=1e-6)  # degree 1 only: heat flow scales it
    np.testing.assert_allclose(pial, bilayer.sphere * axes, atol=1e-5 * axes[0])
    normal = unit(pial / axes**2)
    np.testing.assert_allclose(white, pial - T * normal, atol=1e-4)
    np.testing.assert_allclose(np.linalg.norm(bilayer.sphere, axis=1), 1)
    assert bilayer.closed
    assert bilayer.portion == 1


def test_the_medial_wall_is_held_at_all_depths_and_does_not_grow(tmp_path, subject):
    body = build_body(scene_at(tmp_path, scene_of(subject)))
    bilayer, n = body.bilayer, body.n_surface
    near = read_surface(subject / "surf" / "lh.sphere").verts / 100
    vertex = np.argmax(bilayer.sphere @ near.T, axis=1)
    np.testing.assert_array_equal(bilayer.cortex, cortex_of(near)[vertex])
    fixed = np.zeros(len(body.X), dtype=bool)
    fixed[bilayer.held] = True
    np.testing.assert_array_equal(fixed.reshape(-1, n)[:-1].all(axis=0), ~bilayer.cortex)
    growth = bilayer.growing.reshape(-1, n)
    assert (growth == growth[0]).all()
    assert (growth[0, ~bilayer.cortex] == 0).all()
    far = bilayer.sphere[:, 0] < 0
    np.testing.assert_allclose(growth[0, far], 1)
    corners = bilayer.mesh.t[:, : body.elements.n_cortex]
    np.testing.assert_allclose(body.pattern, bilayer.growing[corners].mean(axis=0))


def test_before_it_grows_no_force_moves_the_body(tmp_path, subject):
    """Forces are in single precision."""
    body = build_body(scene_at(tmp_path, scene_of(subject)))
    body.grow(1.0)
    at_rest = np.abs(body.all_forces(body.X)).max()
    body.grow(1.01)
    assert at_rest < 1e-5 * np.abs(body.all_forces(body.X)).max()


def test_sizes_are_counted_without_building_the_body(tmp_path, subject):
    scene = scene_at(tmp_path, scene_of(subject))
    bilayer = build_bilayer(scene)
    counted, built = sizes_by_rule(scene, layers_of(bilayer)), sizes_of(bilayer)
    assert counted.elements == built.elements
    assert counted.nodes == built.nodes
    assert counted.vertices == built.vertices
    assert scene.bricks == pytest.approx(built.elements, rel=0.5)


def test_a_stage_is_a_subject_of_its_own_hemisphere_and_knows_the_person(tmp_path):
    hemi = "rh"
    subject = write_subject(tmp_path / "bert", hemi)
    run = grow(tmp_path, scene_of(subject, geometry=f'hemi = "{hemi}"'))
    surf = run.path / "stages" / "g1.04" / "surf"
    names = ("white", "pial", "sphere", "thickness", "curv", "sulc", "area")
    assert {path.name for path in surf.iterdir()} == {f"{hemi}.{name}" for name in names}
    cortex = run.cortex()
    assert cortex.hemi == hemi
    assert hemispheres(run.path) == (hemi,)
    assert mf.read_cortex(run.path).hemi == hemi
    points = cortex.sphere.verts / 100
    np.testing.assert_allclose(np.linalg.norm(points, axis=1), 1, rtol=1e-6)
    np.testing.assert_array_equal(
        cortex.cortex, read_label(surf.parent / "label" / f"{hemi}.cortex.label", len(points))
    )
    away = np.abs(points[:, 2]) > 0.1  # of the border of the regions
    np.testing.assert_array_equal(cortex.regions.labels[away], (points[away, 2] > 0))
    assert cortex.regions.names == read_annotation(subject / "label" / f"{hemi}.aparc.annot").names
    grown_from = cortex.info["grown_from"]
    assert grown_from["unfold"] == 0.03
    person = mf.read_cortex(*[write_pial(subject, hemi)], hemi=hemi)
    white = next(row for row in person.inputs if row["path"].endswith(f"{hemi}.white"))
    assert grown_from["sha256"]["surface"] == white["sha256"]
    wall = ~cortex.cortex
    first = build_bilayer(run.scene)
    np.testing.assert_allclose(cortex.pial.verts[wall], first.mesh.p.T[: first.n_surface][wall], atol=1e-5)


def test_a_stage_knows_which_maps_its_body_was_given(tmp_path):
    subject = write_subject(tmp_path / "bert", thickness=lambda s: 2.5 + 0.2 * s[:, 2])
    maps = 'thickness_map = {file = "thickness"}'
    growth = "[effects.growth_map]\nfile = 'area_ratio'\nvalues = 'area ratio'"
    run = grow(tmp_path, scene_of(subject, growth, geometry=maps))
    assert run.cortex().info["grown_from"]["maps"] == ["thickness_map", "growth_map"]


def write_pial(subject, hemi):
    white = read_surface(subject / "surf" / f"{hemi}.white")
    write_surface(subject / "surf" / f"{hemi}.pial", Surface(1.1 * white.verts, white.faces))
    return subject


def test_a_run_is_not_continued_on_files_that_changed(tmp_path, subject):
    text = scene_of(subject)
    run = grow(tmp_path, text)
    assert grow(tmp_path, text, resume=True).health == run.health
    write_subject(subject, axes=AXES * [1.0, 1.0, 1.1])
    with pytest.raises(Mismatch):
        grow(tmp_path, text, resume=True)


def torn(subject):
    for name in ("white", "sphere"):
        surface = read_surface(subject / "surf" / f"lh.{name}")
        write_surface(subject / "surf" / f"lh.{name}", Surface(surface.verts, surface.faces[1:]))


def other_sphere(subject):
    s, faces = icosphere(3)
    write_surface(subject / "surf" / "lh.sphere", Surface(100 * s, faces))


def no_labels(subject):
    for path in (subject / "label").iterdir():
        path.unlink()


@pytest.mark.parametrize(
    ("spoil", "geometry", "error"),
    [
        (torn, "", OpenSurface),
        (other_sphere, "", Mismatch),
        (no_labels, "", MissingPart),
        (lambda subject: None, "radius = 20.0\nhole_share = 0.6", ImpossibleBody),
        (lambda subject: None, 'thickness_map = {file = "thickness"}', FileNotFoundError),
        (lambda subject: None, 'sphere = "sphere.reg"', FileNotFoundError),
    ],
)
def test_a_subject_that_cannot_grow_is_refused_and_nothing_is_written(tmp_path, subject, spoil, geometry, error):
    spoil(subject)
    with pytest.raises(error):
        grow(tmp_path, scene_of(subject, geometry=geometry))
    assert not (tmp_path / "run").exists()


def test_the_cortex_of_a_template_is_held_where_the_subject_has_no_label(tmp_path, subject):
    no_labels(subject)
    write_surface(subject / "surf" / "lh.sphere.reg", read_surface(subject / "surf" / "lh.sphere"))
    run = grow(tmp_path, scene_of(subject, growth="final = 1.0"))
    info = json.loads((next((run.path / "stages").glob("g*")) / "stage.json").read_text())
    assert info["grown_from"]["cortex_mask"] == "template"
    cortex = run.cortex().cortex
    assert 0.85 < (True if cortex is None else cortex.mean()) < 0.97  # of fsaverage5 0.91


def test_a_body_without_a_medial_wall_holds_its_hole_alone(tmp_path, subject):
    no_labels(subject)
    bilayer = build_bilayer(scene_at(tmp_path, scene_of(subject, geometry='held = "hole"')))
    assert bilayer.growing is None
    assert bilayer.cortex.all()
    assert len(bilayer.held) == bilayer.n_surface


ELLIPSOID = np.array([60.0, 45.0, 40.0])
THICKNESS, LAYERS = 2.5, 3


@pytest.fixture
def ellipsoid():
    s, _ = cube_directions(16)
    return SmoothSurface(fit(s, s * ELLIPSOID, np.ones(len(s)), 3))


def levels_of(bilayer):
    return bilayer.mesh.p.T.reshape(-1, bilayer.n_surface, 3)


def edges_of(bilayer):
    pial = levels_of(bilayer)[0]
    return np.linalg.norm(pial[bilayer.faces] - pial[np.roll(bilayer.faces, -1, axis=1)], axis=2)


def test_layers_of_an_ellipsoid_lie_along_its_exact_normals(quick_searches, ellipsoid):
    bilayer = smooth_body(ellipsoid, THICKNESS, THICKNESS, 0.25).bricks(12, LAYERS)
    levels = levels_of(bilayer)
    pial = levels[0]
    np.testing.assert_allclose(np.sum((pial / ELLIPSOID) ** 2, axis=1), 1, atol=1e-12)
    normal = pial / ELLIPSOID**2
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    np.testing.assert_allclose(bilayer.radial[: bilayer.n_surface], normal, atol=1e-12)
    for k in range(LAYERS + 1):
        np.testing.assert_allclose(levels[k], pial - k * THICKNESS / LAYERS * normal, atol=1e-10)
    np.testing.assert_allclose(bilayer.white @ bilayer.mesh.p.T, pial - THICKNESS * normal, atol=1e-10)
    assert bilayer.edge == pytest.approx(edges_of(bilayer).max())
    assert set(bilayer.held) == set(range(bilayer.mesh.nvertices - bilayer.n_surface, bilayer.mesh.nvertices))


def test_cells_of_an_ellipsoid_are_evener_than_those_of_straight_directions(quick_searches, ellipsoid):
    directions, quads = cube_directions(16)
    unevenness = []
    for s in (directions, unit(directions + hemisphere_body.even_cells(ellipsoid, THICKNESS)(directions))):
        pial = ellipsoid(s)
        edge = np.linalg.norm(pial[quads] - pial[np.roll(quads, -1, axis=1)], axis=2)
        unevenness.append(edge.max() / edge.mean())
    assert unevenness[1] < 1.3 < unevenness[0]


def test_the_gradient_of_the_search_for_even_cells_is_exact(ellipsoid, rng):
    directions, quads = cube_directions(6)
    excess = hemisphere_body._excess(ellipsoid, 6.0, directions, quads)
    point, direction = 1e-3 * rng.standard_normal((2, 3 * (hemisphere_body.SHIFT_DEGREE + 1) ** 2))
    slope = (excess(point + 1e-4 * direction, 3)[0] - excess(point - 1e-4 * direction, 3)[0]) / 2e-4
    assert excess(point, 3)[1] @ direction == pytest.approx(slope, rel=1e-5)


def test_the_gradient_of_the_search_for_good_bricks_is_exact(rng):
    directions, quads = cube_directions(4)
    levels = np.linspace(1, 0.4, 4)[:, None, None] * directions + 0.02 * rng.standard_normal((4, len(directions), 3))
    sizes, heights = np.full(4, 0.3), np.full((3, len(directions)), 0.2)
    slope, direction, h = np.zeros(levels.shape), rng.standard_normal(levels.shape), 1e-6

    def total(x):
        return hemisphere_body._sum_misshape(x, quads, sizes, heights, 2.0, 0.1, np.zeros(x.shape))

    hemisphere_body._sum_misshape(levels, quads, sizes, heights, 2.0, 0.1, slope)
    assert np.sum(slope * direction) == pytest.approx(
        (total(levels + h * direction) - total(levels - h * direction)) / (2 * h), rel=1e-5
    )


def test_scaled_jacobians_are_1_for_right_angles_and_negative_inside_out():
    square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], dtype=float)
    levels = np.stack([np.column_stack([square, np.full(4, z)]) for z in (1.0, 0.0)])
    quads = np.array([[0, 1, 2, 3]])
    assert scaled_jacobians(levels, quads) == pytest.approx(1)
    assert scaled_jacobians(levels[::-1].copy(), quads) == pytest.approx(-1)
    levels[0, :, 0] += 1  # sheared by 45 degrees
    assert scaled_jacobians(levels, quads) == pytest.approx(0.5**0.5)


def test_a_finer_mesh_keeps_the_points_of_the_coarser_one(quick_searches, ellipsoid):
    body = smooth_body(ellipsoid, THICKNESS, THICKNESS, 0.25)
    coarse, fine = (body.points(cube_directions(n)[0]) for n in (6, 12))
    distance = np.linalg.norm(coarse[:, None] - fine[None], axis=2).min(axis=1)
    assert distance.max() < 1e-12


def test_a_cortex_too_thick_for_its_bends_or_its_hole_is_refused(quick_searches, ellipsoid):
    with pytest.raises(ImpossibleBody, match="radius"):
        smooth_body(ellipsoid, 25.0, 25.0, 0.3)
    with pytest.raises(ImpossibleBody, match="hole"):
        smooth_body(ellipsoid, 5.0, 5.0, 0.7)


@pytest.mark.slow
@pytest.mark.parametrize(("hemi", "level", "thickness"), [("rh", 0.03, 2.5), ("lh", 0.08, 4.0)])
def test_bricks_of_a_template_are_even_and_well_shaped_at_every_size(hemi, level, thickness, monkeypatch):
    """The study's mesh: longest over mean edge 1.85, scaled Jacobians 0.61 in the cortex and 0.21 in the core."""
    monkeypatch.undo()  # a whole search, not a quick one
    white, sphere = (read_surface(sample_path(f"fsaverage5/surf/{hemi}.{name}")) for name in ("white", "sphere"))
    body = smooth_body(unfold(white, sphere, level, radius=50.0).surface, thickness, thickness, 0.25)
    for n in (24, 60):
        bilayer = body.bricks(n, LAYERS)
        shape = scaled_jacobians(levels_of(bilayer), bilayer.faces)
        assert shape[:LAYERS].min() > 0.6
        assert shape[LAYERS:].min() > 0.2
        edge = edges_of(bilayer)
        assert edge.max() < 1.4 * edge.mean()
