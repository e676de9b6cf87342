"""Gyral thickness: the width of a gyrus from wall to wall, at mid-height of the fold, on the pial surface."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csgraph

from morphofold import geometry
from morphofold.analysis.relief import Contour, Relief, mid_height_contour
from morphofold.analysis.thickness.cortical_thickness import cortical_thickness
from morphofold.arrays import Array, Bools, Ints
from morphofold.errors import NoCortex
from morphofold.mesh_quality.checks import cortex_mask
from morphofold.surface import Cortex, PerVertex, Surface
from morphofold.validators import check_kind, same_length


class RayCaster:
    """First hit of rays on a surface. embree finds the triangle in single precision, this class the point in double."""

    def __init__(self, surface: Surface) -> None:
        try:
            from embreex.mesh_construction import TriangleMesh
            from embreex.rtcore_scene import EmbreeScene
        except ImportError as error:
            raise ImportError(
                "gyral thickness needs embree to cast rays, but it is missing: pip install embreex"
            ) from error
        self.verts, self.faces = surface.verts, surface.faces
        self.normals = geometry.face_normals(surface.verts, surface.faces)
        self.edge = geometry.mean_edge_length(surface.verts, surface.faces)
        self._origin, self._unit = surface.verts.mean(axis=0), float(np.ptp(surface.verts, axis=0).max())
        self._scene = EmbreeScene()
        TriangleMesh(self._scene, self._scaled(surface.verts), surface.faces.astype(np.int32))

    def _scaled(self, points: Array) -> NDArray[np.float32]:
        """Points moved to 0 and scaled to size 1, because embree's tolerances are absolute."""
        return ((points - self._origin) / self._unit).astype(np.float32)

    def shoot(self, origins: Array, directions: Array) -> tuple[Array, Ints, Array]:
        """Distance (R,) of the first hit (inf: none), its triangle (R,), cosine of ray and outward normal (R,)."""
        triangle = np.asarray(self._scene.run(self._scaled(origins), directions.astype(np.float32)), dtype=np.int64)
        normal = self.normals[triangle]
        cosine = np.sum(normal * directions, axis=1)
        ahead = np.sum((self.verts[self.faces[triangle, 0]] - origins) * normal, axis=1)
        hit = (triangle >= 0) & (np.abs(cosine) > 1e-6)
        return np.divide(ahead, cosine, out=np.full(len(origins), np.inf), where=hit), triangle, cosine

    def crossings(
        self, origins: Array, directions: Array, lengths: Array | float, followed: Bools
    ) -> Iterator[tuple[Ints, Array, Ints, Array]]:
        """Successive hits of rays, up to their lengths: the first hits of all rays, then the second hits, and so on.

        Yields the rays (L,) that hit, and the distances, triangles and cosines (L,). Rays whose ``followed`` (R,) is or
        becomes False are not followed. There are 32 hits at most, because of rays that graze the surface.
        """
        gone, lengths = np.zeros(len(origins)), np.broadcast_to(lengths, len(origins))
        for _ in range(32):
            live = np.flatnonzero(followed)
            if not len(live):
                return
            ahead = directions[live]
            distance, triangle, cosine = self.shoot(origins[live] + gone[live, None] * ahead, ahead)
            distances = gone[live] + np.maximum(distance, 0)
            within = distances < lengths[live]
            followed[live[~within]] = False
            live, distances = live[within], distances[within]
            gone[live] = distances + 1e-3 * self.edge
            yield live, distances, triangle[within], cosine[within]

    def bodies(self, origins: Array, directions: Array, longest: float) -> Ints:
        """Number of bodies in which each point (R,) lies: the largest count of exits less entries along its ray."""
        depth, deepest = np.zeros(len(origins), dtype=np.int64), np.zeros(len(origins), dtype=np.int64)
        for live, _, _, cosine in self.crossings(origins, directions, longest, np.ones(len(origins), dtype=bool)):
            depth[live] += np.where(cosine > 0, 1, -1)
            np.maximum(deepest, depth, out=deepest)
        return deepest

    def exits(self, origins: Array, directions: Array, number: Ints, longest: float) -> tuple[Array, Ints, Array]:
        """As ``shoot``, but for the ``number``-th (R,) exit of each ray from the surface; entries are skipped.

        The distance is inf where there is no such exit within ``longest``.
        """
        distance, hit = np.full(len(origins), np.inf), np.zeros(len(origins), dtype=np.int64)
        slope, still, followed = np.zeros(len(origins)), np.array(number), np.ones(len(origins), dtype=bool)
        for live, distances, triangle, cosine in self.crossings(origins, directions, longest, followed):
            still[live] -= cosine > 0
            last = still[live] == 0
            followed[live[last]] = False
            distance[live[last]], hit[live[last]], slope[live[last]] = distances[last], triangle[last], cosine[last]
        return distance, hit, slope

    def stays_white(self, origins: Array, directions: Array, lengths: Array, slack: float) -> Bools:
        """True (R,) where no stretch between leaving this surface and entering it again is longer than ``slack``."""
        good, left = np.ones(len(origins), dtype=bool), np.full(len(origins), np.nan)
        followed = good.copy()
        for live, distances, _, cosine in self.crossings(origins, directions, lengths, followed):
            leaving = cosine > 0
            out = live[~leaving & (distances - left[live] > slack)]
            good[out], followed[out] = False, False
            left[live[leaving]] = distances[leaving]
        return good


LEAST_COVERAGE = 0.2  # of the mid-height contour, below which no median is given
LONGEST_CHORD_IN_WAVELENGTHS = 1.2  # longest chord, relative to the wavelength
RAY_OFFSET_IN_EDGES = 5e-3  # mean edges from a triangle to the start of a ray that is cast from it
SYMMETRISING_ANGLES_RAD = np.deg2rad([0.0, -15.0, 15.0, -30.0, 30.0])
CHORD_ANGLES_RAD = np.deg2rad([0.0, -10.0, 10.0, -20.0, 20.0])


@dataclass(frozen=True, eq=False)
class GyralThickness:
    """Widths of gyri at S samples along the mid-height contour of a surface.

    Parameters
    ----------
    points : (S, 3) float64
        Samples on the wall [mm], one per triangle that the contour crosses.
    triangle : (S,) int64
        Triangle of each sample.
    width : (S,) float64
        Chord through the gyrus to the opposite wall [mm]; NaN where no chord passed the tests.
    partner : (S, 3) float64
        Other end of the chord [mm]; NaN where the width is.
    weight : (S,) float64
        Length of contour that the sample represents [mm].
    gap : (S,) float64
        Chord through the sulcus to the next gyrus [mm]; NaN where the sulcus is closed or touching, or a test failed.
    per_vertex : (N,) float64
        Width [mm] of the nearest sample along the surface that has one. NaN outside the mask, farther than half a
        wavelength from the sample, and where a sample without a width is nearer by more than half of that width. The
        width therefore stays on its own gyrus. It is measured between the walls. Where the crown is thicker than the
        walls, it may be less than twice the cortical thickness (4.6 % of the area of S1, 0.3 and 0.6 % on fsaverage5
        and 6).
    median, lower, upper, median_gap : float
        Length-weighted medians and quartiles [mm]; NaN if ``reason`` is not empty.
    coverage : float
        Share of the contour length that has a width.
    wavelength : float
        Twice the area divided by the contour length [mm]: the distance along the surface from fundus to fundus.
    amplitude : float
        Length-weighted median height of the folds [mm].
    scale : float
        Smoothing length that defines the folds [mm]. Widths grow with it, so report it with them.
    white_tested : bool
        Whether a white surface was used to reject chords that pass below sulci. Without it widths are about a tenth
        larger on an individual brain. Never compare the two kinds.
    relief : Relief
        Height, phase and amplitude per vertex, from which the contour was found.
    reason : str
        Why there is no median; empty if there is one.
    """

    points: Array
    triangle: Ints
    width: Array
    partner: Array
    weight: Array
    gap: Array
    per_vertex: PerVertex
    median: float
    lower: float
    upper: float
    median_gap: float
    coverage: float
    wavelength: float
    amplitude: float
    scale: float
    white_tested: bool
    relief: Relief
    reason: str = ""

    def __repr__(self) -> str:
        if self.reason:
            return f"GyralThickness(no median: {self.reason})"
        middle = f"median {self.median:.3g} mm, quartiles {self.lower:.3g} to {self.upper:.3g} mm"
        return f"GyralThickness({middle}, {len(self.width):,} samples, {self.coverage:.0%} of the contour)"

    def median_where(self, vertices: Bools, faces: Ints) -> float:
        """Length-weighted median of the samples with two corners or more in the region (N,) bool; NaN if none."""
        inside = self._within(vertices, faces)
        return weighted_quantile(self.width[inside], self.weight[inside], 0.5)

    def contour_where(self, vertices: Bools, faces: Ints) -> float:
        """Length [mm] of the measured contour in the region (N,) bool; below about 60 the median is of a few gyri."""
        return float(self.weight[self._within(vertices, faces) & np.isfinite(self.width)].sum())

    def _within(self, vertices: Bools, faces: Ints) -> Bools:
        return np.asarray(vertices[faces[self.triangle]].sum(axis=1) >= 2)


def gyral_thickness(
    cortex: Cortex | Surface, *, scale: float | None = None, mask: Bools | None = None
) -> GyralThickness:
    """Width of the gyri of a closed surface: horizontal chords through the tissue at mid-height.

    Parameters
    ----------
    cortex : Cortex or Surface
        With a Cortex the pial surface is measured. The white surface is used to reject chords that pass below a sulcus.
        Vertices outside the cortex (:func:`morphofold.analysis.measure`) and chords too short for two cortices are left
        out. A Surface alone is measured without these tests.
    scale : float, optional
        Smoothing length [mm] that defines a fold: 10 for an adult human brain (used in the table of published numbers).
        None: a third of the wavelength of the surface.
    mask : (N,) bool, optional
        True where to measure, in addition to the cortex label.

    Returns
    -------
    GyralThickness
        On a surface without folds it has no samples, NaN for every number, and a ``reason``.

    Raises
    ------
    ImportError
        If embreex is missing: the rays would take hours without it.
    ValueError
        If scale or mask has no meaning, white is pial everywhere, or no vertex is cortex.

    Notes
    -----
    1. The phase: the height above the surface smoothed over ``scale``, normalised between the crown and the fundus
       within 1.5 scale (see :func:`morphofold.analysis.relief.relief`). Folds lower than a quarter of the 90th
       percentile of the amplitude are left out.
    2. The contour phase = 1/2, with one sample per triangle, weighted by the length of contour there.
    3. The walls of neighbouring gyri may pass through each other; in closed sulci a little noise is enough. Then a
       sample lies in two gyri. The number of other gyri is the number of exits less entries along an outward ray. A ray
       through the gyrus skips as many walls as belong to the others, and all walls by which it enters.
    4. The vertical u at a sample is that of the smoothed surface, averaged with u at the opposite wall. This wall is
       found first with the vertical before averaging, a little too high, and again with the average. Without the
       average, u leans away from the gyrus, and chords come out 4 to 8 % short; with the wall found once, 1 to 2 %.
    5. Five rays within 20 degrees in the plane normal to u, into the tissue. A ray counts if these hold where it leaves
       the gyrus: the horizontal parts of the normals of both walls oppose each other (dot < -0.3), the phase of the hit
       lies in (0.1, 0.9), the ray is shorter than 1.2 wavelengths, and it does not cross grey matter for more than a
       quarter of the cortical thickness between two stretches of white. Each length is multiplied by
       ``sqrt(cos(ray, wall normal) cos(ray, opposite wall normal))``. The width is the median of at least two lengths.
    6. With a white surface, a width is rejected if it is below the sum of the cortical thicknesses at its two ends and
       the fold is higher than that sum: a gyrus contains two cortices and the tissue between them. These are 1 to 4 %
       of the contour, and none passes through white. Widths next to them are not those of thin gyri (median 9.2 of 9.6
       mm on S1, 8.9 of 10.8 on fsaverage5). If those widths replace the rejected ones, the median changes by 0.2 % at
       most.
    7. From the middle of the chord a ray along u must reach the crown, phase < 1/2. (It may be longer than the
       amplitude: a gyrus on the margin of the hemisphere rises higher above its chord than its walls do above the
       smoothed surface.)

    Fig. 8b of Razavi et al. 2015 shows the width of a gyrus on the pial surface. The definition here is our own. It was
    tested on Gaussian ridges of known width. The median is within 2 % of that width, and the 5th to 95th percentile are
    0.95 to 1.06, where ridges are a few widths apart or less. For isolated ridges the error goes down to -5 %, because
    the smoothed surface puts their mid-height too high. On brains the width grows by 0.14 to 0.25 mm per mm of scale.
    Smooth noise of 0.3 mm, independent on white and pial, changes the median by 1.1 % at most on S1 and fsaverage5 and
    6, and by 0.6 % on average and 2.0 % at most on a simulated cortex.

    With ``scale=None`` the scale is set to a third of ``wavelength`` repeatedly, until it changes by less than 5 %. It
    is at least two edges of the mesh and at most ``0.3 sqrt(area / 4 pi)``. Adult brains end between 10.4 and 11.3.
    """
    check_kind(cortex, (Cortex, Surface), "gyral_thickness: cortex")
    surface = cortex.pial if isinstance(cortex, Cortex) else cortex
    inside = _measured_vertices(cortex, mask)
    scan = RayCaster(surface)  # first, so that a missing package raises an error before the work
    contour = mid_height_contour(surface, inside, scale)
    if contour.reason:
        return _no_thickness(surface, contour, contour.reason)
    grey = _grey_matter_bounds(cortex, inside) if isinstance(cortex, Cortex) else None
    return _measure_chords(surface, inside, contour, scan, grey)


def weighted_quantile(values: Array, weights: Array, quantile: float) -> float:
    """Value below which ``quantile`` of the weight lies. NaN values are left out; NaN if no value is left."""
    good = np.isfinite(values) & (weights > 0)
    if not good.any():
        return math.nan
    order = np.argsort(values[good], kind="stable")
    v, w = values[good][order], weights[good][order]
    return float(np.interp(quantile, (np.cumsum(w) - w / 2) / w.sum(), v))


def _measured_vertices(cortex: Cortex | Surface, mask: Bools | None) -> Bools:
    surface = cortex.pial if isinstance(cortex, Cortex) else cortex
    inside = geometry.used(len(surface.verts), surface.faces)
    if isinstance(cortex, Cortex):
        inside &= cortex_mask(cortex)
    if mask is not None:
        same_length(mask, len(inside), f"{surface.name}: mask")
        inside &= np.asarray(mask, dtype=bool)
    if not inside.any():
        raise NoCortex(f"{surface.name}: no vertex is left to measure. Check the mask and the cortex label.")
    return inside


class _ChordData(NamedTuple):
    """Data for chords at their start, (S, ...), and at their end, by triangle (M, ...).

    ``bodies`` (S,): number of gyri in which the start lies: 1, plus the number of gyri whose walls pass through it.
    """

    points: Array
    normal: Array
    triangle_normal: Array
    triangle_phase: Array
    longest: float
    bodies: Ints


class _GreyMatterBounds(NamedTuple):
    """Bounds on chords from the grey matter. A chord may not run through it for more than ``slack`` [mm] between two
    stretches of ``white``, or be shorter than the sum of ``triangle_thickness`` (M,) [mm] at its ends."""

    white: RayCaster
    slack: float
    triangle_thickness: Array


def _grey_matter_bounds(cortex: Cortex, inside: Bools) -> _GreyMatterBounds:
    span = np.linalg.norm(cortex.pial.verts - cortex.white.verts, axis=1)
    thickness = cortical_thickness(cortex.white, cortex.pial, cap=None)
    slack, by_triangle = float(np.median(span[inside])) / 4, thickness[cortex.faces].mean(axis=1)
    return _GreyMatterBounds(RayCaster(cortex.white), slack, by_triangle)


def _cast_fan(
    scan: RayCaster, samples: _ChordData, vertical: Array, angles: Array, side: int
) -> tuple[Array, Array, Ints, Array]:
    """Rays in the horizontal plane into the tissue (side = 1) or out of it (-1).

    Returns corrected lengths (S, K), NaN where not from wall to wall, uncorrected lengths (S, K), triangles hit (S, K)
    and directions (S, K, 3).
    """
    wall = geometry.unit(samples.normal - _vector_component_along(samples.normal, vertical))
    ahead, across = -side * wall, np.cross(vertical, -side * wall)
    rays = np.cos(angles)[None, :, None] * ahead[:, None, :] + np.sin(angles)[None, :, None] * across[:, None, :]
    shape, flat = rays.shape[:2], rays.reshape(-1, 3)

    def spread(a: NDArray[Any]) -> NDArray[Any]:
        return np.repeat(a, len(angles), axis=0)

    step = RAY_OFFSET_IN_EDGES * scan.edge
    start = spread(samples.points) + step * flat
    if side > 0:
        distance, triangle, cosine = scan.exits(start, flat, spread(samples.bodies), samples.longest)
    else:
        distance, triangle, cosine = scan.shoot(start, flat)
    distance = distance + step
    other = samples.triangle_normal[triangle]
    other = geometry.unit(other - _vector_component_along(other, spread(vertical)))
    phase = samples.triangle_phase[triangle]
    good = (side * cosine > 0.1) & (np.sum(other * spread(wall), axis=1) < -0.3)
    good &= (phase > 0.1) & (phase < 0.9) & (distance < samples.longest)
    slant = np.maximum(side * np.sum(other * flat, axis=1), 0) * spread(np.linalg.norm(wall, axis=1))
    slant *= np.tile(np.cos(angles), len(samples.points))
    length = np.where(good & (slant > 0), np.where(np.isfinite(distance), distance, 0) * np.sqrt(slant), np.nan)
    return length.reshape(shape), distance.reshape(shape), triangle.reshape(shape), rays


def _symmetrised_vertical(
    scan: RayCaster, samples: _ChordData, vertical: Array, folds: Relief, faces: Ints, side: int
) -> Array:
    """The vertical (S, 3) averaged with that of the nearest opposite wall; unchanged where there is none.

    The wall is searched horizontally, so it is searched twice: with the given vertical, then with the average.
    """
    even = vertical
    for _ in range(2):
        length, distance, triangle, _ = _cast_fan(scan, samples, even, SYMMETRISING_ANGLES_RAD, side)
        nearest = np.where(np.isfinite(length), distance, np.inf).argmin(axis=1)
        opposite = geometry.unit(folds.vertical[faces[triangle[np.arange(len(distance)), nearest]]].mean(axis=1))
        even = np.where(np.isfinite(length).any(axis=1, keepdims=True), geometry.unit(vertical + opposite), even)
    return even


def _vector_component_along(a: Array, u: Array) -> Array:
    return np.sum(a * u, axis=1, keepdims=True) * u


def _median_of_rows(lengths: Array) -> tuple[Array, Ints]:
    """Median of each row if it has at least two values, else NaN; and its column, of two the one with the shorter.

    The median of an even number of values is midway between two: without this rule rounding would choose the column.
    """
    count, row = np.isfinite(lengths).sum(axis=1), np.arange(len(lengths))
    order = np.argsort(lengths, axis=1, kind="stable")  # NaN last
    low, high = order[row, np.maximum(count - 1, 0) // 2], order[row, count // 2 % lengths.shape[1]]
    return np.where(count >= 2, (lengths[row, low] + lengths[row, high]) / 2, np.nan), low


def _measure_chords(
    surface: Surface, inside: Bools, contour: Contour, scan: RayCaster, grey: _GreyMatterBounds | None
) -> GyralThickness:
    faces, folds, row = surface.faces, contour.relief, np.arange(len(contour.points))
    by_triangle = geometry.vertex_normals(surface.verts, faces)[faces].mean(axis=1)
    normal, longest = by_triangle[contour.triangle], LONGEST_CHORD_IN_WAVELENGTHS * contour.wavelength
    phase = np.where(inside, folds.phase, np.nan)[faces].mean(axis=1)
    bodies = 1 + scan.bodies(contour.points + RAY_OFFSET_IN_EDGES * scan.edge * normal, normal, longest)
    samples = _ChordData(contour.points, normal, by_triangle, phase, longest, bodies)
    vertical = geometry.unit(folds.vertical[faces[contour.triangle]].mean(axis=1))

    even = _symmetrised_vertical(scan, samples, vertical, folds, faces, 1)
    length, distance, triangle, rays = _cast_fan(scan, samples, even, CHORD_ANGLES_RAD, 1)
    if grey is not None:
        s, k = np.nonzero(np.isfinite(length))
        crosses_grey = ~grey.white.stays_white(samples.points[s], rays[s, k], distance[s, k], grey.slack)
        length[s[crosses_grey], k[crosses_grey]] = np.nan
    width, k = _median_of_rows(length)
    distance, ray, end = distance[row, k], rays[row, k], triangle[row, k]
    if grey is not None:
        both = grey.triangle_thickness[contour.triangle] + grey.triangle_thickness[end]
        width[(width < both) & (both < folds.amplitude[faces[contour.triangle]].mean(axis=1))] = np.nan
    partner = samples.points + np.where(np.isfinite(distance), distance, 0)[:, None] * ray

    s = np.flatnonzero(np.isfinite(width))
    up, roof, cosine = scan.shoot((samples.points[s] + partner[s]) / 2, even[s])
    width[s[~(np.isfinite(up) & (samples.triangle_phase[roof] < 0.5) & (cosine > 0))]] = np.nan
    partner[np.isnan(width)] = np.nan

    even = _symmetrised_vertical(scan, samples, vertical, folds, faces, -1)
    gap, _ = _median_of_rows(_cast_fan(scan, samples, even, CHORD_ANGLES_RAD, -1)[0])
    if (coverage := _coverage(contour, width)) < LEAST_COVERAGE:
        of = f"of the mid-height contour (scale {folds.scale:.3g}) has an opposite wall"
        return _no_thickness(surface, contour, f"no gyri: only {coverage:.0%} {of}; {LEAST_COVERAGE:.0%} are needed")
    per_vertex = _carry_to_vertices(surface, inside, contour, width)
    return _gyral_thickness(surface, contour, width, partner, gap, per_vertex, grey is not None)


def _gyral_thickness(
    surface: Surface, contour: Contour, width: Array, partner: Array, gap: Array, per_vertex: PerVertex, tested: bool
) -> GyralThickness:
    """The widths and what follows from them; on a contour that is not one of folds there are none."""
    weight, relief = contour.length, contour.relief
    lower, median, upper = (weighted_quantile(width, weight, quantile) for quantile in (0.25, 0.5, 0.75))
    median_gap, coverage = weighted_quantile(gap, weight, 0.5), _coverage(contour, width)
    wavelength = math.nan if contour.reason else contour.wavelength
    amplitude = weighted_quantile(relief.amplitude[surface.faces[contour.triangle]].mean(axis=1), weight, 0.5)
    samples = contour.points, contour.triangle, width, partner, weight, gap, per_vertex
    numbers = median, lower, upper, median_gap, coverage, wavelength, amplitude
    return GyralThickness(*samples, *numbers, relief.scale, tested, relief, contour.reason)


def _coverage(contour: Contour, width: Array) -> float:
    """Share of the length of the contour that has a width; 0 without a contour."""
    weight = contour.length
    return float(weight[np.isfinite(width)].sum() / weight.sum()) if len(weight) else 0.0


def _no_thickness(surface: Surface, contour: Contour, reason: str) -> GyralThickness:
    points, none = np.empty((0, 3)), np.empty(0)
    empty = replace(contour, points=points, length=none, triangle=np.empty(0, dtype=np.int64), reason=reason)
    return _gyral_thickness(surface, empty, none, points, none, np.full(len(surface.verts), math.nan), False)


def _carry_to_vertices(surface: Surface, inside: Bools, contour: Contour, width: Array) -> PerVertex:
    """Width (N,) of the nearest sample along the edges that has one; NaN where that sample is too far.

    Too far means farther than half a wavelength, or farther than the nearest of all samples by more than half of that
    width.
    """
    corners, n, reach = surface.faces[contour.triangle], len(surface.verts), contour.wavelength / 2
    graph, good = geometry.edge_graph(surface.verts, surface.faces), np.isfinite(width)
    load = np.repeat(contour.length[good], 3)
    total = np.bincount(corners[good].ravel(), load, n)
    amount = np.bincount(corners[good].ravel(), load * np.repeat(width[good], 3), n)
    distance, _, origin = csgraph.dijkstra(
        graph, indices=np.flatnonzero(total > 0), min_only=True, return_predecessors=True, limit=reach
    )
    nearest = csgraph.dijkstra(graph, indices=np.unique(corners), min_only=True, limit=reach)
    reached = np.flatnonzero(inside & (origin >= 0))
    value = amount[origin[reached]] / total[origin[reached]]
    result = np.full(n, np.nan)
    result[reached] = np.where(distance[reached] - nearest[reached] <= value / 2, value, np.nan)
    return result
