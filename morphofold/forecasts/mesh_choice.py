"""Choice of the edge length for a budget of time, or for an error: a scene in, the scene with that edge out."""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass

from morphofold.errors import NoSolution, NotReadable, NotStudied, OptionsClash, OutOfRange
from morphofold.forecasts.cost_record import SAME_EDGE_TOLERANCE, errors_of_run, headline, studied
from morphofold.forecasts.forecasting import Forecast, calibrate, forecast_from
from morphofold.forecasts.sizes import edges_between, refuse_without_edge
from morphofold.number_texts import percent, percent_above, span
from morphofold.sim.scene import MOST_BRICKS, Scene

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
        error_text = cost.how["errors"]
        if cost.headline is not None:
            name, expected = cost.headline
            error_text = f"about {percent(expected.error)} ({name})"
        return (
            f"chose an edge of {cost.edge_over_T:.2f} T ({cost.setting}): {cost.elements:,} elements, about "
            f"{span(cost.seconds)} ({span(cost.slowest)} at most), error {error_text}"
        )


def budget_seconds(text: str) -> float:
    """Seconds of a time such as ``90s``, ``5min``, ``2h`` or ``1.5d``.

    Raises
    ------
    ValueError
        If it is not such a time, or not positive.
    """
    advice = "Give a number with s, min, h or d, such as 90s, 5min or 2h."
    return _amount(text, SECONDS_PER_UNIT, math.inf, f"--budget {text}: is not a time. {advice}")


def error_share(text: str) -> float:
    """A relative error: ``1%`` and ``0.01`` are the same.

    Raises
    ------
    ValueError
        If it is not an error, or not between 0 and 1 (100 %).
    """
    advice = "Give a percentage such as 5%, or a fraction such as 0.05, more than 0 and less than 1."
    return _amount(text, SHARE_PER_UNIT, 1.0, f"--error {text}: is not a relative error. {advice}")


def _amount(text: str, value_of_unit: Mapping[str, float], upper_limit: float, message: str) -> float:
    """A number with one of the units, more than 0 and less than ``upper_limit``."""
    match = re.fullmatch(rf"\s*(\d+(?:\.\d+)?|\.\d+)\s*({'|'.join(value_of_unit)})\s*", text)
    amount = float(match[1]) * value_of_unit[match[2]] if match else 0.0
    if not 0 < amount < upper_limit:
        raise (OutOfRange if match else NotReadable)(message)
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
        Time that the run may take [s], at the slow end of its range.
    error : float, optional
        Largest relative error of the ``HEADLINE_QUANTITIES``; 0.01 is 1 %. With both, the mesh is the one for the
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
    candidates = _candidates(scene, "--budget" if error is None else "--error")
    if error is not None:
        candidates = [_coarsest_within_error(scene, candidates, error)]
    timed_scene, most_seconds = candidates[0], math.inf if budget is None else budget
    for _ in candidates[:2]:  # time the coarsest edge, and then the edge that follows from it
        timing = calibrate(timed_scene, threads)
        choices = [MeshChoice(candidate, forecast_from(candidate, timing)) for candidate in candidates]
        fitting_choices = [choice for choice in choices if choice.forecast.slowest <= most_seconds]
        if not fitting_choices:
            raise _over_budget(choices[0].forecast, most_seconds, error)
        timed_scene = fitting_choices[-1].scene
    return fitting_choices[-1]


def _over_budget(forecast: Forecast, budget: float, error: float | None) -> NoSolution | OptionsClash:
    """The refusal of a budget in which not even the run with the coarsest edge, or that for the error, is certain."""
    if error is None:
        return NoSolution(
            f"--budget {span(budget)}: {forecast.scene} may take {span(forecast.slowest)} with the coarsest studied "
            f"edge ({forecast.edge_over_T:.2f} T). Allow this time, take a smaller portion, or set accuracy.edge."
        )
    return OptionsClash(
        f"--error {percent(error)}: {forecast.scene} may take {span(forecast.slowest)} (an edge of "
        f"{forecast.edge_over_T:.2f} T), more than --budget {span(budget)}. Allow the time or a larger error."
    )


def _candidates(scene: Scene, option: str) -> list[Scene]:
    """The scene with each edge to choose from, the coarsest first."""
    refuse_without_edge(scene, f"{option} chooses accuracy.edge")
    if scene.accuracy.edge is not None:
        raise OptionsClash(
            f"{option} chooses accuracy.edge, but {scene.name} sets it to {scene.accuracy.edge:g} mm; leave out one of "
            "the two."
        )
    finest, coarsest = (ratio * scene.thinnest for ratio in studied())
    finest *= 1 - SAME_EDGE_TOLERANCE
    accuracies = [scene.accuracy.model_copy(update={"edge": edge}) for edge in edges_between(scene, finest, coarsest)]
    candidates = [scene.model_copy(update={"accuracy": accuracy}) for accuracy in accuracies]
    if not (affordable_scenes := [candidate for candidate in candidates if candidate.bricks <= MOST_BRICKS]):
        raise NoSolution(
            f"{option}: {scene.name} has no edge between {finest:.3g} and {coarsest:.3g} mm (the studied range) with "
            f"{MOST_BRICKS:.0e} bricks or fewer. Take a smaller portion, or set accuracy.edge yourself."
        )
    return affordable_scenes


def _coarsest_within_error(scene: Scene, candidates: list[Scene], error: float) -> Scene:
    """The scene with the coarsest edge whose expected error is small enough."""
    if (studied_errors := errors_of_run(scene, studied()[0])).not_studied:
        raise NotStudied(
            f"--error uses a table of errors, which is {studied_errors.how} ({scene.name}). Choose the mesh by "
            "--budget or accuracy.edge, and estimate the error of the run with --estimate."
        )
    headlines = [headline(errors_of_run(scene, c.edge / c.thinnest).errors) for c in candidates]
    for candidate, (_, expected) in zip(candidates, headlines):
        if expected.error <= error:
            return candidate
    finest, (name, least_error) = candidates[-1].edge / scene.thinnest, headlines[-1]
    raise NoSolution(
        f"--error {percent(error)}: with the finest edge to choose from ({finest:.2f} T), {scene.name} has an "
        f"error of about {percent_above(least_error.error)} ({name}). Allow this error, or set accuracy.edge."
    )
