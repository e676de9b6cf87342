"""JSON that every reader accepts, and the digests of inputs."""

import hashlib
import json
import os

import numpy as np

from morphofold.digests_and_json import changed_since, input_records, printable, sha256_of, strict_json
from morphofold.tables import cell


def test_json_is_strict_whatever_the_values():
    odd = {"a": np.float64("nan"), "b": [np.inf, np.int32(3), np.bool_(True)], 5: np.arange(2), "c": {1.5: object}}
    assert json.loads(strict_json(odd)) == {
        "a": None,
        "b": [None, 3, True],
        "5": [0, 1],
        "c": {"1.5": "<class 'object'>"},
    }


def test_a_name_that_is_no_text_can_be_written_everywhere():
    name = os.fsdecode(b"caf\xe9 \xc3\xa9")
    assert printable(name) == "caf\\udce9 \u00e9"
    assert json.loads(strict_json({name: [name]})) == {printable(name): [printable(name)]}
    for text in (strict_json({name: [name]}), cell(name), printable("\ud800")):
        text.encode("utf-8")


def test_what_changed_in_a_folder_is_named(tmp_path):
    (tmp_path / "deep").mkdir()
    for name in ("a", "deep/b", "deep/c", "d"):
        (tmp_path / name).write_text(name)
    files = {name: tmp_path / name for name in ("a", "deep/b", "deep/c", "d")}
    known = {name: sha256_of(path) for name, path in files.items()}
    assert changed_since(known, {**files, "new": tmp_path}) == []
    (tmp_path / "a").write_text("A")
    (tmp_path / "deep" / "b").unlink()
    (tmp_path / "d").unlink()
    (tmp_path / "d").mkdir()
    assert set(changed_since(known, files)) == {"a", "deep/b", "d"}
    assert set(changed_since(known, {"deep/c": tmp_path / "deep" / "c"})) == {"a", "deep/b", "d"}


def test_an_input_has_its_digest_and_one_that_is_gone_none(tmp_path):
    source = tmp_path / "lh.white"
    source.write_bytes(b"some surface")
    assert input_records([source, "gone"]) == [
        {"path": str(source), "sha256": hashlib.sha256(b"some surface").hexdigest(), "bytes": 12},
        {"path": "gone", "sha256": None, "bytes": None},
    ]
