"""Where the machine code of kernels is kept. Imports nothing large: commands ask this before anything else."""

from __future__ import annotations

import functools
import hashlib
import os
import sys
import tempfile
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path


@functools.cache
def folder() -> Path | None:
    """``NUMBA_CACHE_DIR``, else the user's folder for caches, else beside the source: the first that can be written."""
    usual = {"win32": os.environ.get("LOCALAPPDATA", "~/AppData/Local"), "darwin": "~/Library/Caches"}
    user = usual.get(sys.platform, os.environ.get("XDG_CACHE_HOME") or "~/.cache")
    for place in (os.environ.get("NUMBA_CACHE_DIR") or user, Path(__file__).parent / "__pycache__"):
        try:
            found = Path(place).expanduser() / f"morphofold-numba-{version('numba')}"
            found.mkdir(parents=True, exist_ok=True)
            tempfile.TemporaryFile(dir=found).close()
        except (OSError, RuntimeError):  # RuntimeError: no home
            continue
        return found
    return None


def name(module: str, file: str | Path) -> str:
    """Beginning of the names of the folders for the kernels of a module, by the contents of its file."""
    return f"{module}-{hashlib.sha256(Path(file).read_bytes()).hexdigest()[:12]}"


def is_kept(module: str) -> bool:
    """Whether kernels of a module with this source were compiled before, by this or another process."""
    place, spec = folder(), find_spec(module)
    if place is None or spec is None or spec.origin is None:
        return False
    try:
        return any(place.glob(f"{name(module, spec.origin)}*/*.nbc"))
    except OSError:  # it may be written but not listed
        return False
