"""The parts of docs/speed.md on measuring."""

import json

import pytest

from morphofold.studies.speed.measuring_page import PICTURE, main

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
