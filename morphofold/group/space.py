"""Maps of a cohort on a template: each subject's come over through its registered sphere, then one array holds all."""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from morphofold.arrays import Array
from morphofold.group.covariates import NO_COVARIATES, Covariates
from morphofold.group.tasks import INPUT_ERRORS, Outcome, Say, TaskFolder, digest, perform, read_record
from morphofold.group.template_space import HEMIS, TEMPLATE_SURFACES, Template, digest_or_reason
from morphofold.io import atomic_folder, files_of, read_surface
from morphofold.io.cortices import SURFACE_ENDINGS
from morphofold.io.json_files import write_json
from morphofold.spheres.templates import read_own_sphere
from morphofold.tables import write_table
from morphofold.words import in_one_line

if TYPE_CHECKING:
    from morphofold.analysis.measures import Measures

SPACES = "spaces"  # folder of a cohort, with a folder for each template
LEAST_SHARE_TO_FILL = 0.5  # of a smoothing kernel on known values, from which on a hole in the cortex is filled
SUMMED_MAPS = ("area", "hinges", "crest_length")  # maps of amounts, whose sum matters; of others the mean
DISTANCES = ("hinge_distance", "crest_distance")  # interpolated, since a mean is longer near where they are 0
DENSITIES = {"hinge_density": "hinges", "crest_density": "crest_length"}  # of amounts, for each cm2 of white surface
MM2_PER_CM2 = 100.0
WIDTH = "graph_width_mm"


@dataclass(frozen=True)
class Mapped:
    """A measured subject whose maps are to come over.

    Attributes
    ----------
    name : str
    folder : str
        Its own folder, with ``surf/?h.sphere.reg``.
    measured : TaskFolder
        Of its measuring.
    results : str
        Folder of its measures.
    place : TaskFolder
    template : Template
    """

    name: str
    folder: str
    measured: TaskFolder
    results: str
    place: TaskFolder
    template: Template

    @property
    def maps(self) -> Path:
        """Folder of its maps on the template."""
        return Path(self.place.out) / "subjects" / self.name


def map_participant(subject: Mapped) -> Outcome:
    """Bring the maps of a subject over to a template, unless this was done for the same files.

    A hemisphere without a registered sphere, or with that of another mesh, fails alone.
    """
    measured = read_record(subject.measured.record)
    files = measured.get("files", {})
    hemis = [
        hemi for hemi in HEMIS if any(f"{hemi}.white" in name or f"hemi-{hemi[0].upper()}" in name for name in files)
    ]

    def key() -> str:
        if not measured.get("results"):
            raise FileNotFoundError(f"{subject.name}: has no measures, so no maps.")
        spheres = {hemi: digest_or_reason(subject.template.registration, subject.folder, hemi) for hemi in hemis}
        return digest({"measured": files, "spheres": spheres, "template": subject.template.digests()})

    return perform(
        subject.place,
        key,
        lambda: files_of(subject.maps),
        lambda say, _: _bring_over(subject, say),
        parts=max(len(hemis), 1),
    )


def _bring_over(subject: Mapped, say: Say) -> dict[str, str]:
    """Write the maps of the hemispheres that can come over; return the failures of the others."""
    from morphofold.results import read_analysis

    found, failures = {}, {}
    for m in read_analysis(subject.results):
        hemi = m.cortex.hemi
        say(f"{hemi} resampling")
        try:
            found[hemi] = _widths_of(m) | maps_on_template(
                m, subject.template.registration(subject.folder, hemi), subject.template
            )
        except INPUT_ERRORS as error:
            failures[hemi] = in_one_line(error)
            say(f"{hemi} failed: {failures[hemi]}")
    subject.maps.parent.mkdir(parents=True, exist_ok=True)
    with atomic_folder(subject.maps) as folder:
        for hemi, maps in found.items():
            single: dict[str, Any] = {name: values.astype(np.float32) for name, values in maps.items()}
            np.savez(folder / f"{hemi}.npz", **single)
    return failures


def _widths_of(m: Measures) -> dict[str, Array]:
    """The crown width of the net [mm] as an array () beside the maps; nothing if there are no folds."""
    width = m.parameters.get(WIDTH)
    return {} if width is None else {WIDTH: np.asarray(width, dtype=np.float64)}


def maps_on_template(m: Measures, sphere: str | Path, on: Template) -> dict[str, Array]:
    """The maps of one hemisphere at the vertices of a template, (P,) each.

    Parameters
    ----------
    m : Measures
    sphere : str or path
        The subject's ``?h.sphere.reg``.
    on : Template

    Returns
    -------
    dict
        Means over the white area around each vertex, NaN where less than half of a mean is known. Sums: ``area`` [mm2],
        and of the gyral graph ``hinges`` and ``crest_length`` [mm]. Interpolated: ``hinge_distance`` and
        ``crest_distance`` [mm] (:func:`~morphofold.analysis.graph.graph_rows.landmark_maps`).

        Smoothing closes holes within the template's cortex, where half of the kernel is known, and leaves NaN outside
        it. Sums and distances are not smoothed; smoothed sums over smoothed area are ``hinge_density`` [1/cm2] and
        ``crest_density`` [mm/cm2].

    Raises
    ------
    ValueError, OSError
        If the sphere is that of another mesh, or is no sphere, or the template lacks a surface.
    """
    from morphofold.analysis.graph.graph_rows import landmark_maps
    from morphofold.geometry import vertex_areas
    from morphofold.spheres.resampling import Resampling

    cortex = m.cortex
    own, there = read_own_sphere(sphere, cortex), read_surface(on.sphere(cortex.hemi))
    resampling, areas = Resampling(own, there), vertex_areas(cortex.white.verts, cortex.faces)
    maps = {**m.maps, **({} if m.graph is None else landmark_maps(cortex, m.graph))}
    found = {}
    for name, values in maps.items():
        if name in SUMMED_MAPS:
            found[name] = resampling.sums(values)
        else:
            found[name] = resampling.values(values) if name in DISTANCES else resampling.means(values, areas)
    return found if on.fwhm is None else found | _smoothed(found, on, cortex.hemi)


def _smoothed(maps: Mapping[str, Array], on: Template, hemi: str) -> dict[str, Array]:
    """The smoothed maps, and densities."""
    from morphofold.analysis.smoothing import smooth
    from morphofold.geometry import vertex_areas

    assert on.fwhm is not None
    white = read_surface(on.surface(hemi, "white"))
    around, inside = vertex_areas(white.verts, white.faces), on.cortex(hemi, len(white.verts))
    means = {name: values for name, values in maps.items() if name not in (*SUMMED_MAPS, *DISTANCES)}
    spread = {name: maps[name] / around for name in SUMMED_MAPS if name in maps}  # for each mm2 of the template
    columns = np.column_stack([*means.values(), *spread.values()])
    fill = None if inside is None else LEAST_SHARE_TO_FILL
    smoothed = smooth(white.verts, white.faces, columns, on.fwhm, inside, fill=fill).T
    found = dict(zip([*means, *spread], smoothed))
    densities = {
        density: MM2_PER_CM2 * np.divide(found[name], found["area"])
        for density, name in DENSITIES.items()
        if {name, "area"} <= spread.keys()
    }
    return {name: found[name] for name in means} | densities


def write_space(
    out: Path, on: Template, subjects: Sequence[Mapped], covariates: Covariates = NO_COVARIATES
) -> dict[str, tuple[int, int]]:
    """Write ``out/group``: for each map and hemisphere one array of all subjects, completely or not at all.

    ``?h.MAP.npy`` is float32 (subjects, vertices), NaN where a subject has no value; ``participants.tsv`` has the
    subjects in the order of the rows, their covariates, and 1 where a hemisphere has maps; ``surf`` and ``label`` are
    the template's.
    Returns the shape of each array by its name.
    """
    with atomic_folder(out / "group") as folder:
        shapes: dict[str, tuple[int, int]] = {}
        widths: list[float] = []
        rows: list[dict[str, Any]] = [{"participant_id": one.name, **covariates.of(one.name)} for one in subjects]
        for hemi in HEMIS:
            files = [one.maps / f"{hemi}.npz" for one in subjects]
            for row, file in zip(rows, files):
                row[hemi] = int(file.is_file())
            shapes |= _write_arrays(folder, hemi, files, widths)
        write_table(folder / "participants.tsv", ("participant_id", *covariates.columns, *HEMIS), rows)
        _copy_template(on, folder)
        content = {
            "template": on.name,
            "smoothing_fwhm_mm": on.fwhm,
            "summed": list(SUMMED_MAPS),
            "one_side": on.xhemi,
            "symmetric": on.is_symmetric(),
            WIDTH: float(np.median(widths)) if widths else None,
            "arrays": shapes,
        }
        write_json(folder / "space.json", content)
    return shapes


def _write_arrays(folder: Path, hemi: str, files: Sequence[Path], widths: list[float]) -> dict[str, tuple[int, int]]:
    """Write ``HEMI.MAP.npy`` of all maps in the subjects' files; append their crown widths; return the shapes."""
    arrays: dict[str, Any] = {}
    for k, file in enumerate(files):
        if not file.is_file():
            continue
        with np.load(file) as maps:
            for name in maps.files:
                values = maps[name]
                if name == WIDTH:
                    widths.append(float(values))
                    continue
                if name not in arrays:
                    shape, place = (len(files), len(values)), folder / f"{hemi}.{name}.npy"
                    arrays[name] = np.lib.format.open_memmap(place, mode="w+", dtype=np.float32, shape=shape)
                    arrays[name][:] = np.nan
                arrays[name][k] = values
    for array in arrays.values():
        array.flush()
    return {f"{hemi}.{name}": arrays[name].shape for name in sorted(arrays)}


def _copy_template(on: Template, folder: Path) -> None:
    """Copy the template's surfaces and labels, so that the arrays can be drawn without it."""
    for place in ("surf", "label"):
        (folder / place).mkdir()
    for hemi in ("lh",) if on.xhemi else HEMIS:
        files = [
            Path(on.folder) / "surf" / f"{hemi}.{kind}{end}" for kind in TEMPLATE_SURFACES for end in SURFACE_ENDINGS
        ]
        files += [on.label(hemi, name) for name in ("cortex.label", "aparc.annot")]
        for file in files:
            if file.is_file():
                shutil.copyfile(file, folder / file.parent.name / file.name)
