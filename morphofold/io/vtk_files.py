"""VTK file formats: VTP, VTU and legacy files. VTK ends the process on damaged ones, so another process reads them."""

from __future__ import annotations

import importlib
import io
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from morphofold.errors import DamagedFile, WrongFile
from morphofold.io.files import SurfaceContent, atomic_file, write_and_read
from morphofold.surface import Surface

_TRIANGLE, _LEFT_OUT = 5, {1, 2, 3, 4, 10}  # VTK's numbers: points, lines and tetrahedra are not part of a surface


def read(raw: bytes, path: Path) -> SurfaceContent:
    """Vertices and triangles of VTK polygons, or of an unstructured grid without its lines, points and tetrahedra.

    Raises ``WrongFile`` if the file has faces other than triangles, or no triangles.
    """
    arrays = _arrays(path)
    kinds = arrays["types"]
    if not {*kinds.tolist()} <= {_TRIANGLE, *_LEFT_OUT}:
        raise WrongFile("it holds faces that are not triangles; triangulate it first")
    starts = arrays["offsets"][:-1][kinds == _TRIANGLE]
    if not len(starts):
        raise WrongFile("it holds no triangles; extract its surface first")
    faces = arrays["connectivity"][starts[:, None] + np.arange(3)]
    return arrays["points"].astype(np.float64), faces.astype(np.int64), None


def read_grid(path: Path) -> Any:
    """The ``meshio.Mesh`` in a VTU file; of damaged ones, any exception, which ``decoding`` explains."""
    import meshio
    from meshio._vtk_common import vtk_cells_from_data

    arrays = _arrays(path)
    of_points, of_cells = (
        {name.removeprefix(kind): values for name, values in arrays.items() if name.startswith(kind)}
        for kind in ("point ", "cell ")
    )
    cells = arrays["connectivity"].astype(np.int64), arrays["offsets"][1:], arrays["types"]
    blocks, of_blocks = vtk_cells_from_data(*cells, of_cells)
    return meshio.Mesh(arrays["points"], blocks, of_points, of_blocks)


def _arrays(path: Path) -> dict[str, NDArray[Any]]:
    """The arrays of a file by name, as vtk_process.py writes them."""
    script = Path(__file__).with_name("vtk_process.py")
    done = subprocess.run([sys.executable, "-P", script, path], capture_output=True, check=False)
    if done.returncode or b"rror" in done.stderr:
        raise DamagedFile(done.stderr.decode("utf-8", "replace").strip().rpartition("\n")[2] or "VTK stops")
    with np.load(io.BytesIO(done.stdout)) as arrays:
        return dict(arrays)


def write(path: Path, surface: Surface) -> None:
    """Write a surface as VTK or VTU, or as VTP in float32, by the ending of the path."""
    import meshio

    if path.suffix.lower() == ".vtp":
        return _write_polygons(path, surface)
    to_file = importlib.import_module(f"meshio.{path.suffix[1:].lower()}").write
    mesh = meshio.Mesh(surface.verts, [("triangle", surface.faces)])
    return write_and_read(path, lambda name: to_file(name, mesh), read)


def _write_polygons(path: Path, surface: Surface) -> None:
    import pyvista
    from vtkmodules.vtkIOXML import vtkXMLPolyDataWriter

    with atomic_file(path) as temporary:
        writer = vtkXMLPolyDataWriter()
        writer.SetInputData(pyvista.PolyData.from_regular_faces(surface.verts, surface.faces.astype(int)))
        writer.SetDataModeToBinary()
        writer.WriteToOutputStringOn()  # into memory: VTK ends the process if the disk is full
        writer.Write()
        temporary.write_text(writer.GetOutputString(), encoding="ascii")
