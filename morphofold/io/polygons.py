"""Polygon files through trimesh, and VTK's through meshio and pyvista."""

from __future__ import annotations

import importlib
import logging
import os
import re
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path

import numpy as np

from morphofold.io.files import StrPath, atomic_file, decoding, looks_like_text, read_back, write_by_library
from morphofold.io.vtk_blocks import check_blocks
from morphofold.surface import Faces, Surface, Verts

TRIMESH = (".ply", ".stl", ".obj", ".off", ".glb")
MESHIO = (".vtk", ".vtu")
PYVISTA = (".vtp",)
ENDINGS = (*TRIMESH, *MESHIO, *PYVISTA)

# counts that a header may promise (PLY; VTK; GLB); each counted thing takes at least a byte of the file
_COUNTS = re.compile(
    rb'(?:element[ \t]+\w+|\n[ \t]*(?:points|polygons|cells)|"count"[ \t]*:)[ \t]*(\d+)(?:[ \t]+(\d+))?', re.IGNORECASE
)
_PLY_COUNTS = re.compile(rb"\n[ \t]*element[ \t]+(vertex|face)[ \t]+(\d+)")
_OFF_COUNTS = re.compile(rb"OFF\s+(?:#[^\n]*\n\s*)*(\d+)\s+(\d+)")


def read_trimesh(path: Path, kind: str) -> tuple[Verts, Faces]:
    """Vertices and faces of a PLY, STL, OBJ, OFF or GLB file (``kind``: the ending without its dot).

    trimesh cuts polygons with more corners into triangles. Vertices keep the file's order.

    STL names no vertices, so corners at exactly the same place become one (in order of first appearance), and
    a warning says how many. OBJ does not say how long it is, so a missing end goes unseen. Materials,
    textures and files named inside are not read.
    """
    import trimesh

    with decoding(path, f"a surface in {kind.upper()} format"):
        raw = path.read_bytes()
        _check_counts(raw)
        if kind in _CHECK:
            _CHECK[kind](raw)
        # from memory and without a resolver: no other file that this one may name is opened
        options = {"process": False, "maintain_order": True, "skip_materials": True}
        with _silent_log():                                             # of normals, which are not taken
            mesh = trimesh.load_mesh(BytesIO(raw), file_type=kind, **options)
        verts, faces = np.array(mesh.vertices, dtype=np.float64), np.array(mesh.faces, dtype=np.int64)
        if len(faces) == 0:
            raise ValueError("it holds no triangles")
        if kind == "ply":
            _check_ply(raw, len(verts), len(faces))
    _warn_of_no_end(path, raw)
    if kind == "stl":
        corners = len(verts)
        verts, faces = merge_equal(verts, faces)
        warnings.warn(
            f"{path}: STL has no shared vertices; {corners} corners at exactly equal places were merged to "
            f"{len(verts)} vertices.", stacklevel=4,
        )  # fmt: skip
    return verts, faces


def merge_equal(verts: Verts, faces: Faces) -> tuple[Verts, Faces]:
    """Make one vertex of those at exactly the same place, in order of first appearance."""
    _, first, inverse = np.unique(verts, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return verts[first[order]], rank[inverse.reshape(-1)][faces]


def read_meshio(path: Path, kind: str) -> tuple[Verts, Faces]:
    """Vertices and triangles of a VTK (unstructured) or VTU file; lines and points are left out.

    Refused if the file has other faces than triangles, or volume cells and no triangles.
    """
    with decoding(path, f"a surface in {kind.upper()} format"):
        raw = path.read_bytes()
        _check_vtk(raw)
        mesh = importlib.import_module(f"meshio.{kind}").read(os.fspath(path))
        cells = {block.type: len(block.data) for block in mesh.cells if block.type not in ("vertex", "line")}
        if not cells.get("triangle"):
            raise ValueError(f"it holds no triangles but {cells or 'no cells'}; extract its surface first")
        flat = {k: n for k, n in cells.items() if k != "triangle" and k.startswith(("tri", "quad", "poly"))}
        if flat:
            raise ValueError(f"it holds {flat} beside {cells['triangle']} triangles; triangulate it first")
        found = mesh.points, mesh.get_cells_type("triangle").astype(np.int64)
    _warn_of_no_end(path, raw)
    return found


def read_pyvista(path: Path) -> tuple[Verts, Faces]:
    """Vertices and triangles of VTK polygon data (``.vtp``, or a ``.vtk`` that says ``DATASET POLYDATA``)."""
    import pyvista

    errors = pyvista.VtkErrorCatcher(raise_errors=True, send_to_logging=False)  # VTK itself only prints them
    with decoding(path, "a surface in VTK format"), _silent_log(), pyvista.vtk_verbosity("off"), errors:
        raw = path.read_bytes()
        _check_vtk(raw)
        mesh = pyvista.get_reader(path, force_ext=".vtk" if raw.startswith(b"# vtk") else ".vtp").read()
        if not isinstance(mesh, pyvista.PolyData) or mesh.n_points == 0 or mesh.GetNumberOfPolys() == 0:
            raise ValueError("it holds no triangles, or is truncated")
        if not mesh.is_all_triangles:
            raise ValueError("it holds faces that are no triangles; triangulate it first")
        found = np.array(mesh.points, dtype=np.float64), mesh.regular_faces.astype(np.int64)
    _warn_of_no_end(path, raw)
    return found


@contextmanager
def _silent_log() -> Iterator[None]:
    """Keep packages from logging what is raised anyway, or doesn't matter."""
    before = logging.root.manager.disable
    logging.disable(logging.CRITICAL)
    try:
        yield
    finally:
        logging.disable(before)


def _check_counts(raw: bytes) -> None:
    for match in _COUNTS.finditer(raw):
        for count in filter(None, match.groups()):
            if int(count) > len(raw):
                raise ValueError(f"its header promises {count.decode()} elements, it has {len(raw)} bytes")


def _check_vtk(raw: bytes) -> None:
    _check_counts(raw)
    if raw.startswith(b"# vtk"):
        return
    if not (b"<VTKFile" in raw and raw.rstrip().endswith(b"</VTKFile>")):
        raise ValueError("it does not go from <VTKFile> to </VTKFile>")
    check_blocks(raw)


def _check_stl(raw: bytes) -> None:
    """Binary by its size, or text with an end; trimesh takes half a binary file for an empty text."""
    promised = 84 + 50 * int.from_bytes(raw[80:84], "little")
    if len(raw) == promised or (raw.lstrip().startswith(b"solid") and b"endsolid" in raw[-1024:]):
        return
    if raw.lstrip().startswith(b"solid") and b"facet" in raw[:1024]:
        raise ValueError("it has no endsolid, so its end is missing")
    raise ValueError(f"its header promises {promised} bytes, it has {len(raw)}")


def _check_off(raw: bytes) -> None:
    """trimesh takes as many faces as there are; a triangle needs four numbers."""
    match = _OFF_COUNTS.search(raw[:4096])
    n, m = (int(match[1]), int(match[2])) if match else (0, 0)
    numbers = len(raw[match.end() :].split()) if match else 0
    if numbers < 3 * n + 4 * m:
        raise ValueError(f"{n} vertices and {m} faces need {3 * n + 4 * m} numbers or more, it has {numbers}")


def _check_ply(raw: bytes, n: int, m: int) -> None:
    """trimesh takes as many faces of a text as there are; a polygon makes one triangle at least."""
    promised = {name.decode(): int(count) for name, count in _PLY_COUNTS.findall(raw)}
    if n < promised.get("vertex", 0) or m < promised.get("face", 0):
        raise ValueError(f"its header promises {promised}, it has {n} vertices and {m} triangles")


def _warn_of_no_end(path: Path, raw: bytes) -> None:
    """Where a text stops within a line, its last number may be a part of one: 1 of 162. XML and STL say their end."""
    says = raw.endswith(b">") or b"endsolid" in raw[-1024:]
    if not (says or raw[-1:].isspace()) and looks_like_text(raw[:1024]) and looks_like_text(raw[-64:]):
        warnings.warn(f"{path}: its last line has no end; was it cut? Then its last number is wrong.", stacklevel=5)


_CHECK = {"stl": _check_stl, "off": _check_off}


def write_polygons(path: StrPath, surface: Surface) -> None:
    """Write by ending. PLY, STL, GLB and VTP hold float32; OBJ and OFF get 22 decimals."""
    path = Path(path)
    kind = path.suffix.lower()
    with atomic_file(path) as temporary:
        if kind in TRIMESH:
            import trimesh

            mesh = trimesh.Trimesh(surface.verts, surface.faces, process=False)
            exact = {"digits": 22} if kind in (".obj", ".off") else {}
            mesh.export(temporary, file_type=kind[1:], **exact)
        elif kind in PYVISTA:
            import pyvista
            from vtkmodules.vtkIOXML import vtkXMLPolyDataWriter

            writer = vtkXMLPolyDataWriter()
            writer.SetInputData(pyvista.PolyData.from_regular_faces(surface.verts, surface.faces.astype(int)))
            writer.SetDataModeToBinary()
            writer.WriteToOutputStringOn()              # into memory: at a full disk VTK ends the process
            writer.Write()
            temporary.write_text(writer.GetOutputString(), encoding="ascii")
        else:
            import meshio

            mesh = meshio.Mesh(surface.verts, [("triangle", surface.faces)])
            with write_by_library(path, temporary):
                importlib.import_module(f"meshio.{kind[1:]}").write(os.fspath(temporary), mesh)
            with read_back(path, temporary):
                read_meshio(temporary, kind[1:])
