"""Choice of the mesh for a budget of time, or for an error."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

from morphofold.errors import DoesNotApply, NoSolution, NotReadable, NotStudied, OptionsClash, OutOfRange
from morphofold.forecasts.calibration import Calibration, calibrate
from morphofold.forecasts.forecasting import Forecast, forecast_from
from morphofold.forecasts.sizes import edges_between
from morphofold.forecasts.table import SAME_EDGE_TOLERANCE, costs, headline, not_studied, studied, unstudied
from morphofold.words import percent, percent_above, span

if TYPE_CHECKING:
    from morphofold.sim.scene import Scene

SECONDS_PER_UNIT = {"s": 1.0, "min": 60.0, "h": 3600.0, "d": 86400.0}


@dataclass(frozen=True)
class MeshChoice:
    """A scene with the chosen edge, and its forecast."""

    scene: Scene
    forecast: Forecast

    def __repr__(self) -> str:
        return f"MeshChoice({self.scene.name!r}: {self.words})"

    @property
    def words(self) -> str:
        """The choice, in a line."""
        found = self.forecast
        error = unstudied(found.not_studied)
        if found.headline is not None:
            name, expected = found.headline
            error = f"about {percent(expected.error)} ({name})"
        return (
            f"chose an edge of {found.edge_over_T:.2f} T ({found.setting}): {found.elements:,} elements, about "
            f"{span(found.seconds)} ({span(found.slowest)} at most), error {error}"
        )


def budget_seconds(text: str) -> float:
    """Seconds of a time such as ``90s``, ``5min``, ``2h`` or ``1.5d``.

    Raises
    ------
    ValueError
        If it is not such a time, or not positive.
    """
    match = re.fullmatch(r"\s*(\d+(?:\.\d+)?|\.\d+)\s*(s|min|h|d)\s*", text)
    seconds = float(match[1]) * SECONDS_PER_UNIT[match[2]] if match else 0.0
    if not 0 < seconds < float("inf"):
        raise (OutOfRange if match else NotReadable)(
            f"--budget {text}: is not a time. Give a number with s, min, h or d, such as 90s, 5min or 2h."
        )
    return seconds


def error_share(text: str) -> float:
    """A relative error: ``1%`` and ``0.01`` are the same.

    Raises
    ------
    ValueError
        If it is not an error, or not between 0 and 1 (100 %).
    """
    match = re.fullmatch(r"\s*(\d+(?:\.\d+)?|\.\d+)\s*(%?)\s*", text)
    share = float(match[1]) / (100 if match[2] else 1) if match else 0.0
    if not 0 < share < 1:
        raise (OutOfRange if match else NotReadable)(
            f"--error {text}: is not a relative error. Give a percentage such as 5%, or a fraction such as 0.05, "
            "more than 0 and less than 1."
        )
    return share


def choose_mesh(
    scene: Scene, *, budget: float | None = None, error: float | None = None, threads: int | None = None
) -> MeshChoice:
    """The finest edge that fits a budget, or the coarsest one whose expected error is small enough.

    Parameters
    ----------
    scene : Scene
        Without an ``accuracy.edge`` of its own.
    budget : float, optional
        Time that the run may take [s].
    error : float, optional
        Largest relative error of the ``HEADLINE`` quantities; 0.01 is 1 %. With both, the mesh is the one for the
        error, and its run must fit the budget.
    threads : int, optional
        Threads of the run.

    Raises
    ------
    ValueError
        If the scene's edge can't be chosen, no studied edge fits, neither budget nor error is given, or an error is
        given for a scene that was not studied.
    """
    if budget is None and error is None:
        raise OptionsClash("choose_mesh: neither a budget nor an error is given; give one of them.")
    asked = "--budget" if error is None else "--error"
    edges = _candidate_edges(scene, asked)
    if error is not None:
        return _mesh_for_error(scene, edges, error, budget, threads)
    assert budget is not None
    chosen = _scene_with_edge(scene, edges[0])
    for _ in range(2):  # time the coarsest edge, and then the edge that follows from it
        found = calibrate(chosen, costs(), threads)
        chosen = _scene_with_edge(scene, _finest_within_budget(scene, edges, found, budget))
    return MeshChoice(chosen, forecast_from(chosen, found))


def _candidate_edges(scene: Scene, asked: str) -> list[float]:
    """Edges to choose from [mm], the coarsest first."""
    shape = scene.geometry.shape
    if shape in ("mesh", "radial"):
        why = "its mesh comes from a file" if shape == "mesh" else "it is solved in one dimension, in milliseconds"
        raise DoesNotApply(
            f"{asked} chooses accuracy.edge, but {scene.name} (shape {shape!r}) has none: {why}. Leave it out."
        )
    if scene.accuracy.edge is not None:
        raise OptionsClash(
            f"{asked} chooses accuracy.edge, but {scene.name} sets it to {scene.accuracy.edge:g} mm; leave out one of "
            "the two."
        )
    from morphofold.sim.scene import MOST_BRICKS

    finest, coarsest = (share * scene.thinnest for share in studied())
    finest *= 1 - SAME_EDGE_TOLERANCE
    edges = [e for e in edges_between(scene, finest, coarsest) if _bricks_with_edge(scene, e) <= MOST_BRICKS]
    if not edges:
        raise NoSolution(
            f"{asked}: {scene.name} has no edge between {finest:.3g} and {coarsest:.3g} mm (the studied range) with "
            f"{MOST_BRICKS:.0e} bricks or fewer. Take a smaller portion, or set accuracy.edge yourself."
        )
    return edges


def _bricks_with_edge(scene: Scene, edge: float) -> float:
    """About the number of bricks of the scene with an edge [mm], even if there are too many."""
    return scene.model_copy(update={"accuracy": scene.accuracy.model_copy(update={"edge": edge})}).bricks


def _scene_with_edge(scene: Scene, edge: float) -> Scene:
    from morphofold.sim.scene.files import load_scene

    return load_scene(scene, [f"accuracy.edge={edge!r}"])


def _finest_within_budget(scene: Scene, edges: list[float], found: Calibration, budget: float) -> float:
    """The finest edge whose run takes no longer than the budget, even at the slow end of its range."""
    forecasts = [forecast_from(_scene_with_edge(scene, edge), found) for edge in edges]
    fitting = [edge for edge, cost in zip(edges, forecasts) if cost.slowest <= budget]
    if not fitting:
        cheapest = forecasts[0]
        raise NoSolution(
            f"--budget {span(budget)}: {scene.name} may take {span(cheapest.slowest)} with the coarsest studied edge "
            f"({cheapest.edge_over_T:.2f} T). Allow this time, take a smaller portion, or set accuracy.edge."
        )
    return min(fitting)


def _mesh_for_error(
    scene: Scene, edges: list[float], error: float, budget: float | None, threads: int | None
) -> MeshChoice:
    """The coarsest edge whose expected error is small enough, if the run with it fits the budget."""
    if unlike := not_studied(scene, studied()[0]):
        raise NotStudied(
            f"--error uses a table of errors, which is {unstudied(unlike)} ({scene.name}). Choose the mesh by --budget "
            "or accuracy.edge, and estimate the error of the run with --estimate."
        )
    good = [edge for edge in edges if headline(edge / scene.thinnest)[1].error <= error]
    if not good:
        finest = edges[-1] / scene.thinnest
        name, best = headline(finest)
        raise NoSolution(
            f"--error {percent(error)}: with the finest edge to choose from ({finest:.2f} T), {scene.name} has an "
            f"error of about {percent_above(best.error)} ({name}). Allow this error, or set accuracy.edge."
        )
    chosen = _scene_with_edge(scene, good[0])
    cost = forecast_from(chosen, calibrate(chosen, costs(), threads))
    if budget is not None and cost.slowest > budget:
        raise OptionsClash(
            f"--error {percent(error)}: {scene.name} may take {span(cost.slowest)} (an edge of "
            f"{cost.edge_over_T:.2f} T), more than --budget {span(budget)}. Allow the time or a larger error."
        )
    return MeshChoice(chosen, cost)
