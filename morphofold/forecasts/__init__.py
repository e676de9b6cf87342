"""Forecasts of a run: its time, memory and errors, and the mesh that fits; afterwards the cost of a run or an analysis,
and its errors.
"""

from morphofold.forecasts.forecasting import Forecast, forecast
from morphofold.forecasts.mesh_choice import MeshChoice, choose_mesh
from morphofold.forecasts.richardson import Estimate, estimate_error

__all__ = ["Estimate", "Forecast", "MeshChoice", "choose_mesh", "estimate_error", "forecast"]
