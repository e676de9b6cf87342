"""Paths of the sample surfaces, in a checkout and in an installed package."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

from morphofold.io.files import StrPath


def sample_path(name: StrPath = "") -> Path:
    """Path of a sample that comes with morphofold, e.g. ``"fsaverage5"`` or ``"S1/lh.pial.surf.gii"``.

    The folder of each sample holds a README with its origin and licence.

    Raises
    ------
    FileNotFoundError
        If there is no such sample; the message lists the samples that exist.
    """
    root = Path(str(files("morphofold.data_samples")))
    path = root / name
    if not path.exists():
        there = sorted(p.name for p in root.iterdir() if p.is_dir() and not p.name.startswith("_"))
        raise FileNotFoundError(f"{name}: no such sample. The samples are {', '.join(there)}.")
    return path
