"""Names of maps and scalars on pages: label, unit, sign, and limits of colours. The words are in quantities.toml."""

import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Quantity:
    """A per-vertex quantity as pages show it; ``limits`` are used when they suit the data."""

    key: str
    label: str
    unit: str = ""
    signed: bool = False
    limits: tuple[float, float] | None = None
    aliases: tuple[str, ...] = ()

    @property
    def title(self) -> str:
        return f"{self.label} [{self.unit}]" if self.unit else self.label


_TOML: dict[str, Any] = tomllib.loads(Path(__file__).with_suffix(".toml").read_text("utf-8"))
_lists_as_tuples: Any = lambda fields: {k: tuple(v) if isinstance(v, list) else v for k, v in fields.items()}
QUANTITIES = tuple(Quantity(key, **_lists_as_tuples(fields)) for key, fields in _TOML["maps"].items())
#: label and unit of the numbers of a surface
SCALAR_WORDS: dict[str, tuple[str, str]] = {name: tuple(words) for name, words in _TOML["scalars"].items()}
#: the map from which a scalar is computed, if there is one
MAP_OF_SCALAR: dict[str, str] = _TOML["map_of_scalar"]
#: meaning of the columns of tables, where SCALAR_WORDS and the name of the column are not enough
COLUMN_WORDS: dict[str, str] = _TOML["columns"]

#: height above the smoothed surface about its median, a map that compare makes of a person and of what grew from it
RELIEF = "relief_height"
SAME_SIDE = "same_side"  # another one: whether the grown cortex and the person are both gyrus or both sulcus
#: gyral over cortical thickness, made by compare: median over mean of the surface, and median of the ratio over crests
THICKNESS_RATIO, CREST_THICKNESS_RATIO = "gyral_to_cortical_ratio", "gyral_to_cortical_ratio_at_crests"
# Blue, vermilion and green of Okabe and Ito's palette, then plum, brown, sky and black: all seven stay apart for
# protanopes and deuteranopes, too.
CATEGORICAL_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#5b2a6e", "#7a3b00", "#3f9bd1", "#333333")
MAIN_MAPS = ("H", "cortical_thickness", "gyral_thickness", "sulcal_depth")
#: the numbers that stand first on pages
HEADLINE_SCALARS: tuple[str, ...] = tuple(_TOML["headline_scalars"])


def quantity(name: str, map_values: Iterable[np.ndarray] = ()) -> Quantity:
    """The ``Quantity`` of a map's name.

    An unknown name gets its label and unit from the name. It is signed if the 2nd and 98th percentiles of
    ``map_values`` have different signs.
    """
    for candidate in QUANTITIES:
        if name == candidate.key or name in candidate.aliases:
            return candidate
    label, unit = _label_and_unit(name)
    percentiles = [np.percentile(v[np.isfinite(v)], [2, 98]) for v in map_values if np.isfinite(v).any()]
    return Quantity(name, label, unit, bool(percentiles) and bool(np.min(percentiles) < 0 < np.max(percentiles)))


def scalar_words(name: str) -> tuple[str, str]:
    """Label and unit of a scalar's name."""
    return SCALAR_WORDS.get(name) or _label_and_unit(name)


def column_words(name: str) -> tuple[str, str]:
    """Meaning of a column of a table, and its unit."""
    label, unit = scalar_words(name)
    if name in ("x", "y", "z"):
        unit = "mm"
    elif name.endswith("_deg"):
        unit = "degree"
    return COLUMN_WORDS.get(name, label), unit


def _label_and_unit(name: str) -> tuple[str, str]:
    unit_by_suffix = _TOML["unit_of_suffix"]
    suffix = next((suffix for suffix in unit_by_suffix if name.endswith(suffix)), "")
    label = name.removesuffix(suffix).replace("_", " ")
    return label[:1].upper() + label[1:], unit_by_suffix.get(suffix, "")


def common_limits(map_quantity: Quantity, map_values: Iterable[np.ndarray]) -> tuple[float, float]:
    """Common limits of colours for several surfaces; every surface has the same weight.

    The quantity's own limits are used if at least 80 % of every surface's values are inside, and the values fill at
    least 40 % of the range. Otherwise the limits are the least 2nd and the greatest 98th percentile of all surfaces,
    rounded outwards to two figures and, for a signed quantity, made symmetric about zero.
    """
    finite_values = [finite for array in map_values if (finite := array[np.isfinite(array)]).size]
    if not finite_values:
        return map_quantity.limits or (0.0, 1.0)
    percentiles = [np.percentile(array, [2, 98]) for array in finite_values]
    low, high = float(np.min(percentiles)), float(np.max(percentiles))
    if map_quantity.limits is not None:
        lowest, highest = map_quantity.limits
        least_inside_fraction = min(np.mean((array >= lowest) & (array <= highest)) for array in finite_values)
        if least_inside_fraction >= 0.8 and high - low >= 0.4 * (highest - lowest):
            return map_quantity.limits
    if map_quantity.signed:
        largest_magnitude = round_out(max(-low, high))
        return (-largest_magnitude, largest_magnitude) if largest_magnitude > 0 else (-1.0, 1.0)
    if high - low <= 1e-9 * max(1.0, abs(high)):
        margin_unit = round_out(abs(high)) or 1.0
        return (low - 0.1 * margin_unit, high + 0.1 * margin_unit)
    step = 10.0 ** np.floor(np.log10(high - low)) / 2
    return float(np.floor(low / step) * step), float(np.ceil(high / step) * step)


def round_out(x: float) -> float:
    """The next number with at most two figures whose second is 0 or 5, away from zero; 0 stays 0."""
    if x <= 0:
        return 0.0
    step = 10.0 ** np.floor(np.log10(x)) / 2
    return float(f"{np.ceil(x / step - 1e-9) * step:.12g}")  # 0.15, not 0.15000000000000002


def find(maps: Mapping[str, np.ndarray], key: str) -> np.ndarray | None:
    """The map named ``key`` or one of its aliases; None if there is none."""
    sought_quantity = quantity(key)
    return next((maps[name] for name in (sought_quantity.key, *sought_quantity.aliases) if name in maps), None)
