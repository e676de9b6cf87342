"""Measures written into a FreeSurfer subject, whose own files stay."""

import json
import os
import shutil
from dataclasses import replace

import nibabel.freesurfer as fs
import numpy as np
import pytest
from commands import refused
from made_cohort import quick_measure, write_subject
from made_measures import made_measures

from morphofold.cli import main
from morphofold.errors import DamagedFile, DoesNotApply
from morphofold.io import sample_path
from morphofold.provenance import digests, sha256_of
from morphofold.results import check_subject, write_analysis, write_into_subject

IN_ORDER = ["surf/lh.gyral_thickness", "surf/lh.pial_lgi", "stats/lh.aparc.gyral.stats"]
NAMES = set(IN_ORDER)


def made(hemi="lh", value=2.0):
    m = made_measures(hemi, level=2)
    return replace(m, maps={**m.maps, "local_gyrification_index": np.full(m.cortex.n_vertices, value)})


@pytest.fixture
def bert(tmp_path):
    return write_subject(tmp_path / "bert")


def test_maps_and_stats_are_where_freesurfer_has_its_own_and_read_as_its_own(bert):
    before, m = digests(bert), made()
    written, kept = write_into_subject([m, made("rh")], bert)
    assert set(written) == NAMES | {name.replace("lh", "rh") for name in NAMES}
    assert kept == []
    width = m.maps["gyral_thickness"]
    np.testing.assert_array_equal(
        fs.read_morph_data(bert / "surf" / "lh.gyral_thickness"), np.nan_to_num(width).astype(np.float32)
    )
    assert set(fs.read_morph_data(bert / "surf" / "lh.pial_lgi")) == {2.0}
    after = digests(bert)
    assert after.keys() - before.keys() == {*written, "stats/morphofold.json"}
    assert before.items() <= after.items()


def test_files_that_morphofold_did_not_write_or_that_were_changed_are_kept(bert):
    (bert / "surf" / "lh.pial_lgi").write_bytes(b"of recon-all -localGI")
    assert write_into_subject([made()], bert)[1] == ["surf/lh.pial_lgi"]
    (bert / "stats" / "lh.aparc.gyral.stats").write_text("mine")
    written, kept = write_into_subject([made()], bert)
    assert written == ["surf/lh.gyral_thickness"]
    assert set(kept) == NAMES - {"surf/lh.gyral_thickness"}
    assert (bert / "surf" / "lh.pial_lgi").read_bytes() == b"of recon-all -localGI"
    assert (bert / "stats" / "lh.aparc.gyral.stats").read_text() == "mine"


def test_a_second_run_replaces_its_own_files_and_the_record_has_their_digests(bert):
    write_into_subject([made()], bert)
    write_into_subject([made("rh")], bert)  # the other hemisphere does not make the first one unknown
    assert write_into_subject([made(value=3.0)], bert) == (IN_ORDER, [])
    assert set(fs.read_morph_data(bert / "surf" / "lh.pial_lgi")) == {3.0}
    record = json.loads((bert / "stats" / "morphofold.json").read_text())["files"]
    assert record == {name: sha256_of(bert / name) for name in record}
    assert len(record) == 6


def test_nothing_is_left_of_a_run_that_fails_at_its_last_file(bert, monkeypatch):
    def full(path, m):
        raise OSError(28, "No space left on device", str(path))

    before = digests(bert)
    monkeypatch.setattr("morphofold.results.subject_files.write_gyral_stats", full)
    with pytest.raises(OSError, match="No space"):
        write_into_subject([made()], bert)
    assert digests(bert) == before
    assert not (bert / "stats").exists()


def test_a_run_that_was_killed_between_two_moves_knows_its_old_and_its_new_files(bert, monkeypatch):
    write_into_subject([made()], bert)
    move, moved = os.replace, []

    def killed(source, target):
        if not os.path.basename(target).startswith("."):  # writers move files of their own, too
            moved.append(target)
        if len(moved) == 3:  # the record and one file are in place
            raise KeyboardInterrupt
        move(source, target)

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(os, "replace", killed)
        write_into_subject([made(value=3.0)], bert)
    assert write_into_subject([made(value=4.0)], bert) == (IN_ORDER, [])


def test_a_damaged_record_is_refused_and_a_place_that_cannot_be_written(bert, monkeypatch):
    (bert / "stats").mkdir()
    (bert / "stats" / "morphofold.json").write_text("{")
    with pytest.raises(DamagedFile, match=r"morphofold\.json"):
        check_subject(bert)
    (bert / "stats" / "morphofold.json").unlink()
    access = os.access
    monkeypatch.setattr(os, "access", lambda path, mode: path.name != "surf" and access(path, mode))
    with pytest.raises(PermissionError, match="surf"):
        check_subject(bert)


def test_a_simulation_an_analysis_and_a_folder_of_gifti_are_no_subjects(tmp_path):
    shutil.copytree(sample_path("simulated"), tmp_path / "stage")
    write_analysis([made()], tmp_path / "analysis")
    for folder in (tmp_path / "stage", tmp_path / "analysis", sample_path("S1"), tmp_path / "nowhere"):
        with pytest.raises(DoesNotApply, match="is not a FreeSurfer subject"):
            check_subject(folder)


def test_the_command_writes_into_the_subject_by_its_name_and_says_what_it_kept(here, capsys, monkeypatch):
    bert = write_subject(here / "all" / "bert", hemis=("lh",))
    (bert / "surf" / "lh.pial_lgi").write_bytes(b"of recon-all -localGI")
    monkeypatch.setenv("SUBJECTS_DIR", str(here / "all"))
    argv = ["analyze", "-s", "bert", "-q", "--no-report", "--into-subject", "-o", "out"]
    assert main(argv) == 0
    *_, first, second = capsys.readouterr().out.splitlines()
    assert "surf/lh.gyral_thickness, stats/lh.aparc.gyral.stats" in first
    assert second.endswith(": surf/lh.pial_lgi")
    np.testing.assert_array_equal(
        fs.read_morph_data(bert / "surf" / "lh.gyral_thickness"),
        fs.read_morph_data(here / "out" / "maps" / "lh.gyral_thickness"),
    )
    stats = "lh.aparc.gyral.stats"
    assert (bert / "stats" / stats).read_bytes() == (here / "out" / "stats" / stats).read_bytes()


@pytest.mark.parametrize("more", [["--white", "a", "--pial", "b"], ["--stages"]])
def test_options_that_leave_no_subject_to_write_into_are_refused(here, capsys, more):
    base = [] if "--white" in more else [str(sample_path("fsaverage5"))]
    refused(capsys, ["analyze", *base, "--into-subject", *more], "--into-subject", "[options-clash]")


def test_what_is_no_subject_is_refused_before_anything_is_measured(here, capsys, monkeypatch):
    monkeypatch.setattr("morphofold.analysis.measuring.measure", quick_measure)
    write_analysis([made()], here / "analysis")
    for name in ("analysis", str(sample_path("simulated")), str(sample_path("S1"))):
        refused(capsys, ["analyze", name, "--into-subject", "-o", "out", "-q"], "[does-not-apply]")
    assert not (here / "out").exists()
