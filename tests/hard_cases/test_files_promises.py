"""Files that promise more than they hold, or unpack to more than a computer has: refused within 2 GiB and seconds."""

import io
import json
import re
import struct
import zipfile

import numpy as np
import pytest
from hard_cases.cases import hard_case
from hard_cases.made_files import MEMORY, SCENE, Sample, in_child, samples, verdict
from hypothesis import given, settings
from hypothesis import strategies as st

from morphofold.io import read_annotation, read_cortex, read_label, read_morph, read_surface
from morphofold.sim.output.checkpoint import read_arrays
from morphofold.sim.scene import files as scene_file
from morphofold.sim.scene.files import load_scene

MANY = 2**31 - 1
LIGHT = 512 * 2**20  # bytes: a quarter of what any file may take
pytestmark = pytest.mark.filterwarnings("ignore::UserWarning")


@pytest.fixture(scope="module")
def known(tmp_path_factory):
    return samples(tmp_path_factory.mktemp("samples"))


def refused(holds, what, path, raw, read, *words):
    """Within a child's means: the file is damaged, told in one line with these numbers, and little memory."""
    path.write_bytes(raw)
    message, taken = in_child(lambda: verdict(Sample(path, lambda: read(path))))
    holds.says(what, message.replace(str(path), path.name), path.name, *words, "[damaged-file]")
    holds(f"{what}: memory taken", taken / 2**20, at_most=LIGHT / 2**20, unit="MiB")


@pytest.mark.parametrize("kind", ["map", "annotation", "label"])
@hard_case(
    "files",
    "a FreeSurfer map, annotation or label that promises 2³¹ vertices",
    peers="nibabel: allocates what the header says (read)",
)
def test_freesurfer(kind, known, holds, tmp_path):
    raw = known["lh.white"].path.read_bytes()
    much = struct.pack(">i", MANY)
    name, damaged, read = {
        "map": ("lh.k", b"\xff\xff\xff" + struct.pack(">3i", MANY, 1, 1) + raw, read_morph),
        "annotation": ("a.annot", much + raw, read_annotation),
        "label": ("a.label", f"#!ascii\n{MANY}\n0 1 2 3 4\n".encode(), lambda path: read_label(path, 42)),
    }[kind]
    refused(holds, kind, tmp_path / name, damaged, read)


LEGACY = "# vtk DataFile Version 3.0\nx\nASCII\nDATASET {}\nPOINTS\t{} float\n0 0 0 1 0 0 0 1 0\n{}\t{} {}\n3 0 1 2\n"
PLY = "ply\nformat {} 1.0\nelement\tvertex {}\nproperty float x\nproperty float y\nproperty float z\nelement face 1\n"
polygons_promise = hard_case(
    "files", "a VTK or PLY that promises 2³¹ points or faces", peers="VTK: ends the process (measured)"
)


@pytest.mark.parametrize(("n", "m", "size"), [(MANY, 1, 4), (3, 1, MANY)])
@polygons_promise
def test_legacy_vtk(n, m, size, holds, tmp_path):
    text = LEGACY.format("POLYDATA", n, "POLYGONS", m, size).encode()
    refused(holds, f"POINTS {n}, POLYGONS {m} {size}", tmp_path / "a.vtk", text, read_surface)


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian"])
@polygons_promise
def test_ply(form, holds, tmp_path):
    text = PLY.format(form, MANY) + "property list uchar int vertex_indices\nend_header\n0 0 0\n"
    refused(holds, f"element vertex, {form}", tmp_path / "a.ply", text.encode(), read_surface)


@pytest.mark.slow
@pytest.mark.parametrize(("n", "zeros"), [(5 * 2**24, 5 * 2**27), (2**40, 2**24)])
@hard_case(
    "files",
    "a checkpoint whose array unpacks to 640 MiB, or claims 8 TiB",
    guard="sizes before unpacking",
    without=lambda patch: patch.setattr(zipfile.ZipFile, "infolist", lambda self: []),
)
def test_checkpoint(n, zeros, holds, tmp_path):
    like, out = {"x": np.zeros((10, 3))}, io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as file, file.open("x.npy", "w", force_zip64=True) as x:
        np.lib.format.write_array_header_1_0(x, {"descr": "<f8", "fortran_order": False, "shape": (n,)})
        for _ in range(0, zeros, 2**24):
            x.write(bytes(2**24))
    read = lambda path: read_arrays(path, like)
    refused(holds, f"{n:,} numbers", tmp_path / "a.npz", out.getvalue(), read, "240")


@hard_case(
    "files",
    "a scene with 20,000 unknown keys, or a key of 100,000 parts",
    peers="FetalFoldSim: a missing key is a KeyError minutes later (read)",
    guard="20 problems at most",
    without=lambda patch: patch.setattr(scene_file, "MOST_PROBLEMS", 10**9),
)
def test_scenes(holds, tmp_path):
    path = tmp_path / "a.toml"
    path.write_text(".".join(["a"] * 100_000) + " = 1\n")
    message, taken = in_child(lambda: verdict(Sample(path, lambda: load_scene(path))))
    holds.says("deep key", message.replace(str(path), path.name), "a.toml", "nested too deeply")
    path.write_text(SCENE.replace("[geometry]", "".join(f"k{i} = 1\n" for i in range(20_000)) + "[geometry]"))
    message, taken = in_child(lambda: verdict(Sample(path, lambda: load_scene(path))))
    holds("lines told", len(message.splitlines()), at_least=1, at_most=21)
    holds("memory taken", taken / 2**20, at_most=MEMORY / 2**20, unit="MiB")


PARTS = st.sampled_from(["a", "b-1", '"a b"', "'+'", '"#"', "'\"'", r'"\\"', r'"\""', '""'])
OTHER_LINES = st.sampled_from(
    ["# {}", "x = 1 # '{}", 'x = "{}"', "x = '{}'", 'x = """\n{}""\n{}"""""', "x = '''\n{}''''", '# """', ""]
)
KEYS = st.sampled_from(["{} = 1", "[{}]", "[[{}]]", "y = {{{} = 1}}"])


def is_taken(text):
    """Whether tomllib is given a text, which it has to understand then."""
    try:
        return scene_file._parse_toml(text) is not None
    except RecursionError:
        return False


@hard_case(
    "files",
    "a key of up to 2,000 parts, in quotes or not, beside comments and texts with as many dots",
    guard="strings and comments left out",
    without=lambda patch: patch.setattr(scene_file, "_STRING_OR_COMMENT", re.compile("(?!)")),
)
def test_deep_keys(holds):
    right = []

    @settings(deadline=None, derandomize=True, max_examples=200, database=None)
    @given(st.lists(PARTS, min_size=1, max_size=8), st.sampled_from([1, 8, 32, 33, 40, 2000]), OTHER_LINES, KEYS)
    def both_sides(parts, count, other, key):
        deep = " . ".join((parts * count)[:count])
        right.append(is_taken(f"{other.format(*2 * ['a.' * 40])}\n{key.format(deep)}\n") == (count <= 32))
        assert right[-1], (other, key, count)

    both_sides()
    holds("keys of at most 32 parts taken, of more refused, share", sum(right) / len(right), at_least=1)


@hard_case(
    "files",
    "numbers beyond all floats, and 100,000 brackets, in our own JSON (found by fuzzing)",
    guard="errors of numbers and nests beyond bounds",
    without=lambda patch: list(
        patch.setattr(f"morphofold.{reader}.read_json", lambda path, *more, **options: json.loads(path.read_text()))
        for reader in ("io.cortices", "results.analyses", "results.hemisphere_files")
    ),
    fails=(AssertionError, OverflowError, RecursionError),
)
def test_json(known, holds):
    for name in ("stage.json", "summary.json", "analysis/summary.json", "analysis/graph/lh.json"):
        sample = known[name]
        raw, huge = sample.path.read_bytes(), b"1" + b"0" * 400
        changed = [b"[" * 100_000, re.sub(rb'("portion": )[\d.]+', rb"\g<1>" + huge, raw)]
        for text in changed[: 1 + (changed[1] != raw)]:
            try:
                sample.path.write_bytes(text)
                message = verdict(sample).replace(str(sample.path.parent), "")
                kind = "[damaged-file]" if text is changed[0] else "[not-readable]"
                holds.says(name, message, sample.path.name, kind)
            finally:
                sample.path.write_bytes(raw)
    assert json.loads(known["stage.json"].path.read_text())
    assert read_cortex(known["stage.json"].path.parent).portion == 1.0
