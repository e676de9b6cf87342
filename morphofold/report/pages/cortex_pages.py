"""The HTML pages of an analysis and of a comparison: contents from here, layout and words in ``templates/report.html``.

In go measures or a comparison, out come ``report.html`` and the pictures in ``figures/`` beside it.
A page is one file that opens offline. Styles, script, surfaces and charts are inlined, a content policy
forbids everything else, and every name from a file is escaped.
"""

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from morphofold.analysis.measures_result import Measures
from morphofold.comparison import Comparison, PersonComparison, compare
from morphofold.comparison.person.fold_heights import FOLD_DEGREES
from morphofold.comparison.person.grown_regions import REGION_MEASURES
from morphofold.comparison.side_by_side import cautions, dimensionless_numbers, matching_growth, plot_notes
from morphofold.digests_and_json import records_as_read
from morphofold.forecasts.cost_record import PAGE_STAGE, called
from morphofold.frozen_arrays import Array
from morphofold.geometry import vertex_areas
from morphofold.progress_callbacks import Progress, logged
from morphofold.quantities import HEADLINE_SCALARS, MAIN_MAPS, RELIEF, SAME_SIDE, find, quantity, scalar_words
from morphofold.report.pages import page_entries as contents
from morphofold.report.pages.page_entries import Entries, Entry, entries_of
from morphofold.report.pages.page_writer import Pictures, methods_of, write_page, write_picture
from morphofold.report.pages.viewer_data import (
    VIEWER_SCRIPTS,
    ShownMaps,
    entries_with_map,
    shown_maps,
    thinned,
    viewer_data,
)
from morphofold.report.pictures.gyral_net import clear_examples, hinge_pairs, net_figure, net_row
from morphofold.report.pictures.pixel_canvas import safe_name
from morphofold.report.pictures.surfaces import Row, figure
from morphofold.report.plots import charts
from morphofold.surface import Surface
from morphofold.threads import run_parallel
from morphofold.timing import Stages

CHARTED_REGION_MEASURES = ("cortical_thickness_mm", "gyral_thickness_mm")
MOST_CHARTED_REGIONS = 100  # more have no names that could be read
SMOOTH_COLOUR = "#8a8f96"
VERDICT_WORDS = {
    "above control": "more than unfolding left",
    "deepened": "no more than deepened sulci",
    "above spins": "more than by chance",
}
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
    named = {name if names.count(name) == 1 else f"{name} {m.cortex.hemi}": m for name, m in zip(names, measures)}
    comparison = replace(compare(named), stages={next(iter(named)): tuple(stages)}, cautions=tuple(cautions(named)))
    title = ", ".join(dict.fromkeys(names))
    return _write_page(Path(path), comparison, inputs, kind="Analysis", title=title, failed=failed, clock=clock)


def comparison_report(
    comparison: Comparison, folder: str | Path, *, inputs: InputRecords = (), progress: Progress = logged
) -> Path:
    """Write ``folder/report.html`` and ``folder/figures/`` of a comparison; ``progress`` gets share and step."""
    title = ", ".join(dict.fromkeys(name.removesuffix(f" {m.cortex.hemi}") for name, m in comparison.named.items()))
    return _write_page(Path(folder) / "report.html", comparison, inputs, progress, kind="Comparison", title=title)


def _write_page(
    path: Path, comparison: Comparison, inputs: InputRecords, progress: Progress = logged, **template_values: Any
) -> Path:
    """Write a page and its pictures; ``template_values`` go to the template."""
    figures_folder = path.parent / "figures"
    figures_folder.mkdir(parents=True, exist_ok=True)
    progress(0.0, "thinning surfaces")
    panels = run_parallel(*(partial(thinned, e) for e in with_smooth_bodies(entries_of(comparison), comparison.people)))
    entries, maps = [entry for entry in panels if entry.name in comparison.names], shown_maps(panels)
    main_maps = {key: maps[key] for key in MAIN_MAPS if key in maps}
    progress(0.15, "drawing pictures")
    pictures, (viewer_config, packed_blocks), pair_pictures, histograms = run_parallel(
        lambda: _write_pictures(figures_folder, entries, main_maps),
        lambda: viewer_data(panels, maps),
        lambda: _write_hinge_pairs(figures_folder, comparison),
        lambda: [_histograms(entries_with_map(entries, key), w.label, w.unit) for key, w in main_maps.items()],
    )
    progress(0.8, "drawing charts")
    return write_page(
        path,
        "report.html",
        VIEWER_SCRIPTS,
        **template_values,
        **_charts(entries, comparison),
        comparison=comparison,
        entries=entries,
        panels=panels,
        drawn=_drawn_surface(panels),
        viewer=viewer_config,
        blocks=packed_blocks,
        pictures=pictures,
        pairs=pair_pictures,
        histograms=histograms,
        notes=contents,
        called=called,
        matching_growth=matching_growth,
        verdicts=VERDICT_WORDS,
        fold_degrees=FOLD_DEGREES,
        headlines=HEADLINE_SCALARS,
        hemi_colours={hemi: colour for hemi, (colour, _) in charts.HEMI_STYLE.items()},
        plot_notes=plot_notes(comparison.named, comparison.clouds),
        people=person_parts(comparison.people, entries, figures_folder),
        methods=methods_of(comparison.measures, entries=entries, comparison=comparison),
        inputs=inputs or records_as_read([entry.cortex for entry in entries]),
    )


def _drawn_surface(entries: Entries) -> str:
    """The surface that a page shows first, and in pictures: inflated, where sulci are seen, if every surface has it."""
    return "inflated" if all(entry.cortex.inflated is not None and not entry.stages for entry in entries) else "pial"


# pictures ----------------------------------------------------------------------------------------------------


def _write_pictures(folder: Path, entries: Entries, maps: ShownMaps) -> Pictures:
    """Write ``folder/KEY.png`` for maps and the gyral net; return them for the page."""
    surface_name, pictures = _drawn_surface(entries), []
    surfaces = {e: Surface(getattr(e.cortex, surface_name).verts[e.display.ids], e.display.faces) for e in entries}
    with ThreadPoolExecutor(1) as writer:  # writes one picture while the next is drawn
        for key, measure in maps.items():
            surface_rows = [
                Row(entry.name, surfaces[entry], map_values[entry.display.ids], entry.cortex.hemi)
                for entry, map_values in entries_with_map(entries, key)
            ]
            image, picture_file = figure(surface_rows, measure, measure.limits), folder / f"{safe_name(key)}.png"
            pictures.append(writer.submit(write_picture, picture_file, image, measure.title, limits=measure.limits))
        if net_rows := [net_row(entry.measures, entry.name) for entry in entries if entry.measures.graph is not None]:
            image, title = net_figure(net_rows), "Net of gyral crests and its hinges"
            pictures.append(writer.submit(write_picture, folder / "gyral_net.png", image, title))
    return [pending.result() for pending in pictures]


def _write_hinge_pairs(folder: Path, comparison: Comparison) -> Pictures:
    """Write ``folder/hinges-1.png`` and so on: pairs of hinges for each two groups whose surfaces have a graph."""
    pictures = []
    for k, groups in enumerate(comparison.hinges, start=1):
        if example_pairs := clear_examples(groups.matches, comparison.named):
            image = hinge_pairs(example_pairs, (groups.one, groups.other))
            title = f"Three-hinge patterns of {groups.one}, and those of {groups.other} with the most similar shape"
            pictures.append(write_picture(folder / f"hinges-{k}.png", image, title))
    return pictures


# charts ------------------------------------------------------------------------------------------------------


def _histograms(maps: Sequence[tuple[Entry, Array]], label: str, unit: str) -> Markup | None:
    """Distributions of a map over the pial area of each surface."""
    series = [(entry, values, vertex_areas(entry.cortex.pial.verts, entry.cortex.faces)) for entry, values in maps]
    return charts.histograms(series, label, unit)


def _charts(entries: Entries, comparison: Comparison) -> dict[str, Any]:
    """The other charts, by their names in the template."""
    folding_terms = [(entry, entry.folding_terms) for entry in entries if entry.folding_terms is not None]
    growth_paths = [(run.name, [terms for terms in run.folding if terms is not None]) for run in comparison.growth]
    theory_lines = [(t.slope, f"linear theory at a stiffness ratio of {t.mu_ratio:.3g}") for t in comparison.theory]
    numbers, growth_charts = [(e, dimensionless_numbers(e.measures)) for e in entries if comparison.growth], []
    for key in comparison.growth[0].numbers if comparison.growth else ():
        curves = [(run.name, run.growth, run.numbers[key]) for run in comparison.growth]
        other_values = [(entry, value) for entry, number_of in numbers if (value := number_of[key]) is not None]
        growth_charts.append(charts.growth_chart(key, curves, other_values))
    return {
        "scatter": charts.thickness_plot([(entry, entry.cloud) for entry in entries], theory_lines),
        "ratio": _thickness_ratio_chart(entries),
        "region_charts": _region_charts(entries),
        "growth_charts": growth_charts,
        "law": charts.folding_plot(folding_terms, [(name, path) for name, path in growth_paths if len(path) > 1]),
    }


def _region_charts(entries: Entries) -> list[Markup]:
    """Measures of the regions of one subject, left and right in one chart; none where regions are few or many."""
    rows = [row for entry in entries for row in entry.measures.regions]
    n_regions = len({row["region"] for row in rows})
    sides = [entry.cortex.hemi for entry in entries]
    is_one_subject = len({entry.cortex.name for entry in entries}) == 1 and len(sides) == len(set(sides))
    if not is_one_subject or n_regions > MOST_CHARTED_REGIONS:
        return []
    charts_of_measures = (charts.region_dots(rows, key, *scalar_words(key)) for key in CHARTED_REGION_MEASURES)
    return [chart for chart in charts_of_measures if chart is not None]


def _thickness_ratio_chart(entries: Entries) -> Markup | None:
    """Distribution of gyral over cortical thickness at vertices where both are known."""
    series = []
    for entry in entries:
        cortical, gyral = (find(entry.measures.maps, key) for key in ("cortical_thickness", "gyral_thickness"))
        if cortical is not None and gyral is not None and np.isfinite(cortical).any():
            is_cortex = cortical > 0.5 * np.nanmedian(cortical)  # without the rim of an unlabelled medial wall
            series.append((entry, np.divide(gyral, cortical, out=np.full(len(gyral), np.nan), where=is_cortex)))
    return _histograms(series, "Gyral over cortical thickness", "")


# people ------------------------------------------------------------------------------------------------------


def with_smooth_bodies(entries: Entries, people: Sequence[PersonComparison]) -> list[Entry]:
    """The panels of the viewer: entries with heights and the person on whose sphere they have points, and the smooth
    body before the first cortex that grew from it."""
    body_of = {who: (p, body) for p in people for who, body in ((p.person, p.bodies.person), (p.grown, p.bodies.grown))}
    first_pairs = {(pair.person, pair.level): pair for pair in reversed(people)}
    pair_of, many_levels = {pair.grown: pair for pair in first_pairs.values()}, len({pair.level for pair in people}) > 1
    panels = []
    for entry in entries:
        if pair := pair_of.get(entry.name):
            body_name = f"smooth body of {pair.person}" + (f", level {pair.level:g}" if many_levels else "")
            smooth_body = pair.bodies.controls["smooth"]
            smooth_body = replace(smooth_body, cortex=replace(smooth_body.cortex, name=body_name))
            panels.append(Entry(body_name, SMOOTH_COLOUR, "diamond", "", smooth_body, person=pair.person))
        if entry.name in body_of:
            pair, body = body_of[entry.name]
            own_map = {SAME_SIDE: pair.same_side} if entry.name == pair.grown else {}
            measures = replace(body.measures, maps={**body.measures.maps, **own_map})
            entry = replace(entry, measures=measures, person=pair.person)
        panels.append(entry)
    return panels


def person_parts(people: Sequence[PersonComparison], entries: Entries, folder: Path) -> list[tuple[Any, ...]]:
    """Each pair with the entries of both, charts of its regions, and its picture ``folder/person-1.png`` and so on."""
    entry_by_name = {entry.name: entry for entry in entries}
    parts = []
    for k, pair in enumerate(people, start=1):
        person, grown, bodies = entry_by_name[pair.person], entry_by_name[pair.grown], pair.bodies
        plots = [charts.region_plot(pair.regions, key, *scalar_words(key), person, grown) for key in REGION_MEASURES]
        labelled_bodies = (
            (pair.person, bodies.person.measures, 1.0),
            ("smooth body before growth", bodies.controls["smooth"], 1.0),
            (pair.grown, bodies.grown.measures, pair.scale),  # to a hull of equal area
        )
        surface_rows = [
            Row(label, Surface(size_factor * body.cortex.pial.verts, body.cortex.faces), body.maps[RELIEF], pair.hemi)
            for label, body, size_factor in labelled_bodies
        ]
        title = f"{pair.person}, the smooth body and {pair.grown}, four views each"
        picture_entry = write_picture(folder / f"person-{k}.png", figure(surface_rows, quantity(RELIEF)), title)
        parts.append((pair, person, grown, plots, picture_entry))
    return parts
