"""The surfaces of a page: names and symbols in charts, tables, warnings, and reasons why a number is missing.

In goes a comparison, out come its entries; ``templates/report.html`` calls the rest, as ``notes``.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import chain, product
from pathlib import Path
from typing import Any

import numpy as np

from morphofold.analysis.gyrification.folding_indices import ShapeTerms
from morphofold.analysis.measures_result import COLUMNS, FREESURFER_VALUES, SCALARS, Measures
from morphofold.comparison import Comparison
from morphofold.comparison.thickness_plot_data import Cloud
from morphofold.forecasts.cost_record import Cost, cost_of_analysis, stored_cost
from morphofold.frozen_arrays import Ints
from morphofold.geometry import norms
from morphofold.mesh_quality.cortex_checks import cortex_label, vertices_at
from morphofold.note_texts import LEVELS, VERDICTS, WARNINGS
from morphofold.number_texts import number
from morphofold.quantities import scalar_words
from morphofold.report.plots import charts
from morphofold.surface import Cortex, Faces
from morphofold.timing import Stages

#: title and columns of the tables of a surface
TABLES = {
    "shapes": ("Thickness by shape and depth", COLUMNS["shapes"]),
    "regions": (
        "Regions",
        "region n_vertices area_mm2 cortical_thickness_mm cortical_thickness_sd_mm gyral_thickness_mm gray_volume_mm3 "
        "mean_H_per_mm".split(),
    ),
    "hinges": (
        "Hinges",
        "hinge confidence degree shape min_angle_deg max_angle_deg mean_arm_length_mm region x y z".split(),
    ),
    "crests": (
        "Crests",
        "crest from_hinge to_hinge length_mm gyral_thickness_mm cortical_thickness_mm mean_H_per_mm region".split(),
    ),
}
ACCURACY_NOTE = "accuracy"  # it and the warnings are about a surface, not about one number
Rows = list[dict[str, Any]]
NO_REASON = "No reason was recorded."
EMPTY_CLOUD = Cloud("whole", ())


@dataclass(frozen=True, eq=False)
class Display:
    """A cortex thinned for drawing: ``ids`` (n,) are vertices of the full surface, ``faces`` index ``ids``."""

    ids: Ints
    faces: Faces
    thinned: bool


@dataclass(frozen=True, eq=False)
class Entry(charts.Pen):
    """One surface of a page: its pen in charts, its points in the plot of gyral against cortical thickness, other
    stages of its growth, terms of the law of folding, the person on whose sphere it has points, and how it is drawn."""

    measures: Measures
    cloud: Cloud = EMPTY_CLOUD
    folding_terms: ShapeTerms | None = None
    group: str = ""
    stages: tuple[Measures, ...] = ()
    person: str | None = None
    display: Display = None  # type: ignore[assignment]  # until it is thinned

    @property
    def cortex(self) -> Cortex:
        """Its surfaces."""
        return self.measures.cortex

    @property
    def not_cortex(self) -> int:
        """Number of vertices that are not cortex."""
        return int((~cortex_label(self.cortex)[0]).sum())


Entries = Sequence[Entry]


def entries_of(comparison: Comparison) -> list[Entry]:
    """Name and pen of each surface; a group of one subject gets no label of its own."""
    entries = []
    for k, (name, measures) in enumerate(comparison.named.items()):
        group = next((group for group, names in comparison.groups.items() if name in names), "")
        group_label = "" if name in (group, f"{group} {measures.cortex.hemi}") else group
        marker, dash = [*charts.MARKERS][k % 4], charts.DASHES[(k + k // 4) % 4]  # sixteen before one repeats
        stages = tuple(stage for stage in comparison.stages.get(name, ()) if is_earlier_stage(stage, measures))
        entry_fields = comparison.clouds[k], comparison.folding[k], group_label, stages
        entries.append(Entry(name, comparison.colours[name], marker, dash, measures, *entry_fields))
    return entries


def is_earlier_stage(stage: Measures, measures: Measures) -> bool:
    """Whether ``stage`` is an earlier stage of the same body: less growth, same vertices (each stage splits quads)."""
    earlier, later = stage.cortex, measures.cortex
    is_same_body = earlier.n_vertices == later.n_vertices and earlier.info.get("name") == later.info.get("name")
    return is_same_body and earlier.info.get("g", np.inf) < later.info.get("g", 0.0)


# tables ------------------------------------------------------------------------------------------------------


def scalars(entries: Entries, comparison: Comparison) -> dict[str, list[Any]]:
    """The value of each surface for every scalar, and for FreeSurfer's own numbers, that any surface has."""
    values_by_scalar = {row["measure"]: [row[entry.name] for entry in entries] for row in comparison.table}
    values_by_scalar |= {key: [entry.cortex.info.get(key) for entry in entries] for key in FREESURFER_VALUES}
    return {key: values for key, values in values_by_scalar.items() if any(value is not None for value in values)}


def costs(entries: Entries, clock: Stages | None = None) -> list[tuple[str, Cost, Any]]:
    """Title, cost and estimated errors of each simulation whose folder is complete, and of the analysis of a clock."""
    cost_rows = []
    for entry in entries:
        for run_folder in (file.parents[2] for file in map(Path, entry.cortex.files) if file.name == "stage.json"):
            if (cost := stored_cost(run_folder)) is not None:
                # loads the solver, which a person does not need
                from morphofold.forecasts.richardson import stored_estimate

                cost_rows.append((f"The simulation of {entry.name}", cost, stored_estimate(run_folder)))
    if clock is not None:
        cost_rows.append(("The analysis", cost_of_analysis([entry.measures for entry in entries], clock), None))
    return cost_rows


def facts(entries: Entries) -> Rows:
    """Information from the files of each surface."""
    cortices = [entry.cortex for entry in entries]
    return [{"origin": each.origin, "portion": each.portion, "units": each.units, **each.info} for each in cortices]


def value_text(value: Any) -> str:
    """A value of any kind as text, short enough for a column."""
    if isinstance(value, str) and re.fullmatch("[0-9a-f]{64}", value):
        return f"{value[:12]}…"  # a digest, whole in the JSON beside the page: columns shall not be as wide
    if value is None or isinstance(value, str):
        return value or "–"
    if isinstance(value, int | float | np.number) and not isinstance(value, bool):
        as_float = float(value)
        return number(as_float) if abs(as_float) >= 1e4 else f"{as_float:.4g}".replace("-", "−")
    if isinstance(value, Mapping):
        return ", ".join(f"{name} {value_text(item)}" for name, item in value.items())
    return ", ".join(map(value_text, value)) if isinstance(value, list | tuple) else str(value)


# notes -------------------------------------------------------------------------------------------------------


def warnings(entries: Entries) -> Rows:
    """Warnings on the surfaces, the most severe first, with the vertices that they name."""
    rows = []
    for level, (key, (cause, _)), entry in product(VERDICTS, WARNINGS.items(), entries):
        if LEVELS[key] == level and (text := entry.measures.notes.get(key)):
            verts = entry.cortex.white.verts
            drawn_xyz = verts[entry.display.ids]
            places = [(vertex, norms(drawn_xyz - verts[vertex]).argmin()) for vertex in vertices_at(text, entry.cortex)]
            advice = {"level": level, "verdict": VERDICTS[level]}
            rows.append({"entry": entry, "code": key, "cause": cause, "text": text, "places": places, **advice})
    return rows


def notes(entries: Entries, *, of_missing: bool) -> list[tuple[str, str, str]]:
    """Notes on numbers that are missing, or on those that are there, in the order of scalars.

    One row for all with the same text: labels, text, and surfaces if these are not all. The last is of numbers that no
    surface has, without a reason.
    """
    rows: dict[str, Any] = {}  # labels and names as ordered sets, by text
    measured_keys = {key for entry in entries for key, value in entry.measures.scalars.items() if value is not None}
    noted_keys = dict.fromkeys(chain(*(entry.measures.notes for entry in entries)))
    for key, entry in product(dict.fromkeys([*SCALARS, *noted_keys]), entries):
        reason = entry.measures.notes.get(key, "" if key in measured_keys | noted_keys.keys() else NO_REASON)
        is_missing = key in SCALARS and entry.measures.scalars.get(key) is None
        if reason and is_missing == of_missing and key not in (*WARNINGS, ACCURACY_NOTE):
            labels, names = rows.setdefault(reason, ({}, {}))
            labels[scalar_words(key)[0]] = names[entry.name] = None
    lines = [("; ".join(a), reason, ", ".join(n) if len(n) < len(entries) else "") for reason, (a, n) in rows.items()]
    return sorted(lines, key=lambda note_row: note_row[1] == NO_REASON)
