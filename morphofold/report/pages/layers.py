"""The gyral net as a layer of the viewer: crests as lines of drawn vertices, hinges with the text for a click."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from morphofold.analysis.graph.hinges import counts
from morphofold.analysis.measures import Measures
from morphofold.words import number

VertexIds = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Net:
    """A gyral net on the drawn vertices.

    Attributes
    ----------
    crests : sequence of (P,) int64
        Indices in the list of drawn vertices, along each crest.
    hinges : list of dict
        ``at``, the index of the nearest drawn vertex, ``degree``, whether it is ``doubtful``, and ``lines`` of label
        and text.
    """

    crests: Sequence[VertexIds]
    hinges: list[dict[str, Any]]


def net_of(measures: Measures, ids: VertexIds) -> Net | None:
    """The net of a surface, of which only the vertices ``ids`` (n,) are drawn; None if it has no graph."""
    if measures.graph is None:
        return None
    tree = cKDTree(measures.cortex.white.verts[ids])
    crests = []
    for _, _, crest in measures.graph.edges(data=True):
        near: VertexIds = tree.query(crest["polyline"])[1].astype(np.int64)
        near = near[np.flatnonzero(np.diff(near, prepend=-1))]  # drop consecutive repeats
        crests.append(near)
    arms: dict[int, list[dict[str, Any]]] = {}
    for row in measures.arms:
        arms.setdefault(row["hinge"], []).append(row)
    hinges = [
        {
            "at": int(tree.query((row["x"], row["y"], row["z"]))[1]),
            "degree": row["degree"],
            "doubtful": not counts(row),
            "lines": _lines_of_click_text(row, arms.get(row["hinge"], [])),
        }
        for row in measures.hinges
    ]
    return Net(crests, hinges)


def _lines_of_click_text(row: dict[str, Any], arms: Sequence[dict[str, Any]]) -> list[tuple[str, str]]:
    """Label and text that a click on a hinge shows."""
    angles = ", ".join(f"{number(arm['angle_deg'])}°" for arm in arms)
    lengths = ", ".join(number(arm["length_mm"]) for arm in arms)
    kind = f"{row['hinge']}, {row['shape']}" + (", by a dead-end gyrus" if row.get("blind") else "")
    lines = [("Hinge", kind), ("Angles", angles), ("Arms", f"{lengths} mm")]
    if row.get("confidence") is not None:
        doubt = "" if counts(row) else ", doubtful: not counted"
        lines.append(("Confidence", f"{number(row['confidence'])}{doubt}"))
    return lines
