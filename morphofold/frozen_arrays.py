"""The arrays of the house by what they hold; arrays that can't change, and functions of them that remember results."""

import functools
import weakref
from collections.abc import Callable, Hashable
from threading import Lock
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

REMEMBERED: list[dict[Any, Any]] = []  # the results of each memoized function
AnyFunction = TypeVar("AnyFunction", bound=Callable[..., Any])


def cannot_change(values: np.ndarray) -> bool:
    """Whether an array is read-only, and not a view of another one."""
    return not values.flags.writeable and values.base is None


def read_only(values: Any) -> Any:
    """An array that can't change, copied if it is a view of another; also in a tuple, or a sparse matrix."""
    if isinstance(values, tuple):
        return tuple(map(read_only, values))
    if isinstance(values, np.ndarray) and values.base is not None:
        values = values.copy()
    buffers = (values.indptr, values.indices, values.data) if hasattr(values, "indptr") else (values,)
    for buffer in buffers:
        if isinstance(buffer, np.ndarray):
            buffer.flags.writeable = False
    return values


def memoized(function: AnyFunction) -> AnyFunction:
    """Remember the results of a function of arrays, as long as the arrays exist.

    Only for arrays that can't change, as those of a Surface. (Never make them writable again.) For other arrays the
    function is called each time. The arrays of a remembered result are read-only.
    """
    results: dict[tuple[Hashable, ...], Any] = {}
    locks: dict[tuple[Hashable, ...], Lock] = {}

    @functools.wraps(function)
    def call(*arguments: Any, **options: Any) -> Any:
        call_arguments = [*arguments, *(key_part for option in sorted(options.items()) for key_part in option)]
        arrays = [argument for argument in call_arguments if isinstance(argument, np.ndarray)]
        if not all(map(cannot_change, arrays)):
            return function(*arguments, **options)
        key = tuple(id(argument) if isinstance(argument, np.ndarray) else argument for argument in call_arguments)
        if key not in results:
            try:
                with locks.setdefault(key, Lock()):  # one thread computes it, others wait for it
                    if key not in results:
                        results[key] = read_only(function(*arguments, **options))
                        for array in arrays:
                            weakref.finalize(array, results.pop, key, None).atexit = False
            finally:
                locks.pop(key, None)
        return results[key]

    REMEMBERED.append(results)
    return call  # type: ignore[return-value]
