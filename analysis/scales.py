"""Lengths at which curvature and the folding indices of a cortex are measured."""

from morphofold import geometry
from morphofold.analysis.curvatures import check_scale, largest_scale
from morphofold.surface import Cortex

CURVATURE_SCALE_MM = 3.0  # [mm], unless the mesh is too coarse for it
LEAST_CURVATURE_SCALE_IN_EDGES = 2.5  # least curvature scale in mean edges
LEAST_FOLDING_SCALE_IN_EDGES = 1.5  # least smoothing of the folding indices in mean edges
# of the radius of the sphere of equal area, above which the curvature scale gives a note
LARGEST_SCALE_OVER_RADIUS = 0.1


def scale_of_curvature(cortex: Cortex, wanted: float | None = None) -> tuple[float, str]:
    """The curvature scale [mm], and a note on it or on the unit of length; empty if there is nothing to note.

    Raises
    ------
    ValueError
        If the scale does not fit the mesh.
    """
    surfaces = (cortex.white, cortex.pial)
    edge = max(geometry.mean_edge_length(s.verts, cortex.faces) for s in surfaces)
    size = min(geometry.equal_area_radius(s.verts, cortex.faces) for s in surfaces)
    usual = _usual_curvature_scale(size)
    most = min(largest_scale(s.verts, cortex.faces) for s in surfaces)
    scale = min(max(usual, LEAST_CURVATURE_SCALE_IN_EDGES * edge), most) if wanted is None else float(wanted)
    for surface in surfaces:
        check_scale(surface.verts, cortex.faces, scale)
    say = (
        f"curvature is fitted within {scale:.3g}, mean edge {edge:.3g}, radius of the sphere of equal area {size:.3g}."
    )
    if cortex.units != "mm":
        return scale, f"Lengths are in {cortex.units!r}, not in mm as the names of the measures suggest; {say}"
    if wanted is None and (
        CURVATURE_SCALE_MM > LARGEST_SCALE_OVER_RADIUS * size
        or LEAST_CURVATURE_SCALE_IN_EDGES * edge > 10 * CURVATURE_SCALE_MM
    ):
        return scale, f"The coordinates do not look like millimetres of a human brain; {say}"
    return scale, ""


def scale_of_folding(cortex: Cortex, scale: float) -> float:
    """Scale of the folding indices [mm]: 3, or 1.5 mean edges of white if that is more; at most the curvature scale."""
    verts, faces = cortex.white.verts, cortex.faces
    size = geometry.equal_area_radius(verts, faces)
    return min(
        scale, max(_usual_curvature_scale(size), LEAST_FOLDING_SCALE_IN_EDGES * geometry.mean_edge_length(verts, faces))
    )


def _usual_curvature_scale(size: float) -> float:
    """Curvature scale of a body with the equal-area radius ``size``; 0 where it can only follow from the mesh."""
    return CURVATURE_SCALE_MM if CURVATURE_SCALE_MM < size / 2 else 0.0
