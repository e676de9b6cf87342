"""``@kernel``: functions that numba compiles when they are first called, and where their machine code is kept."""

from __future__ import annotations

import functools
import hashlib
import os
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from types import FunctionType
from typing import Any

import numba
import numpy as np
from numba.core import caching, config
from numba.core.dispatcher import Dispatcher
from numpy.typing import NDArray
from scipy import sparse

from morphofold import kernel_files

KEPT_VERSIONS = 4  # of each module, in the folder of compiled kernels
_OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}
_CONSTANTS = (bool, int, float, str, tuple)


def kernel(function: Callable[..., Any] | None = None, **options: Any) -> Any:
    """Decorate a function that numba compiles when it is first called; its machine code is kept for other processes.

    A kernel releases Python's lock, so threads run kernels beside each other. It divides by zero without an error, as
    NumPy does. ``options`` are those of ``numba.njit``.

    The code is kept in the folder ``NUMBA_CACHE_DIR``, else in the user's folder for caches, else beside the source:
    the first of them that can be written. It is found again by the contents of the source, so other installations and
    environments with the same source use it too. If no folder can be written, every process compiles for itself.
    """
    if function is None:
        return functools.partial(kernel, **options)
    options = {**_OPTIONS, **options}
    if kernel_files.folder() is None:
        return numba.njit(**options)(function)
    before = getattr(config, "CACHE_LOCATOR_CLASSES", "")
    config.CACHE_LOCATOR_CLASSES = (  # type: ignore[attr-defined]
        f"{__name__}.{KernelFolder.__name__}"  # numba before 0.62 keeps code beside the source
    )
    try:
        return numba.njit(cache=True, **options)(function)
    finally:
        config.CACHE_LOCATOR_CLASSES = before  # type: ignore[attr-defined]


def reading(*values: Any) -> tuple[Any, ...]:
    """Arguments of a kernel that it only reads: arrays in C order and read-only, since a kernel is compiled for each
    kind of arguments.

    Of a sparse matrix: its row starts, its columns, and its values unless it is boolean. Both are unsigned, which makes
    a product a quarter faster, because no index is counted from the end.
    """
    return tuple(part for value in values for part in _read_only(value))


def _read_only(value: Any) -> tuple[Any, ...]:
    if isinstance(value, sparse.csr_array):
        rows = [part.astype(np.int32, copy=False).view(np.uint32) for part in (value.indptr, value.indices)]
        return reading(*rows) if value.dtype == bool else reading(*rows, value.data)
    if not isinstance(value, np.ndarray):
        return (value,)
    view: NDArray[Any] = np.ascontiguousarray(value).view()
    view.flags.writeable = False
    return (view,)


class KernelFolder(caching._CacheLocator):  # type: ignore[misc]
    """Where numba keeps the code of a kernel: a folder for each content of its module and of all that it calls."""

    def __init__(self, function: FunctionType):
        self._line, self._stamp = function.__code__.co_firstlineno, _stamp(function.__module__)
        folder, file = kernel_files.folder(), function.__code__.co_filename
        assert folder is not None  # else there is no cache
        self._path = folder / f"{kernel_files.name(function.__module__, file)}-{self._stamp[:12]}"

    def get_cache_path(self) -> str:
        """The folder."""
        return str(self._path)

    def ensure_cache_path(self) -> None:
        """Make the folder; of the module, the folders that were not used for longest are removed."""
        if self._path.is_dir():
            os.utime(self._path)
            return
        self._path.mkdir(parents=True, exist_ok=True)
        same = self._path.parent.glob(f"{self._path.name.split('-')[0]}-*")
        for old in sorted(same, key=_time_of_use)[:-KEPT_VERSIONS]:
            shutil.rmtree(old, ignore_errors=True)

    def get_source_stamp(self) -> str:
        """A hash of the source."""
        return self._stamp

    def get_disambiguator(self) -> str:
        """The line of the kernel."""
        return str(self._line)

    @classmethod
    def from_function(cls, py_func: FunctionType, py_file: str) -> KernelFolder:
        """As numba asks for it."""
        return cls(py_func)


@functools.cache
def _stamp(module: str) -> str:
    """Hash of the source of a module, of its constants from elsewhere, and of the modules whose kernels it calls."""
    source = sys.modules[module]
    found = hashlib.sha256(Path(str(source.__file__)).read_bytes())
    others = set()
    for name, value in sorted(vars(source).items()):
        if isinstance(value, Dispatcher):
            others.add(value.py_func.__module__)
        elif isinstance(value, _CONSTANTS) and not name.startswith("__"):
            found.update(f"{name}={value!r}".encode())
    for other in sorted(others - {module}):
        found.update(_stamp(other).encode())
    return found.hexdigest()


def _time_of_use(folder: Path) -> float:
    try:
        return folder.stat().st_mtime
    except OSError:  # another process has just removed it
        return 0.0
