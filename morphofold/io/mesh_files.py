"""Surface formats that are neither binary FreeSurfer nor GIFTI, bytes to arrays and back, for ``formats``.

PLY, STL, OBJ, OFF and GLB go through trimesh, VTK's formats through VTK and meshio. FreeSurfer's text (.asc, .srf), MNI
OBJ and maps as plain text, one value per line, are read here.
"""

import io
import logging
import re
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np

from morphofold.errors import DamagedFile, WrongFile
from morphofold.io.files import SurfaceContent, atomic_file, write_and_read
from morphofold.surface import PerVertex, Surface

#: the numbers of vertices and faces in a header
_HEADER_COUNTS = {
    "ply": re.compile(rb"element[ \t]+vertex[ \t]+(\d+)(?:.*?element[ \t]+face[ \t]+(\d+))?", re.DOTALL),
    "off": re.compile(rb"OFF\s+(?:#[^\n]*\n\s*)*(\d+)\s+(\d+)"),
}
_TRIANGLE, _LEFT_OUT = 5, {1, 2, 3, 4, 10}  # VTK's numbers: points, lines and tetrahedra are not part of a surface


# PLY, STL, OBJ, OFF and GLB ----------------------------------------------------------------------------------


def read_trimesh(ending: str, raw: bytes, path: Path) -> SurfaceContent:
    """Vertices and faces of a file; ``ending`` is the ending without its dot.

    trimesh cuts polygons with more corners into triangles, and reads as many faces as there are. Vertices keep the
    order of the file.

    STL has no shared vertices: see :func:`merge_corners`. OBJ does not give its length, so a missing end is not
    detected. Materials, textures and files named inside are not read.
    """
    import trimesh

    stl_bytes = 84 + 50 * int.from_bytes(raw[80:84], "little")  # trimesh reads half a binary STL as an empty text
    if ending == "stl" and len(raw) != stl_bytes and b"endsolid" not in raw[-1024:]:
        raise DamagedFile(f"its header gives {stl_bytes} bytes, but it has {len(raw)}, and it has no endsolid")
    # from memory and without a resolver: files that this file may name are not opened
    disabled_level = logging.root.manager.disable
    logging.disable(logging.CRITICAL)  # messages about normals, which are not used
    try:
        raw_stream = io.BytesIO(raw)
        mesh = trimesh.load_mesh(raw_stream, file_type=ending, process=False, maintain_order=True, skip_materials=True)
    finally:
        logging.disable(disabled_level)
    verts, faces = mesh.vertices, mesh.faces
    if len(faces) == 0:
        raise DamagedFile("it holds no triangles")
    header_counts = _HEADER_COUNTS[ending].search(raw[:4096]) if ending in _HEADER_COUNTS else None
    n, m = (int(count or 0) for count in header_counts.groups()) if header_counts else (0, 0)
    if len(verts) < n or len(faces) < m:
        raise DamagedFile(f"its header gives {n} vertices and {m} faces, but it has {len(verts)} and {len(faces)}")
    return verts, faces, None


def merge_corners(content: SurfaceContent, path: Path) -> SurfaceContent:
    """Merge corners at exactly the same place, in order of first appearance; a warning gives the numbers."""
    corners, faces, _ = content
    _, first_corners, point_of_corner = np.unique(corners, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first_corners)
    rank = np.argsort(order)  # the inverse permutation
    warnings.warn(
        f"{path}: STL has no shared vertices; {len(corners)} corners at exactly the same place were merged to "
        f"{len(order)} vertices.",
        stacklevel=4,
    )
    return corners[first_corners[order]], rank[point_of_corner.reshape(-1)][faces], None


def write_trimesh(ending: str, path: Path, surface: Surface) -> None:
    """Write a surface; PLY, STL and GLB hold float32, OBJ and OFF get 22 decimals."""
    import trimesh

    with atomic_file(path) as temporary:
        digits = {"digits": 22} if ending in ("obj", "off") else {}
        trimesh.Trimesh(surface.verts, surface.faces, process=False).export(temporary, file_type=ending, **digits)


# VTP, VTU and legacy files of VTK, which ends the process on damaged ones, so another process reads them -----


def read_vtk(raw: bytes, path: Path) -> SurfaceContent:
    """Vertices and triangles of VTK polygons, or of an unstructured grid without its lines, points and tetrahedra.

    Raises ``WrongFile`` if the file has faces other than triangles, or no triangles.
    """
    script = Path(__file__).with_name("vtk_process.py")
    process = subprocess.run([sys.executable, "-P", script, path], capture_output=True, check=False)
    if process.returncode or b"rror" in process.stderr:
        raise DamagedFile(process.stderr.decode("utf-8", "replace").strip().rpartition("\n")[2] or "VTK stops")
    points, corners, cell_starts, cell_types = np.load(io.BytesIO(process.stdout)).values()
    if not {*cell_types.tolist()} <= {_TRIANGLE, *_LEFT_OUT}:
        raise WrongFile("it holds faces that are not triangles; triangulate it first")
    cell_starts = cell_starts[:-1][cell_types == _TRIANGLE]
    if not len(cell_starts):
        raise WrongFile("it holds no triangles; extract its surface first")
    return points, corners[cell_starts[:, None] + np.arange(3)], None


def write_vtk(path: Path, surface: Surface) -> None:
    """Write a surface as VTK or VTU, or as VTP in float32, by the ending of the path."""
    from morphofold.io.meshio_files import Mesh, write_mesh

    if path.suffix.lower() != ".vtp":
        return write_and_read(path, read_vtk, write_mesh, Mesh(surface.verts, [("triangle", surface.faces)]))
    import pyvista
    from vtkmodules.vtkIOXML import vtkXMLPolyDataWriter

    with atomic_file(path) as temporary:
        writer = vtkXMLPolyDataWriter()
        writer.SetInputData(pyvista.PolyData.from_regular_faces(surface.verts, surface.faces.astype(int)))
        writer.SetDataModeToBinary()
        writer.WriteToOutputStringOn()  # into memory: VTK ends the process if the disk is full
        writer.Write()
        temporary.write_text(writer.GetOutputString(), encoding="ascii")


# texts of FreeSurfer and AFNI, and the MNI objects of CIVET ---------------------------------------------------


def read_ascii(raw: bytes, path: Path) -> SurfaceContent:
    """Vertices and faces of FreeSurfer's text format: a comment, two counts, and rows of three numbers and a flag."""
    n_verts, n_faces, *numbers = re.sub(rb"#[^\n]*", b"", raw).split()
    if len(numbers) != 4 * (int(n_verts) + int(n_faces)):
        raise DamagedFile(f"{int(n_verts)} vertices and {int(n_faces)} faces do not have {len(numbers)} numbers")
    rows = np.array(numbers).reshape(-1, 4)[:, :3]
    return rows[: int(n_verts)].astype(np.float64), rows[int(n_verts) :].astype(np.int64), None


def read_mni(raw: bytes, path: Path) -> SurfaceContent:
    """Vertices and triangles of an MNI object of polygons, as text."""
    words = raw.split()
    n_verts = int(words[6])
    start = 7 + 6 * n_verts  # after positions and normals
    n_tri, colour_mode = int(words[start]), int(words[start + 1])
    start += 2 + 4 * {0: 1, 1: n_tri, 2: n_verts}[colour_mode]
    face_ends, corners = (np.array(part, np.int64) for part in (words[start : start + n_tri], words[start + n_tri :]))
    if not np.array_equal(face_ends, 3 * np.arange(1, n_tri + 1)):
        raise WrongFile("it is cut, or holds faces that are not triangles; triangulate it first")
    return np.array(words[7 : 7 + 3 * n_verts], np.float64).reshape(n_verts, 3), corners.reshape(n_tri, 3), None


def read_text_map(raw: bytes, path: Path) -> PerVertex:
    """Values (N,) of a text with one number a line, or with vertex, position and value a line as of mris_convert."""
    table = np.loadtxt(raw.decode("ascii").splitlines(), ndmin=2)
    n_columns = table.shape[1]
    if n_columns not in (1, 5) or (n_columns == 5 and not np.array_equal(table[:, 0], np.arange(len(table)))):
        raise WrongFile(f"its lines hold {n_columns} numbers, not one value of each vertex")
    return table[:, -1]
