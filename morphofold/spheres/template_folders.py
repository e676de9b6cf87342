"""Templates to which subjects are registered by ``?h.sphere.reg``: their files, and parcellations carried from them."""

import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from importlib.resources import files as package_files
from pathlib import Path
from typing import Any

import numpy as np

from morphofold.digests_and_json import unchanged
from morphofold.errors import Mismatch, MissingPart, NamedTwice
from morphofold.frozen_arrays import Bools, memoized
from morphofold.geometry import vertex_areas
from morphofold.io import read_annotation, read_cortex, read_label, read_surface
from morphofold.io.cortices import cortex_files, hemispheres, registered_sphere
from morphofold.io.files import StrPath
from morphofold.io.json_files import file_word
from morphofold.io.layouts import CONTENT_OF_SPACE, FREESURFER, HEMIS, Subject, programs
from morphofold.spheres.resampling import Resampling
from morphofold.spheres.template_layouts import TEMPLATE_LAYOUTS
from morphofold.surface import Cortex, Faces, Regions, Surface, Verts

LABELLED_TEMPLATE = "fsaverage5"  # the sample whose cortex label is carried over


@dataclass(frozen=True)
class TemplateFolder:
    """The surfaces and labels of a template, by the names of FreeSurfer, templateflow or HCP."""

    files: Subject

    @property
    def folder(self) -> Path:
        return self.files.folder

    @property
    def name(self) -> str:
        """``fsaverage5``, or with a density ``fsLR-32k``."""
        density = self.files.fields.get("density")
        return self.files.name if density is None else f"{self.files.layout.program}-{density}"

    @property
    def hemis(self) -> list[str]:
        """The hemispheres of which it has a sphere."""
        return [hemi for hemi in HEMIS if any(self._spheres(hemi).values())]

    def surface_file(self, hemi: str, kind: str = "white") -> Path:
        """A surface; of fs_LR, which has no white, midthickness in its place. Raises ``MissingPart`` if there is
        none."""
        path = self.files.surface(hemi, kind)
        if path is None:
            raise MissingPart(
                f"{self.folder}: has no {self.files.expected(hemi, kind).name}, which a template needs, and no file of "
                "templateflow or HCP with a midthickness."
            )
        return path

    def _spheres(self, hemi: str) -> dict[str, Path | None]:
        """Its spheres by the space in which they are; ``?h.sphere`` of a template that others are registered to."""
        by_space = {space: self.files.other(hemi, content) for space, content in CONTENT_OF_SPACE.items()}
        own_sphere = self.files.surface(hemi, "sphere") if self.files.layout.program == FREESURFER else None
        return {**by_space, "fsaverage": by_space["fsaverage"] or own_sphere}

    def sphere_file(self, hemi: str, space: str | None = None) -> Path:
        """Its sphere in a space, by default in its own; raises ``MissingPart`` if there is none."""
        spheres = self._spheres(hemi)
        path = next(filter(None, spheres.values()), None) if space is None else spheres[space]
        return path or self.surface_file(hemi, "sphere")

    def sphere_pair(self, subject: StrPath, hemi: str) -> tuple[Path, Path]:
        """The registered spheres of a subject and of the template in the first space in which both have one.

        Raises
        ------
        FileNotFoundError
            If the subject has none.
        """
        spaces = [space for space, file in self._spheres(hemi).items() if file is not None]
        own_file, space = registered_sphere(subject, hemi, spaces or ["fsaverage"])
        return own_file, self.sphere_file(hemi, space)

    def cortex_file(self, hemi: str) -> Path | None:
        """Its label or map of the cortex, if it has one."""
        return self.files.other(hemi, "cortex")

    def surface(self, hemi: str, kind: str = "white") -> Surface:
        """A surface of the template."""
        return read_surface(self.surface_file(hemi, kind))

    def sphere(self, hemi: str) -> Surface:
        """The template's registered sphere."""
        return read_surface(self.sphere_file(hemi))

    def cortex(self, hemi: str) -> Bools:
        """The template's cortex (N,); everywhere if it has no label."""
        n_vertices, label_file = len(self.surface(hemi).verts), self.cortex_file(hemi)
        return np.ones(n_vertices, dtype=bool) if label_file is None else read_label(label_file, n_vertices)

    def regions(self, hemi: str) -> Regions | None:
        """The template's parcellation, if it has one."""
        annotation_file = self.files.regions(hemi, None)
        return None if annotation_file is None else read_annotation(annotation_file)


def find_template(name: StrPath) -> TemplateFolder:
    """A template by its folder, or its name: that of a sample such as ``"fsaverage5"``, of a subject in
    ``SUBJECTS_DIR``, or of templateflow (in ``TEMPLATEFLOW_HOME``), such as ``"fsLR"`` or ``"fsaverage-41k"``.

    Raises
    ------
    FileNotFoundError
        If there is none.
    NamedTwice
        If it has several densities, none of them is 32k, and none is named.
    """
    template_name, _, density = str(name).partition("-")
    places = [Path(name).absolute()]
    if Path(name).name == str(Path(name)) and not places[0].is_dir():
        flow_home = os.environ.get("TEMPLATEFLOW_HOME") or "~/.cache/templateflow"
        places = [Path(str(package_files("morphofold.data_samples"))) / name]
        places += [Path(os.environ["SUBJECTS_DIR"]).absolute() / name] if os.environ.get("SUBJECTS_DIR") else []
        places += [Path(flow_home).expanduser().absolute() / f"tpl-{template_name}"]
    folder = next(filter(Path.is_dir, places), None)
    if folder is None:
        raise FileNotFoundError(
            f"{name}: no such template. Tried {', '.join(map(str, places))}; fsaverage5 is packaged."
        )
    found = {s.fields["density"]: s for layout in TEMPLATE_LAYOUTS for s in layout.subjects(folder)}
    if not found:
        return TemplateFolder(freesurfer_subject(folder))
    density = density if folder.name == f"tpl-{template_name}" else ""
    chosen = density or (next(iter(found)) if len(found) == 1 else "32k")
    if chosen not in found:
        names = ", ".join(TemplateFolder(subject).name for subject in found.values())
        raise NamedTwice(f"{folder}: holds the densities {names}, not {chosen}. Name one of them.")
    return TemplateFolder(found[chosen])


def freesurfer_subject(folder: Path) -> Subject:
    """The files of a folder by FreeSurfer's names."""
    return Subject(programs()["freesurfer_folders"][0], folder)


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
    template = find_template(LABELLED_TEMPLATE)
    white = template.surface(hemi)
    resampling = Resampling(template.sphere(hemi), Surface(verts, faces, name=f"{hemi}.sphere.reg"))
    return resampling.labels(template.cortex(hemi).astype(np.int64), vertex_areas(white.verts, white.faces)) > 0


def check_template(template: StrPath, annotation: str | None = None) -> TemplateFolder:
    """A template that has spheres and a parcellation.

    Raises
    ------
    FileNotFoundError
        If there is no such folder and no such sample.
    ValueError
        If it has no sphere or no such parcellation of any hemisphere, or its name can't be part of a file's name.
    """
    template_folder = find_template(template)
    file_word(template_folder.name)
    hemis = [hemi for hemi in HEMIS if template_folder.files.regions(hemi, annotation)] or HEMIS[:1]
    _required_annotation(template_folder, hemis[0], annotation)
    template_folder.sphere_file(hemis[0])
    return template_folder


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
    own_sphere, template_sphere = template_folder.sphere_pair(folder, hemi)
    return {"registered sphere": own_sphere, **_template_files(template_folder, template_sphere, hemi, annotation)}


def _template_files(template: TemplateFolder, sphere: Path, hemi: str, annotation: str | None) -> dict[str, Path]:
    return {
        "sphere of the template": sphere,
        "white of the template": template.surface_file(hemi),
        "annotation of the template": _required_annotation(template, hemi, annotation),
    }


def read_parcellated(
    folder: StrPath | None,
    hemi: str | None,
    *,
    name: str | None = None,
    annotation: str | None = None,
    annotation_from: StrPath | None = None,
    **files_of_pair: Any,
) -> Cortex:
    """Read a cortex as :func:`morphofold.read_cortex` does; one without the annotation gets that of a template.

    Parameters
    ----------
    folder, hemi, name, annotation, files_of_pair
        As for :func:`morphofold.read_cortex`; instead of a folder also ``white``, ``pial`` or ``surface``, and their
        ``sphere`` that is registered to fsaverage. Of these ``annotation`` is that of the template.
    annotation_from : str or path, optional
        The folder of a template, or its name, as :func:`find_template` takes it.

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
    if annotation_from is None:
        return read_cortex(folder, hemi, name=name, annotation=annotation, **files_of_pair)
    template = find_template(annotation_from)
    if folder is None:
        cortex = read_cortex(None, hemi, name=name, **files_of_pair)
        if cortex.registered is None:
            raise MissingPart(f"{cortex.called}: regions come over from a template by a sphere. Pass sphere= as well.")
        files = _template_files(template, template.sphere_file(cortex.hemi, "fsaverage"), cortex.hemi, annotation)
    else:
        hemi = hemi or hemispheres(Path(folder))[0]
        files = carried_files(folder, hemi, annotation_from, annotation)
        if not files:
            return read_cortex(folder, hemi, name=name, annotation=annotation)
        cortex = read_cortex(folder, hemi, name=name)
    with unchanged(files.values()) as input_records:
        regions = carried_regions(cortex, files)
    return replace(
        cortex,
        regions=replace(regions, name=f"{regions.name}.{template.name}"),
        info={**cortex.info, "annotation_from": template.name},
        files=(*cortex.files, *map(str, files.values())),
        inputs=(*cortex.inputs, *input_records),
    )


def carried_regions(cortex: Cortex, files: Mapping[str, Path]) -> Regions:
    """The regions of a template at the vertices of a cortex, by :func:`carried_files` or its own ``registered`` sphere.

    A vertex gets the label with the largest share of area around it, or where the subject's mesh is finer, with the
    largest barycentric weight in the template's triangle; see :meth:`Resampling.labels`.
    """
    sphere, white = (read_surface(files[f"{kind} of the template"]) for kind in ("sphere", "white"))
    regions = read_annotation(files["annotation of the template"], cortex.hemi)
    own_file = files.get("registered sphere")
    own_sphere = cortex.registered if own_file is None else read_own_sphere(own_file, cortex)
    assert own_sphere is not None
    resampling = Resampling(sphere, own_sphere)
    return replace(regions, labels=resampling.labels(regions.labels, vertex_areas(white.verts, white.faces)))


def _required_annotation(template: TemplateFolder, hemi: str, annotation: str | None) -> Path:
    file = template.files.regions(hemi, annotation)
    if file is None:
        names = ", ".join(template.files.annotations(hemi)) or "none"
        raise MissingPart(
            f"{template.folder}: has no label/{hemi}.{annotation or 'aparc'}.annot, nor a .label.gii, to carry over; "
            f"its annotations are {names}."
        )
    return file
