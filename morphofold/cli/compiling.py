"""Compile the kernels of measuring in a process of its own, once on a machine, while a command does other work."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def compiling_beside(threads: int | None) -> Iterator[None]:
    """While the block runs, compile the kernels of measuring, unless they are kept from before or one core is used."""
    from morphofold.kernel_files import is_kept

    if threads == 1 or os.cpu_count() == 1 or is_kept("morphofold.analysis.diffusion"):
        yield
        return
    none = subprocess.DEVNULL
    child = subprocess.Popen([sys.executable, "-m", __name__], stdin=none, stdout=none, stderr=none)
    try:
        yield
    finally:
        child.terminate()  # a kernel is kept whole or not at all
        child.wait()


def main() -> None:
    """Compile the kernels of measuring, those first that ``measure`` needs late."""
    import numpy as np

    from morphofold.analysis import curvature, folding_indices, gyral_graph
    from morphofold.analysis.measuring import measure
    from morphofold.report.pictures import raster
    from morphofold.shapes.folded_ball import folded_ball

    ball = folded_ball(1000)
    verts, faces = ball.pial.verts, ball.faces
    folding_indices(verts, faces, 20.0)
    curvature(verts, faces)
    gyral_graph(ball)
    raster.look(verts, faces, (8, 8), 60.0).coloured(verts, np.zeros((len(verts), 3), dtype=np.uint8))
    measure(ball)


if __name__ == "__main__":
    main()
