"""Which hemispheres of a group may be pooled: of each measure, those that were measured alike."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from morphofold.analysis.measures import FOLLOWS_FROM, PARAMETERS

HOW = ("morphofold", *PARAMETERS)  # the version, and what every measure may follow from
MAJORITY = 0.5  # share of the hemispheres that must be alike and more, for them to be pooled
NAMED = 4  # values that a sentence names
WORDS = {
    "morphofold": "version of morphofold",
    "folding_scale_mm": "scale of the folding indices [mm]",
    "graph_width_mm": "gyral width of the net [mm]",
    "cortical_thickness_cap_mm": "bound on cortical thickness [mm]",
    "cortex_mask": "cortex marked by",
    "accuracy": "accuracy",
    "annotation": "parcellation",
}
#: options that give a group one value: the coarsest scale, which all meshes bear, and the width in the middle
CURES: Mapping[str, tuple[str, Callable[[Any], Any]]] = {
    "folding_scale_mm": ("--curvature-scale", np.max),
    "graph_width_mm": ("--gyral-width", np.median),
}

How = tuple[Any, ...]  # of one hemisphere, in the order of HOW


@dataclass(frozen=True)
class Pooling:
    """What of a group is pooled.

    Attributes
    ----------
    counts : mapping of parameter to mapping of value to int
        Hemispheres by what is not the same of all of them, the commonest value first; empty if all were measured alike.
    alike : mapping of measure to (subjects, 2) bool
        Which values statistics may hold against each other; measures without an entry may be pooled whole.
    left_out : mapping of measure to (int, int)
        Values that are not pooled, and all; measures that are pooled whole have no entry.
    """

    counts: Mapping[str, Mapping[Any, int]] = field(default_factory=dict)
    alike: Mapping[str, NDArray[np.bool_]] = field(default_factory=dict)
    left_out: Mapping[str, tuple[int, int]] = field(default_factory=dict)

    def of(self, measure: str, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Values (subjects, 2) of a measure, NaN where they may not be pooled."""
        return np.where(self.alike[measure], values, np.nan) if measure in self.alike else values

    @property
    def sentences(self) -> list[str]:
        """Sentences: what differs, and the options that would measure the group alike."""
        parts = [f"{WORDS[key]} {_listed(counts)}" for key, counts in self.counts.items()]
        cures = []
        for key, (option, choice) in CURES.items():
            counts = {value: n for value, n in self.counts.get(key, {}).items() if value is not None}
            if counts:
                cures.append(f"{option} {choice(np.repeat(list(counts), list(counts.values()))):.3g}")
        found = [f"Hemispheres were not measured alike: {'; '.join(parts)}."] if parts else []
        return found + ([f"To measure all alike, run it again with {' '.join(cures)}."] if cures else [])


def pooling(hows: Sequence[How], of: NDArray[np.int64], scalars: Mapping[str, NDArray[np.float64]]) -> Pooling:
    """What may be pooled of hemispheres (subjects, 2) that were measured as ``hows[of]`` says; -1 where there is none.

    Of each measure the commonest of the ways that it follows from is pooled, if more than half of its values are of it;
    else none.
    """
    if len(hows) < 2:
        return Pooling()
    hemispheres = np.bincount(of[of >= 0], minlength=len(hows))
    counts = {}
    for k, key in enumerate(HOW):
        found = Counter({how[k]: 0 for how in hows})
        for how, n in zip(hows, hemispheres.tolist()):
            found[how[k]] += n
        if len(found) > 1:
            counts[key] = dict(sorted(found.items(), key=lambda item: (-item[1], str(item[0]))))
    alike, left_out = {}, {}
    for name, values in scalars.items():
        held = np.isfinite(values) & (of >= 0)
        kinds, kind = _kinds(hows, FOLLOWS_FROM.get(name, PARAMETERS))
        n = np.bincount(kind[of[held]], minlength=kinds)
        if held.any() and n.max() < held.sum():
            pooled = held & (kind[of] == n.argmax()) if n.max() > MAJORITY * held.sum() else np.zeros_like(held)
            alike[name], left_out[name] = pooled, (int(held.sum() - pooled.sum()), int(held.sum()))
    return Pooling(counts, alike, left_out)


def commonest(counts: Mapping[How, int]) -> How | None:
    """The way that more than half were measured in; None if there is none."""
    most = max(counts, key=lambda how: counts[how], default=None)
    return most if most is not None and counts[most] > MAJORITY * sum(counts.values()) else None


def part_of(how: How, parameters: Sequence[str]) -> How:
    """Of a way of measuring, the version and some parameters."""
    return tuple(how[HOW.index(key)] for key in ("morphofold", *parameters))


def _kinds(hows: Sequence[How], parameters: Sequence[str]) -> tuple[int, NDArray[np.int64]]:
    """Number of the different ways as far as some parameters say, and which of them each is."""
    number: dict[How, int] = {}
    kind = [number.setdefault(part_of(how, parameters), len(number)) for how in hows]
    return len(number), np.array(kind, dtype=np.int64)


def _listed(counts: Mapping[Any, int]) -> str:
    more = len(counts) - NAMED
    if more > 0 and all(isinstance(x, int | float) for x in counts):
        return f"{_word(min(counts))} to {_word(max(counts))} ({len(counts)} values)"
    first = ", ".join(f"{_word(value)} ({n})" for value, n in list(counts.items())[:NAMED])
    return f"{first} and {more} more" if more > 0 else first


def _word(value: Any) -> str:
    return "none" if value is None else f"{value:.3g}" if isinstance(value, int | float) else f"'{value}'"
