"""Surfaces and maps in FreeSurfer's and AFNI's text format, and the MNI objects of CIVET."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from morphofold.errors import DamagedFile, WrongFile
from morphofold.io.files import SurfaceContent
from morphofold.surface import PerVertex


def read_ascii(raw: bytes, path: Path) -> SurfaceContent:
    """Vertices and faces of FreeSurfer's text format: a comment, two counts, and rows of three numbers and a flag."""
    n, m, *numbers = re.sub(rb"#[^\n]*", b"", raw).split()
    if len(numbers) != 4 * (int(n) + int(m)):
        raise DamagedFile(f"{int(n)} vertices and {int(m)} faces do not have {len(numbers)} numbers")
    verts = np.array(numbers[: 4 * int(n)], np.float64).reshape(-1, 4)[:, :3]
    return verts, np.array(numbers[4 * int(n) :], np.int64).reshape(-1, 4)[:, :3], None


def read_mni(raw: bytes, path: Path) -> SurfaceContent:
    """Vertices and triangles of an MNI object of polygons, as text."""
    words = raw.split()
    n = int(words[6])
    at = 7 + 6 * n  # after positions and normals
    m, colours = int(words[at]), int(words[at + 1])
    at += 2 + 4 * {0: 1, 1: m, 2: n}[colours]
    ends, corners = (np.array(part, np.int64) for part in (words[at : at + m], words[at + m :]))
    if not np.array_equal(ends, 3 * np.arange(1, m + 1)):
        raise WrongFile("it is cut, or holds faces that are not triangles; triangulate it first")
    return np.array(words[7 : 7 + 3 * n], np.float64).reshape(n, 3), corners.reshape(m, 3), None


def read_map(raw: bytes, path: Path) -> PerVertex:
    """Values (N,) of a text with one number a line, or with vertex, position and value a line as of mris_convert."""
    table = np.loadtxt(raw.decode("ascii").splitlines(), ndmin=2)
    width = table.shape[1]
    if width not in (1, 5) or (width == 5 and not np.array_equal(table[:, 0], np.arange(len(table)))):
        raise WrongFile(f"its lines hold {width} numbers, not one value of each vertex")
    return table[:, -1]
