"""Maps of a cohort on a template: each subject's come over through its registered sphere, then one array holds all."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from morphofold.arrays import Array
from morphofold.cohort.covariates import NO_COVARIATES, Covariates
from morphofold.cohort.tasks import INPUT_ERRORS, Outcome, Say, TaskFolder, digest, perform, read_record
from morphofold.errors import MissingPart, OutOfRange
from morphofold.io import atomic_folder, files_of, read_label, read_surface
from morphofold.io.cortices import SURFACE_ENDINGS, registered_sphere
from morphofold.provenance import sha256_of, strict_json
from morphofold.spheres.templates import read_own_sphere, template_folder, template_sphere, template_surface
from morphofold.tables import write_table
from morphofold.words import in_one_line

if TYPE_CHECKING:
    from morphofold.analysis.measures import Measures

HEMIS = ("lh", "rh")
SPACES = "spaces"  # folder of a cohort, with a folder for each template
LEAST_SHARE_TO_FILL = 0.5  # of a smoothing kernel on known values, from which on a hole in the cortex is filled
SUMMED_MAPS = ("area",)  # maps of amounts, whose sum matters; of others the mean
TEMPLATE_SURFACES = ("white", "pial", "inflated", "sphere", "sphere.reg")


@dataclass(frozen=True)
class Template:
    """A template, and how maps are smoothed on it.

    Attributes
    ----------
    name : str
    folder : str
        With ``surf/?h.sphere.reg`` or, of a template that others are registered to, ``surf/?h.sphere``.
    fwhm : float or None
        Full width at half maximum [mm] of the smoothing along its white surface.
    """

    name: str
    folder: str
    fwhm: float | None = None

    @property
    def place(self) -> str:
        """Name of the folder for maps on it."""
        return self.name if self.fwhm is None else f"{self.name}-fwhm{self.fwhm:g}"

    def sphere(self, hemi: str) -> Path:
        """The file of its sphere."""
        return template_sphere(self.folder, hemi)

    def cortex(self, hemi: str, n: int) -> NDArray[np.bool_] | None:
        """Its cortex (n,), by ``label/?h.cortex.label``; None if it has none."""
        file = Path(self.folder) / "label" / f"{hemi}.cortex.label"
        return read_label(file, n) if file.is_file() else None

    def has_sphere(self, hemi: str) -> bool:
        """Whether it has that hemisphere."""
        try:
            self.sphere(hemi)
        except MissingPart:
            return False
        return True

    def digests(self) -> dict[str, Any]:
        """Digests of the files on which maps depend, or why there is none, and the smoothing."""
        found: dict[str, Any] = {"fwhm": self.fwhm}
        for hemi in HEMIS:
            found[hemi] = [_digest_or_reason(self.sphere, hemi)]
            if self.fwhm is not None:
                label = Path(self.folder) / "label" / f"{hemi}.cortex.label"
                found[hemi] += [_digest_or_reason(self.surface, hemi, "white"), _digest_or_reason(Path, label)]
        return found

    def surface(self, hemi: str, kind: str) -> Path:
        """The file of one of its surfaces; raises if there is none."""
        return template_surface(self.folder, hemi, kind)


def template(name: str, fwhm: float | None = None) -> Template:
    """The template of a name: a folder, or a sample such as ``"fsaverage5"``.

    Raises
    ------
    FileNotFoundError
        If there is neither.
    ValueError
        If ``fwhm`` is not a positive length, or the folder has no sphere, or no white surface to smooth along.
    """
    if fwhm is not None and not (np.isfinite(fwhm) and fwhm > 0):
        raise OutOfRange(f"smoothing must be a positive width in mm, got {fwhm!r}.")
    folder = template_folder(name)
    found = Template(folder.name, str(folder), fwhm)
    hemis = [hemi for hemi in HEMIS if found.has_sphere(hemi)]
    if not hemis:
        found.sphere(HEMIS[0])  # raises
    for hemi in hemis if fwhm is not None else ():
        found.surface(hemi, "white")
    return found


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
        spheres = {hemi: _digest_or_reason(registered_sphere, subject.folder, hemi) for hemi in hemis}
        return digest({"measured": files, "spheres": spheres, "template": subject.template.digests()})

    return perform(
        subject.place,
        key,
        lambda: files_of(subject.maps),
        lambda say, _: _bring_over(subject, say),
        parts=max(len(hemis), 1),
    )


def _digest_or_reason(find: Callable[..., Path], *what: str | Path) -> str:
    try:
        return sha256_of(find(*what))
    except INPUT_ERRORS as error:
        return str(error)


def _bring_over(subject: Mapped, say: Say) -> dict[str, str]:
    """Write the maps of the hemispheres that can come over; return the failures of the others."""
    from morphofold.results import read_analysis

    found, failures = {}, {}
    for m in read_analysis(subject.results):
        hemi = m.cortex.hemi
        say(f"{hemi} resampling")
        try:
            found[hemi] = maps_on_template(m, registered_sphere(subject.folder, hemi), subject.template)
        except INPUT_ERRORS as error:
            failures[hemi] = in_one_line(error)
            say(f"{hemi} failed: {failures[hemi]}")
    subject.maps.parent.mkdir(parents=True, exist_ok=True)
    with atomic_folder(subject.maps) as folder:
        for hemi, maps in found.items():
            single: dict[str, Any] = {name: values.astype(np.float32) for name, values in maps.items()}
            np.savez(folder / f"{hemi}.npz", **single)
    return failures


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
        Means over the white area around each vertex; of ``area`` the sum [mm^2]. NaN where less than half of a mean is
        known. Smoothing closes holes within the template's cortex, where half of the kernel is known, and leaves NaN
        outside it. Areas are not smoothed.

    Raises
    ------
    ValueError, OSError
        If the sphere is that of another mesh, or is no sphere, or the template lacks a surface.
    """
    from morphofold.analysis.smoothing import smooth
    from morphofold.geometry import vertex_areas
    from morphofold.spheres.resampling import Resampling

    cortex = m.cortex
    own, there = read_own_sphere(sphere, cortex), read_surface(on.sphere(cortex.hemi))
    resampling, areas = Resampling(own, there), vertex_areas(cortex.white.verts, cortex.faces)
    found = {
        name: resampling.sums(values) if name in SUMMED_MAPS else resampling.means(values, areas)
        for name, values in m.maps.items()
    }
    means = [name for name in found if name not in SUMMED_MAPS]
    if on.fwhm is not None and means:
        white = read_surface(on.surface(cortex.hemi, "white"))
        inside = on.cortex(cortex.hemi, len(white.verts))
        fill = None if inside is None else LEAST_SHARE_TO_FILL
        both = np.column_stack([found[name] for name in means])
        smoothed = smooth(white.verts, white.faces, both, on.fwhm, inside, fill=fill)
        found |= dict(zip(means, smoothed.T))
    return found


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
        shapes = {}
        rows: list[dict[str, Any]] = [{"participant_id": one.name, **covariates.of(one.name)} for one in subjects]
        for hemi in HEMIS:
            files = [one.maps / f"{hemi}.npz" for one in subjects]
            for row, file in zip(rows, files):
                row[hemi] = int(file.is_file())
            for name, n in _maps_of(files).items():
                shapes[f"{hemi}.{name}"] = len(subjects), n
                array = np.lib.format.open_memmap(
                    folder / f"{hemi}.{name}.npy", mode="w+", dtype=np.float32, shape=(len(subjects), n)
                )
                for k, file in enumerate(files):
                    array[k] = _map_in(file, name, n)
                array.flush()
                del array
        write_table(folder / "participants.tsv", ("participant_id", *covariates.columns, *HEMIS), rows)
        _copy_template(on, folder)
        content = {"template": on.name, "smoothing_fwhm_mm": on.fwhm, "summed": list(SUMMED_MAPS), "arrays": shapes}
        (folder / "space.json").write_text(strict_json(content), encoding="utf-8")
    return shapes


def _maps_of(files: Sequence[Path]) -> Mapping[str, int]:
    """The maps that any of these files has, and their number of vertices."""
    found: dict[str, int] = {}
    for file in files:
        if file.is_file():
            with np.load(file) as maps:
                found |= {name: len(maps[name]) for name in maps.files if name not in found}
    return dict(sorted(found.items()))


def _map_in(file: Path, name: str, n: int) -> Array:
    if file.is_file():
        with np.load(file) as maps:
            if name in maps.files:
                return np.asarray(maps[name])
    return np.full(n, np.nan)


def _copy_template(on: Template, folder: Path) -> None:
    """Copy the template's surfaces and labels, so that the arrays can be drawn without it."""
    for place in ("surf", "label"):
        (folder / place).mkdir()
    for hemi in HEMIS:
        files = [
            Path(on.folder) / "surf" / f"{hemi}.{kind}{end}" for kind in TEMPLATE_SURFACES for end in SURFACE_ENDINGS
        ]
        files += [Path(on.folder) / "label" / f"{hemi}.{name}" for name in ("cortex.label", "aparc.annot")]
        for file in files:
            if file.is_file():
                shutil.copyfile(file, folder / file.parent.name / file.name)
