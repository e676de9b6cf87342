"""Crest lines: where a principal curvature is extremal along its own direction, on gyral crowns and sulcal fundi."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from morphofold.analysis import _mesh
from morphofold.analysis._curvature import Curvature, curvature
from morphofold.analysis.net import paths
from morphofold.analysis.smooth import diffused
from morphofold.surface import Faces, PerVertex, Verts

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

CALM = 0.6              # scales over which extremality is smoothed
FLAT, SHARP = 0.25, 1.0 # times the cube of its curvature by which a crest falls away: everywhere, and at its median
ROUND = 0.15            # share of k1 by which k2 is less on a crest
SHORTEST = 1.0          # scales that a line has at least
KINDS = ("gyral", "sulcal")


@dataclass(frozen=True, eq=False)
class CrestLine:
    """One line.

    Attributes
    ----------
    kind : {"gyral", "sulcal"}
    points : (P, 3) float64
        On edges of the surface, one after another [mm]; the first is the last of a closed line.
    length : float
        [mm].
    strength : float
        Integral of the extremal curvature along the line, without sign and unit (Ohtake and others 2004).
    mean_H : float
        Mean of the mean curvature along the line [1/mm], convex positive.
    """

    kind: str
    points: Array = field(repr=False)
    length: float
    strength: float
    mean_H: float


@dataclass(frozen=True, eq=False)
class CrestLines:
    """The crest lines of a surface, the strongest first, and the ``scale`` of its curvature [mm]."""

    lines: list[CrestLine] = field(repr=False)
    scale: float

    def of_kind(self, kind: str) -> list[CrestLine]:
        return [line for line in self.lines if line.kind == kind]

    def length(self, kind: str) -> float:
        """Of all lines of a kind [mm]."""
        return float(sum(line.length for line in self.of_kind(kind)))


def crest_lines(
    verts: Verts, faces: Faces, *, scale: float | None = None, curv: Curvature | None = None, weakest: float = 0.0
) -> CrestLines:
    """Gyral and sulcal crest lines.

    Parameters
    ----------
    verts, faces : (N, 3) float64, (M, 3) int64
        Surface [mm], faces counter-clockwise seen from outside.
    scale : float, optional
        Of the curvature [mm]; None: that of :func:`morphofold.analysis.curvature`.
    curv : Curvature, optional
        Curvature of the surface, if it is there already.
    weakest : float
        Least strength of a line.

    Returns
    -------
    CrestLines

    Raises
    ------
    ValueError
        If the arrays are no mesh, scale does not fit it (as in ``curvature``), or scale and ``curv`` are both given.

    Notes
    -----
    Gyral: ``e1 = 0``, ``de1/dt1 < 0``, ``k1 > |k2|``; sulcal: the same of the surface turned inside out (Ohtake,
    Belyaev, Seidel 2004, ACM TOG 23). Extremality comes from the cubic terms of the fit behind the curvature; as a
    vector ``e1 d1`` it does not depend on the sign of d1, and so is smoothed over 0.6 ``scale``. On an edge whose ends
    have a maximum between them the place of the zero is linear. A sphere, a torus, a cylinder and all cyclides of Dupin
    have e = 0 everywhere and must have no lines: so the curvature has to fall away from a crest by a quarter of its own
    cube everywhere and by more than that cube at the median of a line, ``-d2k/dt2 > k^3``, bounds without unit,
    whatever the mesh; and k2 has to be less than 0.85 k1, for near an umbilic noise alone chooses the direction. Lines
    shorter than ``scale`` are left out.

    Crest lines end before they meet: where three gyri do the surface is umbilic, with no direction to follow. The net
    is the business of :func:`morphofold.analysis.gyral_graph`.
    """
    if curv is not None and scale is not None:
        raise ValueError("pass scale or curv, not both: curv has its scale.")
    if curv is None:
        curv = curvature(verts, faces, scale)
    found = []
    for kind in KINDS:
        sign = 1.0 if kind == "gyral" else -1.0
        k, other, along, e = (
            (curv.k1, curv.k2, curv.d1, curv.e1) if kind == "gyral" else (-curv.k2, -curv.k1, curv.d2, -curv.e2)
        )
        flow = np.nan_to_num(diffused(verts, faces, np.nan_to_num(e[:, None] * along), CALM * curv.scale))
        found += [
            CrestLine(kind, points, length, float(strength), sign * float(bent))
            for points, length, strength, bent in _trace(verts, faces, k, other, along, flow)
            if length >= SHORTEST * curv.scale and strength >= weakest
        ]
    return CrestLines(sorted(found, key=lambda line: -line.strength), curv.scale)


def _trace(
    verts: Verts, faces: Faces, k: PerVertex, other: PerVertex, along: Array, flow: Array
) -> Iterator[tuple[Array, float, float, float]]:
    """Points, length, integral of k and mean of (k + other) / 2 of each line."""
    pairs = _mesh.edges(faces)
    i, j = pairs.T
    ti, tj = along[i], along[j]
    tj = np.where(np.sum(ti * tj, axis=1) < 0, -1.0, 1.0)[:, None] * tj
    ei, ej = np.sum(flow[i] * ti, axis=1), np.sum(flow[j] * tj, axis=1)
    step = verts[j] - verts[i]
    si, sj = np.sum(step * ti, axis=1), np.sum(step * tj, axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        share = np.abs(ei) / (np.abs(ei) + np.abs(ej))
        height, level = (1 - share) * k[i] + share * k[j], (1 - share) * other[i] + share * other[j]
        falls = (np.abs(ei) + np.abs(ej)) / np.abs(0.5 * (si + sj))
        crossed = (
            (ei * ej < 0) & ((ei * si > 0) | (ej * sj < 0))
            & (k[i] > np.abs(other[i])) & (k[j] > np.abs(other[j])) & (falls > FLAT * height**3)
            & (level < (1 - ROUND) * height)
        )  # fmt: skip
    at = np.flatnonzero(crossed)
    points = verts[i[at]] + share[at, None] * step[at]
    bent, sharp = 0.5 * (height + level)[at], (falls / height**3)[at]
    number = np.full(len(pairs), -1)
    number[at] = np.arange(len(at))
    key = i * len(verts) + j
    after = np.roll(faces, -1, axis=1)
    side = number[np.searchsorted(key, np.minimum(faces, after) * len(verts) + np.maximum(faces, after))]
    count = (side >= 0).sum(axis=1)
    two, three = side[count == 2], side[count == 3]
    middle = len(points) + np.arange(len(three))
    points = np.concatenate([points, points[three].mean(axis=1)]) if len(three) else points
    height = np.r_[height[at], height[at][three].mean(axis=1)] if len(three) else height[at]
    bent = np.r_[bent, bent[three].mean(axis=1)] if len(three) else bent
    sharp = np.r_[sharp, sharp[three].mean(axis=1)] if len(three) else sharp
    links = np.concatenate([two[two >= 0].reshape(-1, 2), np.column_stack([np.repeat(middle, 3), three.ravel()])])
    a, b = np.r_[links[:, 0], links[:, 1]], np.r_[links[:, 1], links[:, 0]]
    graph = sparse.csr_array((np.ones(len(a), dtype=np.int8), (a, b)), shape=(len(points), len(points)))
    for path in paths(graph, middle):
        line = points[path]
        steps = np.linalg.norm(np.diff(line, axis=0), axis=1)
        length = float(steps.sum())
        if length > 0 and np.median(sharp[path]) > SHARP:
            yield (line, length, 0.5 * float(np.sum(steps * (height[path][1:] + height[path][:-1]))),
                   0.5 * float(np.sum(steps * (bent[path][1:] + bent[path][:-1]))) / length)  # fmt: skip
