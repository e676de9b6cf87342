"""Comparison of models and MRI: measures of several cortices (Figs. 8 and 9 of Razavi et al. 2015).

Begin at ``compare``, which takes measures by name; ``compare_with_person`` takes a grown cortex and the person that it
grew from.
"""

# ruff: noqa: F401  (the public names, imported on first use)
from typing import TYPE_CHECKING

from morphofold.lazy import importer, public_names

if TYPE_CHECKING:
    from morphofold.comparison.person.compare_person import PersonComparison, compare_with_person
    from morphofold.comparison.side_by_side import Comparison, compare
    from morphofold.comparison.thickness_plot_data import (
        Cloud,
        Fit,
        TheoryLine,
        ThicknessPoint,
        fit_line,
        thickness_cloud,
        wrinkling_wavelength,
    )

_PUBLIC = public_names(__file__)
__all__ = sorted(_PUBLIC)
__getattr__ = importer(__name__, _PUBLIC)
