"""Comparison of models and MRI: measures of several cortices (Figs. 8 and 9 of Razavi et al. 2015).

Simulations and brains are treated the same. ``cortex.origin`` and ``cortex.info`` are shown as labels, and
``info["mu_ratio"]``, if there is one, gives the theoretical line.
"""

from morphofold.comparison.person.compare_person import PersonComparison, compare_with_person
from morphofold.comparison.side_by_side import Comparison, compare
from morphofold.comparison.thickness import (
    Cloud,
    Fit,
    TheoryLine,
    ThicknessPoint,
    fit_line,
    thickness_cloud,
    wrinkling_wavelength,
)

__all__ = [
    "Cloud",
    "Comparison",
    "Fit",
    "PersonComparison",
    "TheoryLine",
    "ThicknessPoint",
    "compare",
    "compare_with_person",
    "fit_line",
    "thickness_cloud",
    "wrinkling_wavelength",
]
