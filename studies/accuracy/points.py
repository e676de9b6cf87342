"""What one setting costs and how wrong it is: a point in the plane of error against time."""

from __future__ import annotations

import gc
import math
import statistics
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any, NamedTuple

from morphofold.errors import DamagedFile, NotFinite
from morphofold.timing import working_seconds

OURS = "morphofold"
EACH_OTHER = "each other"  # against which two peers are held that do the same
ANEW = "Delete it, and run again."
KINDS: dict[Any, Any] = {"str": str, "float": (int, float), "int": int}
QUICK, LONG = 0.5, 5.0  # [s] below which work is repeated five times, and from which it is not repeated


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
            raise NotFinite(
                f"{self.subject}, {self.quantity}, {self.method}, {self.setting}: error and seconds must be finite, "
                f"got {self.error} in {self.seconds} s."
            )

    def as_row(self) -> dict[str, Any]:
        """All fields by name, for a table or a file."""
        return asdict(self)

    @staticmethod
    def from_row(row: Mapping[str, Any]) -> Point:
        """The point of a row, None being NaN; ``ValueError`` if it lacks a field, has one too many, or no number."""
        try:
            given: dict[str, Any] = {name: math.nan if value is None else value for name, value in row.items()}
            for field in fields(Point):
                value = given.get(field.name, field.default)
                if isinstance(value, bool) or not isinstance(value, KINDS[field.type]):
                    raise TypeError(f"{field.name} is no {field.type}")
            return Point(**given)
        except TypeError as error:
            raise DamagedFile(f"no point of a study of accuracy: {error}") from None


FIELDS = tuple(f.name for f in fields(Point))


class Case(NamedTuple):
    """A piece of the study that is done as a whole: its name, that of the file it is kept in, and its work."""

    name: str
    work: Callable[[], list[Point]]


class Timing(NamedTuple):
    """Median, fastest and slowest wall time [s], without compiling, of so many repeats."""

    seconds: float
    fastest: float
    slowest: float
    repeats: int

    @staticmethod
    def of(took: Sequence[float]) -> Timing:
        """Of the wall times of each repeat."""
        return Timing(statistics.median(took), min(took), max(took), len(took))


NEVER = Timing(math.nan, math.nan, math.nan, 0)


def timed(work: Callable[[], Any]) -> tuple[Any, Timing]:
    """What the work returns, and how long it takes: five times if it is quick, once if it is long, else three
    times. The first of several is a warm-up that does not count."""
    gc.collect()
    start = working_seconds()
    result = work()
    took = [working_seconds() - start]
    if took[0] < LONG:
        warm, took = took[0], []
        for _ in range(5 if warm < QUICK else 3):
            start = working_seconds()
            result = work()
            took.append(working_seconds() - start)
    return result, Timing.of(took)
