"""Time of the measures: one folded surface in several sizes, and the seconds of each stage."""

from collections.abc import Sequence
from typing import Any

import numba
import numpy as np

from morphofold.analysis.measuring import measure
from morphofold.progress_callbacks import Progress, logged
from morphofold.studies.folded_ball import folded_ball
from morphofold.timing import Stages, peak_memory


def measuring_speed(vertex_counts: Sequence[int], progress: Progress = logged) -> list[dict[str, Any]]:
    """Seconds of each stage of :func:`morphofold.analysis.measure` on :func:`folded_ball`, after a run that compiles.

    Parameters
    ----------
    vertex_counts : sequence of int
        Numbers of vertices; measured in ascending order.
    progress : callable
        Called with the share done and a short text.

    Returns
    -------
    list of dict
        ``vertices``, ``threads``, ``stage`` ("all" for their sum), ``seconds``; rows of "all" also have
        ``memory_GiB``, the peak memory of the process so far (None if the system does not give it).
    """
    measure(folded_ball(1000))
    rows: list[dict[str, Any]] = []
    for k, n_vertices in enumerate(sorted(vertex_counts)):
        progress(k / len(vertex_counts), f"{n_vertices:,} vertices")
        cortex = folded_ball(n_vertices)
        clock = Stages()
        measure(cortex, clock=clock)
        run_keys = {"vertices": n_vertices, "threads": numba.get_num_threads()}
        rows += [{**run_keys, "stage": stage, "seconds": seconds} for stage, seconds in clock.seconds.items()]
        rows.append({**run_keys, "stage": "all", "seconds": sum(clock.seconds.values()), "memory_GiB": peak_memory()})
    return rows


def exponent(rows: Sequence[dict[str, Any]], stage: str = "all") -> float:
    """Slope of the logarithm of seconds over that of ``vertices log(vertices)``: 1 if time is proportional to it."""
    stage_rows = [row for row in rows if row["stage"] == stage]
    n = np.array([row["vertices"] for row in stage_rows], dtype=np.float64)
    return float(np.polyfit(np.log(n * np.log(n)), np.log([row["seconds"] for row in stage_rows]), 1)[0])
