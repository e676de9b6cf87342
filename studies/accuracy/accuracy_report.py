"""The results of ``python3 run.py bench accuracy``: tables, pictures, and an index that describes them."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from morphofold.analysis.resampled_cortex import PRESETS
from morphofold.io.json_files import write_json
from morphofold.report.plots.figure_style import save
from morphofold.studies.accuracy.accuracy_plots import CURVE_LABELS, front_figure, overview
from morphofold.studies.accuracy.accuracy_tables import (
    COLUMN_TEXTS,
    along_meshes,
    budget_rows,
    law_rows,
    laws_of,
    peer_rows,
    point_rows,
    preset_rows,
    rivals,
)
from morphofold.studies.accuracy.error_points import Point
from morphofold.studies.accuracy.errors_from_theory import THEORY
from morphofold.studies.accuracy.folds_by_mesh import FINEST_MESH, LIMIT_AXES, OWN_LIMIT, STAGE_GROWTHS
from morphofold.studies.accuracy.measuring_person import COARSE_SIZE
from morphofold.studies.accuracy.solver_settings import STUDY_BODY
from morphofold.studies.accuracy.time_error_fronts import constant
from morphofold.studies.index_schemas import write_tables

CONTENT_TEXT = "errors and times of settings of the solver and of the analysis"

#: quantities of the study that the forecast of a scene's error uses; there their names have no growth
FORECAST = {
    **dict.fromkeys(("radius", "hoop stress", "onset"), THEORY),
    "gyrification index, g = 2": OWN_LIMIT,
    **dict.fromkeys(("wavelength, g = 2", "pial distance, g = 2"), FINEST_MESH),
}

#: quantities whose error a forecast of an analysis gives; curvature is that of the pial surface, like its maps
MEASURES = (
    "mean cortical thickness",
    "median gyral thickness",
    "wavelength",
    "spectral wavelength",
    "crest length",
    "hinges",
    "local gyrification",
    "mean curvature",
)
#: subject of the study -> name of its hemisphere
PERSON_NAMES = {"S1": "S1", "S1, pial": "S1", f"S1 at {COARSE_SIZE:,} vertices": "S1, thinned"}


def write_study(points: Sequence[Point], environment: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """Write tables, pictures and ``summary.json`` of a study into ``folder``; returns the summary.

    A table without data is not written, and ``left_out`` gives the reason.
    """
    tables = {
        "points": (point_rows(points), "there are no points"),
        "laws": (law_rows(points), "no quantity has three meshes"),
        "presets": (preset_rows(points), "no setting is a preset"),
        "budget": (budget_rows(points), "no solver was studied"),
        "peers": (peer_rows(points), "no peer is installed; install the extra `bench`"),
    }
    table_index = write_tables(folder, tables)
    rival_points: list[Point] = rivals(points)
    picture_files: list[str] = []
    (folder / "figures").mkdir()
    shape_points = [point for point in rival_points if point.half == "measuring" and point.against == "exact"]
    person_points = [point for point in rival_points if point.half == "measuring" and point.against != "exact"]
    solver_points = [point for point in rival_points if point.half == "solver" and _in_picture(point)]
    figures = {
        "solver": front_figure(solver_points, "axis"),
        "shapes": front_figure(shape_points, "method"),
        "person": front_figure(person_points, "axis"),
        "overview": overview(rival_points) if {point.half for point in points} == {"solver", "measuring"} else None,
    }
    for name, figure in figures.items():
        if figure is not None:
            save(figure, folder / "figures" / f"{name}.png")
            picture_files.append(f"figures/{name}.png")
    summary = {
        "shows": CONTENT_TEXT,
        "made": dict(environment),
        "halves": sorted({point.half for point in points}),
        "files": [*table_index["files"], *picture_files],
        "left_out": table_index["left_out"],
        "columns": COLUMN_TEXTS,
        "errors": expected_errors(points),
    }
    write_json(folder / "summary.json", summary)
    return summary


def _in_picture(point: Point) -> bool:
    """Whether the picture shows a point; for axes with their own limit only what the overview also shows."""
    return point.against in (THEORY, FINEST_MESH) or (point.quantity, "mesh") in {key[:2] for key in CURVE_LABELS}


def expected_errors(points: Sequence[Point]) -> dict[str, Any] | None:
    """Laws of the error with the edge over the thickness of the cortex, as a forecast reads them; None if the solver
    has none.

    ``coefficient * (edge / T)^power`` is the relative error of a quantity that is due to the mesh; the power is 0 where
    the fitted one is negative, because a finer mesh has no larger error but by chance. ``spread`` is the largest
    difference of the logarithm of an error from it; ``finest`` and ``coarsest`` are the studied edges over T. ``other``
    is the root of the sum of squares of the errors of ``standard`` along the other axes with a limit, without kappa/mu,
    which is a property of the body. ``measuring`` is for the analysis: see :func:`measuring_errors`.
    """
    law_by_name = {}
    errors_by_name: dict[str, list[float]] = {}
    for row in budget_rows(points):
        is_limit = row["against"] not in (THEORY, FINEST_MESH, OWN_LIMIT)
        if row["axis"] in LIMIT_AXES and row["axis"] != "kappa" and is_limit:
            errors_by_name.setdefault(row["quantity"], []).append(row["error"])
    for (half, subject, quantity, against, _, axis), group in along_meshes(points).items():
        is_forecast = FORECAST.get(quantity) == against
        if is_forecast and (half, subject, axis) == ("solver", STUDY_BODY, "mesh"):
            law = laws_of(group)[1]
            if law is not None:
                law = law if law.power > 0 else constant([p.value for p in group], [p.error for p in group])
                law_by_name[quantity.removesuffix(", g = 2")] = {
                    "coefficient": law.coefficient,
                    "power": law.power,
                    "spread": max(abs(math.log(p.error / law.at(p.value))) for p in group),
                    "finest": law.lowest_x,
                    "coarsest": law.highest_x,
                    "against": against,
                    "other": math.hypot(*errors_by_name.get(quantity, [])),
                }
    if not law_by_name:
        return None
    person_errors = measuring_errors(points)
    return {"subject": STUDY_BODY, "growth": STAGE_GROWTHS[-1], "quantities": law_by_name, "measuring": person_errors}


def measuring_errors(points: Sequence[Point]) -> list[dict[str, Any]]:
    """Errors of the accuracies of the analysis on the hemisphere of one person, unchanged and thinned.

    Each entry has a ``subject`` and its number of ``vertices``. Each of its ``quantities`` has the reference
    (``against``) and the relative error by accuracy. A quantity that an accuracy does not change was studied only at
    standard, which holds for all. No accuracy gets a smaller error than a more expensive one: that would be chance.
    """
    person_by_name: dict[str, dict[str, Any]] = {}
    for point in points:
        if point.half == "measuring" and point.preset and point.subject in PERSON_NAMES and point.quantity in MEASURES:
            name = PERSON_NAMES[point.subject]
            entry = person_by_name.setdefault(name, {"subject": name, "vertices": point.size, "quantities": {}})
            entry["quantities"].setdefault(point.quantity, {"against": point.against})[point.preset] = point.error
    for entry in person_by_name.values():
        error_by_name, entry["quantities"] = entry["quantities"], {}
        for name in (name for name in MEASURES if "standard" in error_by_name.get(name, {})):
            errors = [error_by_name[name].get(preset, error_by_name[name]["standard"]) for preset in PRESETS]
            error_of_preset = {preset: max(errors[preset_index:]) for preset_index, preset in enumerate(PRESETS)}
            entry["quantities"][name] = {"against": error_by_name[name]["against"], **error_of_preset}
    return list(person_by_name.values())
