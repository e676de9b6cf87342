"""Whatever a command is given that it can't take: exit code 2, one line on standard error, nothing written."""

import errno
import os
from contextlib import nullcontext
from dataclasses import MISSING, fields
from pathlib import Path

import pytest
from commands import main
from made_measures import made_measures

from morphofold.cli import app
from morphofold.errors import PYTHON_CODES, OptionsClash, Refusal
from morphofold.io import write_surface
from morphofold.studies import bench
from morphofold.studies.pages.command_pages import commands_below

#: a call of every command that is refused for what it names, so that none begins to work
CALLS = {
    ("demo",): ["--scene", "nowhere"],
    ("simulate",): ["nowhere"],
    ("analyze",): ["nowhere"],
    ("compare",): ["a=nowhere"],
    ("cohort",): ["nowhere"],
    ("overlap",): ["nowhere"],
    ("stats",): ["nowhere", "--model", "H ~ age", "--contrast", "age"],
    ("bids",): ["nowhere", "out", "participant"],
    ("sweep",): ["nowhere", "--vary", "mu_ratio=1,2"],
    ("infer",): ["nowhere"],
    ("unfold",): ["nowhere"],
    ("theory", "radius"): ["--radius=-1"],
    ("theory", "stress"): ["--radius=-1"],
    ("theory", "critical"): ["--ratio=-1"],
    ("theory", "bifurcation"): ["--radius=-1"],
    ("reproduce",): ["fig99"],
    ("scenes",): ["nowhere"],
    ("bench", "speed"): ["--seconds=-1"],
    ("bench", "effects"): ["--seconds=-1"],
    ("bench", "measures"): ["--vertices=1"],
    ("bench", "cohort"): ["-o", "out", "--subjects=0"],
    ("bench", "folds"): ["-o", "out", "--scenes=nowhere"],
    ("bench", "accuracy"): ["-o", "out", "--halves=none"],
    ("bench", "hemisphere"): ["-o", "out", "--levels=coarse"],
}
CODES = {*PYTHON_CODES.values(), "disk-full", *(kind.code for kind in Refusal.__subclasses__())}
ODD = "a\nb\r\x1b[31m\u202e\u2028"
WRONG = ["", "\0", ODD, "\udcff", "nan", "9" * 30, "nowhere", "-1", "1e400", "x" * 300, "."]


def commands():
    """The parser of every command, question and benchmark, by its name."""
    return dict([*commands_below(app()), *commands_below(bench.app(), "bench")])


def arguments(command, *, positional):
    collection = commands()[command].assemble_argument_collection()
    return [argument for argument in collection if (argument.index is not None) is positional]


def refused(argv, capsys, folder):
    """The one line that is said."""
    before = sorted(os.listdir(folder))
    assert main(argv) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.endswith("\n")
    line = captured.err[:-1]
    assert line.isprintable()  # so neither ends a line nor steers a terminal
    assert ".. " not in line.replace("...", "") + " "
    assert "Traceback" not in line
    assert line.endswith("]")
    assert line.rpartition("[")[2][:-1] in CODES
    assert sorted(os.listdir(folder)) == before
    return line


def test_no_command_is_left_out():
    assert commands().keys() == CALLS.keys()


@pytest.mark.parametrize("values", [("", ODD), pytest.param(WRONG, marks=pytest.mark.slow)], ids=["some", "all"])
@pytest.mark.parametrize("command", CALLS, ids=" ".join)
def test_wrong_values_and_arguments_are_refused_in_one_line(command, values, cwd, capsys):
    refused([*command, *CALLS[command]], capsys, cwd)
    for option in (o.name for o in arguments(command, positional=False) if o.hint is not bool):
        for value in values:
            line = refused([*command, *CALLS[command], f"{option}={value}"], capsys, cwd)
            if value == "":
                assert option in line  # refused for itself, and named
    places = arguments(command, positional=True)
    for count in range(len([argument for argument in places if argument.required])):
        refused([*command, *count * ["nowhere"]], capsys, cwd)
    for value in values if places else ():
        refused([*command, *len(places) * [value]], capsys, cwd)
    refused([*command, "--no-such-option"], capsys, cwd)
    refused([*command, *CALLS[command], ODD], capsys, cwd)


def test_what_names_no_command_is_refused_in_one_line(cwd, capsys):
    for argv in ([""], [ODD], ["unfold"], ["theory", "x"], ["bench", ""], ["--no-such-option"]):
        refused(argv, capsys, cwd)


@pytest.mark.parametrize("out", ["", "a-file", "x" * 300])
def test_folders_that_can_not_be_written_are_refused_alike(out, cwd, capsys):
    (cwd / "a-file").write_text("of the user")
    for argv in (["simulate", "radial"], ["demo"], ["reproduce", "fig4"], ["bench", "folds"], ["bench", "accuracy"]):
        refused([*argv, "-q", "-o", out], capsys, cwd)
    assert (cwd / "a-file").read_text() == "of the user"


@pytest.mark.parametrize("above", ["a-file", "a-file/more", "closed"])
def test_what_no_folder_can_be_made_in_is_refused_before_anything_is_measured(above, cwd, capsys, made, monkeypatch):
    (cwd / "a-file").write_text("of the user")
    (cwd / "closed").mkdir()
    access = os.access
    monkeypatch.setattr(os, "access", lambda path, mode: Path(path).name != "closed" and access(path, mode))
    monkeypatch.setattr("morphofold.analysis.measuring.measure", lambda *_, **__: pytest.fail("measured"))
    for argv in (["analyze", "made"], ["reproduce", "fig4"], ["bench", "cohort", "--subjects", "1", "--workers", "1"]):
        refused([*argv, "-q", "-o", f"{above}/out"], capsys, cwd)
    assert above.partition("/")[0] in refused(["compare", "a=nowhere", "-q", "-o", f"{above}/out"], capsys, cwd)


#: command lines by the code of their refusal
LINES = {
    "bad-usage": [
        "analyze made --threads two",
        "analyze made --accuracy best",
        "bids data out participant --participant-label",
        "theory radius --growth",
        "simulate demo -o=",
        "theory stress --points 2.5",
    ],
    "options-clash": [
        "analyze made --white a --pial b",
        "theory critical --radius 40",
        "theory bifurcation --body demo --law both",  # given, though it is the default
    ],
    "no-such-file": [
        "analyze nowhere",
        "analyze -s nobody --subjects-dir .",
        "analyze -s nobody --subjects-dir nowhere",
        "analyze --white lh.white --pial lh.pial",
        "simulate nowhere",
        "cohort nowhere",
        "analyze nowhere --name=QQ==",  # values like options
        "compare a=x,,y",
        "stats nowhere --model m --contrast -age",
    ],
    "not-a-folder": ["analyze a-file", "cohort a-file"],
    "is-a-folder": ["analyze --hemi lh --white made --pial made"],
    "exists-already": ["analyze made -o a-file", "compare a=made -o a-file"],
    "not-readable": ["theory stress --thickness [1,2]"],
}


@pytest.mark.parametrize("code", LINES)
def test_missing_and_misplaced_files_and_wrong_usage_have_codes(code, cwd, capsys, made):
    (cwd / "a-file").write_text("of the user")
    for line in LINES[code]:
        assert refused(line.split(), capsys, cwd).endswith(f"[{code}]")


@pytest.mark.parametrize(
    ("error", "code", "line"),
    [
        (OSError(errno.ENOSPC, "text", "place"), 2, "place: text. Free space. [disk-full]"),
        (OSError(errno.EACCES, "text", "place"), 2, "place: text. Name another file or folder. [no-permission]"),
        (OSError(errno.EROFS, "text", "place"), 2, "place: text. Name another file or folder. [input-output]"),
        (MemoryError(), 2, "memory did not suffice. Close other programs, or ask for less. [no-memory]"),
        (ImportError("no package"), 1, "no package"),
        (KeyboardInterrupt(), 130, "interrupted."),
        (SystemError("returned a result with an exception set"), 130, "interrupted."),  # inside a compiled kernel
    ],
)
def test_errors_of_the_system_have_codes(error, code, line, capsys, monkeypatch):
    def fail(args):
        raise error from (KeyboardInterrupt() if isinstance(error, SystemError) else None)

    monkeypatch.setattr("morphofold.cli.scenes.run", fail)
    assert main(["scenes"]) == code
    assert capsys.readouterr().err == f"morphofold scenes: {line}\n"


def check(kind, chosen, absent=()):
    """Check options: those chosen, and the first that each of them needs, if none of these is to be absent."""
    for option, verb, *others in map(str.split, kind.rules):
        if verb == "needs" and option in chosen and not {*others} & {*chosen, *absent}:
            return check(kind, [*chosen, others[0]], absent)
    required = [f.name for f in fields(kind) if f.init and f.default is f.default_factory is MISSING]
    parts = (option.strip("-").replace("-", "_").lower().partition("=") for option in chosen)
    options = {name: value or "x" for name, _, value in parts}
    kind(**(dict.fromkeys(required, "x") | options)).check_rules(options)


KINDS = [app.default_command for app in commands().values()]


@pytest.mark.parametrize(("kind", "rule"), [(kind, rule) for kind in KINDS for rule in kind.rules])
def test_what_a_rule_of_options_forbids_is_refused_and_the_rest_is_not(kind, rule):
    option, verb, *others = rule.split()
    label = option.replace("=", " ")
    if verb == "needs":
        with pytest.raises(OptionsClash, match=f"^{label} needs {others[0]}"):
            check(kind, [option], absent=others)
    else:
        check(kind, [option])
    for other in others:
        with pytest.raises(OptionsClash, match=f"^{label} .*{other}") if verb == "excludes" else nullcontext():
            check(kind, [option, other])


def test_hemispheres_that_fail_together_keep_the_code_of_their_error(cwd, capsys, made):
    surf = cwd / "made" / "surf"
    (surf / "lh.pial").unlink()
    (surf / "rh.white").write_bytes((surf / "lh.white").read_bytes())
    assert refused(["analyze", "made", "--hemi", "both"], capsys, cwd).endswith("[no-such-file]")


ABSURD = {
    "analyze made --threads": ["0", "-1"],
    "analyze made --curvature-scale": ["nan", "-3", "1e-300"],
    "analyze made -q --gyral-width": ["inf", "0", "1e300", "1e-300", "1e-6"],
    "analyze made --thickness-cap": ["1e-320"],
    "cohort . --workers": ["0"],
    "cohort . --memory": ["nan", "-1"],
    "cohort . --threads": ["0"],
    "simulate radial --threads": ["0"],
    "simulate radial --budget": ["nan", "x"],
    "simulate radial --error": ["-1"],
    "simulate radial --set": ["growth.final=nan", "growth.final=1e400"],
    "bench speed --seconds": ["nan"],
    "bench measures --vertices": ["9" * 30],
    "theory radius --growth": ["nan", "1:2:999999999"],
}


@pytest.mark.parametrize("line", ABSURD)
def test_absurd_numbers_are_refused_in_one_line(line, cwd, capsys, made):
    *words, option = line.split()
    for value in ABSURD[line]:
        refused([*words, f"{option}={value}"], capsys, cwd)


@pytest.fixture
def made(cwd):
    """A subject that could be measured."""
    cortex = made_measures(level=1).cortex
    (cwd / "made" / "surf").mkdir(parents=True)
    write_surface(cwd / "made" / "surf" / "lh.white", cortex.white)
    write_surface(cwd / "made" / "surf" / "lh.pial", cortex.pial)
