"""What measuring costs: seconds of each step, and the parts of docs/speed.md that show them."""

import json

import numpy as np
import pytest

from morphofold.analysis import measure
from morphofold.shapes.folded_ball import folded_ball
from morphofold.studies.bench import main as bench
from morphofold.studies.speed.measuring_page import PICTURE, main
from morphofold.studies.speed.measuring_speed import exponent, measuring_speed

PAGE = "# Speed\n\n" + "\n\n".join(f"<!-- {p} -->\nstale\n<!-- /{p} -->" for p in ("measures", "pairs", "peers")) + "\n"
STEPS = [
    {
        "vertices": n,
        "threads": 2,
        "stage": stage,
        "seconds": s * n / 10_000,
        "memory_GiB": 0.5 if stage == "all" else None,
    }
    for n in (10_000, 160_000)
    for stage, s in (("areas", 0.1), ("all", 0.4))
]
PAIR = {"case": "all", "vertices": 160_000, "repeats": 3, "seconds": 7.0, "other_seconds": 14.0}
PAIRS = [{**PAIR, "ratio": 0.5, "low": 0.48, "high": 0.52}]
PEERS = [{"quantity": "mean curvature", "program": "ours", "vertices": 163_842, "seconds": 0.5, "error": 0.0008}]


@pytest.fixture
def files(tmp_path):
    (tmp_path / "speed.md").write_text(PAGE)
    for name, rows in (("measures", STEPS), ("pairs", PAIRS), ("peers", PEERS)):
        (tmp_path / f"{name}.json").write_text(json.dumps(rows))
    return [
        str(tmp_path / "speed.md"),
        *(x for n in ("measures", "pairs", "peers") for x in (f"--{n}", str(tmp_path / f"{n}.json"))),
    ]


def test_the_page_holds_the_numbers_of_its_files(files, tmp_path):
    assert main(files) == 0
    text = (tmp_path / "speed.md").read_text()
    assert "stale" not in text
    assert "| areas | 0.10 | 1.60 | 0.91 |" in text  # proportional to n: less than n log n
    assert "| peak memory, GiB | 0.50 | 0.50 | – |" in text
    assert "| all | 7.00 | 14.00 | 0.50 | 0.48 to 0.52 |" in text
    assert "| mean curvature | ours | 0.50 | 0.08% |" in text
    assert (tmp_path / PICTURE).read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("damage", ["speed.md", "pairs.json"])
def test_what_can_not_be_used_changes_nothing(damage, files, tmp_path, capsys):
    (tmp_path / damage).write_text("[]" if damage.endswith("json") else "no marks")
    before = (tmp_path / "speed.md").read_text()
    assert main(files) == 2
    assert damage in capsys.readouterr().err
    assert (tmp_path / "speed.md").read_text() == before
    assert not (tmp_path / PICTURE).exists()


def made_times(power=1.0):
    return [
        {"vertices": n, "threads": 2, "stage": stage, "seconds": share * (n * np.log(n)) ** power}
        | ({"memory_GiB": 0.5} if stage == "all" else {})
        for n in (1000, 10_000, 100_000)
        for stage, share in (("areas", 1e-6), ("curvature", 3e-6), ("all", 4e-6))
    ]


@pytest.mark.slow
def test_every_stage_of_measure_is_timed_and_they_add_up():
    calls = []
    rows = measuring_speed([1500, 1000], progress=lambda share, text: calls.append((share, text)))
    assert calls == [(0.0, "1,000 vertices"), (0.5, "1,500 vertices")]
    asked = []
    measure(folded_ball(1000), progress=lambda share, stage: asked.append(stage))
    for n in (1000, 1500):
        mine = {row["stage"]: row["seconds"] for row in rows if row["vertices"] == n}
        assert list(mine) == [*asked[:-1], "all"]
        assert sum(mine.values()) == pytest.approx(2 * mine["all"])
        assert min(mine.values()) > 0


@pytest.mark.parametrize("power", [0.5, 1.0, 1.5])
def test_the_exponent_is_that_of_n_log_n(power):
    assert exponent(made_times(power)) == pytest.approx(power)
    assert exponent(made_times(power), "areas") == pytest.approx(power)


@pytest.mark.parametrize("sizes", ["", "999", "10000,x", "20000000"])
def test_sizes_that_cannot_be_are_refused_before_anything_is_timed(sizes, capsys):
    assert bench(["measures", "--vertices", sizes]) == 2
    stderr = capsys.readouterr().err
    if not sizes:
        assert " --vertices" in stderr
        return
    assert f"{sizes!r}" in stderr
    assert stderr.startswith("run.py bench measures: --vertices: ")
    assert stderr.endswith(" [not-readable]\n" if "x" in sizes else " [out-of-range]\n")


@pytest.mark.slow
def test_the_command_prints_a_line_per_stage_or_rows(capsys):
    assert bench(["measures", "--vertices", "1000,1200", "-q", "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert {row["vertices"] for row in rows} == {1000, 1200}
    assert bench(["measures", "--vertices", "1000", "-q"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[1].split() == ["stage", "1,000", "power"]
    assert [line[:20].strip() for line in lines[2:]] == [*dict.fromkeys(row["stage"] for row in rows), "memory, GiB"]
