"""Templates to which subjects are registered by ``?h.sphere.reg``: their files, and parcellations carried from them."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from morphofold.digests_and_json import unchanged
from morphofold.errors import Mismatch, MissingPart
from morphofold.frozen_arrays import Bools, memoized
from morphofold.geometry import vertex_areas
from morphofold.io import read_annotation, read_cortex, read_label, read_surface, sample_path
from morphofold.io.cortices import cortex_files, registered_sphere
from morphofold.io.files import StrPath
from morphofold.io.json_files import file_word
from morphofold.io.layouts.freesurfer_folders import SURFACE_ENDINGS
from morphofold.spheres.resampling import Resampling
from morphofold.surface import Cortex, Faces, Regions, Surface, Verts

LABELLED_TEMPLATE = "fsaverage5"  # the sample whose cortex label is carried over
DEFAULT_ANNOTATION = "aparc"
HEMIS = ("lh", "rh")


@dataclass(frozen=True)
class TemplateFolder:
    """The surfaces and labels of a template, in a folder as that of a FreeSurfer subject."""

    folder: Path

    def surface_file(self, hemi: str, kind: str = "white") -> Path:
        """The file ``surf/?h.KIND``, in either format; raises ``MissingPart`` if there is none."""
        stem = self.folder / "surf" / f"{hemi}.{kind}"
        path = next((file for end in SURFACE_ENDINGS if (file := stem.with_name(stem.name + end)).is_file()), None)
        if path is None:
            raise MissingPart(f"{self.folder}: has no surf/{stem.name}, which a template needs.")
        return path

    def sphere_file(self, hemi: str) -> Path:
        """``surf/?h.sphere.reg``, or ``?h.sphere`` of a template that others are registered to; else raises
        ``MissingPart``."""
        try:
            return registered_sphere(self.folder, hemi)
        except FileNotFoundError:
            return self.surface_file(hemi, "sphere")

    def label_file(self, hemi: str, name: str) -> Path:
        """Where one of its labels is, if it has it."""
        return self.folder / "label" / f"{hemi}.{name}"

    def surface(self, hemi: str, kind: str = "white") -> Surface:
        """A surface of the template."""
        return read_surface(self.surface_file(hemi, kind))

    def sphere(self, hemi: str) -> Surface:
        """The template's registered sphere."""
        return read_surface(self.sphere_file(hemi))

    def cortex(self, hemi: str) -> Bools:
        """The template's cortex (N,); everywhere if it has no label."""
        n_vertices, label_file = len(self.surface(hemi).verts), self.label_file(hemi, "cortex.label")
        return read_label(label_file, n_vertices) if label_file.is_file() else np.ones(n_vertices, dtype=bool)

    def regions(self, hemi: str) -> Regions | None:
        """The template's parcellation, if it has one."""
        annotation_file = self.label_file(hemi, "aparc.annot")
        return read_annotation(annotation_file) if annotation_file.is_file() else None


def find_template(name: StrPath) -> TemplateFolder:
    """A template by its folder, or of a sample such as ``"fsaverage5"``; raises ``FileNotFoundError``."""
    return TemplateFolder(Path(name).absolute() if Path(name).is_dir() else sample_path(name))


def read_own_sphere(path: StrPath, cortex: Cortex) -> Surface:
    """The registered sphere of a cortex; raises ``Mismatch`` if it is that of another mesh."""
    sphere = read_surface(path)
    if sphere.verts.shape != cortex.white.verts.shape:
        raise Mismatch(
            f"{path}: has {len(sphere.verts):,} vertices, {cortex.called} has {cortex.n_vertices:,}: it is the sphere "
            "of another mesh. Take it from the same reconstruction."
        )
    return sphere


def carried_cortex(registered: Surface, hemi: str) -> Bools:
    """True (N,) where the label of ``LABELLED_TEMPLATE`` says cortex, at the vertices of a sphere registered to it.

    A vertex has the label with the largest share of area around it; see :meth:`Resampling.labels`. Raises
    ``ValueError`` if the sphere is none.
    """
    return _carried_cortex(registered.verts, registered.faces, hemi)


@memoized
def _carried_cortex(verts: Verts, faces: Faces, hemi: str) -> Bools:
    template = TemplateFolder(sample_path(LABELLED_TEMPLATE))
    white = template.surface(hemi)
    resampling = Resampling(template.sphere(hemi), Surface(verts, faces, name=f"{hemi}.sphere.reg"))
    return resampling.labels(template.cortex(hemi).astype(np.int64), vertex_areas(white.verts, white.faces)) > 0


def check_template(template: StrPath, annotation: str | None = None) -> Path:
    """The folder of a template that has spheres and a parcellation.

    Raises
    ------
    FileNotFoundError
        If there is no such folder and no such sample.
    ValueError
        If it has no sphere or no such parcellation of any hemisphere, or its name can't be part of a file's name.
    """
    template_folder = find_template(template)
    file_word(template_folder.folder.name)
    hemis = [hemi for hemi in HEMIS if _annotation_file(template_folder, hemi, annotation).is_file()] or HEMIS[:1]
    _required_annotation(template_folder, hemis[0], annotation)
    template_folder.sphere_file(hemis[0])
    return template_folder.folder


def carried_files(
    folder: StrPath, hemi: str, template: StrPath | None, annotation: str | None = None
) -> dict[str, Path]:
    """The files by which a subject gets the parcellation of a template; none if it has its own, or without a template.

    Raises
    ------
    OSError, ValueError
        If the subject lacks a surface or ``?h.sphere.reg``, or the template its sphere, white surface or parcellation.
    """
    if template is None:
        return {}
    try:
        if "regions" in cortex_files(folder, hemi, annotation=annotation):
            return {}
    except FileNotFoundError:
        cortex_files(folder, hemi)  # raises where it is a surface that is missing
    template_folder = find_template(template)
    return {
        "registered sphere": registered_sphere(folder, hemi),
        "sphere of the template": template_folder.sphere_file(hemi),
        "white of the template": template_folder.surface_file(hemi),
        "annotation of the template": _required_annotation(template_folder, hemi, annotation),
    }


def read_parcellated(
    folder: StrPath,
    hemi: str,
    *,
    name: str | None = None,
    annotation: str | None = None,
    annotation_from: StrPath | None = None,
) -> Cortex:
    """Read a cortex as :func:`morphofold.read_cortex` does; one without the annotation gets that of a template.

    Parameters
    ----------
    folder : str or path
        A FreeSurfer subject.
    hemi : {"lh", "rh"}
    name, annotation : str, optional
        As for :func:`morphofold.read_cortex`.
    annotation_from : str or path, optional
        The folder of a template, or a sample such as ``"fsaverage5"``.

    Returns
    -------
    Cortex
        If they came over, ``regions`` have the name of annotation and template (``aparc.fsaverage5``), and
        ``info["annotation_from"]`` is the template's.

    Raises
    ------
    OSError, ValueError
        As :func:`morphofold.read_cortex` and :func:`carried_files`; or if a sphere is that of another mesh, or no
        sphere.
    """
    files = carried_files(folder, hemi, annotation_from, annotation)
    if not files:
        return read_cortex(folder, hemi, name=name, annotation=annotation)
    assert annotation_from is not None
    cortex = read_cortex(folder, hemi, name=name)
    with unchanged(files.values()) as input_records:
        regions = carried_regions(cortex, files)
    template_name = find_template(annotation_from).folder.name
    return replace(
        cortex,
        regions=replace(regions, name=f"{regions.name}.{template_name}"),
        info={**cortex.info, "annotation_from": template_name},
        files=(*cortex.files, *map(str, files.values())),
        inputs=(*cortex.inputs, *input_records),
    )


def carried_regions(cortex: Cortex, files: Mapping[str, Path]) -> Regions:
    """The regions of a template at the vertices of a cortex, by :func:`carried_files`.

    A vertex gets the label with the largest share of area around it, or where the subject's mesh is finer, with the
    largest barycentric weight in the template's triangle; see :meth:`Resampling.labels`.
    """
    sphere, white = (read_surface(files[f"{kind} of the template"]) for kind in ("sphere", "white"))
    regions = read_annotation(files["annotation of the template"])
    resampling = Resampling(sphere, read_own_sphere(files["registered sphere"], cortex))
    return replace(regions, labels=resampling.labels(regions.labels, vertex_areas(white.verts, white.faces)))


def _annotation_file(template: TemplateFolder, hemi: str, annotation: str | None) -> Path:
    """``?h.aparc.NAME.annot`` or ``?h.NAME.annot``; by default ``?h.aparc.annot``; which may not exist."""
    names = (DEFAULT_ANNOTATION,) if annotation is None else (f"{DEFAULT_ANNOTATION}.{annotation}", annotation)
    files = [template.label_file(hemi, f"{name}.annot") for name in names]
    return next(filter(Path.is_file, files), files[-1])


def _required_annotation(template: TemplateFolder, hemi: str, annotation: str | None) -> Path:
    file = _annotation_file(template, hemi, annotation)
    if not file.is_file():
        names = ", ".join(sorted(path.name for path in file.parent.glob("*.annot"))) or "none"
        raise MissingPart(f"{template.folder}: has no label/{file.name} to carry over; its annotations are {names}.")
    return file
