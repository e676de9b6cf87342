"""GIFTI: bytes of surfaces, per-vertex maps, regions and masks to arrays and back, through nibabel, for ``formats``."""

import gzip
import html
import io
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from morphofold.digests_and_json import Row, clean_name
from morphofold.errors import DamagedFile, WrongFile
from morphofold.frozen_arrays import Bools, Ints
from morphofold.io.files import SurfaceContent, atomic_file, existing_file, name_in_file, side_named
from morphofold.io.freesurfer import scanner_transform
from morphofold.surface import PerVertex, Regions, Surface, Verts

_STRUCTURE_OF_HEMI = {"lh": "CortexLeft", "rh": "CortexRight"}
_GEOMETRIC_TYPES = {"inflated": "Inflated", "sphere": "Spherical"}  # names as in Connectome Workbench
_SECONDARY_STRUCTURES = {"white": "GrayWhite", "pial": "Pial"}
_SCANNER_FRAME = 1  # as in NIfTI; 0 is an unknown frame
_EXTERNAL_NAME = re.compile(rb"""<DataArray\b[^>]*\bExternalFileName\s*=\s*["']([^"']+)""")


def read_surface(raw: bytes, path: Path) -> SurfaceContent:
    """Vertices (N, 3), faces (M, 3) and the volume geometry that mris_convert stores, if complete.

    The geometry is None for a surface marked as in the scanner's frame: its ``C_RAS`` would move the surface twice.
    """
    image = _read(raw, path)
    points, triangles = (image.get_arrays_from_intent(intent) for intent in ("pointset", "triangle"))
    if len(points) != 1 or len(triangles) != 1:
        raise WrongFile(
            f"it holds {len(points)} arrays of points and {len(triangles)} of triangles, not one of each. "
            f"Of all: {_content(image)}; pass a .surf.gii"
        )
    in_scanner = getattr(points[0].coordsys, "dataspace", None) == _SCANNER_FRAME
    return points[0].data, triangles[0].data, None if in_scanner else _volume_geometry(points[0].meta)


def read_map(raw: bytes, path: Path) -> PerVertex:
    """Values (N,) of a GIFTI with a single per-vertex array (``.shape.gii``, ``.func.gii``)."""
    image = _read(raw, path)
    if len(image.darrays) != 1 or np.squeeze(image.darrays[0].data).ndim != 1:
        raise WrongFile(f"it holds {_content(image)}; a map has one array with one value per vertex")
    return np.ravel(image.darrays[0].data)


def read_regions(raw: bytes, path: Path) -> Regions:
    """Regions of a GIFTI label file (``lh.aparc.label.gii``), in the order of their keys; key 0 means no region."""
    image = _read(raw, path)
    arrays = image.get_arrays_from_intent("label")
    if len(image.darrays) != 1 or not arrays or arrays[0].data.ndim != 1:
        raise WrongFile(f"it holds {_content(image)}; regions are one array with one key per vertex")
    labels = image.labeltable.labels
    table = {label.key: (getattr(label, "label", ""), label.rgba) for label in labels}  # nibabel sets no empty text
    return regions_of_keys(arrays[0].data, table, name_in_file(path))


def regions_of_keys(vertex_keys: Ints, table: Mapping[int, tuple[str, Sequence[float]]], name: str) -> Regions:
    """Regions of the keys (N,) of vertices and a table of key to name and RGBA, 0 to 1; key 0 means no region."""
    keys = sorted(key for key in table if key)
    missing_keys = np.setdiff1d(vertex_keys, [0, *keys])
    if missing_keys.size:
        raise DamagedFile(f"its label table lacks {len(missing_keys)} of the keys, the first is {missing_keys[0]}")
    colours = np.nan_to_num(np.array([table[key][1][:3] for key in keys], np.float64)).reshape(-1, 3)
    names = tuple(clean_name(table[key][0]) for key in keys)
    rgb = np.round(255 * colours.clip(0, 1)).astype(np.uint8)
    return Regions(np.where(vertex_keys == 0, -1, np.searchsorted(keys, vertex_keys)), names, rgb, name)


def read_mask(raw: bytes, path: Path) -> Bools:
    """Mask (N,): where a map or the keys of a label file are positive."""
    return read_map(raw, path) > 0


def _read(raw: bytes, path: Path) -> Any:
    """The image of a file, by nibabel; each of its arrays has numbers."""
    from nibabel.gifti.parse_gifti_fast import GiftiImageParser

    for external_name in _EXTERNAL_NAME.findall(raw):  # in a file beside it, where SPM and CAT12 keep arrays
        existing_file(path.with_name(html.unescape(external_name.decode())), "file of arrays")
    raw_stream = io.BytesIO(raw)
    raw_stream.name = str(path)  # where nibabel looks for arrays in files beside it
    parser = GiftiImageParser(mmap=False)
    parser.parse(fptr=raw_stream)
    image = parser.img
    arrays = [array.data for array in image.darrays]
    if any(values is None or not values.size or values.dtype.kind not in "fiu" for values in arrays):
        raise DamagedFile("it has an array without numbers")
    return image


def _content(image: Any) -> str:
    from nibabel.nifti1 import intent_codes

    names = [f"{str(intent_codes.niistring[a.intent]).split('_')[-1].lower()} {a.data.shape}" for a in image.darrays]
    return ", ".join(names[:4]) + (" ..." if len(names) > 4 else "") if names else "no arrays"


_FOOTER_KEYS = {
    "volume": ("Width", "Height", "Depth"),
    "voxelsize": ("Xsize", "Ysize", "Zsize"),
    **{f"{row}ras": tuple(f"{row.upper()}_{axis}" for axis in "RAS") for row in "xyzc"},
}


def _volume_geometry(meta: Mapping[str, str]) -> Row | None:
    """FreeSurfer's footer from the ``VolGeom...`` entries of mris_convert; None unless all exist."""
    try:
        rows = {key: np.array([float(meta[f"VolGeom{name}"]) for name in names]) for key, names in _FOOTER_KEYS.items()}
    except (KeyError, ValueError):
        return None
    header = {"head": np.array([2, 0, 20]), "valid": "1  # volume info valid", "filename": meta.get("VolGeomFname", "")}
    return {**header, **rows, "volume": rows["volume"].astype(int)}


def write_surface(path: Path, surface: Surface, *, scanner: bool = False) -> None:
    """Write a GIFTI surface, float32 and int32, compressed; its footer is written as ``VolGeom...``.

    Coordinates stay unchanged. As with ``mris_convert``, coordinates in FreeSurfer's surface frame stay in that frame,
    and ``C_RAS`` of the footer gives the shift to the scanner's frame. With ``scanner`` the file is marked as in the
    scanner's frame; such a surface has no footer. The end of the file name gives the kind: white, pial, inflated or
    sphere.
    """
    surface_name = re.split(r"[._]", re.sub(r"(\.surf)?\.gii(\.gz)?$", "", path.name))[-1]
    meta = _structure_metadata(path) | {"GeometricType": _GEOMETRIC_TYPES.get(surface_name, "Anatomical")}
    if surface_name in _SECONDARY_STRUCTURES:
        meta["AnatomicalStructureSecondary"] = _SECONDARY_STRUCTURES[surface_name]
    if (footer := surface.geometry) and scanner_transform(footer) is not None:
        meta["VolGeomFname"] = str(footer["filename"])
        for key, names in _FOOTER_KEYS.items():
            meta |= {f"VolGeom{name}": repr(number.item()) for name, number in zip(names, np.asarray(footer[key]))}
    points, triangles = surface.verts.astype(np.float32), surface.faces.astype(np.int32)
    _write_image(path, [(points, "pointset", meta), (triangles, "triangle", {})], frame=int(scanner))


def write_map(path: Path, values: np.ndarray, name: str, hemi: str | None) -> None:
    """Write checked values (N,) as a GIFTI map; ``name`` is by default that of the file."""
    meta = {"Name": name or path.name.split(".gii")[0]}
    _write_image(path, [(values, "shape", meta)], _structure_metadata(path, hemi))


def write_regions(path: Path, regions: Regions) -> None:
    """Write regions as a GIFTI label file: region i has key i + 1; key 0, ??? as in Workbench, means no region."""
    rgba = [(1.0, 1.0, 1.0, 0.0), *((r / 255, g / 255, b / 255, 1.0) for r, g, b in regions.colours.tolist())]
    key_array = (regions.labels + 1).astype(np.int32), "label", {"Name": regions.name}
    _write_image(path, [key_array], _structure_metadata(path), labels=zip(("???", *regions.names), rgba))


def write_mask(path: Path, mask: Bools, verts: Verts) -> None:
    """Write a mask (N,) as a GIFTI label file whose one region is ``cortex``."""
    write_regions(path, Regions(np.where(mask, 0, -1), ("cortex",), np.array([[255, 255, 255]], np.uint8), "cortex"))


def _structure_metadata(path: Path, hemi: str | None = None) -> dict[str, str]:
    hemi = hemi or side_named(path.name)
    return {"AnatomicalStructurePrimary": _STRUCTURE_OF_HEMI[hemi]} if hemi in _STRUCTURE_OF_HEMI else {}


def _write_image(
    path: Path,
    arrays: Iterable[tuple[np.ndarray, str, dict[str, str]]],
    meta: Mapping[str, str] = {},
    labels: Iterable[tuple[str, tuple[float, ...]]] = (),
    frame: int | None = None,
) -> None:
    """Write arrays, each with its intent and metadata, labels with their colours, and the frame of the first array."""
    from nibabel import gifti

    data_arrays = [gifti.GiftiDataArray(values, intent, meta=array_meta) for values, intent, array_meta in arrays]
    image = gifti.GiftiImage(meta=gifti.GiftiMetaData(meta), darrays=data_arrays)
    if frame is not None:
        image.darrays[0].coordsys = gifti.GiftiCoordSystem(frame, frame)
    for key, (name, rgba) in enumerate(labels):
        image.labeltable.labels.append(gifti.GiftiLabel(key, *rgba))
        image.labeltable.labels[-1].label = name
    raw = image.to_bytes()
    with atomic_file(path) as temporary:
        temporary.write_bytes(gzip.compress(raw, mtime=0) if path.suffix == ".gz" else raw)
