"""The accuracy that a budget or an error picks: what is refused, and that more time buys a finer mesh."""

import re

import pytest
from commands import refused

from morphofold.cli import main
from morphofold.errors import NoSolution, NotReadable, OptionsClash, OutOfRange
from morphofold.forecasts import forecast, forecasting
from morphofold.forecasts.cost_record import STUDIED_RANGES, expected_errors, headline
from morphofold.forecasts.mesh_choice import budget_seconds, choose_mesh, error_share
from morphofold.sim.scene import MOST_BRICKS
from morphofold.sim.scene.scene_files import load_scene


def expected_error(edge_over_T):
    return headline(expected_errors(edge_over_T))[1].error


OCTANT = ("geometry.portion=octant", "output.stages=[]")
ERRORS = [1.001 * expected_error(edge) for edge in (0.9, 0.6, 0.4)]  # that edges of so many T just keep


@pytest.fixture
def clockwork(monkeypatch):
    """A machine on which an element-step takes 50 ns and a body is built at once, so that picks do not tremble; a
    small body stands for the scene's, since nothing is timed on it."""

    def timed(run):
        return {"elements": 50e-9 * run.body.elements.n, "contact": 0.0, "grow": 0.0}, 1.0, 1.0

    monkeypatch.setattr(forecasting, "MOST_TIMED_BRICKS", 4000)
    monkeypatch.setattr(forecasting, "_time_steps", timed)
    monkeypatch.setattr(forecasting, "slowness_of_stages", lambda: 1.0)


@pytest.mark.parametrize(
    ("text", "seconds"), [("90s", 90), ("5min", 300), ("2h", 7200), (" 1.5 d ", 129600), (".5h", 1800)]
)
def test_a_budget_has_a_number_and_a_unit(text, seconds):
    assert budget_seconds(text) == seconds


@pytest.mark.parametrize(
    ("option", "read", "outside", "unreadable"),
    [
        ("budget", budget_seconds, ["0s", "9" * 400 + "s"], ["", "5", "-5s", "1h 30min", "nan s", "1e3s"]),
        ("error", error_share, ["0", "0%", "100%"], ["", "-1%", "nan", "1%%"]),
    ],
)
def test_any_other_budget_or_error_is_refused(option, read, outside, unreadable):
    for error, texts in ((OutOfRange, outside), (NotReadable, unreadable)):
        for text in texts:
            with pytest.raises(error, match=re.escape(f"--{option} {text}: ")):
                read(text)


@pytest.mark.slow
def test_more_time_buys_a_finer_mesh_that_fits(clockwork):
    scene = load_scene("fig6-thick", OCTANT)
    picks = [choose_mesh(scene, budget=seconds, threads=1) for seconds in (8, 15, 30)]
    edges = [p.scene.accuracy.edge for p in picks]
    assert edges == sorted(edges, reverse=True)
    assert len(set(edges)) == len(edges)
    for seconds, p in zip((8, 15, 30), picks):
        assert p.forecast.slowest <= seconds
    finer = load_scene(scene, [f"accuracy.edge={edges[1] * 0.9}"])
    assert forecast(finer, threads=1).slowest > 15


@pytest.mark.slow
def test_edges_with_too_many_bricks_are_left_out_whatever_the_level(clockwork):
    scene = load_scene("fig6-thin", ["geometry.portion=full", "accuracy.level=draft"])
    assert scene.elements_through_cortex == 2  # edges up to T/2 take three
    assert choose_mesh(scene, budget=1e9, threads=1).scene.bricks <= MOST_BRICKS


def test_a_smaller_error_takes_a_finer_mesh_and_no_finer_than_it_must(clockwork):
    scene = load_scene("fig6-thick", OCTANT)
    picks = [choose_mesh(scene, error=error, threads=1) for error in ERRORS]
    edges = [p.forecast.edge_over_T for p in picks]
    assert edges == sorted(edges, reverse=True)
    for error, p in zip(ERRORS, picks):
        assert p.forecast.headline[1].error <= error
        cells = p.scene.cells
        assert expected_error(p.forecast.edge_over_T * cells / (cells - 4)) > error  # the next coarser one
    assert picks[0].forecast.seconds < picks[-1].forecast.seconds


def test_an_error_within_a_budget_takes_the_least_time_and_what_cannot_be_had_is_refused_with_numbers(clockwork):
    scene = load_scene("fig6-thick", OCTANT)
    without_budget = choose_mesh(scene, error=ERRORS[0], threads=1)
    assert choose_mesh(scene, error=ERRORS[0], budget=3600, threads=1).scene == without_budget.scene
    with pytest.raises(OptionsClash, match=r"--error [\d.]+ %.*\bfig6-thick\b.*--budget 2\.0 s\b"):
        choose_mesh(scene, error=ERRORS[2], budget=2, threads=1)
    with pytest.raises(NoSolution, match=r"--budget 1\.0 s: fig6-thick\b.* \d.* \(\d\.\d\d T\)"):
        choose_mesh(scene, budget=1, threads=1)
    with pytest.raises(NoSolution, match=r"--error 1 %: .*\(0\.2\d T\).*\bfig6-thick\b") as refusal:
        choose_mesh(scene, error=0.01, threads=1)
    least = re.search(r"fig6-thick\b.* ([\d.]+) %", str(refusal.value))[1]
    assert choose_mesh(scene, error=float(least) / 100, threads=1).forecast.edge_over_T < 0.3
    with pytest.raises(OptionsClash):
        choose_mesh(scene)


@pytest.mark.parametrize(
    ("scene", "expected"),
    [
        ("mesh", ("'mesh'", "[does-not-apply]")),
        ("radial", ("'radial'", "[does-not-apply]")),
        ("strip", ("strip", "0.5 mm", "[options-clash]")),
    ],
)
def test_a_scene_that_has_no_edge_to_choose_is_refused(cwd, capsys, scene, expected):
    refused(capsys, ["simulate", scene, "--budget", "5min"], "--budget", "accuracy.edge", *expected)
    refused(capsys, ["simulate", scene, "--error", "1%"], "--error", "accuracy.edge", *expected)


def test_what_cannot_be_run_is_refused_before_anything_is_timed(cwd, capsys, monkeypatch):
    refused(capsys, ["simulate", "fig5", "--error", "1%", "--resume"], "--error", "--resume", "[options-clash]")
    refused(capsys, ["simulate", "fig5", "--budget", "1h", "--set", "accuracy.edge=1"], " 1 mm", "[options-clash]")
    refused(capsys, ["simulate", "fig5", "--budget", "soon"], "--budget soon: ", "[not-readable]")
    assert list(cwd.iterdir()) == []
    monkeypatch.setattr("morphofold.cli.simulate.choose_mesh", lambda *args, **options: pytest.fail("timed"))
    (cwd / "busy").mkdir()
    (cwd / "busy" / "notes.txt").write_text("of the user")
    refused(capsys, ["simulate", "fig5", "--budget", "1h", "-o", "busy"], "busy: is not empty and holds no simulation")


@pytest.mark.parametrize(
    ("source", "settings"), [("patch", ()), ("ellipsoid", ()), ("fig5-tangential", ()), ("fig5", ("growth.final=1.1",))]
)
def test_an_error_is_refused_where_none_was_studied_and_a_budget_is_not(cwd, capsys, clockwork, source, settings):
    argv = ["simulate", source, *(word for setting in settings for word in ("--set", setting)), "--error", "9%"]
    refused(capsys, argv, "--error", "--budget", "[not-studied]")
    refused(capsys, [*argv, "--budget", "1h"], "--error", "--estimate", "[not-studied]")
    chosen = choose_mesh(load_scene(source, settings), budget=1e4, threads=1)
    assert chosen.forecast.not_studied
    assert chosen.forecast.headline is None
    assert chosen.forecast.how["errors"] in chosen.words


@pytest.mark.slow
def test_the_run_records_the_edge_that_was_picked(cwd, capsys, monkeypatch):
    monkeypatch.setitem(STUDIED_RANGES, "growth", (1.0, 2.0))
    argv = ["simulate", "fig6-thick", "--error", f"{expected_error(1.0):.6f}", "-q", "-o", "run", "--threads", "1"]
    for setting in (*OCTANT, "growth.final=1.004"):
        argv += ["--set", setting]
    assert main(argv) == 0
    printed = capsys.readouterr().out
    chosen = re.search(r"chose an edge of (\d\.\d\d) T \(coarser than draft\): ([\d,]+) elements", printed)
    scene = load_scene(cwd / "run" / "scene.toml")
    assert scene.accuracy.edge / 3 == pytest.approx(float(chosen[1]), abs=0.006)
    assert scene.elements_through_cortex == 2
    assert f"{chosen[2]} bricks" in printed
    assert "expected error about" in printed
