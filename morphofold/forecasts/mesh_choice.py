"""The accuracy that fits a budget of time, or that an error asks for."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

from morphofold.errors import DoesNotApply, NoSolution, NotReadable, NotStudied, OptionsClash, OutOfRange
from morphofold.forecasts.calibration import Calibration, calibrate
from morphofold.forecasts.forecasting import Forecast, forecast_from
from morphofold.forecasts.sizes import edges_between
from morphofold.forecasts.table import ROUNDED, costs, headline, not_studied, studied, unstudied
from morphofold.words import percent, percent_above, span

if TYPE_CHECKING:
    from morphofold.sim.scene import Scene

UNITS = {"s": 1.0, "min": 60.0, "h": 3600.0, "d": 86400.0}


@dataclass(frozen=True)
class MeshChoice:
    """A scene with the edge that was chosen, and what is expected of it."""

    scene: Scene
    forecast: Forecast

    @property
    def words(self) -> str:
        """What was picked, in a line."""
        found = self.forecast
        error = unstudied(found.not_studied)
        if found.headline is not None:
            name, expected = found.headline
            error = f"about {percent(expected.error)} ({name})"
        return (
            f"picked an edge of {found.edge_over_T:.2f} T ({found.setting}): {found.elements:,} elements, about "
            f"{span(found.seconds)} ({span(found.slowest)} at most), error {error}"
        )


def budget_seconds(text: str) -> float:
    """Seconds of a time such as ``90s``, ``5min``, ``2h`` or ``1.5d``.

    Raises
    ------
    ValueError
        If it is no such time, or not positive.
    """
    match = re.fullmatch(r"\s*(\d+(?:\.\d+)?|\.\d+)\s*(s|min|h|d)\s*", text)
    seconds = float(match[1]) * UNITS[match[2]] if match else 0.0
    if not 0 < seconds < float("inf"):
        raise (OutOfRange if match else NotReadable)(
            f"--budget {text}: is no time. Give a number with s, min, h or d, such as 90s, 5min or 2h."
        )
    return seconds


def error_share(text: str) -> float:
    """A relative error: ``1%`` and ``0.01`` are the same.

    Raises
    ------
    ValueError
        If it is none, or not between 0 and 1 (100 %).
    """
    match = re.fullmatch(r"\s*(\d+(?:\.\d+)?|\.\d+)\s*(%?)\s*", text)
    share = float(match[1]) / (100 if match[2] else 1) if match else 0.0
    if not 0 < share < 1:
        raise (OutOfRange if match else NotReadable)(
            f"--error {text}: is no relative error. Give a percentage such as 5%, or a fraction such as 0.05, "
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
        Largest relative error of the ``HEADLINE`` quantities; 0.01 is 1 %. With both, the time is least, and must fit.
    threads : int, optional
        As the run will have.

    Raises
    ------
    ValueError
        If the scene's edge is not to be chosen, no edge that was studied fits, neither is asked for, or an error of a
        scene unlike those studied.
    """
    if budget is None and error is None:
        raise OptionsClash("choose_mesh: neither a budget nor an error is asked for; give one of them.")
    asked = "--budget" if error is None else "--error"
    edges = _edges(scene, asked)
    if error is not None:
        return _for_error(scene, edges, error, budget, threads)
    assert budget is not None
    chosen = _with(scene, edges[0])
    for _ in range(2):  # timed there, and once more where that leads
        found = calibrate(chosen, costs(), threads)
        chosen = _with(scene, _finest(scene, edges, found, budget))
    return MeshChoice(chosen, forecast_from(chosen, found))


def _edges(scene: Scene, asked: str) -> list[float]:
    """Edges to choose from [mm], the coarsest first."""
    shape = scene.geometry.shape
    if shape in ("mesh", "radial"):
        why = "its mesh is the file's" if shape == "mesh" else "it is solved in one dimension, in milliseconds"
        raise DoesNotApply(
            f"{asked} chooses accuracy.edge, and {scene.name} (shape {shape!r}) has none: {why}. Drop it."
        )
    if scene.accuracy.edge is not None:
        raise OptionsClash(
            f"{asked} chooses accuracy.edge, and {scene.name} says it is {scene.accuracy.edge:g} mm; drop the one or "
            "the other."
        )
    from morphofold.sim.scene import MOST_BRICKS

    finest, coarsest = (share * scene.thinnest for share in studied())
    finest *= 1 - ROUNDED
    edges = [e for e in edges_between(scene, finest, coarsest) if _bricks(scene, e) <= MOST_BRICKS]
    if not edges:
        raise NoSolution(
            f"{asked}: {scene.name} has no edge between {finest:.3g} and {coarsest:.3g} mm, which were studied, with "
            f"{MOST_BRICKS:.0e} bricks or fewer. Take a smaller portion, or set accuracy.edge yourself."
        )
    return edges


def _bricks(scene: Scene, edge: float) -> float:
    """About as many bricks as the scene has with an edge [mm], too many for it or not."""
    return scene.model_copy(update={"accuracy": scene.accuracy.model_copy(update={"edge": edge})}).bricks


def _with(scene: Scene, edge: float) -> Scene:
    from morphofold.sim.scene.files import load_scene

    return load_scene(scene, [f"accuracy.edge={edge!r}"])


def _finest(scene: Scene, edges: list[float], found: Calibration, budget: float) -> float:
    """The finest edge with which the run should take no longer than the budget, at the slower end of its range."""
    forecasts = [forecast_from(_with(scene, edge), found) for edge in edges]
    fitting = [edge for edge, cost in zip(edges, forecasts) if cost.slowest <= budget]
    if not fitting:
        cheapest = forecasts[0]
        raise NoSolution(
            f"--budget {span(budget)}: {scene.name} may take {span(cheapest.slowest)} with the coarsest edge that "
            f"was studied ({cheapest.edge_over_T:.2f} T). Allow as much, take a smaller portion, or set accuracy.edge."
        )
    return min(fitting)


def _for_error(scene: Scene, edges: list[float], error: float, budget: float | None, threads: int | None) -> MeshChoice:
    """The coarsest edge whose expected error is small enough, if the run with it fits the budget."""
    if unlike := not_studied(scene, studied()[0]):
        raise NotStudied(
            f"--error chooses by a table of errors, {unstudied(unlike)} ({scene.name}). Choose the mesh by --budget or "
            "accuracy.edge, and let --estimate say how wrong the run is."
        )
    good = [edge for edge in edges if headline(edge / scene.thinnest)[1].error <= error]
    if not good:
        finest = edges[-1] / scene.thinnest
        name, best = headline(finest)
        raise NoSolution(
            f"--error {percent(error)}: the finest edge to choose from ({finest:.2f} T) leaves {scene.name} an error "
            f"of about {percent_above(best.error)} ({name}). Ask for no less, or set accuracy.edge."
        )
    chosen = _with(scene, good[0])
    cost = forecast_from(chosen, calibrate(chosen, costs(), threads))
    if budget is not None and cost.slowest > budget:
        raise OptionsClash(
            f"--error {percent(error)} may take {scene.name} {span(cost.slowest)} (an edge of "
            f"{cost.edge_over_T:.2f} T), more than --budget {span(budget)}. Allow the time or a larger error."
        )
    return MeshChoice(chosen, cost)
