"""The command ``morphofold reproduce``, whose simulations are made up here; help and examples of the benchmarks."""

import json
import re
import shlex
import subprocess
import sys

import pytest
from commands import main, refused
from made_simulations import harmonic, made_simulation, settle

from morphofold.cli import parsed
from morphofold.cli.command_options import FIGURES
from morphofold.sim.output.simulation_folder import Simulation
from morphofold.sim.scene.scene_files import load_scene
from morphofold.studies import bench, paper
from morphofold.studies.pages.command_pages import commands_below
from morphofold.studies.paper import paper_folds, paper_theory


@pytest.fixture
def folder(cwd, monkeypatch):
    """An empty working directory, and figures of few stages."""
    monkeypatch.setattr(paper_folds, "STAGE_GROWTHS", (1.0, 1.5, 2.0))
    monkeypatch.setattr(paper_folds, "FIG5", ((1.5, 2.0),))
    monkeypatch.setattr(paper_theory, "RADIAL_STAGES", dict.fromkeys(paper_theory.RADIAL_STAGES, (2.0,)))
    monkeypatch.setattr(paper_theory, "SOLID_GROWTHS", (1.0, 1.3))
    return cwd


@pytest.fixture
def simulated(monkeypatch):
    """The calls of ``simulate``, which makes spheres up; a finished one it leaves alone, as the true one does."""
    calls = []

    def simulate(scene, out, *, settings, resume, threads, progress):
        assert resume
        scene = load_scene(scene, settings)
        if (out / "health.json").exists():
            return Simulation(out, scene)
        portion = getattr(scene.geometry, "portion", None)
        calls.append((out.relative_to(out.parents[2]).as_posix(), threads, scene.accuracy.level, portion))
        progress(1.0, "done")
        return made_simulation(out, scene, height=wave, warnings=["a bound is broken"])

    monkeypatch.setattr("morphofold.simulation.simulate", simulate)
    return calls


def wave(g, verts):
    return 2 * (g - 1) * (1 + harmonic(verts, 6, 3))


def reproduce(*arguments):
    return main(["reproduce", *arguments])


def names(folder):
    return {path.name for path in folder.iterdir()}


def test_the_command_knows_the_figures_that_can_be_drawn():
    assert list(FIGURES) == list(paper.REPRODUCTIONS)


@pytest.mark.slow
def test_reproduce_writes_figures_tables_and_an_index(folder, simulated, capsys):
    assert reproduce("fig4", "fig3", "fig4", "-o", "out", "--json", "-q") == 0
    index = json.loads(capsys.readouterr().out, parse_constant=pytest.fail)
    files = {f for figure in index["figures"].values() for f in figure["files"]}
    assert list(index["figures"]) == ["fig4", "fig3"]
    assert files == {"fig3.png", "fig3a.tsv", "fig3b.tsv", "fig4.png", "fig4.tsv"}
    assert names(folder / "out") == {*files, "summary.json", "report.html", ".morphofold", "simulations"}
    assert "Eq. (12)" in index["figures"]["fig4"]["equations"]
    assert [simulation["folder"] for simulation in index["figures"]["fig3"]["simulations"]] == [
        f"simulations/{name}" for name in ("fig3", "fig3-thin", "fig3-thick", "fig3-solid")
    ]


def test_reproduce_writes_the_same_bytes_again_and_grows_nothing_for_theory(folder, simulated):
    for out in ("a", "b"):
        assert reproduce("fig4", "-o", out, "-q") == 0
    assert simulated == []
    for out in ("a", "b"):
        assert reproduce("fig5", "-o", out, "-q") == 0
    for file in (folder / "a").glob("*.*"):
        if file.name == "summary.json":
            assert settle(file) == settle(folder / "b" / file.name)
        elif file.is_file() and file.name != "report.html":  # it says how long each took
            assert file.read_bytes() == (folder / "b" / file.name).read_bytes()


@pytest.mark.slow
def test_a_simulation_is_grown_once_and_stays_for_the_next_figure(folder, simulated, capsys):
    assert reproduce("fig5", "-o", "out", "--draft", "--threads", "1") == 0
    assert simulated == [("out/simulations/fig5-octant-draft", 1, "draft", "octant")]
    captured = capsys.readouterr()
    assert "fig5: warning: fig5: a bound is broken" in captured.out
    assert "fig5-octant-draft: 100%" in captured.err
    assert reproduce("fig5", "fig4", "-o", "out", "--draft", "-q") == 0
    assert len(simulated) == 1
    assert names(folder / "out" / "simulations") == {"fig5-octant-draft"}
    assert (folder / "out" / "simulations" / "fig5-octant-draft" / "stages" / "g2.00" / "surf" / "lh.pial").is_file()
    assert reproduce("fig5", "-o", "out", "-q") == 0
    assert simulated[1:] == [("out/simulations/fig5", None, "standard", "half")]


def test_an_interrupt_keeps_the_simulations_and_figures_of_before(folder, simulated, capsys, monkeypatch):
    assert reproduce("fig4", "-o", "out") == 0

    def interrupted(scene, out, **options):
        (out / "part").mkdir(parents=True)
        raise KeyboardInterrupt

    monkeypatch.setattr("morphofold.simulation.simulate", interrupted)
    for out, before in (("out", {"fig4.png", "fig4.tsv", "summary.json", "report.html"}), ("new", set())):
        assert reproduce("fig5", "-o", out, "-q") == 130
        assert "Run it again to go on." in capsys.readouterr().err
        assert names(folder / out) == {*before, ".morphofold", "simulations"}
        assert (folder / out / "simulations" / "fig5" / "part").is_dir()
    assert names(folder) == {"out", "new"}
    (folder / "new" / "simulations" / "fig5" / "part").rmdir()
    assert reproduce("fig4", "-o", "new") == 0  # a marked folder may be written


@pytest.mark.slow
def test_figures_of_an_earlier_run_stay_unless_a_file_is_missing(folder, simulated, capsys):
    for figure in ("fig3", "fig4"):
        assert reproduce(figure, "-o", "out", "-q") == 0
    assert "fig3: kept from an earlier run" in capsys.readouterr().out
    assert reproduce("fig3", "fig4", "-o", "both", "-q") == 0
    for file in (folder / "both").glob("fig*"):
        assert file.read_bytes() == (folder / "out" / file.name).read_bytes()
    (folder / "out" / "fig3b.tsv").unlink()
    assert reproduce("fig4", "-o", "out") == 0
    assert "fig4: kept" not in capsys.readouterr().out  # drawn again
    assert list(json.loads((folder / "out" / "summary.json").read_text())["figures"]) == ["fig4"]
    assert not (folder / "out" / "fig3.png").exists()
    assert names(folder / "out" / "simulations") == {"fig3", "fig3-thin", "fig3-thick", "fig3-solid"}


@pytest.mark.parametrize(
    ("index", "expected"),
    [
        ("{", "JSON"),
        ("[]", "dictionary"),
        ('{"figures": {"fig4": {}}}', "figures.fig4"),
        ('{"figures": {"fig4": {"shows": "", "files": [], "simulations": [{}]}}}', "figures.fig4.simulations.0"),
    ],
)
def test_reproduce_refuses_an_index_of_another_kind(folder, simulated, capsys, index, expected):
    assert reproduce("fig4", "-o", "out") == 0
    (folder / "out" / "summary.json").write_text(index)
    before = names(folder / "out")
    capsys.readouterr()
    assert re.search(expected, refused(capsys, ["reproduce", "fig3", "-o", "out", "-q"], "out/summary.json: "))
    assert simulated == []
    assert names(folder / "out") == before
    assert (folder / "out" / "summary.json").read_text() == index


def test_a_figure_that_was_changed_is_never_used_as_drawn(folder, capsys):
    assert reproduce("fig4", "-o", "out") == 0
    (folder / "out" / "fig4.tsv").write_text("mine")
    capsys.readouterr()
    refused(capsys, ["reproduce", "fig3", "-o", "out", "-q"], "out/fig4.tsv: ", " [mismatch]")
    assert (folder / "out" / "fig4.tsv").read_text() == "mine"
    assert reproduce("fig4", "-o", "out") == 0
    assert (folder / "out" / "fig4.tsv").read_text() != "mine"


def test_two_runs_into_one_folder_never_lose_a_figure(folder, capsys, monkeypatch):
    """The second begins while the first draws, and would keep only what was there before it."""
    codes, draw = [], paper.REPRODUCTIONS["fig4"]

    def slowly(folder, runs):
        codes.append(reproduce("fig3", "-o", "out", "-q"))
        return draw(folder, runs)

    monkeypatch.setitem(paper.REPRODUCTIONS, "fig4", slowly)
    assert reproduce("fig4", "-o", "out", "-q") == 0
    assert codes == [2]
    assert "another run" in capsys.readouterr().err
    assert names(folder) == {"out"}
    assert (folder / "out" / "fig4.tsv").is_file()


def test_every_benchmark_has_help_with_an_example_that_is_understood(capsys):
    for (name,), command in commands_below(bench.app()):
        assert bench.main([name, "--help"]) == 0
        assert "python3 run.py bench" in capsys.readouterr().out
        for line in re.findall("- `(.*)`", command.help):
            arguments = shlex.split(line)
            assert arguments[:4] == ["python3", "run.py", "bench", name]
            assert type(parsed(bench.app(), arguments[3:])).__name__.lower() == name


def test_the_module_is_a_program_whose_errors_name_it():
    argv = [sys.executable, "-m", "morphofold.studies.bench", "speed", "--seconds", "nan"]
    done = subprocess.run(argv, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("run.py bench speed: --seconds ")
    assert done.stderr.endswith(" [out-of-range]\n")
