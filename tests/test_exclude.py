"""``--exclude``: a part of the cortex that is left out, counted and named."""

import json
from pathlib import Path

import numpy as np
import pytest
from commands import refused
from made_cohort import table, work_here, write_subject

from morphofold import io as mio
from morphofold.analysis import measure
from morphofold.cli import main
from morphofold.mesh_quality.cortex_checks import excluding
from morphofold.results import read_analysis

NAMES = ("anna", "ben")


@pytest.fixture
def subjects(tmp_path):
    """Two subjects, the left hemisphere of the first with a tumour in front."""
    for name in NAMES:
        write_subject(tmp_path / "subjects" / name, level=3)
    white = mio.read_surface(tmp_path / "subjects/anna/surf/lh.white").verts
    mio.write_label(tmp_path / "lh.anna.tumour.label", white[:, 1] > 30, white)
    return tmp_path / "subjects"


def test_numbers_are_those_of_a_cortex_label_without_the_part(subjects, tmp_path):
    whole = mio.read_cortex(subjects / "anna", "lh")
    rest = excluding(whole, tmp_path / "lh.anna.tumour.label")
    tumour = whole.white.verts[:, 1] > 30
    assert np.array_equal(rest.cortex, ~tumour)
    measures, control = measure(rest, curvature_scale=12.0), measure(whole, curvature_scale=12.0)
    for name in ("H", "sulcal_depth", "cortical_thickness"):
        assert np.isnan(measures.maps[name][tumour]).all()
        assert np.array_equal(measures.maps[name][~tumour], control.maps[name][~tumour]), name
    counts = rest.info["excluded"]
    assert counts["vertices"] == tumour.sum()
    assert counts["area_mm2"] == pytest.approx(control.maps["area"][tumour].sum(), rel=1e-12)
    assert f"{tumour.sum()} of {len(tumour)}" in measures.notes["excluded"]
    areas, whole_areas = ({row["region"]: row["area_mm2"] for row in m.regions} for m in (measures, control))
    assert areas["back"] == pytest.approx(whole_areas["back"] - counts["area_mm2"], rel=1e-12)
    assert areas["front"] == whole_areas["front"]


def test_the_side_that_has_no_such_file_is_measured_whole(subjects, tmp_path, cwd, capsys):
    words = ["analyze", str(subjects / "anna"), "--no-report", "-q", "-o"]
    assert main([*words, "out", "--exclude", str(tmp_path / "{hemi}.{subject}.tumour.label")]) == 0
    left, right = read_analysis("out")
    assert ("excluded" in left.notes, "excluded" in right.notes) == (True, False)
    assert str(tmp_path / "lh.anna.tumour.label") in [row["path"] for row in left.cortex.inputs]
    assert main(["analyze", "out", "--no-report", "-q", "-o", "again"]) == 0  # of what was written the part is missing
    again = read_analysis("again")[0]
    assert again.notes["excluded"] == left.notes["excluded"]
    assert np.array_equal(again.cortex.cortex, left.cortex.cortex)
    capsys.readouterr()
    assert main([*words, "whole", "--exclude", "{hemi}.{subject}.lesion.label"]) == 0
    assert "measured whole" in capsys.readouterr().err
    assert not any("excluded" in m.notes for m in read_analysis("whole"))
    refused(capsys, [*words, "none", "--exclude", "tumour.label"], "hemi", "options-clash")
    mio.write_label(tmp_path / "lh.other.label", np.ones(9999, bool), np.zeros((9999, 3)))
    refused(capsys, [*words, "none", "--hemi", "lh", "--exclude", str(tmp_path / "lh.other.label")], "mismatch")


def test_a_cohort_says_how_many_have_a_part_that_is_left_out(subjects, tmp_path, cwd, capsys, monkeypatch):
    work_here(monkeypatch)
    words = ["cohort", str(subjects), "-o", "study", "--no-report"]
    refused(capsys, [*words, "-q", "--exclude", "{hemi}.{subject}.lesion"], "no-such-file")
    assert main([*words, "--exclude", "{hemi}.{subject}.tumour.label"]) == 0
    assert "1 of 2 subjects" in capsys.readouterr().err
    rows = table(cwd / "study/group/measures.tsv")
    areas = {(r["subject"], r["hemi"], r["region"]): float(r["value"]) for r in rows if r["measure"] == "n_vertices"}
    assert areas["anna", "lh", "back"] < areas["ben", "lh", "back"] == areas["anna", "rh", "back"]
    summary = json.loads((cwd / "study/subjects/anna/summary.json").read_text())
    assert [Path(row["path"]).name for row in summary["inputs"] if "tumour" in row["path"]] == ["lh.anna.tumour.label"]
