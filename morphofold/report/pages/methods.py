"""A methods paragraph for a paper, with references, from what a page shows and the scales that were used.

Its sentences are in ``templates/methods.txt``, with the references that they cite.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from markupsafe import Markup

from morphofold.analysis.measures import Measures
from morphofold.report.pages.templates import render

REFERENCES = "References, of which those are listed that the text names\n"
RESAMPLED = {"draft": "thinned", "fine": "finer"}  # by accuracy
MOST_VALUES_LISTED = 3  # values of a scale; of more, the least and the greatest


def methods_of(measures: Iterable[Measures], **more: Any) -> tuple[str, list[str]]:
    """How cortices were measured, as one paragraph, and the references that it cites; ``more`` goes to the template."""
    measures = list(measures)
    known = {name for m in measures for name in (*m.maps, *(k for k, v in m.scalars.items() if v is not None))}
    return paragraph(list(map(settings_of, measures)), known, **more)


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


def paragraph(settings: Sequence[Mapping[str, Any]], known: Iterable[str], **more: Any) -> tuple[str, list[str]]:
    """How white and pial surfaces were measured, as one paragraph, and the references that it cites.

    ``settings`` are parameters of measures with ``origin``, ``n_vertices``, ``annotation`` and ``annotation_from``.
    ``known`` are the maps and scalars that any surface has; methods of others are left out. ``more`` goes to the
    template.
    """
    names = set(known)
    masks = {str(s["cortex_mask"]) for s in settings if s.get("cortex_mask") and s["origin"] != "simulation"}
    resampled = [
        (RESAMPLED[s["accuracy"]], s["accuracy_vertices"])
        for s in settings
        if s.get("accuracy") in RESAMPLED and s["accuracy_vertices"] != s["n_vertices"]
    ]
    atlases = {(s["annotation"], s.get("annotation_from")) for s in settings if s.get("annotation")}
    text = render(
        "methods.txt",
        has=lambda *any_of: not names or not names.isdisjoint(any_of),
        values=lambda key: [s[key] for s in settings if s.get(key) is not None],
        listed=_listed,
        settings=settings,
        rules=sorted({mask.partition(", ")[0] if ", " in mask else "" for mask in masks}),
        resampled={how: [n for other, n in resampled if other == how] for how in RESAMPLED.values()},
        atlases=sorted((name.removesuffix(f".{template}"), template or "") for name, template in atlases),
        **more,
    )
    sentences, _, references = text.partition(REFERENCES)
    works = [line.split(" | ") for line in references.strip().splitlines()]
    return Markup(" ".join(sentences.split())), [work for name, work in works if name in sentences]


def _listed(values: Iterable[float], text: Callable[[float], str]) -> str:
    """``a``, ``a or b``, or ``a to z`` if there are more than three; the same text is given once."""
    texts = list(dict.fromkeys(text(value) for value in sorted(map(float, values))))
    return f"{texts[0]} to {texts[-1]}" if len(texts) > MOST_VALUES_LISTED else " or ".join(texts)
