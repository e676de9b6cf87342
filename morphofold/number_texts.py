"""Numbers, times and lists as text for a reader."""

import math
from collections.abc import Sequence

import numpy as np


def number(x: float | int | None, digits: int = 3) -> str:
    """A number for a reader: ``digits`` figures, spaced thousands, a real minus, a dash for None."""
    if x is None or (isinstance(x, float) and not np.isfinite(x)):
        return "–"
    if isinstance(x, bool | str):
        return str(x)
    if isinstance(x, int | np.integer) or abs(x) >= 10**digits:
        text = f"{round(x):,}".replace(",", "\u202f")
    elif x != 0 and abs(x) < 1e-3:
        text = f"{x:.{digits - 1}e}"
    else:
        text = f"{x:.{max(digits - 1 - int(np.floor(np.log10(abs(x)))), 0) if x else 0}f}"
    return text.replace("-", "−")


#: name and length of a unit [s], most of them, and length, name and rounding of what is left
_SPAN_UNITS = (("min", 60, 60, 1, "s", 10), ("h", 3600, 24, 60, "min", 60), ("d", 86400, math.inf, 3600, "h", 3600))


def span(seconds: float) -> str:
    """A time in two units at most: ``0.4 s``, ``45 s``, ``4 min 40 s``, ``2 h 5 min``, ``3 d 2 h``."""
    if seconds < 119.5:
        return f"{seconds:.0f} s" if seconds >= 9.95 else f"{seconds:.1f} s"
    for unit_name, unit_seconds, max_amount, sub_unit, sub_name, rounding in _SPAN_UNITS:
        amount, remainder = divmod(round(seconds / rounding) * rounding, unit_seconds)
        if amount < max_amount:
            return f"{amount} {unit_name} {remainder // sub_unit} {sub_name}" if remainder else f"{amount} {unit_name}"
    raise AssertionError  # the last unit takes all


def percent(fraction: float) -> str:
    """A share with two digits at most: ``0.62 %``, ``2.1 %``, ``23 %``."""
    percentage = 100 * fraction
    return f"{percentage:.2g} %" if percentage < 99.5 else f"{percentage:.0f} %"


def percent_above(fraction: float) -> str:
    """A share with two digits, rounded up, so that the text is never less than the share."""
    return percent(rounded_up(fraction, 2))


def rounded_up(x: float, digits: int) -> float:
    """A positive number rounded up to so many digits."""
    step = 10.0 ** (math.floor(math.log10(x)) + 1 - digits)
    return math.ceil(x / step - 1e-9) * step


def in_one_line(value: object) -> str:
    """Text of an error or another object, without line breaks and double spaces."""
    return " ".join(str(value).split())


def listed(texts: Sequence[str]) -> str:
    """``a``, ``a and b``, ``a, b and c``."""
    return " and ".join([", ".join(texts[:-1]), texts[-1]] if len(texts) > 1 else texts)
