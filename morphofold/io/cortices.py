"""Read a ``Cortex``: a FreeSurfer subject, a simulation or one of its stages, a GIFTI pair, or two files."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from morphofold.io.files import StrPath, existing_file
from morphofold.io.freesurfer import read_annotation, read_label, scanner_transform
from morphofold.io.surfaces import read_morph, read_surface
from morphofold.records import NOT_OURS
from morphofold.surface import Cortex

HEMIS = ("lh", "rh")
MAPS = ("thickness", "curv", "sulc", "area")
SURFACE_ENDINGS = ("", ".surf.gii", ".gii", ".surf.gii.gz")
_MAP_ENDINGS = ("", ".shape.gii", ".gii")


def read_cortex(
    path: StrPath | None = None,
    hemi: str | None = None,
    *,
    white: StrPath | None = None,
    pial: StrPath | None = None,
    surfaces: Sequence[str] = ("white", "pial"),
    annotation: str = "aparc",
    name: str | None = None,
) -> Cortex:
    """Read white and pial surface of one hemisphere and what lies beside them.

    Parameters
    ----------
    path : str or path, optional
        A folder: a FreeSurfer subject or anything shaped so (``surf/lh.white``, ``label/lh.aparc.annot``),
        a pair of surfaces (``lh.white.surf.gii``), a simulation (its last stage is read), or one stage of
        it (``OUT/stages/g1.80``).
    hemi : {"lh", "rh"}, optional
        By default ``"lh"``, or what the names of ``white`` and ``pial`` say.
    white, pial : str or path, optional
        Two files instead of a folder, in any format that ``read_surface`` reads.
    surfaces : two names
        Which inner and outer surface of a folder to read.
    annotation : str
        Which ``label/?h.NAME.annot`` gives the regions, if it is there.
    name : str, optional
        What tables call it; by default the subject's folder, the scene and stage, or the white file.

    Returns
    -------
    Cortex
        ``maps`` has those of thickness, curv, sulc and area that are there, as the files have them
        (FreeSurfer's sign). ``transform`` leads from surface to scanner coordinates where the white surface's
        footer is valid. Of a simulation, ``portion`` and ``info`` come from ``stage.json``.

    Raises
    ------
    FileNotFoundError
        A surface is not there; the message says where it was looked for and what lies there.
    ValueError
        A file is damaged or of the wrong kind, or white, pial and maps do not correspond.
    """
    if hemi not in ("lh", "rh", None):
        raise ValueError(f"hemi must be 'lh' or 'rh', got {hemi!r}.")
    if path is None:
        if white is None or pial is None:
            raise TypeError("Pass a folder, or both white= and pial=.")
        return _pair(Path(white), Path(pial), hemi, name)
    if white is not None or pial is not None:
        raise TypeError(f"{path}: pass either a folder or white= and pial=, not both.")
    path = Path(path)
    if path.is_file():
        raise NotADirectoryError(f"{path}: is a file. Name its folder, or two files as white and pial.")
    if not path.is_dir():
        existing_file(path, "folder with a cortex")  # raises, and lists close names
    return _folder(_stage(path), hemi or "lh", tuple(surfaces), annotation, name)


def hemispheres(folder: Path) -> tuple[str, ...]:
    """Hemispheres of which white or pial is in ``folder`` or its surf/; ("lh",) if neither, for the reader to say."""
    place = folder / "surf" if (folder / "surf").is_dir() else folder
    files = {p.name for p in place.glob("?h.*")} if place.is_dir() else set()
    names = {hemi: {f"{hemi}.{kind}{end}" for kind in ("white", "pial") for end in SURFACE_ENDINGS} for hemi in HEMIS}
    return tuple(hemi for hemi in HEMIS if names[hemi] & files) or ("lh",)


def _pair(white: Path, pial: Path, hemi: str | None, name: str | None) -> Cortex:
    sides = [side_named(file.name) for file in (white, pial)]
    if None not in sides and sides[0] != sides[1]:
        raise ValueError(f"{white} is {sides[0]}, {pial} is {sides[1]}. Name two surfaces of one hemisphere.")
    for file in (white, pial):
        said = side_named(file.name) or hemi
        if hemi is not None and said != hemi:
            raise ValueError(
                f"{file}: is named {said}, but {hemi} was asked for. Ask for {said}, or name the other file."
            )
        hemi = said
    inner, outer = read_surface(white), read_surface(pial)
    return Cortex(
        inner, outer, hemi or "lh", name or white.name, origin="files",
        transform=scanner_transform(inner.geometry), files=(str(white), str(pial)),
    )  # fmt: skip


def side_named(name: str) -> str | None:
    """Hemisphere that a file's name tells: ``lh.white``, ``sub-01_hemi-R_white.surf.gii``, ``100307.R.white...``."""
    if name[:3] in ("lh.", "rh."):
        return name[:2]
    letter = re.search(r"(?:^|_)hemi-([LR])(?=[_.])|\.([LR])\.", name)
    return {"L": "lh", "R": "rh"}[letter[1] or letter[2]] if letter else None


def _stage(path: Path) -> Path:
    """The folder itself, or the last stage if it is a simulation."""
    stages = path / "stages"
    if not stages.is_dir():
        return path.parent if path.name == "surf" else path
    growth = {p: re.fullmatch(r"g(\d+(?:\.\d+)?)", p.name) for p in stages.iterdir() if p.is_dir()}
    done = {p: float(m[1]) for p, m in growth.items() if m}
    if not done:
        raise FileNotFoundError(f"{stages}: no stage (g1.20, ...) is written yet. Let the simulation run.")
    return max(done, key=lambda p: done[p])


def cortex_files(
    path: StrPath, hemi: str, *, surfaces: Sequence[str] = ("white", "pial"), annotation: str = "aparc"
) -> dict[str, Path]:
    """The files that :func:`read_cortex` reads of a folder, by what they hold: white, pial, and what else is there.

    Raises
    ------
    FileNotFoundError
        If a surface is not there.
    ValueError
        If a simulated stage is asked for its right hemisphere, which it has not.
    """
    root = _stage(Path(path))
    stage = root / "stage.json"
    if stage.is_file() and hemi == "rh":
        raise ValueError(f"{root}: is a simulated stage, which has one closed surface named lh. Ask for lh.")
    found = {what: _required(root, f"{hemi}.{s}") for what, s in zip(("white", "pial"), surfaces)}

    def add(what: str, place: str, stem: str, endings: tuple[str, ...] = ("",)) -> None:
        file = _find((root / place,) if (root / place).is_dir() else (root,), stem, endings)
        found.update({} if file is None else {what: file})

    for name in MAPS:
        add(name, "surf", f"{hemi}.{name}", _MAP_ENDINGS)
    add("inflated", "surf", f"{hemi}.inflated", SURFACE_ENDINGS)
    add("annotation", "label", f"{hemi}.{annotation}.annot")
    add("label", "label", f"{hemi}.cortex.label")
    return {**found, "stage": stage} if stage.is_file() else found


def _folder(root: Path, hemi: str, surfaces: tuple[str, ...], annotation: str, name: str | None) -> Cortex:
    if len(surfaces) != 2:
        raise ValueError(f"{root}: surfaces names an inner and an outer surface, got {surfaces}.")
    files = cortex_files(root, hemi, surfaces=surfaces, annotation=annotation)
    inner = files["white"]
    white, pial = read_surface(inner), read_surface(files["pial"])

    def fitting(what: str, read: Callable[[Path], Any], count: Callable[[Any], int] = len) -> Any:
        """What a file holds, refused if it is of another number of vertices."""
        if what not in files:
            return None
        found = read(files[what])
        if count(found) != len(white.verts):
            raise ValueError(
                f"{files[what]} has {count(found):,} vertices, {inner} {len(white.verts):,}: it belongs to another "
                "subject. Take it from the same one, or leave it out."
            )
        return found

    maps = {kind: fitting(kind, read_morph) for kind in MAPS if kind in files}
    inflated = fitting("inflated", read_surface, lambda surface: len(surface.verts))
    regions = fitting("annotation", read_annotation, lambda regions: len(regions.labels))
    found = "FreeSurfer" if inner.suffix not in (".gii", ".gz") else "files"
    said: dict[str, Any] = {"origin": found, "name": root.resolve().name, "info": {}}
    if "stage" in files:
        info = _stage_info(files["stage"])
        said = {**info, "origin": "simulation", "name": _name(root, info), "info": info}
    elif (root / "summary.json").is_file():
        said |= _analysed(root / "summary.json", hemi)
    return Cortex(
        white, pial, hemi, name or said["name"], maps,
        cortex=read_label(files["label"], len(white.verts)) if "label" in files else None,
        regions=regions,
        inflated=inflated,
        origin=said["origin"],
        units=str(said.get("units", "mm")),
        transform=scanner_transform(white.geometry),
        portion=float(said.get("portion", 1.0)),
        info=said["info"], files=tuple(str(p) for p in files.values()),
    )  # fmt: skip


def _find(folders: Sequence[Path], stem: str, endings: tuple[str, ...]) -> Path | None:
    return next((f for folder in folders for e in endings if (f := folder / f"{stem}{e}").is_file()), None)


def _required(root: Path, stem: str) -> Path:
    found = _find((root / "surf", root), stem, SURFACE_ENDINGS)
    if found is None:
        place = root / "surf" if (root / "surf").is_dir() else root
        try:
            existing_file(place / stem, "surface")
        except FileNotFoundError as error:
            raise FileNotFoundError(
                f"{error} Also tried: {stem}.surf.gii, {stem}.gii. A cortex is a FreeSurfer subject (with "
                "surf/lh.white and surf/lh.pial), a simulation, or a pair given as white and pial."
            ) from None
    assert found is not None
    return found


def _name(root: Path, info: dict[str, Any]) -> str:
    folder = root.resolve().name
    scene = str(info.get("name", ""))
    return f"{scene} {folder}" if scene and folder not in scene else scene or folder


def _analysed(path: Path, hemi: str) -> dict[str, Any]:
    """What an analysis folder says of the surface it measured: name, origin, units, portion, info."""
    existing_file(path, "summary of an analysis")
    try:
        entries = {str(e["hemi"]): e for e in json.loads(path.read_text(encoding="utf-8"))["surfaces"]}
        entry = entries[hemi]
        kept = {key: entry[key] for key in ("name", "origin", "units", "portion", "info")}
        if not (isinstance(kept["info"], dict) and 0 < float(kept["portion"]) <= 1):
            raise ValueError("portion must lie in (0, 1]")
    except (ValueError, *NOT_OURS) as error:
        raise ValueError(f"{path}: is not the summary of an analysis of {hemi} ({error}). Analyze it anew.") from error
    return kept


def _stage_info(path: Path) -> dict[str, Any]:
    """What ``simulate`` recorded of a stage: plain facts, with a portion in (0, 1]."""
    existing_file(path, "stage record")
    if path.stat().st_size > 2**20:
        raise ValueError(f"{path}: has {path.stat().st_size} bytes, a stage record has at most 1 MiB.")
    try:
        info = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{path}: is not JSON ({error}). Simulate that stage anew.") from error
    portion = info.get("portion", 1.0) if isinstance(info, dict) else None
    if not isinstance(portion, (int, float)) or not 0 < portion <= 1:
        raise ValueError(f"{path}: a stage record is an object with a portion in (0, 1], got {portion!r:.40}.")
    return {**info, "name": info.get("name", "simulation")}


