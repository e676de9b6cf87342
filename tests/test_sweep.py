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
from morphofold.analysis.measures_result import Measures
from morphofold.cli import main
from morphofold.cli.sweep import _with_absolute_mesh_path
from morphofold.group import task_records
from morphofold.group.sweep import (
    AREA_OVER_FLAT,
    HINGES_PER_AREA,
    Run,
    SphereTheory,
    grow_and_measure,
    read_run,
    theory_of,
)
from morphofold.group.sweep_grid import MOST_RUNS, make_grid
from morphofold.group.task_records import TaskFolder, write_record
from morphofold.io import read_surface
from morphofold.io.atomic_folders import alone
from morphofold.report import analysis_report
from morphofold.results import write_analysis
from morphofold.shapes import icosphere
from morphofold.sim import radial_run, theory
from morphofold.sim.dynamics import UnstableError
from morphofold.sim.effects.perturbation import build
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
        T, mu = (axis.values[i] for axis, i in zip(grid.axes, point.grid_index))
        assert point.scene.geometry.cortex_thickness == T
        assert point.scene.material.mu_ratio == mu
        assert point.scene.effects["perturbation"].seed == point.seed
        assert point.scene.name == point.name


def test_settings_hold_at_every_point_and_varied_values_replace_them():
    grid = make_grid("demo", ["growth.final=1.5,1.6"], settings=["growth.final=1.9", "material.mu_ratio=3"])
    assert [point.scene.growth.final for point in grid.points] == [1.5, 1.6]
    assert {point.scene.material.mu_ratio for point in grid.points} == {3}
    assert all(max(point.scene.stages) == point.scene.growth.final for point in grid.points)


def test_one_imperfection_is_that_of_the_whole_grid_unless_it_is_varied():
    wavelengths = lambda *vary: [p.scene.effects["perturbation"].wavelength for p in make_grid("demo", vary).points]
    (own,) = {*wavelengths("mu_ratio=1,4", 'law="isotropic","tangential"')}
    assert own == build(load_scene("demo").effects["perturbation"], load_scene("demo")).wavelength
    assert wavelengths("wavelength=5.0,8.0") == [5.0, 8.0]
    assert {*wavelengths("mu_ratio=1,4", "amplitude=0.01")} == {own}


def test_names_of_points_differ_and_hold_the_seed_of_an_imperfection():
    def names(scene, *vary):
        return [point.name for point in make_grid(scene, vary).points]

    both = names("core", "growth.final=1.5,1.6", "core_growth.final=1.1,1.2")
    assert both[0] == "growth.final-1.5_effects.core_growth.final-1.1_seed-0"
    signs = names("demo", "geometry.thickness_spots=[],[{centre = [0, 0, 50], radius = 9, factor = 0.5}]")
    assert len({name.casefold() for name in signs}) == 2
    long = names("demo", f"output.stages=[{','.join(f'1.{k}' for k in range(10, 60, 5))}],[1.1]")
    assert len(set(long)) == 2
    assert max(map(len, long)) <= 80
    assert names("demo", "seed=3,7") == ["seed-3", "seed-7"]  # named like any other key
    assert names("radial", "mu_ratio=1,2") == ["mu_ratio-1", "mu_ratio-2"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], ["[nothing-to-do]"]),
        (["--vary", "mu_ratio=1,2", "--vary", "material.mu_ratio=3"], ["--vary material.mu_ratio ", "[named-twice]"]),
        (["--seeds", "0"], ["--seeds ", "got 0.", "[out-of-range]"]),
        (["--seeds", "2", "--vary", "seed=1,2"], ["--seeds 2: ", "--vary", "[options-clash]"]),
        (["--seeds", str(MOST_RUNS + 1)], ["10,001 ", " 10,000.", "[too-large]"]),
        (["--vary", "cortex_thickness=3,60", "--vary", "mu_ratio=1,2"], ["cortex_thickness-60_mu_ratio-1: ", " 60 "]),
    ],
)
def test_a_sweep_that_makes_no_sense_is_refused(cwd, capsys, arguments, message):
    refused(capsys, ["sweep", "demo", *arguments, "-o", "x"], *message)
    assert not (cwd / "x").exists()


# runs --------------------------------------------------------------------------------------------------------


@pytest.fixture
def ball(cwd, monkeypatch):
    """A scene of a second, no workers, and the names of what was simulated and measured."""
    names = {"simulated": [], "measured": []}
    grow, measure = morphofold.simulation.simulate, measuring.measure

    def simulate(scene, out, **options):
        names["simulated"].append(scene.name)
        return grow(scene, out, **options)

    def measured(cortex, **options):
        names["measured"].append(cortex.info["name"])
        return measure(cortex, **options)

    work_here(monkeypatch, measured)
    monkeypatch.setattr(radial_run, "ICOSPHERE_LEVEL", 3)  # 642 vertices
    monkeypatch.setattr(morphofold.simulation, "simulate", simulate)
    (cwd / "ball.toml").write_text(SPHERE)
    return names


def swept(*more, vary=VARY, out="out"):
    return main(["sweep", "ball.toml", *vary, "--accuracy", "draft", "--no-report", "-q", "-o", out, *more])


def test_a_sweep_measures_every_point_and_the_next_one_only_what_is_new(cwd, ball, capsys):
    assert swept() == 0
    assert capsys.readouterr().out.splitlines()[-1].startswith("4 of 4 runs have results -> ")
    assert ball == {"simulated": NAMES, "measured": NAMES}

    rows = table(cwd / "out/group/measures.tsv")
    assert list(rows[0]) == ["run", "mu_ratio", "cortex_thickness", "seed", "measure", "value"]
    assert list(dict.fromkeys(row["run"] for row in rows)) == NAMES
    assert len(parquet.read_table(cwd / "out/group/measures.parquet")) == len(rows)
    for row in (row for row in rows if row["measure"] == "area_pial_mm2"):  # it stays a sphere
        assert row["run"] == f"mu_ratio-{row['mu_ratio']}_cortex_thickness-{row['cortex_thickness']}"
        health = json.loads((cwd / "out/runs" / row["run"] / "simulation/health.json").read_text())
        radius = health["stages"][-1]["mean_radius_mm"]
        assert float(row["value"]) == pytest.approx(4 * np.pi * radius**2, rel=0.02)

    before = {path: path.read_bytes() for path in (cwd / "out/group").rglob("*") if path.is_file()}
    assert swept("--json") == 0
    summary = json.loads(capsys.readouterr().out)
    assert [summary[k] for k in ("runs", "with_results", "from_before", "failed")] == [4, 4, 4, 0]
    assert {path: path.read_bytes() for path in before} == before

    assert swept(vary=["--vary", "mu_ratio=1,3", "--vary", "cortex_thickness=1,2"]) == 0
    assert "4 of 4 runs have results, 2 of them from before" in capsys.readouterr().out
    assert ball["simulated"] == [*NAMES, "mu_ratio-3_cortex_thickness-1", "mu_ratio-3_cortex_thickness-2"]


def test_other_options_of_measuring_grow_nothing_and_another_scene_of_the_same_name_all(cwd, ball):
    single = ["--vary", "mu_ratio=1"]
    assert swept(vary=single) == 0
    stages = cwd / "out/runs/mu_ratio-1/simulation/stages"
    before = (stages / "g1.30/stage.json").stat()
    assert swept("--curvature-scale", "4", vary=single) == 0
    assert (stages / "g1.30/stage.json").stat().st_mtime_ns == before.st_mtime_ns
    assert swept("--curvature-scale", "4", "--set", "growth.final=1.2", vary=single) == 0
    assert [path.name for path in stages.iterdir()] == ["g1.20"]
    assert ball["measured"] == ["mu_ratio-1"] * 3
    assert "grown again" in (cwd / "out/logs/mu_ratio-1.log").read_text()


def test_a_point_that_breaks_fails_alone_and_an_unhealthy_one_is_a_warning(cwd, ball, capsys, monkeypatch):
    grow, names = morphofold.simulation.simulate, []

    def simulate(scene, out, **options):
        names.append(scene.name)
        if scene.name != "mu_ratio-1":
            raise UnstableError("left its bounds", {}) if scene.name == "mu_ratio-2" else ConvergenceError("no state")
        run = grow(scene, out, **options)
        (run.path / "health.json").write_text(json.dumps({**run.health, "healthy": False, "warnings": ["it wobbles"]}))
        return run

    monkeypatch.setattr(morphofold.simulation, "simulate", simulate)
    for from_before in ("", ", 1 of them from before"):
        assert swept(vary=["--vary", "mu_ratio=1,2,3"]) == 1
        *lines, last = capsys.readouterr().out.splitlines()
        assert {*lines} == {"warning: mu_ratio-1: it wobbles", "mu_ratio-2: left its bounds", "mu_ratio-3: no state"}
        assert last.startswith(f"1 of 3 runs have results{from_before}, 2 failed -> ")
    assert names == ["mu_ratio-1", "mu_ratio-2", "mu_ratio-3"]  # none is tried again
    rows = table(cwd / "out/group/runs.tsv")
    reasons = [(row["state"], row["reason"]) for row in rows]
    assert reasons == [("done", "n/a"), ("failed", "left its bounds"), ("failed", "no state")]
    assert rows[0]["warnings"] == "it wobbles"
    assert {row["run"] for row in table(cwd / "out/group/measures.tsv")} == {"mu_ratio-1"}


def one_run(cwd, **options):
    scene = load_scene(cwd / "ball.toml").model_copy(update={"name": "one"})
    return Run(TaskFolder(str(cwd / "out"), "one", "run"), scene, **{"options": {"accuracy": "draft"}, **options})


def test_a_locked_run_is_not_written_and_tried_again(cwd, ball, monkeypatch):
    run = one_run(cwd)
    monkeypatch.setattr(task_records, "LONGEST_WAIT_FOR_LOCK", 0.05)
    with alone(run.task_folder.record.parent, "one.lock"):  # a worker that the scheduler gave up for lost
        assert "another run is writing here" in grow_and_measure(run).failures[""]
    assert ball["simulated"] == []
    assert grow_and_measure(run).state == "done"


def test_changed_simulations_are_grown_anew_and_damaged_analyses_measured_anew(cwd, ball):
    run = one_run(cwd)
    assert grow_and_measure(run).state == "done"
    stage, times = run.simulation / "stages/g1.30/stage.json", []
    for file in (stage.with_name("surf") / "lh.pial", run.analysis / "summary.json"):
        whole = file.read_bytes()
        file.write_bytes(whole[:-10])
        assert grow_and_measure(run).state == "done"
        assert file.read_bytes() == whole
        assert grow_and_measure(run).state == "reused"
        times.append(stage.stat().st_mtime_ns)
    assert times[0] == times[1]
    assert ball["measured"] == ["one"] * 3


def test_a_run_never_removes_files_of_its_user(cwd, ball):
    run = one_run(cwd)
    assert grow_and_measure(run).state == "done"
    for folder in (run.simulation, run.analysis):
        (folder / "NOTES.txt").write_text("of the user")
    assert grow_and_measure(run).state == "reused"
    (run.simulation / "health.json").write_text("{}")
    assert "NOTES.txt" in grow_and_measure(run).failures[""]  # it can't be grown anew there
    (run.simulation / "NOTES.txt").unlink()
    assert grow_and_measure(run).state == "done"
    assert (run.analysis / "NOTES.txt").read_text() == "of the user"


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


def test_a_dry_run_writes_nothing_and_tells_of_the_largest(cwd, capsys):
    (cwd / "ball.toml").write_text(SPHERE)
    assert main(["sweep", "ball.toml", "--vary", "growth.final=1.2,1.4", "--dry-run", "-o", "out", "--json"]) == 0
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
    assert (result.reason, result.warnings, result.run_sizes) == ("", ("it wobbles",), {"elements": 5, "steps": 7})
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
    killed, whole = (
        Run(TaskFolder(str(cwd / name), "one", "run"), scene, options={"accuracy": "draft"}) for name in "ab"
    )
    worker = multiprocessing.get_context("spawn").Process(target=grow_and_measure, args=(killed,))
    worker.start()
    while not (killed.simulation / "checkpoint.npz").exists() and worker.is_alive():
        time.sleep(0.01)
    worker.kill()
    worker.join()
    assert not (killed.simulation / "health.json").exists()

    read, paths = checkpoint.read_checkpoint, []
    monkeypatch.setattr(checkpoint, "read_checkpoint", lambda path, like: paths.append(path) or read(path, like))
    for run in (killed, whole):
        assert grow_and_measure(run).state == "done"
    assert paths == [killed.simulation / "checkpoint.npz"]
    for name in ("surf/lh.pial", "hinges.tsv"):  # as if it had never been killed
        assert (killed.analysis / name).read_bytes() == (whole.analysis / name).read_bytes()


def test_a_mesh_file_has_an_absolute_path_for_workers(cwd):
    (cwd / "own.vtu").write_bytes(b"")
    own, sample = load_scene("mesh", ["geometry.file=own.vtu"]), load_scene("mesh")
    assert _with_absolute_mesh_path(own).geometry.file == str(cwd / "own.vtu")
    assert _with_absolute_mesh_path(sample) == sample


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
