"""The HTML pages of an analysis and of a comparison: contents from here, layout in ``templates/report.html``.

A page is one file that opens offline. Styles, script, surfaces and charts are inlined, a content policy
forbids everything else, and every name from a file is escaped.
"""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from morphofold.analysis.graph.hinge_shapes import hinge_shapes
from morphofold.analysis.measures import Measures
from morphofold.comparison.growth import DIMENSIONLESS_NUMBERS, GrowthCurve
from morphofold.comparison.hinges import HingeComparison, compare_hinges
from morphofold.comparison.person.compare_person import PersonComparison
from morphofold.comparison.side_by_side import cautions, numbers, plot_notes, theory_lines
from morphofold.comparison.thickness import Cloud, TheoryLine, thickness_cloud
from morphofold.forecasts.cost import PAGE_STAGE
from morphofold.geometry import vertex_areas
from morphofold.progress import Progress, silent
from morphofold.provenance import records_as_read
from morphofold.quantities import (
    CATEGORICAL_COLOURS,
    HEADLINE_SCALARS,
    MAIN_MAPS,
    RELIEF,
    Quantity,
    common_limits,
    find,
    quantity,
)
from morphofold.report import colours
from morphofold.report.pages import contents
from morphofold.report.pages.contents import Entry
from morphofold.report.pages.costs import costs
from morphofold.report.pages.layers import net_of
from morphofold.report.pages.methods import methods
from morphofold.report.pages.pack import DISPLAY_VERTICES, STAGED_VERTICES, Display, pack, pack_stage, thin
from morphofold.report.pages.person_section import person_parts, with_smooth_bodies
from morphofold.report.pages.templates import versions, write_page
from morphofold.report.pictures.hinges import clear_examples, hinge_pairs
from morphofold.report.pictures.net import net_figure, net_row
from morphofold.report.pictures.sheet import Picture, halved, png_bytes, safe_name
from morphofold.report.pictures.surfaces import Row, VisibleFaces, figure
from morphofold.report.plots import charts
from morphofold.surface import Cortex, Surface
from morphofold.threads import beside

if TYPE_CHECKING:
    from morphofold.comparison import Comparison
    from morphofold.timing import Stages

ANALYSIS_TITLE = "Analysis"
SIDE_WORDS = {"lh": "left", "rh": "right"}
VIEWER_SCRIPTS = ("tables.js", "viewer-data.js", "viewer-layers.js", "viewer.js")
ShownMaps = dict[str, tuple[Quantity, tuple[float, float]]]  # map key -> quantity, limits for all surfaces
InputRecords = Sequence[Mapping[str, Any]]  # rows with path and sha256


def analysis_report(
    measures: Sequence[Measures],
    path: str | Path,
    *,
    failed: Mapping[str, str] = {},
    inputs: InputRecords = (),
    stages: Sequence[Measures] = (),
    clock: Stages | None = None,
) -> Path:
    """Write the page of one analysis to ``path`` and its pictures to ``figures/`` beside it.

    ``failed`` maps hemispheres that could not be measured to the reason. ``inputs`` are rows with ``path`` and
    ``sha256``; without them, the files that the surfaces name are hashed. ``stages`` are the growth stages of the one
    body that was measured; the page draws them. ``clock`` is the clock of the measurement; with it, the page lists
    the times.
    """
    if clock is not None:
        clock.begin(PAGE_STAGE)
    names = [m.cortex.name for m in measures]
    unique = [n if names.count(n) == 1 else f"{n} {m.cortex.hemi}" for n, m in zip(names, measures)]
    named = dict(zip(unique, measures))
    colours = dict(zip(unique, CATEGORICAL_COLOURS))
    shapes = {name: found for name, m in named.items() if (found := hinge_shapes(m)) is not None}
    grown = [[s.cortex for s in stages if _is_earlier_stage(s, m)] if m is measures[0] else [] for m in measures]
    clouds, hinges, thinned = beside(
        lambda: tuple(map(thickness_cloud, measures)),
        lambda: compare_hinges(shapes, {name: [name] for name in named}),
        lambda: beside(*(partial(_thinned, m.cortex, earlier) for m, earlier in zip(measures, grown))),
    )
    entries = _page_entries(named, colours, clouds, stages={unique[0]: stages})
    sides = " and ".join(SIDE_WORDS[m.cortex.hemi] for m in measures)
    what = f"The {sides} hemisphere{'s' if len(measures) > 1 else ''}"
    if all(m.cortex.origin == "simulation" for m in measures):
        what = "A simulated cortex"
    lede = f"{what}, measured from white and pial surface."
    title = ", ".join(dict.fromkeys(names))
    missing = [f"The {SIDE_WORDS[hemi]} hemisphere could not be measured: {why}" for hemi, why in failed.items()]
    return _write_page(
        Path(path),
        ANALYSIS_TITLE,
        title,
        lede,
        entries,
        theory_lines(named),
        hinges,
        inputs=inputs,
        doubts=cautions(named),
        missing=missing,
        thinned=thinned,
        clock=clock,
    )


def comparison_report(
    comparison: Comparison, folder: str | Path, *, inputs: InputRecords = (), progress: Progress = silent
) -> Path:
    """Write ``folder/report.html`` and ``folder/figures/`` of a comparison; ``progress`` gets share and step."""
    pairs = zip(comparison.names, comparison.measures)
    title = ", ".join(dict.fromkeys(n.removesuffix(f" {m.cortex.hemi}") for n, m in pairs))
    lede = "Measured with the same code. All surfaces share colours, bins and axes."
    named = dict(zip(comparison.names, comparison.measures))
    entries = _page_entries(named, comparison.colours, comparison.clouds, comparison.groups, comparison.stages)
    return _write_page(
        Path(folder) / "report.html",
        "Comparison",
        title,
        lede,
        entries,
        comparison.theory,
        comparison.hinges,
        comparison.growth,
        inputs,
        people=comparison.people,
        doubts=comparison.cautions,
        progress=progress,
    )


def _write_page(
    path: Path,
    kind: str,
    title: str,
    lede: str,
    entries: Sequence[Entry],
    theory: Sequence[TheoryLine],
    hinges: Sequence[HingeComparison],
    growth: Sequence[GrowthCurve] = (),
    inputs: InputRecords = (),
    missing: Sequence[str] = (),
    people: Sequence[PersonComparison] = (),
    doubts: Sequence[str] = (),
    thinned: Sequence[Display] = (),
    progress: Progress = silent,
    clock: Stages | None = None,
) -> Path:
    named = {e.name: e.measures for e in entries}
    table = numbers(list(named.values()))
    panels, person_of = with_smooth_bodies(entries, people)
    shown = _shown_maps(panels)
    main = [key for key in (RELIEF, *MAIN_MAPS) if key in shown]
    progress(0.0, "thinning surfaces")
    thinned = thinned or beside(*(partial(_thinned, e.measures.cortex, [m.cortex for m in e.stages]) for e in panels))
    own = [d for e, d in zip(panels, thinned) if e.name in named]
    progress(0.15, "drawing pictures")
    pictures, (viewer, blocks), pairs, histograms = beside(
        lambda: _write_pictures(path.parent / "figures", entries, own, shown),
        lambda: _viewer_data(panels, thinned, shown, person_of),
        lambda: _write_hinge_pairs(path.parent / "figures", hinges, named),
        lambda: _histogram_charts(entries, shown),
    )
    drawn = [meta for e, meta in zip(panels, viewer["surfaces"]) if e.name in named]
    progress(0.8, "drawing charts")
    spins = people[0].spins if people else 0
    paragraph, references = methods(entries, versions()[0][1], theory=bool(theory), spins=spins)
    return write_page(
        path,
        "report.html",
        VIEWER_SCRIPTS,
        kind=kind,
        title=title,
        lede=lede,
        entries=entries,
        theory=theory,
        headlines=contents.scalars(table, HEADLINE_SCALARS),
        verdict=contents.verdict(table, theory),
        scalars=contents.scalars({**table, **contents.freesurfer_values(entries)}),
        fits=contents.fits(entries),
        left_out=contents.left_out(entries),
        definitions=contents.definitions(entries),
        missing=missing,
        warnings=contents.warnings(entries, {e.name: (k, d.ids) for k, (e, d) in enumerate(zip(panels, thinned))}),
        cautions=doubts,
        plot_notes=plot_notes(named, [e.cloud for e in entries]),
        bins=any(e.cloud.bins for e in entries),
        remarks=contents.remarks(entries, drawn),
        tables=contents.tables(entries),
        methods=paragraph,
        references=references,
        parameters=contents.parameters(entries),
        facts=contents.facts(entries),
        inputs=list(inputs) or _input_records(entries),
        charts=histograms,
        scatter=_thickness_scatter_chart(entries, theory),
        pictures=pictures,
        maps=[what for what, _ in shown.values()],
        main=main,
        panels=panels,
        people=person_parts(people, entries, path.parent / "figures"),
        viewer=viewer,
        blocks=blocks,
        columns={1: 1, 2: 2, 4: 2}.get(len(panels), 3),
        hinges=hinges,
        pairs=pairs,
        growth=growth,
        growth_charts=_growth_charts(entries, growth),
        met=contents.met(entries, growth),
        law=_folding_law_chart(entries, growth),
        ratio=_thickness_ratio_chart(entries),
        folding=[(e, t) for e in entries if (t := e.folding) is not None],
        sides=len({e.measures.cortex.hemi for e in entries if e.measures.cortex.origin != "simulation"}),
        slider=any(e.stages for e in entries),
        nets=any(e.measures.graph is not None for e in entries),
        inflated=any(e.measures.cortex.inflated is not None for e in entries),
        drawn=_drawn_surface(panels),
        costs=costs(entries, clock) if kind == ANALYSIS_TITLE else [],
    )


def _drawn_surface(entries: Sequence[Entry]) -> str:
    """The surface that a page shows first, and in pictures: inflated, where sulci are seen, if every surface has it."""
    return "inflated" if all(e.measures.cortex.inflated is not None and not e.stages for e in entries) else "pial"


def _thinned(cortex: Cortex, stages: Sequence[Cortex]) -> Display:
    return thin(cortex, STAGED_VERTICES if stages else DISPLAY_VERTICES, stages)


def _page_entries(
    named: Mapping[str, Measures],
    colours: Mapping[str, str],
    clouds: Sequence[Cloud],
    groups: Mapping[str, Sequence[str]] = {},
    stages: Mapping[str, Sequence[Measures]] = {},
) -> list[Entry]:
    """Name and look of each surface; a group of one subject gets no label of its own."""
    held = {name: group for group, names in groups.items() for name in names}
    entries = []
    for k, ((name, m), cloud) in enumerate(zip(named.items(), clouds)):
        group = held.get(name, "")
        group_label = group if name not in (group, f"{group} {m.cortex.hemi}") else ""
        marker, dash = [*charts.MARKERS][k % 4], charts.DASHES[(k + k // 4) % 4]  # sixteen before one repeats
        grown = tuple(s for s in stages.get(name, ()) if _is_earlier_stage(s, m))
        entries.append(Entry(name, m, colours[name], marker, dash, cloud, group_label, grown))
    return entries


def _is_earlier_stage(stage: Measures, m: Measures) -> bool:
    """Whether ``stage`` is an earlier stage of the same body: less growth, same vertices (each stage splits quads)."""
    a, b = stage.cortex, m.cortex
    same = all(x == y for x, y in ((a.n_vertices, b.n_vertices), (a.info.get("name"), b.info.get("name"))))
    return same and "g" in a.info and "g" in b.info and float(a.info["g"]) < float(b.info["g"])


def _input_records(entries: Sequence[Entry]) -> InputRecords:
    return records_as_read(e.measures.cortex for e in entries)


def _entries_with_map(entries: Sequence[Entry], key: str) -> list[tuple[Entry, NDArray[np.float64]]]:
    """The entries that have the map ``key`` with at least one value, each with the map."""
    found = [(e, find(e.measures.maps, key)) for e in entries]
    return [(e, a) for e, a in found if a is not None and np.isfinite(a).any()]


def _shown_maps(entries: Sequence[Entry]) -> ShownMaps:
    """The maps that a page shows, heights of folds and main maps first, with the limits that all its surfaces share."""
    others = {quantity(n).key for e in entries for n in e.measures.maps} - {RELIEF, *MAIN_MAPS}
    shown = {}
    for key in (RELIEF, *MAIN_MAPS, *sorted(others)):
        if arrays := [a for _, a in _entries_with_map(entries, key)]:
            what = quantity(key, arrays)
            shown[key] = (what, common_limits(what, arrays))
    return shown


def _viewer_data(
    entries: Sequence[Entry], thinned: Sequence[Display], shown: ShownMaps, person_of: Mapping[str, str] = {}
) -> tuple[dict[str, Any], contents.Rows]:
    """The JSON configuration of viewer.js, and one block of packed data per surface (and per stage).

    ``person_of`` has the person of each surface that has points on that person's sphere.
    """
    surfaces, blocks = [], []
    steps = {key: (high - low) / 2000 for key, (_, (low, high)) in shown.items()}  # finer than the colours can show
    for e, display in zip(entries, thinned):
        maps = {key: a for key in shown for _, a in _entries_with_map([e], key)}
        cortex = e.measures.cortex
        packed = pack(cortex, maps, steps, display, net_of(e.measures, display.ids), person_of.get(e.name))
        own = [key for key in MAIN_MAPS if key in shown]
        grown = [
            pack_stage(m.cortex, {key: a for key in own if (a := find(m.maps, key)) is not None}, steps, display.ids)
            for m in e.stages
        ]
        surfaces.append(
            {
                **packed.meta,
                "name": e.name,
                "hemi": cortex.hemi,
                "sided": cortex.origin != "simulation",
                "g": cortex.info.get("g"),
                "stages": [stage.meta for stage in grown],
            }
        )
        for k, stage in enumerate([packed, *grown]):  # base64 needs no escaping
            blocks.append({"id": f"{len(surfaces) - 1}" + (f"-{k - 1}" if k else ""), "data": Markup(stage.data)})
    maps_shown = [
        {
            "key": key,
            "label": what.label,
            "unit": what.unit,
            "signed": what.signed,
            "main": key in MAIN_MAPS,
            "limits": list(limits),
        }
        for key, (what, limits) in shown.items()
    ]
    config = {
        "surfaces": surfaces,
        "maps": maps_shown,
        "tables": {"sequential": colours.sequential().tolist(), "diverging": colours.diverging().tolist()},
        "missing": colours.NOT_MEASURED_COLOUR,
        "bare": colours.BARE_SURFACE_COLOUR,
    }
    return config, blocks


def _write_pictures(
    folder: Path, entries: Sequence[Entry], thinned: Sequence[Display], shown: ShownMaps
) -> list[dict[str, Any]]:
    """Write ``folder/KEY.png`` for the main maps and the gyral net; return them at half size for the page."""
    folder.mkdir(parents=True, exist_ok=True)
    which = _drawn_surface(entries)
    verts = {e.name: getattr(e.measures.cortex, which).verts for e in entries}
    drawn = {e.name: Surface(verts[e.name][d.ids], d.faces, e.name) for e, d in zip(entries, thinned)}
    ids = {e.name: d.ids for e, d in zip(entries, thinned)}
    pictures = []
    looks: VisibleFaces = {}
    with ThreadPoolExecutor(1) as writer:  # writes one picture while the next is drawn
        for key in (k for k in MAIN_MAPS if k in shown):
            what, limits = shown[key]
            rows = [
                Row(e.name, drawn[e.name], a[ids[e.name]], e.measures.cortex.hemi)
                for e, a in _entries_with_map(entries, key)
            ]
            image = figure(rows, what, limits, looks=looks)
            pictures.append(writer.submit(_saved_picture, folder / f"{safe_name(key)}.png", image, what.title, limits))
        if nets := [net_row(e.measures, e.name) for e in entries if e.measures.graph is not None]:
            title = "Net of gyral crests and its hinges"
            pictures.append(writer.submit(_saved_picture, folder / "gyral_net.png", net_figure(nets), title, None))
    return [picture.result() for picture in pictures]


def _write_hinge_pairs(
    folder: Path, hinges: Sequence[HingeComparison], named: Mapping[str, Measures]
) -> list[dict[str, Any]]:
    """Write ``folder/hinges-1.png`` and so on: pairs of hinges for each two groups whose surfaces have a graph."""
    pictures = []
    for k, found in enumerate(hinges, start=1):
        if chosen := clear_examples(found.matches, named):
            image = hinge_pairs(chosen, (found.one, found.other))
            title = f"Three-hinge patterns of {found.one}, and those of {found.other} with the most similar shape"
            pictures.append(_saved_picture(folder / f"hinges-{k}.png", image, title, None))
    return pictures


def _saved_picture(path: Path, image: Picture, title: str, limits: tuple[float, float] | None) -> dict[str, Any]:
    """Write a picture; return its entry for the page."""
    path.write_bytes(png_bytes(image))
    small = base64.b64encode(png_bytes(halved(image))).decode()
    return {"title": title, "file": f"{path.parent.name}/{path.name}", "data": small, "limits": limits}


def _histogram_charts(entries: Sequence[Entry], shown: ShownMaps) -> list[Markup]:
    areas = {e.name: vertex_areas(e.measures.cortex.pial.verts, e.measures.cortex.faces) for e in entries}
    found = []
    for key in (k for k in MAIN_MAPS if k in shown):
        what, _ = shown[key]
        series = [(e, a, areas[e.name]) for e, a in _entries_with_map(entries, key)]
        found.append(charts.histograms(series, what.label, what.unit))
    return [chart for chart in found if chart is not None]


def _growth_charts(entries: Sequence[Entry], growth: Sequence[GrowthCurve]) -> list[Markup]:
    found = []
    for key, of in DIMENSIONLESS_NUMBERS.items() if growth else ():
        curves = [(c.name, c.growth, c.numbers[key]) for c in growth]
        others = [(e, value) for e in entries if (value := of(e.measures)) is not None]
        found.append(charts.growth_chart(key, curves, others))
    return [chart for chart in found if chart is not None]


def _folding_law_chart(entries: Sequence[Entry], growth: Sequence[GrowthCurve]) -> Markup | None:
    terms = [(e, t) for e in entries if (t := e.folding) is not None]
    paths = [(c.name, [t for t in c.folding if t is not None]) for c in growth]
    return charts.folding_plot(terms, [(name, path) for name, path in paths if len(path) > 1])


def _thickness_ratio_chart(entries: Sequence[Entry]) -> Markup | None:
    """Distribution of gyral over cortical thickness at vertices where both are known."""
    series = []
    for e in entries:
        cortical, gyral = (find(e.measures.maps, key) for key in ("cortical_thickness", "gyral_thickness"))
        if cortical is not None and gyral is not None and np.isfinite(cortical).any():
            cortex = cortical > 0.5 * np.nanmedian(cortical)  # without the rim of an unlabelled medial wall
            ratio = np.divide(gyral, cortical, out=np.full(len(gyral), np.nan), where=cortex)
            areas = vertex_areas(e.measures.cortex.pial.verts, e.measures.cortex.faces)
            series.append((e, ratio, areas))
    return charts.histograms(series, "Gyral over cortical thickness", "")


def _thickness_scatter_chart(entries: Sequence[Entry], theory: Sequence[TheoryLine]) -> Markup | None:
    lines = [(t.slope, f"linear theory at a stiffness ratio of {t.mu_ratio:.3g}") for t in theory]
    return charts.thickness_plot([(e, e.cloud) for e in entries], lines)
