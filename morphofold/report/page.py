"""The HTML pages: values gathered here, laid out in ``templates/report.html``.

A page is one file that opens offline: styles, script, surfaces and charts are inlined, a content policy forbids
everything else, and every name that came from a file is escaped.
"""

from __future__ import annotations

import base64
import hashlib
import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import metadata, resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from markupsafe import Markup

from morphofold.analysis._mesh import vertex_areas
from morphofold.analysis.measures import SCALARS, Measures
from morphofold.report import colours, plots
from morphofold.report.figures import Row, figure, renderer, safe_name
from morphofold.report.pack import DISPLAY_VERTICES, pack
from morphofold.report.png import png_bytes
from morphofold.report.quantities import (
    HEADLINES,
    MAIN,
    Quantity,
    common_limits,
    find,
    quantity,
    scalar_words,
)

if TYPE_CHECKING:
    from morphofold.compare import Comparison

PACKAGES = ("morphofold", "numpy", "scipy", "trimesh", "nibabel", "networkx", "numba", "pyvista")
RATIO = "gyral_to_cortical_ratio"


@dataclass(frozen=True, eq=False)
class Entry:
    """One surface of a page: what it is called there and its colour in charts."""

    name: str
    measures: Measures
    colour: str
    marker: str = "circle"

    @property
    def kind(self) -> str:
        """One line about the surface, for below its name."""
        cortex = self.measures.cortex
        facts = [cortex.origin if cortex.origin != "files" else "", cortex.name, cortex.hemi]
        if "g" in cortex.info:
            facts.append(f"growth {plots.number(cortex.info['g'])}")
        return " · ".join(f for f in facts if f)


def analysis_report(
    measures: Sequence[Measures], path: str | Path, *, inputs: Sequence[Mapping[str, Any]] = ()
) -> Path:
    """Write the page of one analysis to ``path`` and its pictures to ``figures/`` beside it.

    ``inputs`` are rows with ``path`` and ``sha256``; without them the files the surfaces name are hashed.
    """
    from morphofold.compare import compare

    entries = _entries([(_own_name(m, measures), m) for m in measures])
    comparison = compare({e.name: e.measures for e in entries})
    subjects = sorted({m.cortex.name for m in measures})
    hemispheres = " and ".join({"lh": "left", "rh": "right"}[m.cortex.hemi] for m in measures)
    title = ", ".join(subjects)
    lede = f"The {hemispheres} hemisphere, measured from white and pial surface."
    return _write(Path(path), entries, comparison, "Analysis", title, lede, inputs, regions=True)


def comparison_report(
    comparison: Comparison, folder: str | Path, *, inputs: Sequence[Mapping[str, Any]] = ()
) -> Path:
    """Write ``folder/report.html`` and ``folder/figures/`` for a comparison."""
    entries = _entries(list(zip(comparison.names, comparison.measures)))
    bare = dict.fromkeys(n.removesuffix(f" {e.measures.cortex.hemi}") for n, e in zip(comparison.names, entries))
    title = " beside ".join(bare)
    lede = "Measured by the same code. Colours, bins and axes are shared by all surfaces."
    return _write(Path(folder) / "report.html", entries, comparison, "Comparison", title, lede, inputs)


def _own_name(m: Measures, among: Sequence[Measures]) -> str:
    same = [o for o in among if o.cortex.name == m.cortex.name]
    return m.cortex.name if len(same) == 1 else f"{m.cortex.name} {m.cortex.hemi}"


def _entries(named: Sequence[tuple[str, Measures]]) -> list[Entry]:
    palette, markers = colours.CATEGORICAL, plots.MARKERS
    return [Entry(n, m, palette[i % len(palette)], markers[i % len(markers)]) for i, (n, m) in enumerate(named)]


def _write(
    path: Path, entries: list[Entry], comparison: Comparison, kind: str, title: str, lede: str,
    inputs: Sequence[Mapping[str, Any]], regions: bool = False,
) -> Path:  # fmt: skip
    from morphofold.results import input_records

    shown = _shown(entries)
    pictures = _pictures(path.parent / "figures", entries, shown)
    script = resources.files("morphofold.report").joinpath("templates/viewer.js").read_text(encoding="utf-8")
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    viewer, blocks = _viewer(entries, shown)
    files = [f for e in entries for f in e.measures.cortex.files]
    page = plots.environment().get_template("report.html").render(
        kind=kind, title=title, lede=lede, entries=entries, number=plots.number, policy=f"'sha256-{digest}'",
        script=Markup(script), viewer=viewer, blocks=blocks, columns={1: 1, 2: 2, 4: 2}.get(len(entries), 3),
        headlines=_headlines(entries, comparison), verdict=_verdict(comparison), scalars=_scalars(comparison),
        maps=[what for what, _ in shown.values()],
        inflated=any(e.measures.cortex.inflated is not None for e in entries),
        charts=_charts(entries, shown), scatter=_scatter(entries, comparison), fits=_fits(entries, comparison),
        theory=comparison.theory, pictures=pictures, notes=_notes(entries), remarks=_remarks(entries, viewer),
        regions=_regions(entries) if regions else [], parameters=_parameters(entries), facts=_facts(entries),
        inputs=list(inputs) or input_records(dict.fromkeys(files)), versions=_versions(), renderer=renderer(),
    )  # fmt: skip
    path.write_text(page, encoding="utf-8")
    return path


def _shown(entries: Sequence[Entry]) -> dict[str, tuple[Quantity, tuple[float, float]]]:
    """The maps a page shows, the main ones first, with the limits all its surfaces share."""
    others = {quantity(n).key for e in entries for n in e.measures.maps} - set(MAIN)
    shown = {}
    for key in (*MAIN, *sorted(others)):
        arrays = [a for e in entries if (a := find(e.measures.maps, key)) is not None and np.isfinite(a).any()]
        if arrays:
            what = quantity(key, arrays)
            shown[key] = (what, common_limits(what, arrays))
    return shown


def _viewer(entries: Sequence[Entry], shown: Mapping[str, Any]) -> tuple[dict[str, Any], list[Markup]]:
    surfaces, blocks = [], []
    for e in entries:
        maps = {key: a for key in shown if (a := find(e.measures.maps, key)) is not None}
        packed = pack(e.measures.cortex, maps)
        surfaces.append({**packed.meta, "name": e.name, "hemi": e.measures.cortex.hemi})
        blocks.append(Markup(packed.data))       # base64: nothing in it to escape
    config = {
        "surfaces": surfaces,
        "maps": [
            {"key": k, "label": q.label, "unit": q.unit, "signed": q.signed, "limits": list(limits)}
            for k, (q, limits) in shown.items()
        ],
        "tables": {"sequential": colours.sequential().tolist(), "diverging": colours.diverging().tolist()},
        "missing": colours.NOT_MEASURED,
        "bare": colours.BARE,
    }
    return config, blocks


def _pictures(folder: Path, entries: Sequence[Entry], shown: Mapping[str, Any]) -> list[dict[str, Any]]:
    folder.mkdir(parents=True, exist_ok=True)
    pictures = []
    for key in (k for k in MAIN if k in shown):
        what, limits = shown[key]
        rows = [
            Row(e.name, e.measures.cortex.pial, a, e.measures.cortex.hemi)
            for e in entries
            if (a := find(e.measures.maps, key)) is not None
        ]
        image = figure(rows, what, limits)
        name = f"{safe_name(key)}.png"
        (folder / name).write_bytes(png_bytes(image))
        small = base64.b64encode(png_bytes(_halved(image))).decode()
        pictures.append({"title": what.title, "file": f"figures/{name}", "data": small, "limits": limits})
    return pictures


def _halved(image: np.ndarray) -> np.ndarray:
    """Half the size, each channel in steps of four: a third of the bytes, no visible loss at this size."""
    even = image[: image.shape[0] // 2 * 2, : image.shape[1] // 2 * 2].astype(np.uint16)
    mean = even.reshape(even.shape[0] // 2, 2, -1, 2, 3).sum(axis=(1, 3)) / 4
    return np.minimum(np.round(mean / 4) * 4, 255).astype(np.uint8)


def _headlines(entries: Sequence[Entry], comparison: Comparison) -> list[dict[str, Any]]:
    values = {row["measure"]: row for row in comparison.table}
    rows = []
    for key in HEADLINES:
        label, unit = scalar_words(key)
        if any(values[key][e.name] is not None for e in entries):
            rows.append({"label": label, "unit": unit, "values": [values[key][e.name] for e in entries]})
    return rows


def _verdict(comparison: Comparison) -> list[str]:
    values = {row["measure"]: row for row in comparison.table}
    known = lambda key: [(n, values[key][n]) for n in comparison.names if values[key][n] is not None]
    said = []
    if ratios := known(RATIO):
        listed = "; ".join(f"{plots.number(v)} in {n}" for n, v in ratios)
        theory = ", ".join(f"{plots.number(t.slope)} at a stiffness ratio of {t.mu_ratio:.3g}" for t in comparison.theory)
        said.append(
            f"Width of a gyrus over thickness of the cortex: {listed}. "
            f"Linear wrinkling theory puts the wavelength, gyrus and sulcus together, at {theory}."
        )
    return said


def _scalars(comparison: Comparison) -> list[dict[str, Any]]:
    rows = []
    for row in comparison.table:
        label, unit = scalar_words(row["measure"])
        values = [row[n] for n in comparison.names]
        if all(v is None for v in values):
            continue                                        # "What was left out" says why
        rows.append({"key": row["measure"], "label": label, "unit": unit, "values": values})
    return rows


def _charts(entries: Sequence[Entry], shown: Mapping[str, Any]) -> list[Markup]:
    areas = [vertex_areas(e.measures.cortex.pial.verts, e.measures.cortex.faces) for e in entries]
    charts = []
    for key in (k for k in MAIN if k in shown):
        what, limits = shown[key]
        series = [
            (e.name, a, area, e.colour)
            for e, area in zip(entries, areas)
            if (a := find(e.measures.maps, key)) is not None
        ]
        chart = plots.histograms(series, limits, what.label, what.unit)
        if chart is not None:
            charts.append(chart)
    return charts


def _scatter(entries: Sequence[Entry], comparison: Comparison) -> Markup | None:
    point = lambda p: {"cortical": p.cortical, "gyral": p.gyral, "label": p.label, "low": p.low, "high": p.high}
    clouds = [
        {
            "name": e.name, "colour": e.colour, "marker": e.marker, "points": [point(p) for p in c.points], "bins": [point(p) for p in c.bins],
            "fit": {"slope": c.fit.slope, "intercept": c.fit.intercept} if c.fit else None,
        }
        for e, c in zip(entries, comparison.clouds)
    ]  # fmt: skip
    lines = [
        {"slope": t.slope, "label": f"2π t (μ ratio / 3)^⅓ at μ ratio {t.mu_ratio:.3g}"}
        for t in comparison.theory
    ]
    return plots.thickness_plot(clouds, lines)


def _fits(entries: Sequence[Entry], comparison: Comparison) -> list[dict[str, Any]]:
    words = {"region": "regions", "crest": "crests", "whole": "whole surface"}
    return [
        {"entry": e, "points": f"{len(c.points)} {words[c.kind]}" if c.kind != "whole" else words["whole"], "fit": c.fit}
        for e, c in zip(entries, comparison.clouds)
        if c.points
    ]


def _notes(entries: Sequence[Entry]) -> list[dict[str, str]]:
    """What could not be had and why, each reason once with the surfaces it concerns."""
    found: dict[tuple[str, str], list[str]] = {}
    for e in entries:
        for key, why in e.measures.notes.items():
            found.setdefault((key, why), []).append(e.name)
    everyone = [e.name for e in entries]
    unexplained = [k for k in SCALARS if not any(e.measures.scalars.get(k) is not None or k in e.measures.notes for e in entries)]
    if unexplained:
        words = ", ".join(scalar_words(k)[0][:1].lower() + scalar_words(k)[0][1:] for k in unexplained)
        found["Not measured", f"{words}: not given, and no reason recorded."] = everyone
    return [
        {"label": scalar_words(key)[0], "why": why, "who": "" if who == everyone else ", ".join(who)}
        for (key, why), who in sorted(found.items())
    ]


def _remarks(entries: Sequence[Entry], viewer: Mapping[str, Any]) -> list[str]:
    """What a reader should know about how the page shows the surfaces."""
    remarks = []
    for e, meta in zip(entries, viewer["surfaces"]):
        if meta["thinned"]:
            remarks.append(
                f"{e.name} is drawn with {plots.number(meta['vertices'])} of its {plots.number(meta['all_vertices'])} "
                f"vertices (at most about {plots.number(DISPLAY_VERTICES)} here); every number is from the full surface."
            )
        cortex = e.measures.cortex
        if cortex.portion != 1:
            remarks.append(
                f"{e.name}: {plots.number(cortex.portion)} of the closed surface was simulated, the rest is its mirror image; "
                "counts and areas are those of the whole."
            )
        if cortex.cortex is not None and not cortex.cortex.all():
            remarks.append(
                f"{e.name}: {plots.number(int((~cortex.cortex).sum()))} of {plots.number(cortex.n_vertices)} vertices are not "
                "cortex (medial wall)."
            )
    return remarks


def _regions(entries: Sequence[Entry]) -> list[dict[str, Any]]:
    keys = ("n_vertices", "area_mm2", "cortical_thickness_mm", "cortical_thickness_sd_mm", "gyral_thickness_mm")
    return [
        {
            "entry": e,
            "columns": [scalar_words(k) for k in keys],
            "rows": [{"region": r.get("region", ""), "values": [r.get(k) for k in keys]} for r in e.measures.regions],
        }
        for e in entries
        if e.measures.regions
    ]


def _parameters(entries: Sequence[Entry]) -> list[dict[str, Any]]:
    keys = list(dict.fromkeys(k for e in entries for k in e.measures.parameters))
    return [{"key": k, "values": [_word(e.measures.parameters.get(k)) for e in entries]} for k in keys]


def _facts(entries: Sequence[Entry]) -> list[dict[str, Any]]:
    facts = [{"origin": e.measures.cortex.origin, "portion": e.measures.cortex.portion, **e.measures.cortex.info} for e in entries]
    keys = list(dict.fromkeys(k for f in facts for k in f))
    return [{"key": k, "values": [_word(f.get(k)) for f in facts]} for k in keys]


def _word(value: Any) -> str:
    if isinstance(value, str) or value is None:
        return value or "–"
    if isinstance(value, int | float | np.number) and not isinstance(value, bool):
        return plots.number(value.item() if isinstance(value, np.generic) else value, 4)
    return str(value)


def _versions() -> list[tuple[str, str]]:
    from morphofold import __version__

    def version(name: str) -> str:
        try:
            return metadata.version(name)
        except metadata.PackageNotFoundError:
            return "–"

    found = [(n, __version__ if n == "morphofold" else version(n)) for n in PACKAGES]
    return [*found, ("Python", platform.python_version())]
