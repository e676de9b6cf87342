"""What one setting costs and how wrong it is: a point in the plane of error against time."""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any, NamedTuple

from morphofold.clock import working_seconds

OURS = "morphofold"
EACH_OTHER = "each other"         # against which two peers are held that do the same
LEAST, MOST, LONG = 5, 40, 2.0      # repeats of what is timed: so many, at most, and no new one after so long [s]


@dataclass(frozen=True)
class Point:
    """One setting, how long it took and how wrong one quantity came out.

    Attributes
    ----------
    half : {"solver", "measuring"}
    subject : str
        What was solved or measured, such as ``"bumpy sphere"`` or ``"fig6-thick, octant"``.
    quantity : str
        What the error is of, such as ``"mean curvature"``.
    error : float
        Relative to the known answer, or to the finest of its kind (``against``): 0.01 is 1 %.
    against : str
        What the error is measured against, in words: ``"theory"``, ``"exact"``, ``"finest mesh"``.
    axis : str
        The setting that this point varies: ``"mesh"``, ``"scale"``, ``"layers"`` and so on.
    setting : str
        All that differs from the standard, in a few words, such as ``"h = 0.80 T"``.
    value : float
        Where it lies on the axis.
    size : int
        Elements or vertices.
    seconds, fastest, slowest : float
        Wall time without compiling: median over the repeats, and their range.
    repeats : int
        None of them if the work failed (a peer's): error and seconds are NaN then, and the setting says why.
    method : str
        Whose code, ``"morphofold"`` or a peer's name with what was called.
    preset : str
        ``"draft"``, ``"standard"`` or ``"fine"`` if the setting is one of these.
    """

    half: str
    subject: str
    quantity: str
    error: float
    against: str
    axis: str
    setting: str
    value: float
    size: int
    seconds: float
    fastest: float
    slowest: float
    repeats: int = 1
    method: str = OURS
    preset: str = ""

    def __post_init__(self) -> None:
        numbers = (self.error, self.seconds, self.fastest, self.slowest)
        if self.repeats and not all(math.isfinite(n) for n in numbers):
            raise ValueError(
                f"{self.subject}, {self.quantity}, {self.method}, {self.setting}: error and seconds must be finite, "
                f"got {self.error} in {self.seconds} s."
            )

    def as_row(self) -> dict[str, Any]:
        return asdict(self)

    @staticmethod
    def from_row(row: Mapping[str, Any]) -> Point:
        """The point of a row, None being NaN; ``ValueError`` if it lacks a field, has one too many, or no number."""
        try:
            given: dict[str, Any] = {name: math.nan if value is None else value for name, value in row.items()}
            return Point(**given)
        except TypeError as error:
            raise ValueError(f"no point of a study of accuracy: {error}") from None


FIELDS = tuple(f.name for f in fields(Point))


class Case(NamedTuple):
    """A piece of the study that is done as a whole: its name, that of the file it is kept in, and its work."""

    name: str
    work: Callable[[], list[Point]]


class Timing(NamedTuple):
    """Wall seconds of repeated work, without compiling: median and range."""

    seconds: float
    fastest: float
    slowest: float
    repeats: int


def timed(work: Callable[[], object]) -> Timing:
    """Time work after once for caches and compilers: five times or, if that is quick, for two seconds."""
    work()
    laps: list[float] = []
    end = time.perf_counter() + LONG
    while len(laps) < LEAST or (time.perf_counter() < end and len(laps) < MOST):
        begun = working_seconds()
        work()
        laps.append(working_seconds() - begun)
    return Timing(statistics.median(laps), min(laps), max(laps), len(laps))
