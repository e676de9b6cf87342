"""``@kernel``: functions that numba compiles when they are first called, and the cache of their machine code."""

import functools
import hashlib
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any

import numba
import numpy as np
from numba.core import caching, types
from scipy import sparse

import morphofold.threads  # noqa: F401  (how numba's threads wait is set before they start)


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
    dispatcher = numba.njit(**{"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True, **options})(function)
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
    kernel_arguments: list[Any] = []
    for value in values:
        if isinstance(value, sparse.csr_array):
            csr_pattern = [part.astype(np.int32, copy=False).view(np.uint32) for part in (value.indptr, value.indices)]
            kernel_arguments += reading(*csr_pattern) if value.dtype == bool else reading(*csr_pattern, value.data)
        elif isinstance(value, np.ndarray):
            array_view: np.ndarray = np.ascontiguousarray(value).view()
            array_view.flags.writeable = False
            kernel_arguments.append(array_view)
        else:
            kernel_arguments.append(value)
    return tuple(kernel_arguments)


class _Cache(caching.FunctionCache):  # type: ignore[misc]
    """numba's cache of a function, which no damaged file, full disk or changed callee misleads."""

    def __init__(self, function: Any):
        super().__init__(function)
        source_stamp = self._impl.locator.get_source_stamp(), sorted(_called(function, set()))
        self._cache_file = caching.IndexDataCacheFile(self._cache_path, self._impl.filename_base, source_stamp)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        try:
            overload = super().load_overload(sig, target_context)
        except Exception:  # damaged, unreadable, or of a material that is gone: compile
            with suppress(OSError):
                self.flush()
            return None
        # two processes that wrote at once may leave the index of one, and the code of the other
        return overload if overload is not None and overload.signature.args == tuple(sig) else None

    def save_overload(self, sig: Any, data: Any) -> None:
        with suppress(OSError):  # a full disk must not stop the work
            super().save_overload(sig, data)

    def _index_key(self, sig: Any, codegen: Any) -> Any:
        """Of a material the source, too: numba knows only the name of its class."""
        materials: list[Any] = [material for material in sig if isinstance(material, types.BaseNamedTuple)]
        modules = [sys.modules[material.instance_class.__module__] for material in materials]
        source_digests = tuple(_digest(getattr(module, "__file__", "")) for module in modules)
        return super()._index_key(sig, codegen), source_digests


def _called(function: FunctionType, seen_functions: set[FunctionType]) -> Iterator[str]:
    """Constants that a function uses, and of all that it calls, directly or not: the contents of their files."""
    seen_functions.add(function)
    code = function.__code__
    global_names = {name for part in (code, *code.co_consts) if isinstance(part, CodeType) for name in part.co_names}
    namespaces = [function.__globals__]
    namespaces += [vars(module) for name in global_names if isinstance(module := namespaces[0].get(name), ModuleType)]
    for name, value in ((name, scope[name]) for scope in namespaces for name in global_names & scope.keys()):
        value = getattr(value, "__wrapped__", value)  # of a kernel or an intrinsic
        if isinstance(value, FunctionType) and value not in seen_functions:
            yield _digest(value.__code__.co_filename)
            yield from _called(value, seen_functions)
        elif isinstance(value, int | float | str | tuple | np.generic):
            yield f"{name}={value!r}"


@functools.cache
def _digest(source_path: str) -> str:
    return hashlib.sha256(Path(source_path).read_bytes()).hexdigest() if Path(source_path).is_file() else ""
