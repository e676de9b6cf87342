"""Forecasts of a run: its time, memory and errors, and the mesh that fits; afterwards the cost of a run or an analysis,
and its errors. Names are imported on first use: an analysis, which has a cost too, does not load the solver.
"""

# ruff: noqa: F401  (the public names)
from typing import TYPE_CHECKING

from morphofold.lazy import importer, public_names

if TYPE_CHECKING:
    from morphofold.forecasts.forecasting import Forecast, forecast
    from morphofold.forecasts.mesh_choice import MeshChoice, choose_mesh
    from morphofold.forecasts.richardson import Estimate, estimate_error

_PUBLIC = public_names(__file__)
__all__ = sorted(_PUBLIC)
__getattr__ = importer(__name__, _PUBLIC)
