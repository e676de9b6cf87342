"""How many threads the kernels use."""

from __future__ import annotations


def set_threads(threads: int | None) -> None:
    """Let numba kernels use ``threads`` threads; None: all cores. Results are bitwise the same for any number.

    Raises
    ------
    ValueError
        If the number is not between 1 and the cores of this machine.
    """
    import numba

    most: int = numba.config.NUMBA_NUM_THREADS  # type: ignore[attr-defined]
    if threads is not None and not 1 <= threads <= most:
        raise ValueError(f"threads must be 1 to {most} on this machine, got {threads}.")
    numba.set_num_threads(most if threads is None else threads)
