"""Forecasts of a run: its time, memory and errors, and the mesh that fits; afterwards the cost of a run or an analysis,
and its errors. Names are imported on first use: an analysis, which has a cost too, does not load the solver.
"""

from morphofold.lazy import importer

_PUBLIC = {
    "Estimate": "morphofold.forecasts.richardson",
    "Forecast": "morphofold.forecasts.forecasting",
    "MeshChoice": "morphofold.forecasts.mesh_choice",
    "choose_mesh": "morphofold.forecasts.mesh_choice",
    "estimate_error": "morphofold.forecasts.richardson",
    "forecast": "morphofold.forecasts.forecasting",
}
__all__ = sorted(_PUBLIC)
__getattr__ = importer(__name__, _PUBLIC)
