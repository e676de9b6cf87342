"""Outputs that are in use, inputs that are none: exit 2, nothing is written, and what was there stays."""

import os
import shutil
from pathlib import Path

import pytest
from commands import refused
from hard_cases.cases import hard_case
from made_measures import made_measures

from morphofold.io import folders
from morphofold.results import write_analysis


@pytest.fixture
def analysis(cwd):
    return write_analysis([made_measures(level=1)], cwd / "analysis", report=False)


def denied(*args, **options):
    raise PermissionError(13, "Permission denied", "lh.white")


@hard_case(
    "files",
    "inputs and outputs that are files, folders or links of somebody else, dangling, or closed to us",
    guard="a folder of somebody else is not replaced",
    without=lambda patch: patch.setattr(folders, "MARKER_FILE", "thesis.txt"),
)
def test_places(holds, cwd, analysis, capsys, monkeypatch):
    theirs = cwd / "theirs"
    theirs.mkdir()
    for file in (theirs / "thesis.txt", cwd / "a-file"):
        file.write_text("mine")
    for link, target in {"loop": "loop", "dangling": "nowhere", "outside": "theirs"}.items():
        (cwd / link).symlink_to(target)
    before = sorted(os.listdir(cwd))
    for argv in (
        ["analyze", "analysis", "--white", "analysis", "--pial", "analysis"],
        *(["analyze", name] for name in ("a-file", "loop", "dangling")),
        *(["analyze", "analysis", "-o", name] for name in ("a-file", "theirs", "loop", "outside")),
        *(["simulate", name] for name in ("theirs", "loop")),
        *(["simulate", "radial", "-o", name] for name in ("a-file", "theirs", "loop", "outside")),
        *(["compare", f"a={name}"] for name in ("theirs", "loop")),
    ):
        refused(capsys, [*argv, "-q"])
    for method, argv in {"open": ["analyze", "analysis"], "mkdir": ["simulate", "radial"]}.items():
        with monkeypatch.context() as patch:
            patch.setattr(Path, method, denied)
            refused(capsys, [*argv, "-q", "-o", "new"], "Permission denied")
    holds.equal("what was there", (theirs / "thesis.txt").read_text(), "mine")
    holds.equal("in the folder", sorted(os.listdir(cwd)), before)


def replace_whole(new, out):
    shutil.rmtree(out, ignore_errors=True)
    os.replace(new, out)


@hard_case(
    "files",
    "notes of their user in a folder of results that is written anew",
    guard="what is not ours is brought",
    without=lambda patch: patch.setattr(folders, "_replace_folder", replace_whole),
    fails=(AssertionError, FileNotFoundError),
)
def test_notes_of_their_user(holds, cwd, analysis):
    for name in ("NOTES.txt", "maps/mine.txt"):
        (analysis / name).write_text("mine")
    write_analysis([made_measures("rh", level=1)], analysis, report=False)
    there = [(analysis / name).read_text() for name in ("NOTES.txt", "maps/mine.txt")]
    holds.equal("what was there", there, ["mine", "mine"])
    holds.equal("of the old results", [p.name for p in (analysis / "surf").glob("lh.*")], [])
