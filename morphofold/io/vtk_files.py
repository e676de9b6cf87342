"""VTK file formats: VTK and VTU through meshio, VTP and polygon data through pyvista."""

from __future__ import annotations

import importlib
import os
import re
from functools import partial
from pathlib import Path

import numpy as np

from morphofold.errors import DamagedFile, WrongFile
from morphofold.io.files import atomic_file, decoding, write_and_look
from morphofold.io.formats import Format, SurfaceContent, check_counts, silent_log, warn_of_no_end
from morphofold.io.vtk_blocks import check_blocks
from morphofold.surface import Surface


def read_unstructured(kind: str, path: Path) -> SurfaceContent:
    """Vertices and triangles of an unstructured ``vtk`` or ``vtu`` file; lines and points are left out.

    Raises ``WrongFile`` if the file has faces other than triangles, or no triangles.
    """
    with decoding(path, f"a surface in {kind.upper()} format"):
        raw = path.read_bytes()
        _check_vtk(raw)
        mesh = importlib.import_module(f"meshio.{kind}").read(os.fspath(path))
        cells = {block.type: len(block.data) for block in mesh.cells if block.type not in ("vertex", "line")}
        if not cells.get("triangle"):
            raise WrongFile(f"it holds {cells or 'no cells'} and no triangles; extract its surface first")
        flat = {k: n for k, n in cells.items() if k != "triangle" and k.startswith(("tri", "quad", "poly"))}
        if flat:
            raise WrongFile(f"it holds {flat} as well as {cells['triangle']} triangles; triangulate it first")
        verts, faces = mesh.points, mesh.get_cells_type("triangle").astype(np.int64)
    warn_of_no_end(path, raw)
    return verts, faces, None


def read_polygons(path: Path) -> SurfaceContent:
    """Vertices and triangles of VTK polygon data (``.vtp``, or a ``.vtk`` with ``DATASET POLYDATA``)."""
    import pyvista

    errors = pyvista.VtkErrorCatcher(raise_errors=True, send_to_logging=False)  # VTK itself only prints errors
    with decoding(path, "a surface in VTK format"), silent_log(), pyvista.vtk_verbosity("off"), errors:
        raw = path.read_bytes()
        _check_vtk(raw)
        mesh = pyvista.get_reader(path, force_ext=".vtk" if raw.startswith(b"# vtk") else ".vtp").read()
        if not isinstance(mesh, pyvista.PolyData) or mesh.n_points == 0 or mesh.GetNumberOfPolys() == 0:
            raise DamagedFile("it holds no triangles, or is truncated")
        if not mesh.is_all_triangles:
            raise WrongFile("it holds faces that are not triangles; triangulate it first")
        verts, faces = np.array(mesh.points, dtype=np.float64), mesh.regular_faces.astype(np.int64)
    warn_of_no_end(path, raw)
    return verts, faces, None


def _check_vtk(raw: bytes) -> None:
    check_counts(raw)
    if raw.startswith(b"# vtk"):
        return
    if not (b"<VTKFile" in raw and raw.rstrip().endswith(b"</VTKFile>")):
        raise DamagedFile("it does not reach from <VTKFile> to </VTKFile>")
    check_blocks(raw)


def write_unstructured(kind: str, path: Path, surface: Surface) -> None:
    import meshio

    mesh = meshio.Mesh(surface.verts, [("triangle", surface.faces)])
    write = importlib.import_module(f"meshio.{kind}").write
    write_and_look(path, lambda name: write(name, mesh), partial(read_unstructured, kind))


def write_polygons(path: Path, surface: Surface) -> None:
    """Write a surface as VTP in float32."""
    import pyvista
    from vtkmodules.vtkIOXML import vtkXMLPolyDataWriter

    with atomic_file(path) as temporary:
        writer = vtkXMLPolyDataWriter()
        writer.SetInputData(pyvista.PolyData.from_regular_faces(surface.verts, surface.faces.astype(int)))
        writer.SetDataModeToBinary()
        writer.WriteToOutputStringOn()  # into memory: VTK ends the process if the disk is full
        writer.Write()
        temporary.write_text(writer.GetOutputString(), encoding="ascii")


_POLYGONS_START = rb"""[^#]*<VTKFile [^>]*type=["']PolyData|# vtk.*?DATASET +POLYDATA"""
_UNSTRUCTURED_START = rb"""[^#]*<VTKFile [^>]*type=["']UnstructuredGrid"""
FORMATS = (
    Format("VTP", (".vtp",), read_polygons, write_polygons, re.compile(_POLYGONS_START, re.DOTALL)),
    *(
        Format(kind.upper(), (f".{kind}",), partial(read_unstructured, kind), partial(write_unstructured, kind), begins)
        for kind, begins in (("vtu", re.compile(_UNSTRUCTURED_START, re.DOTALL)), ("vtk", re.compile(rb"# vtk")))
    ),
)
