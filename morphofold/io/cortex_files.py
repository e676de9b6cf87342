"""Where the files of a cortex are: in a subject, a simulation or one of its stages, an analysis, or a sample."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from importlib.resources import files as package_files
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from morphofold.errors import DoesNotApply, MissingPart
from morphofold.io.files import StrPath, existing_file
from morphofold.io.json_files import Amount, Count, FileWord, Number, Record, read_json

HEMIS = ("lh", "rh")
MAP_NAMES = ("thickness", "curv", "sulc", "area")
SURFACE_ENDINGS = ("", ".surf.gii", ".gii", ".surf.gii.gz", ".asc")
_MAP_ENDINGS, _ANNOTATION_ENDINGS = ("", ".shape.gii", ".gii", ".mgh", ".mgz"), (".annot", ".label.gii")
#: optional files of a cortex: content, folder, name between hemisphere and ending; the last one of a content is read
_CONTENTS = (
    *((name, "surf", name, _MAP_ENDINGS) for name in MAP_NAMES),
    ("inflated", "surf", "inflated", SURFACE_ENDINGS),
    ("sphere", "surf", "sphere", SURFACE_ENDINGS),
    ("annotation", "label", "aparc.{}", _ANNOTATION_ENDINGS),
    ("annotation", "label", "{}", _ANNOTATION_ENDINGS),
    ("label", "label", "atlasroi.shape.gii", ("",)),  # HCP's
    ("label", "label", "cortex.label", ("",)),  # FreeSurfer's
    ("registered", "surf", "sphere.reg", SURFACE_ENDINGS),  # without a label
)
WHITE = "white"
SIGNS = ("pial", "thickness")  # by which the cortex under white is found without a label

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


def hemispheres(folder: Path) -> tuple[str, ...]:
    """Hemispheres with white or pial in ``folder`` or its surf/, or in the last stage of a simulation; ("lh",) if none:
    then the reader raises the error."""
    folder = last_stage(folder) if (folder / "stages").is_dir() else folder
    found = (hemi for hemi in HEMIS if any(_file_in(folder, "surf", f"{hemi}.{kind}") for kind in ("white", "pial")))
    return tuple(found) or ("lh",)


def last_stage(path: Path) -> Path:
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
    root = last_stage(Path(path))
    stage = root / "stage.json"
    staged = os.path.lexists(stage)
    if staged and hemi not in (sides := hemispheres(root)):
        raise DoesNotApply(f"{root}: is a simulated stage of {sides[0]}, and has no {hemi}. Request {sides[0]}.")
    files = {content: _required_surface(root, f"{hemi}.{s}") for content, s in zip(("white", "pial"), surfaces)}

    if annotation is None and not staged and os.path.lexists(root / "summary.json"):
        annotation = measured_surface_fields(root / "summary.json", hemi).get("annotation")
    name = "aparc" if annotation is None else annotation
    for content, place, stem, endings in _CONTENTS:
        file = _file_in(root, place, f"{hemi}.{stem.format(name)}", endings)
        if file is not None and not (content == "registered" and "label" in files):
            files[content] = existing_file(file, content)
    if annotation is not None and "annotation" not in files:
        annotations = sorted(file.name for place in (root / "label", root) for file in place.glob(f"{hemi}.*.annot"))
        raise FileNotFoundError(
            f"{root}: has no label/{hemi}.{annotation}.annot; it has {', '.join(annotations) or 'no annotation'}. "
            "Name one as aparc.a2009s, without hemisphere and ending."
        )
    if (stats := root / "stats" / "aseg.stats").is_file() and stats.stat().st_size:  # no measure depends on it
        files["stats"] = stats
    return {**files, "stage": existing_file(stage, "stage record")} if staged else files


def measured_surface_fields(path: Path, hemi: str) -> dict[str, Any]:
    """Fields of a measured surface in an analysis folder: name, origin, units, portion, info, annotation."""
    fields = read_json(path, _AnalysisSummary, "Analyze it again.")["surfaces"]
    found: dict[str, Any] | None = next((entry for entry in fields if entry["hemi"] == hemi), None)
    if found is None:
        raise MissingPart(f"{path}: is not the summary of an analysis of {hemi}. Analyze it again.")
    return found


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
    file = _file_in(root, "surf", f"{hemi}.{name}")
    if file is None:
        raise FileNotFoundError(f"{root}: has no surf/{hemi}.{name}, by which maps come over to a template. {writer}")
    return existing_file(file, "registered sphere")


def _file_in(root: Path, place: str, stem: str, endings: tuple[str, ...] = SURFACE_ENDINGS) -> Path | None:
    """The first file with a stem and one of the endings in a folder of ``root``, in surf/, or in itself; or a link."""
    folders = (root / place, root / "surf", root)
    return next((f for folder in folders for end in endings if os.path.lexists(f := folder / f"{stem}{end}")), None)


def _required_surface(root: Path, stem: str) -> Path:
    place = root / "surf" if (root / "surf").is_dir() else root
    try:
        return existing_file(_file_in(root, "surf", stem) or place / stem, "surface")
    except FileNotFoundError as error:
        raise FileNotFoundError(
            f"{error} Also tried: {stem}.surf.gii, {stem}.gii. A cortex is a FreeSurfer subject (with "
            "surf/lh.white and surf/lh.pial), a simulation, or a pair given as white and pial."
        ) from None


def folded_files(path: StrPath, hemi: str, *, surface: str | None = None, sphere: str | None = None) -> dict[str, Path]:
    """The files that :func:`read_folded` reads, by content; raises if a surface does not exist."""
    root = Path(path)
    if not root.is_dir():
        files = {"surface": existing_file(root, "surface")}
        return files if sphere is None else {**files, "sphere": existing_file(Path(sphere), "sphere")}
    kind, surf = surface or WHITE, root / "surf"
    paths = {
        "surface": surf / f"{hemi}.{kind}",
        "sphere": surf / f"{hemi}.{sphere or 'sphere'}",
        "aparc.annot": root / "label" / f"{hemi}.aparc.annot",
        "cortex.label": root / "label" / f"{hemi}.cortex.label",
    }
    needed = {"surface"} if sphere is None else {"surface", "sphere"}
    files = {what: existing_file(p, what) for what, p in paths.items() if what in needed or os.path.lexists(p)}
    if "cortex.label" not in files:
        signs = {"registered": "sphere.reg", **(dict(zip(SIGNS, SIGNS)) if kind == WHITE else {})}
        files |= {what: file for what, name in signs.items() if (file := surf / f"{hemi}.{name}").is_file()}
    return files


def sample_path(name: StrPath = "") -> Path:
    """Path of a sample that comes with morphofold, e.g. ``"fsaverage5"`` or ``"S1/lh.pial.surf.gii"``.

    The folder of each sample holds a README with its origin and licence.

    Raises
    ------
    FileNotFoundError
        If there is no such sample; the message lists the samples that exist.
    """
    root = Path(str(package_files("morphofold.data_samples")))
    path = root / name
    if not path.exists():
        samples = sorted(p.name for p in root.iterdir() if p.is_dir() and not p.name.startswith("_"))
        raise FileNotFoundError(f"{name}: no such sample. The samples are {', '.join(samples)}.")
    return path
