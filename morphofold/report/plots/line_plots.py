"""Style, limits and legends of line plots, and files with the same bytes for the same figure."""

import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from threading import RLock
from typing import Any, Literal

import matplotlib.style
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colorbar import Colorbar
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure

from morphofold.errors import WrongFile
from morphofold.quantities import CATEGORICAL_COLOURS
from morphofold.report import colours

#: file endings for figures, and the metadata that keep date and program out of the file
FORMATS: dict[str, dict[str, Any]] = {
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
DASHES = ((0, ()), (0, (6, 2)), (0, (1.2, 1.4)), (0, (7, 2, 1.2, 2)), (0, (3, 1.5)), (0, (7, 1.5, 1.2, 1.5, 1.2, 1.5)))
GREY = "#666666"
BLACK = "#1a1a1a"
_SETTINGS = RLock()


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


def line_style(index: int) -> dict[str, Any]:
    """Colour and dashes of one curve of several; each differs for the first six, both together for the first 36."""
    return {"color": CATEGORICAL_COLOURS[index % 6], "linestyle": DASHES[(index + index // 6) % 6]}


def around(values: Sequence[float], low: float, high: float, step: float) -> tuple[float, float]:
    """Limits low to high, extended by whole steps where finite values lie beyond."""
    finite = np.array([v for v in values if np.isfinite(v)] or [low])
    below = step * np.floor(finite.min() / step + 1e-9)
    above = step * np.ceil(finite.max() / step - 1e-9)
    return min(low, float(below)), max(high, float(above))


def round_step(size: float) -> float:
    """A round step, 1, 2 or 5 times a power of ten; ``size`` is 3 to 8 steps."""
    if size < 1e-9:  # round-off only
        return 1.0
    decade = 10.0 ** np.floor(np.log10(size / 3))
    return float(decade * max(k for k in (1, 2, 5) if k * decade <= size / 3))


def ticks(low: float, high: float, about: int = 5) -> list[float]:
    """About ``about`` round numbers from low to high, in steps of 1, 2 or 5 times a power of ten."""
    least = (high - low) / about
    if not least > 0:
        return [low]
    decade = 10.0 ** np.floor(np.log10(least))
    step = min(decade * k for k in (1, 2, 5, 10) if decade * k >= 0.999 * least)
    first, last = int(np.ceil(low / step - 1e-9)), int(np.floor(high / step + 1e-9))
    return [float(f"{k * step:.12g}") for k in range(first, last + 1)]


def legend_below(ax: Axes) -> None:
    """Draw a legend below the axes, where it covers nothing."""
    ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.17), ncols=2)


def legend_of_figure(figure: Figure, entries: Mapping[str, Mapping[str, Any]], ax: Axes, columns: int) -> None:
    """Draw one legend below all panels, for the lines of ``entries``."""
    handles = [ax.plot([], [], label=label, **line)[0] for label, line in entries.items()]
    figure.legend(handles=handles, loc="outside lower center", ncols=columns)


def colour_bar(figure: Figure, title: str, limits: tuple[float, float], signed: bool = False, **where: Any) -> Colorbar:
    """Draw the colours between the limits; ``where`` is as for :meth:`matplotlib.figure.Figure.colorbar`."""

    table = ListedColormap(colours.table(signed) / 255)
    bar = figure.colorbar(ScalarMappable(Normalize(*limits), table), label=title, **where)
    bar.outline.set_visible(False)  # type: ignore[operator]
    return bar


@contextmanager
def plot_style(more: Mapping[str, Any] = {}) -> Iterator[None]:
    """Matplotlib's defaults with ``STYLE`` and ``more``, whatever the user's settings: all threads share these, so one
    draws at a time. A box stands for a character that the font lacks."""

    with _SETTINGS, warnings.catch_warnings(), matplotlib.style.context(["default", STYLE, dict(more)]):
        warnings.filterwarnings("ignore", "Glyph .* missing from")
        yield


@contextmanager
def blank_figure(
    width: float, height: float, layout: Literal["constrained"] | None = "constrained", style: Mapping[str, Any] = {}
) -> Iterator[Figure]:
    """A figure without pyplot's global state; inches. ``style`` is added to ``STYLE``."""

    with plot_style(style):
        yield Figure(figsize=(width, height), layout=layout)


@contextmanager
def new_figure(
    width: float, height: float, rows: int = 1, columns: int = 1, *, style: Mapping[str, Any] = {}, **shared: Any
) -> Iterator[tuple[Figure, Any]]:
    """As :func:`blank_figure`, with axes (rows, columns)."""
    with blank_figure(width, height, style=style) as figure:
        yield figure, figure.subplots(rows, columns, squeeze=False, **shared)
