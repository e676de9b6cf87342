"""Which hemispheres of a group may be pooled: for each measure, those measured with the same settings."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from morphofold.analysis.measures import PARAMETERS, PARAMETERS_OF_SCALAR

SETTING_NAMES = ("morphofold", *PARAMETERS)  # the version, and all parameters that a measure may depend on
LEAST_POOLED_SHARE = 0.5  # hemispheres are pooled if more than this share has the same settings
MOST_VALUES_LISTED = 4  # values that a sentence lists at most
SETTING_LABELS = {
    "morphofold": "version of morphofold",
    "folding_scale_mm": "scale of the folding indices [mm]",
    "graph_width_mm": "crown width, the scale of the net [mm]",
    "cortical_thickness_cap_mm": "bound on cortical thickness [mm]",
    "cortex_mask": "cortex marked by",
    "accuracy": "accuracy",
    "annotation": "parcellation",
}
#: options that give a group one value: the coarsest scale, which suits all meshes, and the median width
COMMON_VALUE_OPTIONS: Mapping[str, tuple[str, Callable[[Any], Any]]] = {
    "folding_scale_mm": ("--curvature-scale", np.max),
    "graph_width_mm": ("--gyral-width", np.median),
}

MeasuringSettings = tuple[Any, ...]  # settings of one hemisphere, in the order of SETTING_NAMES


@dataclass(frozen=True)
class Pooling:
    """What is pooled in a group.

    Attributes
    ----------
    counts : mapping of parameter to mapping of value to int
        Number of hemispheres by value, for each parameter that differs, the most common value first; empty if all were
        measured with the same settings.
    alike : mapping of measure to (subjects, 2) bool
        Which values may be pooled; measures without an entry may be pooled completely.
    left_out : mapping of measure to (int, int)
        Number of values not pooled, and of all values; measures that are pooled completely have no entry.
    """

    counts: Mapping[str, Mapping[Any, int]] = field(default_factory=dict)
    alike: Mapping[str, NDArray[np.bool_]] = field(default_factory=dict)
    left_out: Mapping[str, tuple[int, int]] = field(default_factory=dict)

    def of(self, measure: str, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Values (subjects, 2) of a measure, NaN where they may not be pooled."""
        return np.where(self.alike[measure], values, np.nan) if measure in self.alike else values

    @property
    def sentences(self) -> list[str]:
        """Sentences: what differs, and the options to measure the whole group with the same settings."""
        parts = [f"{SETTING_LABELS[key]} {_listed_counts(counts)}" for key, counts in self.counts.items()]
        cures = []
        for key, (option, choice) in COMMON_VALUE_OPTIONS.items():
            counts = {value: n for value, n in self.counts.get(key, {}).items() if value is not None}
            if counts:
                cures.append(f"{option} {choice(np.repeat(list(counts), list(counts.values()))):.3g}")
        found = [f"Hemispheres were not measured in the same way: {'; '.join(parts)}."] if parts else []
        return found + ([f"To measure all in the same way, run it again with {' '.join(cures)}."] if cures else [])


def pooling(
    hows: Sequence[MeasuringSettings], of: NDArray[np.int64], scalars: Mapping[str, NDArray[np.float64]]
) -> Pooling:
    """What may be pooled of hemispheres (subjects, 2) with settings ``hows[of]``; ``of`` is -1 where there is none.

    For each measure, only the parameters that it depends on count. Values with the most common settings are pooled, if
    they are more than half of all values; otherwise none are.
    """
    if len(hows) < 2:
        return Pooling()
    hemispheres = np.bincount(of[of >= 0], minlength=len(hows))
    counts = {}
    for k, key in enumerate(SETTING_NAMES):
        found = Counter({how[k]: 0 for how in hows})
        for how, n in zip(hows, hemispheres.tolist()):
            found[how[k]] += n
        if len(found) > 1:
            counts[key] = dict(sorted(found.items(), key=lambda item: (-item[1], str(item[0]))))
    alike, left_out = {}, {}
    for name, values in scalars.items():
        held = np.isfinite(values) & (of >= 0)
        kinds, kind = _distinct_settings(hows, PARAMETERS_OF_SCALAR.get(name, PARAMETERS))
        n = np.bincount(kind[of[held]], minlength=kinds)
        if held.any() and n.max() < held.sum():
            pooled = (
                held & (kind[of] == n.argmax()) if n.max() > LEAST_POOLED_SHARE * held.sum() else np.zeros_like(held)
            )
            alike[name], left_out[name] = pooled, (int(held.sum() - pooled.sum()), int(held.sum()))
    return Pooling(counts, alike, left_out)


def commonest(counts: Mapping[MeasuringSettings, int]) -> MeasuringSettings | None:
    """The settings that more than half were measured with; None if there are none."""
    most = max(counts, key=lambda how: counts[how], default=None)
    return most if most is not None and counts[most] > LEAST_POOLED_SHARE * sum(counts.values()) else None


def settings_among(how: MeasuringSettings, parameters: Sequence[str]) -> MeasuringSettings:
    """The version and some parameters of the settings ``how``."""
    return tuple(how[SETTING_NAMES.index(key)] for key in ("morphofold", *parameters))


def _distinct_settings(hows: Sequence[MeasuringSettings], parameters: Sequence[str]) -> tuple[int, NDArray[np.int64]]:
    """Number of different settings with respect to ``parameters``, and the index (N,) of each."""
    number: dict[MeasuringSettings, int] = {}
    kind = [number.setdefault(settings_among(how, parameters), len(number)) for how in hows]
    return len(number), np.array(kind, dtype=np.int64)


def _listed_counts(counts: Mapping[Any, int]) -> str:
    more = len(counts) - MOST_VALUES_LISTED
    if more > 0 and all(isinstance(x, int | float) for x in counts):
        return f"{_setting_text(min(counts))} to {_setting_text(max(counts))} ({len(counts)} values)"
    first = ", ".join(f"{_setting_text(value)} ({n})" for value, n in list(counts.items())[:MOST_VALUES_LISTED])
    return f"{first} and {more} more" if more > 0 else first


def _setting_text(value: Any) -> str:
    return "none" if value is None else f"{value:.3g}" if isinstance(value, int | float) else f"'{value}'"
