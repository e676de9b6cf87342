"""Read a folded surface with its sphere, regions and cortex label: what unfolding needs of a subject or a file."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from morphofold.errors import Mismatch
from morphofold.io.files import StrPath, existing_file
from morphofold.io.freesurfer import read_annotation, read_label
from morphofold.io.surfaces import read_surface
from morphofold.provenance import clean_name, unchanged
from morphofold.surface import Regions, Surface


class Folded(NamedTuple):
    """A folded surface and its sphere.

    Attributes
    ----------
    name, hemi : str
    surface : Surface
        [mm]
    sphere : Surface or None
        Its vertex i belongs to vertex i of the surface.
    regions : Regions or None
    cortex : (N,) bool or None
        True where the vertex is cortex.
    inputs : tuple of mapping
        ``{"path", "sha256", "bytes"}`` of the files.
    """

    name: str
    hemi: str
    surface: Surface
    sphere: Surface | None
    regions: Regions | None
    cortex: NDArray[np.bool_] | None
    inputs: tuple[Mapping[str, Any], ...]


def read_folded(path: StrPath, hemi: str, *, surface: str | None = None, sphere: str | None = None) -> Folded:
    """Read ``surf/?h.SURFACE`` (white) and ``surf/?h.SPHERE`` of a subject, and regions and cortex label if they exist.

    Unless a sphere is named, ``surf/?h.sphere`` is read if it exists. ``path`` may also be a file of a closed surface,
    and ``sphere`` then the file of its sphere.

    Raises
    ------
    FileNotFoundError
        If a surface does not exist.
    ValueError
        If a file is damaged, or belongs to another subject.
    """
    files = folded_files(path, hemi, surface=surface, sphere=sphere)
    with unchanged(files.values()) as records:
        folded = read_surface(files["surface"])
        round_ = read_surface(files["sphere"]) if "sphere" in files else None
        regions = read_annotation(files["aparc.annot"]) if "aparc.annot" in files else None
        cortex = read_label(files["cortex.label"], len(folded.verts)) if "cortex.label" in files else None
    if regions is not None and len(regions.labels) != len(folded.verts):
        raise Mismatch(
            f"{files['aparc.annot']} has {len(regions.labels):,} vertices, {files['surface']} {len(folded.verts):,}: "
            "it belongs to another subject. Take it from the same subject, or leave it out."
        )
    root = Path(path)
    name = root.resolve().name if root.is_dir() else root.name
    return Folded(clean_name(name), hemi, folded, round_, regions, cortex, tuple(records))


def folded_files(path: StrPath, hemi: str, *, surface: str | None = None, sphere: str | None = None) -> dict[str, Path]:
    """The files that :func:`read_folded` reads, by content; raises if a surface does not exist."""
    root, there = Path(path), Path(path).is_dir()
    place = root / "surf"
    files = {"surface": existing_file(place / f"{hemi}.{surface or 'white'}" if there else root, "surface")}
    if sphere is not None or (there and os.path.lexists(place / f"{hemi}.sphere")):
        files["sphere"] = existing_file(
            place / f"{hemi}.{sphere or 'sphere'}" if there else Path(sphere or ""), "sphere"
        )
    beside = {name: root / "label" / f"{hemi}.{name}" for name in ("aparc.annot", "cortex.label")}
    return files | {name: existing_file(file, name) for name, file in beside.items() if os.path.lexists(file)}
