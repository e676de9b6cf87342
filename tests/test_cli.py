import errno
import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from commands import refused

from morphofold.analysis.measures import SCALARS
from morphofold.cli import COMMANDS, app, main, parsed
from morphofold.cli.options import Answer
from morphofold.cli.paths import writable_name
from morphofold.io import sample_path, write_surface
from morphofold.results import read_analysis
from morphofold.shapes import icosphere
from morphofold.sim.scene.files import load_scene
from morphofold.studies.pages.commands import commands_below
from morphofold.surface import Surface
from morphofold.tables import read_table

DOCS = Path(__file__).resolve().parent.parent / "docs"


def pair(folder, levels=(3, 3)):
    """White and pial spheres, 2 mm apart, as FreeSurfer files."""
    for name, level, radius in zip(("lh.white", "lh.pial"), levels, (20.0, 22.0)):
        write_surface(folder / name, Surface(*icosphere(level, radius=radius)))
    return ["analyze", "--white", str(folder / "lh.white"), "--pial", str(folder / "lh.pial"), "-q", "-o", "out"]


def test_analyze_measures_a_pair_of_files(here, capsys):
    assert main([*pair(here), "--no-report", "--json"]) == 0
    summary = json.loads(capsys.readouterr().out, parse_constant=pytest.fail)
    measures = summary["surfaces"][0]["measures"]
    assert measures["euler_characteristic"] == 2
    assert measures["mean_cortical_thickness_mm"] == pytest.approx(2.0, rel=0.02)
    assert measures["gyrification_index"] == pytest.approx(1.0, abs=0.01)
    assert measures["median_gyral_thickness_mm"] is None  # a sphere has no gyri


def test_only_some_measures_are_written_and_compared(here, capsys):
    assert main([*pair(here), "--no-report", "--only", "mean_cortical_thickness_mm,cortical_thickness"]) == 0
    assert "mean_cortical_thickness_mm 2.0" in capsys.readouterr().out
    (row,) = read_table(here / "out" / "surfaces.tsv", ("hemi",))
    assert row["mean_cortical_thickness_mm"] == pytest.approx(2.0, rel=0.02)
    assert row["gyrification_index"] is None
    assert {path.name for path in (here / "out" / "maps").glob("lh.*")} == {
        "lh.cortical_thickness",
        "lh.cortical_thickness.shape.gii",
    }
    (read,) = read_analysis(here / "out")
    assert read.parameters["only"] == ["mean_cortical_thickness_mm", "cortical_thickness"]
    assert main(["compare", "a=out", "b=out", "-q", "-o", "both"]) == 0


def test_only_of_an_unknown_name_writes_nothing(here, capsys):
    line = refused(capsys, [*pair(here), "--only", "gyral_thicknes"], "'gyral_thicknes'", "[unknown-name]")
    assert "gyral_thickness" in line
    refused(capsys, ["analyze", "run", "--only", "H", "--stages"], "--only", "[options-clash]")
    assert not (here / "out").exists()


@pytest.mark.parametrize(("word", "hemi"), [("LH", "lh"), ("L", "lh"), ("left", "lh"), ("Right", "rh"), ("rh", "rh")])
def test_a_hemisphere_is_understood_in_any_spelling(word, hemi):
    args = parsed(app(), ["analyze", "subject", "--hemi", word])
    assert args.hemi == hemi


@pytest.mark.parametrize("command", ["analyze", "cohort", "bids"])
def test_what_is_no_hemisphere_is_refused(capsys, command):
    assert main([command, "there", *(["out", "group"] if command == "bids" else []), "--hemi", "middle"]) == 2
    assert "'middle'" in capsys.readouterr().err


def test_scalars_are_a_table_of_one_row_for_each_hemisphere(here):
    assert main([*pair(here), "--no-report"]) == 0
    (row,) = read_table(here / "out" / "surfaces.tsv", ("hemi",))
    summary = json.loads((here / "out" / "summary.json").read_text())["surfaces"][0]["measures"]
    assert row["hemi"] == "lh"
    assert set(SCALARS) < set(row)
    assert row["etiv_mm3"] is None
    for name, value in summary.items():
        assert row[name] == (None if value is None else pytest.approx(value, rel=1e-6))


def test_what_an_open_surface_lacks_is_said_to_be_missing(here, capsys):
    strip = ["simulate", "strip", "-q", "-o", "strip", "--set", "growth.final=1.002", "--set", "accuracy.edge=4"]
    assert main(strip) == 0
    capsys.readouterr()
    assert main(["analyze", "strip", "--no-report", "-q"]) == 0
    assert "GI n/a, cortical thickness 2.50 mm" in capsys.readouterr().out


@pytest.mark.parametrize("option", ["--curvature-scale", "--gyral-width"])
@pytest.mark.parametrize("length", ["-3", "0", "nan", "inf"])
def test_a_length_that_is_none_is_refused_before_anything_is_read(here, capsys, option, length):
    refused(capsys, ["analyze", "not-there", f"{option}={length}"], option, f"got {length}.", "[out-of-range]")


def test_the_bids_layout_asks_for_its_dataset_and_refuses_what_is_of_the_plain_one(here, capsys):
    argv = [*pair(here)[:-2], "--layout", "bids"]
    refused(capsys, argv, "--layout=bids", "--out", "[options-clash]")
    for option in ("--mgh", "--wide"):
        refused(capsys, [*argv, "-o", "out", option], option, "--layout=bids", "[options-clash]")


def test_a_line_break_in_a_name_is_not_part_of_a_folders_name():
    assert writable_name("a/b\nc\x7f d") == "a-b-c- d"


def test_a_pair_whose_names_tell_no_hemisphere_asks_for_it(here, capsys):
    pair(here)
    for name in ("white", "pial"):
        (here / f"lh.{name}").rename(here / name)
    argv = ["analyze", "--white", "white", "--pial", "pial", "-o", "out", "-q", "--no-report"]
    refused(capsys, argv, "white: ", "--hemi", "[options-clash]")
    refused(capsys, [*argv, "--hemi", "both"], "white: ", "--hemi", "[options-clash]")
    assert main([*argv, "--hemi", "rh", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["surfaces"][0]["hemi"] == "rh"


def test_analyze_refuses_a_missing_file(here, capsys):
    argv = pair(here)
    (here / "lh.pial").unlink()
    refused(capsys, argv, "lh.pial")
    refused(capsys, ["analyze", "nobody", "-o", "out"], "nobody")
    assert not (here / "out").exists()


def test_analyze_refuses_a_truncated_file(here, capsys):
    argv = pair(here)
    whole = (here / "lh.white").read_bytes()
    for length in (2, 40, len(whole) // 2, len(whole) - 5):
        (here / "lh.white").write_bytes(whole[:length])
        refused(capsys, argv, "lh.white")
    assert not (here / "out").exists()


def test_analyze_refuses_text_instead_of_a_surface(here, capsys):
    argv = pair(here)
    (here / "lh.white").write_text("this is not a surface\n" * 50)
    refused(capsys, argv, "lh.white")
    assert not (here / "out").exists()


def test_analyze_refuses_surfaces_that_do_not_belong_together(here, capsys):
    refused(capsys, pair(here, levels=(3, 2)), "lh.white", " 642 ", "lh.pial", " 162")
    assert not (here / "out").exists()


def test_analyze_wants_one_input(here, capsys):
    refused(capsys, ["analyze", "-o", "out"], "INPUT", "-s", "--white", "--pial", "[options-clash]")
    refused(capsys, ["analyze", "--white", "lh.white"], "--white", "--pial", "[options-clash]")


def test_analyze_leaves_a_folder_of_someone_else_alone(here, capsys):
    (here / "out").mkdir()
    (here / "out" / "thesis.txt").write_text("mine")
    refused(capsys, [*pair(here), "--no-report"], "out")
    assert [p.name for p in (here / "out").iterdir()] == ["thesis.txt"]


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ("growth.gama=2", ("growth.gama", "[unknown-name]")),
        ("geometry.hole_radius=49", ("hole_radius 49 ", " 47")),
        ("growth.final=nan", ("growth.final",)),
    ],
)
def test_simulate_refuses_a_bad_scene(here, capsys, setting, words):
    refused(capsys, ["simulate", "demo", "--set", setting, "-o", "out"], *words)
    assert list(here.iterdir()) == []


def test_simulate_refuses_missing_and_foreign_scene_files(here, capsys):
    refused(capsys, ["simulate", "fig55", "-o", "out"], "'fig55'", " fig5?")
    shutil.copy(sample_path("fsaverage5") / "surf" / "lh.white", here / "scene.toml")
    refused(capsys, ["simulate", "scene.toml", "-o", "out"], "scene.toml", "UTF-8")
    (here / "half.toml").write_text('name = "half"\n[geometry\n')
    refused(capsys, ["simulate", "half.toml", "-o", "out"], "half.toml", "line 2")
    assert not (here / "out").exists()


def test_compare_says_what_to_do_with_a_subject_and_with_a_foreign_one_of_bids(here, capsys):
    (here / "bert" / "surf").mkdir(parents=True)
    refused(capsys, ["compare", "a=bert", "-o", "out"], "bert: ", "summary.json", "`morphofold analyze bert`")
    (here / "sub-bert" / "anat").mkdir(parents=True)
    refused(capsys, ["compare", "a=sub-bert", "-o", "out"], "sub-bert/anat: ", "sub-NAME_desc-morphofold")


@pytest.mark.slow
def test_the_gyral_width_of_the_net_can_be_held(here):
    for more, width in (([], None), (["--gyral-width", "9"], 9.0)):
        assert main(["analyze", str(sample_path("simulated")), "-q", "--no-report", "-o", "out", *more]) == 0
        summary = json.loads((here / "out" / "summary.json").read_text())
        assert summary["parameters"]["gyral_width_mm"] == width
        found = summary["surfaces"][0]["parameters"]["graph_width_mm"]
        assert (found == 9.0) == (width == 9.0)


@pytest.mark.parametrize(
    ("layout", "name"),
    [("plain", "standard"), *(pytest.param(layout, "fine", marks=pytest.mark.slow) for layout in ("plain", "bids"))],
)
def test_the_accuracy_is_recorded_and_standard_goes_without_saying(here, layout, name):
    file = "sub-a/anat/sub-a_desc-morphofold_provenance.json" if layout == "bids" else "summary.json"
    common = ["analyze", str(sample_path("simulated")), "-q", "--no-report", "--layout", layout, "--name", "a"]
    assert main([*common, "-o", "out", *([] if name == "standard" else ["--accuracy", name])]) == 0
    content = json.loads((here / "out" / file).read_text())
    assert content["parameters"].get("accuracy", "standard") == name
    used = content["surfaces"][0]["parameters"]
    assert used["accuracy"] == name
    n = content["surfaces"][0]["measures"]["n_vertices"]
    assert (used["accuracy_vertices"] > n) == (name == "fine")  # 2 to 10 thousand are split
    assert ("accuracy" in content["surfaces"][0]["notes"]) == (name == "fine")


def test_an_accuracy_of_another_name_is_refused(here, capsys):
    refused(capsys, ["analyze", str(sample_path("simulated")), "--accuracy", "best", "-o", "out"], "--accuracy", "best")
    assert not (here / "out").exists()


def test_compare_refuses_what_is_no_analysis(here, capsys):
    (here / "empty").mkdir()
    argv = ["compare", "a=empty", "-o", "out"]
    refused(capsys, argv, "empty")
    refused(capsys, ["compare", "a=nowhere", "-o", "out"], "nowhere")
    refused(capsys, ["compare", "justaname", "-o", "out"], "'justaname'", "NAME=DIR", "[not-readable]")
    refused(capsys, ["compare", "a=empty", "a=empty", "-o", "out"], "'a'", "[named-twice]")
    for group in ("model", "=a", "model=a,,b"):
        refused(capsys, [*argv, "--group", group], f"--group {group!r}", "GROUP=NAME,NAME", "[not-readable]")
    refused(capsys, [*argv, "--group", "m=a", "--group", "m=b"], "--group ", "'m'", "[named-twice]")
    refused(capsys, [*argv, "--colour", "0072b2"], "--colour '0072b2'", "NAME=RRGGBB", "[not-readable]")
    assert not (here / "out").exists()


def test_compare_refuses_a_damaged_analysis(here, capsys):
    assert main([*pair(here), "--no-report"]) == 0
    capsys.readouterr()
    text = (here / "out" / "summary.json").read_text()
    (here / "out" / "summary.json").write_text(text[: len(text) // 2])
    refused(capsys, ["compare", "a=out", "-o", "c"], "summary.json")
    assert not (here / "c").exists()


def test_compare_puts_two_analyses_side_by_side(here, capsys):
    assert main([*pair(here), "--no-report"]) == 0
    assert main(["compare", "one=out", "two=out", "--colour", "two=a0b0c0", "-q", "--json", "-o", "both"]) == 0
    printed = capsys.readouterr().out
    content = json.loads(printed[printed.index("{") :], parse_constant=pytest.fail)
    assert content["names"] == ["one", "two"]
    assert content["colours"]["two"] == "#a0b0c0"
    assert (here / "both" / "report.html").stat().st_size > 10_000


@pytest.mark.slow
def test_stages_are_measured_once_and_compared_over_growth(here, capsys):
    """Two copies of the simulated sample as stages; what is missing or was measured otherwise is measured anew."""
    for g in ("g1.80", "g2.00"):
        stage = here / "sim" / "stages" / g
        shutil.copytree(sample_path("simulated"), stage)
        info = json.loads((stage / "stage.json").read_text())
        (stage / "stage.json").write_text(json.dumps({**info, "g": float(g[1:])}))
    assert main(["analyze", "sim", "--stages", "-q", "-o", "grown"]) == 0
    assert "2 stages, 0 of them measured before" in capsys.readouterr().out
    (here / "grown" / "g2.00" / "summary.json").unlink()
    assert main(["analyze", "sim", "--stages", "-q", "-o", "grown"]) == 0
    assert "2 stages, 1 of them measured before" in capsys.readouterr().out
    assert main(["analyze", "sim", "--stages", "-q", "-o", "grown", "--curvature-scale", "6"]) == 0
    assert "2 stages, 0 of them measured before" in capsys.readouterr().out
    assert main([*pair(here), "--no-report"]) == 0
    capsys.readouterr()
    argv = ["compare", "a=out", "-o", "both", "--growth"]
    refused(capsys, [*argv, "body"], "--growth 'body'", "NAME=DIR", "[not-readable]")
    refused(capsys, [*argv, "body=out"], "out: ", "`morphofold analyze --stages`")
    refused(capsys, ["analyze", "out", "--stages", "-o", "more"], "out: ", "`morphofold simulate`", "[missing-part]")
    for more in (["--hemi", "lh"], ["--mgh"], ["--wide"], ["--layout", "bids", "-o", "more"]):
        refused(capsys, ["analyze", "sim", "--stages", *more], "--stages", "INPUT", "[options-clash]")
    assert main(["compare", "a=out", "--growth", "body=grown", "-q", "--json", "-o", "both"]) == 0
    printed = capsys.readouterr().out
    content = json.loads(printed[printed.index("{") :], parse_constant=pytest.fail)
    assert content["growth"]["body"]["growth"] == [1.8, 2.0]
    for name, sliders in (("a", 0), ("body", 1)):  # only a body of the name can grow there
        assert main(["compare", f"{name}=grown/g2.00", "--growth", "body=grown", "-q", "-o", "both"]) == 0
        assert (here / "both" / "report.html").read_text().count('<input type="range" id="growth"') == sliders
    assert main(["analyze", "sim", "-q", "-o", "seen"]) == 0
    assert (here / "seen" / "report.html").read_text().count('<input type="range" id="growth"') == 1


def test_no_command_writes_over_what_it_reads(here, capsys):
    assert main([*pair(here), "--no-report"]) == 0
    assert main(["analyze", "out", "-q", "--no-report", "-o", "other"]) == 0
    capsys.readouterr()
    before = sorted(p.name for p in (here / "out").rglob("*"))
    refused(capsys, ["compare", "a=out", "b=other", "-o", "out"], "out: ", " out;", "-o", "[options-clash]")
    refused(capsys, ["analyze", "out", "-q", "-o", "out"], "out: ", "-o", "[options-clash]")
    shutil.copytree(sample_path("simulated"), here / "sim" / "stages" / "g1.90")
    refused(capsys, ["analyze", "sim", "-q", "-o", "sim/stages/g1.90"], "sim/stages/g1.90: ", "-o", "[options-clash]")
    assert sorted(p.name for p in (here / "out").rglob("*")) == before
    assert (here / "sim" / "stages" / "g1.90" / "stage.json").exists()


@pytest.mark.slow
def test_measuring_an_analysis_again_gives_the_same_numbers(here, capsys):
    stage = str(sample_path("simulated"))
    measures = []
    for source, out in ((stage, "once"), ("once", "twice")):
        assert main(["analyze", source, "-q", "--no-report", "--json", "-o", out]) == 0
        measures.append(json.loads(capsys.readouterr().out)["surfaces"][0])
    for key in ("measures", "origin", "portion", "name", "info"):
        assert measures[0][key] == measures[1][key]


def test_the_systems_own_refusals_are_one_line_too(here, capsys):
    (here / "file").write_text("")
    refused(capsys, ["simulate", "demo", "-q", "-o", "file/run"], "file/run")


def test_a_full_disk_is_told_without_a_name_it_does_not_have(capsys, monkeypatch):
    def full(args):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("morphofold.cli.scenes.run", full)
    refused(capsys, ["scenes"], "morphofold scenes: No space left on device")


@pytest.mark.parametrize("words", ["", "Unable to allocate 7.45 GiB for an array"])
def test_a_lack_of_memory_is_told_in_one_line(capsys, monkeypatch, words):
    def large(args):
        raise MemoryError(words)

    monkeypatch.setattr("morphofold.cli.scenes.run", large)
    refused(capsys, ["scenes"], words or "memory did not suffice", "Close other programs, or ask for less.")


def test_scenes_lists_every_scene_with_its_effects(capsys):
    assert main(["scenes", "--json"]) == 0
    scenes = {s["name"]: s for s in json.loads(capsys.readouterr().out)}
    assert scenes["fig5"]["effects"] == ["contact", "perturbation"]


def test_scenes_prints_a_scene_that_reads_back_as_itself(here, capsys):
    assert main(["scenes", "regional"]) == 0
    (here / "mine.toml").write_text(capsys.readouterr().out)
    assert load_scene("mine.toml") == load_scene("regional")
    assert main(["scenes", "mine.toml", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["name"] == "regional"
    refused(capsys, ["scenes", "regionel"], "'regionel'", " regional?")


def test_simulate_wants_the_name_of_a_folder(here, capsys):
    refused(capsys, ["simulate", "demo", "--out="], "--out")
    assert list(here.iterdir()) == []


def test_too_many_threads_are_told_with_the_variable_that_allows_fewer(here, capsys, monkeypatch):
    monkeypatch.setenv("NUMBA_NUM_THREADS", "1")
    argv = ["simulate", "demo", "-o", "out", "-q", "--threads", "100000"]
    refused(capsys, argv, "NUMBA_NUM_THREADS", "threads", " 100000")
    monkeypatch.delenv("NUMBA_NUM_THREADS")
    assert "NUMBA_NUM_THREADS" not in refused(capsys, argv, "threads", " 100000")
    assert list(here.iterdir()) == []


def test_every_command_has_help_and_unknown_ones_exit_2(capsys):
    for name in COMMANDS:
        assert main([name, "--help"]) == 0
    capsys.readouterr()
    refused(capsys, ["unfold"], "unfold")


def test_help_has_examples_that_are_understood_and_on_the_page_of_the_command():
    for words, command in commands_below(app()):
        examples = re.findall("- `(.*)`", command.help)
        assert examples
        for line in examples:
            parsed(app(), shlex.split(line)[1:])  # leaves the test with what is wrong
            assert line.startswith(" ".join(("morphofold", *words)))
            page = DOCS / "commands" / f"{words[0]}.md"
            assert line in " ".join(page.read_text(encoding="utf-8").replace("\\\n", " ").split())


def test_interrupt_ends_with_130_and_keeps_the_checkpoint(here, usual_signals):
    # a real SIGINT to a real process
    small = ["geometry.portion=octant", "growth.final=1.3", "growth.rate=0.1", "accuracy.edge=4.91"]
    small.append("output.stages=[]")
    scene = ["demo", *(word for s in small for word in ("--set", s))]
    argv = [sys.executable, "-m", "morphofold", "simulate", *scene, "-o", "run"]
    code = (
        "import signal, subprocess, sys, time, pathlib\n"
        f"p = subprocess.Popen({argv!r}, stderr=subprocess.PIPE, text=True)\n"
        "while not pathlib.Path('run/scene.toml').exists() and p.poll() is None: time.sleep(0.02)\n"
        "time.sleep(0.1); p.send_signal(signal.SIGINT)\n"
        "print(p.communicate()[1]); sys.exit(p.returncode)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=300)
    assert done.returncode == 130, done.stdout
    assert "--resume" in done.stdout
    assert "Traceback" not in done.stdout
    assert (here / "run" / "checkpoint.npz").exists()
    assert not list((here / "run").glob(".*"))
    assert main(["simulate", *scene, "-o", "run", "--resume", "-q"]) == 0


def test_a_warning_is_one_line_without_source(here, capsys, monkeypatch):
    import warnings

    from morphofold.cli import scenes

    monkeypatch.setattr(scenes, "run", lambda args: warnings.warn("the sky is low", stacklevel=1) or Answer(None, []))
    assert main(["scenes"]) == 0
    assert capsys.readouterr().err == "morphofold: warning: the sky is low\n"


def test_ctrl_c_inside_a_compiled_kernel_is_an_interrupt(monkeypatch, capsys):
    def kernel(args):
        try:
            raise KeyboardInterrupt
        except KeyboardInterrupt as error:
            raise SystemError("returned a result with an exception set") from error

    monkeypatch.setattr("morphofold.cli.scenes.run", kernel)
    assert main(["scenes"]) == 130
    assert capsys.readouterr().err == "morphofold scenes: interrupted.\n"


def test_a_package_that_can_not_be_imported_is_no_bad_input(here, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "embreex.mesh_construction", None)
    assert main(pair(here)) == 1
    assert len(capsys.readouterr().err.splitlines()) == 1
    assert not (here / "out").exists()


@pytest.mark.parametrize("number", [pytest.param(signal.SIGINT, marks=pytest.mark.slow), signal.SIGTERM])
def test_a_stopped_analysis_leaves_nothing_behind(here, number, usual_signals):
    argv = pair(here, levels=(5, 5))
    before = sorted(here.iterdir())
    process = subprocess.Popen([sys.executable, "-m", "morphofold", *argv], stderr=subprocess.PIPE, text=True)
    while sorted(here.iterdir()) == before:  # until it writes
        assert process.poll() is None, "ended before it could be stopped"
        time.sleep(0.005)
    process.send_signal(number)
    assert process.communicate()[1] == "morphofold analyze: interrupted.\n"
    assert process.returncode == 130
    assert sorted(here.iterdir()) == before


def test_a_reader_that_has_seen_enough_is_no_error():
    command = f"{sys.executable} -m morphofold theory radius --growth 1:2:9000 | head -n 1"
    done = subprocess.run(["sh", "-c", command], capture_output=True, text=True, check=False)
    assert done.stdout.startswith("Outer radius")
    assert done.stderr == ""


def test_an_error_of_compiled_code_in_place_of_an_interrupt_is_the_interrupt(capsys, monkeypatch, usual_signals):
    """numpy's ``tofile`` raises a TypeError of its own where a signal ends its look at the file."""

    def run(args):
        try:
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(5)
        except KeyboardInterrupt:
            raise TypeError("expected str, bytes or os.PathLike object") from None

    monkeypatch.setattr("morphofold.cli.scenes.run", run)
    assert main(["scenes"]) == 130
    assert "PathLike" not in capsys.readouterr().err
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
