"""All that morphofold has from meshio: meshes of points and cells, in and out.

meshio's upkeep ended in May 2026. When it no longer works with a new Python or NumPy, this module changes alone: its
fork, or VTK (pyvista, already needed) for ``.vtu`` and ``.vtk``, and Gmsh's own package for ``.msh``.
``tests/test_meshio_files.py`` says what must stay.
"""

import io
import re
from pathlib import Path
from typing import Any

import meshio
import numpy as np
from meshio import Mesh
from numpy.typing import NDArray

from morphofold.errors import DamagedFile
from morphofold.io.files import existing_file

MESH_ENDINGS: tuple[str, ...] = tuple(meshio.extension_to_filetypes)


def write_mesh(path: Path, mesh: Mesh, **options: Any) -> None:
    """Write a mesh in the format that its name ends in, with options of that format."""
    meshio.write(path, mesh, **options)


class _EndingFile(io.FileIO):
    """A file that raises EOFError if a reader repeatedly asks for bytes beyond the end."""

    _asked_in_vain = 0

    def readinto(self, buffer: Any, /) -> int:
        n_bytes = super().readinto(buffer)
        self._asked_in_vain = 0 if n_bytes else self._asked_in_vain + 1
        if self._asked_in_vain > 99:
            raise EOFError("it ends too early")
        return n_bytes


def read_mesh(path: Path, raw: bytes = b"") -> Mesh:
    """The mesh in a file; its bytes ``raw`` tell apart formats that share an ending.

    Any exception may be raised; some of meshio's readers would never return on a truncated file.
    """
    file_format = meshio.extension_to_filetypes.get(path.suffix.lower(), [""])[0]
    if not raw and file_format in ("medit", "ansys"):
        raw = path.read_bytes()
    if file_format == "medit" and re.match(rb"\s*\d+\s*\n", raw):
        return _read_neutral(raw)
    if file_format == "tetgen":
        for suffix in (".node", ".ele"):  # meshio waits forever for their first number
            if not re.search(rb"^\s*\d", existing_file(path.with_suffix(suffix)).read_bytes(), re.MULTILINE):
                raise DamagedFile(f"{path.stem}{suffix} holds no numbers")
    if file_format == "ansys" and b"$MeshFormat" in raw[:4096]:  # meshio reads every .msh as ansys first
        return meshio.read(path, "gmsh")
    if file_format not in ("ansys", "mdpa", "tecplot"):
        return meshio.read(path)
    with io.BufferedReader(_EndingFile(path)) as file:
        return meshio.read(io.TextIOWrapper(file, "utf-8") if file_format == "tecplot" else file, file_format)


def _read_neutral(raw: bytes) -> Mesh:
    """The mesh in Netgen's neutral format, that of the folding codes of Tallinen and BrainGrowth, as a mesh.

    Counts and rows of points, tetrahedra and, if any, triangles; before their corners, which count from 1, cells may
    have a label, here the cell data ``label``.
    """
    rows, tables = [line.split() for line in raw.splitlines() if line.strip()], list[NDArray[Any]]()
    while rows and len(tables) < 3:
        n = int(b" ".join(rows[0]))
        numbers = [word for words in rows[1 : n + 1] for word in words]
        tables.append(np.array(numbers, np.int64 if tables else np.float64).reshape(n, len(numbers) // max(n, 1)))
        rows = rows[n + 1 :]
    points, *cells = tables
    if rows or points.shape[1] != 3 or any(a.size and a.shape[1] - c not in (0, 1) for a, c in zip(cells, (4, 3))):
        raise DamagedFile("it does not hold the points, tetrahedra and triangles that its counts give")
    blocks = [(kind, a[:, -n:] - 1) for kind, a, n in zip(("tetra", "triangle"), cells, (4, 3)) if a.size]
    labels = [a[:, 0] if a.shape[1] > n else np.ones(len(a), int) for a, n in zip(cells, (4, 3)) if a.size]
    return Mesh(points, blocks, cell_data={"label": labels})
