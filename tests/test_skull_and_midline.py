"""The walls around a hemisphere: a skull around the hull of any body, with a gap that may grow, and the midline."""

from dataclasses import replace
from types import SimpleNamespace

import numba
import numpy as np
import pytest
from made_subjects import scene_of, write_subject
from scipy.spatial import ConvexHull

import morphofold as mf
from morphofold.analysis import gyrification_index
from morphofold.errors import DoesNotApply, ImpossibleBody
from morphofold.sim.body import Body
from morphofold.sim.dynamics import Dynamics
from morphofold.sim.effects import build_effects
from morphofold.sim.effects.midline import Midline
from morphofold.sim.effects.skull import HullSkull, Skull, grown_volume_of
from morphofold.sim.mesh.brick_mesh import bilayer_ellipsoid, cube_directions
from morphofold.sim.rigid_shells import EllipsoidShell, HullShell
from morphofold.sim.rigid_walls import medial_plane
from morphofold.sim.scene.scene_files import load_scene
from morphofold.sim.stage_checks import enclosed_volume
from morphofold.threads import using_threads

AXES = np.array([30.0, 50.0, 40.0])


def bilayer(axes=AXES, n=8, portion="full", **parts):
    return replace(bilayer_ellipsoid(axes, 3.0, 0.4, portion, n, 2), **parts)


def body_of(mesh, law="tangential"):
    return Body(mesh, mu_cortex=1.0, mu_core=1.0, kappa_ratio=50.0, law=law)


def forces(effect, body, x, v=None):
    extra = np.zeros((body.n_surface, 3))
    effect.add_forces(body, x, np.zeros_like(x) if v is None else v, extra)
    return extra


# --- the skull


@pytest.mark.slow
def test_a_sphere_in_the_shell_of_a_hull_lies_as_in_the_analytic_one():
    ball = 50 * cube_directions(48)[0]
    radii, energies = [], []
    for shell in (EllipsoidShell(np.full(3, 50.0)), HullShell(ball, 1.0)):
        body, skull = body_of(bilayer(np.full(3, 50.0), 12, "octant"), "isotropic"), Skull(shell, lambda g: 1.0)
        run = Dynamics(body, [skull], steps_per_unit=1000)
        run.grow_to(1.15)
        run.relax(200)
        radii.append(np.linalg.norm(run.state.x[: body.n_surface], axis=1))
        energies.append(skull.energy())
        assert skull.record()["pressed"] == body.n_surface
    assert radii[0].min() > 51
    np.testing.assert_allclose(radii[1], radii[0], atol=0.05)
    assert energies[1] == pytest.approx(energies[0], rel=0.25)


def test_the_hull_of_a_part_is_that_of_the_whole_body(rng):
    depths = []
    for portion in ("full", "octant"):
        skull, body = HullSkull(lambda g: 2.0, 1.0), body_of(bilayer(portion=portion))
        skull.prepare(body)
        x = 1.1 * AXES * np.abs(rng.standard_normal((50, 3)))
        depths += (depth for depth, _ in skull.depths(body, np.array([[33.0, 1.0, 1.0], [1.0, 40.0, 30.0]]), 2))
        assert all(np.isfinite(depth).all() for depth, _ in skull.depths(body, x, 50))
    np.testing.assert_allclose(*depths, atol=1e-9)


def test_the_gap_of_a_scene_grows_linearly():
    scene = load_scene("ellipsoid", ["growth.final=1.4", "effects.skull={gap = 4.5, gap_final = 12.5}"])
    (skull,) = (effect for effect in build_effects(scene) if effect.name == "skull")
    for g, gap in ((1.0, 4.5), (1.1, 6.5), (1.4, 12.5)):
        body = SimpleNamespace(mass=np.ones(3), growth=g)
        for beyond, pressed in ((gap - 0.01, 0), (gap + 0.01, 3)):
            x, extra = np.diag(np.array([60.0, 45.0, 40.0]) + beyond), np.zeros((3, 3))
            skull.add_forces(body, x, np.zeros_like(x), extra)
            assert skull.record()["pressed"] == pressed


def test_a_body_follows_a_skull_that_grows():
    body, gap = body_of(bilayer(np.full(3, 50.0), 8, "octant"), "isotropic"), lambda g: 0.2 + 6 * (g - 1)
    skull = Skull(EllipsoidShell(np.full(3, 50.0)), gap)
    run, outside = Dynamics(body, [skull], steps_per_unit=1000), []

    def record(state):
        beyond = np.linalg.norm(state.x[: body.n_surface], axis=1) - 50 - gap(state.growth)
        outside.append((beyond.max(), skull.record()["pressed"]))

    run.grow_to(1.2, record)
    beyond, pressed = np.array(outside).T
    assert beyond.max() < 0.05 * body.cell
    assert pressed[-1] == body.n_surface
    assert np.linalg.norm(run.state.x[: body.n_surface], axis=1).min() > 51


@pytest.mark.parametrize(("law", "power", "portion"), [("isotropic", 3, "full"), ("tangential", 2, "octant")])
def test_the_volume_of_a_grown_body_is_that_of_its_layers(law, power, portion):
    body = body_of(bilayer(np.full(3, 50.0), 24, portion), law)
    body.core_share = 0.2
    for g in (1.0, 1.2, 1.5):
        layers = 20**3 + (1 + 0.2 * (g - 1)) ** 3 * (47**3 - 20**3) + g**power * (50**3 - 47**3)
        assert grown_volume_of(body)(g) == pytest.approx(4 / 3 * np.pi * layers, rel=0.01)


def room_for(body, g):
    """Gap [mm] of the ball that holds what the grown body fills, around the ball of the body's own volume."""
    fills = grown_volume_of(body)
    return (fills(g) / (4 / 3 * np.pi)) ** (1 / 3) - (fills(1.0) / (4 / 3 * np.pi)) ** (1 / 3)


def test_a_hull_without_room_for_the_grown_body_is_refused():
    """The share of the growth at each node counts: a medial wall does not grow."""
    mesh = bilayer(np.full(3, 50.0))
    mesh = replace(mesh, growing=np.full(len(mesh.share), 0.5))
    body = body_of(mesh)
    room = room_for(body, 1.5)
    assert 0 < room < 6
    HullSkull(lambda g: room + 0.1, 1.5).prepare(body)
    with pytest.raises(ImpossibleBody, match=r"\bg = 1\.5\b") as refused:
        HullSkull(lambda g: room - 0.1, 1.5).prepare(body)
    assert float(str(refused.value).split(" mm, or")[0].split()[-1]) == pytest.approx(room, abs=0.1)


@pytest.mark.slow
def test_a_midline_takes_its_part_of_the_room():
    body = body_of(bilayer())
    room = room_for(body, 1.5)
    HullSkull(lambda g: 1.3 * room, 1.5, gap_of_midline=1.3 * room).prepare(body)
    with pytest.raises(ImpossibleBody):
        HullSkull(lambda g: 1.3 * room, 1.5, gap_of_midline=-0.3 * AXES[0]).prepare(body)


@pytest.mark.parametrize(
    ("scene", "settings"),
    [
        ("demo", ["effects.midline={}"]),
        ("ellipsoid", ["effects.midline={}"]),
        ("mesh", ["effects.midline={}"]),
        ("patch", ["effects.skull={}"]),
        ("skull", ["growth.final=1", "output.stages=[]", "effects.skull.gap_final=3"]),
    ],
)
def test_walls_that_do_not_apply_are_refused(scene, settings):
    with pytest.raises(DoesNotApply):
        load_scene(scene, settings)


# --- the midline


@pytest.mark.parametrize(("hemi", "side"), [("lh", 1), ("rh", -1)])
def test_the_midline_lies_its_gap_beside_the_medial_side(hemi, side):
    body = body_of(bilayer(hemi=hemi))
    plane = medial_plane(body.bilayer, 0.5)
    assert (plane.axis, plane.side) == (0, -side)
    assert plane.at == pytest.approx(side * (AXES[0] + 0.5))
    midline = Midline(0.5)
    midline.prepare(body)
    for beyond, pressed in ((0.49, False), (0.51, True)):
        force = forces(midline, body, body.X + [side * beyond, 0, 0])
        assert np.any(force) == pressed == (midline.record()["pressed"] > 0) == (midline.energy() > 0)
        assert (side * force[:, 0] <= 0).all()
        assert not force[:, 1:].any()  # no friction


def test_the_midline_leaves_held_nodes_alone():
    mesh = bilayer()
    medial = np.flatnonzero(mesh.mesh.p[0, : mesh.n_surface] > 20)
    body = body_of(replace(mesh, held=np.union1d(mesh.held, medial)))
    midline = Midline(0.0)
    midline.prepare(body)
    force = forces(midline, body, body.X + [15.0, 0, 0])
    assert not force[medial].any()
    assert force[body.X[: body.n_surface, 0].argsort()[-len(medial) - 1]].any()


def test_a_body_that_grows_does_not_cross_its_midline():
    """The largest distance beyond the plane at any measurement, with the midline and without."""

    def farthest(effects):
        body, beyond = body_of(bilayer(), "isotropic"), []
        at = medial_plane(body.bilayer, 0.3).at
        run = Dynamics(body, effects, steps_per_unit=1000)
        run.grow_to(1.25, lambda state: beyond.append(state.x[: body.n_surface, 0].max() - at))
        return max(beyond) / body.cell

    assert farthest([Midline(0.3)]) < 0.03
    assert farthest([]) > 0.15


# --- both


def walls():
    return [HullSkull(lambda g: 0.2 + 6 * (g - 1), 1.0), Midline(0.1)]


@pytest.mark.parametrize("which", [0, 1])
def test_the_force_of_a_wall_is_the_slope_of_its_energy(which, rng):
    """Taylor test: what is left of the first order falls with the square of the step."""
    body, wall = body_of(bilayer()), walls()[which]
    wall.prepare(body)
    x = 1.05 * body.X + 0.1 * rng.standard_normal(body.X.shape)
    direction = rng.standard_normal(x.shape)
    slope = -np.sum(forces(wall, body, x) * direction[: body.n_surface])
    first = wall.energy()
    assert first > 0
    steps, rest = 2.0 ** -np.arange(10, 16), []
    for h in steps:
        forces(wall, body, x + h * direction)
        rest.append(abs(wall.energy() - first - h * slope))
    assert np.polyfit(np.log(steps), np.log(rest), 1)[0] == pytest.approx(2, abs=0.1)


@pytest.mark.slow
@pytest.mark.skipif(numba.get_num_threads() < 2, reason="needs two threads")
def test_a_run_between_walls_resumes_with_the_same_bytes_on_another_number_of_threads():
    whole, begun, resumed = (Dynamics(body_of(bilayer(), "isotropic"), walls(), steps_per_unit=1000) for _ in range(3))
    with using_threads(1):
        whole.grow_to(1.06)
        whole.grow_to(1.12)
    with using_threads(2):
        begun.grow_to(1.06)
        resumed.load(begun.save())
        resumed.grow_to(1.12)
    records = [run.state.record["effects"] for run in (whole, resumed)]
    assert records[0] == records[1]
    assert all(record["pressed"] > 0 for record in records[0].values())
    np.testing.assert_array_equal(whole.state.x, resumed.state.x)


def hemisphere(tmp_path, hemi, *walls):
    """A scene of an ellipsoid as one hemisphere of a subject."""
    subject, file = write_subject(tmp_path / "bert", hemi), tmp_path / "own.toml"
    file.write_text(scene_of(subject, *walls, geometry=f'hemi = "{hemi}"', growth="final = 1.2"))
    return load_scene(file)


@pytest.mark.parametrize("hemi", ["lh", pytest.param("rh", marks=pytest.mark.slow)])
def test_a_hemisphere_grows_between_its_walls(tmp_path, quick_searches, hemi):
    """The medial wall does not grow, so it stays where it is; the rest presses on both walls and stays within."""
    skull, side = "[effects.skull]\ngap = 0.2\ngap_final = 3.5", 1 if hemi == "lh" else -1
    scene = hemisphere(tmp_path, hemi, skull, "[effects.midline]\ngap = 0.1", "[effects.contact]")
    last = []
    run = mf.simulate(scene, tmp_path / "run", after=lambda run: last.append((run.state.x, run.body)))
    x, body = last[-1]
    n = body.n_surface
    plane = medial_plane(body.bilayer, 0.1)
    assert plane.at == pytest.approx(0.1 * side + side * (side * body.X[:n, 0]).max(), abs=0.01)
    assert (side * (x[:n, 0] - plane.at)).max() < 0.03 * body.cell
    out, normal = np.zeros(n), np.zeros((n, 3))
    HullShell(body.X[:n], 3.5).measure(x, 3.5, out, normal)
    assert -0.5 < out.max() < 0.03 * body.cell
    assert set(run.health["effects"]) == {"skull", "midline", "contact"}


@pytest.mark.slow
def test_a_hemisphere_without_room_is_refused_before_anything_is_written(tmp_path, quick_searches):
    scene = hemisphere(tmp_path, "lh", "[effects.skull]\ngap = 1.0")
    with pytest.raises(ImpossibleBody):
        mf.simulate(scene, tmp_path / "run")
    assert not (tmp_path / "run").exists()


# --- what the walls are for


def flare(cortex):
    """Area of the convex hull over that of the sphere of the same volume as the body: 1 for a sphere.

    Folds do not change it; a body that flares like a leaf has a hull that is large for its volume.
    """
    pial = cortex.pial
    return ConvexHull(pial.verts).area / (36 * np.pi * enclosed_volume(pial) ** 2) ** (1 / 3)


@pytest.mark.slow
def test_between_its_walls_a_thick_hemisphere_folds_and_without_them_it_flares(tmp_path):
    """A cortex of 0.07 of the radius that grows along the surface by 1.75, on 54,000 bricks, a little coarser than
    draft."""
    results = {}
    for name, settings in (("free", ["effects={contact={}, perturbation={}}"]), ("walls", [])):
        run = mf.simulate("hemisphere-thick", tmp_path / name, settings=["accuracy.edge=3.0", *settings])
        cortex = run.cortex()
        results[name] = flare(cortex), gyrification_index(cortex.pial.verts, cortex.faces), run.health["stages"][-1]
    first = 1.18  # the flare of the body before it grows
    assert results["free"][0] > 1.25 * first
    assert results["walls"][0] < 1.08 * first
    assert results["free"][1] < 1.25
    assert results["walls"][1] > 1.45
    assert results["free"][2]["bending"] > 2 * results["walls"][2]["bending"]
    assert all(stage["crossings"] == 0 for _, _, stage in results.values())
