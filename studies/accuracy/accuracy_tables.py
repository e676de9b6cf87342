"""The tables of a study of accuracy: all points with their fronts, laws of time and error, peers, presets, and the
sources of the error of the standard setting."""

from collections.abc import Iterable, Sequence
from typing import Any

from morphofold.studies.accuracy.error_points import OTHER_PEER, OUR_CODE, Point
from morphofold.studies.accuracy.solver_settings import MESH_AND_PACE, NESTED
from morphofold.studies.accuracy.time_error_fronts import Law, better_than, grouped, halving, law

Row = dict[str, Any]
SHARED_AXES = ("mesh", "mesh, nearest vertex", "mesh at 3 mm")  # axes on which we and the peers use the same mesh
MESH_AXES = ("mesh", MESH_AND_PACE)
PRESET_AXES = ("mesh", NESTED, "accuracy", "voxel")  # axes with presets

COLUMN_TEXTS = {
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
    return [point for point in points if point.repeats and (point.half == "measuring" or point.method == OUR_CODE)]


def ranked(points: Iterable[Point]) -> list[tuple[Point, Point | None]]:
    """Every point with an error, and the comparable point that dominates it."""
    groups = grouped(rivals(points)).values()
    return [point_pair for group in groups for point_pair in zip(group, better_than(group), strict=True)]


def point_rows(points: Sequence[Point]) -> list[Row]:
    """Every point with an error, and whether it is on a front."""
    rows = []
    for point, dominator in ranked(points):
        dominator_text = None if dominator is None else f"{dominator.method}: {dominator.axis}, {dominator.setting}"
        rows.append({**point.as_row(), "front": dominator is None, "dominated_by": dominator_text})
    return rows


def along_meshes(points: Iterable[Point]) -> dict[tuple[str, ...], list[Point]]:
    """Points along the axes of the mesh by (half, subject, quantity, against, method, axis), at least three sizes."""
    group_by_key: dict[tuple[str, ...], list[Point]] = {}
    for p in points:
        if p.axis in MESH_AXES and p.repeats:
            group_by_key.setdefault((p.half, p.subject, p.quantity, p.against, p.method, p.axis), []).append(p)
    return {group_key: group for group_key, group in group_by_key.items() if len({p.size for p in group}) > 2}


def edge_of(point: Point) -> float:
    """The length in mesh laws: edge over thickness for the solver, else 1 / root of the number of vertices."""
    return point.value if point.half == "solver" else point.size**-0.5


def laws_of(group: Sequence[Point]) -> tuple[Law, Law | None]:
    """Laws of time and of error with the edge; None for the error if it is round-off."""
    edges = [edge_of(point) for point in group]
    time_law = law(edges, [point.seconds for point in group])
    if any(point.error < 1e-12 for point in group):
        return time_law, None
    return time_law, law(edges, [point.error for point in group])


def law_rows(points: Sequence[Point]) -> list[Row]:
    """How time and error scale with the edge, and how much longer half the error takes."""
    rows = []
    for group_key, group in along_meshes(points).items():
        time_law, error_law = laws_of(group)
        half_time = halving(time_law, error_law) if error_law else None
        row: Row = dict(zip(("half", "subject", "quantity", "against", "method", "axis"), group_key, strict=True))
        row["points"] = len(group)
        for quantity, fitted_law in (("seconds", time_law), ("error", error_law)):
            row[f"{quantity}_power"] = fitted_law and fitted_law.power
            row[f"{quantity}_power_pm"] = fitted_law and fitted_law.uncertainty
            row[f"{quantity}_coefficient"] = fitted_law and fitted_law.coefficient
        row["error_scatter"] = error_law and error_law.scatter
        for suffix, factor_field in (("", "factor"), ("_low", "low"), ("_high", "high")):
            row[f"half_the_error{suffix}"] = half_time and getattr(half_time, factor_field)
        rows.append(row)
    return rows


def peer_rows(points: Sequence[Point]) -> list[Row]:
    """Each peer with our result on the same mesh, or, if there is none, with our ``standard``."""
    our_points = [p for p in points if p.method == OUR_CODE and p.axis in SHARED_AXES]
    our_point_of = {(p.half, p.subject, p.quantity, p.axis, p.size): p for p in our_points}
    our_point_of |= {(p.half, p.subject, p.quantity, p.axis, 0): p for p in our_points if p.preset == "standard"}
    rows = []
    for p in points:
        our_point = our_point_of.get((p.half, p.subject, p.quantity, p.axis, p.size))
        if p.method == OUR_CODE or our_point is None:
            continue
        row = _fields(p, "subject quantity size method setting seconds fastest slowest repeats error")
        row |= {f"our_{name}": cell for name, cell in _fields(our_point, "size seconds fastest slowest error").items()}
        error_ratio = p.error / our_point.error if our_point.error > 0 else None  # all are NaN for a peer that failed
        rows.append(row | {"seconds_ratio": p.seconds / our_point.seconds, "error_ratio": error_ratio})
    return rows


def preset_rows(points: Sequence[Point]) -> list[Row]:
    """Measured errors and times of the presets, whether on a front, and the error by the law along the mesh."""
    mesh_groups = along_meshes(points)
    rows = []
    for point, dominator in ranked(points):
        group_key = (point.half, point.subject, point.quantity, point.against, point.method, point.axis)
        if point.preset and point.axis in PRESET_AXES:
            fit = laws_of(mesh_groups[group_key])[1] if group_key in mesh_groups else None
            row = _fields(point, "half preset subject quantity against setting size seconds error")
            rows.append(row | {"error_by_law": fit.at(edge_of(point)) if fit else None, "front": dominator is None})
    return rows


def budget_rows(points: Sequence[Point]) -> list[Row]:
    """Sources of the error of ``standard``: along each axis, the difference from the last setting."""
    return [
        _fields(point, "axis quantity setting against error seconds")
        for point in points
        if point.half == "solver" and point.preset == "standard" and point.against != OTHER_PEER
    ]


def _fields(point: Point, columns: str) -> Row:
    return {column: getattr(point, column) for column in columns.split()}
