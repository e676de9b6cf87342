"""The style of all figures by matplotlib: colours and dashes of curves, round limits and ticks, legends, colour bars.

Figures are drawn inside of ``plot_style`` or ``new_figure``; :func:`save` writes them, with the same bytes each time.
"""

import math
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from threading import RLock
from typing import Any

import matplotlib.style
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colorbar import Colorbar
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure

from morphofold.errors import WrongFile
from morphofold.quantities import CATEGORICAL_COLOURS
from morphofold.report.colours import Limits, table

Style = dict[str, Any]  # keyword arguments of matplotlib's functions, or its settings

#: file endings for figures, and the metadata that keep date and program out of the file
FORMATS = {
    ".png": {"Software": None},
    ".svg": {"Date": None, "Creator": None},
    ".pdf": {"CreationDate": None, "Creator": None, "Producer": None},
}
STYLE = {
    "font.size": 11,
    "axes.labelsize": 11,
    "axes.titlesize": 11,
    "axes.titlelocation": "left",
    "legend.fontsize": 10,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#e4e4e0",
    "grid.linewidth": 0.7,
    "axes.axisbelow": True,
    "lines.linewidth": 1.9,
    "legend.frameon": False,
    "legend.handlelength": 2.8,
    "svg.hashsalt": "morphofold",
    "pdf.fonttype": 42,
    "savefig.dpi": 160,
}
NO_FORMULAS = {"text.parse_math": False}  # for names, where $ is a plain character
DASHES = ("", "6 2", "1.2 1.4", "7 2 1.2 2", "3 1.5", "7 1.5 1.2 1.5 1.2 1.5")  # lengths of dashes and gaps
GREY = "#666666"
BLACK = "#1a1a1a"
ROUND_STEPS = np.array([float(f"{digit}e{power}") for power in range(-300, 300) for digit in (1, 2, 5)])
_SETTINGS_LOCK = RLock()


def save(figure: Figure, path: Path) -> None:
    """Write a figure in the format of the file ending, one of :data:`FORMATS`."""
    ending = check_format(path)
    with plot_style():
        figure.savefig(path, format=ending[1:], metadata=FORMATS[ending])


def check_format(path: Path) -> str:
    """Ending of a figure file in lower case; raises ``WrongFile`` if it is not in :data:`FORMATS`."""
    ending = path.suffix.lower()
    if ending not in FORMATS:
        raise WrongFile(
            f"{path}: a figure cannot have this ending. Use one of {', '.join(FORMATS)}, for example figure.png."
        )
    return ending


def line_style(index: int) -> Style:
    """Colour and dashes of one curve of several; each differs for the first six, both together for the first 36."""
    dashes = DASHES[(index + index // 6) % 6].split()
    return {"color": CATEGORICAL_COLOURS[index % 6], "linestyle": (0, tuple(map(float, dashes)))}


def around(values: Sequence[float], low: float, high: float, step: float) -> Limits:
    """Limits low to high, which are whole steps, extended by such where finite values lie beyond."""
    finite_values = [low, high, *filter(math.isfinite, values)]
    return step * math.floor(min(finite_values) / step + 1e-9), step * math.ceil(max(finite_values) / step - 1e-9)


def round_step(upper_limit: float) -> float:
    """The largest round step, 1, 2 or 5 times a power of ten, that is at most ``upper_limit``."""
    return float(ROUND_STEPS[ROUND_STEPS.searchsorted(upper_limit, "right") - 1])


def ticks(low: float, high: float, n_ticks: int = 5) -> list[float]:
    """About ``n_ticks`` round numbers from low to high, in steps of 1, 2 or 5 times a power of ten."""
    if not low < high:
        return [low]
    step = ROUND_STEPS[ROUND_STEPS.searchsorted(0.999 * (high - low) / n_ticks)]
    step_numbers = range(math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9) + 1)
    return [float(f"{step_number * step:.12g}") for step_number in step_numbers]


def legend_below(ax: Axes) -> None:
    """Draw a legend below the axes, where it covers nothing."""
    ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.17), ncols=2)


def legend_of_figure(figure: Figure, style_by_label: Mapping[str, Mapping[str, Any]], ax: Axes, columns: int) -> None:
    """Draw one legend below all panels, for lines of the styles in ``style_by_label``."""
    handles = [ax.plot([], [], label=label, **curve_style)[0] for label, curve_style in style_by_label.items()]
    figure.legend(handles=handles, loc="outside lower center", ncols=columns)


def colour_bar(figure: Figure, title: str, limits: Limits, signed: bool = False, **options: Any) -> Colorbar:
    """Draw the colours between the limits; ``options`` are as for :meth:`matplotlib.figure.Figure.colorbar`."""
    colour_scale = ScalarMappable(Normalize(*limits), ListedColormap(table(signed) / 255))
    colorbar = figure.colorbar(colour_scale, label=title, **options)
    colorbar.outline.set_visible(False)  # type: ignore[operator]
    return colorbar


@contextmanager
def plot_style(more_style: Mapping[str, Any] = {}) -> Iterator[None]:
    """Matplotlib's defaults with ``STYLE`` and ``more_style``, whatever the user's settings: all threads share these,
    so one draws at a time. A box stands for a character that the font lacks."""

    with _SETTINGS_LOCK, warnings.catch_warnings(), matplotlib.style.context(["default", STYLE, dict(more_style)]):
        warnings.filterwarnings("ignore", "Glyph .* missing from")
        yield


@contextmanager
def new_figure(
    width: float, height: float, n_rows: int = 1, n_columns: int = 1, *, style: Mapping[str, Any] = {}, **options: Any
) -> Iterator[tuple[Figure, Any]]:
    """A figure of this size [inches] with axes (rows, columns), without pyplot's global state.

    ``style`` is added to ``STYLE``.
    """
    with plot_style(style):
        figure = Figure(figsize=(width, height), layout="constrained")
        yield figure, figure.subplots(n_rows, n_columns, squeeze=False, **options)
