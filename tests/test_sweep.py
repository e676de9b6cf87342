"""Sweeps: grids of scenes, runs that are done once whatever happens, tables of what they found."""

import json
import multiprocessing
import time

import numba
import numpy as np
import pytest
from commands import refused
from made_cohort import table, work_here
from made_surfaces import area
from pyarrow import parquet

import morphofold.simulation
from morphofold.analysis import measuring
from morphofold.analysis.measures import Measures
from morphofold.cli import main
from morphofold.cli.sweep import _with_absolute_mesh_path
from morphofold.group import tasks
from morphofold.group.grid import MOST_RUNS, make_grid
from morphofold.group.sweep import (
    AREA_OVER_FLAT,
    HINGES_PER_AREA,
    Run,
    SphereTheory,
    grow_and_measure,
    read_run,
    theory_of,
)
from morphofold.group.tasks import TaskFolder, write_record
from morphofold.io import read_surface
from morphofold.io.folders import alone
from morphofold.report import analysis_report
from morphofold.results import write_analysis
from morphofold.shapes import icosphere
from morphofold.sim import radial_run, theory
from morphofold.sim.dynamics import UnstableError
from morphofold.sim.output import checkpoint
from morphofold.sim.scene.scene_files import load_scene
from morphofold.sim.sphere_theory.smooth_sphere import ConvergenceError
from morphofold.surface import Cortex, Surface

SPHERE = """
name = "ball"
[geometry]
shape = "radial"
radius = 12.0
hole_radius = 6.0
cortex_thickness = 2.0
[growth]
final = 1.3
[effects.core_growth]
final = 1.1
"""
VARY = ["--vary", "mu_ratio=1,2", "--vary", "cortex_thickness=1,2"]
NAMES = [f"mu_ratio-{mu}_cortex_thickness-{T}" for mu in (1, 2) for T in (1, 2)]


# grids -------------------------------------------------------------------------------------------------------


def test_a_grid_has_every_point_with_every_seed_by_its_name():
    grid = make_grid("demo", ["cortex_thickness=2,3", "material.mu_ratio=1,0.5"], seeds=2)
    assert [point.name for point in grid.points] == [
        f"cortex_thickness-{T}_mu_ratio-{mu}_seed-{seed}" for T in (2, 3) for mu in (1, 0.5) for seed in (0, 1)
    ]
    for point in grid.points:
        T, mu = (axis.values[i] for axis, i in zip(grid.axes, point.at))
        assert point.scene.geometry.cortex_thickness == T
        assert point.scene.material.mu_ratio == mu
        assert point.scene.effects["perturbation"].seed == point.seed
        assert point.scene.name == point.name
    assert grid.places == [(0, 0), (0, 1), (1, 0), (1, 1)]


def test_settings_hold_at_every_point_and_varied_values_replace_them():
    grid = make_grid("demo", ["growth.final=1.5,1.6"], settings=["growth.final=1.9", "material.mu_ratio=3"])
    assert [point.scene.growth.final for point in grid.points] == [1.5, 1.6]
    assert {point.scene.material.mu_ratio for point in grid.points} == {3}
    assert all(max(point.scene.stages) == point.scene.growth.final for point in grid.points)


def test_names_of_points_differ_and_hold_the_seed_of_an_imperfection():
    both = make_grid("core", ["growth.final=1.5,1.6", "core_growth.final=1.1,1.2"])
    assert both.points[0].name == "growth.final-1.5_effects.core_growth.final-1.1_seed-0"
    signs = make_grid("demo", ["geometry.thickness_spots=[],[{centre = [0, 0, 50], radius = 9, factor = 0.5}]"])
    assert len({point.name.casefold() for point in signs.points}) == 2
    long = make_grid("demo", [f"output.stages=[{','.join(f'1.{k}' for k in range(10, 60, 5))}],[1.1]"])
    assert len({point.name for point in long.points}) == 2
    assert max(len(point.name) for point in long.points) <= 80
    seeds = make_grid("demo", ["seed=3,7"])  # named like any other key
    assert not seeds.axes
    assert [point.name for point in seeds.points] == ["seed-3", "seed-7"]
    assert [point.scene.effects["perturbation"].seed for point in seeds.points] == [3, 7]
    perfect = make_grid("radial", ["mu_ratio=1,2"])
    assert [(point.name, point.seed) for point in perfect.points] == [("mu_ratio-1", None), ("mu_ratio-2", None)]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], ["[nothing-to-do]"]),
        (["--vary", "mu_ratio=1,2", "--vary", "material.mu_ratio=3"], ["--vary material.mu_ratio ", "[named-twice]"]),
        (["--seeds", "0"], ["--seeds ", "got 0.", "[out-of-range]"]),
        (["--seeds", "2", "--vary", "seed=1,2"], ["--seeds 2: ", "--vary", "[options-clash]"]),
        (["--seeds", str(MOST_RUNS + 1)], ["10,001 ", " 10,000.", "[too-large]"]),
        (["--vary", "mu_ratio=1,nan"], ["mu_ratio-nan: ", "material.mu_ratio=nan", "[not-finite]"]),
        (["--vary", "cortex_thickness=3,60", "--vary", "mu_ratio=1,2"], ["cortex_thickness-60_mu_ratio-1: ", " 60 "]),
        (["--vary", "mu_ratio=1", "--curvature-scale", "-1"], ["--curvature-scale ", "got -1.", "[out-of-range]"]),
    ],
)
def test_a_sweep_that_makes_no_sense_is_refused(cwd, capsys, arguments, words):
    refused(capsys, ["sweep", "demo", *arguments, "-o", "x"], *words)
    assert not (cwd / "x").exists()


# runs --------------------------------------------------------------------------------------------------------


@pytest.fixture
def ball(cwd, monkeypatch):
    """A scene of a second, no workers, and the names of what was grown and measured."""
    did = {"grown": [], "measured": []}
    grow, measure = morphofold.simulation.simulate, measuring.measure

    def simulate(scene, out, **options):
        did["grown"].append(scene.name)
        return grow(scene, out, **options)

    def measured(cortex, **options):
        did["measured"].append(cortex.info["name"])
        return measure(cortex, **options)

    work_here(monkeypatch, measured)
    monkeypatch.setattr(radial_run, "ICOSPHERE_LEVEL", 3)  # 642 vertices
    monkeypatch.setattr(morphofold.simulation, "simulate", simulate)
    (cwd / "ball.toml").write_text(SPHERE)
    return did


def swept(*more, vary=VARY, out="out"):
    return main(["sweep", "ball.toml", *vary, "--accuracy", "draft", "--no-report", "-q", "-o", out, *more])


def test_a_sweep_measures_every_point_and_the_next_one_only_what_is_new(cwd, ball, capsys):
    assert swept() == 0
    assert capsys.readouterr().out.splitlines()[-1].startswith("4 of 4 runs have results -> ")
    assert ball == {"grown": NAMES, "measured": NAMES}

    rows = table(cwd / "out/group/measures.tsv")
    assert list(rows[0]) == ["run", "mu_ratio", "cortex_thickness", "seed", "measure", "value"]
    assert list(dict.fromkeys(row["run"] for row in rows)) == NAMES
    assert len(parquet.read_table(cwd / "out/group/measures.parquet")) == len(rows)
    for row in rows:
        assert row["run"] == f"mu_ratio-{row['mu_ratio']}_cortex_thickness-{row['cortex_thickness']}"
        if row["measure"] == "area_pial_mm2":  # it stays a sphere
            health = json.loads((cwd / "out/runs" / row["run"] / "simulation/health.json").read_text())
            radius = health["stages"][-1]["mean_radius_mm"]
            assert float(row["value"]) == pytest.approx(4 * np.pi * radius**2, rel=0.02)

    before = {path: path.read_bytes() for path in (cwd / "out/group").rglob("*") if path.is_file()}
    ball["grown"].clear()
    ball["measured"].clear()
    assert swept("--json") == 0
    summary = json.loads(capsys.readouterr().out)
    assert [summary[k] for k in ("runs", "with_results", "from_before", "failed")] == [4, 4, 4, 0]
    assert summary["warnings"] == summary["failures"] == {}
    assert ball == {"grown": [], "measured": []}
    assert {path: path.read_bytes() for path in before} == before

    assert swept(vary=["--vary", "mu_ratio=1,3", "--vary", "cortex_thickness=1,2"]) == 0
    assert "4 of 4 runs have results, 2 of them from before" in capsys.readouterr().out
    assert ball["grown"] == ["mu_ratio-3_cortex_thickness-1", "mu_ratio-3_cortex_thickness-2"]


def test_another_way_to_measure_grows_nothing_and_another_scene_of_the_same_name_all(cwd, ball, capsys):
    single = ["--vary", "mu_ratio=1"]
    assert swept(vary=single) == 0
    assert swept("--curvature-scale", "4", vary=single) == 0
    assert ball["measured"] == ["mu_ratio-1"] * 2
    stage = cwd / "out/runs/mu_ratio-1/simulation/stages"
    made = (stage / "g1.30/stage.json").stat().st_mtime_ns
    assert swept("--curvature-scale", "4", "--set", "growth.final=1.2", vary=single) == 0
    assert [path.name for path in stage.iterdir()] == ["g1.20"]
    assert ball["measured"] == ["mu_ratio-1"] * 3
    assert made < (stage / "g1.20/stage.json").stat().st_mtime_ns
    assert "grown again" in (cwd / "out/logs/mu_ratio-1.log").read_text()
    assert "of them from before" not in capsys.readouterr().out


def test_a_point_that_breaks_fails_alone_and_an_unhealthy_one_is_a_warning(cwd, ball, capsys, monkeypatch):
    grow, tried = morphofold.simulation.simulate, []

    def simulate(scene, out, **options):
        tried.append(scene.name)
        if scene.name != "mu_ratio-1":
            raise UnstableError("left its bounds", {}) if scene.name == "mu_ratio-2" else ConvergenceError("no state")
        run = grow(scene, out, **options)
        (run.path / "health.json").write_text(json.dumps({**run.health, "healthy": False, "warnings": ["it wobbles"]}))
        return run

    monkeypatch.setattr(morphofold.simulation, "simulate", simulate)
    for from_before in ("", ", 1 of them from before"):
        assert swept(vary=["--vary", "mu_ratio=1,2,3"]) == 1
        lines = capsys.readouterr().out.splitlines()
        expected = {"warning: mu_ratio-1: it wobbles", "mu_ratio-2: left its bounds", "mu_ratio-3: no state"}
        assert expected == set(lines[:-1])
        assert lines[-1].startswith(f"1 of 3 runs have results{from_before}, 2 failed -> ")
    assert tried == ["mu_ratio-1", "mu_ratio-2", "mu_ratio-3"]  # none is tried again
    first, *others = table(cwd / "out/group/runs.tsv")
    assert (first["state"], first["reason"], first["warnings"]) == ("done", "n/a", "it wobbles")
    assert [(row["state"], row["reason"]) for row in others] == [("failed", "left its bounds"), ("failed", "no state")]
    assert {row["run"] for row in table(cwd / "out/group/measures.tsv")} == {"mu_ratio-1"}


def one_run(cwd, **options):
    scene = load_scene(cwd / "ball.toml").model_copy(update={"name": "one"})
    return Run(TaskFolder(str(cwd / "out"), "one", "run"), scene, **{"options": {"accuracy": "draft"}, **options})


def test_a_locked_run_is_not_written_and_tried_again(cwd, ball, monkeypatch):
    run = one_run(cwd)
    monkeypatch.setattr(tasks, "LONGEST_WAIT_FOR_LOCK", 0.05)
    with alone(run.place.record.parent, "one.lock"):  # a worker that the scheduler gave up for lost
        outcome = grow_and_measure(run)
    assert outcome.state == "failed"
    assert "another run is writing here" in outcome.failures[""]
    assert ball["grown"] == []
    assert grow_and_measure(run).state == "done"


def test_changed_simulations_are_grown_anew_and_damaged_analyses_measured_anew(cwd, ball):
    run = one_run(cwd)
    assert grow_and_measure(run).state == "done"
    for name in ("health.json", "stages/g1.30/surf/lh.pial"):
        file = run.simulation / name
        whole = file.read_bytes()
        file.write_bytes(whole.replace(b"2", b"3") if name.endswith("json") else whole + b"\n")
        outcome = grow_and_measure(run)
        assert (outcome.state, outcome.changed) == ("done", True)
        assert name == "health.json" or file.read_bytes() == whole  # which has times
    assert ball["grown"] == ["one"] * 3
    time_of_growth = (run.simulation / "stages/g1.30/stage.json").stat().st_mtime_ns
    for name in ("summary.json", "regions.tsv"):
        file = run.analysis / name
        whole = file.read_bytes()
        file.write_bytes(whole[:-10])
        assert grow_and_measure(run).state == "done"
        assert file.read_bytes() == whole
        assert grow_and_measure(run).state == "reused"
    assert (run.simulation / "stages/g1.30/stage.json").stat().st_mtime_ns == time_of_growth
    assert ball["measured"] == ["one"] * 5


def test_a_run_never_removes_files_of_its_user(cwd, ball):
    run = one_run(cwd)
    assert grow_and_measure(run).state == "done"
    (run.simulation / "NOTES.txt").write_text("mine")
    (run.analysis / "NOTES.txt").write_text("mine")
    assert grow_and_measure(run).state == "reused"
    (run.simulation / "health.json").write_text("{}")
    outcome = grow_and_measure(run)  # it can't be grown anew there
    assert outcome.state == "failed"
    assert "NOTES.txt" in outcome.failures[""]
    (run.simulation / "NOTES.txt").unlink()
    assert grow_and_measure(run).state == "done"
    assert (run.analysis / "NOTES.txt").read_text() == "mine"


def test_a_run_has_a_page_on_request_and_no_more_threads_than_the_worker(cwd, ball, monkeypatch):
    numbers, grow = [], morphofold.simulation.simulate

    def simulate(*arguments, threads, **options):
        numbers.append(threads)
        return grow(*arguments, threads=threads, **options)

    monkeypatch.setattr(morphofold.simulation, "simulate", simulate)
    for report in (False, analysis_report):
        assert grow_and_measure(one_run(cwd, threads=1000, report=report)).state == "done"
        assert (cwd / "out/runs/one/analysis/report.html").is_file() == bool(report)
    assert set(numbers) == {numba.config.NUMBA_NUM_THREADS}
    assert ball["measured"] == ["one", "one"]


def test_a_dry_run_writes_nothing_and_tells_of_the_largest(cwd, capsys):
    (cwd / "ball.toml").write_text(SPHERE)
    argv = ["sweep", "ball.toml", "--vary", "growth.final=1.2,1.4", "--dry-run", "-o", "out"]
    assert main(argv) == 0
    assert "the largest run, growth.final-1.4: forecast" in capsys.readouterr().out
    assert main([*argv, "--json"]) == 0
    summary = json.loads(capsys.readouterr().out)
    assert (summary["runs"], summary["points"], summary["largest"]["scene"]) == (2, 2, "growth.final-1.4")
    assert not (cwd / "out").exists()


def written_run(cwd, scene, settings, white, pial, measures, portion=1.0):
    """A run whose measures were written, and its folder."""
    (point,) = make_grid(scene, ["mu_ratio=1"], settings=settings).points
    folder = cwd / "runs" / point.name
    cortex = Cortex(white, pial, origin="simulation", portion=portion)
    result = Measures(cortex, measures, {}, notes={"wavelength_mm": "no folds"})
    write_analysis([result], folder / "analysis", report=False)
    write_record(cwd / "records" / f"{point.name}.json", "key", {}, results=True, files={"analysis/report.html": "0"})
    return point, folder


@pytest.mark.parametrize("portion", [1.0, 1 / 8])
def test_hinges_per_area_are_of_the_whole_surface_whatever_was_simulated(cwd, portion):
    verts, faces = icosphere(1, 10.0)
    white, pial = (Surface(verts * size, faces, f"lh.{name}") for name, size in (("white", 0.9), ("pial", 1.0)))
    measures = {"n_hinges": 30, "area_pial_mm2": 20_000.0}
    point, folder = written_run(cwd, "demo", [], white, pial, measures, portion)
    (folder / "simulation").mkdir()
    (folder / "simulation/health.json").write_text(
        '{"morphofold": "1", "healthy": false, "warnings": ["it wobbles"], "stages": [{"growth": 2.0}], '
        '"seconds": 1.5, "elements": 5, "steps": 7}'
    )
    result = read_run(cwd, point)
    assert result.measures == {**measures, HINGES_PER_AREA: 1.5}
    assert result.notes == {"wavelength_mm": "no folds"}
    assert (result.reason, result.warnings, result.numbers) == ("", ("it wobbles",), {"elements": 5, "steps": 7})
    np.testing.assert_allclose(read_surface(result.pial).verts, pial.verts, atol=1e-5)
    (folder / "analysis/summary.json").unlink()
    assert "holds no results" in read_run(cwd, point).reason


@pytest.mark.parametrize(("scene", "sizes"), [("patch", "size=[20.0, 10.0]"), ("strip", "length=20")])
def test_area_over_flat_is_one_of_a_flat_piece_and_that_of_its_slope_of_a_steep_one(cwd, scene, sizes):
    """A piece of 20 by 10 mm, with slopes of 45 degrees: sqrt 2."""
    x, y, z = np.array([0.0, 10.0, 20.0]), np.array([0.0, 10.0]), np.array([0.0, 10.0, 0.0])
    verts = np.array([[a, b, c] for b in y for a, c in zip(x, z)])
    faces = np.array([[0, 1, 4], [0, 4, 3], [1, 2, 5], [1, 5, 4]])
    pial, white = (Surface(verts - [0, 0, down], faces) for down in (0.0, 1.0))
    measures = {"n_hinges": 1, "area_pial_mm2": area(pial)}
    point, _ = written_run(cwd, scene, [f"geometry.{sizes}"], white, pial, measures)
    measures = read_run(cwd, point).measures
    assert measures[AREA_OVER_FLAT] == pytest.approx(np.sqrt(2))
    assert (HINGES_PER_AREA in measures) == (scene == "patch")  # a section has no hinges


OCTANT = (
    "geometry.portion=octant",
    "accuracy.level=draft",
    "geometry.radius=20",
    "geometry.hole_radius=10",
    "growth.final=1.5",
    "output.checkpoint_minutes=0.002",
    "output.stages=[]",
    "output.volume=false",
)


@pytest.mark.slow
def test_a_run_that_was_killed_goes_on_from_its_checkpoint(cwd, monkeypatch):
    scene = load_scene("demo", OCTANT)
    runs = {name: Run(TaskFolder(str(cwd / name), "one", "run"), scene, options={"accuracy": "draft"}) for name in "ab"}
    worker = multiprocessing.get_context("spawn").Process(target=grow_and_measure, args=(runs["a"],))
    worker.start()
    while not (runs["a"].simulation / "checkpoint.npz").exists() and worker.is_alive():
        time.sleep(0.01)
    worker.kill()
    worker.join()
    assert not (runs["a"].simulation / "health.json").exists()

    read, taken_up = checkpoint.read_checkpoint, []
    monkeypatch.setattr(checkpoint, "read_checkpoint", lambda path, like: taken_up.append(path) or read(path, like))
    assert grow_and_measure(runs["a"]).state == "done"
    assert taken_up == [runs["a"].simulation / "checkpoint.npz"]
    assert grow_and_measure(runs["b"]).state == "done"
    assert len(taken_up) == 1
    for name in ("surf/lh.pial", "hinges.tsv"):  # as if it had never been killed
        assert (runs["a"].analysis / name).read_bytes() == (runs["b"].analysis / name).read_bytes()


@pytest.mark.slow
def test_two_workers_do_what_one_process_does(cwd, capsys):
    (cwd / "ball.toml").write_text(SPHERE)
    assert swept("--workers", "2") == 0
    assert capsys.readouterr().out.splitlines()[-1].startswith("4 of 4 runs have results -> ")
    assert {row["run"] for row in table(cwd / "out/group/measures.tsv")} == set(NAMES)
    assert swept("--workers", "1", out="alone") == 0
    for file in (cwd / "out/group").glob("*.tsv"):
        assert file.read_bytes() == (cwd / "alone/group" / file.name).read_bytes()


def test_a_mesh_file_is_found_from_where_a_worker_is(cwd):
    (cwd / "mine.vtu").write_bytes(b"")
    mine, sample = load_scene("mesh", ["geometry.file=mine.vtu"]), load_scene("mesh")
    assert _with_absolute_mesh_path(mine).geometry.file == str(cwd / "mine.vtu")
    assert _with_absolute_mesh_path(sample) == sample
    assert _with_absolute_mesh_path(load_scene("demo")) == load_scene("demo")


# theory ------------------------------------------------------------------------------------------------------


def test_theory_of_a_scene_is_that_of_its_sphere():
    scene = load_scene("demo", ["geometry.radius=40", "geometry.hole_radius=10", "material.mu_ratio=3"])
    answer = theory_of(scene)
    truth = theory.bifurcation(3 / 40, 3, "isotropic", 50, A_over_C=10 / 40)
    assert answer == SphereTheory(truth.g_crit, truth.g_crease, 40 * truth.wavelength_deformed)


@pytest.mark.parametrize(
    ("scene", "settings"),
    [("patch", []), ("core", []), ("demo", ["geometry.thickness_spots=[{centre=[0,0,50], radius=9, factor=0.5}]"])],
)
def test_theory_has_a_reason_for_scenes_beyond_it(scene, settings):
    none = theory_of(load_scene(scene, settings))
    assert none.reason
    assert np.isnan([none.g_crit, none.g_crease, none.wavelength]).all()
