"""What work takes: before a run ``forecasting`` (time, memory, errors), ``sizes`` and ``mesh_choice``; after a run or
an analysis ``cost``, and ``richardson``, which estimates the errors of a run.

Names are imported on first use: an analysis, of which ``cost`` says what it took, does not load the solver.
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
