"""Read a ``Cortex``: a FreeSurfer subject, a simulation or one of its stages, a GIFTI pair, or two files."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy import sparse

from morphofold.errors import Mismatch, OptionsClash, UnlikeSurfaces, WrongFile, WrongShape
from morphofold.geometry import adjacency, vertex_normals
from morphofold.io.cortex_files import (
    HEMIS,
    MAP_NAMES,
    StageRecord,
    cortex_files,
    folded_files,
    hemispheres,
    last_stage,
    measured_surface_fields,
)
from morphofold.io.files import StrPath, existing_file, side_named
from morphofold.io.formats import read_annotation, read_label, read_morph, read_surface
from morphofold.io.freesurfer import flip_curvature_sign, read_aseg_stats, scanner_transform
from morphofold.io.json_files import read_json
from morphofold.provenance import clean_name, unchanged
from morphofold.surface import Cortex, PerVertex, Surface
from morphofold.validators import one_of

OPPOSITE = -0.3  # correlation with the depth below; with FreeSurfer's sign it was 0.66 to 0.90 on people and averages
_AVERAGES = 20
#: by the content in folded_files, that of a cortex
_IN_A_CORTEX = {"surface": "white", "aparc.annot": "annotation", "cortex.label": "label"}


def read_cortex(
    path: StrPath | None = None,
    hemi: str | None = None,
    *,
    white: StrPath | None = None,
    pial: StrPath | None = None,
    surfaces: Sequence[str] = ("white", "pial"),
    annotation: str | None = None,
    name: str | None = None,
) -> Cortex:
    """Read the white and pial surface of one hemisphere and the files beside them.

    Parameters
    ----------
    path : str or path, optional
        A folder: a FreeSurfer subject or a folder with the same structure (``surf/lh.white``,
        ``label/lh.aparc.annot``), a pair of surfaces (``lh.white.surf.gii``), a simulation (its last stage is read),
        or one stage of a simulation (``OUT/stages/g1.80``).
    hemi : {"lh", "rh"}, optional
        By default ``"lh"``, or that of a simulation, or the hemisphere in the names of ``white`` and ``pial``.
    white, pial : str or path, optional
        Two files instead of a folder, in any format that ``read_surface`` reads.
    surfaces : two names
        The inner and the outer surface of a folder to read.
    annotation : str, optional
        NAME of ``label/?h.NAME.annot`` or ``label/?h.aparc.NAME.annot`` in a folder, which gives the regions:
        ``"a2009s"`` is ``"aparc.a2009s"``. None: that of an analysis, else ``aparc`` if it exists.
    name : str, optional
        Its name in tables; by default the folder of the subject, the scene and stage, or the white file.

    Returns
    -------
    Cortex
        ``maps`` holds thickness, curv, sulc and area, if they exist, as in the files, but always in FreeSurfer's sign:
        a map of the opposite one is reversed, with a warning.
        ``transform`` maps surface to scanner coordinates if the footer of the white surface is valid. For a simulation,
        ``portion`` and ``info`` come from ``stage.json``. For a FreeSurfer subject, ``info`` holds the intracranial and
        other volumes of ``stats/aseg.stats``.

    Raises
    ------
    FileNotFoundError
        A surface or the named annotation does not exist; the message gives the place that was searched and the
        files that are there.
    ValueError
        A file is damaged or of the wrong kind, or white, pial and maps do not correspond.
    OSError
        A file changed while it was read.
    """
    one_of(hemi or "lh", HEMIS, "hemi")
    if path is None:
        if white is None or pial is None:
            raise TypeError("Pass a folder, or both white= and pial=.")
        if annotation is not None:
            raise OptionsClash(f"{white}: an annotation can be named only for a folder with surfaces. Pass the folder.")
        return _cortex_of_pair(Path(white), Path(pial), hemi, name)
    if white is not None or pial is not None:
        raise TypeError(f"{path}: pass either a folder or white= and pial=, not both.")
    path = Path(path)
    if path.is_file():
        raise NotADirectoryError(f"{path}: is a file. Name its folder, or two files as white and pial.")
    if not path.is_dir():
        existing_file(path, "folder with a cortex")  # raises, and lists close names
    root = last_stage(path)
    hemi = hemi or (hemispheres(root)[0] if os.path.lexists(root / "stage.json") else "lh")
    if len(surfaces) != 2:
        raise WrongShape(f"{root}: surfaces must name an inner and an outer surface, got {tuple(surfaces)}.")
    return read_cortex_files(root, hemi, cortex_files(root, hemi, surfaces=surfaces, annotation=annotation), name)


def _cortex_of_pair(white: Path, pial: Path, hemi: str | None, name: str | None) -> Cortex:
    sides = [side_named(file.name) for file in (white, pial)]
    if None not in sides and sides[0] != sides[1]:
        raise UnlikeSurfaces(f"{white} is {sides[0]}, {pial} is {sides[1]}. Name two surfaces of one hemisphere.")
    for file in (white, pial):
        fields = side_named(file.name) or hemi
        if hemi is not None and fields != hemi:
            raise WrongFile(
                f"{file}: is named {fields}, but {hemi} was requested. Request {fields}, or name the other file."
            )
        hemi = fields
    files = {"white": existing_file(white, "surface"), "pial": existing_file(pial, "surface")}
    return read_cortex_files(None, hemi or "lh", files, name)


def read_cortex_files(root: Path | None, hemi: str, files: dict[str, Path], name: str | None = None) -> Cortex:
    """The cortex that files hold, by content as in :func:`cortex_files`; ``root`` is their folder, if they have one."""
    with unchanged(dict.fromkeys(files.values())) as records:
        cortex = _read(root, hemi, files, name)
    return replace(cortex, inputs=tuple(records))


def _read(root: Path | None, hemi: str, files: dict[str, Path], name: str | None) -> Cortex:
    inner = files["white"]
    white, pial = read_surface(inner), read_surface(files["pial"])

    def fitting(what: str, read: Callable[[Path], Any], count: Callable[[Any], int] = len) -> Any:
        """The content of a file; raises ``Mismatch`` if it has another number of vertices."""
        if what not in files:
            return None
        content = read(files[what])
        if count(content) != len(white.verts):
            raise Mismatch(
                f"{files[what]} has {count(content):,} vertices, {inner} {len(white.verts):,}: it belongs to another "
                "subject. Take it from the same subject, or leave it out."
            )
        return content

    maps = {kind: fitting(kind, read_morph) for kind in MAP_NAMES if kind in files}
    registered = read_surface(files["registered"]) if "registered" in files else None
    fields = _fields(root, hemi, files)
    return Cortex(
        white,
        pial,
        hemi,
        clean_name(name or fields["name"]),
        maps if "stage" in files else in_freesurfer_signs(maps, white, files),
        cortex=fitting("label", lambda file: read_label(file, len(white.verts))),
        regions=fitting("annotation", read_annotation, lambda regions: len(regions.labels)),
        inflated=fitting("inflated", read_surface, lambda surface: len(surface.verts)),
        sphere=fitting("sphere", read_surface, lambda surface: len(surface.verts)),
        registered=registered if registered and len(registered.verts) == len(white.verts) else None,
        origin=fields["origin"],
        units=str(fields.get("units", "mm")),
        transform=scanner_transform(white.geometry),
        portion=float(fields.get("portion", 1.0)),
        info=fields["info"],
        files=tuple(str(p) for p in files.values()),
    )


def _fields(root: Path | None, hemi: str, files: dict[str, Path]) -> dict[str, Any]:
    """Name, origin and info of a cortex, and what else its records say: units and portion."""
    inner = files["white"]
    if root is None:
        return {"origin": "files", "name": inner.name, "info": {}}
    folder = root.resolve().name
    if "stage" in files:
        info = read_json(files["stage"], StageRecord, "Simulate that stage again.")
        info = {**info, "name": info.get("name", "simulation")}
        scene = str(info["name"])
        name = f"{scene} {folder}" if scene and folder not in scene else scene or folder
        return {**info, "origin": "simulation", "name": name, "info": info}
    if os.path.lexists(root / "summary.json"):
        return measured_surface_fields(root / "summary.json", hemi)
    info = read_aseg_stats(files["stats"], hemi) if "stats" in files else {}
    return {"origin": "files" if inner.suffix in (".gii", ".gz") else "FreeSurfer", "name": folder, "info": info}


def read_folded(path: StrPath, hemi: str, *, surface: str | None = None, sphere: str | None = None) -> Cortex:
    """Read ``surf/?h.SURFACE`` (white) and ``surf/?h.SPHERE`` of a subject, and regions and cortex label if they exist.

    Unless a sphere is named, ``surf/?h.sphere`` is read if it exists. Without a label, the files by which the cortex
    is found are read too. ``path`` may also be a file of a closed surface, and ``sphere`` then the file of its sphere.

    Returns
    -------
    Cortex
        ``white`` is the folded surface, whatever its name; ``pial`` is the same one, unless it was read.

    Raises
    ------
    FileNotFoundError
        If a surface does not exist.
    ValueError
        If a file is damaged, or belongs to another subject.
    """
    files = folded_files(path, hemi, surface=surface, sphere=sphere)
    known = {_IN_A_CORTEX.get(what, what): file for what, file in files.items()}
    return read_cortex_files(Path(path), hemi, {**known, "pial": known.get("pial", files["surface"])})


def in_freesurfer_signs(
    maps: Mapping[str, PerVertex], white: Surface, files: Mapping[str, Path]
) -> dict[str, PerVertex]:
    """Maps (N,) by name, reversed with a warning where their sign is opposite to FreeSurfer's.

    ``sulc`` and ``curv``, positive in sulci, are opposite if their correlation with the depth of vertices below the
    smoothed white surface is less than ``OPPOSITE``; ``thickness``, if more values are negative than positive.
    """
    signed = dict(maps)
    for name, values in maps.items():
        if name == "area":
            continue
        if name == "thickness":
            opposite, why = (values < 0).sum() > (values > 0).sum(), "is negative, as in HCP's convention"
        else:
            depth = _depth(white)
            finite = np.isfinite(values) & np.isfinite(depth)
            with np.errstate(invalid="ignore", divide="ignore"):  # a constant map has no correlation
                r = np.corrcoef(values[finite], depth[finite])[0, 1] if finite.any() else np.nan
            opposite, why = r < OPPOSITE, f"is positive on gyri, not in sulci (correlation with depth {r:.2f})"
        if opposite:
            warnings.warn(f"{files[name]}: {why}; its sign was reversed.", stacklevel=2)
            signed[name] = flip_curvature_sign(values)
    return signed


def _depth(white: Surface) -> PerVertex:
    """Distance (N,) [mm] of each vertex below the surface after averages over neighbours, positive in sulci."""
    near = adjacency(len(white.verts), white.faces).astype(np.float64)
    mean = sparse.diags_array(1 / np.maximum(near.sum(axis=1), 1)) @ near
    smooth = white.verts
    for _ in range(_AVERAGES):
        smooth = mean @ smooth
    normals = vertex_normals(white.verts, white.faces)
    outward = np.sign(np.nansum((white.verts - np.nanmean(white.verts, axis=0)) * normals))  # faces may be reversed
    return outward * ((smooth - white.verts) * normals).sum(axis=1)
