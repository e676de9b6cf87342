"""One curvature scale and one net width for a cohort: chosen once, kept, and left where a mesh does not bear it."""

import json

import pytest
from commands import refused
from made_cohort import HereWorkers, participants, work_here, write_subject

from morphofold.analysis.curvatures import scale_of_curvature
from morphofold.analysis.measuring import measure
from morphofold.cli import main
from morphofold.group import common_scales
from morphofold.group.common_scales import (
    MOST_SUBJECTS_READ,
    SCALES_FILE,
    Scales,
    curvature_scale,
    read_scales,
    scales_of,
)
from morphofold.io import read_cortex


class Looking:
    """Workers whose hemispheres have the lengths that its subjects are named for: ``"3.0 8"``."""

    def __init__(self):
        self.names = []

    def run(self, work, tasks):
        for task in tasks:
            self.names.append(task.name)
            yield task, [tuple(map(float, task.name.split()))]


def named(tmp_path, *names):
    return participants([tmp_path / name for name in names], tmp_path / "out")


@pytest.fixture
def out(tmp_path):
    (tmp_path / "out").mkdir()
    return tmp_path / "out"


def test_the_scale_is_the_coarsest_and_the_width_the_median(tmp_path, out):
    subjects = named(tmp_path, "3.0 7.0", "3.0 7.5", "3.904 8.123456", "3.908 10.4", "7.731 nan")
    assert scales_of(out, Looking(), subjects) == Scales(
        curvature_scale_mm=7.74, gyral_width_mm=7.81, hemispheres=5
    )  # three digits, the scale rounded up


def test_one_mesh_more_than_twice_as_coarse_as_usual_does_not_set_the_scale_of_all(tmp_path, out):
    assert scales_of(out, Looking(), named(tmp_path, "3 7", "3 8", "3.1 9", "15 30")).curvature_scale_mm == 3.1


def test_the_scales_of_the_first_run_are_kept(tmp_path, out):
    """So that a subject more changes no results of the others."""
    first = scales_of(out, Looking(), named(tmp_path, "3 7", "3 8"))
    workers = Looking()
    assert scales_of(out, workers, named(tmp_path, "3 7", "3 8", "5 20")) == first
    assert workers.names == []
    assert json.loads((out / SCALES_FILE).read_text()) == {
        "curvature_scale_mm": 3.0,
        "gyral_width_mm": 7.5,
        "hemispheres": 2,
    }


def test_of_very_many_subjects_some_are_looked_at(tmp_path, out):
    workers = Looking()
    scales_of(out, workers, named(tmp_path, *(f"3 {k}" for k in range(1, 1001))))
    assert len(workers.names) == MOST_SUBJECTS_READ
    assert {"3 1", "3 1000"} <= set(workers.names)


def test_no_scales_are_kept_where_nothing_can_be_read(tmp_path, out):
    assert scales_of(out, HereWorkers(), named(tmp_path, "nobody")) is None
    assert not (out / SCALES_FILE).exists()


@pytest.mark.parametrize(
    "text",
    [
        "",
        '{"curvature_scale_mm": 3}',
        *(
            f'{{"curvature_scale_mm": {x}, "gyral_width_mm": 8.0, "hemispheres": 2}}'
            for x in ("NaN", "-1", '"3"', "1e999")
        ),
    ],
)
def test_damaged_scales_are_refused(tmp_path, out, text):
    (out / SCALES_FILE).write_text(text)
    with pytest.raises(ValueError, match=SCALES_FILE):
        scales_of(out, Looking(), named(tmp_path, "3 7"))


def test_what_was_asked_for_goes_before_the_scales_of_the_cohort():
    found = Scales(curvature_scale_mm=3.9, gyral_width_mm=8.0, hemispheres=4)
    asked = {"curvature_scale_mm": None, "gyral_width_mm": None}
    assert found.fill(asked) == {**asked, "common_curvature_scale_mm": 3.9, "gyral_width_mm": 8.0}
    asked = {"curvature_scale_mm": 5.0, "gyral_width_mm": 9.0}
    assert found.fill(asked) == asked


def test_a_subject_is_looked_at_as_it_would_be_measured(tmp_path):
    (subject,) = participants([write_subject(tmp_path / "anna", level=3, hemis=("lh",))], tmp_path / "out")
    cortex = read_cortex(tmp_path / "anna")
    ((scale, width),) = read_scales(subject)
    found = measure(cortex).parameters
    assert scale == found["curvature_scale_mm"]
    assert width == found.get("graph_width_mm", width)


def test_a_mesh_that_does_not_bear_the_scale_has_its_own(tmp_path):
    cortex = read_cortex(write_subject(tmp_path / "anna", level=3))
    own = scale_of_curvature(cortex)[0]
    assert curvature_scale(cortex, 1.2 * own) == 1.2 * own
    assert curvature_scale(cortex, 0.9 * own) is None  # too coarse
    assert curvature_scale(cortex, 1000.0) is None  # too small


def test_a_cohort_is_measured_with_one_scale_and_one_width(tmp_path, monkeypatch, capsys):
    """Subjects of unlike meshes; by their own scales nothing could be pooled."""
    work_here(monkeypatch)
    monkeypatch.setattr(common_scales, "read_scales", lambda one: {"a": [(12.0, 20.0)], "b": [(14.0, 24.0)]}[one.name])
    for name, level in (("a", 3), ("b", 2)):
        write_subject(tmp_path / "subjects" / name, level=level)
    argv = ["cohort", str(tmp_path / "subjects"), "-o", str(tmp_path / "out"), "--no-report"]
    assert main(argv) == 0
    assert SCALES_FILE in capsys.readouterr().err
    for name in ("a", "b"):
        summary = json.loads((tmp_path / "out" / "subjects" / name / "summary.json").read_text())
        assert summary["parameters"]["gyral_width_mm"] == 22.0
        assert [one["parameters"]["graph_width_mm"] for one in summary["surfaces"]] == [22.0, 22.0]
    assert main([*argv, "--gyral-width", "9", "--curvature-scale", "30"]) == 0
    summary = json.loads((tmp_path / "out" / "subjects" / "a" / "summary.json").read_text())
    assert [one["parameters"]["curvature_scale_mm"] for one in summary["surfaces"]] == [30.0, 30.0]
    capsys.readouterr()
    assert main([*argv, "--gyral-width", "9", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["remarks"] == []  # all alike
    (tmp_path / "out" / SCALES_FILE).write_text("{}")
    capsys.readouterr()
    refused(capsys, argv, SCALES_FILE)
