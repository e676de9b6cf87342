"""Contents of the tables and sentences of a page: surfaces and their numbers as plain rows for the template."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from morphofold.analysis.frames import COLUMNS, FREESURFER_VALUES
from morphofold.analysis.gyrification.folding_law import ShapeTerms, shape_terms_of
from morphofold.analysis.measures import SCALARS, Measures
from morphofold.comparison.growth import GrowthCurve, matching_growth
from morphofold.comparison.thickness import Cloud, TheoryLine
from morphofold.geometry import norms
from morphofold.mesh_quality.checks import cortex_label, vertices_at
from morphofold.mesh_quality.defects import SEVERE_WARNINGS, SLIGHT_WARNINGS, WARNINGS
from morphofold.quantities import THICKNESS_RATIO, scalar_words
from morphofold.report.pictures.sheet import safe_name
from morphofold.words import number

REGION_COLUMNS = (
    "region",
    "n_vertices",
    "area_mm2",
    "cortical_thickness_mm",
    "cortical_thickness_sd_mm",
    "gyral_thickness_mm",
    "gray_volume_mm3",
    "mean_H_per_mm",
)
HINGE_COLUMNS = (
    "hinge",
    "confidence",
    "degree",
    "shape",
    "min_angle_deg",
    "max_angle_deg",
    "mean_arm_length_mm",
    "region",
    "x",
    "y",
    "z",
)
CREST_COLUMNS = (
    "crest",
    "from_hinge",
    "to_hinge",
    "length_mm",
    "gyral_thickness_mm",
    "cortical_thickness_mm",
    "mean_H_per_mm",
    "region",
)
ACCURACY_NOTE = "accuracy"  # it and the warnings are about a surface, not about one number
LEVELS = ("severe", "check", "note")  # of warnings
PORTION_WORDS = {0.5: "Half", 0.25: "A quarter", 0.125: "One eighth"}
Rows = list[dict[str, Any]]
NumbersBySurface = Mapping[str, Sequence[Any]]  # of each surface, as comparison.side_by_side.numbers has them


@dataclass(frozen=True, eq=False)
class Entry:
    """One surface of a page: its name, its colour, marker and dashes in charts, its points in the plot of gyral
    against cortical thickness, and other stages of its growth."""

    name: str
    measures: Measures
    colour: str
    marker: str
    dash: str
    cloud: Cloud
    group: str = ""
    stages: tuple[Measures, ...] = ()

    @property
    def folding(self) -> ShapeTerms | None:
        """Terms of the law of folding."""
        return shape_terms_of(self.measures)

    @property
    def kind(self) -> str:
        """One line about the surface, shown below its name."""
        cortex = self.measures.cortex
        side = "" if cortex.origin == "simulation" else cortex.hemi
        facts = [self.group, cortex.origin if cortex.origin != "files" else "", cortex.name, side]
        g = cortex.info.get("g")
        if g is not None and not (isinstance(g, int | float) and cortex.name.endswith(f"g{g:.2f}")):  # not twice
            facts.append(f"growth {_value_text(g)}")
        return " · ".join(f for f in facts if f)


def scalars(numbers: NumbersBySurface, keys: Sequence[str] = ()) -> Rows:
    """One row per scalar, or for each of ``keys``; scalars that no surface has are in ``left_out`` instead."""
    rows = []
    for key in keys or numbers:
        values = numbers[key]
        if any(v is not None for v in values):
            label, unit = scalar_words(key)
            rows.append({"key": key, "label": label, "unit": unit, "values": values})
    return rows


def freesurfer_values(entries: Sequence[Entry]) -> NumbersBySurface:
    """FreeSurfer's own numbers of the surfaces, None where there is none."""
    return {key: [e.measures.cortex.info.get(key) for e in entries] for key in FREESURFER_VALUES}


def verdict(numbers: NumbersBySurface, theory: Sequence[TheoryLine]) -> list[str]:
    """Sentence on the ratio in linear theory, if gyral over cortical thickness and a stiffness ratio are known."""
    if not theory or all(value is None for value in numbers[THICKNESS_RATIO]):
        return []
    slopes = ", ".join(f"{number(t.slope)} (stiffness ratio {t.mu_ratio:.3g})" for t in theory)
    return [f"In linear theory, the wavelength of the first wrinkles over cortical thickness is {slopes}."]


def fits(entries: Sequence[Entry]) -> Rows:
    """The kind and number of the points of each surface, and the fit through them."""
    words = {"region": "regions", "crest": "crests"}
    return [
        {"entry": e, "fit": c.fit, "points": f"{len(c.points)} {words[c.kind]}" if c.kind in words else "whole surface"}
        for e in entries
        if (c := e.cloud).points
    ]


def met(entries: Sequence[Entry], growth: Sequence[GrowthCurve]) -> Rows:
    """The growth at which each number of a growing body equals that of each surface."""
    rows = []
    for curve in growth:
        found = [matching_growth(curve, e.measures) for e in entries]
        for key in curve.numbers:
            cells = [", ".join(f"{g:.2f}" for g in growths[key]) or "–" for growths in found]
            rows.append({"curve": curve.name, "number": key, "values": cells})
    return rows


def left_out(entries: Sequence[Entry]) -> Rows:
    """Measures that are missing and why; each reason once, with its surfaces."""
    rows = _note_rows(entries, lambda m, key: key in SCALARS and m.scalars.get(key) is None)
    silent = [k for k in SCALARS if all(_missing_without_note(e.measures, k) for e in entries)]
    if silent:
        words = "; ".join(scalar_words(k)[0] for k in silent)
        rows.append({"label": words, "why": "No reason was recorded.", "who": ""})
    return rows


def definitions(entries: Sequence[Entry]) -> Rows:
    """Notes of the measures on numbers that are there."""
    apart = (*WARNINGS, ACCURACY_NOTE)
    return _note_rows(
        entries, lambda m, key: key not in apart and (key not in SCALARS or m.scalars.get(key) is not None)
    )


def warnings(entries: Sequence[Entry], shown: Mapping[str, tuple[int, NDArray[np.int64]]]) -> Rows:
    """Warnings on the surfaces, the most severe first, with the vertices that they name.

    ``shown`` has the panel of each surface, by its name, and the vertices that are drawn there.
    """
    rows = []
    for key, (cause, _) in WARNINGS.items():
        for e in (e for e in entries if e.measures.notes.get(key)):
            panel, ids = shown[e.name]
            text, white = e.measures.notes[key], e.measures.cortex.white.verts
            places = [
                {"vertex": vertex, "panel": panel, "drawn": int(norms(white[ids] - white[vertex]).argmin())}
                for vertex in vertices_at(text, e.measures.cortex)
            ]
            rows.append({"entry": e, "code": key, "cause": cause, "text": text, "places": places, "level": _level(key)})
    return sorted(rows, key=lambda row: LEVELS.index(row["level"]))


def _level(warning: str) -> str:
    return LEVELS[0 if warning in SEVERE_WARNINGS else 2 if warning in SLIGHT_WARNINGS else 1]


def _missing_without_note(m: Measures, key: str) -> bool:
    return m.scalars.get(key) is None and key not in m.notes


def _note_rows(entries: Sequence[Entry], wanted: Callable[[Measures, str], bool]) -> Rows:
    """The ``wanted`` notes, in the order of their scalars; one row for all scalars and surfaces with the same text."""
    scalars: dict[str, list[str]] = {}
    names: dict[str, list[str]] = {}
    for key in dict.fromkeys([*SCALARS, *(k for e in entries for k in e.measures.notes)]):
        for e in entries:
            if key in e.measures.notes and wanted(e.measures, key):
                why = e.measures.notes[key]
                scalars[why] = list(dict.fromkeys([*scalars.get(why, []), scalar_words(key)[0]]))
                names[why] = list(dict.fromkeys([*names.get(why, []), e.name]))
    return [
        {
            "label": "; ".join(scalars[why]),
            "why": why,
            "who": ", ".join(names[why]) if len(names[why]) < len(entries) else "",
        }
        for why in scalars
    ]


def remarks(entries: Sequence[Entry], shown: Sequence[Mapping[str, Any]]) -> list[str]:
    """Notes on the surfaces as drawn; ``shown`` is the ``meta`` of ``pack`` for each."""
    sentences = []
    for e, meta in zip(entries, shown):
        cortex = e.measures.cortex
        if meta["thinned"]:
            drawn, there = number(meta["vertices"]), number(meta["all_vertices"])
            sentences.append(f"{e.name} is drawn with {drawn} of its {there} vertices; numbers are from all of them.")
        if cortex.portion != 1:
            part = PORTION_WORDS.get(cortex.portion, f"{cortex.portion:.3g}")
            share = f"{part} of the closed surface of {e.name}"
            sentences.append(f"{share} was simulated, the rest is mirrored. Counts and areas are of the whole.")
        label = cortex_label(cortex)[0]
        if not label.all():
            out = number(int((~label).sum()))
            sentences.append(f"{out} of {number(cortex.n_vertices)} vertices of {e.name} are not cortex (medial wall).")
        if accuracy := e.measures.notes.get(ACCURACY_NOTE):
            sentences.append(f"{e.name}: {accuracy}")
    return sentences


def tables(entries: Sequence[Entry]) -> Rows:
    """Tables of every surface that has them: title, column headings, values."""
    found = []
    for title, name, columns in (
        ("Thickness by shape and depth", "shapes", COLUMNS["shapes"]),
        ("Regions", "regions", REGION_COLUMNS),
        ("Hinges", "hinges", HINGE_COLUMNS),
        ("Crests", "crests", CREST_COLUMNS),
    ):
        for e in entries:
            rows = getattr(e.measures, name)
            if rows:
                found.append(
                    {
                        "title": title,
                        "entry": e,
                        "name": safe_name(f"{e.measures.cortex.name}-{e.measures.cortex.hemi}-{name}"),
                        "heads": [(key, *scalar_words(key)) for key in columns],
                        "rows": [[row.get(key) for key in columns] for row in rows],
                    }
                )
    return found


def parameters(entries: Sequence[Entry]) -> Rows:
    """Scales and options used, one row each."""
    return _rows_side_by_side([e.measures.parameters for e in entries])


def facts(entries: Sequence[Entry]) -> Rows:
    """Information from the files of the surfaces."""
    columns = []
    for e in entries:
        c = e.measures.cortex
        known = {key: value for key, value in c.info.items() if key not in FREESURFER_VALUES}
        columns.append({"origin": c.origin, "portion": c.portion, "units": c.units, **known})
    return _rows_side_by_side(columns)


def _rows_side_by_side(columns: Sequence[Mapping[str, Any]]) -> Rows:
    keys = dict.fromkeys(k for column in columns for k in column)
    return [{"key": k, "values": [_value_text(column.get(k)) for column in columns]} for k in keys]


def _value_text(value: Any) -> str:
    if isinstance(value, str) and re.fullmatch("[0-9a-f]{64}", value):
        return f"{value[:12]}…"  # a digest, whole in the JSON beside the page: columns shall not be as wide
    if value is None or isinstance(value, str):
        return value or "–"
    if isinstance(value, int | float | np.number) and not isinstance(value, bool):
        x = float(value)
        return number(x) if abs(x) >= 1e4 else f"{x:.4g}".replace("-", "−")
    if isinstance(value, Mapping):
        return ", ".join(f"{k} {_value_text(v)}" for k, v in value.items())
    return ", ".join(map(_value_text, value)) if isinstance(value, list | tuple) else str(value)
