"""The analysis: one set of measures for simulated and real cortices.

Public names load on first use; functions run with one thread of BLAS, so that their last bits do not depend on the
machine. No file here may have the name of a public function: as soon as the file is imported,
Python would replace the function by the module (hence ``curvatures.py``).
"""

# ruff: noqa: F401  (names of __all__)
from __future__ import annotations

import importlib
from types import FunctionType
from typing import TYPE_CHECKING, Any

from morphofold.threads import one_blas_thread

if __name__ != "morphofold.analysis":
    raise ImportError(
        "this folder is imported as morphofold.analysis, not as analysis: use `import morphofold.analysis`"
    )

if TYPE_CHECKING:  # public names, as in _PUBLIC
    from morphofold.analysis.crests import CrestLine, CrestLines, crest_lines
    from morphofold.analysis.curvatures import Curvature, curvature
    from morphofold.analysis.graph.crest_net import GyralScales
    from morphofold.analysis.graph.depth_potential import wavelength
    from morphofold.analysis.graph.gyral_graph import gyral_graph
    from morphofold.analysis.graph.hinge_shapes import HingeShapes, hinge_shapes
    from morphofold.analysis.graph.hinges import Arm, Hinge, hinges
    from morphofold.analysis.graph.prominence import prominent_peaks
    from morphofold.analysis.graph.sensitivity import hinge_sensitivity
    from morphofold.analysis.gyrification.across_scales import (
        AtScale,
        LawAcrossScales,
        across_scales,
        law_across_scales,
    )
    from morphofold.analysis.gyrification.depth import sulcal_depth
    from morphofold.analysis.gyrification.folding import FoldingIndices, folding_indices
    from morphofold.analysis.gyrification.folding_law import ShapeTerms, shape_terms
    from morphofold.analysis.gyrification.fractal_dimension import fractal_dimension
    from morphofold.analysis.gyrification.hull import gyrification_index
    from morphofold.analysis.gyrification.local_gyrification import local_gyrification_index
    from morphofold.analysis.gyrification.power_spectrum import Spectrum, power_spectrum
    from morphofold.analysis.measures import Measures
    from morphofold.analysis.measuring import measure
    from morphofold.analysis.regions import gray_volumes, region_table, wide_table
    from morphofold.analysis.smoothing import smooth
    from morphofold.analysis.spins import SpinTest, spin_test
    from morphofold.analysis.thickness.cortical import cortical_thickness
    from morphofold.geometry import euler_characteristic, vertex_areas, vertex_normals

_PUBLIC = {
    "Arm": "analysis.graph.hinges",
    "AtScale": "analysis.gyrification.across_scales",
    "CrestLine": "analysis.crests",
    "CrestLines": "analysis.crests",
    "Curvature": "analysis.curvatures",
    "FoldingIndices": "analysis.gyrification.folding",
    "GyralScales": "analysis.graph.crest_net",
    "GyralThickness": "analysis.thickness.gyral",
    "Hinge": "analysis.graph.hinges",
    "HingeShapes": "analysis.graph.hinge_shapes",
    "LawAcrossScales": "analysis.gyrification.across_scales",
    "Measures": "analysis.measures",
    "ShapeTerms": "analysis.gyrification.folding_law",
    "Spectrum": "analysis.gyrification.power_spectrum",
    "SpinTest": "analysis.spins",
    "across_scales": "analysis.gyrification.across_scales",
    "cortical_thickness": "analysis.thickness.cortical",
    "crest_lines": "analysis.crests",
    "curvature": "analysis.curvatures",
    "euler_characteristic": "geometry",
    "folding_indices": "analysis.gyrification.folding",
    "fractal_dimension": "analysis.gyrification.fractal_dimension",
    "gyral_graph": "analysis.graph.gyral_graph",
    "gyral_thickness": "analysis.thickness.gyral",
    "gyrification_index": "analysis.gyrification.hull",
    "hinge_sensitivity": "analysis.graph.sensitivity",
    "hinge_shapes": "analysis.graph.hinge_shapes",
    "hinges": "analysis.graph.hinges",
    "law_across_scales": "analysis.gyrification.across_scales",
    "local_gyrification_index": "analysis.gyrification.local_gyrification",
    "measure": "analysis.measuring",
    "power_spectrum": "analysis.gyrification.power_spectrum",
    "prominent_peaks": "analysis.graph.prominence",
    "gray_volumes": "analysis.regions",
    "region_table": "analysis.regions",
    "wide_table": "analysis.regions",
    "shape_terms": "analysis.gyrification.folding_law",
    "smooth": "analysis.smoothing",
    "spin_test": "analysis.spins",
    "sulcal_depth": "analysis.gyrification.depth",
    "vertex_areas": "geometry",
    "vertex_normals": "geometry",
    "wavelength": "analysis.graph.depth_potential",
}
__all__ = sorted(_PUBLIC)


def __getattr__(name: str) -> Any:
    if name not in _PUBLIC:
        raise AttributeError(f"module 'morphofold.analysis' has no attribute {name!r}")
    value = getattr(importlib.import_module(f"morphofold.{_PUBLIC[name]}"), name)
    if isinstance(value, FunctionType):
        value = one_blas_thread()(value)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
