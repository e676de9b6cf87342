"""Layouts of folders with a cortex, other than FreeSurfer's: each has a file here, and ``read_cortex`` tries them.

``NAME.py`` has a function ``files(folder, hemi)`` that gives the files of a hemisphere by what they hold: ``white``,
``pial``, and those of ``thickness``, ``curv``, ``sulc``, ``area``, ``inflated``, ``sphere``, ``regions`` and ``cortex``
that exist. It gives none for a folder of another layout.
"""

import pkgutil
from importlib import import_module
from pathlib import Path


def files_by_layout(folder: Path, hemi: str) -> dict[str, Path]:
    """The files of a hemisphere by the first layout, in the order of their names, that has any; empty if none has."""
    names = sorted(module.name for module in pkgutil.iter_modules(__path__))
    files = (import_module(f"{__name__}.{name}").files(folder, hemi) for name in names)
    return next(filter(None, files), {})
