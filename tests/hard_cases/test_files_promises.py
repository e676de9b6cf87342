"""Files that promise more than they hold, or unpack to more than a computer has: refused within 2 GiB and seconds."""

import base64
import gzip
import io
import json
import re
import struct
import zipfile
import zlib

import numpy as np
import pytest
from hard_cases.cases import hard_case
from hard_cases.made_files import MEMORY, SCENE, Sample, in_child, samples, verdict
from hypothesis import given, settings
from hypothesis import strategies as st

from morphofold.io import (
    files,
    freesurfer,
    gifti,
    read_annotation,
    read_cortex,
    read_label,
    read_morph,
    read_surface,
    trimesh_files,
    vtk_files,
)
from morphofold.sim.mesh.tetmesh import read_tets
from morphofold.sim.output.checkpoint import read_arrays
from morphofold.sim.scene import MeshFile
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


def counts_believed(patch):
    patch.setattr(freesurfer, "len", lambda things: MANY if isinstance(things, np.ndarray) else 2**40, raising=False)


@pytest.mark.parametrize("kind", ["map", "annotation", "label"])
@hard_case(
    "files",
    "a FreeSurfer map, annotation or label that promises 2³¹ vertices",
    peers="nibabel: allocates what the header says (read)",
    guard="counts held against the size",
    without=counts_believed,
)
def test_freesurfer(kind, known, holds, tmp_path):
    raw = known["lh.white"].path.read_bytes()
    much = struct.pack(">i", MANY)
    name, damaged, read = {
        "map": ("lh.k", b"\xff\xff\xff" + struct.pack(">3i", MANY, 1, 1) + raw, read_morph),
        "annotation": ("a.annot", much + raw, read_annotation),
        "label": ("a.label", f"#!ascii\n{MANY}\n0 1 2 3 4\n".encode(), lambda path: read_label(path, 42)),
    }[kind]
    refused(holds, kind, tmp_path / name, damaged, read, str(MANY))


LEGACY = "# vtk DataFile Version 3.0\nx\nASCII\nDATASET {}\nPOINTS\t{} float\n0 0 0 1 0 0 0 1 0\n{}\t{} {}\n3 0 1 2\n"
PLY = "ply\nformat {} 1.0\nelement\tvertex {}\nproperty float x\nproperty float y\nproperty float z\nelement face 1\n"
polygons_promise = hard_case(
    "files",
    "a VTK or PLY that promises 2³¹ points or faces",
    peers="VTK: ends the process (measured)",
    guard="counts held against the size",
    without=lambda patch: [
        patch.setattr(module, name, lambda raw, *counts: None)
        for module, name in (
            (trimesh_files, "check_counts"),
            (trimesh_files, "_check_ply"),
            (vtk_files, "check_counts"),
        )
    ],
)


@pytest.mark.parametrize(("n", "m", "size"), [(MANY, 1, 4), (3, MANY, 4)])
@polygons_promise
def test_legacy_vtk(n, m, size, holds, tmp_path):
    text = LEGACY.format("POLYDATA", n, "POLYGONS", m, size).encode()
    refused(holds, f"POINTS {n}, POLYGONS {m} {size}", tmp_path / "a.vtk", text, read_surface, str(MANY))


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian"])
@polygons_promise
def test_ply(form, holds, tmp_path):
    text = PLY.format(form, MANY) + "property list uchar int vertex_indices\nend_header\n0 0 0\n"
    refused(holds, f"element vertex, {form}", tmp_path / "a.ply", text.encode(), read_surface, str(MANY))


def _gifti(data, dims):
    return (
        (
            '<?xml version="1.0"?><GIFTI Version="1.0" NumberOfDataArrays="1"><DataArray Intent="NIFTI_INTENT_SHAPE" '
            f'DataType="NIFTI_TYPE_FLOAT32" ArrayIndexingOrder="RowMajorOrder" {dims} Encoding="GZipBase64Binary" '
            'Endian="LittleEndian" ExternalFileName="" ExternalFileOffset="0"><Data>'
        ).encode()
        + base64.b64encode(data)
        + b"</Data></DataArray></GIFTI>"
    )


def _zeros(n, tool=None):
    """n zeros, packed."""
    tool, step = tool or zlib.compressobj(), 2**24
    return b"".join([*(tool.compress(bytes(min(step, n - k))) for k in range(0, n, step)), tool.flush()])


def tetrahedra(path):
    return read_tets(MeshFile(shape="mesh", file=str(path), cortex_thickness=3.0))


def unbounded(patch):
    patch.setattr(gifti, "MOST_NUMBERS", 2**40)
    patch.setattr(files, "MOST_UNPACKED_BYTES", 2**40)
    patch.setattr(vtk_files, "MOST_UNPACKED_BYTES", 2**40)


def _vtk_bomb(kind):
    """A mesh whose one array unpacks to 1 GiB."""
    block = zlib.compress(bytes(2**24))
    head = base64.b64encode(struct.pack("<67I", 64, 2**24, 0, *[len(block)] * 64))
    return (
        (
            f'<VTKFile type="{kind}" byte_order="LittleEndian" compressor="vtkZLibDataCompressor"><{kind}><Piece '
            'NumberOfPoints="9" NumberOfCells="1" NumberOfPolys="1"><Points><DataArray type="Float32" '
            'NumberOfComponents="3" format="binary">'
        ).encode()
        + head
        + base64.b64encode(64 * block)
        + f"</DataArray></Points></Piece></{kind}></VTKFile>".encode()
    )


def _gifti_bomb(n=2**29):
    return _gifti(_zeros(n), f'Dimensionality="1" Dim0="{n // 4}"')


def _spaces(n=2**29):
    return gzip.compress(b"<GIFTI>" + bytes(2**20)) + _zeros(n, zlib.compressobj(wbits=31))


UNPACKS = str(2**29)
BOMBS = {
    "GIFTI": ("a.shape.gii", _gifti_bomb, read_morph, str(2**27)),
    "compressed GIFTI": ("a.gii.gz", _spaces, read_morph, "256 MiB"),
    "VTU": ("a.vtu", lambda: _vtk_bomb("UnstructuredGrid"), read_surface, UNPACKS),
    "VTU of tetrahedra": ("a.vtu", lambda: _vtk_bomb("UnstructuredGrid"), tetrahedra, UNPACKS),
    "VTP": ("a.vtp", lambda: _vtk_bomb("PolyData"), read_surface, UNPACKS),
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", BOMBS)
@hard_case(
    "files",
    "a GIFTI, VTU or VTP of 1 MB that unpacks to 512 MiB or 1 GiB",
    peers="nibabel, meshio, VTK: unpack it (measured)",
    guard="bounds for what is unpacked",
    without=unbounded,
)
def test_bombs(kind, holds, tmp_path):
    name, make, read, word = BOMBS[kind]
    refused(holds, kind, tmp_path / name, make(), read, word)


@hard_case(
    "files",
    "a GIFTI array of 10¹¹ dimensions (found by fuzzing)",
    guard="six at most",
    without=lambda patch: patch.setattr(gifti, "_check_array", lambda path, header: None),
)
def test_dimensions(holds, tmp_path):
    raw = _gifti(zlib.compress(bytes(12)), f'Dimensionality="{10**11}" Dim0="3"')
    refused(holds, "Dimensionality", tmp_path / "a.shape.gii", raw, read_morph, "100000000000")


@hard_case(
    "files",
    "a sound map that needs more memory than there is",
    guard="a lack of memory is no damage",
    without=lambda patch: patch.setattr(files, "_is_lack_of_memory", lambda error: False),
    fails=AssertionError,
)
def test_little_memory(holds, tmp_path):
    path, n = tmp_path / "lh.thickness", 2**24
    path.write_bytes(b"\xff\xff\xff" + struct.pack(">3i", n, 1, 1) + bytes(4 * n))
    with pytest.raises(AssertionError) as caught:
        in_child(lambda: verdict(Sample(path, lambda: read_morph(path))), memory=2**26)
    message = str(caught.value).replace(str(path), path.name)
    holds.says("error", message, "MemoryError: lh.thickness: ")


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
        for reader in ("io.cortices", "io.cortex_files", "results.analyses", "results.graph_file")
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
