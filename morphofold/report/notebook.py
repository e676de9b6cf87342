"""What a notebook shows: a cortex, measures, a comparison or a simulation goes in, HTML with a short table and a small
picture comes out; and the picture of one map, for ``Measures.plot``. No graphics card is needed.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import singledispatch
from typing import Any

import numpy as np
from PIL import Image

from morphofold.analysis.measures_result import Measures
from morphofold.comparison import Comparison
from morphofold.errors import NothingToDo, OutOfRange, UnknownName
from morphofold.number_texts import in_one_line
from morphofold.quantities import HEADLINE_SCALARS, MAIN_MAPS, Quantity, find, quantity, scalar_words
from morphofold.report.pages.page_writer import SIDES, plural, render
from morphofold.report.pictures.pixel_canvas import in_page, in_steps_of_four, png_bytes
from morphofold.report.pictures.surfaces import NO_VALUES, Row, figure
from morphofold.sim.output.simulation_folder import Simulation
from morphofold.surface import Cortex

SIDE_VIEWS = ("lateral", "medial")
MOST_SURFACES = 4  # of a comparison that are drawn; its table has them all
WIDTH_PX = {1: 840, 2: 1040}  # by the number of views; more get 1520
CARD_PX = (700, 900)  # of one surface, and of several
SHOWN_SCALARS = ("n_vertices", *HEADLINE_SCALARS, "n_hinges")
NO_MEASURE = Quantity("surface", "")
NumbersRow = tuple[str, str, Sequence[Any]]  # label, unit, values


@dataclass(frozen=True)
class Card:
    """Title, rows of label, unit and values, sentences below, and a picture of surfaces or why there is none."""

    title: str
    rows: Sequence[NumbersRow]
    column_names: Sequence[str] = ()
    remarks: Sequence[str] = ()
    surfaces: Sequence[Row] = ()
    measure: Quantity = NO_MEASURE
    reason: str = ""


def html_of(result: Any) -> str:
    """Table and picture of an object, as HTML that needs nothing else.

    A surface without extent, or a folder whose stages can't be read, gives the reason in place of the picture.
    """
    card = card_of(result)
    picture_source, reason, has_several = "", card.reason, len(card.surfaces) > 1
    if card.surfaces:
        views = SIDE_VIEWS[: 1 if has_several else 2]
        try:
            image = figure(card.surfaces, card.measure, None, views, CARD_PX[has_several], transposed=has_several)
            picture_source = in_page(png_bytes(in_steps_of_four(image)))
        except OutOfRange as error:
            reason = f"No picture: {error}"
    return render("notebook.html", card=card, picture=picture_source, reason=reason)


def plot(
    measures: Measures, map_name: str, surface_name: str, views: str | Sequence[str], limits: tuple[float, float] | None
) -> Image.Image:
    """Picture of one map, as the report draws it."""
    cortex = measures.cortex
    values = find(measures.maps, map_name)
    if values is None:
        raise UnknownName(f"{cortex.called}: has no map {map_name!r}. Its maps: {', '.join(measures.maps) or 'none'}.")
    views = (views,) if isinstance(views, str) else tuple(views)
    if not views:
        raise NothingToDo(f"{cortex.called}: no view is named. Name some: lateral, medial, top, bottom, front.")
    if limits is not None and not (len(limits) == 2 and np.isfinite(limits).all() and limits[0] < limits[1]):
        raise OutOfRange(f"{cortex.called}: limits must be two numbers, the smaller first; got {tuple(limits)}.")
    row = Row(cortex.called, cortex.surface(surface_name), values, cortex.hemi)
    return Image.fromarray(figure([row], quantity(map_name, [values]), limits, views, WIDTH_PX.get(len(views), 1520)))


@singledispatch
def card_of(result: Any) -> Card:
    """The card of a cortex, measures, a comparison or a simulation."""
    raise NotImplementedError(type(result).__name__)


@card_of.register
def _of_cortex(cortex: Cortex) -> Card:
    extra_names = [*cortex.maps, *(name for name in ("inflated", "sphere") if getattr(cortex, name))]
    facts = {
        "Hemisphere": SIDES[cortex.hemi],
        "From": cortex.origin,
        **_sizes(cortex),
        "Regions": f"{len(cortex.regions.names)} of {cortex.regions.name}" if cortex.regions else None,
        "With": ", ".join(extra_names),
    }
    return Card(f"Cortex {cortex.name}", _rows([facts], facts), surfaces=[Row("", cortex.pial, hemi=cortex.hemi)])


@card_of.register
def _of_measures(measures: Measures) -> Card:
    tables = {name: getattr(measures, name) for name in ("regions", "crests", "hinges", "arms", "shapes")}
    return Card(
        f"Measures of {measures.cortex.name}, {SIDES[measures.cortex.hemi]}",
        _rows([measures.scalars], (*SHOWN_SCALARS, "wavelength_mm")),
        remarks=[
            f"Scalars: {sum(value is not None for value in measures.scalars.values())}. Notes: {len(measures.notes)}.",
            f"Maps: {', '.join(measures.maps) or 'none'}.",
            f"Tables: {', '.join(f'{len(rows)} {name}' for name, rows in tables.items() if rows) or 'none'}.",
            measures.notes.get("only", ""),
        ],
        **_surfaces([measures], [measures.cortex.called]),
    )


@card_of.register
def _of_comparison(comparison: Comparison) -> Card:
    columns = [{row["measure"]: row[name] for row in comparison.table} for name in comparison.names]
    limit_remark = f"The picture shows the first {MOST_SURFACES}." if len(comparison.names) > MOST_SURFACES else ""
    return Card(
        f"Comparison of {plural(len(comparison.names), 'surface')}",
        _rows(columns, SHOWN_SCALARS),
        column_names=comparison.names,
        remarks=[*comparison.cautions, limit_remark],
        **_surfaces(comparison.measures[:MOST_SURFACES], comparison.names[:MOST_SURFACES]),
    )


@card_of.register
def _of_simulation(simulation: Simulation) -> Card:
    scene, reason, surfaces = simulation.scene, "", []
    facts = {
        "Folder": str(simulation.path),
        "Shape": scene.geometry.shape,
        "Growth": f"{scene.growth.law}, to {scene.growth.final:g}",
        "Stiffness ratio": scene.material.mu_ratio,
    }
    try:
        if simulation.stages:
            facts["Stages"] = ", ".join(f"{growth:g}" for growth in simulation.stages)
            cortex, health = simulation.cortex(), simulation.health
            health_text = "healthy" if health["healthy"] else "; ".join(map(str, health["warnings"]))
            facts |= {**_sizes(cortex), "Health": health_text}
            surfaces = [Row("", cortex.pial, hemi=cortex.hemi)]
        else:
            reason = "No stage is written yet."
    except (OSError, ValueError) as error:  # a run that goes on or was moved; files that were changed
        reason = in_one_line(error)
    return Card(f"Simulation {scene.name}", _rows([facts], facts), surfaces=surfaces, reason=reason)


def _sizes(cortex: Cortex) -> dict[str, float]:
    areas = {f"area_{name}_mm2": cortex.to_trimesh(name).area for name in ("pial", "white")}
    return {"n_vertices": cortex.n_vertices, **areas}


def _rows(columns: Sequence[Mapping[str, Any]], names: Iterable[str]) -> list[NumbersRow]:
    """A row for each name, of a scalar or of a fact, that has a value in some column."""
    rows = {name: [column.get(name) for column in columns] for name in names}
    return [(*scalar_words(name), row) for name, row in rows.items() if any(value not in (None, "") for value in row)]


def _surfaces(measures: Sequence[Measures], names: Sequence[str]) -> dict[str, Any]:
    """Pial surfaces in the colours of the first main map, else of the first map, with a value; bare without one."""
    map_names = (*MAIN_MAPS, *(name for each in measures for name in each.maps))
    key = next((k for k in map_names if any(np.isfinite(each.maps.get(k, np.nan)).any() for each in measures)), "")
    arrays = [each.maps.get(key, np.full(each.cortex.n_vertices, np.nan)) if key else NO_VALUES for each in measures]
    rows = [Row(name, each.cortex.pial, array, each.cortex.hemi) for each, name, array in zip(measures, names, arrays)]
    return {"surfaces": rows, "measure": quantity(key, arrays) if key else NO_MEASURE}
