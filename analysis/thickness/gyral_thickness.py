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
from morphofold.errors import NoCortex
from morphofold.frozen_arrays import Array, Bools, Ints
from morphofold.mesh_quality.cortex_checks import cortex_mask
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
        self.mean_edge = geometry.mean_edge_length(surface.verts, surface.faces)
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
        plane_distance = np.sum((self.verts[self.faces[triangle, 0]] - origins) * normal, axis=1)
        is_hit = (triangle >= 0) & (np.abs(cosine) > 1e-6)
        return np.divide(plane_distance, cosine, out=np.full(len(origins), np.inf), where=is_hit), triangle, cosine

    def crossings(
        self, origins: Array, directions: Array, lengths: Array | float, is_followed: Bools
    ) -> Iterator[tuple[Ints, Array, Ints, Array]]:
        """Successive hits of rays, up to their lengths: the first hits of all rays, then the second hits, and so on.

        Yields the rays (L,) that hit, and the distances, triangles and cosines (L,). Rays whose ``is_followed`` (R,) is
        or becomes False are not followed. There are 32 hits at most, because of rays that graze the surface.
        """
        travelled, lengths = np.zeros(len(origins)), np.broadcast_to(lengths, len(origins))
        for _ in range(32):
            live_rays = np.flatnonzero(is_followed)
            if not len(live_rays):
                return
            heading = directions[live_rays]
            distance, triangle, cosine = self.shoot(origins[live_rays] + travelled[live_rays, None] * heading, heading)
            distances = travelled[live_rays] + np.maximum(distance, 0)
            is_within = distances < lengths[live_rays]
            is_followed[live_rays[~is_within]] = False
            live_rays, distances = live_rays[is_within], distances[is_within]
            travelled[live_rays] = distances + 1e-3 * self.mean_edge
            yield live_rays, distances, triangle[is_within], cosine[is_within]

    def bodies(self, origins: Array, directions: Array, longest: float) -> Ints:
        """Number of bodies in which each point (R,) lies: the largest count of exits less entries along its ray."""
        n_exits, most_exits = np.zeros(len(origins), dtype=np.int64), np.zeros(len(origins), dtype=np.int64)
        for live_rays, _, _, cosine in self.crossings(origins, directions, longest, np.ones(len(origins), dtype=bool)):
            n_exits[live_rays] += np.where(cosine > 0, 1, -1)
            np.maximum(most_exits, n_exits, out=most_exits)
        return most_exits

    def exits(self, origins: Array, directions: Array, exit_number: Ints, longest: float) -> tuple[Array, Ints, Array]:
        """As ``shoot``, but for the ``exit_number``-th (R,) exit of each ray from the surface; entries are skipped.

        The distance is inf where there is no such exit within ``longest``.
        """
        distance, face = np.full(len(origins), np.inf), np.zeros(len(origins), dtype=np.int64)
        hit_cos, exits_left, followed = np.zeros(len(origins)), np.array(exit_number), np.ones(len(origins), dtype=bool)
        for rays, distances, triangle, cosine in self.crossings(origins, directions, longest, followed):
            exits_left[rays] -= cosine > 0
            last = exits_left[rays] == 0
            followed[rays[last]] = False
            distance[rays[last]], face[rays[last]], hit_cos[rays[last]] = distances[last], triangle[last], cosine[last]
        return distance, face, hit_cos

    def stays_white(self, origins: Array, directions: Array, lengths: Array, slack: float) -> Bools:
        """True (R,) where no stretch between leaving this surface and entering it again is longer than ``slack``."""
        is_white, exit_distance = np.ones(len(origins), dtype=bool), np.full(len(origins), np.nan)
        is_followed = is_white.copy()
        for rays, distances, _, cosine in self.crossings(origins, directions, lengths, is_followed):
            is_leaving = cosine > 0
            stray_rays = rays[~is_leaving & (distances - exit_distance[rays] > slack)]
            is_white[stray_rays], is_followed[stray_rays] = False, False
            exit_distance[rays[is_leaving]] = distances[is_leaving]
        return is_white


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
        widths_text = f"median {self.median:.3g} mm, quartiles {self.lower:.3g} to {self.upper:.3g} mm"
        return f"GyralThickness({widths_text}, {len(self.width):,} samples, {self.coverage:.0%} of the contour)"

    def median_where(self, vertices: Bools, faces: Ints) -> float:
        """Length-weighted median of the samples with two corners or more in the region (N,) bool; NaN if none."""
        is_inside = self._within(vertices, faces)
        return weighted_quantile(self.width[is_inside], self.weight[is_inside], 0.5)

    def contour_where(self, vertices: Bools, faces: Ints) -> float:
        """Length [mm] of the measured contour in the region (N,) bool; below about 60 the median is of a few gyri."""
        return float(self.weight[self._within(vertices, faces) & np.isfinite(self.width)].sum())

    def _within(self, in_region: Bools, faces: Ints) -> Bools:
        return np.asarray(in_region[faces[self.triangle]].sum(axis=1) >= 2)


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
    is_inside = _measured_vertices(cortex, mask)
    ray_caster = RayCaster(surface)  # first, so that a missing package raises an error before the work
    contour = mid_height_contour(surface, is_inside, scale)
    if contour.reason:
        return _no_thickness(surface, contour, contour.reason)
    grey_bounds = None
    if isinstance(cortex, Cortex) and not cortex.is_one_surface:
        grey_bounds = _grey_matter_bounds(cortex, is_inside)
    return _measure_chords(surface, is_inside, contour, ray_caster, grey_bounds)


def weighted_quantile(values: Array, weights: Array, quantile: float) -> float:
    """Value below which ``quantile`` of the weight lies. NaN values are left out; NaN if no value is left."""
    is_valid = np.isfinite(values) & (weights > 0)
    if not is_valid.any():
        return math.nan
    order = np.argsort(values[is_valid], kind="stable")
    sorted_values, sorted_w = values[is_valid][order], weights[is_valid][order]
    return float(np.interp(quantile, (np.cumsum(sorted_w) - sorted_w / 2) / sorted_w.sum(), sorted_values))


def _measured_vertices(cortex: Cortex | Surface, mask: Bools | None) -> Bools:
    surface = cortex.pial if isinstance(cortex, Cortex) else cortex
    is_measured = geometry.used(len(surface.verts), surface.faces)
    if isinstance(cortex, Cortex):
        is_measured &= cortex_mask(cortex)
    if mask is not None:
        same_length(mask, len(is_measured), f"{surface.name}: mask")
        is_measured &= np.asarray(mask, dtype=bool)
    if not is_measured.any():
        raise NoCortex(f"{surface.name}: no vertex is left to measure. Check the mask and the cortex label.")
    return is_measured


class _ChordData(NamedTuple):
    """Data for chords at their start, (S, ...), and at their end, by triangle (M, ...).

    ``n_bodies`` (S,): number of gyri in which the start lies: 1, plus the number of gyri whose walls pass through it.
    """

    points: Array
    normal: Array
    triangle_normal: Array
    triangle_phase: Array
    longest: float
    n_bodies: Ints


class _GreyMatterBounds(NamedTuple):
    """Bounds on chords from the grey matter. A chord may not run through it for more than ``slack`` [mm] between two
    stretches of ``white``, or be shorter than the sum of ``triangle_thickness`` (M,) [mm] at its ends."""

    white: RayCaster
    slack: float
    triangle_thickness: Array


def _grey_matter_bounds(cortex: Cortex, is_inside: Bools) -> _GreyMatterBounds:
    separation = np.linalg.norm(cortex.pial.verts - cortex.white.verts, axis=1)
    thickness = cortical_thickness(cortex.white, cortex.pial, cap=None)
    slack, triangle_thickness = float(np.median(separation[is_inside])) / 4, thickness[cortex.faces].mean(axis=1)
    return _GreyMatterBounds(RayCaster(cortex.white), slack, triangle_thickness)


def _cast_fan(
    ray_caster: RayCaster, samples: _ChordData, vertical: Array, angles: Array, sign: int
) -> tuple[Array, Array, Ints, Array]:
    """Rays in the horizontal plane into the tissue (sign = 1) or out of it (-1).

    Returns corrected lengths (S, K), NaN where not from wall to wall, uncorrected lengths (S, K), triangles hit (S, K)
    and directions (S, K, 3).
    """
    wall_normal = geometry.unit(samples.normal - _vector_component_along(samples.normal, vertical))
    fan_axis, fan_side = -sign * wall_normal, np.cross(vertical, -sign * wall_normal)
    rays = np.cos(angles)[None, :, None] * fan_axis[:, None, :] + np.sin(angles)[None, :, None] * fan_side[:, None, :]
    fan_shape, directions = rays.shape[:2], rays.reshape(-1, 3)

    def per_ray(values: NDArray[Any]) -> NDArray[Any]:
        return np.repeat(values, len(angles), axis=0)

    offset = RAY_OFFSET_IN_EDGES * ray_caster.mean_edge
    origins = per_ray(samples.points) + offset * directions
    if sign > 0:
        distance, triangle, cosine = ray_caster.exits(origins, directions, per_ray(samples.n_bodies), samples.longest)
    else:
        distance, triangle, cosine = ray_caster.shoot(origins, directions)
    distance = distance + offset
    hit_normal = samples.triangle_normal[triangle]
    hit_normal = geometry.unit(hit_normal - _vector_component_along(hit_normal, per_ray(vertical)))
    hit_phase = samples.triangle_phase[triangle]
    is_valid = (sign * cosine > 0.1) & (np.sum(hit_normal * per_ray(wall_normal), axis=1) < -0.3)
    is_valid &= (hit_phase > 0.1) & (hit_phase < 0.9) & (distance < samples.longest)
    slant = np.maximum(sign * np.sum(hit_normal * directions, axis=1), 0) * per_ray(np.linalg.norm(wall_normal, axis=1))
    slant *= np.tile(np.cos(angles), len(samples.points))
    corrected = np.where(is_valid & (slant > 0), np.where(np.isfinite(distance), distance, 0) * np.sqrt(slant), np.nan)
    return corrected.reshape(fan_shape), distance.reshape(fan_shape), triangle.reshape(fan_shape), rays


def _symmetrised_vertical(
    ray_caster: RayCaster, samples: _ChordData, vertical: Array, folds: Relief, faces: Ints, sign: int
) -> Array:
    """The vertical (S, 3) averaged with that of the nearest opposite wall; unchanged where there is none.

    The wall is searched horizontally, so it is searched twice: with the given vertical, then with the average.
    """
    average = vertical
    for _ in range(2):
        chords, distance, triangle, _ = _cast_fan(ray_caster, samples, average, SYMMETRISING_ANGLES_RAD, sign)
        nearest_ray = np.where(np.isfinite(chords), distance, np.inf).argmin(axis=1)
        opposite = geometry.unit(folds.vertical[faces[triangle[np.arange(len(distance)), nearest_ray]]].mean(axis=1))
        average = np.where(np.isfinite(chords).any(axis=1, keepdims=True), geometry.unit(vertical + opposite), average)
    return average


def _vector_component_along(vectors: Array, unit_vectors: Array) -> Array:
    return np.sum(vectors * unit_vectors, axis=1, keepdims=True) * unit_vectors


def _median_of_rows(lengths: Array) -> tuple[Array, Ints]:
    """Median of each row if it has at least two values, else NaN; and its column, of two the one with the shorter.

    The median of an even number of values is midway between two: without this rule rounding would choose the column.
    """
    n_finite, rows = np.isfinite(lengths).sum(axis=1), np.arange(len(lengths))
    order = np.argsort(lengths, axis=1, kind="stable")  # NaN last
    lower, upper = order[rows, np.maximum(n_finite - 1, 0) // 2], order[rows, n_finite // 2 % lengths.shape[1]]
    return np.where(n_finite >= 2, (lengths[rows, lower] + lengths[rows, upper]) / 2, np.nan), lower


def _measure_chords(
    surface: Surface, is_inside: Bools, contour: Contour, caster: RayCaster, bounds: _GreyMatterBounds | None
) -> GyralThickness:
    faces, folds, rows = surface.faces, contour.relief, np.arange(len(contour.points))
    triangle_normal = geometry.vertex_normals(surface.verts, faces)[faces].mean(axis=1)
    normal, longest = triangle_normal[contour.triangle], LONGEST_CHORD_IN_WAVELENGTHS * contour.wavelength
    phase = np.where(is_inside, folds.phase, np.nan)[faces].mean(axis=1)
    n_bodies = 1 + caster.bodies(contour.points + RAY_OFFSET_IN_EDGES * caster.mean_edge * normal, normal, longest)
    samples = _ChordData(contour.points, normal, triangle_normal, phase, longest, n_bodies)
    vertical = geometry.unit(folds.vertical[faces[contour.triangle]].mean(axis=1))

    mean_vertical = _symmetrised_vertical(caster, samples, vertical, folds, faces, 1)
    chord_length, distance, triangle, rays = _cast_fan(caster, samples, mean_vertical, CHORD_ANGLES_RAD, 1)
    if bounds is not None:
        row, ray = np.nonzero(np.isfinite(chord_length))
        crosses_grey = ~bounds.white.stays_white(samples.points[row], rays[row, ray], distance[row, ray], bounds.slack)
        chord_length[row[crosses_grey], ray[crosses_grey]] = np.nan
    width, ray = _median_of_rows(chord_length)
    distance, direction, end_triangle = distance[rows, ray], rays[rows, ray], triangle[rows, ray]
    if bounds is not None:
        least_width = bounds.triangle_thickness[contour.triangle] + bounds.triangle_thickness[end_triangle]
        width[(width < least_width) & (least_width < folds.amplitude[faces[contour.triangle]].mean(axis=1))] = np.nan
    partner = samples.points + np.where(np.isfinite(distance), distance, 0)[:, None] * direction

    row = np.flatnonzero(np.isfinite(width))
    roof_mm, roof_triangle, cosine = caster.shoot((samples.points[row] + partner[row]) / 2, mean_vertical[row])
    width[row[~(np.isfinite(roof_mm) & (samples.triangle_phase[roof_triangle] < 0.5) & (cosine > 0))]] = np.nan
    partner[np.isnan(width)] = np.nan

    mean_vertical = _symmetrised_vertical(caster, samples, vertical, folds, faces, -1)
    gap, _ = _median_of_rows(_cast_fan(caster, samples, mean_vertical, CHORD_ANGLES_RAD, -1)[0])
    if (coverage := _coverage(contour, width)) < LEAST_COVERAGE:
        text = f"of the mid-height contour (scale {folds.scale:.3g}) has an opposite wall"
        return _no_thickness(surface, contour, f"no gyri: only {coverage:.0%} {text}; {LEAST_COVERAGE:.0%} are needed")
    per_vertex = _carry_to_vertices(surface, is_inside, contour, width)
    return _gyral_thickness(surface, contour, width, partner, gap, per_vertex, bounds is not None)


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
    points, no_values = np.empty((0, 3)), np.empty(0)
    empty = replace(contour, points=points, length=no_values, triangle=np.empty(0, dtype=np.int64), reason=reason)
    return _gyral_thickness(surface, empty, no_values, points, no_values, np.full(len(surface.verts), math.nan), False)


def _carry_to_vertices(surface: Surface, is_inside: Bools, contour: Contour, width: Array) -> PerVertex:
    """Width (N,) of the nearest sample along the edges that has one; NaN where that sample is too far.

    Too far means farther than half a wavelength, or farther than the nearest of all samples by more than half of that
    width.
    """
    sample_corners, n, largest_distance = surface.faces[contour.triangle], len(surface.verts), contour.wavelength / 2
    graph, has_width = geometry.edge_graph(surface.verts, surface.faces), np.isfinite(width)
    sample_lengths = np.repeat(contour.length[has_width], 3)
    length_sums = np.bincount(sample_corners[has_width].ravel(), sample_lengths, n)
    width_sums = np.bincount(sample_corners[has_width].ravel(), sample_lengths * np.repeat(width[has_width], 3), n)
    distance, _, source_vertex = csgraph.dijkstra(
        graph, indices=np.flatnonzero(length_sums > 0), min_only=True, return_predecessors=True, limit=largest_distance
    )
    nearest_mm = csgraph.dijkstra(graph, indices=np.unique(sample_corners), min_only=True, limit=largest_distance)
    vertices = np.flatnonzero(is_inside & (source_vertex >= 0))
    mean_width = width_sums[source_vertex[vertices]] / length_sums[source_vertex[vertices]]
    width_map = np.full(n, np.nan)
    width_map[vertices] = np.where(distance[vertices] - nearest_mm[vertices] <= mean_width / 2, mean_width, np.nan)
    return width_map
