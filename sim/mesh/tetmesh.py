"""Tetrahedra from a file that meshio reads, checked to be one body: neighbours, outer surface, inner surfaces."""

from __future__ import annotations

import contextlib
import io
import warnings
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from morphofold.arrays import Array, Bools, Ints
from morphofold.errors import (
    BadMesh,
    DamagedFile,
    NoCortex,
    NotFinite,
    OutOfRange,
    TooLarge,
    UnknownName,
    WrongFile,
    WrongShape,
)
from morphofold.io.files import decoding, looks_like_text
from morphofold.io.vtk_blocks import check_blocks
from morphofold.sim.scene import MOST_BRICKS, MeshFile

#: other cells that a file may have; they are ignored
IGNORED_CELL_TYPES = ("vertex", "line", "line3", "triangle", "triangle6")
TET_FACES = ((1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1))  # opposite to each corner; seen from outside
FARTHEST_POINT_MM = 1e6  # largest distance from the origin [mm]
FLAT_VOLUME_RATIO = 1e-10  # a volume below this share of the cube of the longest edge counts as zero


class TetMesh(NamedTuple):
    """One body of tetrahedra.

    Attributes
    ----------
    points : (N, 3) float64
        Points [mm], all in use.
    tets : (E, 4) int
        Corners in right-handed order.
    across : (E, 4) int
        The tetrahedron beyond the face opposite to each corner, -1 at the boundary.
    pial, inner : (F, 3), (H, 3) int
        Faces of the outer surface and of inner surfaces, counter-clockwise seen from outside of the material.
    cortex : (E,) bool, optional
        Which tetrahedra have the label of the cortex.
    """

    points: Array
    tets: Ints
    across: Ints
    pial: Ints
    inner: Ints
    cortex: Bools | None


def read_tets(geometry: MeshFile) -> TetMesh:
    """Read the body from the file of a geometry.

    Raises
    ------
    FileNotFoundError
        If there is neither a file nor a sample of that name.
    ValueError
        For a file that is damaged, too large, or has other cells; for a body of several parts, with flat tetrahedra, or
        whose surface touches itself; for a label that does not exist, or that all tetrahedra have.
    """
    name = geometry.file
    points, tets, cortex = _read_points_and_tets(geometry)
    points, tets, volume = _right_handed_tets(name, points, tets)
    across = _tets_across_faces(name, tets)
    pial, inner, enclosed = _outer_and_inner_faces(name, points, tets[:, TET_FACES][across < 0])
    if abs(volume - enclosed) > 1e-6 * volume:  # two neighbours are on the same side of their face
        raise BadMesh(
            f"{name}: tetrahedra overlap: the sum of their volumes is {volume:.6g} mm3, but their surface encloses "
            f"{enclosed:.6g}. Repair the mesh."
        )
    return TetMesh(points, tets, across, pial, inner, cortex)


class _EndCheckedFile(io.BufferedReader):
    """A file that raises EOFError if a reader repeatedly asks for bytes beyond the end."""

    asked = 0

    def read(self, size: int | None = -1, /) -> bytes:
        return self._seen(super().read(size))

    def read1(self, size: int = -1, /) -> bytes:
        return self._seen(super().read1(size))

    def readline(self, size: int | None = -1, /) -> bytes:
        return self._seen(super().readline(size))

    def _seen(self, got: bytes) -> bytes:
        self.asked = 0 if got else self.asked + 1
        if self.asked > 99:
            raise EOFError("it ends too early")
        return got


def _read_with_meshio(path: Path) -> Any:
    """Read the mesh in a file. Some readers of meshio never return on a truncated file; one would unpack any size."""
    import meshio

    kinds = meshio.extension_to_filetypes.get(path.suffix.lower(), [""])
    if kinds == ["vtu"]:
        check_blocks(path.read_bytes())
    if "ansys" in kinds:  # meshio reads every .msh as ansys first
        with path.open("rb") as file:
            kinds = ["gmsh"] if b"$MeshFormat" in file.read(4096) else ["ansys"]
    if kinds == ["tetgen"]:
        for part in (path.with_suffix(".node"), path.with_suffix(".ele")):
            if not any(line.strip() and not line.startswith(b"#") for line in part.read_bytes().splitlines()):
                raise DamagedFile(f"{part.name} has no line of counts")
    if kinds[0] not in ("ansys", "mdpa", "tecplot"):
        return meshio.read(path, kinds[0] if kinds == ["gmsh"] else None)
    with _EndCheckedFile(io.FileIO(path)) as file:
        return meshio.read(io.TextIOWrapper(file, "utf-8") if kinds == ["tecplot"] else file, kinds[0])


def _read_points_and_tets(geometry: MeshFile) -> tuple[Array, Ints, Bools | None]:
    """Points (P, 3) [mm], tetrahedra (E, 4), and which of these have the label of the cortex."""
    import meshio

    name = geometry.file
    path = geometry.path()
    if not path.name.lower().endswith(tuple(meshio.extension_to_filetypes)):
        raise WrongFile(
            f"{name}: meshio can't read files that end in {path.suffix!r}; convert it, for example to .vtu."
        )
    quiet = contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO())
    with decoding(path, "a mesh that meshio reads"), quiet[0], quiet[1]:
        mesh = _read_with_meshio(path)
        points = np.asarray(mesh.points, dtype=np.float64) * geometry.scale
        blocks = [block.data.astype(np.int64) for block in mesh.cells if block.type == "tetra"]
    _warn_of_cut_file(path)
    counts: dict[str, int] = {}
    for block in mesh.cells:
        counts[block.type] = counts.get(block.type, 0) + len(block.data)
    others = {kind: n for kind, n in counts.items() if kind not in ("tetra", *IGNORED_CELL_TYPES) and n}
    if others or not counts.get("tetra"):
        listing = ", ".join(f"{n:,} {kind}" for kind, n in (others or counts).items()) or "no cells"
        raise WrongFile(
            f"{name}: must hold linear tetrahedra (tetra) but holds {listing}; split the cells or mesh it again."
        )
    tets = np.concatenate(blocks)
    if len(tets) > MOST_BRICKS:
        raise TooLarge(f"{name}: has {len(tets):,} tetrahedra, more than {MOST_BRICKS:,}; coarsen the mesh.")
    if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
        bad = int((~np.isfinite(points)).any(axis=-1).sum())
        kind = NotFinite if bad else WrongShape
        raise kind(f"{name}: points need three finite coordinates; their shape is {points.shape}, {bad} not finite.")
    far = float(np.abs(points).max())
    if far > FARTHEST_POINT_MM:
        raise OutOfRange(
            f"{name}: has points {far:.3g} mm from the origin, more than {FARTHEST_POINT_MM:g}; check the scale."
        )
    if tets.min() < 0 or tets.max() >= len(points):
        named = f"{tets.min()} to {tets.max()}"
        raise DamagedFile(f"{name}: tetrahedra use points {named} of 0 to {len(points) - 1}. Repair the mesh.")
    return points, tets, None if geometry.label is None else _has_cortex_label(geometry, mesh)


def _warn_of_cut_file(path: Path) -> None:
    """Warn if a text file ends within a line: its last number may be cut, for example 1 instead of 162."""
    with path.open("rb") as file:
        head = file.read(1024)
        file.seek(max(path.stat().st_size - 64, 0))
        end = file.read()
    if looks_like_text(head) and looks_like_text(end) and not (end[-1:].isspace() or end.endswith(b">")):
        warnings.warn(
            f"{path}: its last line has no line end; if the file is cut, its last number is wrong.", stacklevel=4
        )


def _has_cortex_label(geometry: MeshFile, mesh: Any) -> Bools:
    """Which tetrahedra have the label of the cortex."""
    name, label = geometry.file, geometry.label
    if label not in mesh.cell_data:
        there = ", ".join(mesh.cell_data) or "none"
        raise UnknownName(f"{name}: has no cell data {label!r} (geometry.label); it has: {there}.")
    values = np.concatenate([v for v, block in zip(mesh.cell_data[label], mesh.cells) if block.type == "tetra"])
    if values.ndim != 1:
        raise WrongShape(f"{name}: cell data {label!r} have shape {values.shape}; give one number per cell.")
    cortex = values == geometry.cortex_label
    if cortex.all() or not cortex.any():
        kinds, n = np.unique(values, return_counts=True)
        listing = ", ".join(f"{kind:g} ({count:,})" for kind, count in list(zip(kinds, n))[:8])
        raise NoCortex(
            f"{name}: needs tetrahedra with {label} = {geometry.cortex_label} (geometry.cortex_label) and others for "
            f"the core; it has {listing}."
        )
    return cortex


def _right_handed_tets(name: str, points: Array, tets: Ints) -> tuple[Array, Ints, float]:
    """Points in use, tetrahedra with corners in right-handed order, and their total volume [mm^3]."""
    used, tets = np.unique(tets, return_inverse=True)
    points, tets = np.ascontiguousarray(points[used]), tets.reshape(-1, 4)
    a, b, c, d = (points[tets[:, k]] for k in range(4))
    volume = np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a) / 6
    edges = (a - b, a - c, a - d, b - c, b - d, c - d)
    longest = np.sqrt(np.max([np.einsum("ij,ij->i", edge, edge) for edge in edges], axis=0))
    flat = np.flatnonzero(~(np.abs(volume) > FLAT_VOLUME_RATIO * longest**3))
    if flat.size:
        raise BadMesh(
            f"{name}: {len(flat):,} of {len(tets):,} tetrahedra are flat; the first is {flat[0]} with volume "
            f"{volume[flat[0]]:.2g} mm3 and longest edge {longest[flat[0]]:.3g} mm. Repair the mesh."
        )
    return points, np.where(volume[:, None] < 0, tets[:, [1, 0, 2, 3]], tets), float(np.abs(volume).sum())


def _tets_across_faces(name: str, tets: Ints) -> Ints:
    """The tetrahedron beyond each face (E, 4), as in ``TetMesh``; raises if the mesh has several parts."""
    faces = np.sort(tets[:, TET_FACES].reshape(-1, 3), axis=1)
    order = np.lexsort(faces.T)
    same = (faces[order[1:]] == faces[order[:-1]]).all(axis=1)
    if (same[1:] & same[:-1]).any():
        at = faces[order[1:][np.flatnonzero(same[1:] & same[:-1])[0]]]
        raise BadMesh(f"{name}: more than two tetrahedra share the face with corners {at.tolist()}. Repair the mesh.")
    left, right = order[:-1][same], order[1:][same]
    across = np.full(tets.size, -1)
    across[left], across[right] = right // 4, left // 4
    parts, part = _connected_parts(left // 4, right // 4, len(tets))
    if parts > 1:
        size = np.sort(np.bincount(part))[::-1]
        raise BadMesh(
            f"{name}: has {parts:,} parts that share no face, of {size[0]:,}, {size[1]:,} ... tetrahedra. Keep one "
            "part; if points are duplicated, merge them."
        )
    return across.reshape(-1, 4)


def _outer_and_inner_faces(name: str, points: Array, faces: Ints) -> tuple[Ints, Ints, float]:
    """Boundary faces (F, 3) of the sheet that encloses most, and those of the others; enclosed volume [mm^3]."""
    half = np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2)  # half-edge 3 f + k, from corner k
    low, high = half.min(axis=1), half.max(axis=1)
    order = np.lexsort((high, low))  # each edge has an even number of half-edges
    one, two = order[0::2], order[1::2]
    cure = "Separate these parts, or join them by a face."
    again = (low[one[1:]] == low[one[:-1]]) & (high[one[1:]] == high[one[:-1]])
    if again.any() or (half[one] != half[two][:, ::-1]).any():
        raise BadMesh(f"{name}: parts of its surface touch along {max(again.sum(), 1):,} edges. {cure}")
    following = one // 3 * 3 + (one + 1) % 3, two // 3 * 3 + (two + 1) % 3
    fans, _ = _connected_parts(np.concatenate([one, two]), np.concatenate([following[1], following[0]]), faces.size)
    pinched = fans - len(np.unique(faces))
    if pinched:
        raise BadMesh(f"{name}: parts of its surface touch at {pinched:,} points. {cure}")
    count, sheet = _connected_parts(one // 3, two // 3, len(faces))
    a, b, c = (points[faces[:, k]] for k in range(3))
    enclosed = np.bincount(sheet, np.einsum("ij,ij->i", a, np.cross(b, c)), count)
    outer = sheet == enclosed.argmax()
    return faces[outer], faces[~outer], float(enclosed.sum()) / 6


def _connected_parts(one: Ints, two: Ints, size: int) -> tuple[int, Ints]:
    """Number of connected parts of ``size`` items, where ``one`` and ``two`` are joined, and the part of each item."""
    return connected_components(sparse.csr_matrix((np.ones(len(one)), (one, two)), (size, size)))
