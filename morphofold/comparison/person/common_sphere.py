"""Put a person, the smooth body and the cortex grown from it on one sphere, at equal areas of their hulls: ``Bodies``.

In go the measures of person and grown cortex, and how far the person was unfolded; out come points, scales, areas and
maps of both, and two control bodies, the smooth one and one whose dents are deepened. ``compare_person`` calls it.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from math import sqrt

import numpy as np

from morphofold.analysis.gyrification.hull_measures import hull, sulcal_depth
from morphofold.analysis.gyrification.local_gyrification import local_gyrification_index
from morphofold.analysis.measures_result import Measures
from morphofold.analysis.relief import height_and_vertical
from morphofold.errors import MissingPart, Refusal, UnlikeSurfaces
from morphofold.frozen_arrays import Array, Bools
from morphofold.geometry import vertex_areas
from morphofold.mesh_quality.cortex_checks import cortex_mask
from morphofold.quantities import RELIEF
from morphofold.spheres.resampling import Places, places
from morphofold.surface import Cortex, Surface
from morphofold.unfolding.harmonics import Expansion, SmoothSurface, degrees
from morphofold.unfolding.unfold import points_on_sphere, unfold

RELIEF_SCALE_MM = 10.0  # of the height above the smoothed surface, on the person; as for an adult brain
DEEPENED_FROM = 30.0  # l (l + 1) at which the amplitude of a dent is doubled
DEFAULT_VOXEL_MM = 1.25  # of local gyrification, where an analysis does not record it


@dataclass(frozen=True, eq=False)
class Body:
    """A measured cortex on the sphere.

    Attributes
    ----------
    measures : Measures
        Its map of mean curvature is NaN off the cortex. A further map, ``relief_height``, is the height above the
        surface smoothed over 10 mm, minus its median over the area of the smooth body [mm of the person]: positive on
        gyri, negative in sulci, NaN off the cortex.
    points : (N, 3) float64
        Vertices on the unit sphere.
    cortex : (N,) bool
    scale : float
        Factor of its lengths, so that its convex hull has the area of the person's.
    areas : (N,) float64
        Area of the smooth body around each vertex [mm^2].
    """

    measures: Measures
    points: Array
    cortex: Bools
    scale: float
    areas: Array

    @property
    def pial(self) -> Surface:
        return self.measures.cortex.pial

    @property
    def weights(self) -> Array:
        """Areas of the smooth body, 0 off the cortex."""
        return self.areas * self.cortex


@dataclass(frozen=True, eq=False)
class Bodies:
    """A person, the cortex that grew from it, and the smooth body between them at the grown vertices.

    Attributes
    ----------
    person, grown : Body
    smooth : SmoothSurface
        The body before it grew, its hull scaled to the area of the person's.
    to_grown, to_person : Places
        From the person's vertices to the grown ones, and back.
    """

    person: Body
    grown: Body
    smooth: SmoothSurface
    to_grown: Places
    to_person: Places

    @cached_property
    def controls(self) -> dict[str, Measures]:
        """The smooth body, and the one with its dents deepened, as cortices: white and pial are the same surface.

        Maps are as those of an analysis, and the height, at the grown vertices, NaN off the cortex. Curvature is exact.
        Local gyrification is left out where the body does not allow it.
        """
        return {"smooth": self._measured(self.smooth), "deepened": self._measured(self.deepened)}

    @cached_property
    def deepened(self) -> SmoothSurface:
        """The smooth body with its dents deepened, the more the shorter they are, as folding does.

        Its harmonics of degree l are multiplied by ``1 + (l (l + 1) / 30)^2``: by 2 at l = 5, 14 at 10, 65 at 15. It
        has nothing of the person that the smooth body doesn't have.
        """
        l = degrees(self.smooth.shape.degree)
        gain = 1 + (l * (l + 1) / DEEPENED_FROM) ** 2
        return SmoothSurface(Expansion(gain[:, None] * self.smooth.shape.coefficients))

    def _measured(self, body: SmoothSurface) -> Measures:
        points, grown = self.grown.points, self.grown.measures.cortex
        surface = Surface(body(points), grown.faces, "smooth body")
        mesh = surface.verts, surface.faces
        maps = {
            RELIEF: centred(height_and_vertical(*mesh, RELIEF_SCALE_MM)[0], self.grown.weights),
            "H": body.frame(points).curvature.mean(axis=1),
            "sulcal_depth": sulcal_depth(*mesh),
        }
        voxel_mm = self.person.measures.parameters.get("local_gyrification_voxel_mm") or DEFAULT_VOXEL_MM
        try:
            maps["local_gyrification_index"] = local_gyrification_index(*mesh, voxel=voxel_mm)
        except Refusal:
            pass
        is_cortex, pair = self.grown.cortex, (surface, surface)
        cortex = Cortex(*pair, grown.hemi, surface.name, cortex=is_cortex, regions=grown.regions, sphere=grown.sphere)
        return Measures(cortex, {}, {name: np.where(is_cortex, values, np.nan) for name, values in maps.items()})


def bodies_of(person: Measures, grown: Measures, level: float) -> Bodies:
    """Place a person and a cortex that grew from it on the person's sphere.

    Parameters
    ----------
    person, grown : Measures
        Of cortices with a sphere.
    level : float
        At which the person was unfolded.

    Raises
    ------
    MissingPart
        If one has no sphere or no map of mean curvature.
    UnlikeSurfaces
        If they are of two hemispheres.
    OutOfRange, OpenSurface, Mismatch, BadMesh
        As :func:`morphofold.unfolding.unfold.unfold`.

    Notes
    -----
    Lengths are compared at convex hulls of equal area. Hulls, because the total area of a surface is part of what is
    compared: at equal area a body with few folds would be drawn larger than a person's brain.
    """
    sphere_points = []
    for measures in (person, grown):
        cortex = measures.cortex
        if cortex.sphere is None:
            raise MissingPart(
                f"{cortex.called}: the analysis has no {cortex.hemi}.sphere, so its vertices can't be found on the "
                f"other cortex. Put surf/{cortex.hemi}.sphere into the subject, and analyze it again."
            )
        if "H" not in measures.maps:
            raise MissingPart(f"{cortex.called}: has no map of mean curvature (H). Analyze it again.")
        sphere_points.append(points_on_sphere(cortex.pial, cortex.sphere))
    if person.cortex.hemi != grown.cortex.hemi:
        raise UnlikeSurfaces(
            f"{person.cortex.called} and {grown.cortex.called} are two hemispheres. Compare a cortex with the one it "
            "grew from."
        )
    hull_area = hull(person.cortex.pial.verts, person.cortex.faces).area
    assert person.cortex.sphere is not None
    smooth = unfold(person.cortex.white, person.cortex.sphere, level).surface
    smooth = smooth.scaled(sqrt(hull_area / hull(smooth(sphere_points[1]), grown.cortex.faces).area))
    own, other = (_body(measures, s, hull_area, smooth) for measures, s in zip((person, grown), sphere_points))
    to_grown, to_person = (places(a.points, a.pial.faces, b.points) for a, b in ((own, other), (other, own)))
    return Bodies(own, other, smooth, to_grown, to_person)


def _body(measures: Measures, points: Array, hull_area: float, smooth: SmoothSurface) -> Body:
    """A measured cortex with points (N, 3) on the sphere, scaled to a hull of the area ``size`` [mm^2]."""
    verts, faces = measures.cortex.pial.verts, measures.cortex.faces
    is_cortex, areas = cortex_mask(measures.cortex), vertex_areas(smooth(points), faces)
    scale = sqrt(hull_area / hull(verts, faces).area)
    height = scale * height_and_vertical(verts, faces, RELIEF_SCALE_MM / scale)[0]
    height, curvature = (np.where(is_cortex, values, np.nan) for values in (height, measures.maps["H"]))
    maps = {**measures.maps, RELIEF: centred(height, areas), "H": curvature}
    return Body(replace(measures, maps=maps), points, is_cortex, scale, areas)


def centred(values: Array, weights: Array) -> Array:
    """Values (N,) minus their median by weight (N,), over the known ones with a weight above 0."""
    is_known = np.isfinite(values) & (weights > 0)
    return values - weighted_median(values[is_known], weights[is_known]) if is_known.any() else values


def weighted_median(values: Array, weights: Array) -> float:
    """Middle between the two values (N,) beside which half of the weight (N,) lies, so that no value is on it."""
    order = np.argsort(values, kind="stable")
    cumulative_weight = np.cumsum(weights[order])
    middle = np.searchsorted(cumulative_weight, 0.5 * cumulative_weight[-1])
    return values[order[middle : middle + 2]].mean()
