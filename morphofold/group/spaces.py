"""Maps of a cohort on a template: each subject's come over through its registered sphere, then one array holds all.

``write_space`` writes the arrays for ``cohort --space``, ``find_space`` finds them for statistics.
"""

import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np
from pydantic import ConfigDict

from morphofold.analysis import Measures
from morphofold.analysis.graph.gyral_tables import landmark_maps
from morphofold.analysis.smoothing import smooth
from morphofold.digests_and_json import Row, sha256_of
from morphofold.errors import DamagedFile, MissingPart, UnknownName
from morphofold.frozen_arrays import Array, Bools, Ints
from morphofold.geometry import vertex_areas
from morphofold.group import task_records
from morphofold.group.measure_subject import Participant
from morphofold.group.subjects import NO_COVARIATES, PARTICIPANTS_FILE, Covariates
from morphofold.io import (
    atomic_folder,
    files_of,
    read_surface,
    write_annotation,
    write_gifti_map,
    write_label,
    write_morph,
)
from morphofold.io.cifti import write_dscalar
from morphofold.io.files import StrPath
from morphofold.io.json_files import Amount, Record, read_json, write_json
from morphofold.io.layouts import CONTENT_OF_SPACE, HEMIS
from morphofold.io.layouts.freesurfer_folders import SURFACE_ENDINGS
from morphofold.number_texts import in_one_line
from morphofold.results import read_analysis
from morphofold.spheres.resampling import Resampling
from morphofold.spheres.template_folders import TemplateFolder, find_template, freesurfer_subject, read_own_sphere
from morphofold.tables import read_table, write_table
from morphofold.validators import positive

FS_LR = "fsLR"  # begins the names of templates whose users expect CIFTI
SPACES_FOLDER = "spaces"  # folder of a cohort, with a folder for each template
RERUN_ADVICE = "Run cohort --space again."
SYMMETRY_TOLERANCE = 1e-4  # of the radius, between a vertex of the left sphere and the mirrored one of the right
TEMPLATE_SURFACES = ("white", "pial", "inflated", "sphere", "sphere.reg")
LEAST_SHARE_TO_FILL = 0.5  # of a smoothing kernel on known values, from which on a hole in the cortex is filled
SUMMED_MAPS = ("area", "hinges", "crest_length")  # maps of amounts, whose sum matters; of others the mean
DISTANCE_MAPS = ("hinge_distance", "crest_distance")  # interpolated, since a mean is longer near where they are 0
DENSITY_MAPS = {"hinge_density": "hinges", "crest_density": "crest_length"}  # of amounts, for each cm2 of white surface
MM2_PER_CM2 = 100.0
WIDTH_KEY = "graph_width_mm"


@dataclass(frozen=True)
class Template(TemplateFolder):
    """A template to which maps come over, and how they are smoothed on it.

    Attributes
    ----------
    files : Subject
        With ``surf/?h.sphere.reg`` or, of a template that others are registered to, ``surf/?h.sphere``.
    fwhm : float or None
        Full width at half maximum [mm] of the smoothing along its white surface.
    """

    fwhm: float | None = None

    @property
    def folder_name(self) -> str:
        """Name of the folder for maps on it."""
        return self.name + (f"-fwhm{self.fwhm:g}" if self.fwhm is not None else "")

    def is_symmetric(self) -> bool:
        """Whether vertex i of its left hemisphere belongs to vertex i of the right one: their spheres are mirrored."""
        if len(self.hemis) < 2:
            return False
        left, right = (self.sphere(hemi).verts for hemi in HEMIS)
        tolerance = SYMMETRY_TOLERANCE * np.abs(left).max()
        return left.shape == right.shape and np.allclose(left * (-1, 1, 1), right, rtol=0, atol=tolerance)

    def digests(self) -> Row:
        """Digests of the files on which maps depend, or why there is none, and the smoothing."""
        spheres = [partial(self.sphere_file, space=space) for space in CONTENT_OF_SPACE]
        file_finders: list[Callable[..., Path | None]] = [*spheres, self.surface_file, self.cortex_file]
        return {"fwhm": self.fwhm} | {hemi: [digest_or_reason(find, hemi) for find in file_finders] for hemi in HEMIS}


def template(name: StrPath, fwhm: float | None = None) -> Template:
    """The template of a name: a folder, or a sample such as ``"fsaverage5"``.

    Raises
    ------
    FileNotFoundError
        If there is neither.
    ValueError
        If ``fwhm`` is not a positive length, or the folder has no sphere, or no white surface.
    """
    if fwhm is not None:
        positive(fwhm, "the smoothing")
    chosen_template = Template(find_template(name).files, fwhm)
    for hemi in chosen_template.hemis or HEMIS[:1]:
        chosen_template.sphere_file(hemi)
        chosen_template.surface_file(hemi)  # which statistics need, too
    return chosen_template


def digest_or_reason(find_file: Callable[..., Path | None], *find_args: StrPath) -> str:
    try:
        file = find_file(*find_args)
        return "" if file is None else sha256_of(file)
    except task_records.INPUT_ERRORS as error:
        return str(error)


@dataclass(frozen=True)
class Mapped:
    """A measured subject whose maps are to come over, with ``surf/?h.sphere.reg`` in its own folder."""

    subject: Participant
    task_folder: task_records.TaskFolder
    template: Template

    @property
    def maps(self) -> Path:
        """Folder of its maps on the template."""
        return Path(self.task_folder.out) / "subjects" / self.task_folder.name


def map_participant(task: Mapped) -> task_records.Outcome:
    """Bring the maps of a subject over to a template, unless this was done for the same files.

    A hemisphere without a registered sphere, or with that of another mesh, fails alone.
    """
    subject = task.subject
    old_record = task_records.read_record(subject.task_folder.record)
    digests = old_record.get("files", {})
    hemis = [
        hemi for hemi in HEMIS if any(f"{hemi}.white" in file or f"hemi-{hemi[0].upper()}" in file for file in digests)
    ]

    def key() -> str:
        if not old_record.get("results"):
            raise FileNotFoundError(f"{subject.name}: has no measures, so no maps.")
        own_sphere = lambda hemi: task.template.sphere_pair(subject.folder, hemi)[0]
        sphere_digests = {hemi: digest_or_reason(own_sphere, hemi) for hemi in hemis}
        return task_records.digest(
            {"measured": digests, "spheres": sphere_digests, "template": task.template.digests()}
        )

    return task_records.perform(
        task.task_folder, key, lambda: files_of(task.maps), lambda log, _: _bring_over(task, log), max(len(hemis), 1)
    )


def _bring_over(task: Mapped, log: task_records.TaskLog) -> dict[str, str]:
    """Write the maps of the hemispheres that can come over; return the failures of the others."""
    maps_by_hemi, failures = {}, {}
    for measures in read_analysis(task.subject.results):
        hemi = measures.cortex.hemi
        log(f"{hemi} resampling")
        try:
            spheres = task.template.sphere_pair(task.subject.folder, hemi)
            maps_by_hemi[hemi] = maps_on_template(measures, *spheres, task.template)
            if (crown_width := measures.parameters.get(WIDTH_KEY)) is not None:  # of the net; none without folds [mm]
                maps_by_hemi[hemi][WIDTH_KEY] = np.asarray(crown_width, dtype=np.float64)
        except task_records.INPUT_ERRORS as error:
            failures[hemi] = in_one_line(error)
            log(f"{hemi} failed: {failures[hemi]}")
    task.maps.parent.mkdir(parents=True, exist_ok=True)
    with atomic_folder(task.maps) as folder:
        for hemi, maps in maps_by_hemi.items():
            float32_maps: Row = {map_name: map_values.astype(np.float32) for map_name, map_values in maps.items()}
            np.savez(folder / f"{hemi}.npz", **float32_maps)
    return failures


def maps_on_template(
    measures: Measures, sphere_file: StrPath, template_sphere: StrPath, template: Template
) -> dict[str, Array]:
    """The maps of one hemisphere at the vertices of a template, (P,) each.

    Parameters
    ----------
    measures : Measures
    sphere_file, template_sphere : str or path
        The registered spheres of the subject, such as ``?h.sphere.reg``, and of the template in the same space.
    template : Template

    Returns
    -------
    dict
        Means over the white area around each vertex, NaN where less than half of a mean is known. Sums: ``area`` [mm2],
        and of the gyral graph ``hinges`` and ``crest_length`` [mm]. Interpolated: ``hinge_distance`` and
        ``crest_distance`` [mm] (:func:`~morphofold.analysis.graph.gyral_tables.landmark_maps`).

        Smoothing closes holes within the template's cortex, where half of the kernel is known, and leaves NaN outside
        it. Sums and distances are not smoothed; smoothed sums over smoothed area are ``hinge_density`` [1/cm2] and
        ``crest_density`` [mm/cm2].

    Raises
    ------
    ValueError, OSError
        If the sphere is that of another mesh, or is no sphere, or the template lacks a surface.
    """
    cortex = measures.cortex
    resampling = Resampling(read_own_sphere(sphere_file, cortex), read_surface(template_sphere))
    areas = vertex_areas(cortex.white.verts, cortex.faces)
    maps = {**measures.maps, **({} if measures.graph is None else landmark_maps(cortex, measures.graph))}
    for name, map_values in maps.items():
        if name in SUMMED_MAPS:
            maps[name] = resampling.sums(map_values)
        else:
            maps[name] = resampling.values(map_values) if name in DISTANCE_MAPS else resampling.means(map_values, areas)
    return maps if template.fwhm is None else maps | _smoothed(maps, template, template.fwhm, cortex.hemi)


def _smoothed(maps: Mapping[str, Array], template: Template, fwhm: float, hemi: str) -> dict[str, Array]:
    """The smoothed maps, and densities."""
    white = template.surface(hemi)
    vertex_area, is_cortex, least_share = vertex_areas(white.verts, white.faces), None, None
    if template.cortex_file(hemi) is not None:
        is_cortex, least_share = template.cortex(hemi), LEAST_SHARE_TO_FILL
    mean_maps = {name: values for name, values in maps.items() if name not in (*SUMMED_MAPS, *DISTANCE_MAPS)}
    densities = {name: maps[name] / vertex_area for name in SUMMED_MAPS if name in maps}  # for each mm2 of the template
    map_columns = np.column_stack([*mean_maps.values(), *densities.values()])
    smoothed_columns = smooth(white.verts, white.faces, map_columns, fwhm, is_cortex, fill=least_share).T
    columns_by_name = dict(zip([*mean_maps, *densities], smoothed_columns))
    if "area" in columns_by_name:
        for density, name in DENSITY_MAPS.items():
            if name in densities:
                columns_by_name[density] = MM2_PER_CM2 * np.divide(columns_by_name[name], columns_by_name["area"])
    return {name: values for name, values in columns_by_name.items() if name not in densities}


def write_space(
    out: Path, template: Template, subjects: Sequence[Mapped], covariates: Covariates = NO_COVARIATES
) -> dict[str, tuple[int, int]]:
    """Write ``out/group``: for each map and hemisphere one array of all subjects, completely or not at all.

    ``?h.MAP.npy`` is float32 (subjects, vertices), NaN where a subject has no value; ``participants.tsv`` has the
    subjects in the order of the rows, their covariates, and 1 where a hemisphere has maps; ``surf`` and ``label`` are
    the template's. On fs_LR, ``MAP.dscalar.nii`` has the same with a named row for each subject.
    Returns the shape of each array by its name.
    """
    memmaps, crown_widths, participant_rows = Row(), list[float](), list[Row]()
    with atomic_folder(out / "group") as folder:
        for row, task in enumerate(subjects):
            participant_rows.append({"participant_id": task.task_folder.name, **covariates.of(task.task_folder.name)})
            for hemi in HEMIS:
                maps_file = task.maps / f"{hemi}.npz"
                participant_rows[row][hemi] = int(maps_file.is_file())
                for name, map_values in np.load(maps_file).items() if maps_file.is_file() else ():
                    stem = f"{hemi}.{name}"
                    if name == WIDTH_KEY:
                        crown_widths.append(float(map_values))
                        continue
                    if stem not in memmaps:
                        shape = len(subjects), len(map_values)
                        memmaps[stem] = np.lib.format.open_memmap(folder / f"{stem}.npy", "w+", np.float32, shape)
                        memmaps[stem][:] = np.nan
                    memmaps[stem][row] = map_values
        write_table(folder / PARTICIPANTS_FILE, ("participant_id", *covariates.columns, *HEMIS), participant_rows)
        _copy_template(template, folder)
        if template.name.startswith(FS_LR):
            _write_cifti(memmaps, template, [task.task_folder.name for task in subjects], folder)
        shapes = {name: memmaps[name].shape for name in sorted(memmaps)}
        space_record = {
            "template": template.name,
            "smoothing_fwhm_mm": template.fwhm,
            "summed": list(SUMMED_MAPS),
            "symmetric": template.is_symmetric(),
            WIDTH_KEY: float(np.median(crown_widths)) if crown_widths else None,
            "arrays": shapes,
        }
        write_json(folder / "space.json", space_record)
    return shapes


def _write_cifti(maps: Mapping[str, Array], template: Template, names: Sequence[str], folder: Path) -> None:
    """Write ``MAP.dscalar.nii`` of each map, with a row per subject."""
    is_cortex = {hemi: template.cortex(hemi) for hemi in template.hemis}
    for map_name in sorted({stem[3:] for stem in maps}):
        side_maps = {hemi: maps[f"{hemi}.{map_name}"] for hemi in template.hemis if f"{hemi}.{map_name}" in maps}
        rows = {name: {hemi: side_maps[hemi][k] for hemi in side_maps} for k, name in enumerate(names)}
        write_dscalar(folder / f"{map_name}.dscalar.nii", rows, is_cortex)


def _copy_template(template: Template, folder: Path) -> None:
    """Copy the template's surfaces and labels, so that the arrays can be drawn without it."""
    for name in ("surf", "label"):
        (folder / name).mkdir()
    for hemi in template.hemis:
        surface_files = {kind: template.files.surface(hemi, kind) for kind in TEMPLATE_SURFACES}
        surface_files |= {"sphere": surface_files["sphere"] or template.sphere_file(hemi)}
        for kind, file in surface_files.items():
            if file is not None:
                ending = next((end for end in SURFACE_ENDINGS[1:] if file.name.endswith(end)), "")
                shutil.copyfile(file, folder / "surf" / f"{hemi}.{kind}{ending}")
        if template.cortex_file(hemi) is not None:
            write_label(folder / "label" / f"{hemi}.cortex.label", template.cortex(hemi), template.surface(hemi).verts)
        if (regions := template.regions(hemi)) is not None:
            write_annotation(folder / "label" / f"{hemi}.aparc.annot", regions)


class SpaceRecord(Record):
    """``space.json``: whether vertex i of one hemisphere belongs to vertex i of the other, the median crown width of
    the subjects [mm], and the smoothing."""

    model_config = ConfigDict(frozen=True)

    symmetric: bool = False
    graph_width_mm: Amount | None = None
    smoothing_fwhm_mm: Amount | None = None


@dataclass(frozen=True, eq=False, repr=False)
class Space(TemplateFolder):
    """Maps of a study on a template.

    Attributes
    ----------
    files : Subject
        In the folder that ``cohort --space`` wrote: ``spaces/TEMPLATE/group``.
    subjects : tuple of str
        In the order of the rows.
    has_maps : mapping of hemisphere to (S,) bool
        Which subjects have maps of it.
    about : SpaceRecord
    covariates : tuple of str
        Columns of the participants that ``cohort`` knew, such as age.
    """

    subjects: tuple[str, ...] = ()
    has_maps: Mapping[str, Bools] = field(default_factory=dict)
    record: SpaceRecord = field(default_factory=SpaceRecord)
    covariates: tuple[str, ...] = ()

    def __repr__(self) -> str:
        return f"Space({str(self.folder)!r}, {len(self.subjects)} subjects, {' and '.join(self.has_maps)})"

    def map(self, hemi: str, name: str) -> Array:
        """A map (S, N) of all subjects; raises if there is none."""
        array_file = self.folder / f"{hemi}.{name}.npy"
        map_names = sorted({path.stem[3:] for path in self.folder.glob("?h.*.npy")})
        if name not in map_names:
            raise UnknownName(f"{name!r}: no such map in {self.folder}; they are {', '.join(map_names)}.")
        shape = len(self.subjects), len(self.surface(hemi).verts)
        try:
            map_values = np.load(array_file, mmap_mode="r")
        except FileNotFoundError:
            raise MissingPart(f"{array_file}: is missing, though the other side has this map. {RERUN_ADVICE}") from None
        except (ValueError, EOFError):  # numpy advises to allow pickles
            map_values = None
        if getattr(map_values, "shape", None) != shape or map_values.dtype.kind not in "fiu":
            raise DamagedFile(
                f"{array_file}: is no array of numbers of shape {shape}, the rows of {self.folder / PARTICIPANTS_FILE} "
                f"and the vertices of the template. {RERUN_ADVICE}"
            )
        return map_values

    def areas(self, hemi: str, subject_rows: Ints) -> Array:
        """Mean white area of some subjects at each vertex (N,) [mm^2]; the template's if the study has no map of it."""
        try:
            area_maps = np.asarray(self.map(hemi, "area"), dtype=np.float64)
        except UnknownName:
            white = self.surface(hemi)
            return vertex_areas(white.verts, white.faces)
        return np.nan_to_num(np.nanmean(area_maps[subject_rows], axis=0))


def find_space(study: StrPath, name: str | None = None) -> Space:
    """The space of a study: that of a template's name, also without its density or smoothing, or the only one.

    Raises
    ------
    FileNotFoundError
        If there is none.
    ValueError
        If there are several and none is named, or it is damaged.
    """
    spaces_folder = Path(study) / SPACES_FOLDER
    space_names = sorted(path.parent.parent.name for path in spaces_folder.glob("*/group/space.json"))
    matches = [key for key in space_names if key == name] or [k for k in space_names if k.startswith(name or "")]
    if not matches:
        raise FileNotFoundError(
            f"{study}: has no maps on {name or 'a template'}; its templates: {', '.join(space_names) or 'none'}. "
            f"Run: morphofold cohort SUBJECTS_DIR -o {study} --space {name or 'fsaverage5'}"
        )
    if len(matches) > 1:
        raise UnknownName(f"{study}: has maps in several spaces: {', '.join(matches)}. Name one with --space.")
    group_folder = spaces_folder / matches[0] / "group"
    table_file = group_folder / PARTICIPANTS_FILE
    rows = read_table(table_file, text_columns=("participant_id",), number_columns=HEMIS)
    subjects = tuple(row.get("participant_id", "") for row in rows)
    if not rows or len({*subjects}) < len(rows) or not rows[0].keys() >= {*HEMIS}:
        raise DamagedFile(f"{table_file}: lacks rows, a column or names, or has a name twice. {RERUN_ADVICE}")
    hemis = {hemi: np.array([row[hemi] == 1 for row in rows]) for hemi in HEMIS}
    record = SpaceRecord(**read_json(group_folder / "space.json", SpaceRecord, RERUN_ADVICE))
    covariates = tuple(column for column in rows[0] if column not in ("participant_id", *HEMIS))
    return Space(freesurfer_subject(group_folder), subjects, hemis, record, covariates)


def write_results(
    out: StrPath,
    space: Space,
    maps: Mapping[str, Mapping[str, Array]],
    table: tuple[str, Sequence[str], Sequence[Row]],
    summary: Row,
    draw: Callable[[Path], object] | None,
) -> Path:
    """Write maps by name and hemisphere as GIFTI and FreeSurfer files, on fs_LR also as CIFTI, a table, a summary and
    a page, completely or not at all. Where they are unknown, FreeSurfer's have p = 1, or 0."""
    with atomic_folder(out) as folder:
        maps_folder = folder / "maps"
        maps_folder.mkdir()
        for map_name, side_maps in maps.items():
            for hemi, values in side_maps.items():
                write_gifti_map(maps_folder / f"{hemi}.{map_name}.shape.gii", values, nan=np.nan, hemi=hemi)
                write_morph(maps_folder / f"{hemi}.{map_name}", values, nan=1.0 if "p" in map_name.split("_") else 0.0)
            if space.folder.parent.name.startswith(FS_LR):
                is_cortex = {hemi: space.cortex(hemi) for hemi in side_maps}
                write_dscalar(maps_folder / f"{map_name}.dscalar.nii", {map_name: side_maps}, is_cortex)
        write_table(folder / table[0], *table[1:])
        write_json(folder / "summary.json", summary)
        if draw is not None:
            draw(folder)
    return Path(out)
