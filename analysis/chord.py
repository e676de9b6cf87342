"""Gyral thickness: the width of a gyrus from wall to wall, at mid-height of the fold, on the pial surface."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csgraph

from morphofold.analysis import _mesh
from morphofold.analysis.smooth import Relief, edge_graph, relief
from morphofold.surface import Cortex, PerVertex, Surface

FLAT = 0.1              # amplitude / scale below which a surface counts as unfolded
SHALLOW = 0.25          # amplitude, relative to its 90th percentile, below which a ripple is no fold
LEAST_COVERAGE = 0.2    # of the mid-height contour, below which no median is stated
LONGEST = 1.2           # chord, relative to the wavelength
SYMMETRISE = np.deg2rad([0.0, -15.0, 15.0, -30.0, 30.0])
FAN = np.deg2rad([0.0, -10.0, 10.0, -20.0, 20.0])


@dataclass(frozen=True, eq=False)
class GyralThickness:
    """Widths of gyri along the mid-height contour of a surface, S samples.

    Parameters
    ----------
    points : (S, 3) float64
        Samples on the wall [mm], one per triangle that the contour crosses.
    triangle : (S,) int64
        The triangle of each.
    width : (S,) float64
        Chord through the gyrus to the opposite wall [mm]; NaN where no chord passed the tests.
    partner : (S, 3) float64
        The chord's other end [mm]; NaN likewise.
    weight : (S,) float64
        Length of contour the sample stands for [mm].
    gap : (S,) float64
        Chord through the sulcus to the next gyrus [mm]; NaN where it is closed, touching, or failed.
    per_vertex : (N,) float64
        Width [mm] of the nearest sample along the surface; NaN outside the mask and farther than a wavelength
        from every sample.
    median, lower, upper, median_gap : float
        Length-weighted median, quartiles [mm]; NaN if ``reason`` is not empty.
    coverage : float
        Share of the contour's length that has a width.
    wavelength : float
        Twice the area over the contour's length [mm]: the way along the surface from fundus to fundus.
    amplitude : float
        Length-weighted median height of the folds [mm].
    scale : float
        Smoothing length that defined the folds [mm]. Widths grow with it, so state it beside them.
    white_tested : bool
        Whether a white surface kept chords from passing below sulci. Without it widths come out about a tenth
        larger on an individual brain; never compare one kind with the other.
    relief : Relief
        Height, phase and amplitude per vertex that the contour was drawn from.
    reason : str
        Why there is no median; empty if there is one.
    """

    points: NDArray[np.float64] = field(repr=False)
    triangle: NDArray[np.int64] = field(repr=False)
    width: NDArray[np.float64] = field(repr=False)
    partner: NDArray[np.float64] = field(repr=False)
    weight: NDArray[np.float64] = field(repr=False)
    gap: NDArray[np.float64] = field(repr=False)
    per_vertex: PerVertex = field(repr=False)
    median: float
    lower: float
    upper: float
    median_gap: float
    coverage: float
    wavelength: float
    amplitude: float
    scale: float
    white_tested: bool
    relief: Relief = field(repr=False)
    reason: str = ""

    def median_where(self, vertices: NDArray[np.bool_], faces: NDArray[np.int64]) -> float:
        """Length-weighted median over the samples most of whose triangle lies in the region (N,) bool; NaN if none."""
        inside = vertices[faces[self.triangle]].sum(axis=1) >= 2
        return weighted_quantile(self.width[inside], self.weight[inside], 0.5)


def gyral_thickness(
    cortex: Cortex | Surface, *, scale: float | None = None, mask: NDArray[np.bool_] | None = None
) -> GyralThickness:
    """Width of the gyri of a closed surface: horizontal chords through the tissue at mid-height.

    Parameters
    ----------
    cortex : Cortex or Surface
        With a Cortex the pial surface is measured, chords that pass below a sulcus are told by the white surface, and
        what lies outside ``cortex.cortex`` or has white on pial is left out. A bare Surface is measured without that
        test.
    scale : float, optional
        Smoothing length [mm] that says what a fold is: 10 for an adult human brain (the table of published numbers
        uses it); None: from the surface, a third of its wavelength.
    mask : (N,) bool, optional
        True where to measure, on top of the cortex label.

    Returns
    -------
    GyralThickness
        On a surface without folds: no samples, NaN for every number, and ``reason``.

    Raises
    ------
    ImportError
        If embreex is missing: the rays would take hours without it.
    ValueError
        If scale or mask has no meaning.

    Notes
    -----
    1. Height above a copy of the surface smoothed over ``scale``, normalised between the crown and the fundus within
       1.5 scale: the phase (see :mod:`morphofold.analysis.smooth`). Folds lower than a quarter of the 90th
       percentile of the amplitude are left out.
    2. The contour phase = 1/2, one sample per triangle, weight = its length there.
    3. The vertical u at a sample: that of the smoothed copy, averaged with u at the opposite wall. Unaveraged, it leans
       outward and chords come out 4 to 8 % short.
    4. Five rays within 20 degrees in the plane normal to u, into the tissue. A ray counts if its first hit leaves the
       tissue, the horizontal parts of both walls' normals oppose (dot < -0.3), the phase of the hit lies in (0.1,
       0.9), it is shorter than 1.2 wavelengths, and it does not cross grey matter for more than a quarter of the cortical
       thickness between two stretches of white. Each length is multiplied by
       ``sqrt(cos(ray, wall normal) cos(ray, opposite wall normal))``; the width is the median of at least two.
    5. From the middle of the chord a ray along u must reach the crown, phase < 1/2, within the amplitude.

    The width of a gyrus in Fig. 8b of Razavi et al. 2015 is drawn on the pial surface; the definition here is our own
    and was tested on ridges of known width (bias -2 to +1 %).

    With ``scale=None`` the scale is repeatedly set to a third of ``wavelength`` until it changes by less than 5 %,
    bounded by ``0.3 sqrt(area / 4 pi)``. Adult brains end near 10.
    """
    surface = cortex.pial if isinstance(cortex, Cortex) else cortex
    inside = _inside(cortex, mask)
    scan = _Scanner(surface)                    # first, so that a missing package is told before the work
    contour = _contour(surface, inside, scale)
    if contour.reason:
        return _nothing(surface, contour, contour.reason)
    white, slack = None, 0.0
    if isinstance(cortex, Cortex):
        span = np.linalg.norm(cortex.pial.verts - cortex.white.verts, axis=1)
        white, slack = _Scanner(cortex.white), float(np.median(span[inside])) / 4
    return _measure(surface, inside, contour, scan, white, slack)


def weighted_quantile(values: NDArray[np.float64], weights: NDArray[np.float64], share: float) -> float:
    """Value below which ``share`` of the weight lies, NaN values left out; NaN if nothing is left."""
    good = np.isfinite(values) & (weights > 0)
    if not good.any():
        return math.nan
    order = np.argsort(values[good], kind="stable")
    v, w = values[good][order], weights[good][order]
    return float(np.interp(share, (np.cumsum(w) - w / 2) / w.sum(), v))


def _inside(cortex: Cortex | Surface, mask: NDArray[np.bool_] | None) -> NDArray[np.bool_]:
    surface = cortex.pial if isinstance(cortex, Cortex) else cortex
    n = len(surface.verts)
    inside = np.zeros(n, dtype=bool)
    inside[surface.faces] = True
    if isinstance(cortex, Cortex):
        inside &= np.any(cortex.white.verts != cortex.pial.verts, axis=1)
        if cortex.cortex is not None:
            inside &= cortex.cortex
    if mask is not None:
        if np.shape(mask) != (n,):
            raise ValueError(f"{surface.name}: mask has shape {np.shape(mask)}, the surface has {n} vertices.")
        inside &= np.asarray(mask, dtype=bool)
    if not inside.any():
        raise ValueError(f"{surface.name}: no vertex is left to measure; check the mask and the cortex label.")
    return inside


# ---- the mid-height contour -----------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Contour:
    """Samples of the mid-height contour: points (S, 3), lengths (S,), triangles (S,)."""

    points: NDArray[np.float64]
    length: NDArray[np.float64]
    triangle: NDArray[np.int64]
    wavelength: float
    relief: Relief
    reason: str = ""


def _contour(surface: Surface, inside: NDArray[np.bool_], scale: float | None) -> _Contour:
    """The contour at the given scale, or at the scale that is a third of the wavelength it finds."""
    whole = np.flatnonzero(inside[surface.faces].all(axis=1))
    area = float(_mesh.face_areas(surface.verts, surface.faces)[whole].sum())
    size = math.sqrt(area / (4 * math.pi))
    if scale is not None:
        return _contour_at(surface, inside, whole, area, float(scale))
    scale = 0.12 * size                         # about 10 for a brain
    for _ in range(8):
        contour = _contour_at(surface, inside, whole, area, scale)
        wanted = min(contour.wavelength / 3, 0.3 * size)
        if contour.reason or abs(wanted - scale) < 0.05 * scale:
            break
        scale = wanted
    return contour


def _contour_at(surface: Surface, inside: NDArray[np.bool_], whole: Any, area: float, scale: float) -> _Contour:
    found = relief(surface.verts, surface.faces, scale)
    high = float(np.percentile(found.amplitude[inside], 90))
    points, length, triangle = _level_set(surface, np.where(found.amplitude > SHALLOW * high, found.phase, np.nan), whole)
    total = float(length.sum())
    wavelength = 2 * area / total if total > 0 else math.nan
    reason = ""
    if high < FLAT * scale:
        reason = f"no folds: at scale {scale:.3g} the surface undulates by {high:.2g}, less than {FLAT:g} of the scale"
    elif total == 0:
        reason = f"no folds: no mid-height contour at scale {scale:.3g}"
    return _Contour(points, length, triangle, wavelength, found, reason)


def _level_set(
    surface: Surface, phase: PerVertex, whole: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
    """Segments of phase = 1/2 within the given triangles: midpoints (S, 3), lengths (S,), triangles (S,)."""
    value = phase[surface.faces[whole]] - 0.5
    above = value > 0
    crossed = np.isfinite(value).all(axis=1) & (above.any(axis=1) != above.all(axis=1))
    triangle, value, above = whole[crossed], value[crossed], above[crossed]
    alone = np.where((above.sum(axis=1) == 1)[:, None], above, ~above).argmax(axis=1)    # corner on its own side
    row = np.arange(len(triangle))
    corner = surface.verts[surface.faces[triangle]]
    ends = []
    for step in (1, 2):
        other = (alone + step) % 3
        a, b = value[row, alone], value[row, other]
        ends.append(corner[row, alone] + (a / (a - b))[:, None] * (corner[row, other] - corner[row, alone]))
    return (ends[0] + ends[1]) / 2, np.linalg.norm(ends[0] - ends[1], axis=1), triangle


# ---- rays -----------------------------------------------------------------------------------------------------------


class _Scanner:
    """First hits of rays on a surface (embree finds the triangle in single, we the place in double precision)."""

    def __init__(self, surface: Surface) -> None:
        try:
            from trimesh import Trimesh
            from trimesh.ray.ray_pyembree import RayMeshIntersector
        except ImportError as error:
            raise ImportError("gyral thickness casts rays with embree, which is missing: pip install embreex") from error
        self.verts, self.faces = surface.verts, surface.faces
        self.normals = _mesh.face_normals(surface.verts, surface.faces)
        self.edge = _mesh.mean_edge_length(surface.verts, surface.faces)
        mesh = Trimesh(surface.verts, surface.faces, process=False, validate=False)
        self._rays = RayMeshIntersector(mesh)

    def shoot(
        self, origins: NDArray[np.float64], directions: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.float64]]:
        """Distance (R,) of the first hit (inf: none), its triangle (R,), cosine of ray and outward normal (R,)."""
        triangle = np.asarray(self._rays.intersects_first(origins, directions), dtype=np.int64)
        normal = self.normals[triangle]
        cosine = np.sum(normal * directions, axis=1)
        ahead = np.sum((self.verts[self.faces[triangle, 0]] - origins) * normal, axis=1)
        hit = (triangle >= 0) & (np.abs(cosine) > 1e-6)
        return np.divide(ahead, cosine, out=np.full(len(origins), np.inf), where=hit), triangle, cosine

    def stays_white(
        self, origins: NDArray[np.float64], directions: NDArray[np.float64], lengths: NDArray[np.float64], slack: float
    ) -> NDArray[np.bool_]:
        """True (R,) where no stretch between leaving this surface and entering it again is longer than slack."""
        good = np.ones(len(origins), dtype=bool)
        live, gone, left = np.arange(len(origins)), np.zeros(len(origins)), np.full(len(origins), np.nan)
        for _ in range(32):                     # a ray that grazes more often than this is settled by what it did so far
            far, _, cosine = self.shoot(origins[live] + gone[live, None] * directions[live], directions[live])
            at = gone[live] + np.maximum(far, 0)
            within, leaving = at < lengths[live], cosine > 0
            good[live[within & ~leaving & (at - left[live] > slack)]] = False
            left[live[leaving]] = at[leaving]
            gone[live] = at + 1e-3 * self.edge
            live = live[within & good[live]]
            if not len(live):
                break
        return good


# ---- chords ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Samples:
    """What a chord needs to know at its start, (S, ...), and at its end, by triangle (M, ...)."""

    points: NDArray[np.float64]
    normal: NDArray[np.float64]
    triangle_normal: NDArray[np.float64]
    triangle_phase: NDArray[np.float64]
    longest: float


def _fan(
    scan: _Scanner, samples: _Samples, vertical: NDArray[np.float64], angles: NDArray[np.float64], side: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64], NDArray[np.float64]]:
    """Rays in the horizontal plane into the tissue (side = 1) or out of it (-1).

    Returns corrected lengths (S, K), NaN where not from wall to wall, plain lengths (S, K), triangles hit (S, K) and
    directions (S, K, 3).
    """
    wall = _mesh.unit(samples.normal - _along(samples.normal, vertical))
    ahead, across = -side * wall, np.cross(vertical, -side * wall)
    rays = np.cos(angles)[None, :, None] * ahead[:, None, :] + np.sin(angles)[None, :, None] * across[:, None, :]
    shape, flat = rays.shape[:2], rays.reshape(-1, 3)
    spread = lambda a: np.repeat(a, len(angles), axis=0)
    step = 5e-3 * scan.edge                     # off the triangle the ray starts on
    far, triangle, cosine = scan.shoot(spread(samples.points) + step * flat, flat)
    far = far + step
    other = samples.triangle_normal[triangle]
    other = _mesh.unit(other - _along(other, spread(vertical)))
    phase = samples.triangle_phase[triangle]
    good = (side * cosine > 0.1) & (np.sum(other * spread(wall), axis=1) < -0.3)
    good &= (phase > 0.1) & (phase < 0.9) & (far < samples.longest)
    slant = np.maximum(side * np.sum(other * flat, axis=1), 0) * spread(np.linalg.norm(wall, axis=1))
    slant *= np.tile(np.cos(angles), len(samples.points))
    length = np.where(good & (slant > 0), np.where(np.isfinite(far), far, 0) * np.sqrt(slant), np.nan)
    return length.reshape(shape), far.reshape(shape), triangle.reshape(shape), rays


def _along(a: NDArray[np.float64], u: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.sum(a * u, axis=1, keepdims=True) * u


def _middle(lengths: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Median of each row if it has two values at least, else NaN; and the column whose value is nearest to it."""
    enough = np.isfinite(lengths).sum(axis=1) >= 2
    median = np.full(len(lengths), np.nan)
    median[enough] = np.nanmedian(lengths[enough], axis=1)
    away = np.where(np.isfinite(lengths), np.abs(lengths - np.where(enough, median, 0)[:, None]), np.inf)
    return median, away.argmin(axis=1)


def _measure(
    surface: Surface, inside: NDArray[np.bool_], contour: _Contour, scan: _Scanner, white: _Scanner | None, slack: float
) -> GyralThickness:
    faces, found, row = surface.faces, contour.relief, np.arange(len(contour.points))
    normals = _mesh.vertex_normals(surface.verts, faces)
    by_triangle = normals[faces].mean(axis=1)
    samples = _Samples(
        contour.points,
        by_triangle[contour.triangle],
        by_triangle,
        np.where(inside, found.phase, np.nan)[faces].mean(axis=1),
        LONGEST * contour.wavelength,
    )
    vertical = _mesh.unit(found.vertical[faces[contour.triangle]].mean(axis=1))

    length, far, triangle, _ = _fan(scan, samples, vertical, SYMMETRISE, 1)
    nearest = np.where(np.isfinite(length), far, np.inf).argmin(axis=1)
    met = np.isfinite(length).any(axis=1)
    opposite = found.vertical[faces[triangle[row, nearest]]].mean(axis=1)
    even = np.where(met[:, None], _mesh.unit(vertical + _mesh.unit(opposite)), vertical)

    length, far, _, rays = _fan(scan, samples, even, FAN, 1)
    if white is not None:
        s, k = np.nonzero(np.isfinite(length))
        crosses_grey = ~white.stays_white(samples.points[s], rays[s, k], far[s, k], slack)
        length[s[crosses_grey], k[crosses_grey]] = np.nan
    width, k = _middle(length)
    far, ray = far[row, k], rays[row, k]
    partner = samples.points + np.where(np.isfinite(far), far, 0)[:, None] * ray

    s = np.flatnonzero(np.isfinite(width))
    up, roof, cosine = scan.shoot((samples.points[s] + partner[s]) / 2, even[s])
    amplitude = found.amplitude[faces[contour.triangle]].mean(axis=1)
    covered = (up < amplitude[s]) & (samples.triangle_phase[roof] < 0.5) & (cosine > 0)
    width[s[~covered]] = np.nan
    partner[np.isnan(width)] = np.nan

    gap, _ = _middle(_fan(scan, samples, vertical, FAN, -1)[0])
    return _report(surface, inside, contour, width, partner, gap, amplitude, white is not None)


def _report(
    surface: Surface,
    inside: NDArray[np.bool_],
    contour: _Contour,
    width: NDArray[np.float64],
    partner: NDArray[np.float64],
    gap: NDArray[np.float64],
    amplitude: NDArray[np.float64],
    white_tested: bool,
) -> GyralThickness:
    weight = contour.length
    coverage = float(weight[np.isfinite(width)].sum() / weight.sum())
    if coverage < LEAST_COVERAGE:
        return _nothing(
            surface,
            contour,
            f"no gyri: only {coverage:.0%} of the mid-height contour (scale {contour.relief.scale:.3g}) has an opposite "
            f"wall; {LEAST_COVERAGE:.0%} are needed",
        )
    quartile = [weighted_quantile(width, weight, share) for share in (0.25, 0.5, 0.75)]
    return GyralThickness(
        points=contour.points,
        triangle=contour.triangle,
        width=width,
        partner=partner,
        weight=weight,
        gap=gap,
        per_vertex=_carry(surface, inside, contour, width),
        median=quartile[1],
        lower=quartile[0],
        upper=quartile[2],
        median_gap=weighted_quantile(gap, weight, 0.5),
        coverage=coverage,
        wavelength=contour.wavelength,
        amplitude=weighted_quantile(amplitude, weight, 0.5),
        scale=contour.relief.scale,
        white_tested=white_tested,
        relief=contour.relief,
    )


def _carry(
    surface: Surface, inside: NDArray[np.bool_], contour: _Contour, width: NDArray[np.float64]
) -> PerVertex:
    """Width of the nearest sample along the edges, up to a wavelength away (N,)."""
    faces, n = surface.faces, len(surface.verts)
    good = np.isfinite(width)
    corner = faces[contour.triangle[good]].ravel()
    load = np.repeat(contour.length[good], 3)
    total, amount = np.bincount(corner, load, n), np.bincount(corner, load * np.repeat(width[good], 3), n)
    source = np.flatnonzero(total > 0)
    _, _, origin = csgraph.dijkstra(
        edge_graph(surface.verts, faces),
        directed=True,
        indices=source,
        min_only=True,
        return_predecessors=True,
        limit=contour.wavelength,
    )
    reached = inside & (origin >= 0)
    result = np.full(n, np.nan)
    result[reached] = amount[origin[reached]] / total[origin[reached]]
    return result


def _nothing(surface: Surface, contour: _Contour, reason: str) -> GyralThickness:
    none, nan = np.empty(0), math.nan
    return GyralThickness(
        points=np.empty((0, 3)),
        triangle=np.empty(0, dtype=np.int64),
        width=none,
        partner=np.empty((0, 3)),
        weight=none,
        gap=none,
        per_vertex=np.full(len(surface.verts), nan),
        median=nan,
        lower=nan,
        upper=nan,
        median_gap=nan,
        coverage=0.0,
        wavelength=nan,
        amplitude=nan,
        scale=contour.relief.scale,
        white_tested=False,
        relief=contour.relief,
        reason=reason,
    )
