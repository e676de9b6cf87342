"""The command ``morphofold reproduce``; the simulations that figures ask for are made up."""

import json
import re

import pytest
from commands import main
from made_simulations import harmonic, made_simulation, settle

from morphofold.sim.output.folder import Simulation
from morphofold.sim.scene.scene_files import load_scene
from morphofold.studies import paper
from morphofold.studies.paper import paper_folds, paper_theory
from morphofold.studies.runs import Runs


@pytest.fixture
def cwd(tmp_path, monkeypatch):
    """An empty working directory, and figures of few stages."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(paper_folds, "STAGES", (1.0, 1.5, 2.0))
    monkeypatch.setattr(paper_folds, "FIG5", ((1.5, 2.0),))
    monkeypatch.setattr(paper_theory, "RADIAL", dict.fromkeys(paper_theory.RADIAL, (2.0,)))
    monkeypatch.setattr(paper_theory, "SOLID", (1.0, 1.3))
    return tmp_path


@pytest.fixture
def grown(monkeypatch):
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


def refused(capsys, *argv):
    """The one line that a refused command says."""
    assert main(list(argv)) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert len(captured.err.splitlines()) == 1
    return captured.err


def index_of(file):
    """A summary whose only figure has this file."""
    return json.dumps({"figures": {"fig4": {"shows": "", "files": [file]}}})


def names(folder):
    return {path.name for path in folder.iterdir()}


@pytest.mark.slow
def test_reproduce_writes_figures_tables_and_an_index(cwd, grown, capsys):
    assert main(["reproduce", "fig4", "fig3", "fig4", "-o", "out", "--json", "-q"]) == 0
    index = json.loads(capsys.readouterr().out, parse_constant=pytest.fail)
    files = {f for figure in index["figures"].values() for f in figure["files"]}
    assert list(index["figures"]) == ["fig4", "fig3"]
    assert files == {"fig3.png", "fig3a.tsv", "fig3b.tsv", "fig4.png", "fig4.tsv"}
    assert names(cwd / "out") == {*files, "summary.json", "report.html", ".morphofold", "simulations"}
    assert index["morphofold"]
    assert "Eq. (12)" in index["figures"]["fig4"]["equations"]
    assert [simulation["folder"] for simulation in index["figures"]["fig3"]["simulations"]] == [
        f"simulations/{name}" for name in ("fig3", "fig3-thin", "fig3-thick", "fig3-solid")
    ]


def test_reproduce_writes_the_same_bytes_again(cwd, grown, capsys):
    for out in ("a", "b"):
        assert main(["reproduce", "fig4", "fig5", "-o", out, "-q"]) == 0
    for file in (cwd / "a").glob("*.*"):
        if file.name == "summary.json":
            assert settle(file) == settle(cwd / "b" / file.name)
        elif file.is_file() and file.name != "report.html":  # it says how long each took
            assert file.read_bytes() == (cwd / "b" / file.name).read_bytes()


def test_a_theory_figure_grows_nothing(cwd, grown):
    assert main(["reproduce", "fig4", "-o", "out"]) == 0
    assert grown == []
    assert names(cwd / "out") == {"fig4.png", "fig4.tsv", "summary.json", "report.html", ".morphofold"}


@pytest.mark.slow
def test_a_simulation_is_grown_once_and_stays_for_the_next_figure(cwd, grown, capsys):
    assert main(["reproduce", "fig5", "-o", "out", "--draft", "--threads", "1"]) == 0
    assert grown == [("out/simulations/fig5-octant-draft", 1, "draft", "octant")]
    captured = capsys.readouterr()
    assert "fig5: warning: fig5: a bound is broken" in captured.out
    assert "fig5-octant-draft: 100%" in captured.err
    assert main(["reproduce", "fig5", "fig4", "-o", "out", "--draft", "-q"]) == 0
    assert len(grown) == 1
    assert names(cwd / "out" / "simulations") == {"fig5-octant-draft"}
    assert (cwd / "out" / "simulations" / "fig5-octant-draft" / "stages" / "g2.00" / "surf" / "lh.pial").is_file()
    assert main(["reproduce", "fig5", "-o", "out", "-q"]) == 0
    assert grown[1:] == [("out/simulations/fig5", None, "standard", "half")]


@pytest.mark.parametrize(("draft", "accuracy"), [(True, "draft"), (False, "standard")])
def test_a_cortex_is_measured_once_and_a_draft_at_draft_accuracy(draft, accuracy, tmp_path, monkeypatch):
    calls = []
    monkeypatch.setattr("morphofold.analysis.measure", lambda cortex, **options: calls.append((cortex, options)))
    runs = Runs(tmp_path, threads=1, quiet=True, draft=draft)
    for _ in range(2):
        runs.measure("one", "cortex")
    assert [(cortex, options["accuracy"]) for cortex, options in calls] == [("cortex", accuracy)]


def test_an_interrupt_keeps_simulations_and_figures_that_were_there(cwd, grown, capsys, monkeypatch):
    assert main(["reproduce", "fig4", "-o", "out"]) == 0

    def interrupted(scene, out, **options):
        (out / "part").mkdir(parents=True)
        raise KeyboardInterrupt

    monkeypatch.setattr("morphofold.simulation.simulate", interrupted)
    for out, there in (("out", {"fig4.png", "fig4.tsv", "summary.json", "report.html"}), ("new", set())):
        assert main(["reproduce", "fig5", "-o", out, "-q"]) == 130
        assert "Run it again to go on." in capsys.readouterr().err
        assert names(cwd / out) == {*there, ".morphofold", "simulations"}
        assert (cwd / out / "simulations" / "fig5" / "part").is_dir()
    assert names(cwd) == {"out", "new"}
    (cwd / "new" / "simulations" / "fig5" / "part").rmdir()
    monkeypatch.undo()
    monkeypatch.chdir(cwd)
    assert main(["reproduce", "fig4", "-o", "new"]) == 0  # a marked folder may be written


def test_simulations_are_copied_where_files_cannot_have_two_names(cwd, grown, monkeypatch):
    def refuse(source, target, **how):
        raise OSError("no links here")

    monkeypatch.setattr("os.link", refuse)
    assert main(["reproduce", "fig5", "-o", "out", "-q"]) == 0
    assert Simulation(cwd / "out" / "simulations" / "fig5", load_scene("fig5")).stages[-1] == 2


def test_reproduce_refuses_a_figure_that_it_does_not_know_before_it_writes(cwd, capsys):
    message = refused(capsys, "reproduce", "fig3", "fig33")
    assert "'fig33'" in message
    assert "fig3, fig4" in message
    assert " [unknown-name]" in message
    assert list(cwd.iterdir()) == []


def test_reproduce_leaves_a_folder_of_someone_else_alone(cwd, grown, capsys):
    (cwd / "reproduce").mkdir()
    (cwd / "reproduce" / "thesis.txt").write_text("mine")
    for figure in ("fig4", "fig5"):
        assert "thesis.txt" in refused(capsys, "reproduce", figure)
    assert grown == []
    assert names(cwd / "reproduce") == {"thesis.txt"}


@pytest.mark.slow
def test_reproduce_keeps_the_figures_that_are_there(cwd, grown, capsys):
    for figure in ("fig3", "fig4"):
        assert main(["reproduce", figure, "-o", "out", "-q"]) == 0
    assert "fig3: kept from an earlier run" in capsys.readouterr().out
    assert main(["reproduce", "fig4", "-o", "out"]) == 0
    assert "fig4: kept" not in capsys.readouterr().out  # drawn again
    assert main(["reproduce", "fig3", "fig4", "-o", "both", "-q"]) == 0
    for file in (cwd / "both").glob("fig*"):
        assert file.read_bytes() == (cwd / "out" / file.name).read_bytes()


def test_reproduce_keeps_no_figure_of_which_a_file_is_gone(cwd, grown):
    assert main(["reproduce", "fig3", "-o", "out", "-q"]) == 0
    (cwd / "out" / "fig3b.tsv").unlink()
    assert main(["reproduce", "fig4", "-o", "out"]) == 0
    assert list(json.loads((cwd / "out" / "summary.json").read_text())["figures"]) == ["fig4"]
    assert not (cwd / "out" / "fig3.png").exists()
    assert names(cwd / "out" / "simulations") == {"fig3", "fig3-thin", "fig3-thick", "fig3-solid"}


def test_reproduce_refuses_an_index_that_it_cannot_read(cwd, capsys):
    assert main(["reproduce", "fig4", "-o", "out"]) == 0
    (cwd / "out" / "summary.json").write_text("{")
    capsys.readouterr()
    assert "out/summary.json: " in refused(capsys, "reproduce", "fig3", "-o", "out")


@pytest.mark.parametrize(
    ("index", "why"),
    [
        ("[]", "dictionary"),
        ("{}", "figures"),
        ('{"figures": []}', "figures"),
        ('{"figures": {"fig4": {}}}', "figures.fig4"),
        ('{"figures": {"fig4": 3}}', "figures.fig4"),
        ('{"figures": {"fig4": {"shows": "", "files": [3]}}}', "figures.fig4.files.0"),
        ('{"figures": {"fig4": {"shows": "", "files": [], "seconds": "x"}}}', "figures.fig4.seconds"),
        ('{"figures": {"fig4": {"shows": "", "files": [], "simulations": [{}]}}}', "figures.fig4.simulations.0"),
        (index_of("../thesis.txt"), r"fig4 .*'\.\./thesis\.txt'\. .*\[damaged-file\]"),
        (index_of("fig4/../../thesis.txt"), r"fig4 .*'fig4/\.\./\.\./thesis\.txt'\. .*\[damaged-file\]"),
        (index_of("summary.json"), r"fig4 .*'summary\.json'\. .*\[damaged-file\]"),
        ("[" * 100_000, "JSON"),
    ],
)
def test_reproduce_refuses_an_index_of_another_kind(cwd, grown, capsys, index, why):
    assert main(["reproduce", "fig4", "-o", "out"]) == 0
    (cwd / "thesis.txt").write_text("mine")
    (cwd / "out" / "summary.json").write_text(index)
    before = names(cwd / "out")
    capsys.readouterr()
    message = refused(capsys, "reproduce", "fig3", "-o", "out", "-q")
    assert "out/summary.json: " in message
    assert re.search(why, message)
    assert grown == []
    assert names(cwd / "out") == before
    assert (cwd / "out" / "summary.json").read_text() == index


def test_a_figure_that_was_changed_is_never_kept_as_drawn(cwd, capsys):
    assert main(["reproduce", "fig4", "-o", "out"]) == 0
    (cwd / "out" / "fig4.tsv").write_text("mine")
    capsys.readouterr()
    message = refused(capsys, "reproduce", "fig3", "-o", "out", "-q")
    assert "out/fig4.tsv: " in message
    assert " [mismatch]" in message
    assert (cwd / "out" / "fig4.tsv").read_text() == "mine"
    assert main(["reproduce", "fig4", "-o", "out"]) == 0
    assert (cwd / "out" / "fig4.tsv").read_text() != "mine"


def test_two_runs_into_one_folder_never_lose_a_figure(cwd, capsys, monkeypatch):
    """The second begins while the first draws, and would keep only what was there before it."""
    codes, draw = [], paper.REPRODUCTIONS["fig4"]

    def slowly(folder, runs):
        codes.append(main(["reproduce", "fig3", "-o", "out", "-q"]))
        return draw(folder, runs)

    monkeypatch.setitem(paper.REPRODUCTIONS, "fig4", slowly)
    assert main(["reproduce", "fig4", "-o", "out", "-q"]) == 0
    assert codes == [2]
    stderr = capsys.readouterr().err
    assert "out: " in stderr or ".out.lock: " in stderr
    assert "another run" in stderr
    assert {path.name for path in cwd.iterdir()} == {"out"}
    assert (cwd / "out" / "fig4.tsv").is_file()


def test_threads_that_cannot_be_had_are_refused_before_anything_is_written(cwd, grown, capsys):
    for argv in (("reproduce", "fig5"), ("reproduce", "fig4"), ("bench", "folds")):
        assert re.search(r"threads .* 1 .* 0\.", refused(capsys, *argv, "--threads", "0", "-o", "out"))
    assert grown == []
    assert list(cwd.iterdir()) == []


def test_reproduce_refuses_a_folder_without_a_name(cwd, capsys):
    assert "-o" in refused(capsys, "reproduce", "fig4", "-o", "")
    assert list(cwd.iterdir()) == []
