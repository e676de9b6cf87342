"""PLY, STL, OBJ, OFF and GLB, through trimesh."""

from __future__ import annotations

import re
import warnings
from io import BytesIO
from pathlib import Path

import numpy as np

from morphofold.errors import DamagedFile
from morphofold.io.files import SurfaceContent, atomic_file, check_counts, silent_log
from morphofold.surface import Faces, Surface, Verts

_PLY_COUNTS = re.compile(rb"\n[ \t]*element[ \t]+(vertex|face)[ \t]+(\d+)")
_OFF_COUNTS = re.compile(rb"OFF\s+(?:#[^\n]*\n\s*)*(\d+)\s+(\d+)")


def read(kind: str, raw: bytes, path: Path) -> SurfaceContent:
    """Vertices and faces of a file; ``kind`` is the ending without its dot.

    trimesh cuts polygons with more corners into triangles. Vertices keep the order of the file.

    STL has no shared vertices: see :func:`merge_corners`. OBJ does not give its length, so a missing end is not
    detected. Materials, textures and files named inside are not read.
    """
    import trimesh

    check_counts(raw)
    if kind in _CHECK_OF_KIND:
        _CHECK_OF_KIND[kind](raw)
    # from memory and without a resolver: files that this file may name are not opened
    options = {"process": False, "maintain_order": True, "skip_materials": True}
    with silent_log():  # messages about normals, which are not used
        mesh = trimesh.load_mesh(BytesIO(raw), file_type=kind, **options)
    verts, faces = np.array(mesh.vertices, dtype=np.float64), np.array(mesh.faces, dtype=np.int64)
    if len(faces) == 0:
        raise DamagedFile("it holds no triangles")
    if kind == "ply":
        _check_ply(raw, len(verts), len(faces))
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


def _check_stl(raw: bytes) -> None:
    """Check the size of a binary file, or the end of a text; trimesh reads half a binary file as an empty text."""
    promised = 84 + 50 * int.from_bytes(raw[80:84], "little")
    if len(raw) == promised or (raw.lstrip().startswith(b"solid") and b"endsolid" in raw[-1024:]):
        return
    if raw.lstrip().startswith(b"solid") and b"facet" in raw[:1024]:
        raise DamagedFile("it has no endsolid, so its end is missing")
    raise DamagedFile(f"its header gives {promised} bytes, but it has {len(raw)}")


def _check_off(raw: bytes) -> None:
    """Check the number of values: trimesh reads as many faces as there are; a triangle needs four numbers."""
    match = _OFF_COUNTS.search(raw[:4096])
    n, m = (int(match[1]), int(match[2])) if match else (0, 0)
    numbers = len(raw[match.end() :].split()) if match else 0
    if numbers < 3 * n + 4 * m:
        raise DamagedFile(f"{n} vertices and {m} faces need at least {3 * n + 4 * m} numbers, but it has {numbers}")


def _check_ply(raw: bytes, n: int, m: int) -> None:
    """Check the counts: trimesh reads as many faces of a text as there are; a polygon gives at least one triangle."""
    promised = {name.decode(): int(count) for name, count in _PLY_COUNTS.findall(raw)}
    if n < promised.get("vertex", 0) or m < promised.get("face", 0):
        raise DamagedFile(f"its header gives {promised}, but it has {n} vertices and {m} triangles")


_CHECK_OF_KIND = {"stl": _check_stl, "off": _check_off}


def write(kind: str, path: Path, surface: Surface) -> None:
    """Write a surface; PLY, STL and GLB hold float32, OBJ and OFF get 22 decimals."""
    import trimesh

    with atomic_file(path) as temporary:
        mesh = trimesh.Trimesh(surface.verts, surface.faces, process=False)
        mesh.export(temporary, file_type=kind, **({"digits": 22} if kind in ("obj", "off") else {}))
