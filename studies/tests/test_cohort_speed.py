"""What many subjects cost: what is counted is there, and what fails is told."""

import json
from contextlib import nullcontext

import pytest
from commands import refused
from made_cohort import HereWorkers, quick_measure

from morphofold.analysis.measures import SCALARS
from morphofold.group.group_tables import REGION_MEASURES
from morphofold.io import read_cortex
from morphofold.studies.bench import main
from morphofold.studies.speed import cohort_speed
from morphofold.studies.speed.cohort_speed import REGIONS, measure_load, text_table, write_subjects

pytestmark = pytest.mark.slow  # studies are not shipped: run them when they change


@pytest.fixture
def work_in_this_process(monkeypatch):
    monkeypatch.setattr(cohort_speed, "open_workers", lambda workers: nullcontext(HereWorkers()))
    monkeypatch.setattr("morphofold.analysis.measuring.measure", quick_measure)


def test_made_up_subjects_are_whole_of_other_sizes_and_stay(tmp_path):
    folders = write_subjects(tmp_path, 3)
    found = [read_cortex(folder, "lh") for folder in folders]
    assert len({cortex.pial.verts.max() for cortex in found}) == 3
    assert all(len(cortex.regions.names) == REGIONS for cortex in found)
    (folders[0] / "label" / "lh.aparc.annot").unlink()  # as if it had been stopped there
    when = (folders[1] / "surf" / "lh.white").stat().st_mtime_ns
    assert write_subjects(tmp_path, 3) == folders
    assert (folders[0] / "label" / "lh.aparc.annot").is_file()
    assert (folders[1] / "surf" / "lh.white").stat().st_mtime_ns == when


def test_what_is_counted_is_there(tmp_path, work_in_this_process):
    tmp_path /= "group"  # a name that parts of it have, too
    found = measure_load(tmp_path, 5, 2)
    group = tmp_path / "cohort-5-2" / "group"
    assert found.rows == 5 * (len(SCALARS) + REGIONS * len(REGION_MEASURES))
    assert found.rows == len((group / "measures.tsv").read_text().splitlines()) - 1
    assert found.page_bytes == (group / "report.html").stat().st_size
    assert found.overhead * 5 == pytest.approx(2 * found.seconds - found.measuring)
    of_one = sum(
        file.stat().st_size
        for name in ("subjects/sub-00000", "logs/sub-00000.log", "records/sub-00000.json")
        for file in [tmp_path / "cohort-5-2" / name, *(tmp_path / "cohort-5-2" / name).rglob("*")]
        if file.is_file()
    )
    assert found.subject_bytes == pytest.approx(of_one, rel=0.02)
    assert measure_load(tmp_path, 5, 2).rows == found.rows  # anew, and not found done
    assert any(f"{found.rows:,} rows" in line for line in text_table([found]))


def test_a_subject_that_fails_is_told(tmp_path, work_in_this_process, monkeypatch):
    def failing(cortex, **options):
        raise ValueError("no folds")

    monkeypatch.setattr("morphofold.analysis.measuring.measure", failing)
    with pytest.raises(RuntimeError, match=r"sub-00000: .*no folds"):
        measure_load(tmp_path, 2, 1)


@pytest.mark.parametrize("words", [["--subjects", "0"], ["--workers", "0"], ["--workers", "1001"]])
def test_numbers_that_are_none_are_refused(cwd, capsys, words):
    refused(capsys, ["bench", "cohort", "-o", "load", *words], " ".join(words), "1,000,000", "1,000 ", "[out-of-range]")
    assert not (cwd / "load").exists()


@pytest.mark.slow
def test_the_command_measures_on_real_workers(cwd, capsys):
    assert main(["cohort", "-o", "load", "--subjects", "6", "--workers", "1,2", "-q", "--json"]) == 0
    (one, two) = json.loads(capsys.readouterr().out)["loads"]
    assert (one["workers"], two["workers"]) == (1, 2)
    assert one["rows"] == two["rows"]
    assert 0 < one["worker_GiB"] < 2
    assert one["again"] < one["seconds"]
    tables = [cwd / "load" / f"cohort-6-{n}" / "group" for n in (1, 2)]
    assert {p.name: p.read_bytes() for p in tables[0].iterdir() if p.is_file()} == {
        p.name: p.read_bytes() for p in tables[1].iterdir() if p.is_file()
    }
