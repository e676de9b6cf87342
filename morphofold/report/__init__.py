"""Figures (PNG) and self-contained HTML pages with an interactive view.

``analysis_report`` and ``comparison_report`` write pages; ``figure`` draws one static picture.
No measure is computed here.
"""

from __future__ import annotations

from morphofold.lazy import importer

_PUBLIC = {
    "analysis_report": "morphofold.report.pages.page",
    "comparison_report": "morphofold.report.pages.page",
    "figure": "morphofold.report.pictures.surfaces",
}
__all__ = sorted(_PUBLIC)
__getattr__ = importer(__name__, _PUBLIC)
