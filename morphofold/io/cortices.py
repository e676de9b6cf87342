"""From a folder to a ``Cortex``: which files in it are those of one hemisphere, and what is in them.

What goes in is a folder: a FreeSurfer subject, a simulation or one of its stages, an analysis, a sample; or a white
and a pial file. Its files are found by their names (``cortex_files``) and read by ``morphofold.io.formats``, and their
contents, which must belong to the same vertices, come out as one ``Cortex``. Users and commands call ``read_cortex``;
``unfold`` and ``simulate`` begin from a single folded surface and call ``read_folded``.
"""

import os
import re
import warnings
from collections.abc import Callable, Mapping, Sequence
from importlib.resources import files as package_files
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from morphofold.digests_and_json import Row, clean_name, unchanged
from morphofold.errors import DoesNotApply, Mismatch, MissingPart, OptionsClash, UnlikeSurfaces, WrongFile
from morphofold.geometry import adjacency, vertex_normals
from morphofold.io.files import StrPath, existing_file, side_named
from morphofold.io.formats import read_annotation, read_label, read_morph, read_surface
from morphofold.io.freesurfer import flip_curvature_sign, read_aseg_stats, scanner_transform
from morphofold.io.json_files import Amount, Count, FileWord, Number, Record, read_json
from morphofold.io.layouts import CONTENT_OF_SPACE, FREESURFER, HEMIS, MAP_NAMES, Files, Subject, programs, subject_at
from morphofold.surface import ONE_SURFACE, Cortex, PerVertex, Surface
from morphofold.validators import one_of

OPPOSITE_R = -0.3  # correlation with the depth below; with FreeSurfer's sign it was 0.66 to 0.90 on people and averages
_SMOOTHING_ROUNDS = 20
#: what folded_files calls a file, as it stands in the records of runs -> the field of a Cortex
_FIELD_OF_FILE = {"surface": "white", "aparc.annot": "regions", "cortex.label": "cortex"}
_RECORDED_FIELDS = ("origin", "units", "portion", "info")  # fields that stage.json or summary.json may give

_PositiveSize = Annotated[float, Field(ge=1e-6, le=1e6)]


class StageHealth(Record):
    """Numbers of a stage in ``stage.json`` and ``health.json``."""

    growth: Number = 1.0
    min_J: Number = 1.0
    crossings: Count = 0
    deepest_crossing: Amount = 0.0
    mean_radius_mm: Amount | None = None


class PersonRecord(Record):
    """The surface of a person from which a cortex grew."""

    subject: str
    sha256: dict[str, str]
    unfold: Number


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
    grown_from: PersonRecord | None = None


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
    """Hemispheres with white or pial of the subject of a folder, or in the last stage of a simulation; ("lh",) if none:
    then the reader raises the error."""
    return _subject(folder).hemis or ("lh",)


def _subject(path: Path) -> Subject:
    """The subject that a folder holds; of a folder with no surface, as FreeSurfer would name them."""
    root = last_stage(path)
    return subject_at(root) or Subject(programs()["freesurfer_folders"][0], root)


def last_stage(path: Path) -> Path:
    """The folder itself, or the last stage if it is a simulation."""
    stages = path / "stages"
    if not stages.is_dir():
        return path.parent if path.name == "surf" else path
    matches = {stage: re.fullmatch(r"g(\d+(?:\.\d+)?)", stage.name) for stage in stages.iterdir() if stage.is_dir()}
    stages_by_growth = [(float(match[1]), stage) for stage, match in matches.items() if match]
    if not stages_by_growth:
        raise FileNotFoundError(
            f"{stages}: no stage (g1.20, ...) is written yet. Wait until the simulation has written one."
        )
    return max(stages_by_growth)[1]


def cortex_files(
    path: StrPath, hemi: str, *, surfaces: Sequence[str] = ("white", "pial"), annotation: str | None = None
) -> Files:
    """The files that :func:`read_cortex` reads in a folder, by content: white, pial, and the others that exist.

    Raises
    ------
    FileNotFoundError
        If a surface does not exist.
    OSError, ValueError
        If the right hemisphere of a simulated stage is requested, which does not exist; or if one of the other paths
        is not a file: a folder, a pipe, a link whose target does not exist; or if the folder holds several subjects.
    """
    subject = _subject(Path(path))
    root = subject.folder
    stage_file = root / "stage.json"
    is_stage = os.path.lexists(stage_file)
    if is_stage and hemi not in (sides := subject.hemis):
        raise DoesNotApply(f"{root}: is a simulated stage of {sides[0]}, and has no {hemi}. Request {sides[0]}.")
    files = {field: _required_surface(subject, hemi, kind) for field, kind in zip(("white", "pial"), surfaces)}
    if annotation is None and not is_stage and (summary_file := subject.other(hemi, "summary")):
        annotation = measured_surface_fields(summary_file, hemi).get("annotation")
    optional_files = {
        **{name: subject.map(hemi, name) for name in MAP_NAMES},
        **{kind: subject.surface(hemi, kind) for kind in ("inflated", "sphere")},
        "regions": subject.regions(hemi, annotation),
        "cortex": subject.other(hemi, "cortex"),
    }
    if optional_files["cortex"] is None:
        optional_files["registered"] = subject.other(hemi, "registered")
    files |= {content: existing_file(file) for content, file in optional_files.items() if file is not None}
    if annotation is not None and "regions" not in files:
        raise FileNotFoundError(
            f"{root}: has no label/{hemi}.{annotation}.annot; it has "
            f"{', '.join(subject.annotations(hemi)) or 'no annotation'}. "
            "Name one as aparc.a2009s, without hemisphere and ending."
        )
    aseg_file = subject.other(hemi, "stats")
    if aseg_file is not None and aseg_file.is_file() and aseg_file.stat().st_size:  # no measure depends on it
        files["stats"] = aseg_file
    return {**files, "stage": existing_file(stage_file, "stage record")} if is_stage else files


def measured_surface_fields(path: Path, hemi: str) -> Row:
    """Fields of a measured surface in an analysis folder: name, origin, units, portion, info, annotation."""
    for entry in read_json(path, _AnalysisSummary, "Analyze it again.")["surfaces"]:
        if entry["hemi"] == hemi:
            return dict(entry)
    raise MissingPart(f"{path}: is not the summary of an analysis of {hemi}. Analyze it again.")


def registered_sphere(path: StrPath, hemi: str, spaces: Sequence[str] = ("fsaverage",)) -> tuple[Path, str]:
    """The sphere of a folder that is registered to the first of some spaces of which it has one, and that space.

    Raises
    ------
    FileNotFoundError
        If there is none.
    """
    subject = _subject(Path(path))
    for space in spaces:
        if file := subject.other(hemi, CONTENT_OF_SPACE[space]):
            return existing_file(file, "registered sphere"), space
    raise FileNotFoundError(
        f"{path}: has no {hemi} sphere that is registered to {' or '.join(spaces)}, by which maps come over to a "
        f"template; FreeSurfer's recon-all (-surfreg) or mris_register writes such a surf/{hemi}.sphere.reg."
    )


def _required_surface(subject: Subject, hemi: str, kind: str) -> Path:
    try:
        return existing_file(subject.surface(hemi, kind) or subject.expected(hemi, kind), "surface")
    except FileNotFoundError as error:
        if subject.layout.program != FREESURFER:
            raise
        all_programs = dict.fromkeys(layout.program for layouts in programs().values() for layout in layouts)
        raise FileNotFoundError(
            f"{error} Also tried: {hemi}.{kind}.surf.gii, {hemi}.{kind}.gii. A cortex is a folder of "
            f"{', '.join(all_programs)}, a simulation, or a pair given as white and pial."
        ) from None


def folded_files(path: StrPath, hemi: str, *, surface: str | None = None, sphere: str | None = None) -> Files:
    """The files that :func:`read_folded` reads, by content; raises if a surface does not exist."""
    root, kind = Path(path), surface or "white"
    if root.is_file():
        file_paths = {"surface": path} if sphere is None else {"surface": path, "sphere": sphere}
        return {content: existing_file(file, content) for content, file in file_paths.items()}
    subject = _subject(root)
    paths = {
        "surface": subject.surface(hemi, kind) or subject.expected(hemi, kind),
        "sphere": subject.surface(hemi, sphere or "sphere") or (sphere and subject.expected(hemi, sphere)),
        "aparc.annot": subject.regions(hemi, None),
        "cortex.label": subject.other(hemi, "cortex"),
    }
    files = {content: existing_file(file, content) for content, file in paths.items() if file}
    if "cortex.label" not in files:  # these mark the cortex then
        marks = {"registered": subject.other(hemi, "registered")}
        if kind == "white":
            marks |= {"pial": subject.surface(hemi, "pial"), "thickness": subject.map(hemi, "thickness")}
        files |= {content: file for content, file in marks.items() if file is not None and file.is_file()}
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


# reading ----------------------------------------------------------------------------------------------------


def read_cortex(
    path: StrPath | None = None,
    hemi: str | None = None,
    *,
    white: StrPath | None = None,
    pial: StrPath | None = None,
    thickness: StrPath | None = None,
    mask: StrPath | None = None,
    sphere: StrPath | None = None,
    surface: StrPath | None = None,
    surfaces: Sequence[str] = ("white", "pial"),
    annotation: str | None = None,
    name: str | None = None,
) -> Cortex:
    """Read the white and pial surface of one hemisphere, or one surface alone, and the files beside them.

    Parameters
    ----------
    path : str or path, optional
        A folder: a subject of FreeSurfer, or of another program whose layout is in :mod:`morphofold.io.layouts`; a pair
        of surfaces (``lh.white.surf.gii``); a simulation (its last stage is read), or one stage of a simulation
        (``OUT/stages/g1.80``). ``DIR/NAME`` is a subject that files in ``DIR`` name, as CAT12 does.
    hemi : {"lh", "rh"}, optional
        By default ``"lh"``, or that of a simulation, or the hemisphere in the names of ``white`` and ``pial``.
    white, pial : str or path, optional
        Two files instead of a folder, in any format that ``read_surface`` reads.
    thickness, mask, sphere : str or path, optional
        Files of a pair: cortical thickness [mm], where the cortex is, and the sphere that is registered to fsaverage.
    surface : str or path, optional
        One file in place of a pair: what needs no second surface can be measured of it.
    surfaces : two names
        The inner and the outer surface of a folder to read.
    annotation : str, optional
        NAME of ``label/?h.NAME.annot`` or ``label/?h.aparc.NAME.annot`` in a folder, which gives the regions:
        ``"a2009s"`` is ``"aparc.a2009s"``. None: that of an analysis, else ``aparc`` if it exists. The file, of a pair.
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
    if [path is None, surface is None, white is None].count(False) != 1 or (white is None) != (pial is None):
        raise TypeError("Pass a folder, or both white= and pial=, or surface=.")
    others = {"thickness": thickness, "cortex": mask, "registered": sphere}
    if path is None:
        given_files = {"white": white or surface, "pial": pial, **others, "regions": annotation}
        return _cortex_of_files({key: Path(file) for key, file in given_files.items() if file is not None}, hemi, name)
    if any(file is not None for file in others.values()):
        raise OptionsClash(f"{path}: thickness, mask and sphere go with white and pial, or surface. Leave them out.")
    path = Path(path)
    if path.is_file():
        raise NotADirectoryError(
            f"{path}: is a file. Name its folder, or two files as white and pial, or one as surface."
        )
    if not path.is_dir() and subject_at(path) is None:
        existing_file(path, "folder with a cortex")  # raises, and lists close names
    root = last_stage(path)
    hemi = hemi or (hemispheres(root)[0] if os.path.lexists(root / "stage.json") else "lh")
    return read_cortex_files(root, hemi, cortex_files(root, hemi, surfaces=surfaces, annotation=annotation), name)


def _cortex_of_files(files: Files, hemi: str | None, name: str | None) -> Cortex:
    side_of_file = {file: side for file in files.values() if (side := side_named(file.name))}
    if len({*side_of_file.values()}) > 1:
        texts = [f"{file} is {side}" for file, side in side_of_file.items()]
        raise UnlikeSurfaces(f"{', '.join(texts)}. Name files of one hemisphere.")
    for file, side in side_of_file.items():
        if hemi not in (None, side):
            raise WrongFile(
                f"{file}: is named {side}, but {hemi} was requested. Request {side}, or name the other file."
            )
    existing_files = {content: existing_file(file, "surface") for content, file in files.items()}
    return read_cortex_files(None, hemi or next(iter(side_of_file.values()), "lh"), existing_files, name)


def read_cortex_files(root: Path | None, hemi: str, files: Files, name: str | None = None) -> Cortex:
    """The cortex that files hold, by content as in :func:`cortex_files`; ``root`` is their folder, if they have one."""
    with unchanged(dict.fromkeys(files.values())) as records:
        white = read_surface(files["white"])
        n_vertices = len(white.verts)
        readers: dict[str, Callable[[Path], Any]] = {
            **dict.fromkeys(("pial", "inflated", "sphere", "registered"), read_surface),
            "cortex": lambda file: read_label(file, n_vertices, hemi),
            "regions": lambda file: read_annotation(file, hemi),
            **{name: lambda file: read_morph(file, hemi) for name in MAP_NAMES},
        }
        content_of_field = {field: readers[field](file) for field, file in files.items() if field in readers}
        record = _record(root, hemi, files)
    for field, field_content in [*content_of_field.items()]:
        n_values = len(getattr(field_content, "verts", getattr(field_content, "labels", field_content)))
        if n_values == n_vertices or field == "pial":  # which a Cortex compares itself
            continue
        text = (
            f"{files[field]} has {n_values:,} vertices, {files['white']} {n_vertices:,}: it belongs to another "
            "subject or mesh. Take it from the same one, or leave it out."
        )
        if field != "registered" or root is None:
            raise Mismatch(text)
        record["info"] = {**record.get("info", {}), "sphere_unlike": text}
        del content_of_field[field]  # it would only mark the cortex
    maps = {field: content_of_field.pop(field) for field in MAP_NAMES if field in content_of_field}
    single = {} if "pial" in content_of_field else {"pial": white, "origin": ONE_SURFACE}
    return Cortex(
        white,
        hemi=hemi,
        name=clean_name(name or record["name"]),
        maps=maps if "stage" in files else in_freesurfer_signs(maps, white, files),
        transform=scanner_transform(white.geometry),
        files=tuple(map(str, files.values())),
        inputs=tuple(records),
        **content_of_field,
        **{key: record[key] for key in _RECORDED_FIELDS if key in record} | single,
    )


def _record(root: Path | None, hemi: str, files: Files) -> Row:
    """What the records in a folder say of a cortex: its name, and the fields in ``_RECORDED_FIELDS`` that are known."""
    white = files["white"]
    if root is None:
        return {"name": white.name}
    subject = _subject(root)
    folder_name = root.resolve().name
    if "stage" in files:
        info = read_json(files["stage"], StageRecord, "Simulate that stage again.")
        scene_name = info.setdefault("name", "simulation")
        name = scene_name if folder_name in scene_name else f"{scene_name} {folder_name}".strip()
        return {**info, "origin": "simulation", "name": name, "info": info}
    if summary_file := subject.other(hemi, "summary"):
        return measured_surface_fields(summary_file, hemi)
    info = read_aseg_stats(files["stats"], hemi) if "stats" in files else {}
    info |= {"in_template_space": True} if subject.layout.in_template_space else {}
    is_bare = subject.layout.program == FREESURFER and white.suffix in (".gii", ".gz")
    return {"origin": "files" if is_bare else subject.layout.program, "name": subject.name, "info": info}


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
    fields = {_FIELD_OF_FILE.get(name, name): file for name, file in files.items()}
    fields.setdefault("pial", files["surface"])
    return read_cortex_files(Path(path), hemi, fields)


def in_freesurfer_signs(
    maps: Mapping[str, PerVertex], white: Surface, files: Mapping[str, Path]
) -> dict[str, PerVertex]:
    """Maps (N,) by name, reversed with a warning where their sign is opposite to FreeSurfer's.

    ``sulc`` and ``curv``, positive in sulci, are opposite if their correlation with the depth of vertices below the
    smoothed white surface is less than ``OPPOSITE_R``; ``thickness``, if more values are negative than positive.
    """
    signed_maps = dict(maps)
    depth = _depth(white) if maps.keys() & {"curv", "sulc"} else np.empty(0)
    for name, values in maps.items():
        if name == "area":
            continue
        if name == "thickness":
            is_opposite, reason = (values < 0).sum() > (values > 0).sum(), "is negative, as in HCP's convention"
        else:
            is_finite = np.isfinite(values) & np.isfinite(depth)
            with np.errstate(invalid="ignore", divide="ignore"):  # a constant map has no correlation
                r = np.corrcoef(values[is_finite], depth[is_finite])[0, 1] if is_finite.any() else np.nan
            is_opposite, reason = r < OPPOSITE_R, f"is positive on gyri, not in sulci (correlation with depth {r:.2f})"
        if is_opposite:
            warnings.warn(f"{files[name]}: {reason}; its sign was reversed.", stacklevel=2)
            signed_maps[name] = flip_curvature_sign(values)
    return signed_maps


def _depth(white: Surface) -> PerVertex:
    """Distance (N,) [mm] of each vertex below the surface after averages over neighbours, positive in sulci."""
    neighbours = adjacency(len(white.verts), white.faces).astype(np.float64)
    n_neighbours, smooth_verts = np.maximum(np.diff(neighbours.indptr), 1)[:, None], white.verts
    for _ in range(_SMOOTHING_ROUNDS):
        smooth_verts = neighbours @ smooth_verts / n_neighbours
    normals = vertex_normals(white.verts, white.faces)
    outward = np.sign(np.nansum((white.verts - np.nanmean(white.verts, axis=0)) * normals))  # faces may be reversed
    return outward * ((smooth_verts - white.verts) * normals).sum(axis=1)
