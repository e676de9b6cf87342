"""A methods paragraph for a paper, with references, from what a page shows and the scales that were used.

Its sentences are in ``templates/methods.txt``.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from markupsafe import Markup

from morphofold.analysis.measures import Measures
from morphofold.report.pages.contents import Entry
from morphofold.report.pages.templates import render
from morphofold.words import number

RESAMPLED = {"draft": "thinned", "fine": "finer"}  # by accuracy
USUAL_VOXEL_MM = 1.25
MOST_VALUES_LISTED = 3  # values of a scale; of more, the least and the greatest


def methods(entries: Sequence[Entry], version: str, *, theory: bool, spins: int = 0) -> tuple[str, list[str]]:
    """The methods as one paragraph, with this version of morphofold, and the references that it cites.

    ``theory``: whether the page has a line of linear theory. ``spins``: rotations by which grown cortices were tested
    against the people that they grew from, 0 if none was.
    """
    grown = []
    for e in entries:
        info = {"material": "neo-hookean", **e.measures.cortex.info, "name": e.name}
        if e.measures.cortex.origin == "simulation" and None not in (info.get(key) for key in ("g", "law", "mu_ratio")):
            grown.append({**info, "g": float(info["g"]), "mu_ratio": float(info["mu_ratio"])})
    measures = [e.measures for e in entries]
    there = {name for m in measures for name in (*m.maps, *(k for k, v in m.scalars.items() if v is not None))}
    law = any(e.folding is not None for e in entries)
    return paragraph(
        [settings_of(m) for m in measures], there, version, grown=grown, law=law, theory=theory, spins=spins
    )


def settings_of(m: Measures) -> dict[str, Any]:
    """How a cortex was measured, as :func:`paragraph` needs it."""
    cortex = m.cortex
    return {
        **m.parameters,
        "origin": cortex.origin,
        "n_vertices": cortex.n_vertices,
        "annotation": cortex.regions.name if cortex.regions is not None and m.regions else None,
        "annotation_from": cortex.info.get("annotation_from"),
    }


def paragraph(
    settings: Sequence[Mapping[str, Any]], there: Iterable[str], version: str, **more: Any
) -> tuple[str, list[str]]:
    """How white and pial surfaces were measured, as one paragraph, and the references that it cites.

    ``settings`` are parameters of measures with ``origin``, ``n_vertices``, ``annotation`` and ``annotation_from``.
    ``there`` are the maps and scalars that any surface has; methods of others are left out. ``more`` goes to the
    template.
    """
    values = lambda key: [s[key] for s in settings if s.get(key) is not None]
    masks = {str(s["cortex_mask"]) for s in settings if s.get("cortex_mask") and s["origin"] != "simulation"}
    simulated = {origin == "simulation" for origin in values("origin")}
    resampled = []
    for accuracy, how in RESAMPLED.items():
        used = [s for s in settings if s.get("accuracy") == accuracy]
        if counts := {s["accuracy_vertices"] for s in used if s["accuracy_vertices"] != s["n_vertices"]}:
            resampled.append((how, _listed(counts, "{:,.0f}".format)))
    voxels = {s.get("local_gyrification_voxel_mm", USUAL_VOXEL_MM) for s in settings}
    names = {(s["annotation"], s.get("annotation_from")) for s in settings if s.get("annotation")}
    caps = values("cortical_thickness_cap_mm")
    text = render(
        "methods.txt",
        has=lambda *names, there=set(there): not there or not there.isdisjoint(names),
        version=version,
        both=simulated == {True, False},
        rules=sorted({mask.partition(", ")[0] if ", " in mask else "" for mask in masks}),
        resampled=resampled,
        voxels=_listed(voxels, "{:g}".format) if voxels - {USUAL_VOXEL_MM} else "",
        atlases=sorted((name.removesuffix(f".{template}"), template or "") for name, template in names),
        curvature=_listed(values("curvature_scale_mm"), number),
        width=_listed(values("graph_width_mm"), number),
        cap=_listed(caps, "{:g}".format),
        uncapped=len(caps) < len(settings),
        **more,
    )
    text = " ".join(text.split())
    works = (line.split(" | ") for line in render("references.txt").splitlines())
    return Markup(text), [work for name, work in works if name in text]


def _listed(values: Iterable[float], text: Any) -> str:
    """``a``, ``a or b``, or ``a to z`` if there are more than three; the same text is given once."""
    texts = list(dict.fromkeys(text(value) for value in sorted(map(float, values))))
    return f"{texts[0]} to {texts[-1]}" if len(texts) > MOST_VALUES_LISTED else " or ".join(texts)
