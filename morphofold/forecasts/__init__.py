"""Time, memory and errors of runs and analyses.

Before a run: ``forecasting`` makes a ``Forecast`` of a scene, and ``mesh_choice`` finds the edge for a budget or an
error; both use ``sizes`` (elements, steps, memory). Afterwards: ``cost_record`` has what a run or an analysis took, and
the table of errors to expect; ``richardson`` estimates those of a run by its folds on a coarser mesh.

Names are imported on first use: an analysis, which has a cost, does not load the solver.
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
