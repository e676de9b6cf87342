"""JSON that every reader accepts, and the digests of inputs."""

import hashlib
import json

import numpy as np

from morphofold.records import input_records, strict_json


def test_json_is_strict_whatever_the_values():
    odd = {"a": np.float64("nan"), "b": [np.inf, np.int32(3), np.bool_(True)], 5: np.arange(2), "c": {1.5: object}}
    assert json.loads(strict_json(odd)) == {
        "a": None, "b": [None, 3, True], "5": [0, 1], "c": {"1.5": "<class 'object'>"},
    }  # fmt: skip


def test_an_input_has_its_digest_and_one_that_is_gone_none(tmp_path):
    source = tmp_path / "lh.white"
    source.write_bytes(b"some surface")
    assert input_records([source, "gone"]) == [
        {"path": str(source), "sha256": hashlib.sha256(b"some surface").hexdigest(), "bytes": 12},
        {"path": "gone", "sha256": None, "bytes": None},
    ]
