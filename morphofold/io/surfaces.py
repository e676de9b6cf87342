"""Read and write one surface or one per-vertex map in any supported format."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from morphofold.errors import NotFinite, WrongFile, WrongShape
from morphofold.io import freesurfer, gifti, text_files
from morphofold.io.files import StrPath, beginning, existing_file, looks_like_text
from morphofold.io.formats import Format, SurfaceContent
from morphofold.surface import PerVertex, Surface, check_mesh
from morphofold.words import listed

#: modules with ``FORMATS``, in the order in which they are tried; FreeSurfer names are the least specific
FORMAT_MODULES = ("trimesh_files", "vtk_files", "text_files", "gifti", "freesurfer")
FORMATS: tuple[Format, ...] = tuple(
    one for name in FORMAT_MODULES for one in import_module(f"morphofold.io.{name}").FORMATS
)
_GZIP_MAGIC = b"\x1f\x8b"


def read_surface(path: StrPath) -> Surface:
    """Read a triangle surface.

    Parameters
    ----------
    path : str or path
        FreeSurfer (any name, binary or text), GIFTI, PLY, STL, OBJ of Wavefront or MNI, OFF, GLB, VTK, VTP or VTU. The
        first bytes of the file decide; its ending only if they do not identify a format (Wavefront's OBJ, binary STL).

    Returns
    -------
    Surface
        Vertices in the unit (FreeSurfer and GIFTI: mm) and order of the file, named after the file; with the
        volume-geometry footer of a FreeSurfer file. Only STL has no shared vertices: corners at exactly the same place
        are merged, with a warning.

    Raises
    ------
    FileNotFoundError
        The file does not exist; the message lists similar names.
    ValueError
        The file is not a surface, truncated, damaged, larger than 2 GiB, or not made of triangles.
    """
    path = existing_file(path, "surface")
    verts, faces, geometry = _read_by_format(path)
    try:
        return Surface(verts, faces, name=path.name, geometry=geometry)
    except (ValueError, TypeError):
        check_mesh(np.asarray(verts), np.asarray(faces), str(path))  # the same error, with the whole path
        raise


def _read_by_format(path: Path) -> SurfaceContent:
    with path.open("rb") as file:
        head = file.read(1024)
    found = _format_of_file(path, head)
    if found is not None:
        return found.read(path)
    if head.startswith(_GZIP_MAGIC):
        raise WrongFile(
            f"{path}: is compressed; only .gii.gz can be read compressed. Decompress it first, with gunzip."
        )
    raise WrongFile(
        f"{path}: is not a surface that morphofold can read ({beginning(head)}). It reads {_known_formats_text()}."
    )


def _format_of_file(path: Path, head: bytes) -> Format | None:
    """The format by the first bytes; by the ending only if they do not identify one."""
    by_head = (one for one in FORMATS if one.starts(head))
    by_name = (one for one in FORMATS if one.endings and one.named(path.name))
    return next(by_head, None) or next(by_name, None)


def is_surface(path: Path) -> bool:
    """Whether a file has the first bytes, or the name, of a surface format."""
    with path.open("rb") as file:
        return _format_of_file(path, file.read(1024)) is not None


def _known_formats_text() -> str:
    return listed([one.name for one in FORMATS])


def is_gifti(path: Path, head: bytes) -> bool:
    """Whether a file is GIFTI, by its first bytes or its name."""
    return any(one.starts(head) or one.named(path.name) for one in gifti.FORMATS)


def write_surface(path: StrPath, surface: Surface) -> None:
    """Write a surface completely or not at all; the ending of ``path`` gives the format.

    Parameters
    ----------
    path : str or path
        A name like ``lh.white``, or any name without ending: FreeSurfer, with the footer of
        ``surface.geometry``. ``.gii``, ``.gii.gz``: GIFTI. ``.ply .stl .obj .off .glb .vtp .vtk .vtu``: that format.
    surface : Surface

    Raises
    ------
    WrongFile
        The ending is none of these.

    Notes
    -----
    FreeSurfer, GIFTI, PLY, STL, GLB and VTP hold float32, so coordinates are rounded to it (6e-8 relative).
    """
    path = Path(path)
    write = next((one.write for one in FORMATS if one.write and one.named(path.name)), None)
    if write is None:
        raise WrongFile(
            f"{path}: no format has the ending {path.suffix.lower()!r}. The known formats are {_known_formats_text()}."
        )
    write(path, surface)


def read_morph(path: StrPath) -> PerVertex:
    """Values (N,) float64 of a per-vertex map, as in the file: FreeSurfer ("curv", MGH, MGZ), GIFTI, or a text.

    A text has one number a line, or what ``mris_convert -c`` writes: vertex, x, y, z and value.

    FreeSurfer's sign stays: ``?h.curv`` and ``?h.sulc`` are positive in sulci; ``flip_curvature_sign`` reverses it.
    NaN stays; all functions that take a map treat it as an unknown value.

    Raises
    ------
    ValueError
        If the file is damaged or of another kind, or a value is infinite.
    """
    path = existing_file(path, "per-vertex map")
    with path.open("rb") as file:
        head = file.read(1024)
    if is_gifti(path, head):
        values = gifti.read_gifti_map(path)
    elif freesurfer.is_mgh(path, head):
        values = freesurfer.read_mgh(path)
    elif looks_like_text(head) and text_files.NUMBER_FIRST.match(head):
        values = text_files.read_map(path)
    else:
        values = freesurfer.read_curv(path)
    _refuse_infinite(path, values)
    return values


def write_morph(path: StrPath, values: ArrayLike, *, nan: float | None = None) -> None:
    """Write a per-vertex map (N,) for FreeSurfer (float32): as MGH if ``path`` ends in .mgh, else as "curv".

    Parameters
    ----------
    nan : float, optional
        Value to write in place of NaN (``float("nan")`` keeps it). Without it NaN is refused: other tools
        average over it or stop at it.

    Raises
    ------
    ValueError
        NaN without ``nan``, infinite values, or another shape than (N,).
    """
    write = freesurfer.write_mgh if Path(path).suffix.lower() == ".mgh" else freesurfer.write_curv
    write(path, _checked_map(path, values, nan))


def write_gifti_map(
    path: StrPath, values: ArrayLike, *, name: str = "", hemi: str | None = None, nan: float | None = None
) -> None:
    """Write a per-vertex map (N,) as GIFTI (float32); ``nan`` as in ``write_morph``.

    ``name`` is the name that viewers show, by default that of the file. ``hemi`` is by default taken from the file
    name.
    """
    name = name or Path(path).name.split(".gii")[0]
    gifti.write_gifti_map_file(path, _checked_map(path, values, nan), name, hemi)


def _checked_map(path: StrPath, values: ArrayLike, nan: float | None) -> NDArray[np.float32]:
    values = np.asarray(values, dtype=np.float64)
    if values.ndim != 1 or len(values) == 0:
        raise WrongShape(f"{path}: a map has one value per vertex, shape (N,); got {values.shape}.")
    _refuse_infinite(path, values)
    missing = np.isnan(values)
    if missing.any():
        if nan is None:
            raise NotFinite(
                f"{path}: {missing.sum()} of {len(values)} values are NaN; the first is at vertex "
                f"{np.flatnonzero(missing)[0]}. Choose the value to write there, e.g. nan=0.0."
            )
        values = np.where(missing, nan, values)
    return values.astype(np.float32)


def _refuse_infinite(path: StrPath, values: PerVertex) -> None:
    with np.errstate(over="ignore"):
        infinite = np.flatnonzero(np.isinf(values.astype(np.float32)))
    if len(infinite):
        raise NotFinite(
            f"{path}: {len(infinite)} of {len(values)} values are infinite or beyond float32, the first at vertex "
            f"{infinite[0]}. Repair the file, or leave it out."
        )
