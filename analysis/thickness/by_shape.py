"""Cortical thickness of convex, saddle-shaped and concave cortex, and of crowns, walls and fundi."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from morphofold.arrays import Bools
from morphofold.geometry import norms, vertex_areas
from morphofold.surface import Cortex, PerVertex
from morphofold.validators import check_kind

RIDGE = 0.5  # shape index of a ridge, and less than 0 of a groove: there one principal curvature is 0
#: shares of the area of the cortex in the order of depth: the shallowest, the middle and the deepest part
DEPTHS = {"crown": (0.0, 0.15), "wall": (0.35, 0.65), "fundus": (0.85, 1.0)}
EQUAL_DEPTH_TOLERANCE = 1e-7  # of the root of the area of the cortex


def thickness_by_shape(cortex: Cortex, maps: Mapping[str, PerVertex]) -> list[dict[str, Any]]:
    """Thickness over the parts of a cortex that its shape, and its depth, make.

    Parameters
    ----------
    cortex : Cortex
    maps : mapping of str to (N,) float64
        ``cortical_thickness`` [mm], ``shape_index`` of pial, and ``sulcal_depth`` [mm]; NaN where undefined. Without a
        map of shape or depth, its rows are missing.

    Returns
    -------
    list of dict
        Six rows: ``by`` is ``"shape"`` for the parts ``concave``, ``saddle`` and ``convex``, and ``"depth"`` for
        ``crown``, ``wall`` and ``fundus``. ``area_mid_mm2`` is the mean of the areas of white and pial, by which the
        other numbers are weighted: ``thickness_mm`` and ``thickness_sd_mm``, mean and standard deviation of cortical
        thickness (closest points), and ``column_mm``, the mean distance from a vertex of white to its own on pial. None
        where a part has no vertex.

    Notes
    -----
    Convex, concave: both principal curvatures are positive, or negative; a shape index above 1/2, or below -1/2
    (Koenderink, van Doorn 1992). A surface parallel to pial, such as the one midway to white, has the same parts, since
    an offset changes the size of principal curvatures and not their sign. Crown, wall and fundus are 15, 30 and 15 % of
    the cortex by area, in the order of sulcal depth: its first part, its middle and its last. Vertices of equal depth,
    as on a convex body, are all in a part or all outside.
    """
    check_kind(cortex, Cortex, "thickness_by_shape: cortex")
    thickness = maps["cortical_thickness"]
    white, pial = (vertex_areas(s.verts, cortex.faces) for s in (cortex.white, cortex.pial))
    area = 0.5 * (white + pial)
    column = norms(cortex.pial.verts - cortex.white.verts)
    rows = []
    for by, parts in _parts(maps, area, np.isfinite(thickness)):
        for part, at in parts.items():
            row: dict[str, Any] = {"hemi": cortex.hemi, "by": by, "part": part, "n_vertices": int(at.sum())}
            row |= dict.fromkeys(("area_mid_mm2", "thickness_mm", "thickness_sd_mm", "column_mm"))
            weights = area[at]
            if weights.sum() > 0:
                mean = float(np.average(thickness[at], weights=weights))
                spread = float(np.sqrt(np.average((thickness[at] - mean) ** 2, weights=weights)))
                row |= {"area_mid_mm2": float(weights.sum()), "thickness_mm": mean, "thickness_sd_mm": spread}
                row["column_mm"] = float(np.average(column[at], weights=weights))
            rows.append(row)
    return rows


def _parts(maps: Mapping[str, PerVertex], area: PerVertex, known: Bools) -> Iterator[tuple[str, dict[str, Bools]]]:
    """Which vertices (N,) are in each part."""
    if "shape_index" in maps:
        index = maps["shape_index"]
        inside = known & np.isfinite(index)
        shape = {"concave": index < -RIDGE, "saddle": np.abs(index) <= RIDGE, "convex": index > RIDGE}
        yield "shape", {part: inside & at for part, at in shape.items()}
    if "sulcal_depth" in maps:
        depth = maps["sulcal_depth"]
        some = np.flatnonzero(known & np.isfinite(depth))
        order = some[np.argsort(depth[some], kind="stable")]
        share = np.cumsum(area[order]) - 0.5 * area[order]
        share /= max(float(area[order].sum()), np.finfo(float).tiny)
        found: dict[str, Bools] = {}
        same = EQUAL_DEPTH_TOLERANCE * area[order].sum() ** 0.5
        for part, (low, high) in DEPTHS.items():
            ends = depth[order[(share >= low) & (share <= high)]]
            least, most = ends.min(initial=np.inf) - same, ends.max(initial=-np.inf) + same
            found[part] = known & (depth >= least) & (depth <= most)
        yield "depth", found
