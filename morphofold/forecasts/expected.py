"""What is expected of a run, as ``forecast`` returns it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from morphofold.forecasts.table import HEADLINE, Expected

STAGES = "stages"       # phases of a run that the solver's clock does not know: checks, maps and files of its stages,
SETTING_UP = "set-up"   # and the building of its body


@dataclass(frozen=True)
class Forecast:
    """What is expected of a run.

    Attributes
    ----------
    scene, shape, setting : str
        Its name and shape, and its accuracy in words: ``"standard"``, or between which levels its edge lies.
    edge_mm, edge_over_T : float or None
        Largest surface edge [mm], and in thicknesses of the (thinnest) cortex; None in one dimension, as all below.
    elements_through_cortex : int or None
        None for a mesh from a file, too.
    elements, nodes, steps, stages : int
    fewest_steps, most_steps : int
    seconds, fastest, slowest : float
        Wall time without compiling, and the range in which it plausibly is [s].
    seconds_by_phase : mapping
        As in health.json, with ``"set-up"`` and ``"stages"``.
    memory_GiB : float
        At most, of the whole process.
    threads : int
    errors : mapping
        Quantity to its ``Expected`` relative error; empty in one dimension, and for a scene unlike those studied.
    not_studied : tuple of str
        What of the scene is unlike them (:func:`morphofold.forecasts.table.not_studied`).
    how : mapping
        How each of these was obtained, in words.
    doubts : tuple of str
        Why it may not hold, one sentence each.
    """

    scene: str
    shape: str
    setting: str
    edge_mm: float | None
    edge_over_T: float | None
    elements_through_cortex: int | None
    elements: int
    nodes: int
    steps: int
    fewest_steps: int
    most_steps: int
    stages: int
    seconds: float
    fastest: float
    slowest: float
    seconds_by_phase: Mapping[str, float]
    memory_GiB: float
    threads: int
    errors: Mapping[str, Expected]
    not_studied: tuple[str, ...]
    how: Mapping[str, str]
    doubts: tuple[str, ...]

    @property
    def headline(self) -> tuple[str, Expected] | None:
        """The largest error of ``HEADLINE``, and of what it is."""
        found = [(name, self.errors[name]) for name in HEADLINE if name in self.errors]
        return max(found, key=lambda item: item[1].error) if found else None

    def as_dict(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        return {**asdict(self), "not_studied": list(self.not_studied), "doubts": list(self.doubts)}
