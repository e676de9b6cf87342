"""The mid-height contour of the folds of a surface: halfway between crown and fundus, on every wall."""

import math
from dataclasses import dataclass

import numpy as np

from morphofold import geometry
from morphofold.analysis.relief import Relief, relief
from morphofold.arrays import Array, Bools, Ints
from morphofold.surface import PerVertex, Surface

LEAST_AMPLITUDE_OVER_SCALE = 0.1  # amplitude / scale below which a surface counts as unfolded
LEAST_RELATIVE_AMPLITUDE = 0.25  # amplitude, relative to its 90th percentile, below which a ripple is not a fold
SHORTEST_WAVELENGTH_IN_EDGES = 4.0  # wavelength / mean edge, below which folds cannot be distinguished from noise
# wavelength / radius of the sphere of equal area, above which it is the body's shape, not a fold
LONGEST_WAVELENGTH_IN_RADII = 1.0


@dataclass(frozen=True, eq=False)
class Contour:
    """Samples of the mid-height contour, one per triangle it crosses.

    ``points`` (S, 3) [mm]; ``length`` (S,) [mm] of contour in the ``triangle`` (S,); ``wavelength`` [mm], twice the
    area divided by the total length; ``reason``: why this is not a contour of folds, empty if it is one.
    """

    points: Array
    length: Array
    triangle: Ints
    wavelength: float
    relief: Relief
    reason: str = ""


def mid_height_contour(surface: Surface, inside: Bools, scale: float | None) -> Contour:
    """The contour where ``inside`` (N,), at the given scale [mm], or at a third of the wavelength that it finds."""
    whole = np.flatnonzero(inside[surface.faces].all(axis=1))
    size = geometry.equal_area_radius(surface.verts, surface.faces[whole])
    edge = geometry.mean_edge_length(surface.verts, surface.faces)
    if scale is not None:
        return _contour_at_scale(surface, inside, whole, size, edge, float(scale))
    scale = 0.115 * size  # the result for a human brain is within 5 % of it, so one step is enough
    for _ in range(8):
        contour = _contour_at_scale(surface, inside, whole, size, edge, scale)
        wanted = max(min(contour.wavelength / 3, 0.3 * size), 2 * edge)
        if contour.reason or abs(wanted - scale) < 0.05 * scale:
            break
        scale = wanted
    return contour


def _contour_at_scale(surface: Surface, inside: Bools, whole: Ints, size: float, edge: float, scale: float) -> Contour:
    found = relief(surface.verts, surface.faces, scale)
    high = float(np.percentile(found.amplitude[inside], 90))
    phase = np.where(found.amplitude > LEAST_RELATIVE_AMPLITUDE * high, found.phase, np.nan)
    points, length, triangle = _level_set(surface, phase, whole)
    total = float(length.sum())
    wavelength = 8 * math.pi * size**2 / total if total > 0 else math.nan
    reason = ""
    border, used = geometry.border_edges(surface.faces), geometry.used(len(surface.verts), surface.faces)
    if len(border) and len(np.unique(border)) == np.count_nonzero(used):
        reason = "no wavelength of a band one row of triangles wide: all its vertices lie on its border"
    elif high < LEAST_AMPLITUDE_OVER_SCALE * scale:
        reason = (
            f"no folds: at scale {scale:.3g} the height of the surface varies by {high:.2g}, less than "
            f"{LEAST_AMPLITUDE_OVER_SCALE:g} of the scale"
        )
    elif not wavelength <= LONGEST_WAVELENGTH_IN_RADII * size:  # also if there is no contour
        reason = (
            f"no folds: at scale {scale:.3g} the mid-height contour is {total:.3g} long on a surface of radius "
            f"{size:.3g}; so short a contour comes from the shape of the body"
        )
    elif wavelength < SHORTEST_WAVELENGTH_IN_EDGES * edge:
        reason = (
            f"no folds resolved: at scale {scale:.3g} their wavelength is {wavelength:.2g}, which is "
            f"{wavelength / edge:.2g} mesh edges; {SHORTEST_WAVELENGTH_IN_EDGES:g} are needed. Remove the noise by "
            "smoothing, or refine the mesh"
        )
    return Contour(points, length, triangle, wavelength, found, reason)


def _level_set(surface: Surface, phase: PerVertex, whole: Ints) -> tuple[Array, Array, Ints]:
    """Segments of phase = 1/2 within the given triangles: midpoints (S, 3), lengths (S,), triangles (S,)."""
    value = phase[surface.faces[whole]] - 0.5
    above = value > 0
    crossed = np.isfinite(value).all(axis=1) & (above.any(axis=1) != above.all(axis=1))
    triangle, value, above = whole[crossed], value[crossed], above[crossed]
    alone = np.where((above.sum(axis=1) == 1)[:, None], above, ~above).argmax(
        axis=1
    )  # the corner that is alone on its side
    row = np.arange(len(triangle))
    corner = surface.verts[surface.faces[triangle]]
    ends = []
    for step in (1, 2):
        other = (alone + step) % 3
        a, b = value[row, alone], value[row, other]
        ends.append(corner[row, alone] + (a / (a - b))[:, None] * (corner[row, other] - corner[row, alone]))
    return (ends[0] + ends[1]) / 2, np.linalg.norm(ends[0] - ends[1], axis=1), triangle
