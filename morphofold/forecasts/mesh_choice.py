"""Choice of the mesh for a budget of time, or for an error."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

from morphofold.errors import NoSolution, NotReadable, NotStudied, OptionsClash, OutOfRange
from morphofold.forecasts.calibration import Calibration, calibrate
from morphofold.forecasts.forecasting import Forecast, forecast_from
from morphofold.forecasts.sizes import edges_between, refuse_without_edge
from morphofold.forecasts.table import (
    SAME_EDGE_TOLERANCE,
    Expected,
    expected_errors,
    headline,
    not_studied,
    studied,
    unstudied,
)
from morphofold.sim.scene import MOST_BRICKS, Scene
from morphofold.sim.scene.files import load_scene
from morphofold.words import percent, percent_above, span

SECONDS_PER_UNIT = {"s": 1.0, "min": 60.0, "h": 3600.0, "d": 86400.0}
SHARE_PER_UNIT = {"%": 0.01, "": 1.0}


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
        cost = self.forecast
        error = unstudied(cost.not_studied)
        if cost.headline is not None:
            name, expected = cost.headline
            error = f"about {percent(expected.error)} ({name})"
        return (
            f"chose an edge of {cost.edge_over_T:.2f} T ({cost.setting}): {cost.elements:,} elements, about "
            f"{span(cost.seconds)} ({span(cost.slowest)} at most), error {error}"
        )


def budget_seconds(text: str) -> float:
    """Seconds of a time such as ``90s``, ``5min``, ``2h`` or ``1.5d``.

    Raises
    ------
    ValueError
        If it is not such a time, or not positive.
    """
    rule = "Give a number with s, min, h or d, such as 90s, 5min or 2h."
    return _amount(text, SECONDS_PER_UNIT, float("inf"), f"--budget {text}: is not a time. {rule}")


def error_share(text: str) -> float:
    """A relative error: ``1%`` and ``0.01`` are the same.

    Raises
    ------
    ValueError
        If it is not an error, or not between 0 and 1 (100 %).
    """
    rule = "Give a percentage such as 5%, or a fraction such as 0.05, more than 0 and less than 1."
    return _amount(text, SHARE_PER_UNIT, 1.0, f"--error {text}: is not a relative error. {rule}")


def _amount(text: str, units: Mapping[str, float], below: float, refusal: str) -> float:
    """A number with one of the units, more than 0 and less than ``below``."""
    match = re.fullmatch(rf"\s*(\d+(?:\.\d+)?|\.\d+)\s*({'|'.join(units)})\s*", text)
    amount = float(match[1]) * units[match[2]] if match else 0.0
    if not 0 < amount < below:
        raise (OutOfRange if match else NotReadable)(refusal)
    return amount


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
    edges = _candidate_edges(scene, "--budget" if error is None else "--error")
    if error is not None:
        return _mesh_for_error(scene, edges, error, budget, threads)
    assert budget is not None
    chosen = _scene_with_edge(scene, edges[0])
    for _ in range(2):  # time the coarsest edge, and then the edge that follows from it
        timed = calibrate(chosen, threads)
        chosen = _scene_with_edge(scene, _finest_within_budget(scene, edges, timed, budget))
    return MeshChoice(chosen, forecast_from(chosen, timed))


def _candidate_edges(scene: Scene, option: str) -> list[float]:
    """Edges to choose from [mm], the coarsest first."""
    refuse_without_edge(scene, f"{option} chooses accuracy.edge")
    if scene.accuracy.edge is not None:
        raise OptionsClash(
            f"{option} chooses accuracy.edge, but {scene.name} sets it to {scene.accuracy.edge:g} mm; leave out one of "
            "the two."
        )
    finest, coarsest = (share * scene.thinnest for share in studied())
    finest *= 1 - SAME_EDGE_TOLERANCE
    edges = [e for e in edges_between(scene, finest, coarsest) if _bricks_with_edge(scene, e) <= MOST_BRICKS]
    if not edges:
        raise NoSolution(
            f"{option}: {scene.name} has no edge between {finest:.3g} and {coarsest:.3g} mm (the studied range) with "
            f"{MOST_BRICKS:.0e} bricks or fewer. Take a smaller portion, or set accuracy.edge yourself."
        )
    return edges


def _bricks_with_edge(scene: Scene, edge: float) -> float:
    """About the number of bricks of the scene with an edge [mm], even if there are too many."""
    return scene.model_copy(update={"accuracy": scene.accuracy.model_copy(update={"edge": edge})}).bricks


def _scene_with_edge(scene: Scene, edge: float) -> Scene:
    return load_scene(scene, [f"accuracy.edge={edge!r}"])


def _finest_within_budget(scene: Scene, edges: list[float], timed: Calibration, budget: float) -> float:
    """The finest edge whose run takes no longer than the budget, even at the slow end of its range."""
    forecasts = [forecast_from(_scene_with_edge(scene, edge), timed) for edge in edges]
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
    good = [edge for edge in edges if _expected(edge / scene.thinnest)[1].error <= error]
    if not good:
        finest = edges[-1] / scene.thinnest
        name, best = _expected(finest)
        raise NoSolution(
            f"--error {percent(error)}: with the finest edge to choose from ({finest:.2f} T), {scene.name} has an "
            f"error of about {percent_above(best.error)} ({name}). Allow this error, or set accuracy.edge."
        )
    chosen = _scene_with_edge(scene, good[0])
    cost = forecast_from(chosen, calibrate(chosen, threads))
    if budget is not None and cost.slowest > budget:
        raise OptionsClash(
            f"--error {percent(error)}: {scene.name} may take {span(cost.slowest)} (an edge of "
            f"{cost.edge_over_T:.2f} T), more than --budget {span(budget)}. Allow the time or a larger error."
        )
    return MeshChoice(chosen, cost)


def _expected(edge_over_T: float) -> tuple[str, Expected]:
    return headline(expected_errors(edge_over_T))
