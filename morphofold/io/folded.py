"""Read a folded surface with its sphere, regions and cortex label: what unfolding needs of a FreeSurfer subject."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from morphofold.errors import Mismatch
from morphofold.io.files import StrPath, existing_file
from morphofold.io.freesurfer import read_annotation, read_label
from morphofold.io.surfaces import read_surface
from morphofold.provenance import printable, unchanged
from morphofold.surface import Regions, Surface


class Folded(NamedTuple):
    """A folded surface and its sphere.

    Attributes
    ----------
    name, hemi : str
    surface, sphere : Surface
        Vertex i of one belongs to vertex i of the other [mm].
    regions : Regions or None
    cortex : (N,) bool or None
        True where the vertex is cortex.
    inputs : tuple of mapping
        ``{"path", "sha256", "bytes"}`` of the files.
    """

    name: str
    hemi: str
    surface: Surface
    sphere: Surface
    regions: Regions | None
    cortex: NDArray[np.bool_] | None
    inputs: tuple[Mapping[str, Any], ...]


def read_folded(path: StrPath, hemi: str, *, surface: str = "white", sphere: str = "sphere") -> Folded:
    """Read ``surf/?h.SURFACE`` and ``surf/?h.SPHERE`` of a subject, and the regions and cortex label if they exist.

    Raises
    ------
    FileNotFoundError
        If a surface does not exist.
    ValueError
        If a file is damaged, or belongs to another subject.
    """
    root = Path(path)
    if not root.is_dir():
        existing_file(root, "folder of a FreeSurfer subject")
        raise NotADirectoryError(f"{root}: is a file. Name the folder of its subject, which has surf/{hemi}.{sphere}.")
    files = {name: existing_file(root / "surf" / f"{hemi}.{name}", "surface") for name in (surface, sphere)}
    beside = {name: root / "label" / f"{hemi}.{name}" for name in ("aparc.annot", "cortex.label")}
    files |= {name: file for name, file in beside.items() if file.is_file()}
    with unchanged(files.values()) as records:
        folded, round_ = read_surface(files[surface]), read_surface(files[sphere])
        regions = read_annotation(files["aparc.annot"]) if "aparc.annot" in files else None
        cortex = read_label(files["cortex.label"], len(folded.verts)) if "cortex.label" in files else None
    if regions is not None and len(regions.labels) != len(folded.verts):
        raise Mismatch(
            f"{files['aparc.annot']} has {len(regions.labels):,} vertices, {files[surface]} {len(folded.verts):,}: it "
            "belongs to another subject. Take it from the same subject, or leave it out."
        )
    return Folded(printable(root.resolve().name), hemi, folded, round_, regions, cortex, tuple(records))
