"""Templates to which subjects are registered by ``?h.sphere.reg``: their folders and files, and the packaged label."""

from pathlib import Path

import numpy as np

from morphofold.arrays import Bools, memoized
from morphofold.errors import Mismatch, MissingPart
from morphofold.geometry import vertex_areas
from morphofold.io import read_label, read_surface, sample_path
from morphofold.io.cortices import SURFACE_ENDINGS, registered_sphere
from morphofold.io.files import StrPath
from morphofold.spheres.resampling import Resampling
from morphofold.surface import Cortex, Faces, Surface, Verts

LABELLED_TEMPLATE = "fsaverage5"  # the sample whose cortex label is carried over


def template_folder(name: StrPath) -> Path:
    """The folder of a template: that folder, or a sample such as ``"fsaverage5"``; raises ``FileNotFoundError``."""
    return Path(name).absolute() if Path(name).is_dir() else sample_path(name)


def template_surface(folder: StrPath, hemi: str, kind: str) -> Path:
    """The file ``surf/?h.KIND`` of a template, in either format; raises ``MissingPart`` if there is none."""
    places = (Path(folder) / "surf" / f"{hemi}.{kind}{ending}" for ending in SURFACE_ENDINGS)
    found = next((file for file in places if file.is_file()), None)
    if found is None:
        raise MissingPart(f"{folder}: has no surf/{hemi}.{kind}, which a template needs.")
    return found


def template_sphere(folder: StrPath, hemi: str) -> Path:
    """``surf/?h.sphere.reg``, or ``?h.sphere`` of a template that others are registered to; raises ``MissingPart``."""
    try:
        return registered_sphere(folder, hemi)
    except FileNotFoundError:
        return template_surface(folder, hemi, "sphere")


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
    folder = sample_path(LABELLED_TEMPLATE)
    white = read_surface(template_surface(folder, hemi, "white"))
    label = read_label(folder / "label" / f"{hemi}.cortex.label", len(white.verts))
    sphere = Surface(verts, faces, name=f"{hemi}.sphere.reg")
    resampling = Resampling(read_surface(template_sphere(folder, hemi)), sphere)
    return resampling.labels(label.astype(np.int64), vertex_areas(white.verts, white.faces)) > 0
