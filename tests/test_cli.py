import json
import re
import shlex
import shutil
import signal
import subprocess
import sys
import time
import warnings
from pathlib import Path

import numpy as np
import pytest
from commands import refused, run_json

from morphofold.analysis.measures_result import SCALARS
from morphofold.cli import COMMAND_NAMES, app, main, parsed, scenes
from morphofold.cli.analyze import writable_name
from morphofold.cli.command_options import Answer
from morphofold.errors import BadUsage
from morphofold.io import sample_path, write_surface
from morphofold.results import read_analysis
from morphofold.shapes import icosphere
from morphofold.sim.scene.scene_files import load_scene
from morphofold.studies.pages.command_pages import commands_below
from morphofold.surface import Surface
from morphofold.tables import read_table

DOCS = Path(__file__).resolve().parent.parent / "docs"

SAMPLE = sample_path("simulated")


def pair(folder, levels=(3, 3)):
    """White and pial spheres, 2 mm apart, as FreeSurfer files."""
    for name, level, radius in zip(("lh.white", "lh.pial"), levels, (20.0, 22.0)):
        write_surface(folder / name, Surface(*icosphere(level, radius=radius)))
    return ["analyze", "--white", str(folder / "lh.white"), "--pial", str(folder / "lh.pial"), "-q", "-o", "out"]


@pytest.fixture(scope="module")
def analysed_once(tmp_path_factory):
    """A folder with the pair and its analysis, out."""
    folder = tmp_path_factory.mktemp("pair")
    assert main([*pair(folder)[:-1], str(folder / "out"), "--no-report"]) == 0
    return folder


@pytest.fixture
def analysed(analysed_once, cwd):
    """A copy of it, in the working directory."""
    shutil.copytree(analysed_once, cwd, dirs_exist_ok=True)
    return cwd


def test_analyze_measures_a_pair_of_files_into_a_summary_and_a_table(analysed_once):
    (entry,) = json.loads((analysed_once / "out" / "summary.json").read_text(), parse_constant=pytest.fail)["surfaces"]
    measures = entry["measures"]
    assert measures["euler_characteristic"] == 2
    assert measures["mean_cortical_thickness_mm"] == pytest.approx(2.0, rel=0.02)
    assert measures["gyrification_index"] == pytest.approx(1.0, abs=0.01)
    assert measures["median_gyral_thickness_mm"] is None  # a sphere has no gyri
    (row,) = read_table(analysed_once / "out" / "surfaces.tsv", ("hemi",))
    assert row["hemi"] == "lh"
    assert set(SCALARS) < set(row)
    for name, value in measures.items():
        assert row[name] == (None if value is None else pytest.approx(value, rel=1e-6))


def test_a_shell_completes_every_command_and_its_options():
    for shell in ("bash", "zsh", "fish"):
        script = app().generate_completion(shell=shell)
        assert all(word in script for word in (*COMMAND_NAMES, "curvature-scale", "bifurcation"))


def test_only_some_measures_are_written_and_compared(cwd, capsys):
    assert main([*pair(cwd), "--no-report", "--only", "mean_cortical_thickness_mm,cortical_thickness"]) == 0
    assert "mean_cortical_thickness_mm 2.0" in capsys.readouterr().out
    (row,) = read_table(cwd / "out" / "surfaces.tsv", ("hemi",))
    assert row["mean_cortical_thickness_mm"] == pytest.approx(2.0, rel=0.02)
    assert row["gyrification_index"] is None
    maps = {path.name for path in (cwd / "out" / "maps").glob("lh.*")}
    assert maps == {"lh.cortical_thickness", "lh.cortical_thickness.shape.gii"}
    (measures,) = read_analysis(cwd / "out")
    assert measures.parameters["only"] == ["mean_cortical_thickness_mm", "cortical_thickness"]
    assert main(["compare", "a=out", "b=out", "-q", "-o", "both"]) == 0


@pytest.mark.parametrize(
    ("spoil", "expected"),
    [
        (lambda white: white.with_name("lh.pial").unlink(), ("lh.pial", "[no-such-file]")),
        (lambda white: white.write_bytes(white.read_bytes()[:-5]), ("lh.white",)),
        (lambda white: write_surface(white, Surface(*icosphere(2, radius=20.0))), ("lh.white", " 162 ", " 642")),
    ],
)
def test_files_that_are_missing_damaged_or_of_other_surfaces_are_refused(cwd, capsys, spoil, expected):
    argv = pair(cwd)
    spoil(cwd / "lh.white")
    refused(capsys, argv, *expected)
    assert not (cwd / "out").exists()


@pytest.mark.parametrize(
    ("argv", "expected"),
    [
        ("analyze -o out", ("INPUT", "-s", "--white", "--pial", "[options-clash]")),
        (f"analyze {SAMPLE} -o out --only gyral_thicknes", ("'gyral_thicknes'", "gyral_thickness", "[unknown-name]")),
        ("simulate demo -o out --set growth.gama=2", ("growth.gama", "[unknown-name]")),
        ("simulate demo -o out --set geometry.hole_radius=49", ("hole_radius 49 ", " 47")),
        ("simulate binary.toml -o out", ("binary.toml", "UTF-8")),
        ("simulate half.toml -o out", ("half.toml", "line 2")),
        ("scenes regionel", ("'regionel'", " regional?")),
        ("compare a=empty -o out", ("empty",)),
        ("compare a=bert -o out", ("bert: ", "summary.json", "`morphofold analyze bert`")),
        ("compare a=sub-bert -o out", ("sub-bert/anat: ", "sub-NAME_desc-morphofold")),
        ("compare name -o out", ("'name'", "NAME=DIR", "[not-readable]")),
        ("compare a=empty a=empty -o out", ("'a'", "[named-twice]")),
        ("compare a=empty --group model=a,,b", ("--group 'model=a,,b'", "[not-readable]")),
        ("compare a=empty --group m=a --group m=b", ("--group ", "'m'", "[named-twice]")),
        ("compare a=empty --colour 0072b2", ("--colour '0072b2'", "[not-readable]")),
    ],
)
def test_what_a_command_can_not_use_is_refused_and_nothing_is_written(cwd, capsys, argv, expected):
    for folder in ("empty", "bert/surf", "sub-bert/anat"):
        (cwd / folder).mkdir(parents=True)
    (cwd / "half.toml").write_text('name = "half"\n[geometry\n')
    shutil.copy(sample_path("fsaverage5") / "surf" / "lh.white", cwd / "binary.toml")
    before = sorted(cwd.rglob("*"))
    refused(capsys, argv.split(), *expected)
    assert sorted(cwd.rglob("*")) == before


def test_a_hemisphere_is_understood_in_any_spelling_and_a_name_becomes_one_of_a_folder():
    assert writable_name("a/b\nc\x7f d") == "a-b-c- d"
    spellings = ("LH", "L", "left", "Right", "rh", "both")
    hemis = [parsed(app(), ["analyze", "subject", "--hemi", spelling]).hemi for spelling in spellings]
    assert hemis == ["lh", "lh", "lh", "rh", "rh", "both"]
    with pytest.raises(BadUsage, match="'middle'"):
        parsed(app(), ["cohort", "subjects", "--hemi", "middle"])


def test_what_an_open_surface_lacks_is_said_to_be_missing(cwd, capsys):
    verts, faces = icosphere(3)
    half = faces[(verts[faces][:, :, 2] > 0).all(axis=1)]
    numbers, half = np.unique(half, return_inverse=True)
    for name, radius in (("lh.white", 20.0), ("lh.pial", 22.0)):
        write_surface(cwd / name, Surface(radius * verts[numbers], half.reshape(-1, 3)))
    assert main(["analyze", "--white", "lh.white", "--pial", "lh.pial", "-o", "out", "--no-report", "-q"]) == 0
    assert "GI n/a, cortical thickness 2." in capsys.readouterr().out


def test_a_pair_whose_names_tell_no_hemisphere_asks_for_it(cwd, capsys):
    pair(cwd)
    for name in ("white", "pial"):
        (cwd / f"lh.{name}").rename(cwd / name)
    argv = ["analyze", "--white", "white", "--pial", "pial", "-o", "out", "-q", "--no-report"]
    refused(capsys, argv, "white: ", "--hemi", "[options-clash]")
    refused(capsys, [*argv, "--hemi", "both"], "white: ", "--hemi", "[options-clash]")
    assert run_json([*argv, "--hemi", "rh", "--json"], capsys)["surfaces"][0]["hemi"] == "rh"


@pytest.mark.slow
@pytest.mark.parametrize("name", ["standard", "fine"])
def test_the_accuracy_is_recorded_and_standard_goes_without_saying(cwd, name):
    accuracy = [] if name == "standard" else ["--accuracy", name]
    assert main(["analyze", str(SAMPLE), "-q", "--no-report", "-o", "out", *accuracy]) == 0
    content = json.loads((cwd / "out/summary.json").read_text())
    assert content["parameters"].get("accuracy", "standard") == name
    used = content["surfaces"][0]["parameters"]
    assert used["accuracy"] == name
    n = content["surfaces"][0]["measures"]["n_vertices"]
    assert (used["accuracy_vertices"] > n) == (name == "fine")  # 2 to 10 thousand are split
    assert ("accuracy" in content["surfaces"][0]["notes"]) == (name == "fine")


def test_compare_puts_two_analyses_side_by_side_and_refuses_a_damaged_one(analysed, capsys):
    argv = ["compare", "first=out", "second=out", "--colour", "second=a0b0c0", "-q", "--json", "-o", "both"]
    content = run_json(argv, capsys)
    assert content["names"] == ["first", "second"]
    assert content["colours"]["second"] == "#a0b0c0"
    assert (analysed / "both" / "report.html").stat().st_size > 10_000
    summary = analysed / "out" / "summary.json"
    summary.write_text(summary.read_text()[:900])
    refused(capsys, ["compare", "a=out", "-o", "c"], "summary.json")
    assert not (analysed / "c").exists()


@pytest.mark.slow
def test_stages_are_measured_once_and_compared_over_growth(analysed, cwd, capsys):
    """Two copies of the simulated sample as stages; what is missing or was measured otherwise is measured anew."""
    for g in ("g1.80", "g2.00"):
        stage = cwd / "sim" / "stages" / g
        shutil.copytree(SAMPLE, stage)
        info = json.loads((stage / "stage.json").read_text())
        (stage / "stage.json").write_text(json.dumps({**info, "g": float(g[1:])}))
    assert main(["analyze", "sim", "--stages", "-q", "-o", "grown"]) == 0
    assert "2 stages, 0 of them measured before" in capsys.readouterr().out
    (cwd / "grown" / "g2.00" / "summary.json").unlink()
    assert main(["analyze", "sim", "--stages", "-q", "-o", "grown"]) == 0
    assert "2 stages, 1 of them measured before" in capsys.readouterr().out
    assert main(["analyze", "sim", "--stages", "-q", "-o", "grown", "--curvature-scale", "6"]) == 0
    assert "2 stages, 0 of them measured before" in capsys.readouterr().out
    argv = ["compare", "a=out", "-o", "both", "--growth"]
    refused(capsys, [*argv, "body"], "--growth 'body'", "NAME=DIR", "[not-readable]")
    refused(capsys, [*argv, "body=out"], "out: ", "`morphofold analyze --stages`")
    refused(capsys, ["analyze", "out", "--stages", "-o", "more"], "out: ", "`morphofold simulate`", "[missing-part]")
    content = run_json(["compare", "a=out", "--growth", "body=grown", "-q", "--json", "-o", "both"], capsys)
    assert content["growth"]["body"]["growth"] == [1.8, 2.0]
    for name, sliders in (("a", 0), ("body", 1)):  # only a body of the name can grow there
        assert main(["compare", f"{name}=grown/g2.00", "--growth", "body=grown", "-q", "-o", "both"]) == 0
        assert (cwd / "both" / "report.html").read_text().count('<input type="range" id="growth"') == sliders
    assert main(["analyze", "sim", "-q", "-o", "seen"]) == 0
    assert (cwd / "seen" / "report.html").read_text().count('<input type="range" id="growth"') == 1


def test_no_command_writes_over_what_it_reads(analysed, capsys):
    shutil.copytree(SAMPLE, analysed / "sim" / "stages" / "g1.90")
    before = sorted(analysed.rglob("*"))
    for argv in (
        ["compare", "a=out", "b=out", "-o", "out"],
        ["analyze", "out", "-o", "out"],
        ["analyze", "sim", "-o", "sim/stages/g1.90"],
    ):
        refused(capsys, [*argv, "-q"], f"{argv[-1]}: ", "-o", "[options-clash]")
    assert sorted(analysed.rglob("*")) == before


@pytest.mark.slow
def test_measuring_an_analysis_again_gives_the_same_numbers(cwd, capsys):
    common = ["-q", "--no-report", "--json", "-o"]
    first = run_json(["analyze", str(SAMPLE), *common, "once"], capsys)["surfaces"][0]
    second = run_json(["analyze", "once", *common, "twice"], capsys)["surfaces"][0]
    for key in ("measures", "origin", "portion", "name", "info"):
        assert first[key] == second[key]


def test_scenes_are_listed_with_their_effects_and_printed_as_they_read_back(cwd, capsys):
    assert main(["scenes", "--json"]) == 0
    scenes = {s["name"]: s for s in json.loads(capsys.readouterr().out)}
    assert scenes["fig5"]["effects"] == ["contact", "perturbation"]
    assert main(["scenes", "regional"]) == 0
    (cwd / "own.toml").write_text(capsys.readouterr().out)
    assert load_scene("own.toml") == load_scene("regional")
    assert run_json(["scenes", "own.toml", "--json"], capsys)["name"] == "regional"


def test_too_many_threads_are_refused_with_the_variable_that_allows_fewer(cwd, capsys, monkeypatch):
    monkeypatch.setenv("NUMBA_NUM_THREADS", "1")
    argv = ["simulate", "demo", "-o", "out", "-q", "--threads", "100000"]
    refused(capsys, argv, "NUMBA_NUM_THREADS", "threads", " 100000")
    monkeypatch.delenv("NUMBA_NUM_THREADS")
    assert "NUMBA_NUM_THREADS" not in refused(capsys, argv, "threads", " 100000")
    assert list(cwd.iterdir()) == []


def test_help_has_examples_that_are_understood_and_on_the_page_of_the_command():
    for name, command in commands_below(app()):
        assert main([*name, "--help"]) == 0
        examples = re.findall("- `(.*)`", command.help)
        assert examples
        for line in examples:
            parsed(app(), shlex.split(line)[1:])  # leaves the test with what is wrong
            assert line.startswith(" ".join(("morphofold", *name)))
            page = DOCS / "commands" / f"{name[0]}.md"
            assert line in " ".join(page.read_text(encoding="utf-8").replace("\\\n", " ").split())


def test_a_warning_is_one_line_without_source(cwd, capsys, monkeypatch):
    monkeypatch.setattr(scenes, "run", lambda args: warnings.warn("the sky is low", stacklevel=1) or Answer(None, []))
    assert main(["scenes"]) == 0
    assert capsys.readouterr().err == "morphofold: warning: the sky is low\n"


def test_a_package_that_can_not_be_imported_is_no_bad_input(cwd, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "embreex.mesh_construction", None)
    assert main(pair(cwd)) == 1
    assert len(capsys.readouterr().err.splitlines()) == 1
    assert not (cwd / "out").exists()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
def test_a_stopped_analysis_leaves_nothing_behind(cwd, name, usual_signals):
    argv = pair(cwd, levels=(5, 5))
    before = sorted(cwd.iterdir())
    process = subprocess.Popen([sys.executable, "-m", "morphofold", *argv], stderr=subprocess.PIPE, text=True)
    while sorted(cwd.iterdir()) == before:  # until it writes
        assert process.poll() is None, "ended before it could be stopped"
        time.sleep(0.005)
    process.send_signal(getattr(signal, name))
    assert process.communicate()[1] == "morphofold analyze: interrupted.\n"
    assert process.returncode == 130
    assert sorted(cwd.iterdir()) == before
