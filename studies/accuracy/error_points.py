"""Time and error of one setting: a point in the plane of error against time."""

import gc
import math
import statistics
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any, NamedTuple

from morphofold.errors import DamagedFile, NotFinite
from morphofold.frozen_arrays import REMEMBERED
from morphofold.timing import working_seconds

OUR_CODE = "morphofold"
OTHER_PEER = "each other"  # reference of two peers that compute the same
RERUN_ADVICE = "Delete it, and run again."
VALID_TYPES: dict[Any, Any] = {str: str, float: (int, float), int: int}
QUICK, LONG = 0.5, 5.0  # [s]: faster work is repeated five times; work from the second value on is not repeated


@dataclass(frozen=True)
class Point:
    """One setting with its time and the error of one quantity.

    Attributes
    ----------
    half : {"solver", "measuring"}
    subject : str
        The solved or measured object, such as ``"bumpy sphere"`` or ``"fig6-thick, octant"``.
    quantity : str
        The quantity of the error, such as ``"mean curvature"``.
    error : float
        Relative to the known answer or to the finest result (``against``): 0.01 is 1 %.
    against : str
        The reference of the error as text: ``"theory"``, ``"exact"``, ``"finest mesh"``.
    axis : str
        The setting that is varied: ``"mesh"``, ``"scale"``, ``"layers"`` and so on.
    setting : str
        Short text on what differs from the standard, such as ``"h = 0.80 T"``.
    value : float
        Position on the axis.
    size : int
        Number of elements or vertices.
    seconds, fastest, slowest : float
        Wall time without compilation: median over the repeats, and their range.
    repeats : int
        0 if the work of a peer failed: then error and seconds are NaN, and the setting gives the reason.
    method : str
        The code: ``"morphofold"``, or the name of a peer with the called function.
    preset : str
        ``"draft"``, ``"standard"`` or ``"fine"`` if the setting is one of these, else empty.
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
    method: str = OUR_CODE
    preset: str = ""

    def __post_init__(self) -> None:
        checked_numbers = (self.error, self.seconds, self.fastest, self.slowest)
        if self.repeats and not all(math.isfinite(number) for number in checked_numbers):
            raise NotFinite(
                f"{self.subject}, {self.quantity}, {self.method}, {self.setting}: error and seconds must be finite, "
                f"got {self.error} in {self.seconds} s."
            )

    def as_row(self) -> dict[str, Any]:
        """All fields by name, for a table or a file."""
        return asdict(self)

    @staticmethod
    def from_row(row: Mapping[str, Any]) -> "Point":
        """The point of a row, with None as NaN; ``ValueError`` if a field is missing, unknown or of another type."""
        try:
            point_fields: dict[str, Any] = {name: math.nan if value is None else value for name, value in row.items()}
            for field in fields(Point):
                value = point_fields.get(field.name, field.default)
                if isinstance(value, bool) or not isinstance(value, VALID_TYPES[field.type]):
                    raise TypeError(f"{field.name} is not of type {field.type}")
            return Point(**point_fields)
        except TypeError as error:
            raise DamagedFile(f"not a point of a study of accuracy: {error}") from None


POINT_FIELDS = tuple(f.name for f in fields(Point))


class Case(NamedTuple):
    """A part of the study that is done as a whole: its name, also that of its file, and its computation."""

    name: str
    compute: Callable[[], list[Point]]


class Timing(NamedTuple):
    """Median, fastest and slowest wall time [s] without compilation, and the number of repeats."""

    seconds: float
    fastest: float
    slowest: float
    repeats: int

    @staticmethod
    def of(durations: Sequence[float]) -> "Timing":
        """The timing from the wall times of all repeats."""
        return Timing(statistics.median(durations), min(durations), max(durations), len(durations))


NO_TIMING = Timing(math.nan, math.nan, math.nan, 0)


def forget() -> None:
    """Forget what functions remember of arrays."""
    for results in REMEMBERED:
        results.clear()


def timed(compute: Callable[[], Any]) -> tuple[Any, Timing]:
    """The result of the work and its time. Long work is timed once. Other work is timed three times, quick work five
    times, after a warm-up that does not count. Nothing is remembered from one time to the next."""
    gc.collect()
    forget()
    began_at = working_seconds()
    result = compute()
    durations = [working_seconds() - began_at]
    if durations[0] < LONG:
        first_duration, durations = durations[0], []
        for _ in range(5 if first_duration < QUICK else 3):
            forget()
            began_at = working_seconds()
            result = compute()
            durations.append(working_seconds() - began_at)
    return result, Timing.of(durations)
