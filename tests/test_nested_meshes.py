"""A run on two nested meshes: states come over exactly enough, and the run is one run."""

import json

import numpy as np
import pytest

from morphofold.sim.build import build_body
from morphofold.sim.dynamics import Dynamics, UnstableError
from morphofold.sim.effects import Effect, build_effects
from morphofold.sim.mesh.brick_mesh import SYMMETRY_AXES, bilayer_patch, bilayer_sphere, cube_grids, cube_surface
from morphofold.sim.nested_meshes import NestedDynamics, carried, carry
from morphofold.sim.run import simulate
from morphofold.sim.scene import LEVELS
from morphofold.sim.scene.scene_files import load_scene

SMALL = ["geometry.portion=octant", "accuracy.level=fine", "geometry.cortex_thickness=7", "growth.final=1.6"]
SHORT_WINDOW_END = 1.02


def smooth_field(bilayer):
    """A smooth vector at each node: of place across the surface, times a line of the depth in each layer."""
    points = bilayer.mesh.p.T
    x, y, z = (points / np.ptp(points, axis=0).max()).T
    return np.column_stack([np.sin(3 * x + y), np.cos(2 * y - z), x * y * np.exp(z)])


@pytest.mark.parametrize("portion", [*SYMMETRY_AXES])
def test_the_grids_of_a_cube_have_all_its_points_and_follow_its_lines(portion):
    axes = SYMMETRY_AXES[portion]
    lattice, quads = cube_surface(8, axes)
    grids = cube_grids(8, axes)
    assert len(grids) == 6 - len(axes)
    assert np.array_equal(np.unique(np.concatenate([grid.ravel() for grid in grids])), np.arange(len(lattice)))
    assert sum((grid.shape[0] - 1) * (grid.shape[1] - 1) for grid in grids) == len(quads)
    for grid in grids:
        for steps in (lattice[grid[1:]] - lattice[grid[:-1]], lattice[grid[:, 1:]] - lattice[grid[:, :-1]]):
            assert (np.abs(steps).sum(axis=-1) == 1).all()


def test_a_field_comes_over_with_fourth_order_across_the_surface_and_exactly_to_its_own_mesh():
    meshes = [bilayer_sphere(50.0, 3.0, 25.0, "half", n) for n in (16, 32, 44)]
    fields = [smooth_field(mesh)[: mesh.n_surface] for mesh in meshes]
    target = meshes[-1]
    errors = []
    for mesh, field in zip(meshes, fields):
        on_all_layers = np.tile(field, (len(mesh.mesh.p.T) // mesh.n_surface, 1))
        errors.append(np.abs(carried(mesh, target, on_all_layers)[: target.n_surface] - fields[-1]).max())
    assert np.log2(errors[0] / errors[1]) > 3.3
    assert errors[2] < 1e-13


def test_what_is_linear_in_depth_comes_over_exactly_whatever_the_layers():
    source, target = (bilayer_patch((8.0, 6.0), 10.0, 1.0, edge, layers) for edge, layers in ((1.0, 3), (0.4, 4)))
    lines = lambda mesh: mesh.mesh.p.T @ np.array([[1.0, 0.2, 0], [0.3, 1.0, 0], [0.1, 0.4, 2.0]])
    np.testing.assert_allclose(carried(source, target, lines(source)), lines(target), atol=1e-12)


def test_a_carried_state_keeps_its_energy_planes_and_held_nodes():
    scenes = [load_scene("demo", ["geometry.portion=octant", f"accuracy.edge={edge}"]) for edge in (6.0, 4.0)]
    effects = [build_effects(scene) for scene in scenes]
    coarse, fine = (Dynamics.of(s, build_body(s, own), own) for s, own in zip(scenes, effects))
    coarse.grow_to(1.1)
    coarse.hold(12)
    carry(coarse.body, coarse.state, fine)
    body, state = fine.body, fine.state
    assert (state.growth, state.lowest_J) == (1.1, coarse.state.lowest_J)
    assert state.record["strain_energy"] == pytest.approx(coarse.state.record["strain_energy"], rel=3e-3)
    assert all((state.x[body.on_plane[:, p.axis], p.axis] == p.at).all() for p in body.bilayer.planes)
    assert np.array_equal(state.x[body.bilayer.held], body.X[body.bilayer.held])


@pytest.fixture(autouse=True)
def short_window(monkeypatch):
    """The window of the fine mesh ends soon after first contact, so that small bodies come to its end."""
    monkeypatch.setattr("morphofold.sim.nested_meshes.WINDOW_END", SHORT_WINDOW_END)


@pytest.fixture(scope="module")
def nested_run(tmp_path_factory):
    scene = load_scene("fig7-ratio1", [*SMALL, "output.stages=[1.2,1.4,1.55]"])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("morphofold.sim.nested_meshes.WINDOW_END", SHORT_WINDOW_END)
        return simulate(scene, tmp_path_factory.mktemp("nested") / "run", threads=1)


def test_the_fine_mesh_grows_only_between_the_first_wrinkles_and_soon_after_contact(nested_run):
    log = [json.loads(line) for line in (nested_run.path / "log.jsonl").read_text().splitlines()]
    health = nested_run.health
    coarse, fine = health["coarse_elements"], health["elements"]
    assert fine > (LEVELS["standard"] / LEVELS["fine"]) * coarse
    growing = [row for row in log if row["growth"] not in nested_run.stages]
    on_fine = [row["growth"] for row in growing if row["elements"] == fine]
    first_contact = min(row["growth"] for row in log if row["elements"] == fine and row["effects"]["contact"]["pairs"])
    assert 1.2 < min(on_fine) < max(on_fine) < 1 + SHORT_WINDOW_END * (first_contact - 1) + 0.02
    on_coarse = [row["growth"] for row in growing if row["elements"] == coarse]
    assert not any(min(on_fine) <= growth <= max(on_fine) for growth in on_coarse)
    assert min(on_coarse) < min(on_fine) < max(on_fine) < max(on_coarse)
    assert np.all(np.diff([row["step"] for row in log]) >= 0)
    assert log[-1]["step"] == health["steps"]
    assert np.all(np.diff([stage["lowest_J"] for stage in health["stages"]]) <= 0)


def test_all_stages_are_on_the_fine_mesh(nested_run):
    counts = {len(nested_run.cortex(g).pial.verts) for g in nested_run.stages}
    assert len(counts) == 1
    log = [json.loads(line) for line in (nested_run.path / "log.jsonl").read_text().splitlines()]
    on_mesh = {g: [row["elements"] for row in log if row["growth"] == g][-1] for g in nested_run.stages}
    assert set(on_mesh.values()) == {nested_run.health["elements"]}


@pytest.mark.parametrize("stop_at", [1.1, 1.35, 1.55, 1.58])
def test_a_stopped_run_ends_with_the_same_bytes_on_whichever_mesh_it_stopped(nested_run, tmp_path, stop_at):
    class Stop(Exception):
        pass

    def progress(share, text):
        if float(text.removeprefix("g ").split(",")[0]) >= stop_at - 1e-9:
            raise Stop

    scene = nested_run.scene.model_copy(
        update={"output": nested_run.scene.output.model_copy(update={"checkpoint_minutes": 1e-9})}
    )
    with pytest.raises(Stop):
        simulate(scene, tmp_path / "run", threads=1, progress=progress)
    resumed = simulate(scene, tmp_path / "run", threads=1, resume=True)
    for g in nested_run.stages:
        own, other = (run.cortex(g).pial.verts for run in (resumed, nested_run))
        assert np.array_equal(own, other)


def test_a_body_that_bursts_when_it_is_carried_leaves_the_state_that_it_came_from(monkeypatch):
    def bursting(*_):
        raise UnstableError("it burst.", {})

    scene = load_scene("fig7-ratio1", SMALL)
    run = NestedDynamics(scene, build_effects(scene))
    run.state.x += 0.01
    monkeypatch.setattr("morphofold.sim.nested_meshes.carry", bursting)
    with pytest.raises(UnstableError, match=r"it burst\. .*finest") as caught:
        run.grow_to(1.5, lambda state: None)
    assert np.array_equal(caught.value.sound["x"], run.coarse.state.x)


@pytest.mark.parametrize(
    ("settings", "nested"),
    [
        (["accuracy.level=fine"], True),
        (["accuracy.level=finest"], False),
        (["accuracy.level=fine", "accuracy.edge=1"], False),
        (["accuracy.level=fine", "effects.stress_growth={}"], False),
        (["accuracy.level=fine", "effects.inertia={}"], False),
    ],
)
def test_only_fine_is_nested_and_only_where_a_state_can_be_carried(settings, nested):
    assert (not load_scene("fig6-thick", settings).not_nested) is nested


@pytest.mark.parametrize("name", ["patch", "ellipsoid", "strip", "mesh"])
def test_shapes_whose_meshes_are_not_nested_say_so(name):
    scene = load_scene(name, ["accuracy.level=fine"] if name != "mesh" else [])
    assert bool(scene.not_nested) is (name in ("strip", "mesh"))


def test_effects_of_ones_own_grow_on_one_mesh_and_the_folder_says_why(tmp_path):
    class Nothing(Effect):
        name = "nothing"

    settings = [*SMALL[:3], "growth.final=1.02", "output.volume=false", "output.stages=[]"]
    run = simulate("fig6-thick", tmp_path / "run", settings=settings, effects=[Nothing()], threads=1)
    assert "own" in run.health["not_nested"]
    assert "coarse_elements" not in run.health
