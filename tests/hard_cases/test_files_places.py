"""Links, folders in place of files, places that may not be read or written: one line, exit 2, nothing written."""

import os
from pathlib import Path

import pytest
from commands import refused
from hard_cases.cases import hard_case
from made_measures import made_measures

from morphofold.cli import paths
from morphofold.io import files
from morphofold.results import write_analysis


@pytest.fixture
def analysis(here):
    return write_analysis([made_measures(level=1)], here / "analysis", report=False)


def followed(path):
    """The end of a link, link by link: one to itself has none. Path.resolve() raised there before Python 3.13."""
    return followed(path.parent / os.readlink(path)) if path.is_symlink() else path


@hard_case(
    "files", "links: dangling, to themselves, to a folder of somebody else", guard="paths followed by realpath",
    without=lambda patch: patch.setattr(paths, "refuse_overlap", lambda out, read: [followed(p) for p in (out, *read)]),
    fails=(AssertionError, RuntimeError),
)  # fmt: skip
def test_links(holds, here, analysis, capsys):
    (here / "loop").symlink_to("loop")
    (here / "dangling").symlink_to("nowhere")
    theirs = here / "theirs"
    theirs.mkdir()
    (theirs / "thesis.txt").write_text("mine")
    (here / "outside").symlink_to("theirs")
    for argv in (
        ["analyze", "loop"], ["analyze", "dangling"], ["analyze", "analysis", "-o", "loop"], ["simulate", "loop"],
        ["analyze", "analysis", "-o", "outside"], ["simulate", "radial", "-o", "loop"], ["compare", "a=loop"],
        ["compare", "a=analysis", "-o", "loop"], ["simulate", "radial", "-o", "outside"],
    ):  # fmt: skip
        refused(capsys, [*argv, "-q"])
    holds.equal("what was there", (theirs / "thesis.txt").read_text(), "mine")
    holds.equal("in the folder", sorted(os.listdir(here)), ["analysis", "dangling", "loop", "outside", "theirs"])


def denied(*args, **options):
    raise PermissionError(13, "Permission denied", "lh.white")


@hard_case(
    "files", "inputs that are folders or may not be read, outputs that exist or may not be written",
    guard="a folder of somebody else is not replaced",
    without=lambda patch: patch.setattr(files, "_ours", lambda out: True),
)  # fmt: skip
def test_unreadable_and_read_only(holds, here, analysis, capsys, monkeypatch):
    theirs = here / "theirs"
    theirs.mkdir()
    (theirs / "thesis.txt").write_text("mine")
    (here / "a-file").write_text("mine")
    before = sorted(os.listdir(here))
    for argv in (
        ["analyze", "analysis", "--white", "analysis", "--pial", "analysis"], ["analyze", "a-file"],
        ["analyze", "analysis", "-o", "a-file"], ["analyze", "analysis", "-o", "theirs"], ["simulate", "theirs"],
        ["simulate", "radial", "-o", "theirs"], ["simulate", "radial", "-o", "a-file"], ["compare", "a=theirs"],
    ):  # fmt: skip
        refused(capsys, [*argv, "-q"])
    with monkeypatch.context() as patch:
        patch.setattr(Path, "open", denied)
        refused(capsys, ["analyze", "analysis", "-q", "-o", "new"], "Permission denied")
    with monkeypatch.context() as patch:
        patch.setattr(Path, "mkdir", denied)
        refused(capsys, ["simulate", "radial", "-q", "-o", "new"], "Permission denied")
    holds.equal("what was there", (theirs / "thesis.txt").read_text(), "mine")
    holds.equal("in the folder", sorted(os.listdir(here)), before)
