"""Read a folded surface with what unfolding needs of a subject or a file: sphere, regions, and signs of the cortex."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

from morphofold.io.cortices import read_cortex_files
from morphofold.io.files import StrPath, existing_file
from morphofold.provenance import unchanged
from morphofold.surface import Cortex

WHITE = "white"
SIGNS = ("pial", "thickness")  # by which the cortex under white is found without a label
#: by the content in folded_files, that of a cortex
_IN_A_CORTEX = {"surface": "white", "aparc.annot": "annotation", "cortex.label": "label"}


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
    with unchanged(files.values()) as records:
        known = {"pial": files["surface"]} | {_IN_A_CORTEX.get(what, what): file for what, file in files.items()}
        cortex = read_cortex_files(Path(path), hemi, known)
    return replace(cortex, inputs=tuple(records))


def folded_files(path: StrPath, hemi: str, *, surface: str | None = None, sphere: str | None = None) -> dict[str, Path]:
    """The files that :func:`read_folded` reads, by content; raises if a surface does not exist."""
    root, there = Path(path), Path(path).is_dir()
    place, kind = root / "surf", surface or WHITE
    files = {"surface": existing_file(place / f"{hemi}.{kind}" if there else root, "surface")}
    if sphere is not None or (there and os.path.lexists(place / f"{hemi}.sphere")):
        files["sphere"] = existing_file(
            place / f"{hemi}.{sphere or 'sphere'}" if there else Path(sphere or ""), "sphere"
        )
    beside = {name: root / "label" / f"{hemi}.{name}" for name in ("aparc.annot", "cortex.label")}
    files |= {name: existing_file(file, name) for name, file in beside.items() if os.path.lexists(file)}
    if "cortex.label" not in files:
        signs = {"registered": "sphere.reg", **(dict(zip(SIGNS, SIGNS)) if kind == WHITE else {})}
        files |= {what: file for what, name in signs.items() if (file := place / f"{hemi}.{name}").is_file()}
    return files
