"""Forecasts: what is counted is exact, what is modelled lies by what it models; nothing here is a time."""

import itertools
import json
import tracemalloc

import meshio
import numpy as np
import pytest
from commands import refused, run_json

import morphofold
from morphofold.cli import main
from morphofold.digests_and_json import strict_json
from morphofold.forecasts import cost_record as cost, forecast, forecasting, sizes
from morphofold.number_texts import percent, span
from morphofold.sim.build import build_bilayer, build_body
from morphofold.sim.dynamics import Dynamics
from morphofold.sim.effects import build_effects
from morphofold.sim.equilibrium.wrinkle_onset import first_wrinkles
from morphofold.sim.output.stage_surfaces import whole_surfaces
from morphofold.sim.run import simulate
from morphofold.sim.scene import LEVELS
from morphofold.sim.scene.scene_files import load_scene
from morphofold.sim.stage_checks import BOUNDS
from morphofold.simulation import freesurfer_maps
from morphofold.studies.speed.solver_speed import cut_bricks

SMALL = ("geometry.portion=octant", "accuracy.level=draft", "output.stages=[]")
#: a scene of every shape that has a body
BODIES = {
    **{p: ("fig6-thick", f"geometry.portion={p}", "accuracy.edge=4") for p in ("full", "half", "quarter", "octant")},
    "four layers": ("fig5", *SMALL, "accuracy.elements_through_cortex=4", "accuracy.edge=3"),
    "ellipsoid": ("ellipsoid", "accuracy.edge=5"),
    "spots": ("regional", "accuracy.edge=4"),
    "patch": ("patch", "accuracy.edge=3"),
    "strip": ("strip", "accuracy.edge=2"),
}


@pytest.mark.parametrize("name", BODIES)
def test_elements_nodes_and_vertices_by_rule_are_those_of_the_built_body(name):
    source, *settings = BODIES[name]
    scene = load_scene(source, settings)
    body = build_body(scene)
    white, pial, _ = whole_surfaces(body, body.X)
    by_rule = sizes.sizes_by_rule(scene, sizes.layers_of(body.bilayer))
    assert by_rule[:3] == (body.elements.n, len(body.X), len(pial.verts))
    assert by_rule.edge == pytest.approx(body.bilayer.edge, rel=1e-12)
    assert sizes.sizes_of(body.bilayer)[:3] == by_rule[:3]
    assert len(white.verts) == by_rule.vertices


def test_a_forecast_counts_the_body_that_a_run_builds():
    source, *settings = BODIES["octant"]
    scene = load_scene(source, settings)
    bilayer = build_bilayer(scene)
    expected = forecast(scene, threads=1)
    assert (expected.elements, expected.nodes) == (bilayer.mesh.nelements, bilayer.mesh.nvertices)
    assert expected.edge_over_T == pytest.approx(bilayer.edge / scene.geometry.cortex_thickness)
    assert expected.stages == len(scene.stages)
    assert expected.fastest < expected.seconds < expected.slowest
    assert expected.seconds == pytest.approx(sum(expected.seconds_by_phase.values()))
    assert {"elements", "advance", "measure", forecasting.STAGES_PHASE, forecasting.SETTING_UP_PHASE} <= set(
        expected.seconds_by_phase
    )


def test_a_body_of_tetrahedra_is_counted_and_has_no_errors_by_the_table(tmp_path):
    tets = cut_bricks(build_bilayer(load_scene("fig6-thick", ["geometry.portion=full", "accuracy.edge=12"]))).mesh
    meshio.Mesh(tets.p.T, [("tetra", tets.t.T)]).write(tmp_path / "body.vtu")
    geometry = f"geometry={{shape = 'mesh', file = '{tmp_path / 'body.vtu'}', cortex_thickness = 8}}"
    expected = forecast(load_scene("mesh", [geometry, "output.stages=[]"]), threads=1)
    assert (expected.elements, expected.nodes) == (tets.nelements, tets.nvertices)
    assert "shape" in expected.not_studied
    assert (expected.errors, expected.headline, expected.elements_through_cortex) == ({}, None, None)
    assert expected.how["errors"] in forecasting.table_of(expected)


@pytest.mark.parametrize(
    "extra",
    [
        ("growth.rate=0.5", "output.stages=[1.01, 1.03]"),
        pytest.param((), marks=pytest.mark.slow),
        pytest.param(('effects.ramp={shape = "smooth"}',), marks=pytest.mark.slow),
    ],
)
def test_steps_of_a_run_before_its_folds_are_those_expected(tmp_path, extra):
    scene = load_scene("fig6-thick", [*SMALL, "accuracy.edge=2", "growth.final=1.06", *extra])
    body = build_body(scene)
    expected = sizes.steps_of(scene, body.crossing, scene.steps_per_unit(body.crossing))
    took = simulate(scene, tmp_path / "run", threads=1).health["steps"]
    assert expected.waiting == 0
    assert took == pytest.approx(expected.expected, rel=0.1)  # contact and balance hardly need more


def test_growth_waits_longer_for_a_stiffer_cortex_a_faster_pace_and_only_once_it_folds():
    def waiting(*settings):
        return sizes.steps_of(load_scene("fig5", settings), 40.0, 7000).waiting

    assert waiting("growth.final=1.1", "output.stages=[]") == 0
    assert waiting() < waiting("material.mu_ratio=4")
    assert waiting() < waiting("growth.rate=2")


def test_the_crossing_time_is_scaled_between_meshes_as_bodies_have_it():
    for layers in (2, 4):
        squares = []
        for edge in (3.0, 1.5):
            settings = [f"accuracy.edge={edge}", f"accuracy.elements_through_cortex={layers}"]
            scene = load_scene("fig6-thick", ["geometry.portion=octant", *settings])
            body = build_body(scene)
            squares.append((body.crossing / sizes.relative_crossing(scene, body.bilayer.edge)) ** 2)
        assert squares[0] == pytest.approx(squares[1], rel=0.1)  # 5 % in steps


def test_a_body_too_large_to_be_timed_is_scaled_from_a_part_of_it():
    scene = load_scene("fig6-thin")
    part = forecasting.reduced(scene)
    assert scene.bricks > forecasting.MOST_TIMED_BRICKS >= part.bricks
    assert part.geometry.portion == "octant"
    assert part.cells == scene.cells
    small = load_scene("fig5", [*SMALL, "accuracy.edge=4"])
    assert forecasting.reduced(small) == small
    assert forecasting.reduced(load_scene("patch", ["accuracy.edge=0.2"])).bricks <= forecasting.MOST_TIMED_BRICKS


@pytest.mark.slow
def test_a_forecast_scaled_to_another_portion_and_mesh_has_its_exact_size_and_its_steps():
    timed = forecasting.calibrate(load_scene("fig6-thick", [*SMALL, "accuracy.edge=4"]), threads=1)
    scene = load_scene("fig6-thick", ["accuracy.edge=1.4", "output.stages=[]"])  # half, finer, more layers
    assert (timed.scene.elements_through_cortex, scene.elements_through_cortex) == (2, 3)
    scaled, body = forecasting.forecast_from(scene, timed), build_body(scene)
    assert (scaled.elements, scaled.nodes) == (body.elements.n, len(body.X))
    exact = sizes.steps_of(scene, body.crossing, scene.steps_per_unit(body.crossing))
    assert scaled.steps == pytest.approx(exact.expected, rel=0.05)
    assert "octant body" in scaled.how["elements"]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "precision"), [("octant", "double"), ("quarter", "single")])
def test_modelled_memory_is_what_building_and_stepping_take(name, precision):
    source, *settings = BODIES[name]
    scene = load_scene(source, [*settings[:1], "accuracy.edge=0.9", f"accuracy.precision={precision}"])
    for _ in range(2):  # the first time modules and kernels count, too
        effects = build_effects(scene)
        tracemalloc.start()
        body = build_body(scene, effects)
        building = tracemalloc.get_traced_memory()[1]
        run = Dynamics(body, effects, steps_per_unit=1e4)
        run.grow_to(1 + 1e-6)
        stepping = tracemalloc.get_traced_memory()[0]
        tracemalloc.stop()
    expected_building, expected_stepping = sizes.body_bytes(scene, body.elements.n)
    assert building == pytest.approx(expected_building, rel=0.1)
    assert stepping == pytest.approx(expected_stepping, rel=0.15)


def test_a_radial_scene_is_forecast_without_a_body():
    expected = morphofold.forecast("radial", threads=1)
    assert (expected.elements, expected.nodes, expected.steps) == (0, 0, 0)
    assert (expected.errors, expected.headline) == ({}, None)
    assert "one dimension" in forecasting.table_of(expected)
    assert json.loads(strict_json(expected.as_dict()), parse_constant=pytest.fail)["edge_mm"] is None


def test_the_presets_of_the_body_that_was_studied_are_not_doubted_and_another_growth_is():
    for level in LEVELS:
        scene = load_scene("fig6-thick", [f"accuracy.level={level}", "geometry.portion=octant"])
        sphere = scene.geometry
        edge = 0.5 * np.pi * sphere.radius / scene.cells / sphere.cortex_thickness
        expected = cost.errors_of_run(scene, edge)
        assert (expected.not_studied, expected.doubts) == ((), ())
    assert cost.errors_of_run(load_scene("fig6-thick", ["growth.final=1.75"]), 0.45).doubts


@pytest.mark.parametrize(
    ("source", "settings", "edge", "names"),
    [
        ("demo", (), 0.6, ()),
        ("fig6-thick", (), 1.5, ("edge",)),
        ("fig6-thick", ("growth.final=1.4",), 0.45, ("growth",)),
        ("fig6-thick", ("material.mu_ratio=0.5",), 0.45, ("mu_ratio",)),
        ("fig5-tangential", (), 0.45, ("law",)),
        ("skull", (), 0.45, ("effects",)),
        ("strip", ("growth.final=2",), 0.45, ("shape",)),
    ],
)
def test_errors_are_expected_of_what_was_studied_and_of_nothing_else(source, settings, edge, names):
    assert cost.not_studied(load_scene(source, settings), edge) == names


def test_a_mesh_on_which_folds_are_not_healthy_is_doubted():
    """By the bounds of health: edges over the thickness, and over the length of the first wrinkles."""
    scene = load_scene("fig6-thick", ["geometry.portion=octant"])
    standard, coarse = (forecast(load_scene(scene, setting)) for setting in ([], ["accuracy.edge=5"]))
    wave = first_wrinkles(scene).wavelength_over_T
    assert standard.cells_per_wave == pytest.approx(wave / standard.edge_over_T)
    assert coarse.cells_per_wave < 1 / BOUNDS["cell_over_wave"][0] < standard.cells_per_wave
    named = lambda f: [name for name in ("cell_over_T", "cell_over_wave") if any(name in text for text in f.doubts)]
    assert (named(standard), named(coarse)) == ([], ["cell_over_T", "cell_over_wave"])


def test_edges_to_choose_from_change_the_cells_one_by_one():
    for name in ("fig5", "ellipsoid", "patch"):
        scene = load_scene(name)
        T = scene.thinnest
        edges = sizes.edges_between(scene, 0.3 * T, 1.2 * T)
        meshes = [sizes.sizes_by_rule(load_scene(scene, [f"accuracy.edge={e!r}"]), (T, 20.0)) for e in edges]
        assert all(0.299 * T < s.edge <= 1.2 * T * (1 + 1e-9) for s in meshes)
        assert all(s.edge == pytest.approx(e, rel=1.1e-3) and s.edge <= e for s, e in zip(meshes, edges))
        assert all(a.elements < b.elements for a, b in itertools.pairwise(meshes))


def test_spans_and_percentages_as_text():
    spans = [span(s) for s in (0.04, 9.96, 119, 119.6, 280, 3599, 7500, 86399, 90000)]
    assert spans == ["0.0 s", "10 s", "119 s", "2 min", "4 min 40 s", "1 h", "2 h 5 min", "1 d", "1 d 1 h"]
    assert [percent(s) for s in (0.00333, 0.021, 0.5, 1.0, 2.5)] == ["0.33 %", "2.1 %", "50 %", "100 %", "250 %"]


def test_a_dry_run_writes_nothing_and_says_everything(cwd, capsys):
    settings = [*SMALL, "accuracy.edge=3.5"]
    argv = ["simulate", "fig6-thick", "--dry-run", "--threads", "1", *(w for s in settings for w in ("--set", s))]
    assert main(argv) == 0
    printed = capsys.readouterr().out
    for part in ("elements", "nodes", "steps", "GiB", "time", "error of gyrification index", "coarser than draft"):
        assert part in printed
    content = run_json([*argv, "--json"], capsys)
    assert content["elements"] == build_bilayer(load_scene("fig6-thick", settings)).mesh.nelements
    assert content["not_studied"] == []
    assert content["errors"]["wavelength"]["low"] < content["errors"]["wavelength"]["error"]
    content = run_json([*argv, "--json", "--set", "growth.law=tangential", "--set", "growth.final=1.1"], capsys)
    assert (content["not_studied"], content["errors"]) == (["law", "growth"], {})
    refused(capsys, ["simulate", "demo", "--dry-run", "--set", "growth.final=9"], "growth.final")
    refused(capsys, ["simulate", "demo", "--dry-run", "--threads", "9999"], "threads ", " 9999.")
    refused(capsys, ["simulate", "demo", "--dry-run", "--resume"], "--dry-run", "--resume", "[options-clash]")
    assert list(cwd.iterdir()) == []


def test_the_cost_of_a_run_adds_up_and_leaves_no_effect_out(tmp_path):
    scene = load_scene("core", [*SMALL, "accuracy.edge=4", "growth.final=1.02", "effects.core_growth.final=1.01"])
    run = simulate(scene, tmp_path / "run", threads=1)
    of_run = cost.cost_of(run.health, scene)
    assert sum(of_run.parts.values()) == pytest.approx(of_run.seconds, rel=0.02)
    assert set(run.health["effects"]) <= set(of_run.labels)
    assert of_run.labels["core_growth"] == "effect: within grow"
    assert of_run.labels["contact"] == "effect"
    assert {"contact", cost.OTHER_PHASE} <= set(of_run.parts)
    assert of_run.expected.not_studied == ("effects", "edge", "growth")
    assert of_run.expected.errors == {}
    assert of_run.expected.how in cost.cost_line(of_run)
    studied = cost.cost_of({**run.health, "surface_edge_mm": 1.5}, load_scene("fig6-thick", ["growth.final=1.8"]))
    assert (studied.expected.not_studied, studied.expected.errors) == ((), cost.expected_errors(0.5))
    assert percent(cost.headline(cost.expected_errors(0.5))[1].error) in cost.cost_line(studied)
    assert studied.expected.doubts
    assert ".." not in cost.cost_line(studied)  # doubts are sentences, joined as such
    assert cost.stored_cost(run.path) == of_run
    (tmp_path / "run" / "health.json").unlink()
    assert cost.stored_cost(run.path) is None


def test_the_page_of_a_simulation_says_what_it_cost(cwd, capsys, monkeypatch):
    settings = [*SMALL, "accuracy.edge=6", "growth.final=1.01", "output.volume=false"]
    simulate(load_scene("fig6-thick", settings), cwd / "run", threads=1, describe=freesurfer_maps)
    monkeypatch.setattr("morphofold.forecasts.cost_record.not_studied", lambda scene, edge_over_T: ())
    assert main(["analyze", "run", "-q", "-o", "analysis"]) == 0
    page = (cwd / "analysis" / "report.html").read_text(encoding="utf-8")
    section = page.split("<h2>What it cost</h2>")[1].split("</section>")[0]
    parts = ("by 1 thread", "GiB", "elements", cost.OTHER_PHASE, "symmetry", "perturbation", "once, within rest")
    for part in (*parts, "Relative error of", "gyrification index", "before the run, from its edge and a table"):
        assert part in section
