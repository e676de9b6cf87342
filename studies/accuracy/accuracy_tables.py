"""The tables of a study of accuracy: all points with their fronts, laws of time and error, peers, presets, and the
sources of the error of the standard setting."""

from collections.abc import Iterable, Sequence
from typing import Any

from morphofold.studies.accuracy.error_points import EACH_OTHER, OURS, Point
from morphofold.studies.accuracy.fronts import Law, better_than, grouped, halving, law
from morphofold.studies.accuracy.solver_settings import PACED

Row = dict[str, Any]
ON_MESHES = ("mesh", "mesh, nearest vertex", "mesh at 3 mm")  # axes on which we and the peers use the same mesh
REFINED = ("mesh", PACED)
PRESETS = ("mesh", "accuracy", "voxel")  # axes with presets

COLUMNS = {
    "error": "relative: 0.01 is 1 %",
    "against": "reference of the error",
    "value": "position of the setting on its axis: edge over thickness of the cortex, elements, kappa/mu, pace, "
    "factor, binary digits; for a surface the mean edge or the scale [mm]",
    "seconds, fastest, slowest": "wall time without compilation: median over the repeats, and range",
    "front": "1 if no setting with the same reference takes less than 75 % of the time with an error at most 5 % "
    "larger, or no more time with less than 95 % of the error",
    "dominated_by": "the most accurate of the settings that do",
    "*_power": "power of the edge (for a surface: of 1 / root of its number of vertices), +- half the 95 % interval",
    "*_coefficient": "coefficient of the power law: error = coefficient * edge^power",
    "half_the_error": "half the error takes so many times as long, with its 95 % interval",
    "error_scatter": "standard deviation of ln error about its law",
    "seconds_ratio, error_ratio": "value of the peer over ours, if both use the same mesh",
}


def rivals(points: Iterable[Point]) -> list[Point]:
    """The points for fronts: without failed ones, and for the solver without theory, which can't fold."""
    return [p for p in points if p.repeats and (p.half == "measuring" or p.method == OURS)]


def ranked(points: Iterable[Point]) -> list[tuple[Point, Point | None]]:
    """Every point with an error, and the comparable point that dominates it."""
    groups = grouped(rivals(points)).values()
    return [pair for group in groups for pair in zip(group, better_than(group), strict=True)]


def point_rows(points: Sequence[Point]) -> list[Row]:
    """Every point with an error, and whether it is on a front."""
    rows = []
    for p, better in ranked(points):
        better_text = None if better is None else f"{better.method}: {better.axis}, {better.setting}"
        rows.append({**p.as_row(), "front": better is None, "dominated_by": better_text})
    return rows


def along_meshes(points: Iterable[Point]) -> dict[tuple[str, ...], list[Point]]:
    """Points along the axes of the mesh by (half, subject, quantity, against, method, axis), at least three sizes."""
    groups: dict[tuple[str, ...], list[Point]] = {}
    for p in points:
        if p.axis in REFINED and p.repeats:
            groups.setdefault((p.half, p.subject, p.quantity, p.against, p.method, p.axis), []).append(p)
    return {key: group for key, group in groups.items() if len({p.size for p in group}) > 2}


def edge_of(p: Point) -> float:
    """The length in mesh laws: edge over thickness for the solver, else 1 / root of the number of vertices."""
    return p.value if p.half == "solver" else p.size**-0.5


def laws_of(group: Sequence[Point]) -> tuple[Law, Law | None]:
    """Laws of time and of error with the edge; None for the error if it is round-off."""
    x = [edge_of(p) for p in group]
    seconds = law(x, [p.seconds for p in group])
    if any(p.error < 1e-12 for p in group):
        return seconds, None
    return seconds, law(x, [p.error for p in group])


def law_rows(points: Sequence[Point]) -> list[Row]:
    """How time and error scale with the edge, and how much longer half the error takes."""
    rows = []
    for key, group in along_meshes(points).items():
        time_law, error_law = laws_of(group)
        halved = halving(time_law, error_law) if error_law else None
        row: Row = dict(zip(("half", "subject", "quantity", "against", "method", "axis"), key, strict=True))
        row["points"] = len(group)
        for name, fitted_law in (("seconds", time_law), ("error", error_law)):
            row[f"{name}_power"] = fitted_law and fitted_law.power
            row[f"{name}_power_pm"] = fitted_law and fitted_law.uncertainty
            row[f"{name}_coefficient"] = fitted_law and fitted_law.coefficient
        row["error_scatter"] = error_law and error_law.scatter
        for end, field in (("", "factor"), ("_low", "low"), ("_high", "high")):
            row[f"half_the_error{end}"] = halved and getattr(halved, field)
        rows.append(row)
    return rows


def peer_rows(points: Sequence[Point]) -> list[Row]:
    """Each peer with our result on the same mesh, or, if there is none, with our ``standard``."""
    our_points = [p for p in points if p.method == OURS and p.axis in ON_MESHES]
    our_point_of = {(p.half, p.subject, p.quantity, p.axis, p.size): p for p in our_points}
    our_point_of |= {(p.half, p.subject, p.quantity, p.axis, 0): p for p in our_points if p.preset == "standard"}
    rows = []
    for p in points:
        our_point = our_point_of.get((p.half, p.subject, p.quantity, p.axis, p.size))
        if p.method == OURS or our_point is None:
            continue
        row = _fields(p, "subject quantity size method setting seconds fastest slowest repeats error")
        row |= {f"our_{k}": v for k, v in _fields(our_point, "size seconds fastest slowest error").items()}
        error_ratio = p.error / our_point.error if our_point.error > 0 else None  # all are NaN for a peer that failed
        rows.append(row | {"seconds_ratio": p.seconds / our_point.seconds, "error_ratio": error_ratio})
    return rows


def preset_rows(points: Sequence[Point]) -> list[Row]:
    """Measured errors and times of the presets, whether on a front, and the error by the law along the mesh."""
    meshes = along_meshes(points)
    rows = []
    for p, better in ranked(points):
        key = (p.half, p.subject, p.quantity, p.against, p.method, p.axis)
        if p.preset and p.axis in PRESETS:
            fit = laws_of(meshes[key])[1] if key in meshes else None
            row = _fields(p, "half preset subject quantity against setting size seconds error")
            rows.append(row | {"error_by_law": fit.at(edge_of(p)) if fit else None, "front": better is None})
    return rows


def budget_rows(points: Sequence[Point]) -> list[Row]:
    """Sources of the error of ``standard``: along each axis, the difference from the last setting."""
    return [
        _fields(p, "axis quantity setting against error seconds")
        for p in points
        if p.half == "solver" and p.preset == "standard" and p.against != EACH_OTHER
    ]


def _fields(p: Point, names: str) -> Row:
    return {name: getattr(p, name) for name in names.split()}
