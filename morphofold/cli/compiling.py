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
    """Compile the kernels of measuring, those first that take longest and that ``measure`` does not need at once."""
    import numpy as np

    from morphofold.analysis.curvatures import curvature
    from morphofold.analysis.diffusion import diffusion
    from morphofold.analysis.graph.depth_potential import COTANGENT_BOUNDS
    from morphofold.analysis.graph.gyral_graph import gyral_graph
    from morphofold.shapes import bumpy_sphere
    from morphofold.surface import Cortex, Surface

    pial = bumpy_sphere(3, radius=40.0)
    solver = diffusion(pial.verts, pial.faces, COTANGENT_BOUNDS)
    solver.solve(1.0, solver.mass, solver.mass, 1e-3)
    curvature(pial.verts, pial.faces)
    gyral_graph(Surface(pial.verts, pial.faces))

    from morphofold.analysis.measuring import measure
    from morphofold.report.pictures import raster

    raster.look(pial.verts, pial.faces, (8, 8), 60.0).coloured(pial.verts, np.zeros(pial.verts.shape, dtype=np.uint8))
    measure(Cortex(Surface(0.92 * pial.verts, pial.faces), Surface(pial.verts, pial.faces)))


if __name__ == "__main__":
    main()
