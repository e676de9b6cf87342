"""A file of tetrahedra that meshio reads: points, tetrahedra, and the values and labels that it holds for them."""

import io
from collections import Counter
from collections.abc import Sequence
from contextlib import redirect_stderr, redirect_stdout
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from morphofold.errors import DamagedFile, MissingPart, TooLarge, UnknownName, WrongFile, WrongShape
from morphofold.frozen_arrays import Array, Ints
from morphofold.io.files import decoding, warn_of_no_end
from morphofold.io.formats import format_of
from morphofold.io.meshio_files import MESH_ENDINGS, Mesh, read_mesh
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
    mesh : Mesh
        What meshio read.
    """

    name: str
    points: Array
    tets: Ints
    mesh: Mesh

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
    is_readable = path.name.lower().endswith(MESH_ENDINGS)
    raw = path.read_bytes()
    # VTK's surfaces are in files that end like its meshes
    if b"DATASET POLYDATA" in raw[:4096] if is_readable else format_of(raw, path.name):
        raise WrongFile(SURFACE.format(name, ""))
    if not is_readable:
        raise WrongFile(
            f"{name}: meshio can't read files that end in {path.suffix!r}; convert it, for example to .vtu."
        )
    with decoding(path, "a mesh that meshio reads"), redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
        mesh = read_mesh(path, raw)
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
