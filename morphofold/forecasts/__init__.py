"""Forecasts of a run or an analysis: its time, memory and errors, and the accuracy that fits; afterwards its cost and
its errors.
"""

from morphofold.forecasts.forecasting import Forecast, forecast
from morphofold.forecasts.measuring import AnalysisForecast, forecast_analysis
from morphofold.forecasts.mesh_choice import MeshChoice, choose_mesh
from morphofold.forecasts.richardson import Estimate, estimate_error

__all__ = [
    "AnalysisForecast",
    "Estimate",
    "Forecast",
    "MeshChoice",
    "choose_mesh",
    "estimate_error",
    "forecast",
    "forecast_analysis",
]
