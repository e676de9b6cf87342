"""``@kept``: results that are computed once and kept as long as the arrays they were computed from exist."""

from __future__ import annotations

import functools
import weakref
from collections.abc import Callable, Hashable
from threading import Lock
from typing import Any, ParamSpec, TypeVar

import numpy as np
from scipy import sparse

P = ParamSpec("P")
R = TypeVar("R")


def kept(function: Callable[P, R]) -> Callable[P, R]:
    """Keep the results of a function of arrays, as long as the arrays exist.

    Only for arrays that can not change, as those of a Surface: read-only, and not a view of another array. (Never make
    them writable again.) For other arrays the function is called each time. The arrays of a kept result are read-only.
    """
    results: dict[tuple[Hashable, ...], R] = {}
    locks: dict[tuple[Hashable, ...], Lock] = {}

    @functools.wraps(function)
    def call(*given: P.args, **options: P.kwargs) -> R:
        named = [*given, *(part for option in sorted(options.items()) for part in option)]
        arrays = [value for value in named if isinstance(value, np.ndarray)]
        if any(array.flags.writeable or array.base is not None for array in arrays):
            return function(*given, **options)
        key = tuple(id(value) if isinstance(value, np.ndarray) else value for value in named)
        if key not in results:
            try:
                with locks.setdefault(key, Lock()):  # one thread computes it, others wait for it
                    if key not in results:
                        results[key] = _frozen(function(*given, **options))
                        for array in arrays:
                            weakref.finalize(array, results.pop, key, None).atexit = False
            finally:
                locks.pop(key, None)
        return results[key]

    call.results = results  # type: ignore[attr-defined]
    return call


def _frozen(result: Any) -> Any:
    """A result whose arrays are read-only."""
    if isinstance(result, np.ndarray):
        if result.base is not None:
            result = result.copy()
        result.flags.writeable = False
    elif isinstance(result, tuple):
        return tuple(map(_frozen, result))
    elif isinstance(result, sparse.csr_array):
        for part in (result.indptr, result.indices, result.data):
            part.flags.writeable = False
    return result
