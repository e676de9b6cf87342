"""Read a ``Cortex``: a FreeSurfer subject, a simulation or one of its stages, a GIFTI pair, or two files."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from morphofold.errors import DoesNotApply, Mismatch, MissingPart, OptionsClash, UnlikeSurfaces, WrongFile, WrongShape
from morphofold.io.files import MAX_BYTES, StrPath, existing_file, side_named
from morphofold.io.formats import read_mask, read_morph, read_regions, read_surface
from morphofold.io.freesurfer import read_aseg_stats, scanner_transform
from morphofold.io.json_files import Amount, Count, FileWord, Number, Record, read_json
from morphofold.io.map_signs import in_freesurfer_signs
from morphofold.provenance import clean_name, unchanged
from morphofold.surface import Cortex
from morphofold.validators import one_of

HEMIS = ("lh", "rh")
MAP_NAMES = ("thickness", "curv", "sulc", "area")
SURFACE_ENDINGS = ("", ".surf.gii", ".gii", ".surf.gii.gz", ".asc")
_MAP_ENDINGS = ("", ".shape.gii", ".gii", ".mgh", ".mgz")

_PositiveSize = Annotated[float, Field(ge=1e-6, le=1e6)]


class StageHealth(Record):
    """Numbers of a stage in ``stage.json`` and ``health.json``."""

    growth: Number = 1.0
    min_J: Number = 1.0
    crossings: Count = 0
    deepest_crossing: Amount = 0.0
    mean_radius_mm: Amount | None = None


class GrownFrom(Record):
    """The person whose unfolded cortex grew: SHA-256 of the files by content, the level of unfolding, which maps it was
    given, and what marked its cortex."""

    subject: str
    sha256: dict[str, str]
    unfold: Annotated[float, Field(gt=0, le=1)]
    maps: list[str] = []
    cortex_mask: str = ""


class StageRecord(Record):
    """``stage.json``: the record of a stage by ``simulate``, the ``info`` of an analysis; all keys may be missing."""

    name: str = "simulation"
    g: Annotated[float, Field(gt=0, le=1000)] = 1.0
    law: str = ""
    mu_ratio: _PositiveSize = 1.0
    material: str = "neo-hookean"
    shape: str = ""
    reference_thickness: _PositiveSize = 1.0
    reference_radius: _PositiveSize = 1.0
    portion: Annotated[float, Field(ge=1e-3, le=1)] = 1.0
    units: str = "mm"
    health: StageHealth = StageHealth()
    warnings: list[str] = []
    vertices_without_value_written_as_0: dict[str, Count] = {}
    grown_from: GrownFrom | None = None


class SurfaceRecord(Record):
    """The origin of a surface as given in ``summary.json``."""

    hemi: Literal["lh", "rh"]
    name: str
    origin: str
    units: str
    portion: Annotated[float, Field(ge=1e-3, le=1)]
    info: StageRecord
    annotation: FileWord | None = None


class _AnalysisSummary(Record):
    surfaces: list[SurfaceRecord]


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
    root = _last_stage(path)
    hemi = hemi or (hemispheres(root)[0] if os.path.lexists(root / "stage.json") else "lh")
    return _cortex_of_folder(root, hemi, tuple(surfaces), annotation, name)


def hemispheres(folder: Path) -> tuple[str, ...]:
    """Hemispheres with white or pial in ``folder`` or its surf/, or in the last stage of a simulation; ("lh",) if none:
    then the reader raises the error."""
    folder = _last_stage(folder) if (folder / "stages").is_dir() else folder
    place = folder / "surf" if (folder / "surf").is_dir() else folder
    files = {p.name for p in place.glob("?h.*")} if place.is_dir() else set()
    names = {hemi: {f"{hemi}.{kind}{end}" for kind in ("white", "pial") for end in SURFACE_ENDINGS} for hemi in HEMIS}
    return tuple(hemi for hemi in HEMIS if names[hemi] & files) or ("lh",)


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
    with _recording_inputs((white, pial)) as records:
        inner, outer = read_surface(white), read_surface(pial)
    return Cortex(
        inner,
        outer,
        hemi or "lh",
        clean_name(name or white.name),
        origin="files",
        transform=scanner_transform(inner.geometry),
        files=(str(white), str(pial)),
        inputs=tuple(records),
    )


def _recording_inputs(files: Sequence[Path]) -> AbstractContextManager[list[dict[str, Any]]]:
    """Context for reading: records of the bytes that are read. Files that no reader accepts are not scanned before."""
    return unchanged(file for file in files if file.is_file() and file.stat().st_size <= MAX_BYTES)


def _last_stage(path: Path) -> Path:
    """The folder itself, or the last stage if it is a simulation."""
    stages = path / "stages"
    if not stages.is_dir():
        return path.parent if path.name == "surf" else path
    growth = {p: re.fullmatch(r"g(\d+(?:\.\d+)?)", p.name) for p in stages.iterdir() if p.is_dir()}
    done = {p: float(m[1]) for p, m in growth.items() if m}
    if not done:
        raise FileNotFoundError(
            f"{stages}: no stage (g1.20, ...) is written yet. Wait until the simulation has written one."
        )
    return max(done, key=lambda p: done[p])


def cortex_files(
    path: StrPath, hemi: str, *, surfaces: Sequence[str] = ("white", "pial"), annotation: str | None = None
) -> dict[str, Path]:
    """The files that :func:`read_cortex` reads in a folder, by content: white, pial, and the others that exist.

    Raises
    ------
    FileNotFoundError
        If a surface does not exist.
    OSError, ValueError
        If the right hemisphere of a simulated stage is requested, which does not exist; or if one of the other paths
        is not a file: a folder, a pipe, a link whose target does not exist.
    """
    root = _last_stage(Path(path))
    stage = root / "stage.json"
    staged = os.path.lexists(stage)
    if staged and hemi not in (sides := hemispheres(root)):
        raise DoesNotApply(f"{root}: is a simulated stage of {sides[0]}, and has no {hemi}. Request {sides[0]}.")
    found = {what: _required_surface(root, f"{hemi}.{s}") for what, s in zip(("white", "pial"), surfaces)}

    def add(what: str, place: str, stem: str, endings: tuple[str, ...] = ("",)) -> None:
        places = [folder for folder in (root / place, root / "surf") if folder.is_dir()]
        file = _first_existing_file(places or [root], stem, endings)
        found.update({} if file is None else {what: existing_file(file, what)})

    for name in MAP_NAMES:
        add(name, "surf", f"{hemi}.{name}", _MAP_ENDINGS)
    for kind in ("inflated", "sphere"):
        add(kind, "surf", f"{hemi}.{kind}", SURFACE_ENDINGS)
    if annotation is None and not staged and os.path.lexists(root / "summary.json"):
        annotation = _measured_surface_fields(root / "summary.json", hemi)["annotation"]
    for stem in ("aparc",) if annotation is None else (f"aparc.{annotation}", annotation):
        add("annotation", "label", f"{hemi}.{stem}", (".annot", ".label.gii"))
    if annotation is not None and "annotation" not in found:
        there = sorted(file.name for place in (root / "label", root) for file in place.glob(f"{hemi}.*.annot"))
        raise FileNotFoundError(
            f"{root}: has no label/{hemi}.{annotation}.annot; it has {', '.join(there) or 'no annotation'}. "
            "Name one as aparc.a2009s, without hemisphere and ending."
        )
    for stem in (f"{hemi}.atlasroi.shape.gii", f"{hemi}.cortex.label"):  # HCP's, and FreeSurfer's, which goes first
        add("label", "label", stem)
    if "label" not in found:
        add("registered", "surf", f"{hemi}.sphere.reg", SURFACE_ENDINGS)
    if (stats := root / "stats" / "aseg.stats").is_file() and stats.stat().st_size:  # no measure depends on it
        found["stats"] = stats
    return {**found, "stage": existing_file(stage, "stage record")} if staged else found


def _cortex_of_folder(
    root: Path, hemi: str, surfaces: tuple[str, ...], annotation: str | None, name: str | None
) -> Cortex:
    if len(surfaces) != 2:
        raise WrongShape(f"{root}: surfaces must name an inner and an outer surface, got {surfaces}.")
    files = cortex_files(root, hemi, surfaces=surfaces, annotation=annotation)
    with _recording_inputs(list(files.values())) as records:
        cortex = read_cortex_files(root, hemi, files, name)
    return replace(cortex, inputs=tuple(records))


def read_cortex_files(root: Path, hemi: str, files: dict[str, Path], name: str | None = None) -> Cortex:
    """The cortex that files hold, by content as in :func:`cortex_files`; ``root`` is their folder."""
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
    maps = maps if "stage" in files else in_freesurfer_signs(maps, white, files)
    inflated, sphere = (fitting(name, read_surface, lambda found: len(found.verts)) for name in ("inflated", "sphere"))
    registered = read_surface(files["registered"]) if "registered" in files else None
    regions = fitting("annotation", read_regions, lambda regions: len(regions.labels))
    mask = fitting("label", lambda file: read_mask(file, len(white.verts)))
    found = "FreeSurfer" if inner.suffix not in (".gii", ".gz") else "files"
    info = read_aseg_stats(files["stats"], hemi) if "stats" in files else {}
    fields: dict[str, Any] = {"origin": found, "name": root.resolve().name, "info": info}
    if "stage" in files:
        info = _stage_record(files["stage"])
        fields = {**info, "origin": "simulation", "name": _simulation_name(root, info), "info": info}
    elif os.path.lexists(root / "summary.json"):
        fields |= _measured_surface_fields(root / "summary.json", hemi)
    return Cortex(
        white,
        pial,
        hemi,
        clean_name(name or fields["name"]),
        maps,
        cortex=mask,
        regions=regions,
        inflated=inflated,
        sphere=sphere,
        registered=registered if registered and len(registered.verts) == len(white.verts) else None,
        origin=fields["origin"],
        units=str(fields.get("units", "mm")),
        transform=scanner_transform(white.geometry),
        portion=float(fields.get("portion", 1.0)),
        info=fields["info"],
        files=tuple(str(p) for p in files.values()),
    )


def registered_sphere(
    path: StrPath,
    hemi: str,
    name: str = "sphere.reg",
    writer: str = "FreeSurfer's recon-all (-surfreg) or mris_register writes it.",
) -> Path:
    """The sphere of a folder on which its surfaces are registered to others: ``surf/?h.sphere.reg``, or another name,
    as a FreeSurfer or GIFTI file. ``writer`` says in the error what writes it.

    Raises
    ------
    FileNotFoundError
        If there is none.
    """
    root = Path(path)
    file = _first_existing_file((root / "surf", root), f"{hemi}.{name}", SURFACE_ENDINGS)
    if file is None:
        raise FileNotFoundError(f"{root}: has no surf/{hemi}.{name}, by which maps come over to a template. {writer}")
    return existing_file(file, "registered sphere")


def _first_existing_file(folders: Sequence[Path], stem: str, endings: tuple[str, ...]) -> Path | None:
    return next((f for folder in folders for e in endings if os.path.lexists(f := folder / f"{stem}{e}")), None)


def _required_surface(root: Path, stem: str) -> Path:
    found = _first_existing_file((root / "surf", root), stem, SURFACE_ENDINGS)
    try:
        return existing_file(found or (root / "surf" if (root / "surf").is_dir() else root) / stem, "surface")
    except FileNotFoundError as error:
        raise FileNotFoundError(
            f"{error} Also tried: {stem}.surf.gii, {stem}.gii. A cortex is a FreeSurfer subject (with "
            "surf/lh.white and surf/lh.pial), a simulation, or a pair given as white and pial."
        ) from None


def _simulation_name(root: Path, info: dict[str, Any]) -> str:
    folder = root.resolve().name
    scene = str(info.get("name", ""))
    return f"{scene} {folder}" if scene and folder not in scene else scene or folder


def _measured_surface_fields(path: Path, hemi: str) -> dict[str, Any]:
    """Fields of a measured surface in an analysis folder: name, origin, units, portion, info, annotation."""
    fields = read_json(path, _AnalysisSummary, "Analyze it again.")["surfaces"]
    found = next((entry for entry in fields if entry["hemi"] == hemi), None)
    if found is None:
        raise MissingPart(f"{path}: is not the summary of an analysis of {hemi}. Analyze it again.")
    return {key: found.get(key) for key in ("name", "origin", "units", "portion", "info", "annotation")}


def _stage_record(path: Path) -> dict[str, Any]:
    """The record of a stage by ``simulate``."""
    info = read_json(path, StageRecord, "Simulate that stage again.", most=2**20)
    return {**info, "name": info.get("name", "simulation")}
