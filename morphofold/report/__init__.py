"""Figures (PNG) and self-contained HTML pages with an interactive view.

``analysis_report`` and ``comparison_report`` write pages; ``figure`` draws one static picture.
No measure is computed here.
"""

# ruff: noqa: F401  (the public names)
from typing import TYPE_CHECKING

from morphofold.lazy import importer, public_names

if TYPE_CHECKING:
    from morphofold.report.pages.cortex_pages import analysis_report, comparison_report
    from morphofold.report.pictures.surfaces import figure

_PUBLIC = public_names(__file__)
__all__ = sorted(_PUBLIC)
__getattr__ = importer(__name__, _PUBLIC)
