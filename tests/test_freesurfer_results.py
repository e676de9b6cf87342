"""Files of FreeSurfer: regions in its stats format, read as its aparcstats2table reads them, and files in a subject."""

import json
import math
import os
import shutil
from dataclasses import replace

import nibabel.freesurfer as fs
import numpy as np
import pytest
from commands import refused
from made_cohort import quick_measure, write_subject
from made_measures import REGIONS, made_measures

from morphofold.analysis.region_tables import region_table
from morphofold.cli import main
from morphofold.digests_and_json import digests, sha256_of
from morphofold.errors import DamagedFile, DoesNotApply
from morphofold.geometry import vertex_areas
from morphofold.io import read_annotation, sample_path, write_annotation
from morphofold.results import check_subject, read_analysis, write_analysis, write_into_subject
from morphofold.results.freesurfer_results import stats_name, write_gyral_stats

IN_ORDER = ["surf/lh.gyral_thickness", "surf/lh.pial_lgi", "stats/lh.aparc.gyral.stats"]
NAMES = set(IN_ORDER)
#: position in a row of what --meas asks for, from the source of aparcstats2table
POSITIONS = {"area": 2, "volume": 3, "thickness": 4, "thicknessstd": 5, "meancurv": 6, "gauscurv": 7}
POSITIONS |= {"foldind": 8, "curvind": 9}
#: values of the head that it takes: of every table, of areas, of thickness
OF_HEAD = {"EstimatedTotalIntraCranialVol, eTIV": "", "BrainSegNotVent, BrainSegVolNotVent": ""}
OF_HEAD |= {"Cortex, WhiteSurfArea,": "area", "Cortex, MeanThickness,": "thickness"}


# regions in FreeSurfer's stats format -----------------------------------------------------------------------


def read_stats(path, measure):
    """A line without ``#`` is a row, its words are split at blanks; of a line of the head the fourth part is taken."""
    values = {}
    for line in path.read_text(encoding="utf-8").splitlines():
        if "#" not in line:
            words = line.split()
            values[words[0]] = float(words[POSITIONS[measure]])
        for words, of_measure in OF_HEAD.items():
            if line.startswith(f"# Measure {words}") and of_measure in ("", measure):
                values[words.split(",")[1].strip()] = float(line.split(",")[3])
    return values


def measured(**options):
    """Made-up thickness on a made cortex, whose areas and volumes are its own."""
    m = made_measures(**options)
    m.maps["gyral_thickness"][m.cortex.regions.labels == 0] = 12.5
    rows = region_table(m.cortex, m.maps)
    return replace(m, regions=rows)


@pytest.fixture
def stats(tmp_path):
    path = tmp_path / "lh.aparc.gyral.stats"
    write_gyral_stats(path, measured(info={"etiv_mm3": 1534567.890123}))
    return path


def test_areas_volumes_and_gyral_thickness_of_regions_are_read_as_freesurfer_reads_them(stats):
    m = measured()
    for measure, column, digits in (
        ("area", "area_mm2", 0.5),  # whole numbers, as FreeSurfer's
        ("volume", "gray_volume_mm3", 0.5),
        ("thickness", "gyral_thickness_mm", 5e-4),
    ):
        values = read_stats(stats, measure)
        for row in m.regions:
            assert values[row["region"]] == pytest.approx(row[column], abs=digits)
    area = vertex_areas(m.cortex.white.verts, m.cortex.faces)[m.cortex.cortex].sum()
    assert read_stats(stats, "area")["WhiteSurfArea"] == pytest.approx(area, rel=1e-9)
    deviations, widths = read_stats(stats, "thicknessstd"), m.maps["gyral_thickness"][m.cortex.regions.labels == 1]
    assert deviations["front"] == 0
    assert deviations["middle"] == pytest.approx(np.nanstd(widths), abs=5e-4)
    thickness = read_stats(stats, "thickness")
    assert thickness["front"] == 12.5
    assert thickness["MeanThickness"] == m.scalars["median_gyral_thickness_mm"]


def test_unknown_gyral_thickness_and_curvature_that_is_not_freesurfers_are_nan(stats, tmp_path):
    m = measured()
    m.regions[1]["gyral_thickness_mm"] = None
    write_gyral_stats(tmp_path / "stats", m)
    for measure in ("thickness", "thicknessstd"):
        values = read_stats(tmp_path / "stats", measure)
        assert [math.isnan(values[name]) for name in REGIONS] == [False, True, False]
    assert read_stats(tmp_path / "stats", "area")["middle"] > 100
    for measure in ("meancurv", "gauscurv", "foldind", "curvind"):
        assert all(math.isnan(read_stats(stats, measure)[name]) for name in REGIONS)


def test_the_head_has_volumes_of_the_brain_and_columns_as_freesurfer_does(stats, tmp_path):
    assert read_stats(stats, "volume")["eTIV"] == 1534567.890
    assert "BrainSegVolNotVent" not in read_stats(stats, "volume")
    write_gyral_stats(tmp_path / "none", measured())
    assert "eTIV" not in read_stats(tmp_path / "none", "volume")
    lines = stats.read_text().splitlines()
    heads = [line.split()[-1] for line in lines if line.startswith("# TableCol") and " ColHeader " in line]
    assert {f"# ColHeaders {' '.join(heads)}", f"# NTableCols {len(heads)}", "# hemi lh"} <= set(lines)
    assert heads[4:6] == ["ThickAvg", "ThickStd"]
    assert all(lines)  # an empty line would end aparcstats2table


def test_an_analysis_has_the_stats_of_its_parcellation_and_the_same_again_from_its_own_files(tmp_path):
    m = measured()
    write_analysis([m], tmp_path / "out")
    written = tmp_path / "out" / "stats" / "lh.aparc.gyral.stats"
    (again,) = read_analysis(tmp_path / "out")
    write_gyral_stats(tmp_path / "again", again)
    for measure in POSITIONS:
        first, second = (read_stats(path, measure) for path in (written, tmp_path / "again"))
        assert first.keys() == second.keys()
        np.testing.assert_allclose(list(first.values()), list(second.values()), atol=2e-3, rtol=1e-6)
    write_analysis([made_measures(regions=False)], tmp_path / "none")
    assert not (tmp_path / "none" / "stats").exists()


def test_names_of_regions_are_one_word_and_control_no_terminal(tmp_path):
    m = measured()
    names = ("G and S # 1", "a\x1b[31m\nb", "back")
    write_annotation(tmp_path / "lh.x\x1b[2J.annot", replace(m.cortex.regions, names=names))
    cortex = replace(m.cortex, regions=read_annotation(tmp_path / "lh.x\x1b[2J.annot"))
    m = replace(m, cortex=cortex, regions=region_table(cortex, m.maps))
    write_gyral_stats(tmp_path / stats_name(m), m)
    text = (tmp_path / stats_name(m)).read_text(encoding="utf-8")
    assert all(line.isprintable() for line in [stats_name(m), *text.split("\n")])
    values = read_stats(tmp_path / stats_name(m), "thickness")
    assert values["G_and_S_1"] == 12.5
    write_gyral_stats(tmp_path / "clean", measured())
    assert len(values) == len(read_stats(tmp_path / "clean", "thickness"))


# files of the subject that was measured ---------------------------------------------------------------------


def made(hemi="lh", value=2.0):
    m = made_measures(hemi, level=2)
    return replace(m, maps={**m.maps, "local_gyrification_index": np.full(m.cortex.n_vertices, value)})


@pytest.fixture
def bert(tmp_path):
    return write_subject(tmp_path / "bert")


def test_maps_and_stats_are_where_freesurfer_has_its_own_and_read_as_its_own(bert):
    before, m = digests(bert), made()
    written, skipped = write_into_subject([m, made("rh")], bert)
    assert set(written) == NAMES | {name.replace("lh", "rh") for name in NAMES}
    assert skipped == []
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
    written, skipped = write_into_subject([made()], bert)
    assert written == ["surf/lh.gyral_thickness"]
    assert set(skipped) == NAMES - {"surf/lh.gyral_thickness"}
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
    def full(path, side):
        raise OSError(28, "No space left on device", str(path))

    before = digests(bert)
    monkeypatch.setattr("morphofold.results.freesurfer_results.write_gyral_stats", full)
    with pytest.raises(OSError, match="No space"):
        write_into_subject([made()], bert)
    assert digests(bert) == before


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


def test_the_command_writes_into_the_subject_by_its_name_and_says_what_it_kept(cwd, capsys, monkeypatch):
    bert = write_subject(cwd / "all" / "bert", hemis=("lh",))
    (bert / "surf" / "lh.pial_lgi").write_bytes(b"of recon-all -localGI")
    monkeypatch.setenv("SUBJECTS_DIR", str(cwd / "all"))
    argv = ["analyze", "-s", "bert", "-q", "--no-report", "--into-subject", "-o", "out"]
    assert main(argv) == 0
    *_, first, second = capsys.readouterr().out.splitlines()
    assert "surf/lh.gyral_thickness, stats/lh.aparc.gyral.stats" in first
    assert second.endswith(": surf/lh.pial_lgi")
    np.testing.assert_array_equal(
        fs.read_morph_data(bert / "surf" / "lh.gyral_thickness"),
        fs.read_morph_data(cwd / "out" / "maps" / "lh.gyral_thickness"),
    )
    stats = "lh.aparc.gyral.stats"
    assert (bert / "stats" / stats).read_bytes() == (cwd / "out" / "stats" / stats).read_bytes()
    assert main([*argv, "--json"]) == 0
    captured = capsys.readouterr()
    assert json.loads(captured.out)["surfaces"]
    assert captured.err.splitlines()[-1].endswith(": surf/lh.pial_lgi")


def test_inputs_that_are_no_subject_are_refused_before_anything_is_measured(cwd, capsys, monkeypatch):
    monkeypatch.setattr("morphofold.analysis.measuring.measure", quick_measure)
    shutil.copytree(sample_path("simulated"), cwd / "stage")
    write_analysis([made()], cwd / "analysis")
    for folder in (cwd / "stage", cwd / "analysis", sample_path("S1"), cwd / "nowhere"):
        with pytest.raises(DoesNotApply, match="is not a FreeSurfer subject"):
            check_subject(folder)
    refused(capsys, ["analyze", "analysis", "--into-subject", "-o", "out", "-q"], "[does-not-apply]")
    for words in (["--white", "a", "--pial", "b"], [str(sample_path("fsaverage5")), "--stages"]):
        refused(capsys, ["analyze", *words, "--into-subject"], "--into-subject", "[options-clash]")
    assert not (cwd / "out").exists()
