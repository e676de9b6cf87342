"""Unfold a cortex: from its folded surface and its sphere to a smooth one with the same vertices.

The numbers of an unfolding: how far it went, what cortex fits, and where the area of the folded surface comes from.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.spatial import ConvexHull

from morphofold.errors import BadMesh, Handles, Mismatch, OpenSurface, OutOfRange, SeveralPieces
from morphofold.frozen_arrays import Array
from morphofold.geometry import (
    components,
    edges_and_counts,
    euler_characteristic,
    face_areas,
    face_vectors,
    inner,
    used,
    vertex_areas,
)
from morphofold.intersections.intersection import self_intersections
from morphofold.surface import Regions, Surface
from morphofold.threads import one_blas_thread
from morphofold.unfolding.harmonics import DEGREE, LEVELS, SmoothSurface, fit

MOST_TURNED_SHARE = 0.01  # of the area of a sphere that may lie in triangles that are inside out
MIRRORED_SHARE = 0.9  # of the area of a sphere inside out beyond which all its faces run the other way
SPHERE_AREA_TOLERANCE = 0.05  # relative difference between the area of a sphere and 4 pi
LEAST_DEPTH = 1e-3  # of the least standard deviation of vertices along an axis, over the largest: else they are flat
LEAST_VERTICES_PER_HARMONIC = 4
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


@dataclass(frozen=True, eq=False)
class Unfolding:
    """A folded surface and the smooth surface that it unfolds to.

    Attributes
    ----------
    folded : Surface
        As it was given [mm].
    points : (N, 3) float64
        Point of the unit sphere of each vertex.
    surface : SmoothSurface
        Smooth surface, about the centre of its area on the sphere, scaled so that its area is 4 pi radius^2.
    radius : float
        Radius of the sphere with its area [mm].
    scale : float
        Factor by which the smooth surface was scaled; 1 if no radius was asked for.
    level : float
        Time w of the heat flow on the unit sphere.
    """

    folded: Surface
    points: Array
    surface: SmoothSurface
    radius: float
    scale: float
    level: float

    def smooth(self) -> Surface:
        """The smooth surface with the vertices and faces of the folded one [mm]."""
        return self._smooth

    @cached_property
    def _smooth(self) -> Surface:
        return Surface(self.surface(self.points), self.folded.faces, name=f"{self.folded.name} unfolded")

    def area_ratio(self) -> Array:
        """Area of the folded surface around each vertex (N,) over that of the smooth one, over the ratio of the totals.

        NaN at vertices that no face uses.
        """
        folded_area, smooth_area = (vertex_areas(mesh.verts, mesh.faces) for mesh in (self.folded, self.smooth()))
        with np.errstate(invalid="ignore", divide="ignore"):
            return (folded_area / folded_area.sum()) / (smooth_area / smooth_area.sum())


@one_blas_thread()
def unfold(
    folded: Surface, sphere: Surface, level: float = 0.03, *, radius: float | None = None, degree: int = DEGREE
) -> Unfolding:
    """Unfold a closed surface by heat flow on its sphere.

    Parameters
    ----------
    folded : Surface
        White surface of a hemisphere, or any closed surface of one piece [mm].
    sphere : Surface
        The same vertices and faces on a sphere about the origin, of any radius: FreeSurfer's ``?h.sphere``.
    level : float
        Time w of the heat flow on the unit sphere: 0.02 keeps hints of the largest sulci, 0.08 nothing but the shape of
        the hemisphere.
    radius : float, optional
        Of the sphere with the area of the smooth surface [mm]; by default the smooth surface is not scaled.
    degree : int
        Largest degree of the spherical harmonics.

    Raises
    ------
    OutOfRange
        If ``level`` or ``radius`` is out of range.
    SeveralPieces, OpenSurface, Handles, BadMesh
        If the surface is not closed, of one piece and without handles, or flat.
    Mismatch, BadMesh
        If the sphere is that of another mesh, or no sphere.
    """
    check_options(level, radius)
    points = points_on_sphere(folded, sphere)
    n_used = int(used(len(points), folded.faces).sum())
    if n_used < LEAST_VERTICES_PER_HARMONIC * (degree + 1) ** 2:
        raise BadMesh(
            f"{folded.name}: {n_used:,} vertices are too few for {(degree + 1) ** 2} harmonics (degree {degree}); use "
            f"a surface with at least {LEAST_VERTICES_PER_HARMONIC * (degree + 1) ** 2:,}."
        )
    expansion = fit(points, folded.verts, vertex_areas(points, folded.faces), degree).smoothed(level)
    expansion.coefficients[0] = 0.0
    surface = SmoothSurface(expansion)
    old_radius = surface_radius(surface)
    scale = 1.0 if radius is None else radius / old_radius
    return Unfolding(folded, points, surface.scaled(scale), scale * old_radius, scale, level)


def check_options(level: float, radius: float | None) -> None:
    """Raise ``OutOfRange`` as :func:`unfold`, before a sphere is made."""
    if not LEVELS[0] <= level <= LEVELS[1]:
        raise OutOfRange(f"level must be {LEVELS[0]:g} to {LEVELS[1]:g}, got {level:g}.")
    if radius is not None and not 0 < radius < np.inf:
        raise OutOfRange(f"radius must be positive, got {radius:g}.")


def surface_radius(surface: SmoothSurface) -> float:
    """Radius of the sphere with the area of a smooth surface [mm], by Gauss quadrature on the sphere."""
    points, weights = quadrature(3 * surface.shape.degree)
    return float(np.sqrt(weights @ surface.frame(points).stretch / (4 * np.pi)))


def quadrature(degree: int) -> tuple[Array, Array]:
    """Points (P, 3) and weights (P,) on the unit sphere that integrate harmonics up to ``degree`` exactly."""
    z, weights = np.polynomial.legendre.leggauss(degree // 2 + 1)
    angle = 2 * np.pi * np.arange(degree + 1) / (degree + 1)
    rho = np.sqrt(1 - z**2)[:, None]
    points = np.stack([rho * np.cos(angle), rho * np.sin(angle), np.broadcast_to(z[:, None], (len(z), len(angle)))], -1)
    return points.reshape(-1, 3), np.repeat(weights * 2 * np.pi / len(angle), len(angle))


def check_closed(surface: Surface) -> None:
    """Raise unless a surface is closed, of one piece, without handles, and not flat; as :func:`unfold`."""
    verts, faces, piece = surface.verts, surface.faces, components(len(surface.verts), surface.faces)[1]
    if piece.max() > 0:
        sizes = np.sort(np.bincount(piece[piece >= 0]))[::-1].tolist()
        raise SeveralPieces(
            f"{surface.name}: is in {len(sizes)} pieces, of {', '.join(map(str, sizes[:3]))} vertices. Only one piece "
            "unfolds to a sphere: give each a file of its own."
        )
    edge_ends, n_triangles = edges_and_counts(faces)
    if len(bad := edge_ends[n_triangles != 2]):
        raise OpenSurface(
            f"{surface.name}: {len(bad)} edges have one triangle or more than two, not two; the first joins vertices "
            f"{bad[0, 0]} and {bad[0, 1]}. Only a closed surface unfolds to a sphere: close its holes."
        )
    if (genus := 1 - euler_characteristic(faces) / 2) > 0:
        raise Handles(
            f"{surface.name}: has {genus:g} handles (Euler characteristic {euler_characteristic(faces)}, not 2), so "
            "it does not unfold to a sphere. Cut them first, as FreeSurfer's mris_fix_topology does."
        )
    deviations = np.sqrt(np.maximum(np.linalg.eigvalsh(np.cov(verts[piece >= 0].T)), 0.0))
    if not deviations[0] > LEAST_DEPTH * deviations[2]:
        raise BadMesh(
            f"{surface.name}: its vertices lie in a plane, on a line or at a point: their standard deviations along "
            f"three axes are {deviations[0]:.3g}, {deviations[1]:.3g} and {deviations[2]:.3g}. Write the surface again."
        )


def check_same_mesh(folded: Surface, sphere: Surface) -> None:
    """Raise ``Mismatch`` unless a sphere has the vertices and faces of a surface."""
    if len(sphere.verts) != len(folded.verts) or not np.array_equal(
        np.sort(sphere.faces, axis=1), np.sort(folded.faces, axis=1)
    ):
        raise Mismatch(
            f"{sphere.name} has {len(sphere.verts):,} vertices and {len(sphere.faces):,} faces, {folded.name} "
            f"{len(folded.verts):,} and {len(folded.faces):,}, or the faces differ: it is the sphere of another "
            "surface. Take it from the same subject."
        )


def points_on_sphere(folded: Surface, sphere: Surface) -> Array:
    """Points (N, 3) of the unit sphere of the vertices of a closed surface; raises as :func:`unfold`."""
    check_same_mesh(folded, sphere)
    check_closed(folded)
    radii = np.linalg.norm(sphere.verts, axis=1)
    mean_radius = float(radii[used(len(radii), folded.faces)].mean())
    if not 0 < 0.5 * mean_radius <= radii.min() <= radii.max() <= 1.5 * mean_radius:
        raise BadMesh(
            f"{sphere.name}: its vertices lie {radii.min():.3g} to {radii.max():.3g} mm from the origin, so it is no "
            "sphere. Take ?h.sphere or ?h.sphere.reg."
        )
    points = sphere.verts / radii[:, None]
    areas = face_areas(points, folded.faces)
    flipped = float(areas[inner(face_vectors(points, folded.faces), points[folded.faces[:, 0]]) < 0].sum())
    if flipped > MIRRORED_SHARE * areas.sum():
        raise BadMesh(f"{sphere.name}: its faces run clockwise seen from outside. Reverse those of sphere and surface.")
    if flipped > MOST_TURNED_SHARE * areas.sum() or abs(areas.sum() / (4 * np.pi) - 1) > SPHERE_AREA_TOLERANCE:
        raise BadMesh(
            f"{sphere.name}: covers the sphere {areas.sum() / (4 * np.pi):.3g} times instead of once, with "
            f"{100 * flipped / max(areas.sum(), 1e-300):.2g} % of its area inside out. Take ?h.sphere or ?h.sphere.reg."
        )
    return np.ascontiguousarray(points)


def unfolding_numbers(unfolding: Unfolding) -> dict[str, Any]:
    """The numbers of :data:`COLUMNS`, without the hemisphere."""
    smooth, (points, _) = unfolding.smooth(), quadrature(3 * unfolding.surface.shape.degree)
    curvature, hull = unfolding.surface.frame(points).curvature, ConvexHull(smooth.verts)
    volume = float(
        np.einsum("fi,fi->", smooth.verts[smooth.faces].mean(axis=1), face_vectors(smooth.verts, smooth.faces)) / 3
    )
    smooth_areas, area_ratio = vertex_areas(smooth.verts, smooth.faces), unfolding.area_ratio()
    is_valid = np.isfinite(area_ratio) & (area_ratio > 0)
    least_curvature, largest_curvature = float(curvature.min()), float(curvature.max())
    return {
        "level": unfolding.level,
        "radius_mm": unfolding.radius,
        "folded_area_mm2": float(face_areas(unfolding.folded.verts, unfolding.folded.faces).sum()),
        "area_mm2": float(smooth_areas.sum()),
        "gyrification_index": float(smooth_areas.sum() / hull.area),
        "volume_over_hull": volume / float(hull.volume),
        "least_convex_radius_mm": 1 / largest_curvature,
        "least_concave_radius_mm": -1 / least_curvature if least_curvature < 0 else None,
        "thickest_cortex_mm": 1 / largest_curvature / LEAST_RADIUS_OVER_T,
        "sd_log_area_ratio": _weighted_sd(np.log(area_ratio[is_valid]), smooth_areas[is_valid]),
        **{f"area_ratio_p{percent}": float(np.percentile(area_ratio[is_valid], percent)) for percent in (1, 50, 99)},
        "crossings": len(self_intersections(smooth, vertices=False)),
    }


def region_rows(unfolding: Unfolding, regions: Regions) -> list[dict[str, Any]]:
    """For each region its share of the folded and of the smooth area [%], and the ratio of the two."""
    smooth = unfolding.smooth()
    areas = [vertex_areas(surface.verts, surface.faces) for surface in (unfolding.folded, smooth)]
    rows = []
    for k, name in enumerate(regions.names):
        in_region = regions.labels == k
        if not in_region.any():
            continue
        folded, flat = (100 * float(area[in_region].sum() / area.sum()) for area in areas)
        rows.append({"region": name, "folded_percent": folded, "smooth_percent": flat, "area_ratio": folded / flat})
    return rows


def _weighted_sd(values: Array, weights: Array) -> float:
    return float(np.sqrt(np.average((values - np.average(values, weights=weights)) ** 2, weights=weights)))
