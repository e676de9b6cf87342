"""The part of a page on cortices that grew from a person who is on it, too: what is shown of each pair."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from morphofold.comparison.person.agreement import REGION_MEASURES
from morphofold.comparison.person.compare_person import PersonComparison
from morphofold.comparison.thickness import Cloud
from morphofold.quantities import RELIEF, common_limits, quantity, scalar_words
from morphofold.report.pages.entries import Entry
from morphofold.report.pages.templates import write_picture
from morphofold.report.pictures.sheet import Picture
from morphofold.report.pictures.surfaces import Row, figure
from morphofold.report.plots.charts import region_plot
from morphofold.surface import Surface

SMOOTH_COLOUR = "#8a8f96"
VERDICT_WORDS = {
    "above control": "more than unfolding left",
    "deepened": "no more than deepened sulci",
    "above spins": "more than by chance",
}


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
    panels = []
    for e in entries:
        if e.name in before:
            p = before[e.name]
            name = f"smooth body of {p.person}" + (f", level {p.level:g}" if several else "")
            panels.append(Entry(name, SMOOTH_COLOUR, "diamond", "", p.bodies.smooth_measures(name), Cloud("whole", ())))
            person_of[name] = p.person
        panels.append(replace(e, measures=heights[e.name].with_height()) if e.name in heights else e)
    return panels, person_of


def person_parts(
    people: Sequence[PersonComparison], entries: Sequence[Entry], folder: Path
) -> list[tuple[PersonComparison, Entry, Entry, list[Any], dict[str, Any]]]:
    """Each pair with the entries of both, charts of its regions, and its picture ``folder/person-1.png`` and so on."""
    by_name = {e.name: e for e in entries}
    parts = []
    for k, pair in enumerate(people, start=1):
        person, grown = by_name[pair.person], by_name[pair.grown]
        measures = REGION_MEASURES if pair.regions else ()
        plots = [region_plot(pair.regions, key, *scalar_words(key), person, grown) for key in measures]
        title = f"{pair.person}, the smooth body and {pair.grown}, four views each"
        picture = write_picture(folder / f"person-{k}.png", _picture(pair), title)
        parts.append((pair, person, grown, [plot for plot in plots if plot is not None], picture))
    return parts


def _picture(pair: PersonComparison) -> Picture:
    """Person, smooth body and grown cortex, hulls of equal area, coloured by height above the smoothed surface."""
    bodies, what = pair.bodies, quantity(RELIEF)
    pial = bodies.grown.pial
    rows = [
        Row(pair.person, bodies.person.pial, bodies.person.height, pair.hemi),
        Row("smooth body before growth", bodies.surface, bodies.smooth_maps["smooth"][RELIEF], pair.hemi),
        Row(pair.grown, Surface(pair.scale * pial.verts, pial.faces, pair.grown), bodies.grown.height, pair.hemi),
    ]
    return figure(rows, what, common_limits(what, [row.values for row in rows]))
