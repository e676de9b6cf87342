"""PLY, STL, OBJ, OFF and GLB, through trimesh."""

from __future__ import annotations

import re
import warnings
from io import BytesIO
from pathlib import Path

import numpy as np

from morphofold.errors import DamagedFile
from morphofold.io.files import SurfaceContent, atomic_file, silent_log
from morphofold.surface import Faces, Surface, Verts

#: the numbers of vertices and faces in a header
_COUNTS = {
    "ply": re.compile(rb"element[ \t]+vertex[ \t]+(\d+)(?:.*?element[ \t]+face[ \t]+(\d+))?", re.DOTALL),
    "off": re.compile(rb"OFF\s+(?:#[^\n]*\n\s*)*(\d+)\s+(\d+)"),
}


def read(kind: str, raw: bytes, path: Path) -> SurfaceContent:
    """Vertices and faces of a file; ``kind`` is the ending without its dot.

    trimesh cuts polygons with more corners into triangles, and reads as many faces as there are. Vertices keep the
    order of the file.

    STL has no shared vertices: see :func:`merge_corners`. OBJ does not give its length, so a missing end is not
    detected. Materials, textures and files named inside are not read.
    """
    import trimesh

    size = 84 + 50 * int.from_bytes(raw[80:84], "little")  # of a binary STL; trimesh reads half of one as an empty text
    if kind == "stl" and len(raw) != size and b"endsolid" not in raw[-1024:]:
        raise DamagedFile(f"its header gives {size} bytes, but it has {len(raw)}, and it has no endsolid")
    # from memory and without a resolver: files that this file may name are not opened
    options = {"process": False, "maintain_order": True, "skip_materials": True}
    with silent_log():  # messages about normals, which are not used
        mesh = trimesh.load_mesh(BytesIO(raw), file_type=kind, **options)
    verts, faces = np.array(mesh.vertices, dtype=np.float64), np.array(mesh.faces, dtype=np.int64)
    if len(faces) == 0:
        raise DamagedFile("it holds no triangles")
    counts = _COUNTS[kind].search(raw[:4096]) if kind in _COUNTS else None
    n, m = (int(count or 0) for count in counts.groups()) if counts else (0, 0)
    if len(verts) < n or len(faces) < m:
        raise DamagedFile(f"its header gives {n} vertices and {m} faces, but it has {len(verts)} and {len(faces)}")
    return verts, faces, None


def merge_corners(content: SurfaceContent, path: Path) -> SurfaceContent:
    """Merge corners at exactly the same place, in order of first appearance; a warning gives the numbers."""
    verts, faces = merge_equal(content[0], content[1])
    warnings.warn(
        f"{path}: STL has no shared vertices; {len(content[0])} corners at exactly the same place were merged to "
        f"{len(verts)} vertices.",
        stacklevel=4,
    )
    return verts, faces, None


def merge_equal(verts: Verts, faces: Faces) -> tuple[Verts, Faces]:
    """Merge vertices at exactly the same place, in order of first appearance."""
    _, first, inverse = np.unique(verts, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return verts[first[order]], rank[inverse.reshape(-1)][faces]


def write(kind: str, path: Path, surface: Surface) -> None:
    """Write a surface; PLY, STL and GLB hold float32, OBJ and OFF get 22 decimals."""
    import trimesh

    with atomic_file(path) as temporary:
        mesh = trimesh.Trimesh(surface.verts, surface.faces, process=False)
        mesh.export(temporary, file_type=kind, **({"digits": 22} if kind in ("obj", "off") else {}))
