"""Which hemispheres of a group may be pooled: for each measure, those measured with the same settings."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd

from morphofold.analysis.measures import PARAMETERS, PARAMETERS_OF_SCALAR
from morphofold.arrays import Array, Bools

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


@dataclass(frozen=True)
class Pooling:
    """What is pooled in a group.

    Attributes
    ----------
    counts : mapping of parameter to mapping of value to int
        Number of hemispheres by value, for each parameter that differs, the most common value first; empty if all were
        measured with the same settings.
    poolable : mapping of measure to (subjects, 2) bool
        Which values may be pooled; measures without an entry may be pooled completely.
    left_out : mapping of measure to (int, int)
        Number of values not pooled, and of all values; measures that are pooled completely have no entry.
    """

    counts: Mapping[str, Mapping[Any, int]] = field(default_factory=dict)
    poolable: Mapping[str, Bools] = field(default_factory=dict)
    left_out: Mapping[str, tuple[int, int]] = field(default_factory=dict)

    def of(self, measure: str, values: Array) -> Array:
        """Values (subjects, 2) of a measure, NaN where they may not be pooled."""
        return np.where(self.poolable[measure], values, np.nan) if measure in self.poolable else values

    @property
    def sentences(self) -> list[str]:
        """Sentences: what differs, and the options to measure the whole group with the same settings."""
        if not self.counts:
            return []
        parts = [f"{SETTING_LABELS[key]} {_listed_counts(counts)}" for key, counts in self.counts.items()]
        cures = []
        for key, (option, choice) in COMMON_VALUE_OPTIONS.items():
            counts = {value: n for value, n in self.counts.get(key, {}).items() if value is not None}
            if counts:
                cures.append(f"{option} {choice(np.repeat(list(counts), list(counts.values()))):.3g}")
        cure = [f"To measure all in the same way, run it again with {' '.join(cures)}."] if cures else []
        return [f"Hemispheres were not measured in the same way: {'; '.join(parts)}.", *cure]


def pooling(settings: pd.DataFrame, scalars: Mapping[str, Array]) -> Pooling:
    """What may be pooled of measures (subjects, 2); ``settings`` have a row for each value, empty without hemisphere.

    For each measure, only the parameters that it depends on count. Values with the most common settings are pooled, if
    they are more than half of all values; otherwise none are.
    """
    counts, poolable, left_out = {}, {}, {}
    for key, column in settings.dropna(subset="morphofold")[[*SETTING_NAMES]].items():
        numbers = Counter(column)
        if len(numbers) > 1:
            counts[str(key)] = dict(sorted(numbers.items(), key=lambda item: (-item[1], str(item[0]))))
    for name, values in scalars.items():
        measured = np.isfinite(values)
        pooled = measured_alike(settings, PARAMETERS_OF_SCALAR.get(name, PARAMETERS), measured)
        n, n_pooled = int(measured.sum()), int(pooled.sum())
        if n_pooled < n:
            poolable[name], left_out[name] = pooled, (n - n_pooled, n)
    return Pooling(counts, poolable, left_out)


def measured_alike(settings: pd.DataFrame, parameters: Sequence[str], measured: Bools) -> Bools:
    """Which of the ``measured`` values (subjects, 2) are by the version and the parameters that most are by; none if
    half or fewer are."""
    kinds = settings.groupby(["morphofold", *parameters], dropna=False).ngroup().to_numpy().reshape(measured.shape)
    counts = np.bincount(kinds[measured], minlength=1)
    return measured & (kinds == counts.argmax()) & (counts.max() > LEAST_POOLED_SHARE * measured.sum())


def _listed_counts(counts: Mapping[Any, int]) -> str:
    more = len(counts) - MOST_VALUES_LISTED
    if more > 0 and all(isinstance(x, int | float) for x in counts):
        return f"{_setting_text(min(counts))} to {_setting_text(max(counts))} ({len(counts)} values)"
    first = ", ".join(f"{_setting_text(value)} ({n})" for value, n in list(counts.items())[:MOST_VALUES_LISTED])
    return f"{first} and {more} more" if more > 0 else first


def _setting_text(value: Any) -> str:
    return "none" if value is None else f"{value:.3g}" if isinstance(value, int | float) else f"'{value}'"
