"""FreeSurfer's formats: bytes of surfaces, per-vertex maps, annotations and labels to arrays and back, for ``formats``.

Also its conventions: the sign of curvature, and the frame of a surface in the scanner. Surfaces are read, and most
files written, through nibabel. Maps are read here, because nibabel takes a truncated map for a shorter one; so are
footers, because nibabel loses those of quadrangles.
"""

import io
import re
import struct
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from morphofold.digests_and_json import Row, clean_name
from morphofold.errors import DamagedFile, NamedTwice, OutOfRange, WrongFile, WrongShape
from morphofold.frozen_arrays import Array, Bools, Ints
from morphofold.io.files import SurfaceContent, beginning, name_in_file, write_and_read, write_text
from morphofold.io.json_files import LARGEST_NUMBER
from morphofold.surface import PerVertex, Regions, Surface, Verts

TRIANGLE_MAGIC, QUAD_MAGIC = b"\xff\xff\xfe", b"\xff\xff\xff"
_CREATED_BY = "created by morphofold"  # nibabel's default writes the name of the user and the date
_FOOTER_KEYS = ("valid", "filename", "volume", "voxelsize", "xras", "yras", "zras", "cras")
_FOOTER_HEAD = b"\0\0\0\2\0\0\0\0\0\0\0\x14"  # an older one has only the last number
_FOOTER = re.compile(rb"((?:\0\0\0\x02\0{4})?\0\0\0\x14)" + b"".join(b"%s *=(.*)\n" % k.encode() for k in _FOOTER_KEYS))
_MGH_TYPES, _MGH_HEAD = {0: ">u1", 1: ">i4", 3: ">f4", 4: ">i2"}, 284  # by their number; bytes before the values


# surfaces -------------------------------------------------------------------------------------------------


def read_surface(raw: bytes, path: Path) -> SurfaceContent:
    """Vertices (N, 3) [mm], faces (M, 3) and the volume-geometry footer of a FreeSurfer surface.

    Old quadrangle surfaces are returned as triangles: a quadrangle is cut as by nibabel, and one with two equal corners
    is one triangle. The footer is None if the file has none.
    """
    import nibabel.freesurfer as fs

    if _is_map(raw):
        raise WrongFile("it holds one value for each vertex, not a surface; name a surface such as lh.white")
    verts, faces = fs.read_geometry(path)
    if raw.startswith(TRIANGLE_MAGIC):  # after "created by ...", an empty line, two counts and the arrays
        footer_start = raw.index(b"\n", raw.index(b"\n") + 1) + 9 + 4 * (verts.size + faces.size)
    else:
        footer_start = 9 + (2 if raw.startswith(QUAD_MAGIC) else 4) * verts.size + 2 * faces.size
        faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
    return verts, faces, _footer(raw[footer_start:])


def _footer(footer_bytes: bytes) -> Row | None:
    """The volume geometry in the bytes after the faces, with the keys of nibabel; None if there is none."""
    match = _FOOTER.match(footer_bytes)
    if match is None:
        if footer_bytes and (_FOOTER_HEAD.startswith(footer_bytes[:12]) or footer_bytes.startswith(_FOOTER_HEAD[8:])):
            raise DamagedFile("it is truncated inside its volume-geometry footer")
        return None
    valid, filename, *row_texts = (text.decode("utf-8", "replace").strip() for text in match.groups()[1:])
    rows = {key: np.array(text.split(), np.float64) for key, text in zip(_FOOTER_KEYS[2:], row_texts)}
    if valid.startswith("1") and not all(row.shape == (3,) and np.isfinite(row).all() for row in rows.values()):
        raise DamagedFile("its volume-geometry footer does not have three numbers in each row")
    head_numbers = np.frombuffer(match[1], ">i4")
    return {"head": head_numbers, "valid": valid, "filename": filename, **rows, "volume": rows["volume"].astype(int)}


def write_surface(path: Path, surface: Surface) -> None:
    """Write a FreeSurfer triangle surface with its footer; the format holds float32."""
    _write(path, read_surface, "write_geometry", surface.verts, surface.faces, _CREATED_BY, surface.geometry)


def _write(path: Path, read: Callable[[bytes, Path], object], writer_name: str, *content: Any, **options: Any) -> None:
    """Write a file by a function of nibabel, and read it back."""
    import nibabel.freesurfer as fs

    write_and_read(path, read, getattr(fs, writer_name), *content, **options)


def scanner_transform(geometry: Mapping[str, Any] | None) -> Array | None:
    """Affine (4, 4) from surface RAS (the tkr frame, [mm]) to scanner RAS; None if the file does not give it.

    R is the matrix of direction cosines of the volume, ``[xras yras zras]``, and T that of the tkr frame, whose
    axes are -x, -z and y. The rotation is R T^-1 and the shift is ``cras``: both frames have the centre of the volume
    at the same voxel. For a conformed volume R = T, and only the shift remains.
    """
    if not geometry or not str(geometry.get("valid", "")).startswith("1"):
        return None
    xras, yras, zras = (np.asarray(geometry[f"{axis}ras"]) for axis in "xyz")
    affine = np.eye(4)
    affine[:3] = np.column_stack([0.0 - xras, 0.0 + zras, 0.0 - yras, geometry["cras"]])  # without negative zeros
    return affine


# per-vertex maps ------------------------------------------------------------------------------------------


def read_curv(raw: bytes, path: Path) -> PerVertex:
    """Values (N,) of a FreeSurfer "curv" file (thickness, curv, sulc, area, ...), as in the file."""
    if _is_map(raw):
        return np.frombuffer(raw, ">f4", int.from_bytes(raw[3:7], "big"), 15)
    n_vertices = int.from_bytes(raw[:3], "big")  # the oldest layout: 3-byte counts, hundredths as int16
    if len(raw) != 6 + 2 * n_vertices or n_vertices == 0:
        raise WrongFile(f"it is not a FreeSurfer map with one value per vertex ({beginning(raw[:15])})")
    return np.frombuffer(raw, ">i2", n_vertices, 6) / 100


def _is_map(raw: bytes) -> bool:
    """Whether these are the bytes of a "curv" file with one value per vertex."""
    return raw.startswith(QUAD_MAGIC) and raw[11:15] == struct.pack(">i", 1)


def write_curv(path: Path, values: np.ndarray, **_: Any) -> None:
    """Write checked values (N,) as a FreeSurfer "curv" file."""
    _write(path, read_curv, "write_morph_data", values)


def write_mgh(path: Path, values: np.ndarray, **_: Any) -> None:
    """Write checked values (N,) as MGH, a volume of N x 1 x 1 voxels, as FreeSurfer stores surface overlays."""
    from nibabel.freesurfer.mghformat import MGHImage

    if path.name.endswith(".mgh.gz"):
        raise WrongFile(f"{path}: no such file can be written. Name it .mgz.")
    write_and_read(path, read_mgh, MGHImage(values.reshape(-1, 1, 1), np.eye(4)).to_filename)


def read_mgh(raw: bytes, path: Path) -> PerVertex:
    """Values (N,) of an MGH or MGZ file of N values along one of its dimensions."""
    *shape, type_number = struct.unpack_from(">5i", raw, 4)
    if max(shape) != np.prod(shape):
        raise WrongFile(f"it holds {' x '.join(map(str, shape))} values, not one of each vertex")
    return np.frombuffer(raw, _MGH_TYPES[type_number], max(shape), _MGH_HEAD)


def flip_curvature_sign(values: ArrayLike) -> PerVertex:
    """Convert between FreeSurfer's sign of curvature and that of morphofold; only this function flips it.

    FreeSurfer's ``?h.curv`` and ``?h.sulc`` are positive in sulci; outside ``morphofold.io`` convex (a gyral
    crown, a sphere) is positive. NaN stays NaN, and zero stays zero without a sign.
    """
    return 0.0 - np.asarray(values, np.float64)


# regions and labels ---------------------------------------------------------------------------------------


def read_regions(raw: bytes, path: Path) -> Regions:
    """Region labels of a FreeSurfer annotation (``?h.aparc.annot``).

    A vertex whose value is not in the colour table of the file has label -1. Names are kept as in the file and in the
    order of the table, including ``"unknown"`` and ``"corpuscallosum"``. The format cannot distinguish regions of the
    same colour; the first is kept.

    Notes
    -----
    The table is parsed here: ``nibabel.freesurfer.read_annot`` pairs names with the wrong colours when the
    table has gaps, and gives a vertex with an unlisted value to the next region in the table.
    """
    (n_vertices,) = struct.unpack_from(">i", raw)
    vertices, colour_codes = np.frombuffer(raw, ">i4", 2 * n_vertices, 4).astype(np.int64).reshape(n_vertices, 2).T
    if not np.array_equal(np.sort(vertices), np.arange(n_vertices)):
        raise DamagedFile(f"its vertices are not 0..{n_vertices - 1}, each once")
    name_of_colour: dict[tuple[int, ...], str] = {}
    for name, colour in _colour_table(io.BytesIO(raw[4 + 8 * n_vertices :])):
        name_of_colour.setdefault(colour, name)
    index_of_code = {r + 256 * g + 65536 * b: index for index, (r, g, b) in enumerate(name_of_colour)}
    labels = np.array([index_of_code.get(code, -1) for code in colour_codes.tolist()])[np.argsort(vertices)]
    colours = np.array([*name_of_colour], np.uint8).reshape(-1, 3)
    return Regions(labels, tuple(name_of_colour.values()), colours, name=name_in_file(path))


def _colour_table(stream: io.BytesIO) -> list[tuple[str, tuple[int, ...]]]:
    """Name and RGB of each entry, in the order of the file; both layouts of the table."""

    def integers(count: int = 1) -> tuple[int, ...]:
        return struct.unpack(f">{count}i", stream.read(4 * count))

    def text() -> str:
        return clean_name(stream.read(*integers()).split(b"\0")[0].decode("utf-8", "replace"))

    if not stream.read(4).endswith(b"\1"):
        raise DamagedFile("it has no colour table, so its regions have no names")
    (n_entries,) = integers()
    has_slots = n_entries == -2
    if has_slots:
        integers()  # the highest slot
    text()  # origin of the table
    if has_slots:
        (n_entries,) = integers()
    # name and colour belong together in any slot, whose number is passed over
    return [(text(), integers(4)[:3]) for _ in range(n_entries) if not has_slots or integers()]


def write_regions(path: Path, regions: Regions) -> None:
    """Write a FreeSurfer annotation. Colours must differ: the format distinguishes regions only by colour."""
    colours, labels = (np.asarray(array, np.int64) for array in (regions.colours, regions.labels))
    if colours.shape != (len(regions.names), 3):
        raise WrongShape(f"{path}: {len(regions.names)} region names, but colours of shape {colours.shape}.")
    colour_codes = colours @ (1, 256, 65536)
    if len(np.unique(colour_codes)) < len(colour_codes):
        raise NamedTwice(f"{path}: two regions have the same colour, so an annotation cannot distinguish them.")
    if (colour_codes == 0).any() and (labels == -1).any():
        raise OutOfRange(f"{path}: colour (0, 0, 0) means 'no region' in the format; choose another.")
    rgba = np.pad(colours, ((0, 0), (0, 1)))
    _write(path, read_regions, "write_annot", labels, rgba, list(regions.names), fill_ctab=True)


def read_label(raw: bytes, path: Path) -> Ints:
    """Numbers of the vertices of a FreeSurfer label (``?h.cortex.label``)."""
    header = re.match(rb"#.*\n\s*(\d+)\b", raw)
    if header is None:
        raise WrongFile(f"it is not a FreeSurfer label ({beginning(raw)})")
    vertices = np.array([row.split(maxsplit=1)[0] for row in raw[header.end() :].splitlines() if row.strip()], np.int64)
    if len(vertices) != int(header[1]):
        raise DamagedFile(f"its second line gives {int(header[1])} vertices, but the file lists {len(vertices)}")
    return vertices


def write_mask(path: Path, mask: Bools, verts: Verts) -> None:
    """Write a FreeSurfer label of the vertices where ``mask`` (N,) is True, with their positions ``verts`` (N, 3)."""
    vertices = np.flatnonzero(mask)
    lines = [f"#!ascii label cortex, written by morphofold\n{len(vertices)}\n"]
    lines += [f"{vertex}  {x:.3f}  {y:.3f}  {z:.3f} 0.0\n" for vertex, (x, y, z) in zip(vertices, verts[vertices])]
    write_text(path, "".join(lines))


_ASEG_MEASURE = re.compile(r"^# Measure (\w+),[^,\n]*,[^,\n]*, *(\d+(?:\.\d*)?(?:e[-+]?\d+)?) *,", re.MULTILINE)
#: values of aseg.stats that are read, by the first word of their ``# Measure`` line; {hemi}: of that hemisphere
_KEY_OF_ASEG_MEASURE = {
    "EstimatedTotalIntraCranialVol": "etiv_mm3",
    "{hemi}SurfaceHoles": "surface_holes",
    "{hemi}Cortex": "freesurfer_cortex_mm3",
    "{hemi}CerebralWhiteMatter": "freesurfer_white_matter_mm3",
    "{hemi}CorticalWhiteMatter": "freesurfer_white_matter_mm3",  # its name before version 6
    "TotalGray": "freesurfer_total_gray_mm3",
    "SubCortGray": "freesurfer_subcortical_gray_mm3",
    "SupraTentorial": "freesurfer_supratentorial_mm3",
    "BrainSeg": "freesurfer_brain_mm3",
    "BrainSegNotVent": "freesurfer_brain_without_ventricles_mm3",
}


def read_aseg_stats(path: Path, hemi: str) -> dict[str, float | int]:
    """Values from FreeSurfer's ``stats/aseg.stats`` for a brain and one of its hemispheres.

    Returns
    -------
    dict
        ``etiv_mm3``, the estimated intracranial volume [mm^3]; ``surface_holes``, the holes in the surface of ``hemi``
        before FreeSurfer repaired its topology (its Euler characteristic was 2 less twice that number); and volumes
        [mm^3]: ``freesurfer_cortex_mm3`` and ``freesurfer_white_matter_mm3`` of ``hemi``; of the brain
        ``freesurfer_total_gray_mm3``, ``_subcortical_gray_mm3``, ``_supratentorial_mm3``, ``_brain_mm3`` (BrainSeg) and
        ``_brain_without_ventricles_mm3``. A value that the file does not give as a number from 0 to 1e12 is left out.
    """
    key_by_name = {name.format(hemi=hemi): key for name, key in _KEY_OF_ASEG_MEASURE.items()}
    values: dict[str, float | int] = {}
    text = path.read_text("utf-8", errors="replace")
    for name, value in _ASEG_MEASURE.findall(text):
        if name in key_by_name and float(value) <= LARGEST_NUMBER:
            values[key_by_name[name]] = round(float(value)) if key_by_name[name] == "surface_holes" else float(value)
    return values
