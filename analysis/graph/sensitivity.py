"""Sensitivity of the number of hinges to the lengths of a gyral graph."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from morphofold.analysis.graph.crest_net import CrestNetBuilder, GyralScales
from morphofold.analysis.graph.net import Net
from morphofold.errors import OutOfRange, UnknownName
from morphofold.progress import Progress, silent
from morphofold.surface import Cortex, Surface

#: lengths that are varied: those of the net, and those of its depth potential, which take longer
NET_LENGTHS = ("persistence", "merge", "prune", "tip")
POTENTIAL_LENGTHS = ("smoothing", "reach")
LENGTH_FACTORS = (0.5, 0.75, 1.5, 2.0)


def hinge_sensitivity(
    surface: Cortex | Surface,
    *,
    width: float | None = None,
    lengths: Sequence[str] = NET_LENGTHS + POTENTIAL_LENGTHS,
    factors: Sequence[float] = LENGTH_FACTORS,
    progress: Progress = silent,
) -> list[dict[str, Any]]:
    """Number of hinges when one length at a time is changed.

    Parameters
    ----------
    surface, width
        As in :func:`morphofold.analysis.gyral_graph`.
    lengths : sequence of str
        Fields of ``GyralScales``.
    factors : sequence of float
        Factors by which each length is multiplied.
    progress : callable
        Called with the share done and a short text.

    Returns
    -------
    list of dict
        ``length`` (its name; empty in the first row, which is the unchanged net), ``factor``, ``mm``, ``n_hinges``,
        ``n_hinges_3``, ``n_hinges_4``, ``n_ends``; ``crest_length_mm`` of the net before its curves move onto the
        crowns, 0.6 to 0.8 % more than that of ``measure``; ``kept``, the share of hinges of the unchanged net within
        half a crown width of a hinge of the changed net; ``old``, the share of hinges of the changed net within half a
        crown width of a hinge of the unchanged net. Empty if the surface has no folds.

    Raises
    ------
    ValueError
        If a name is not one of the lengths, or a factor is not positive.
    """
    for name in lengths:
        if name not in NET_LENGTHS + POTENTIAL_LENGTHS:
            raise UnknownName(f"{name!r} is not a length to vary; use {', '.join(NET_LENGTHS + POTENTIAL_LENGTHS)}.")
    if not all(0 < factor < np.inf for factor in factors):
        raise OutOfRange(f"factors must be positive, got {list(factors)}.")
    builder = CrestNetBuilder(surface)
    scales = builder.scales(width, None)
    if scales is None:
        return []
    fields = builder.fields(scales)
    base = builder.net(fields, scales)
    rows = [_sensitivity_row("", 1.0, np.nan, base, base, scales)]
    cases = [(name, factor) for name in lengths for factor in factors]
    for k, (name, factor) in enumerate(cases):
        progress(k / len(cases), f"{name} x {factor:g}")
        changed = replace(scales, **{name: factor * getattr(scales, name)})
        other = fields if name in NET_LENGTHS else builder.fields(changed)
        rows.append(_sensitivity_row(name, factor, getattr(changed, name), builder.net(other, changed), base, scales))
    return rows


def _sensitivity_row(name: str, factor: float, mm: float, net: Net, base: Net, scales: GyralScales) -> dict[str, Any]:
    degrees = np.array(list(net.degrees().values()), dtype=np.int64)
    return {
        "length": name,
        "factor": factor,
        "mm": mm,
        "n_hinges": int((degrees > 2).sum()),
        "n_hinges_3": int((degrees == 3).sum()),
        "n_hinges_4": int((degrees == 4).sum()),
        "n_ends": int((degrees == 1).sum()),
        "crest_length_mm": float(sum(arc.length for arc in net.arcs.values())),
        "kept": _share_of_hinges_near(base, net, scales),
        "old": _share_of_hinges_near(net, base, scales),
    }


def _share_of_hinges_near(one: Net, other: Net, scales: GyralScales) -> float:
    """Share of the hinges of one net within half a crown width of a hinge of the other; NaN if there are none."""
    place = [
        np.array([net.nodes[node].at for node, degree in net.degrees().items() if degree > 2]).reshape(-1, 3)
        for net in (one, other)
    ]
    if not len(place[0]):
        return np.nan
    if not len(place[1]):
        return 0.0
    return float((cKDTree(place[1]).query(place[0])[0] < 0.5 * scales.width).mean())
