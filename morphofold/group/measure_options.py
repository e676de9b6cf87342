"""Measures a surface with the options of a group; its stages are timed and logged."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from morphofold.analysis.measures import Measures
    from morphofold.surface import Cortex
    from morphofold.timing import Stages


def measure_as_asked(cortex: Cortex, options: Mapping[str, Any], clock: Stages, say: Callable[[str], None]) -> Measures:
    """Measure with ``curvature_scale_mm``, ``gyral_width_mm``, ``thickness_cap_mm`` [mm], ``accuracy`` and ``repair``,
    if ``options`` have them; ``common_curvature_scale_mm`` is used if the mesh is fine and large enough for it."""
    from morphofold.analysis.measuring import measure

    scale, common = options.get("curvature_scale_mm"), options.get("common_curvature_scale_mm")
    if common is not None:
        scale = curvature_scale(cortex, common)

    def show(share: float, what: str) -> None:
        if share < 1:
            say(what)

    return measure(cortex, **{**keywords_of(options), "curvature_scale": scale}, progress=show, clock=clock)


def keywords_of(options: Mapping[str, Any]) -> dict[str, Any]:
    """Recorded options as keywords of :func:`morphofold.analysis.measure`."""
    return {
        "curvature_scale": options.get("curvature_scale_mm"),
        "gyral_width": options.get("gyral_width_mm"),
        "thickness_cap": options.get("thickness_cap_mm"),
        "accuracy": options.get("accuracy", "standard"),
        "repair": options.get("repair", True),
        "only": options.get("only"),
    }


def curvature_scale(cortex: Cortex, common: float) -> float | None:
    """The common curvature scale [mm], or None (the mesh's own scale) if the mesh is too coarse or too small for it."""
    from morphofold.analysis.curvatures import scale_of_curvature

    if scale_of_curvature(cortex)[0] > common:
        return None
    try:
        return scale_of_curvature(cortex, common)[0]
    except ValueError:
        return None
