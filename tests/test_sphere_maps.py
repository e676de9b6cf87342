"""Maps of growth, stiffness and thickness on the sphere of a body, and on the nodes of a mesh."""

import numpy as np
import pytest
from made_subjects import scene_of, write_subject

from morphofold.errors import DoesNotApply, Mismatch, MissingPart, NotFinite, OutOfRange, UnknownName
from morphofold.geometry import face_areas, unit
from morphofold.io import write_morph, write_surface
from morphofold.shapes import icosphere
from morphofold.sim.build import build_bilayer, build_body
from morphofold.sim.effects import build_effects
from morphofold.sim.equilibrium.wrinkle_onset import first_wrinkles
from morphofold.sim.hemisphere.subject_maps import smooth_map
from morphofold.sim.scene.scene_files import load_scene
from morphofold.sim.scene.table_bases import SphereMap
from morphofold.surface import Surface

BALL = 'name = "ball"\n[geometry]\nportion = "octant"\ncortex_thickness = 4.0\n[accuracy]\nedge = 13.0\n'
GROWTH = "[growth]\nfinal = 2.0\n"

pytestmark = pytest.mark.usefixtures("quick_searches")


@pytest.fixture
def template(tmp_path):
    """Writes a map of the points of a template sphere; returns the table that names it."""
    s, faces = icosphere(4)
    write_surface(tmp_path / "lh.sphere", Surface(100 * s, faces))

    def write(of_points):
        write_morph(tmp_path / "lh.map", of_points(s))
        return f"{{file = {str(tmp_path / 'lh.map')!r}, sphere = {str(tmp_path / 'lh.sphere')!r}}}"

    return write


def scene_at(tmp_path, text):
    path = tmp_path / "scene.toml"
    path.write_text(text)
    return load_scene(path)


def prepared_body(scene):
    effects = build_effects(scene)
    body = build_body(scene, effects)
    for effect in effects:
        effect.prepare(body)
    return body


def directions(body):
    """Points of the unit sphere of the bricks of the cortex."""
    X = body.bilayer.mesh.p.T
    return unit(X[body.bilayer.mesh.t[:, : body.elements.n_cortex]].mean(axis=0))


def test_a_map_of_low_degree_is_reproduced_where_it_has_no_values_too():
    s, _ = icosphere(4)
    values = 1 + 0.3 * s[:, 0] - 0.2 * s[:, 1] * s[:, 2]
    masked = np.where(s[:, 2] > 0.9, np.nan, values)
    smoothed = smooth_map(masked, (s, np.ones(len(s))), 2, "map")
    np.testing.assert_allclose(smoothed(s), np.clip(values, np.nanmin(masked), np.nanmax(masked)), atol=2e-3)


def test_values_stay_within_the_range_of_the_map():
    s, _ = icosphere(4)
    step = np.where(s[:, 0] > 0, 2.0, 1.0)
    smoothed = smooth_map(step, (s, np.ones(len(s))), 16, "map")(s)
    assert 1 <= smoothed.min() <= smoothed.max() <= 2
    assert np.abs(smoothed - step)[np.abs(s[:, 0]) > 0.3].max() < 0.15


@pytest.mark.parametrize("table", ["[geometry]\n", '[geometry]\nshape = "ellipsoid"\n'])
def test_the_thickness_follows_a_map_and_has_the_mean_of_the_scene(tmp_path, template, table):
    factor = template(lambda s: 3 * (1 + 0.2 * s[:, 2]))
    text = BALL.replace("[geometry]\n", f"{table}thickness_map = {factor}\n")
    bilayer = build_bilayer(scene_at(tmp_path, text))
    X = bilayer.mesh.p.T
    thickness = np.linalg.norm(X[: bilayer.n_surface] - bilayer.white @ X, axis=1)
    np.testing.assert_allclose(thickness, 4 * (1 + 0.2 * bilayer.sphere[:, 2]), rtol=2e-3)


def test_a_thickness_map_is_kept_within_its_bounds_and_0_is_no_value(tmp_path, template):
    for of_points, least, most in (
        (lambda s: np.where(s[:, 2] > 0, 5.0, 0.1), 4 * 0.6, 4 * 1.5),
        (lambda s: np.where(s[:, 2] > 0.8, 0.0, 2.5), 4.0, 4.0),
    ):
        table = f"thickness_map = {template(of_points)}\ncortex_thickness"
        bilayer = build_bilayer(scene_at(tmp_path, BALL.replace("octant", "full").replace("cortex_thickness", table)))
        X = bilayer.mesh.p.T
        thickness = np.linalg.norm(X[: bilayer.n_surface] - bilayer.white @ X, axis=1)
        assert (thickness.min(), thickness.max()) == pytest.approx((least, most))


def test_a_map_of_factors_multiplies_the_growth(tmp_path, template):
    factor = template(lambda s: 1 + 0.5 * s[:, 2])
    body = prepared_body(scene_at(tmp_path, f"{BALL}{GROWTH}[effects]\ngrowth_map = {factor}\n"))
    np.testing.assert_allclose(body.pattern, 1 + 0.5 * directions(body)[:, 2], atol=0.02)  # bricks are large
    np.testing.assert_allclose(body._stretch(1.5), 1 + 0.5 * body.pattern)


def test_regions_and_maps_multiply(tmp_path, template):
    spots = "spots = [{centre = [0.0, 0.0, 50.0], radius = 1e4, factor = 0.5}]"
    factor = template(lambda s: np.full(len(s), 1.5))
    text = f"{BALL}{GROWTH}[effects]\ngrowth_map = {factor}\n[effects.regional_growth]\n{spots}\n"
    np.testing.assert_allclose(prepared_body(scene_at(tmp_path, text)).pattern, 0.75, rtol=1e-3)


def test_the_weight_of_a_map_follows_its_curve(tmp_path, template):
    table = template(lambda s: 1 + 0.5 * s[:, 2]).replace("}", ", curve = [[1.2, 0], [1.6, 1]]}")
    body = prepared_body(scene_at(tmp_path, f"{BALL}{GROWTH}[effects]\ngrowth_map = {table}\n"))
    factor = (body._stretch(1.8) - 1) / 0.8
    assert np.ptp(factor) > 0.3
    np.testing.assert_allclose(body._stretch(1.1), 1.1)
    np.testing.assert_allclose(body._stretch(1.4), 1 + 0.4 * (1 + 0.5 * (factor - 1)))


def test_a_map_of_area_ratios_gives_areas_in_their_ratio(tmp_path, template):
    table = template(lambda s: 7 * (1 + 0.4 * s[:, 2])).replace("}", ', values = "area ratio"}')
    body = prepared_body(scene_at(tmp_path, f"{BALL}{GROWTH}[effects]\ngrowth_map = {table}\n"))
    ratio = 1 + 0.4 * directions(body)[:, 2]
    np.testing.assert_allclose(body._stretch(2.0) ** 2, 4 * ratio, rtol=0.03)


def test_a_subjects_own_area_ratio_is_that_of_its_surfaces(tmp_path):
    """The white surface has 1.5 times the area above z = 0.5, by waves that heat flow removes."""
    subject = write_subject(tmp_path / "bert")
    s, faces = icosphere(5)
    waves = 1 + 0.035 * np.where(s[:, 2] > 0.3, np.sin(40 * s[:, 0]) * np.sin(40 * s[:, 1]), 0.0)
    write_surface(subject / "surf" / "lh.white", Surface(50 * s * waves[:, None], faces))
    write_surface(subject / "surf" / "lh.sphere", Surface(100 * s, faces))
    for path in (subject / "label").iterdir():
        path.unlink()
    lines = "[effects.growth_map]\nfile = 'area_ratio'\nvalues = 'area ratio'"
    scene = scene_at(tmp_path, scene_of(subject, lines, geometry='held = "hole"', growth="final = 1.5"))
    body = prepared_body(scene)
    z = directions(body)[:, 2]
    area_growth = body._stretch(1.5) ** 2
    whole = icosphere(5)[0] * 50
    area, flat = (face_areas(x, faces) for x in (50 * s * waves[:, None], whole))
    top = s[faces].mean(axis=1)[:, 2] > 0.6
    true = (area[top].sum() / flat[top].sum()) / (area.sum() / flat.sum())
    assert area_growth[z > 0.75].mean() / 1.5**2 == pytest.approx(true, rel=0.06)
    assert area_growth[z < 0].mean() < area_growth[z > 0.75].mean()


def test_folds_are_expected_earlier_where_a_map_grows_more(tmp_path, template):
    plain = scene_at(tmp_path, BALL + GROWTH)
    doubled = scene_at(tmp_path, f"{BALL}{GROWTH}[effects]\ngrowth_map = {template(lambda s: np.full(len(s), 2.0))}\n")
    assert first_wrinkles(doubled).growth - 1 == pytest.approx((first_wrinkles(plain).growth - 1) / 2)


def test_a_stiffness_map_of_2_is_a_cortex_twice_as_stiff(tmp_path, template):
    twice = template(lambda s: np.full(len(s), 2.0))
    mapped = prepared_body(scene_at(tmp_path, f"{BALL}{GROWTH}[effects]\nstiffness_map = {twice}\n"))
    stiff = prepared_body(scene_at(tmp_path, f"{BALL}{GROWTH}[material]\nmu_ratio = 2.0\n"))
    np.testing.assert_allclose(mapped.mu, stiff.mu, rtol=1e-6)
    for body in (mapped, stiff):
        body.grow(1.3)
    ours, theirs = mapped.forces(mapped.X), stiff.forces(stiff.X)
    np.testing.assert_allclose(ours, theirs, atol=1e-5 * np.abs(theirs).max())


@pytest.mark.parametrize(
    ("effect", "of_points", "error"),
    [
        ("growth_map", lambda s: s[:, 0] - 2, OutOfRange),
        ("growth_map", lambda s: np.full(len(s), 20.0), OutOfRange),
        ("growth_map", lambda s: np.full(len(s), np.nan), NotFinite),
        ("growth_map", lambda s: np.ones(len(s) - 1), Mismatch),
        ("stiffness_map", lambda s: s[:, 0], OutOfRange),
    ],
)
def test_maps_that_make_no_sense_are_refused(tmp_path, template, effect, of_points, error):
    with pytest.raises(error):
        prepared_body(scene_at(tmp_path, f"{BALL}{GROWTH}[effects]\n{effect} = {template(of_points)}\n"))


def test_a_map_without_a_sphere_of_too_high_degree_and_curves_that_run_back_are_refused(tmp_path, template):
    table = template(lambda s: np.ones(len(s)))
    with pytest.raises(ValueError, match="40"):
        SphereMap(file="map", degree=41)
    alone = table.split(", sphere")[0] + "}"
    with pytest.raises(MissingPart):
        prepared_body(scene_at(tmp_path, f"{BALL}{GROWTH}[effects]\ngrowth_map = {alone}\n"))
    back = table.replace("}", ", curve = [[1.6, 0], [1.2, 1]]}")
    with pytest.raises(OutOfRange):
        scene_at(tmp_path, f"{BALL}{GROWTH}[effects]\ngrowth_map = {back}\n")
    ratio = f'{table[:-1]}, values = "area ratio"}}'
    with pytest.raises(DoesNotApply):
        scene_at(tmp_path, f"{BALL}[growth]\nfinal = 1.0\n[effects]\ngrowth_map = {ratio}\n")


def test_point_data_of_a_mesh_are_maps_too(tmp_path):
    import meshio

    from morphofold.sim.mesh.brick_mesh import bilayer_sphere
    from morphofold.studies.speed.solver_speed import cut_bricks

    mesh = cut_bricks(bilayer_sphere(50.0, 6.0, 25.0, "full", 8)).mesh
    x = mesh.p.T
    data = {"slow": 1 - 0.4 * (x[:, 2] > 0)}
    meshio.Mesh(x, [("tetra", mesh.t.T)], point_data=data).write(tmp_path / "ball.vtu")
    text = f"name = 'ball'\n[geometry]\nshape = 'mesh'\nfile = {str(tmp_path / 'ball.vtu')!r}\ncortex_thickness = 6.0\n"
    body = prepared_body(scene_at(tmp_path, f"{text}held = 'inner'\n{GROWTH}[effects.growth_map]\nfile = 'slow'\n"))
    z = body.bilayer.mesh.p.T[body.bilayer.mesh.t[:, : body.elements.n_cortex]][:, :, 2]
    np.testing.assert_allclose(body.pattern, (1 - 0.4 * (z > 0)).mean(axis=0))
    with pytest.raises(UnknownName):
        prepared_body(scene_at(tmp_path, f"{text}held = 'inner'\n{GROWTH}[effects.growth_map]\nfile = 'fast'\n"))
