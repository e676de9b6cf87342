"""What the measures cost: one folded surface in several sizes, and the seconds of each stage."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numba
import numpy as np

from morphofold.analysis.measures import measure
from morphofold.geometry import vertex_normals
from morphofold.shapes import even_directions, spherical_delaunay
from morphofold.shapes.ridges import SphericalNet, irregular_net, ridged_net
from morphofold.surface import Cortex, Surface
from morphofold.timing import Stages, peak_memory

CELLS = 60              # of the net: 116 hinges, about as many as half a brain
WIDTH, HEIGHT, RADIUS, THICKNESS = 9.0, 8.0, 65.0, 1.8


def folded_ball(n: int, net: SphericalNet | None = None) -> Cortex:
    """Cortex of ``n`` vertices, evenly spread before they fold: ridges 9 mm wide and 8 mm high on a sphere of 65 mm,
    along a net, by default an irregular one of 60 cells; white lies 1.8 mm deeper along the normals. Vertices are
    numbered slice by slice of 1 mm, as those that come from a voxel image.

    Raises
    ------
    ValueError
        If there are fewer than 1,000 vertices.
    """
    if n < 1000:
        raise ValueError(f"the folded ball needs 1,000 vertices at least, got {n:,}.")
    verts = even_directions(n)
    verts = verts[np.lexsort((verts[:, 2], *np.round(RADIUS * verts[:, :2].T)))]
    faces = spherical_delaunay(verts)
    pial = ridged_net(net or irregular_net(CELLS), (verts, faces), WIDTH, height=HEIGHT, radius=RADIUS)
    white = Surface(pial.verts - THICKNESS * vertex_normals(pial.verts, faces), faces)
    return Cortex(white, pial, name=f"folded ball of {n:,}")


def measuring_speed(
    sizes: Sequence[int], progress: Callable[[float, str], None] = lambda share, text: None
) -> list[dict[str, Any]]:
    """Seconds of each stage of :func:`morphofold.analysis.measure` on :func:`folded_ball`, after once for the compiler.

    Parameters
    ----------
    sizes : sequence of int
        Vertices; measured in ascending order.
    progress : callable
        Called with the share done and a few words.

    Returns
    -------
    list of dict
        ``vertices``, ``threads``, ``stage`` ("all" for their sum), ``seconds``; ``memory_GiB``, the most that the
        process has held by then (None where the system does not say), in the rows of "all".
    """
    measure(folded_ball(1000))
    rows: list[dict[str, Any]] = []
    for k, n in enumerate(sorted(sizes)):
        progress(k / len(sizes), f"{n:,} vertices")
        cortex = folded_ball(n)
        clock = Stages()
        measure(cortex, progress=clock.at)
        common = {"vertices": n, "threads": numba.get_num_threads()}
        rows += [{**common, "stage": stage, "seconds": seconds} for stage, seconds in clock.seconds.items()]
        rows.append({**common, "stage": "all", "seconds": sum(clock.seconds.values()), "memory_GiB": peak_memory()})
    return rows


def exponent(rows: Sequence[dict[str, Any]], stage: str = "all") -> float:
    """Slope of the logarithm of seconds over that of ``vertices log(vertices)``: 1 if the cost grows as these do."""
    mine = [row for row in rows if row["stage"] == stage]
    n = np.array([row["vertices"] for row in mine], dtype=np.float64)
    return float(np.polyfit(np.log(n * np.log(n)), np.log([row["seconds"] for row in mine]), 1)[0])
