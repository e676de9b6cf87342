"""The part of a page on cortices that grew from a person who is on it, too: what is shown of each pair."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from markupsafe import Markup

from morphofold.comparison.person.compare_person import PersonComparison
from morphofold.comparison.person.regions import REGION_MEASURES
from morphofold.comparison.thickness import Cloud
from morphofold.quantities import RELIEF, common_limits, quantity, scalar_words
from morphofold.report.pages.contents import Entry
from morphofold.report.pictures.sheet import halved, png_bytes
from morphofold.report.pictures.surfaces import Row, figure
from morphofold.report.plots.charts import region_plot
from morphofold.surface import Surface

SMOOTH_COLOUR = "#8a8f96"
AGREEMENT_WORDS = {
    "depth": ("Sulci and gyri by depth", "share of area"),
    "curvature": ("Sulci and gyri by mean curvature", "share of area"),
    "axes": ("Directions of folds", "mean cos 2δ"),
}
CONTROL_WORDS = {RELIEF: "by height", "H": "by curvature", "axes": ""}
VERDICT_WORDS = {
    "above control": "more than unfolding left",
    "deepened": "no more than deepened sulci",
    "above spins": "more than by chance",
}


@dataclass(frozen=True, eq=False)
class PersonPart:
    """What the page shows of one pair: the comparison, entries of both, rows of tables, charts, the picture."""

    found: PersonComparison
    person: Entry
    grown: Entry
    agreements: list[dict[str, Any]]
    correlations: list[dict[str, Any]]
    charts: list[Markup]
    picture: str
    file: str


def with_smooth_bodies(
    entries: Sequence[Entry], people: Sequence[PersonComparison]
) -> tuple[list[Entry], dict[str, str]]:
    """The panels of the viewer: entries with heights, and the smooth body before the first cortex that grew from it.

    Also the person of each panel that has points on a person's sphere, by its name.
    """
    heights = {name: body for p in people for name, body in ((p.person, p.bodies.person), (p.grown, p.bodies.grown))}
    person_of = {name: p.person for p in people for name in (p.grown, p.person)}
    first = {(p.person, p.level): p for p in reversed(people)}
    before = {p.grown: p for p in first.values()}
    several = len({level for _, level in first}) > 1
    found = []
    for e in entries:
        if e.name in before:
            p = before[e.name]
            name = f"smooth body of {p.person}" + (f", level {p.level:g}" if several else "")
            found.append(Entry(name, p.bodies.smooth_measures(name), SMOOTH_COLOUR, "diamond", "", Cloud("whole", ())))
            person_of[name] = p.person
        found.append(replace(e, measures=heights[e.name].with_height()) if e.name in heights else e)
    return found, person_of


def person_parts(people: Sequence[PersonComparison], entries: Sequence[Entry], folder: Path) -> list[PersonPart]:
    """The part of each pair; writes its picture to ``folder/person-1.png`` and so on."""
    by_name = {e.name: e for e in entries}
    parts = []
    for number, found in enumerate(people, start=1):
        person, grown = by_name[found.person], by_name[found.grown]
        path = folder / f"person-{number}.png"
        image = _picture(found)
        path.write_bytes(png_bytes(image))
        charts = [
            region_plot(found.regions, key, *scalar_words(key), person, grown)
            for key in REGION_MEASURES
            if found.regions
        ]
        parts.append(
            PersonPart(
                found,
                person,
                grown,
                [_agreement_row(row) for row in found.agreements],
                [{"label": scalar_words(row.what)[0], **_row(row)} for row in found.correlations],
                [chart for chart in charts if chart is not None],
                base64.b64encode(png_bytes(halved(image))).decode(),
                f"{folder.name}/{path.name}",
            )
        )
    return parts


def _agreement_row(row: Any) -> dict[str, Any]:
    label, unit = AGREEMENT_WORDS[row.what]
    by = {"control_map": CONTROL_WORDS[row.control_map], "deepened_map": CONTROL_WORDS[row.deepened_map]}
    return {"label": label, "unit": unit, **by, **_row(row)}


def _row(row: Any) -> dict[str, Any]:
    return {"row": row, "t": row.tested, "d": row.deepened, "verdict": VERDICT_WORDS.get(row.verdict, row.verdict)}


def _picture(found: PersonComparison) -> Any:
    """Person, smooth body and grown cortex, hulls of equal area, coloured by height above the smoothed surface."""
    bodies, what = found.bodies, quantity(RELIEF)
    pial = bodies.grown.pial
    rows = [
        Row(found.person, bodies.person.pial, bodies.person.height, found.hemi),
        Row("smooth body before growth", bodies.surface, bodies.smooth_maps[RELIEF], found.hemi),
        Row(found.grown, Surface(found.scale * pial.verts, pial.faces, found.grown), bodies.grown.height, found.hemi),
    ]
    return figure(rows, what, common_limits(what, [row.values for row in rows]))
