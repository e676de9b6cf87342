"""Sulcal depth of the pial surface."""

from morphofold.analysis.gyrification import hull_measures
from morphofold.surface import Cortex, PerVertex


def values(cortex: Cortex) -> PerVertex:
    """:func:`morphofold.analysis.sulcal_depth` of the pial surface, (N,) [mm]."""
    return hull_measures.sulcal_depth(cortex.pial.verts, cortex.faces)
