"""Read and write a file with a surface, a per-vertex map, regions or a mask, whatever its format.

``FORMATS`` has the formats of each content; the first bytes of a file choose one, or else its name. ``freesurfer``,
``gifti`` and ``mesh_files`` turn bytes into arrays and back. All other rooms call the functions here (``read_surface``,
``write_morph``, ...), which give checked arrays, or raise an error that names the file.
"""

import gzip
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from morphofold.errors import Mismatch, OutOfRange, WrongFile, WrongShape
from morphofold.frozen_arrays import Bools
from morphofold.io import cifti, freesurfer, gifti, mesh_files
from morphofold.io.files import StrPath, beginning, decoding, existing_file, warn_of_no_end
from morphofold.number_texts import listed
from morphofold.surface import PerVertex, Regions, Surface, Verts
from morphofold.validators import finite, same_length


@dataclass(frozen=True)
class Format:
    """A file format of surfaces, maps, regions or masks.

    Attributes
    ----------
    name : str
        Its name in messages.
    read : callable
        ``read(raw, path)`` of the bytes of the file, which is small enough and not compressed. Any exception means
        damage, ``WrongFile`` another content. Of a surface it gives vertices, faces and the volume geometry, or None.
    write : callable, optional
        ``write(path, content)`` writes completely or not at all.
    names : regular expression
        Is found in the names of its files. They decide if the first bytes do not identify a format.
    begins : regular expression
        Matches the start of its files, within their first 1024 bytes.
    finish : callable, optional
        ``finish(content, path)``: what is made of the content, with warnings.
    """

    name: str
    read: Callable[..., Any]
    write: Callable[..., None] | None = None
    names: str = "(?!)"  # none
    begins: bytes = b"(?!)"
    finish: Callable[[Any, Path], Any] | None = None


def _of_trimesh(ending: str, begins: bytes = Format.begins, **fields: Any) -> Format:
    read, write = partial(mesh_files.read_trimesh, ending), partial(mesh_files.write_trimesh, ending)
    return Format(ending.upper(), read, write, rf"(?i)\.{ending}$", begins, **fields)


_GIFTI = r"(?i)\.gii(\.gz)?$", rb"(?s:.*?)<GIFTI"
_VTK = r"(?i)\.vt[kpu]$", rb"# vtk|[^#]*<VTKFile "
_MGH = r"(?i)\.(mgh|mgz|mgh\.gz)$", rb"\0\0\0\x01"
_FREESURFER = r"^[lr]h\.|^[^.]+$|(?i:\.(white|pial|inflated|sphere|orig|smoothwm|mid)$)", rb"\xff\xff[\xfd-\xff]"
_CIFTI = r"(?i)\.d(scalar|label)\.nii$"
_ASCII = rb"#!ascii[^\n]*\n(?:#[^\n]*\n)*\s*\d+[ \t]+\d+[ \t\r]*\n"
#: by content, in the order in which they are tried; FreeSurfer's names are the least specific
FORMATS = {
    "surface": (
        _of_trimesh("ply", rb"ply\r?\n"),
        _of_trimesh("glb", rb"glTF"),
        _of_trimesh("off", rb"\s*(#[^\n]*\n\s*)*OFF\s"),
        _of_trimesh("stl", rb"\s*solid\b", finish=mesh_files.merge_corners),  # a binary file has no mark
        _of_trimesh("obj"),
        Format("VTK (.vtk, .vtp, .vtu)", mesh_files.read_vtk, mesh_files.write_vtk, *_VTK),
        Format("FreeSurfer's text (.asc, .srf)", mesh_files.read_ascii, begins=_ASCII),
        Format("MNI OBJ", mesh_files.read_mni, begins=rb"P(?:\s+[-+.\deE]+){5}\s+\d+\s"),
        Format("GIFTI (.gii)", gifti.read_surface, gifti.write_surface, *_GIFTI),
        Format("FreeSurfer", freesurfer.read_surface, freesurfer.write_surface, *_FREESURFER),
    ),
    "map": (
        Format("CIFTI", cifti.read_map, names=_CIFTI),
        Format("GIFTI", gifti.read_map, gifti.write_map, *_GIFTI),
        Format("MGH", freesurfer.read_mgh, freesurfer.write_mgh, *_MGH),
        Format("text", mesh_files.read_text_map, begins=rb"(?i)\s*[-+]?(?:\d|\.\d|nan)[\t\n\r -~]*\Z"),
        Format("FreeSurfer", freesurfer.read_curv, freesurfer.write_curv, names=""),
    ),
    "annotation": (
        Format("CIFTI", cifti.read_regions, names=_CIFTI),
        Format("GIFTI", gifti.read_regions, gifti.write_regions, *_GIFTI),
        Format("FreeSurfer", freesurfer.read_regions, freesurfer.write_regions, names=""),
    ),
    "label": (
        Format("CIFTI", cifti.read_mask, names=_CIFTI),
        Format("GIFTI", gifti.read_mask, gifti.write_mask, *_GIFTI),
        Format("FreeSurfer", freesurfer.read_label, freesurfer.write_mask, names=""),
    ),
}


def format_of(raw: bytes, name: str, content_kind: str = "surface") -> Format | None:
    """The format of the bytes of a file by the first ones; by its name only if they do not identify one."""
    by_head = (file_format for file_format in FORMATS[content_kind] if re.match(file_format.begins, raw[:1024]))
    by_name = (file_format for file_format in FORMATS[content_kind] if re.search(file_format.names, name))
    return next(by_head, None) or next(by_name, None)


def _read(path: StrPath, content_kind: str, hemi: str | None = None) -> tuple[Path, Any]:
    """The path and the content of a file, of CIFTI that of a hemisphere; any damage raises ``DamagedFile``."""
    path = existing_file(path, content_kind)
    with decoding(path, f"a {content_kind}"):
        raw = path.read_bytes()
        is_compressed = raw.startswith(b"\x1f\x8b")
        raw = gzip.decompress(raw) if is_compressed else raw
    file_format = format_of(raw, path.name, content_kind)
    if file_format is None:
        raise WrongFile(
            f"{path}: is not a {content_kind} that morphofold can read ({beginning(raw)}). It reads "
            f"{listed([f.name for f in FORMATS[content_kind]])}. Convert it to GIFTI: mris_convert, AimsFileConvert."
        )
    with decoding(path, f"a {content_kind} in the format {file_format.name}"), TemporaryDirectory() as folder:
        plain_path = Path(folder, path.name.removesuffix(".gz")) if is_compressed else path
        if is_compressed:  # some readers open the file
            plain_path.write_bytes(raw)
        parsed = file_format.read(raw, plain_path, *([hemi] if file_format.name == "CIFTI" else []))
    warn_of_no_end(path, raw)
    return path, parsed if file_format.finish is None else file_format.finish(parsed, path)


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
    path, (verts, faces, geometry) = _read(path, "surface")
    surface = Surface(verts, faces, f"{path}", geometry)  # errors say the whole path
    return replace(surface, name=path.name)


def _write(path: StrPath, content_kind: str, *content: Any, **options: Any) -> None:
    """Write a file in the format that its name gives; raises ``WrongFile`` if there is none."""
    path = Path(path)
    for file_format in FORMATS[content_kind]:
        if file_format.write and re.search(file_format.names, path.name):
            return file_format.write(path, *content, **options)
    raise WrongFile(
        f"{path}: no format has the ending {path.suffix.lower()!r}. "
        f"The known formats are {listed([file_format.name for file_format in FORMATS[content_kind]])}."
    )


def write_surface(path: StrPath, surface: Surface, *, scanner: bool = False) -> None:
    """Write a surface completely or not at all; the ending of ``path`` gives the format.

    Parameters
    ----------
    path : str or path
        A name like ``lh.white``, or any name without ending: FreeSurfer, with the footer of
        ``surface.geometry``. ``.gii``, ``.gii.gz``: GIFTI. ``.ply .stl .obj .off .glb .vtp .vtk .vtu``: that format.
    surface : Surface
    scanner : bool
        Whether to mark a GIFTI surface, which has no footer then, as in the scanner's frame.

    Raises
    ------
    WrongFile
        The ending is none of these, or not GIFTI's for the scanner's frame.

    Notes
    -----
    FreeSurfer, GIFTI, PLY, STL, GLB and VTP hold float32, so coordinates are rounded to it (6e-8 relative).
    """
    if scanner and not re.search(_GIFTI[0], f"{path}"):
        raise WrongFile(f"{path}: only GIFTI says that a surface is in the scanner's frame. End its name in .gii.")
    _write(path, "surface", surface, **({"scanner": True} if scanner else {}))


def read_morph(path: StrPath, hemi: str = "lh") -> PerVertex:
    """Values (N,) float64 of a per-vertex map, as in the file: FreeSurfer ("curv", MGH, MGZ), GIFTI, a text, or one
    hemisphere of CIFTI (``.dscalar.nii``), NaN where it has none.

    A text has one number a line, or what ``mris_convert -c`` writes: vertex, x, y, z and value.

    FreeSurfer's sign stays: ``?h.curv`` and ``?h.sulc`` are positive in sulci; ``flip_curvature_sign`` reverses it.
    NaN stays; all functions that take a map treat it as an unknown value.

    Raises
    ------
    ValueError
        If the file is damaged or of another kind, or a value is infinite.
    """
    values = np.asarray(_read(path, "map", hemi)[1], np.float64)
    _refuse_infinite(path, values)
    return values


def write_morph(
    path: StrPath, values: ArrayLike, *, name: str = "", hemi: str | None = None, nan: float | None = None
) -> None:
    """Write a per-vertex map (N,) in float32; the ending of ``path`` gives the format.

    Parameters
    ----------
    path : str or path
        ``.gii``, ``.gii.gz``: GIFTI. ``.mgh``: MGH. Any other name: FreeSurfer's "curv".
    name : str
        In GIFTI the name that viewers show; by default that of the file.
    hemi : {"lh", "rh"}, optional
        For GIFTI; by default taken from the file name.
    nan : float, optional
        Value to write in place of NaN (``float("nan")`` keeps it). Without it NaN is refused: other tools
        average over it or stop at it.

    Raises
    ------
    ValueError
        NaN without ``nan``, infinite values, or another shape than (N,).
    """
    values = np.asarray(values, np.float64)
    if values.ndim != 1 or len(values) == 0:
        raise WrongShape(f"{path}: a map has one value per vertex, shape (N,); got {values.shape}.")
    _refuse_infinite(path, values)
    if nan is None:
        finite(values, f"{path}", "Choose the value to write there, e.g. nan=0.0.")
    else:
        values = np.where(np.isnan(values), nan, values)
    _write(path, "map", values.astype(np.float32), name=name, hemi=hemi)


def write_gifti_map(path: StrPath, values: ArrayLike, **options: Any) -> None:
    """As :func:`write_morph`, with its options, for a name that ends in .gii or .gii.gz."""
    if not re.search(_GIFTI[0], f"{path}"):
        raise WrongFile(f"{path}: the name of a GIFTI file must end in .gii or .gii.gz.")
    write_morph(path, values, **options)


def read_annotation(path: StrPath, hemi: str = "lh") -> Regions:
    """Region labels of a FreeSurfer annotation (``?h.aparc.annot``), a GIFTI label file, or one hemisphere of CIFTI
    (``.dlabel.nii``), named after the file.

    A vertex whose value is not in the colour table of an annotation, or whose key is 0 in the others, has label -1.
    Names are kept as in the file and in the order of the table, including ``"unknown"`` and ``"corpuscallosum"``. An
    annotation cannot distinguish regions of the same colour; the first is kept.
    """
    regions: Regions = _read(path, "annotation", hemi)[1]
    return regions


def write_annotation(path: StrPath, regions: Regions) -> None:
    """Write regions as a FreeSurfer annotation, or as a GIFTI label file if ``path`` ends in .gii.

    Colours of an annotation must differ: the format distinguishes regions only by colour.
    """
    labels, n_regions = regions.labels, len(regions.names)
    if labels.min(initial=0) < -1 or labels.max(initial=-1) >= n_regions:
        raise OutOfRange(f"{path}: labels are {labels.min()}..{labels.max()}, allowed -1..{n_regions - 1}.")
    _write(path, "annotation", regions)


def read_label(path: StrPath, n: int, hemi: str = "lh") -> Bools:
    """Mask (n,) that is True at the vertices of a FreeSurfer label (``?h.cortex.label``) on n vertices, or where a map
    of a GIFTI file, or of a hemisphere of CIFTI, is positive."""
    path, label_values = _read(path, "label", hemi)
    if label_values.dtype == bool:
        same_length(label_values, n, f"{path}:", error=Mismatch)
        return np.asarray(label_values)
    if label_values.size and (label_values.min() < 0 or label_values.max() >= n):
        raise Mismatch(
            f"{path}: names vertices {label_values.min()} to {label_values.max()}, but the surface has 0 to "
            f"{n - 1}. It belongs to another surface."
        )
    mask = np.zeros(n, bool)
    mask[label_values] = True
    return mask


def write_label(path: StrPath, mask: Bools, verts: Verts) -> None:
    """Write a FreeSurfer label of the vertices where ``mask`` (N,) is True, with their positions ``verts`` (N, 3); or a
    GIFTI label file if ``path`` ends in .gii."""
    _write(path, "label", mask, verts)


def _refuse_infinite(path: StrPath, values: PerVertex) -> None:
    with np.errstate(over="ignore"):  # what is beyond float32 becomes infinite
        finite(values.astype(np.float32), f"{path}", "Repair the file, or leave it out.", nan=True)
