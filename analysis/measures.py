"""All measures of one cortex: ``measure(cortex)``, the same code for simulated and FreeSurfer surfaces."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from morphofold.surface import Cortex, PerVertex

SCALARS = (
    "n_vertices", "euler_characteristic", "area_pial_mm2", "area_white_mm2", "gyrification_index",
    "folding_index", "intrinsic_curvature_index", "mean_cortical_thickness_mm", "median_gyral_thickness_mm",
    "mean_sulcal_depth_mm", "wavelength_mm", "n_hinges", "n_hinges_3", "n_hinges_4", "n_crests",
    "crest_length_mm", "gyral_to_cortical_slope", "gyral_to_cortical_r",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Measures:
    """What the measuring room says of one cortex.

    ``scalars`` holds every name of ``SCALARS`` (None where a value cannot be had; then ``notes`` says why
    under the same name). ``maps`` are per-vertex arrays (N,), NaN where undefined, convex positive.
    ``regions``, ``crests``, ``hinges`` and ``arms`` are tables: one dict per row. ``parameters`` are the
    scales and options used.
    """

    cortex: Cortex
    scalars: Mapping[str, float | int | None]
    maps: Mapping[str, PerVertex] = field(repr=False)
    regions: list[dict[str, Any]] = field(default_factory=list, repr=False)
    crests: list[dict[str, Any]] = field(default_factory=list, repr=False)
    hinges: list[dict[str, Any]] = field(default_factory=list, repr=False)
    arms: list[dict[str, Any]] = field(default_factory=list, repr=False)
    parameters: Mapping[str, Any] = field(default_factory=dict, repr=False)
    notes: Mapping[str, str] = field(default_factory=dict, repr=False)
