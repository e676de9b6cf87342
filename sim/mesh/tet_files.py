"""A file of tetrahedra that meshio reads: points, tetrahedra, and the values and labels that it holds for them."""

import io
import re
from collections import Counter
from collections.abc import Sequence
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any, NamedTuple

import meshio
import numpy as np
from numpy.typing import NDArray

from morphofold.errors import DamagedFile, MissingPart, TooLarge, UnknownName, WrongFile, WrongShape
from morphofold.frozen_arrays import Array, Ints
from morphofold.io.files import decoding, existing_file, warn_of_no_end
from morphofold.io.formats import format_of
from morphofold.sim.scene import MOST_BRICKS, MeshFile
from morphofold.validators import finite, one_of

#: other cells that a file may have; of these only triangles are used, and only for their labels
OTHER_CELL_TYPES = ("vertex", "line", "line3", "triangle", "triangle6")
MOST_NAMES = 8  # values that a message lists
SURFACE = (
    "{}: is a surface, with {}no tetrahedra. A cortex grows with geometry.shape = 'cortex', whose key is subject; "
    "`morphofold unfold` makes a smooth surface to fill with tetrahedra."
)


class TetFile(NamedTuple):
    """Content of a file of tetrahedra.

    Attributes
    ----------
    name : str
        For messages.
    points : (P, 3) float64
        All points of the file [mm].
    tets : (E, 4) int
    mesh : meshio.Mesh
        What meshio read.
    """

    name: str
    points: Array
    tets: Ints
    mesh: meshio.Mesh

    def point_maps(self) -> dict[str, Array]:
        """All point data with one real number per point, (P,) float64 each, by name."""
        data = {str(name): np.asarray(values) for name, values in self.mesh.point_data.items()}
        is_map = lambda values: values.size == len(values) and values.dtype.kind in "biuf"
        return {name: values.ravel().astype(np.float64) for name, values in data.items() if is_map(values)}

    def point_map(self, map_name: str, key: str) -> Array:
        """Values (P,) of the point data that a key of the scene names."""
        maps = self.point_maps()
        one_of(map_name, maps, f"{self.name}: geometry.{key}, point data with one number per point,")
        return maps[map_name]

    def cell_values(self, name: str, key: str, kind: str = "tetra") -> NDArray[np.generic]:
        """One value per cell of a kind, (E,), from the cell data that a key of the scene names."""
        one_of(name, self.mesh.cell_data, f"{self.name}: geometry.{key}, cell data,")
        values = np.asarray(self.mesh.get_cell_data(name, kind))
        if values.ndim != 1:
            raise WrongShape(f"{self.name}: cell data {name!r} have shape {values.shape}; give one number per cell.")
        return values

    def labelled_triangles(self, name: str, labels: Sequence[int], key: str) -> Ints:
        """Corners (F, 3) of the triangles whose cell data ``name`` have one of the ``labels`` of a key of the scene."""
        triangles = self.mesh.get_cells_type("triangle")
        if not len(triangles):
            raise MissingPart(
                f"{self.name}: has no triangles, so none has a label of geometry.{key}; write the labelled triangles "
                "of the surface into the file, too."
            )
        values = self.cell_values(name, "facets", "triangle")
        for label in labels:
            if not (values == label).any():
                raise UnknownName(
                    f"{self.name}: no triangle has {name} = {label} (geometry.{key}); it has {counted(values)}."
                )
        return triangles.astype(np.int64)[np.isin(values, labels)]


def counted(values: NDArray[np.generic]) -> str:
    """The first values with their numbers, for messages."""
    labels, label_counts = np.unique(values, return_counts=True)
    return ", ".join(f"{label:g} ({count:,})" for label, count in list(zip(labels, label_counts))[:MOST_NAMES])


def read_tet_file(geometry: MeshFile) -> TetFile:
    """Read the file of a geometry, and check points and corners.

    Raises
    ------
    FileNotFoundError
        If there is neither a file nor a sample of that name.
    ValueError
        For a file that is damaged, too large, a surface, or has other cells than tetrahedra.
    """
    name, path = geometry.file, geometry.path()
    is_readable = path.name.lower().endswith(tuple(meshio.extension_to_filetypes))
    raw = path.read_bytes()
    # VTK's surfaces are in files that end like its meshes
    if b"DATASET POLYDATA" in raw[:4096] if is_readable else format_of(raw, path.name):
        raise WrongFile(SURFACE.format(name, ""))
    if not is_readable:
        raise WrongFile(
            f"{name}: meshio can't read files that end in {path.suffix!r}; convert it, for example to .vtu."
        )
    with decoding(path, "a mesh that meshio reads"), redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
        mesh = _read_mesh(path, raw)
        points = np.asarray(mesh.points, dtype=np.float64) * geometry.scale
        tets = mesh.get_cells_type("tetra").astype(np.int64)
    warn_of_no_end(path, raw)
    cell_counts = Counter[str]()
    for block in mesh.cells:
        cell_counts[block.type] += len(block.data)
    other_counts = {kind: n for kind, n in cell_counts.items() if kind not in ("tetra", *OTHER_CELL_TYPES) and n}
    if other_counts or not cell_counts["tetra"]:
        if cell_counts["triangle"] and not other_counts:
            raise WrongFile(SURFACE.format(name, f"{cell_counts['triangle']:,} triangles and "))
        cells_text = ", ".join(f"{n:,} {kind}" for kind, n in (other_counts or cell_counts).items()) or "no cells"
        raise WrongFile(
            f"{name}: must hold linear tetrahedra (tetra) but holds {cells_text}; split the cells or mesh it again."
        )
    if len(tets) > MOST_BRICKS:
        raise TooLarge(f"{name}: has {len(tets):,} tetrahedra, more than {MOST_BRICKS:,}; coarsen the mesh.")
    finite(points, f"{name}: points", "Mesh it again.")
    if tets.min() < 0 or tets.max() >= len(points):
        range_text = f"{tets.min()} to {tets.max()}"
        raise DamagedFile(f"{name}: tetrahedra use points {range_text} of 0 to {len(points) - 1}. Repair the mesh.")
    return TetFile(name, points, tets, mesh)


class _EndingFile(io.FileIO):
    """A file that raises EOFError if a reader repeatedly asks for bytes beyond the end."""

    _asked_in_vain = 0

    def readinto(self, buffer: Any, /) -> int:
        n_bytes = super().readinto(buffer)
        self._asked_in_vain = 0 if n_bytes else self._asked_in_vain + 1
        if self._asked_in_vain > 99:
            raise EOFError("it ends too early")
        return n_bytes


def _read_mesh(path: Path, raw: bytes) -> meshio.Mesh:
    """Read the mesh in a file: by meshio, some of whose readers never return on a truncated file, or here."""
    file_format = meshio.extension_to_filetypes.get(path.suffix.lower(), [""])[0]
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


def _read_neutral(raw: bytes) -> meshio.Mesh:
    """The mesh in Netgen's neutral format, that of the folding codes of Tallinen and BrainGrowth, as ``meshio.Mesh``.

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
    return meshio.Mesh(points, blocks, cell_data={"label": labels})
