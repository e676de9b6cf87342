"""Grow folded cortices, read real ones, and measure both with the same code."""

from pathlib import Path

from morphofold.lazy import DRAWERS, importer

__version__ = "0.3.0"

# In a checkout the rooms sim/, analysis/ and studies/ lie beside this folder. The tracked symlinks already lead
# there; this line covers checkouts without symlinks. It never fires in an installed wheel.
_checkout_root = Path(__file__).resolve().parent.parent
if (_checkout_root / "pyproject.toml").is_file() and (_checkout_root / "sim" / "__init__.py").is_file():
    __path__.append(str(_checkout_root))

_PUBLIC = {
    "Cortex": "morphofold.surface",
    "Surface": "morphofold.surface",
    "read_cortex": "morphofold.io",
    "read_surface": "morphofold.io",
    "read_parcellated": "morphofold.spheres.template_folders",
    "sample_path": "morphofold.io",
    "measure": "morphofold.analysis.measuring",
    "Measures": "morphofold.analysis.measures_result",
    "compare": "morphofold.comparison",
    "simulate": "morphofold.simulation",
    "forecast": "morphofold.forecasts",
    "estimate_error": "morphofold.forecasts",
}
__all__ = ["__version__", *_PUBLIC]

DRAWERS.update(
    html=("morphofold.report.notebook", "html_of"),
    map_picture=("morphofold.report.notebook", "plot"),
    comparison_page=("morphofold.report.pages.cortex_pages", "comparison_report"),
    reproduce=("morphofold.studies.paper.reproduction", "run"),
)
__getattr__ = importer(__name__, _PUBLIC)


def __dir__() -> list[str]:
    return sorted(__all__)
