"""A paragraph on methods for a paper, with its references, made of the scales that were used."""

from __future__ import annotations

from collections.abc import Sequence

from morphofold.analysis.measures import Measures
from morphofold.report.plots import number

#: works that the paragraph names
REFERENCES = (
    "Fischl B, Dale AM (2000). Measuring the thickness of the human cerebral cortex from magnetic resonance images. "
    "PNAS 97, 11050.",
    "Razavi MJ, Zhang T, Li X, Liu T, Wang X (2015). Role of mechanical factors in cortical folding development. "
    "Phys. Rev. E 92, 032701.",
    "Schaer M et al. (2008). A surface-based approach to quantify local cortical gyrification. IEEE Trans. Med. "
    "Imaging 27, 161.",
)


def methods(measures: Sequence[Measures], version: str) -> str:
    """What was measured and how, in sentences: surfaces of a page, and the version of morphofold."""
    simulated = any(m.cortex.origin == "simulation" for m in measures)
    scales = {m.parameters["curvature_scale_mm"] for m in measures if "curvature_scale_mm" in m.parameters}
    caps = {cap for m in measures if (cap := m.parameters.get("cortical_thickness_cap_mm"))}
    within = " and ".join(number(float(mm), 2) for mm in sorted(scales))
    bound = f", each {' or '.join(f'{cap:g}' for cap in sorted(caps))} mm at most" if caps else ""
    same = ", the same code for simulated and reconstructed cortex" if simulated else ""
    return (
        f"White and pial surfaces were measured with morphofold {version}{same}. Curvature is that of a cubic "
        f"surface fitted to the vertices within {within or 'a few'} mm along the surface, convex positive. Cortical "
        "thickness is half the sum of the distances from white to pial surface and back, each to the closest point "
        f"that lies outward (inward) and faces the same way{bound} (Fischl and Dale 2000). Gyral thickness is the "
        "length of the horizontal chord through a gyrus, from wall to wall, at half the height of the fold; the "
        "gyral net is the net of crests, and a hinge a point where three or more crests meet (after Razavi et al. "
        "2015). The gyrification index is the area of the pial surface over that of its convex hull, the local one "
        "that of the surface within 25 mm over that of its closing by a ball of 15 mm (Schaer et al. 2008). Sulcal "
        "depth is the distance to the convex hull."
    )
