"""Figures (PNG) and self-contained HTML pages with an interactive view.

``analysis_report`` and ``comparison_report`` write pages; ``figure`` draws one static picture.
No measure is computed here.
"""

from __future__ import annotations

import importlib
from typing import Any

_PUBLIC = {
    "analysis_report": "morphofold.report.pages.page",
    "comparison_report": "morphofold.report.pages.page",
    "figure": "morphofold.report.pictures.surfaces",
}
__all__ = sorted(_PUBLIC)


def __getattr__(name: str) -> Any:
    if name not in _PUBLIC:
        raise AttributeError(f"module 'morphofold.report' has no attribute {name!r}")
    return getattr(importlib.import_module(_PUBLIC[name]), name)
