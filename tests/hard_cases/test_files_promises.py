"""Headers that promise more than their file holds: refused in one line, and no memory is taken for the promise."""

import struct
import tracemalloc

import pytest
from hard_cases.cases import hard_case
from hard_cases.made_files import Sample, verdict

from morphofold.io import read_annotation, read_label, read_morph, read_surface

MANY = 2**31 - 1
LIGHT = 512  # MiB that a refusal may take
VTK = "# vtk DataFile Version 3.0\nx\nASCII\nDATASET POLYDATA\nPOINTS\t{} float\n{}POLYGONS\t1 {}\n3 0 1 2\n"
TRIANGLE = "0 0 0 1 0 0 0 1 0\n"
PLY = "ply\nformat {} 1.0\nelement\tvertex {}\nproperty float x\nproperty float y\nproperty float z\nelement face 1\n"
PLY_BODY = "property list uchar int vertex_indices\nend_header\n0 0 0\n"
FILES = {
    "lh.k": (b"\xff\xff\xff" + struct.pack(">3i", MANY, 1, 1) + bytes(999), read_morph),
    "a.annot": (struct.pack(">i", MANY) + bytes(999), read_annotation),
    "a.label": (f"#!ascii\n{MANY}\n0 1 2 3 4\n".encode(), lambda path: read_label(path, 42)),
    "points.vtk": (VTK.format(MANY, TRIANGLE, 4).encode(), read_surface),
    "polygons.vtk": (VTK.format(3, TRIANGLE, MANY).encode(), read_surface),
    "text.ply": ((PLY.format("ascii", MANY) + PLY_BODY).encode(), read_surface),
    "binary.ply": ((PLY.format("binary_little_endian", MANY) + PLY_BODY).encode(), read_surface),
}


@pytest.mark.parametrize("name", FILES)
@hard_case(
    "files",
    "a map, annotation, label or surface that promises 2³¹ vertices or faces",
    peers="nibabel: allocates what the header says (read); VTK: ends the process (measured)",
)
def test_promises(name, holds, tmp_path):
    raw, read = FILES[name]
    path = tmp_path / name
    path.write_bytes(raw)
    tracemalloc.start()
    try:
        message = verdict(Sample(path, lambda: read(path)))
        taken = tracemalloc.get_traced_memory()[1] / 2**20
    finally:
        tracemalloc.stop()
    holds.says(name, message.replace(str(path), path.name), path.name, "[damaged-file]")
    holds(f"{name}: memory taken", taken, at_most=LIGHT, unit="MiB")
