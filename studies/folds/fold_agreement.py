"""Agreement of folds between meshes, between seeds of the imperfection, and with a line on cortical thickness.

All functions work on rows of :mod:`morphofold.studies.folds.fold_measures`, which also hold their ``seed``.
"""

from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from morphofold.errors import OpenSurface
from morphofold.frozen_arrays import Array
from morphofold.intersections.box_tree import box_tree, ray_hits
from morphofold.kernels import reading
from morphofold.studies.folds.fold_measures import Row
from morphofold.surface import Surface

N_DIRECTIONS = 4_000
N_HITS = 64  # space for the hits of a ray; a ray with more hits is cast again with enough space

#: numbers whose spread over seeds is computed
SPREAD_COLUMNS = ("gyrification_index", "gyri", "sulci", "wavelength_mm")
#: numbers whose slope on the cortical thickness is computed
SLOPE_COLUMNS = ("wavelength_mm", "gyral_thickness_mm")
#: scenes of one growth law that differ only in the thickness of the cortex: T = 1, 2 and 3 mm
SCENES_BY_LAW = (
    ("fig6-thin", "fig5", "fig6-thick"),
    ("fig6-thin-tangential", "fig5-tangential", "fig6-thick-tangential"),
)

#: (scene, level, seed, growth) -> outer radius [mm] along evenly spread directions
RadiiByRun = dict[tuple[str, str, int, float], Array]


class Line(NamedTuple):
    """A straight line by least squares; ``standard_error`` is that of the slope, None for two points."""

    slope: float
    standard_error: float | None
    intercept: float
    r: float


def outer_radius(surface: Surface, directions: Array) -> Array:
    """Distance (R,) [mm] from the origin to the last hit of the surface along unit directions (R, 3).

    This is the first hit from outside: overhangs hide the parts below them. No hit is lost at an edge or a vertex
    (:func:`morphofold.intersections.box_tree.ray_hits`), so a closed surface around the origin has one in every
    direction.

    Raises
    ------
    OpenSurface
        If a ray has no hit: the surface has a hole, or does not enclose the origin.
    """
    tree, origin = box_tree(surface.verts, surface.faces), (0.0, 0.0, 0.0)
    tree_arguments = reading(surface.verts, surface.faces, tree.bounds, tree.order)
    distances, signs = np.empty(N_HITS), np.empty(N_HITS)
    radii = np.empty(len(directions))
    for ray_index, direction in enumerate(map(tuple, np.asarray(directions, dtype=np.float64).tolist())):
        n_hits, _ = ray_hits(*tree_arguments, origin, direction, distances, signs)
        if n_hits > len(distances):
            distances, signs = np.empty(n_hits), np.empty(n_hits)
            ray_hits(*tree_arguments, origin, direction, distances, signs)
        if n_hits == 0:
            raise OpenSurface(
                f"{surface.name}: has no hit along direction {np.round(direction, 4).tolist()} from the origin; close "
                "its holes, and centre it."
            )
        radii[ray_index] = distances[:n_hits].max()
    return radii


def correlation(a: Array, b: Array) -> float | None:
    """Pearson's correlation of two functions on the same evenly spread directions; None if one is constant."""
    a, b = a - a.mean(), b - b.mean()
    norm = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / norm if norm > 0 else None


def line(x: Sequence[float], y: Sequence[float]) -> Line:
    """The least-squares line through points; the values of x must differ."""
    from scipy import stats

    fit = stats.linregress(x, y)
    standard_error = float(fit.stderr) if len(x) > 2 else None
    return Line(float(fit.slope), standard_error, float(fit.intercept), float(fit.rvalue))


def convergence_rows(rows: Sequence[Row], radii_by_run: RadiiByRun, levels: Sequence[str], seed: int) -> list[Row]:
    """A row per scene, growth and neighbouring pair of ``levels``, which run from coarse to fine; all of one seed."""
    row_by_key = {(row["scene"], row["level"], row["growth"]): row for row in rows if row["seed"] == seed}
    result_rows = []
    for scene, growth in _distinct((row["scene"], row["growth"]) for row in rows):
        for coarser, finer in pairwise(levels):
            coarser_row, finer_row = row_by_key[scene, coarser, growth], row_by_key[scene, finer, growth]
            row: Row = {"scene": scene, "growth": growth, "coarser": coarser, "finer": finer, "seed": seed}
            row["folded"] = coarser_row["wavelength_mm"] is not None and finer_row["wavelength_mm"] is not None
            row["correlation"] = correlation(*(radii_by_run[scene, level, seed, growth] for level in (coarser, finer)))
            for column in ("gyrification_index", "gyri", "sulci", "wavelength_mm"):
                row |= {f"{column}_coarser": coarser_row[column], f"{column}_finer": finer_row[column]}
                row[f"{column}_change_percent"] = _percent(coarser_row[column], finer_row[column])
            result_rows.append(row)
    return result_rows


def _percent(coarser: float | None, finer: float | None) -> float | None:
    return None if coarser is None or finer is None or coarser == 0 else 100 * (finer / coarser - 1)


def spread_rows(rows: Sequence[Row], level: str) -> list[Row]:
    """A row per scene and growth: mean, standard deviation (n - 1) and range over the seeds at one level.

    None for numbers that a seed lacks, such as those of folds if one seed is not folded yet.
    """
    result_rows = []
    for scene, growth in _distinct((row["scene"], row["growth"]) for row in rows):
        level_rows = [r for r in rows if (r["scene"], r["level"], r["growth"]) == (scene, level, growth)]
        row: Row = {"scene": scene, "growth": growth, "level": level, "seeds": len(level_rows)}
        for column in SPREAD_COLUMNS:
            row |= _moments(column, [r[column] for r in level_rows])
        result_rows.append(row)
    return result_rows


def _moments(column: str, values: Sequence[float | None]) -> Row:
    numbers = np.array([value for value in values if value is not None], dtype=np.float64)
    moment_columns = (f"{column}_mean", f"{column}_sd", f"{column}_min", f"{column}_max")
    if len(numbers) < max(2, len(values)):
        return dict.fromkeys(moment_columns)
    return dict(zip(moment_columns, map(float, (numbers.mean(), numbers.std(ddof=1), numbers.min(), numbers.max()))))


def slope_rows(rows: Sequence[Row]) -> list[Row]:
    """A row per growth law, number (:data:`SLOPE_COLUMNS`), level and growth: its line on the reference thickness T.

    The line is fitted to all seeds of the level. There is no line if one of the three bodies is not folded yet. For the
    wavelength, the row also has the line through the first wrinkles of linear stability, and the film formula, which
    is proportional to T.
    """
    result_rows = []
    for scene_names in SCENES_BY_LAW:
        law_rows = [row for row in rows if row["scene"] in scene_names]
        for level, growth in _distinct((row["level"], row["growth"]) for row in law_rows):
            growth_rows = [row for row in law_rows if (row["level"], row["growth"]) == (level, growth)]
            if {row["scene"] for row in growth_rows} == set(scene_names):
                result_rows += [_slope(column, growth_rows) for column in SLOPE_COLUMNS]
    return result_rows


def _slope(column: str, rows: Sequence[Row]) -> Row:
    """The line of one number through the bodies at one growth."""
    first_row = rows[0]
    slope_row: Row = {"law": first_row["law"], "mu_ratio": first_row["mu_ratio"], "number": column}
    slope_row |= {"level": first_row["level"], "growth": first_row["growth"], "points": len(rows)}
    slope_row["thicknesses"] = len({row["thickness_mm"] for row in rows})
    is_complete = all(row[column] is not None for row in rows)
    slope_row |= _line_of("", rows, column if is_complete else None)
    body_rows = list({row["scene"]: row for row in rows}.values())
    for source in ("theory", "film"):
        slope_row |= _line_of(f"{source}_", body_rows, f"{source}_wavelength_mm" if column == "wavelength_mm" else None)
    return slope_row


def _line_of(prefix: str, rows: Sequence[Row], column: str | None) -> dict[str, Any]:
    line_columns = [f"{prefix}{line_field}" for line_field in Line._fields]
    if column is None:
        return dict.fromkeys(line_columns)
    return dict(zip(line_columns, line([row["thickness_mm"] for row in rows], [row[column] for row in rows])))


def _distinct(keys: Iterable[Any]) -> list[Any]:
    return list(dict.fromkeys(keys))
