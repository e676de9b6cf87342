"""The measuring room: one set of measures for simulated and real cortices.

Public names load on first use. No file here may bear the name of one of them: Python would put the module in the
function's place as soon as anything imported it (hence ``_curvature.py``).
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if __name__ != "morphofold.analysis":
    raise ImportError(
        "this folder is imported as morphofold.analysis, never as analysis: use `import morphofold.analysis`"
    )

if TYPE_CHECKING:
    from morphofold.analysis._curvature import Curvature, curvature
    from morphofold.analysis._mesh import euler_characteristic, vertex_areas, vertex_normals
    from morphofold.analysis.altitude import wavelength
    from morphofold.analysis.closing import local_gyrification_index
    from morphofold.analysis.crest import CrestLine, CrestLines, crest_lines
    from morphofold.analysis.depth import sulcal_depth
    from morphofold.analysis.folding import FoldingIndices, folding_indices
    from morphofold.analysis.fractal import fractal_dimension
    from morphofold.analysis.gyral_net import GyralScales
    from morphofold.analysis.gyri import gyral_graph
    from morphofold.analysis.gyrification import gyrification_index
    from morphofold.analysis.hinge_table import Arm, Hinge, hinges
    from morphofold.analysis.measures import Measures, measure
    from morphofold.analysis.patterns import HingeShapes, hinge_shapes
    from morphofold.analysis.prominence import prominent_peaks
    from morphofold.analysis.regions import gray_volumes, region_table, wide_table
    from morphofold.analysis.scaling import ShapeTerms, shape_terms
    from morphofold.analysis.sensitivity import hinge_sensitivity
    from morphofold.analysis.spectrum import Spectrum, power_spectrum
    from morphofold.analysis.thickness import cortical_thickness

_PUBLIC = {
    "Arm": "hinge_table",
    "CrestLine": "crest",
    "CrestLines": "crest",
    "Curvature": "_curvature",
    "FoldingIndices": "folding",
    "GyralScales": "gyral_net",
    "GyralThickness": "chord",
    "Hinge": "hinge_table",
    "HingeShapes": "patterns",
    "Measures": "measures",
    "ShapeTerms": "scaling",
    "Spectrum": "spectrum",
    "cortical_thickness": "thickness",
    "crest_lines": "crest",
    "curvature": "_curvature",
    "euler_characteristic": "_mesh",
    "folding_indices": "folding",
    "fractal_dimension": "fractal",
    "gyral_graph": "gyri",
    "gyral_thickness": "chord",
    "gyrification_index": "gyrification",
    "hinge_sensitivity": "sensitivity",
    "hinge_shapes": "patterns",
    "hinges": "hinge_table",
    "local_gyrification_index": "closing",
    "measure": "measures",
    "power_spectrum": "spectrum",
    "prominent_peaks": "prominence",
    "gray_volumes": "regions",
    "region_table": "regions",
    "wide_table": "regions",
    "shape_terms": "scaling",
    "sulcal_depth": "depth",
    "vertex_areas": "_mesh",
    "vertex_normals": "_mesh",
    "wavelength": "altitude",
}
__all__ = [
    "Arm", "CrestLine", "CrestLines", "Curvature", "FoldingIndices", "GyralScales", "GyralThickness", "Hinge",
    "HingeShapes", "Measures", "ShapeTerms", "Spectrum", "cortical_thickness", "crest_lines", "curvature",
    "euler_characteristic", "folding_indices", "fractal_dimension", "gray_volumes", "gyral_graph",
    "gyral_thickness", "gyrification_index", "hinge_sensitivity", "hinge_shapes", "hinges", "local_gyrification_index",
    "measure", "power_spectrum", "prominent_peaks", "region_table", "shape_terms", "sulcal_depth",
    "vertex_areas", "vertex_normals", "wavelength", "wide_table",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    if name not in _PUBLIC:
        raise AttributeError(f"module 'morphofold.analysis' has no attribute {name!r}")
    value = getattr(importlib.import_module(f"morphofold.analysis.{_PUBLIC[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
