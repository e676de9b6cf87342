"""What a notebook shows of an object, and pictures of maps: for classes below the package ``report``, which draws them.

Its imports run back up (``EXCEPTIONS`` in studies/packages.py), and only when something is shown.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from PIL.Image import Image


def html_of(shown: Any) -> str:
    """Table and small picture of a ``Cortex``, ``Measures``, ``Comparison`` or ``Simulation``, as HTML."""
    from morphofold.report import notebook

    return notebook.html_of(shown)


def plot(
    measures: Any, name: str, surface: str, views: str | Sequence[str], limits: tuple[float, float] | None
) -> Image:
    """Picture of a map of ``Measures``; see :meth:`morphofold.analysis.measures.Measures.plot`."""
    from morphofold.report import notebook

    return notebook.plot(measures, name, surface, views, limits)
