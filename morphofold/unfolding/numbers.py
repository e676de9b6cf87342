"""Numbers of an unfolding: how far it went, what cortex fits, and where the area of a folded surface comes from."""

from typing import Any

import numpy as np
from scipy.spatial import ConvexHull

from morphofold.arrays import Array
from morphofold.geometry import face_areas, face_vectors, vertex_areas
from morphofold.intersections.intersection import self_intersections
from morphofold.surface import Regions
from morphofold.unfolding.unfold import Unfolding, quadrature

LEAST_RADIUS_OVER_T = 1.3  # of a convex bend over the thickness of a cortex under it, so that its inside does not fold
#: meaning of the columns of ``unfold.tsv``
COLUMNS = {
    "hemi": "Hemisphere, lh (left) or rh (right)",
    "level": "Time of the heat flow on the unit sphere",
    "radius_mm": "Radius of the sphere with the area of the smooth surface",
    "folded_area_mm2": "Area of the folded surface",
    "area_mm2": "Area of the smooth surface",
    "gyrification_index": "Area of the smooth surface over that of its convex hull",
    "volume_over_hull": "Volume in the smooth surface over that in its convex hull",
    "least_convex_radius_mm": "Least radius of curvature where it is convex",
    "least_concave_radius_mm": "Least radius of curvature where it is concave; n/a if it is convex everywhere",
    "thickest_cortex_mm": "Thickest cortex that fits under it: the least convex radius over 1.3",
    "sd_log_area_ratio": "Standard deviation of the logarithm of the ratio of areas, weighted by smooth area",
    "area_ratio_p1": "1st percentile of the ratio of areas, folded over smooth, 1 in the mean",
    "area_ratio_p50": "Its median",
    "area_ratio_p99": "Its 99th percentile",
    "crossings": "Edges of the smooth surface that cross it",
}


def unfolding_numbers(found: Unfolding) -> dict[str, Any]:
    """The numbers of :data:`COLUMNS`, without the hemisphere."""
    smooth, (s, _) = found.smooth(), quadrature(3 * found.surface.shape.degree)
    curvature, hull = found.surface.frame(s).curvature, ConvexHull(smooth.verts)
    volume = float(
        np.einsum("fi,fi->", smooth.verts[smooth.faces].mean(axis=1), face_vectors(smooth.verts, smooth.faces)) / 3
    )
    area, ratio = vertex_areas(smooth.verts, smooth.faces), found.area_ratio()
    known = np.isfinite(ratio) & (ratio > 0)
    least, most = float(curvature.min()), float(curvature.max())
    return {
        "level": found.level,
        "radius_mm": found.radius,
        "folded_area_mm2": float(face_areas(found.folded.verts, found.folded.faces).sum()),
        "area_mm2": float(area.sum()),
        "gyrification_index": float(area.sum() / hull.area),
        "volume_over_hull": volume / float(hull.volume),
        "least_convex_radius_mm": 1 / most,
        "least_concave_radius_mm": -1 / least if least < 0 else None,
        "thickest_cortex_mm": 1 / most / LEAST_RADIUS_OVER_T,
        "sd_log_area_ratio": _weighted_sd(np.log(ratio[known]), area[known]),
        **{f"area_ratio_p{p}": float(np.percentile(ratio[known], p)) for p in (1, 50, 99)},
        "crossings": len(self_intersections(smooth, vertices=False)),
    }


def region_rows(found: Unfolding, regions: Regions) -> list[dict[str, Any]]:
    """For each region its share of the folded and of the smooth area [%], and the ratio of the two."""
    smooth = found.smooth()
    areas = [vertex_areas(surface.verts, surface.faces) for surface in (found.folded, smooth)]
    rows = []
    for k, name in enumerate(regions.names):
        inside = regions.labels == k
        if not inside.any():
            continue
        folded, flat = (100 * float(area[inside].sum() / area.sum()) for area in areas)
        rows.append({"region": name, "folded_percent": folded, "smooth_percent": flat, "area_ratio": folded / flat})
    return rows


def _weighted_sd(values: Array, weights: Array) -> float:
    return float(np.sqrt(np.average((values - np.average(values, weights=weights)) ** 2, weights=weights)))
