"""Our own JSON files with every leaf changed in turn: refused in one line with the file's name, or read and used."""

import json

import pytest
from made_measures import made_measures

from morphofold.errors import Refusal, TooLarge
from morphofold.io import read_cortex
from morphofold.io.json_files import Amount, Record, read_json
from morphofold.results import write_analysis

WRONG = ["x", 5, None, [], {}, float("nan"), -1, 1e308, True, 1e-300]
STAGE = {
    "name": "ball",
    "g": 1.8,
    "law": "isotropic",
    "mu_ratio": 2.0,
    "shape": "sphere",
    "reference_thickness": 3.0,
    "reference_radius": 50.0,
    "portion": 0.125,
    "units": "mm",
    "warnings": ["it wobbles"],
    "health": {"growth": 1.8, "min_J": 0.5, "crossings": 0, "deepest_crossing": 0.0, "mean_radius_mm": 60.0},
}


def leaves(content, at=()):
    """Places of all values, and of all that hold some."""
    if at:
        yield at
    inner = content.items() if isinstance(content, dict) else enumerate(content) if isinstance(content, list) else ()
    for key, value in inner:
        yield from leaves(value, (*at, key))


def changed(content, changes):
    content = json.loads(json.dumps(content))
    for (*path, last), value in changes:
        part = content
        for key in path:
            part = part[key]
        part[last] = value
    return json.dumps(content)


def refusal(read, path):
    """The refusal, which names a file or one in its folder; "" if it is read."""
    try:
        read()
    except (Refusal, OSError) as error:
        line = str(error)
        assert str(path) in line, line
        assert len(line) < 600
        assert "\n" not in line
        return line
    return ""


def test_a_stage_record_is_refused_or_read_whatever_it_holds(tmp_path):
    folder = write_analysis([made_measures(level=1)], tmp_path / "g1.80", report=False)
    (folder / "summary.json").unlink()
    path = folder / "stage.json"
    allowed = {("name",), ("law",), ("shape",), ("units",), ("warnings", 0)}
    for place in leaves(STAGE):
        for value in WRONG:
            path.write_text(changed(STAGE, [(place, value)]))
            if not refusal(lambda: read_cortex(folder), path):
                assert not isinstance(value, bool), place
                assert place in allowed or not isinstance(value, str), place
                assert value != 1e308, place
    path.write_text(json.dumps({**STAGE, "mine": {"a": [1, "x", None]}}))
    assert read_cortex(folder).info["mine"] == {"a": [1, "x", None]}  # of a later version, or somebody's own
    assert read_cortex(folder).portion == 0.125


class Sample(Record):
    size: Amount
    name: str = ""


@pytest.mark.parametrize(
    "raw",
    [
        b"",
        b"{",
        b"[]",
        b'{"size": NaN}',
        b'{"size": 1e999}',
        b"\xff",
        b'{"size": true}',
        b'{"size": "1"}',
        b'{"size": -1e-9}',
        b'{"name": "x"}',
        b'{"size": 1} {}',
    ],
)
def test_what_is_not_as_its_schema_is_refused_with_file_and_cure(raw, tmp_path):
    path = tmp_path / "sample.json"
    path.write_bytes(raw)
    line = refusal(lambda: read_json(path, Sample, "Make it anew."), path)
    assert line.endswith("Make it anew.")


def test_a_file_beyond_its_bound_is_refused_unread_and_one_that_is_none_is_told(tmp_path):
    path = tmp_path / "sample.json"
    with pytest.raises(FileNotFoundError):
        read_json(path, Sample, "")
    with path.open("wb") as file:
        file.truncate(2**40)
    with pytest.raises(TooLarge, match=r"sample\.json: .*\b1,099,511,627,776\b"):
        read_json(path, Sample, "")
    path.unlink()
    path.mkdir()
    with pytest.raises(IsADirectoryError):
        read_json(path, Sample, "")
