"""Two installations timed in turn."""

import sys
from pathlib import Path

import pytest

from morphofold.errors import MissingPart, OptionsClash, WrongFile
from morphofold.shapes.folded_ball import folded_ball
from morphofold.studies.bench import main
from morphofold.studies.speed.paired import CASES, paired_speed, text_table

pytestmark = pytest.mark.slow  # studies are not shipped: run them when they change


@pytest.fixture(scope="module")
def ball():
    return folded_ball(1500)


def test_every_measure_has_its_ratio_between_quartiles(ball):
    rows = paired_speed(ball, Path(sys.executable), scale=15.0, repeats=3, threads=1)
    assert tuple(row["case"] for row in rows) == CASES
    for row in rows:
        assert (row["vertices"], row["repeats"]) == (1500, 3)
        assert 0 < row["low"] <= row["ratio"] <= row["high"]
        assert min(row["seconds"], row["other_seconds"]) > 0
    whole, *parts = (row["seconds"] for row in rows)
    assert whole > max(parts)
    assert len(text_table(rows)) == 2 + len(CASES)


def test_a_python_that_can_not_measure_is_refused(ball, tmp_path):
    with pytest.raises(MissingPart):
        paired_speed(ball, tmp_path / "nowhere")
    broken = tmp_path / "python"
    broken.write_text("#!/bin/sh\necho 'no module of that name' >&2\nexit 1\n")
    broken.chmod(0o755)
    with pytest.raises(WrongFile, match="no module of that name"):
        paired_speed(ball, broken)


def test_pairs_are_of_one_size(capsys):
    assert main(["measures", "--against", sys.executable, "--vertices", "1000,2000"]) == 2
    assert OptionsClash.code in capsys.readouterr().err
    assert main(["measures", "--against", sys.executable, "--vertices", "1000", "--repeats", "0"]) == 2
