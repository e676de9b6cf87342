"""Notes on a comparison: what was left out of it, and which options differ between surfaces."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from morphofold.analysis.measures import Measures
from morphofold.comparison.thickness import Cloud
from morphofold.words import listed, number


def _text_in_mm(length: Any) -> str:
    return f"{number(float(length), 2)} mm"


#: parameters that make numbers differ: text of a value, and the sentence with all values and their surfaces
PARAMETER_CAUTIONS: Mapping[str, tuple[Callable[[Any], str], str]] = {
    "curvature_scale_mm": (
        _text_in_mm,
        "Curvature was taken within {}; compare H, folding indices and the sharpness of hinges with care.",
    ),
    "cortical_thickness_cap_mm": (
        lambda mm: f"at {mm:g} mm" if mm else "nowhere",
        "Cortical thickness was capped {}; compare thick cortex with care.",
    ),
    "graph_width_mm": (
        _text_in_mm,
        "Gyral graphs are scaled by a crown width of {}; compare their hinges per square of that width.",
    ),
    "accuracy": (str, "Accuracy was {}; hinges and local gyrification of coarse meshes depend on it."),
    "cortex_mask": (
        lambda mask: f"by '{mask}'",
        "Cortex was marked {}; where nothing marks the medial wall, means may count it as cortex.",
    ),
}


def cautions(named: Mapping[str, Measures]) -> list[str]:
    """A sentence for each scale or option that differs between surfaces and makes their numbers differ."""
    sentences = []
    for key, (words, sentence) in PARAMETER_CAUTIONS.items():
        found: dict[str, list[str]] = {}
        for name, m in named.items():
            if key in m.parameters:
                found.setdefault(words(m.parameters[key]), []).append(name)
        if len(found) > 1:
            sentences.append(sentence.format(listed([f"{value} on {listed(names)}" for value, names in found.items()])))
    return sentences


def notes(named: Mapping[str, Measures]) -> list[str]:
    """Numbers that were left out, and why."""
    return [
        f"{name}: {what} ({why})"
        for name, m in named.items()
        for what, why in sorted(m.notes.items())
        if m.scalars.get(what) is None
    ]


def plot_notes(named: Mapping[str, Measures], clouds: Sequence[Cloud]) -> list[str]:
    """Notes on the points of each surface in the plot of gyral against cortical thickness."""
    plotted = list(zip(named, named.values(), clouds))
    sentences = [
        f"{name}: not in the plot of gyral against cortical thickness, because one of the two is missing."
        for name, _, cloud in plotted
        if not cloud.points
    ]
    if len(kinds := {cloud.kind for cloud in clouds} & {"region", "crest"}) == 2:
        of = (f"{listed([n for n, _, c in plotted if c.kind == kind])} are {kind}s" for kind in sorted(kinds))
        sentences.append(f"Points of {' and of '.join(of)}: compare their lines, not the points.")
    if mirrored := [name for name, m in named.items() if m.cortex.portion != 1]:
        sentences.append(
            f"{listed(mirrored)}: a part was simulated and the rest is its mirror image. Intervals and p count the "
            "image as further evidence, so intervals are too narrow and p too small."
        )
    if whole := [name for name, _, cloud in plotted if cloud.kind == "whole" and cloud.points]:
        sentences.append(
            f"{listed(whole)}: no regions, so one point (median gyral, mean cortical thickness) and bins of vertices "
            "represent the surface."
        )
    return sentences
