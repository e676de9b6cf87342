"""The results of ``python3 run.py bench accuracy``: tables, pictures, and an index that describes them."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from morphofold.analysis.resampled_cortex import PRESETS
from morphofold.io.json_files import write_json
from morphofold.report.plots.figure_style import save
from morphofold.studies.accuracy.accuracy_plots import HEADLINES, front_figure, overview
from morphofold.studies.accuracy.accuracy_tables import (
    COLUMNS,
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
from morphofold.studies.accuracy.folds_by_mesh import MESH, STAGES, WITH_A_LIMIT
from morphofold.studies.accuracy.fronts import constant
from morphofold.studies.accuracy.measuring_person import COARSE
from morphofold.studies.accuracy.solver_settings import SUBJECT
from morphofold.studies.index_schemas import write_tables

SHOWS = "errors and times of settings of the solver and of the analysis"

#: quantities of the study that the forecast of a scene's error uses; there their names have no growth
FORECAST = ("radius", "hoop stress", "onset", "gyrification index, g = 2", "wavelength, g = 2", "pial distance, g = 2")

#: quantities whose error a forecast of an analysis gives; curvature is that of the pial surface, like its maps
MEASURED = (
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
PERSONS = {"S1": "S1", "S1, pial": "S1", f"S1 at {COARSE:,} vertices": "S1, thinned"}


def write_study(points: Sequence[Point], made: Mapping[str, Any], folder: Path) -> dict[str, Any]:
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
    ours_and_peers: list[Point] = rivals(points)
    pictures: list[str] = []
    (folder / "figures").mkdir()
    shape_points = [p for p in ours_and_peers if p.half == "measuring" and p.against == "exact"]
    person_points = [p for p in ours_and_peers if p.half == "measuring" and p.against != "exact"]
    solver_points = [p for p in ours_and_peers if p.half == "solver" and _in_picture(p)]
    figures = {
        "solver": front_figure(solver_points, "axis"),
        "shapes": front_figure(shape_points, "method"),
        "person": front_figure(person_points, "axis"),
        "overview": overview(ours_and_peers) if {p.half for p in points} == {"solver", "measuring"} else None,
    }
    for name, figure in figures.items():
        if figure is not None:
            save(figure, folder / "figures" / f"{name}.png")
            pictures.append(f"figures/{name}.png")
    summary = {
        "shows": SHOWS,
        "made": dict(made),
        "halves": sorted({p.half for p in points}),
        "files": [*table_index["files"], *pictures],
        "left_out": table_index["left_out"],
        "columns": COLUMNS,
        "errors": expected_errors(points),
    }
    write_json(folder / "summary.json", summary)
    return summary


def _in_picture(p: Point) -> bool:
    """Whether the picture shows a point; for axes with their own limit only what the overview also shows."""
    return p.against in (THEORY, MESH) or (p.quantity, "mesh") in HEADLINES


def expected_errors(points: Sequence[Point]) -> dict[str, Any] | None:
    """Laws of the error with the edge over the thickness of the cortex, as a forecast reads them; None if the solver
    has none.

    ``coefficient * (edge / T)^power`` is the relative error of a quantity that is due to the mesh; the power is 0 where
    the fitted one is negative, because a finer mesh has no larger error but by chance. ``spread`` is the standard
    deviation of its logarithm; ``finest`` and ``coarsest`` are the studied edges over T. ``other`` is the
    root of the sum of squares of the errors of ``standard`` along the other axes with a limit, without kappa/mu, which
    is a property of the body. ``measuring`` is for the analysis: see :func:`measuring_errors`.
    """
    quantities = {}
    other_errors: dict[str, list[float]] = {}
    for row in budget_rows(points):
        if row["axis"] in WITH_A_LIMIT and row["axis"] != "kappa" and row["against"] not in (THEORY, MESH):
            other_errors.setdefault(row["quantity"], []).append(row["error"])
    for (half, subject, quantity, against, _, axis), group in along_meshes(points).items():
        is_forecast = quantity in FORECAST and against in (THEORY, MESH)
        if is_forecast and (half, subject, axis) == ("solver", SUBJECT, "mesh"):
            fit = laws_of(group)[1]
            if fit is not None:
                fit = fit if fit.power > 0 else constant([p.value for p in group], [p.error for p in group])
                quantities[quantity.removesuffix(", g = 2")] = {
                    "coefficient": fit.coefficient,
                    "power": fit.power,
                    "spread": fit.scatter,
                    "finest": fit.low,
                    "coarsest": fit.high,
                    "against": against,
                    "other": math.hypot(*other_errors.get(quantity, [])),
                }
    if not quantities:
        return None
    measuring = measuring_errors(points)
    return {"subject": SUBJECT, "growth": STAGES[-1], "quantities": quantities, "measuring": measuring}


def measuring_errors(points: Sequence[Point]) -> list[dict[str, Any]]:
    """Errors of the accuracies of the analysis on the hemisphere of one person, unchanged and thinned.

    Each entry has a ``subject`` and its number of ``vertices``. Each of its ``quantities`` has the reference
    (``against``) and the relative error by accuracy. A quantity that an accuracy does not change was studied only at
    standard, which holds for all. No accuracy gets a smaller error than a more expensive one: that would be chance.
    """
    people: dict[str, dict[str, Any]] = {}
    for p in points:
        if p.half == "measuring" and p.preset and p.subject in PERSONS and p.quantity in MEASURED:
            name = PERSONS[p.subject]
            person = people.setdefault(name, {"subject": name, "vertices": p.size, "quantities": {}})
            person["quantities"].setdefault(p.quantity, {"against": p.against})[p.preset] = p.error
    for person in people.values():
        quantities, person["quantities"] = person["quantities"], {}
        for name in (name for name in MEASURED if "standard" in quantities.get(name, {})):
            errors = [quantities[name].get(preset, quantities[name]["standard"]) for preset in PRESETS]
            error_of_preset = {preset: max(errors[k:]) for k, preset in enumerate(PRESETS)}
            person["quantities"][name] = {"against": quantities[name]["against"], **error_of_preset}
    return list(people.values())
