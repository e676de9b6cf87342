"""Sulcal depth of the pial surface."""

from morphofold.analysis.gyrification import convex_hull
from morphofold.surface import Cortex, PerVertex


def values(cortex: Cortex) -> PerVertex:
    """:func:`morphofold.analysis.sulcal_depth` of the pial surface, (N,) [mm]."""
    return convex_hull.sulcal_depth(cortex.pial.verts, cortex.faces)
