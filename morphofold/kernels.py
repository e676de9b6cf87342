"""``@kernel``: functions that numba compiles when they are first called, and the cache of their machine code."""

from __future__ import annotations

import functools
import hashlib
import io
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any, BinaryIO

import numba
import numpy as np
from numba.core import caching, types
from numpy.typing import NDArray
from scipy import sparse

import morphofold.threads  # noqa: F401  (how numba's threads wait is set before they start)

_OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}
_CONSTANTS = (bool, int, float, str, tuple, np.generic)


def kernel(function: Callable[..., Any] | None = None, **options: Any) -> Any:
    """Decorate a function that numba compiles when it is first called; its machine code is cached for other processes.

    A kernel releases Python's lock, so threads run kernels beside each other. It divides by zero without an error, as
    NumPy does. ``options`` are those of ``numba.njit``.

    The code is where numba caches code: in the folder ``NUMBA_CACHE_DIR``, else in ``__pycache__`` beside the source,
    else in the user's folder for caches. If none of them can be written, every process compiles for itself. It is
    compiled again if its source has changed, or that of anything that it calls, and if its file is damaged.
    """
    if function is None:
        return functools.partial(kernel, **options)
    dispatcher = numba.njit(**{**_OPTIONS, **options})(function)
    if Path(function.__code__.co_filename).is_file():  # not a cell of a notebook, whose other cells may have changed
        with suppress(RuntimeError):  # no folder can be written
            dispatcher._cache = _Cache(function)
    return dispatcher


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


class _Cache(caching.FunctionCache):  # type: ignore[misc]
    """numba's cache of a function, which no damaged file, full disk or changed callee misleads."""

    def __init__(self, function: Any):
        super().__init__(function)
        stamp = self._impl.locator.get_source_stamp(), sorted(_called(function, set()))
        self._cache_file = _Files(self._cache_path, self._impl.filename_base, stamp)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        try:
            return super().load_overload(sig, target_context)
        except (OSError, AttributeError, ImportError):  # unreadable, or of a material that is gone: compile
            with suppress(OSError):
                self.flush()
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        with suppress(OSError):  # a full disk must not stop the work
            super().save_overload(sig, data)

    def _index_key(self, sig: Any, codegen: Any) -> Any:
        """Of a material the source, too: numba knows only the name of its class."""
        classes: list[Any] = [
            each.instance_class for each in sig if isinstance(each, types.NamedUniTuple | types.NamedTuple)
        ]
        sources = tuple(_digest(getattr(sys.modules[each.__module__], "__file__", "")) for each in classes)
        return super()._index_key(sig, codegen), sources


class _Files(caching.IndexDataCacheFile):  # type: ignore[misc]
    """numba's files, each with a checksum at its end, which unpickling passes over."""

    def save(self, key: Any, data: Any) -> None:
        super().save(key, (key, data))

    def load(self, key: Any) -> Any:
        """The data, unless two processes wrote to the same file at once and it is of another key."""
        found = super().load(key)
        return found[1] if found is not None and found[0] == key else None

    def _load_index(self) -> Any:
        if Path(self._index_path).exists():
            _check(self._index_path)
        return super()._load_index()

    def _load_data(self, name: str) -> Any:
        _check(self._data_path(name))
        return super()._load_data(name)

    @contextmanager
    def _open_for_write(self, filepath: str) -> Iterator[BinaryIO]:
        with super()._open_for_write(filepath) as file:
            yield (content := io.BytesIO())
            file.write(content.getvalue() + hashlib.sha256(content.getvalue()).digest())


def _check(path: str) -> None:
    content = Path(path).read_bytes()
    if hashlib.sha256(content[:-32]).digest() != content[-32:]:
        raise OSError(f"{path} is damaged.")


def _called(function: FunctionType, seen: set[FunctionType]) -> Iterator[str]:
    """Constants that a function uses, and of all that it calls, directly or not: the contents of their files."""
    seen.add(function)
    code = function.__code__
    names = {name for part in (code, *code.co_consts) if isinstance(part, CodeType) for name in part.co_names}
    scopes = [function.__globals__]
    scopes += [vars(each) for name in names if isinstance(each := scopes[0].get(name), ModuleType)]
    for name, value in [(name, scope[name]) for scope in scopes for name in names & scope.keys()]:
        value = getattr(value, "__wrapped__", value)  # of a kernel or an intrinsic
        if isinstance(value, FunctionType) and value not in seen:
            yield _digest(value.__code__.co_filename)
            yield from _called(value, seen)
        elif isinstance(value, _CONSTANTS):
            yield f"{name}={value!r}"


@functools.cache
def _digest(file: str) -> str:
    return hashlib.sha256(Path(file).read_bytes()).hexdigest() if Path(file).is_file() else ""
