"""Links, folders in place of files, places that may not be read or written: one line, exit 2, nothing written."""

import contextlib
import os
import shutil
import tempfile
from pathlib import Path

import pytest
from commands import refused
from hard_cases.cases import hard_case
from made_measures import made_measures

from morphofold.cli import main
from morphofold.io import folders
from morphofold.results import write_analysis

NOBODY = 65534  # the number of a user who owns nothing


@pytest.fixture
def analysis(here):
    return write_analysis([made_measures(level=1)], here / "analysis", report=False)


def followed(path):
    """The end of a link, link by link: one to itself has none. Path.resolve() raised there before Python 3.13."""
    return followed(path.parent / os.readlink(path)) if path.is_symlink() else path


@hard_case(
    "files",
    "links: dangling, to themselves, to a folder of somebody else",
    guard="paths followed by realpath",
    without=lambda patch: patch.setattr(folders, "refuse_overlap", lambda out, read=(): followed(out)),
    fails=(AssertionError, RuntimeError),
)
def test_links(holds, here, analysis, capsys):
    (here / "loop").symlink_to("loop")
    (here / "dangling").symlink_to("nowhere")
    theirs = here / "theirs"
    theirs.mkdir()
    (theirs / "thesis.txt").write_text("mine")
    (here / "outside").symlink_to("theirs")
    for argv in (
        ["analyze", "loop"],
        ["analyze", "dangling"],
        ["analyze", "analysis", "-o", "loop"],
        ["simulate", "loop"],
        ["analyze", "analysis", "-o", "outside"],
        ["simulate", "radial", "-o", "loop"],
        ["compare", "a=loop"],
        ["compare", "a=analysis", "-o", "loop"],
        ["simulate", "radial", "-o", "outside"],
    ):
        refused(capsys, [*argv, "-q"])
    holds.equal("what was there", (theirs / "thesis.txt").read_text(), "mine")
    holds.equal("in the folder", sorted(os.listdir(here)), ["analysis", "dangling", "loop", "outside", "theirs"])


def denied(*args, **options):
    raise PermissionError(13, "Permission denied", "lh.white")


@hard_case(
    "files",
    "inputs that are folders or may not be read, outputs that exist or may not be written",
    guard="a folder of somebody else is not replaced",
    without=lambda patch: patch.setattr(folders, "MARKER_FILE", "thesis.txt"),
)
def test_unreadable_and_read_only(holds, here, analysis, capsys, monkeypatch):
    theirs = here / "theirs"
    theirs.mkdir()
    (theirs / "thesis.txt").write_text("mine")
    (here / "a-file").write_text("mine")
    before = sorted(os.listdir(here))
    for argv in (
        ["analyze", "analysis", "--white", "analysis", "--pial", "analysis"],
        ["analyze", "a-file"],
        ["analyze", "analysis", "-o", "a-file"],
        ["analyze", "analysis", "-o", "theirs"],
        ["simulate", "theirs"],
        ["simulate", "radial", "-o", "theirs"],
        ["simulate", "radial", "-o", "a-file"],
        ["compare", "a=theirs"],
    ):
        refused(capsys, [*argv, "-q"])
    with monkeypatch.context() as patch:
        patch.setattr(Path, "open", denied)
        refused(capsys, ["analyze", "analysis", "-q", "-o", "new"], "Permission denied")
    with monkeypatch.context() as patch:
        patch.setattr(Path, "mkdir", denied)
        refused(capsys, ["simulate", "radial", "-q", "-o", "new"], "Permission denied")
    holds.equal("what was there", (theirs / "thesis.txt").read_text(), "mine")
    holds.equal("in the folder", sorted(os.listdir(here)), before)


@pytest.fixture
def anyones():
    """A folder that every user may enter: those of pytest are its own user's."""
    with tempfile.TemporaryDirectory() as name:
        os.chmod(name, 0o755)
        yield Path(name)


@contextlib.contextmanager
def as_nobody():
    """Without the rights of root, if this is root."""
    if os.geteuid():
        yield
        return
    os.setegid(NOBODY)
    os.seteuid(NOBODY)
    try:
        yield
    finally:
        os.seteuid(0)
        os.setegid(0)


@pytest.mark.slow
@hard_case("files", "files and folders of mode 000, and an output folder of mode 555, to a user who is not root")
@pytest.mark.skipif(not hasattr(os, "seteuid"), reason="modes are of POSIX")
def test_modes(holds, anyones, tmp_path, capsys):
    analysis = write_analysis([made_measures(level=1)], anyones / "analysis", report=False)
    for path in (anyones / "shut.white", anyones / "lh.pial"):
        shutil.copyfile(analysis / "surf" / f"lh.{path.suffix[1:]}", path)
    shutil.copytree(analysis, anyones / "closed")
    (anyones / "fixed").mkdir()
    for argv in (
        ["analyze", "no"],
        ["analyze", str(analysis), "-o", str(tmp_path / "first")],
        ["simulate", "no"],
        ["compare", "a=no"],
    ):
        main([*argv, "-q"])  # imports: nobody may not read all packages
    capsys.readouterr()
    kept = sorted(p.relative_to(anyones) for p in anyones.rglob("*"))
    modes = {"shut.white": 0, "closed": 0, "fixed": 0o555}
    try:
        for name, mode in modes.items():
            (anyones / name).chmod(mode)
        at = lambda *names: [str(anyones / name) for name in names]
        pair = [*at("shut.white"), *at("lh.pial")]
        for place, argv in (
            (
                "/shut.white",
                ["analyze", "--white", pair[0], "--pial", pair[1], "--hemi", "lh", "-o", str(tmp_path / "new")],
            ),
            ("/closed", ["analyze", *at("closed")]),
            ("/fixed/new", ["analyze", *at("analysis"), "-o", *at("fixed/new")]),
            ("/fixed/new", ["simulate", "radial", "-o", *at("fixed/new")]),
            ("/closed", ["compare", "a=" + at("closed")[0]]),
        ):
            with as_nobody():
                code = main([*argv, "-q"])
            stderr = capsys.readouterr().err
            holds.says(argv[0], stderr.replace(str(anyones), ""), place, "Permission denied")
            holds.equal("code, lines", (code, len(stderr.strip().splitlines())), (2, 1))
    finally:
        for name in modes:
            (anyones / name).chmod(0o755)
    holds.equal("in the folders", sorted(p.relative_to(anyones) for p in anyones.rglob("*")), kept)


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
def test_notes_of_their_user(holds, here, analysis):
    for name in ("NOTES.txt", "maps/mine.txt"):
        (analysis / name).write_text("mine")
    write_analysis([made_measures("rh", level=1)], analysis, report=False)
    there = [(analysis / name).read_text() for name in ("NOTES.txt", "maps/mine.txt")]
    holds.equal("what was there", there, ["mine", "mine"])
    holds.equal("of the old results", [p.name for p in (analysis / "surf").glob("lh.*")], [])
