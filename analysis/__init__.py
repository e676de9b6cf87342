"""The analysis: one set of measures for simulated and real cortices.

Public names load on first use; functions run with one thread of BLAS, so that their last bits do not depend on the
machine. No file here may have the name of a public function: as soon as the file is imported,
Python would replace the function by the module (hence ``curvatures.py``).
"""

# ruff: noqa: F401  (the public names)
from __future__ import annotations

from types import FunctionType
from typing import TYPE_CHECKING, Any

from morphofold.lazy import importer, public_names
from morphofold.threads import one_blas_thread

if __name__ != "morphofold.analysis":
    raise ImportError(
        "this folder is imported as morphofold.analysis, not as analysis: use `import morphofold.analysis`"
    )

if TYPE_CHECKING:
    from morphofold.analysis.crests import CrestLine, CrestLines, crest_lines
    from morphofold.analysis.curvatures import Curvature, curvature
    from morphofold.analysis.graph.depth_potential import wavelength
    from morphofold.analysis.graph.gyral_graph import gyral_graph
    from morphofold.analysis.graph.hinge_statistics import HingeShapes, hinge_shapes
    from morphofold.analysis.graph.hinges import Arm, Hinge, hinges
    from morphofold.analysis.graph.net_builder import GyralScales, hinge_sensitivity
    from morphofold.analysis.gyrification.across_scales import (
        AtScale,
        LawAcrossScales,
        across_scales,
        fractal_dimension,
        law_across_scales,
    )
    from morphofold.analysis.gyrification.folding_indices import (
        FoldingIndices,
        ShapeTerms,
        folding_indices,
        shape_terms,
    )
    from morphofold.analysis.gyrification.hull_measures import gyrification_index, sulcal_depth
    from morphofold.analysis.gyrification.local_gyrification import local_gyrification_index
    from morphofold.analysis.gyrification.power_spectrum import Spectrum, power_spectrum
    from morphofold.analysis.measures_result import Measures
    from morphofold.analysis.measuring import measure
    from morphofold.analysis.region_tables import gray_volumes, region_table, wide_table
    from morphofold.analysis.smoothing import smooth
    from morphofold.analysis.spin_tests import SpinTest, spin_test
    from morphofold.analysis.thickness.cortical_thickness import cortical_thickness
    from morphofold.analysis.thickness.gyral_thickness import GyralThickness, gyral_thickness
    from morphofold.geometry import euler_characteristic, vertex_areas, vertex_normals


def _in_one_blas_thread(value: Any) -> Any:
    return one_blas_thread()(value) if isinstance(value, FunctionType) else value


_PUBLIC = public_names(__file__)
__all__ = sorted(_PUBLIC)
__getattr__ = importer(__name__, _PUBLIC, _in_one_blas_thread)


def __dir__() -> list[str]:
    return __all__
