"""Our own JSON files with every leaf changed in turn: refused in one line with the file's name, or read and used."""

import json
from dataclasses import replace

import numpy as np
import pytest
from made_measures import made_measures

from morphofold import compare
from morphofold.analysis import gyral_graph
from morphofold.errors import Refusal, TooLarge
from morphofold.io import read_cortex
from morphofold.io.json_files import Amount, Record, read_json
from morphofold.results import read_analysis, write_analysis, write_dataset

WRONG = ["x", 5, None, [], {}, float("nan"), -1, 1e308, True, float("inf"), 1e-300, "\n\x1b", 10**400]
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


def made(level=1):
    """An analysis of a simulated stage with nothing left out, and a net."""
    measures = made_measures(level=level, origin="simulation", portion=0.125, info=STAGE)
    rng = np.random.default_rng(0)
    scalars = {key: 1 + rng.random() if value is None else value for key, value in measures.scalars.items()}
    return replace(
        measures,
        scalars=scalars,
        notes={**measures.notes, "simulation": "it wobbles"},
        parameters={
            "curvature_scale_mm": 3.0,
            "cortical_thickness_cap_mm": None,
            "graph_width_mm": 7.0,
            "cortex_mask": "label",
            "accuracy": "standard",
            "accuracy_vertices": 42,
            "local_gyrification_voxel_mm": 1.25,
        },
    )


@pytest.mark.parametrize("layout", [pytest.param("plain", marks=pytest.mark.slow), "bids"])
def test_an_analysis_is_refused_or_compared_whatever_its_summary_holds(layout, tmp_path):
    if layout == "plain":
        folder = write_analysis([made()], tmp_path / "out", report=False)
        path = folder / "summary.json"
    else:
        folder = write_dataset([made()], tmp_path / "out", "one", report=False)
        (path,) = folder.glob("anat/*provenance.json")
    content = json.loads(path.read_text())
    whole, taken, refusals = read_analysis(folder), {}, 0
    for place in leaves(content):
        for k, value in enumerate(WRONG):
            path.write_text(changed(content, [(place, value)]))
            if refusal(lambda: read_analysis(folder), folder):
                refusals += 1
                continue
            taken.setdefault(k, []).append(place)
            strict(compare({"one": read_analysis(folder), "other": whole}).to_dict())
    assert refusals > 500
    if layout == "bids":
        return
    inner = {
        k: [at for at in places if not any(len(o) > len(at) and o[: len(at)] == at for o in places)]
        for k, places in taken.items()
    }
    for k in (0, 1, 6):  # "x", 5, -1 wherever they may stand, at once
        path.write_text(changed(content, [(at, WRONG[k]) for at in inner[k] if at[-1] not in ("hemi",)]))
        page = compare({"one": read_analysis(folder), "other": whole}).report(tmp_path / f"page{k}")
        text = page.read_text()
        assert ".. " not in text.replace("...", "")
        assert ">nan<" not in text


def strict(content):
    json.dumps(content, allow_nan=False)


def test_a_stage_record_is_refused_or_read_whatever_it_holds(tmp_path):
    folder = write_analysis([made()], tmp_path / "g1.80", report=False)
    (folder / "summary.json").unlink()
    path = folder / "stage.json"
    allowed = {("name",), ("law",), ("shape",), ("units",), ("warnings", 0)}
    for place in leaves(STAGE):
        for value in WRONG:
            path.write_text(changed(STAGE, [(place, value)]))
            if not refusal(lambda: read_cortex(folder), path):
                assert not isinstance(value, bool), place
                assert place in allowed or not isinstance(value, str), place
                assert value not in (1e308, float("inf")), place
    for key, value in (
        ("warnings", 5),
        ("g", float("nan")),
        ("reference_thickness", "x"),
        ("portion", True),
        ("portion", 1e-300),
        ("mu_ratio", "2"),
        ("health", 5),
        ("g", None),
    ):
        path.write_text(json.dumps({**STAGE, key: value}))
        line = refusal(lambda: read_cortex(folder), path)
        assert key in line or "NaN" in line
    path.write_text(json.dumps({**STAGE, "mine": {"a": [1, "x", None]}}))
    assert read_cortex(folder).info["mine"] == {"a": [1, "x", None]}  # of a later version, or somebody's own
    assert read_cortex(folder).portion == 0.125


@pytest.mark.slow
def test_a_net_is_refused_or_read_whatever_its_file_holds(tmp_path):
    measures = made_measures(level=3)
    measures = replace(measures, graph=gyral_graph(measures.cortex.pial))
    folder = write_analysis([measures], tmp_path / "out", report=False)
    path = folder / "graph" / "lh.json"
    content = json.loads(path.read_text())
    first = lambda at: at[1] == 0 and (len(at) == 3 or at[-1] == 0)
    few = [at for at in leaves(content) if at[0] == "graph" or len(at) < 2 or first(at)]
    assert len(few) > 20
    for place in few:
        for value in WRONG:
            path.write_text(changed(content, [(place, value)]))
            refusal(lambda: read_analysis(folder), path)


class Sample(Record):
    size: Amount
    name: str = ""


@pytest.mark.parametrize(
    "raw",
    [
        b"",
        b"{",
        b"[]",
        b"5",
        b"null",
        b'{"size": NaN}',
        b'{"size": 1e999}',
        b'{"other": -Infinity, "size": 1}',
        b"\xff",
        b'{"size": true}',
        b'{"size": "1"}',
        b'{"size": -1e-9}',
        b'{"name": "x"}',
        b'{"size": ' + b"9" * 5000 + b"}",
        b'{"size": 1' + b"0" * 400 + b"}",
        b"[" * 100_000,
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
