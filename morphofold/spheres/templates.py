"""Templates to which subjects are registered by ``?h.sphere.reg``: their folders and files, and the packaged label."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from morphofold.arrays import Bools, memoized
from morphofold.errors import Mismatch, MissingPart
from morphofold.geometry import vertex_areas
from morphofold.io import read_annotation, read_label, read_surface, sample_path
from morphofold.io.cortices import SURFACE_ENDINGS, registered_sphere
from morphofold.io.files import StrPath
from morphofold.spheres.resampling import Resampling
from morphofold.surface import Cortex, Faces, Regions, Surface, Verts

LABELLED_TEMPLATE = "fsaverage5"  # the sample whose cortex label is carried over
HEMIS = ("lh", "rh")


@dataclass(frozen=True)
class TemplateFolder:
    """The surfaces and labels of a template, in a folder as that of a FreeSurfer subject.

    Attributes
    ----------
    folder : Path
    one_side : bool
        Whether both hemispheres of a subject come to its left one, the right one mirrored.
    """

    folder: Path
    one_side: bool = False

    def side(self, hemi: str) -> str:
        """The template's hemisphere that the maps of one are on."""
        return "lh" if self.one_side else hemi

    def surface_file(self, hemi: str, kind: str = "white") -> Path:
        """The file ``surf/?h.KIND``, in either format; raises ``MissingPart`` if there is none."""
        stem = self.folder / "surf" / f"{self.side(hemi)}.{kind}"
        found = next((file for end in SURFACE_ENDINGS if (file := stem.with_name(stem.name + end)).is_file()), None)
        if found is None:
            raise MissingPart(f"{self.folder}: has no surf/{stem.name}, which a template needs.")
        return found

    def sphere_file(self, hemi: str) -> Path:
        """``surf/?h.sphere.reg``, or ``?h.sphere`` of a template that others are registered to; else raises
        ``MissingPart``."""
        try:
            return registered_sphere(self.folder, self.side(hemi))
        except FileNotFoundError:
            return self.surface_file(hemi, "sphere")

    def label_file(self, hemi: str, name: str) -> Path:
        """Where one of its labels is, if it has it."""
        return self.folder / "label" / f"{self.side(hemi)}.{name}"

    def surface(self, hemi: str, kind: str = "white") -> Surface:
        """A surface of the template."""
        return read_surface(self.surface_file(hemi, kind))

    def sphere(self, hemi: str) -> Surface:
        """The template's registered sphere."""
        return read_surface(self.sphere_file(hemi))

    def cortex(self, hemi: str) -> Bools:
        """The template's cortex (N,); everywhere if it has no label."""
        n, file = len(self.surface(hemi).verts), self.label_file(hemi, "cortex.label")
        return read_label(file, n) if file.is_file() else np.ones(n, dtype=bool)

    def regions(self, hemi: str) -> Regions | None:
        """The template's parcellation, if it has one."""
        file = self.label_file(hemi, "aparc.annot")
        return read_annotation(file) if file.is_file() else None


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
