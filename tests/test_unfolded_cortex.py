"""Bodies made of a subject: layers, held wall, regions, stages, sizes, refusals; the subject is an ellipsoid."""

import json

import numpy as np
import pytest
from made_subjects import AXES, cortex_of, scene_of, write_subject

import morphofold as mf
from morphofold.cli import main
from morphofold.errors import ImpossibleBody, Mismatch, MissingPart, OpenSurface
from morphofold.forecasts.sizes import layers_of, sizes_by_rule, sizes_of
from morphofold.geometry import unit
from morphofold.io import read_annotation, read_label, read_surface, write_morph, write_surface
from morphofold.io.cortices import hemispheres
from morphofold.shapes import icosphere
from morphofold.sim.build import build_bilayer, build_body
from morphofold.sim.scene.scene_files import load_scene
from morphofold.surface import Surface

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


def test_the_pial_surface_has_the_area_of_the_sphere_of_the_scene(tmp_path, subject):
    bilayer = build_bilayer(scene_at(tmp_path, scene_of(subject, geometry="radius = 30.0\nhole_share = 0.3")))
    pial = bilayer.mesh.p.T[: bilayer.n_surface]
    faces = np.concatenate([bilayer.faces[:, [0, 1, 2]], bilayer.faces[:, [0, 2, 3]]])
    area = 0.5 * np.linalg.norm(np.cross(*(pial[faces[:, k]] - pial[faces[:, 0]] for k in (1, 2))), axis=1).sum()
    assert area == pytest.approx(4 * np.pi * 30**2, rel=0.02)  # of flat cells


def test_the_medial_wall_is_held_at_all_depths_and_does_not_grow(tmp_path, subject):
    body = build_body(scene_at(tmp_path, scene_of(subject)))
    bilayer, n = body.bilayer, body.n_surface
    near = read_surface(subject / "surf" / "lh.sphere").verts / 100
    vertex = np.argmax(bilayer.sphere @ near.T, axis=1)
    np.testing.assert_array_equal(bilayer.cortex, cortex_of(near)[vertex])
    held = np.zeros(len(body.X), dtype=bool)
    held[bilayer.held] = True
    np.testing.assert_array_equal(held.reshape(-1, n)[:-1].all(axis=0), ~bilayer.cortex)
    share = bilayer.growing.reshape(-1, n)
    assert (share == share[0]).all()
    assert (share[0, ~bilayer.cortex] == 0).all()
    far = bilayer.sphere[:, 0] < 0
    np.testing.assert_allclose(share[0, far], 1)
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
    names = ("white", "pial", "sphere", "thickness", "curv", "sulc", "area", "white.surf.gii", "pial.surf.gii")
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


def test_a_medial_wall_that_nothing_marks_is_refused_before_a_sphere_is_made(tmp_path, subject, monkeypatch):
    no_labels(subject)
    (subject / "surf" / "lh.sphere").unlink()
    monkeypatch.setattr(
        "morphofold.sim.hemisphere.subject_maps.sphere_of", lambda surface: pytest.fail("was unfolded before")
    )
    with pytest.raises(MissingPart):
        grow(tmp_path, scene_of(subject))


def test_the_cortex_of_a_template_is_held_where_the_subject_has_no_label(tmp_path, subject):
    no_labels(subject)
    write_surface(subject / "surf" / "lh.sphere.reg", read_surface(subject / "surf" / "lh.sphere"))
    run = grow(tmp_path, scene_of(subject, growth="final = 1.0"))
    info = json.loads((next((run.path / "stages").glob("g*")) / "stage.json").read_text())
    assert info["grown_from"]["cortex_mask"] == "template"
    cortex = run.cortex().cortex
    assert 0.85 < (True if cortex is None else cortex.mean()) < 0.97  # of fsaverage5 0.91


def test_a_speck_beside_the_subject_changes_nothing_of_its_body(tmp_path, subject):
    scene = lambda: scene_at(tmp_path, scene_of(subject, geometry='thickness_map = {file = "thickness"}'))
    write_morph(subject / "surf" / "lh.thickness", 2 + cortex_of(icosphere(4)[0]))
    one, (verts, faces) = build_bilayer(scene()), icosphere(1)
    for name, place, radius in (("white", [100.0, 0, 0], 1.5), ("sphere", [0.0, 0, 0], 100.0)):
        surface = read_surface(subject / "surf" / f"lh.{name}")
        both = np.concatenate([surface.faces, faces + len(surface.verts)])
        moved = np.concatenate([surface.verts, radius * verts + place])
        write_surface(subject / "surf" / f"lh.{name}", Surface(moved, both))
    (subject / "label" / "lh.aparc.annot").unlink()
    write_morph(subject / "surf" / "lh.thickness", np.r_[2.0 + cortex_of(icosphere(4)[0]), np.full(len(verts), 9.0)])
    other = build_bilayer(scene())
    np.testing.assert_array_equal(other.mesh.p, one.mesh.p)
    np.testing.assert_array_equal(other.growing, one.growing)


def test_a_body_without_a_medial_wall_holds_its_hole_alone(tmp_path, subject):
    no_labels(subject)
    bilayer = build_bilayer(scene_at(tmp_path, scene_of(subject, geometry='held = "hole"')))
    assert bilayer.growing is None
    assert bilayer.cortex.all()
    assert len(bilayer.held) == bilayer.n_surface


def test_the_command_refuses_a_subject_that_is_not_there_in_one_line(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["simulate", "hemisphere", "--set", "geometry.subject=nobody", "-q"]) == 2
    assert len(capsys.readouterr().err.strip().splitlines()) == 1
    assert not (tmp_path / "hemisphere").exists()
