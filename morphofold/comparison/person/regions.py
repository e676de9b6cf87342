"""Numbers of the regions of a person, of the cortex that grew from it, and of the smooth body between them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import rankdata

from morphofold.analysis.graph.hinges import counts
from morphofold.analysis.measures import Measures
from morphofold.analysis.multiple_tests import holm
from morphofold.arrays import Array, Bools, Ints
from morphofold.comparison.person.agreement import Agreement, Statistic, best_controls
from morphofold.comparison.person.bodies import Bodies
from morphofold.geometry import vertex_areas
from morphofold.mesh_quality.checks import is_no_cortex
from morphofold.provenance import json_value
from morphofold.quantities import find

LEAST_REGIONS = 5  # for a correlation
LEAST_COVERED_SHARE = 0.5  # of the points of a region that must be cortex after a spin


class Ratio(NamedTuple):
    """A number of a region: the sum of ``over`` (N,) in it over the sum of ``under`` (N,)."""

    over: Array
    under: Array


class Median(NamedTuple):
    """A number of a region: the median of ``values`` (N,) in it, NaN where there is none."""

    values: Array


Fields = Mapping[str, Ratio | Median]


#: columns of a table of regions
REGION_MEASURES = (
    "gyrification_index",
    "sulcal_depth_mm",
    "gyral_thickness_mm",
    "cortical_thickness_mm",
    "hinges_per_cm2",
    "area_expansion",
)
#: those that the smooth body has, too, and its map of each
SMOOTH_MAPS = {"gyrification_index": "local_gyrification_index", "sulcal_depth_mm": "sulcal_depth"}
#: map that a body was given -> measure of regions that it has from it
MEASURES_OF_GIVEN_MAPS = {"thickness_map": "cortical_thickness_mm", "growth_map": "area_expansion"}


@dataclass(frozen=True, eq=False)
class RegionNumbers:
    """Numbers of R regions in a person, the smooth and the grown body.

    Attributes
    ----------
    names : tuple of str
    labels : (N,) int64
        Regions of the person's vertices, -1 off the cortex and where there is none.
    person, smooth, grown : (K, R) float64
        The :data:`REGION_MEASURES` of each; NaN where a body does not have one.
    fields : (Fields, Fields, Fields)
        Of the grown, the smooth and the deepened smooth body.
    """

    names: tuple[str, ...]
    labels: Ints
    person: Array
    smooth: Array
    grown: Array
    fields: tuple[Fields, Fields, Fields]


def mean_field(values: Array, weights: Array) -> Ratio:
    """The weighted mean of values (N,) over the vertices that have one."""
    known = np.isfinite(values)
    return Ratio(np.where(known, values, 0.0) * weights, known * weights)


def region_fields(m: Measures, smooth_area: Array, cortex: Bools, scale: float) -> Fields:
    """The fields of a measured cortex for which it has maps.

    Parameters
    ----------
    m : Measures
    smooth_area : (N,) float64
        Area of the smooth body at its vertices.
    cortex : (N,) bool
    scale : float
        Factor of its lengths.

    Returns
    -------
    dict
        ``gyrification_index`` and ``sulcal_depth_mm`` are means over pial area, ``cortical_thickness_mm`` is one over
        vertices, as in the table of regions; ``gyral_thickness_mm`` is the median over vertices. ``hinges_per_cm2``
        counts hinges without doubtful ones per area midway between white and pial; ``area_expansion`` is this area over
        that of the smooth body, 1 for the whole cortex.
    """
    white, pial = (vertex_areas(s.verts, s.faces) * cortex for s in (m.cortex.white, m.cortex.pial))
    middle = 0.5 * scale**2 * (white + pial)
    flat = smooth_area * cortex
    fields: dict[str, Ratio | Median] = {"area_expansion": Ratio(middle / middle.sum(), flat / flat.sum())}
    for key, name, factor, weights in (
        ("gyrification_index", "local_gyrification_index", 1.0, pial),
        ("sulcal_depth_mm", "sulcal_depth", scale, pial),
        ("cortical_thickness_mm", "cortical_thickness", scale, cortex.astype(np.float64)),
    ):
        if (values := find(m.maps, name)) is not None:
            fields[key] = mean_field(factor * values, weights)
    if (widths := find(m.maps, "gyral_thickness")) is not None:
        fields["gyral_thickness_mm"] = Median(np.where(cortex, scale * widths, np.nan))
    if m.graph is not None or m.hinges:
        vertices = np.array([row["vertex"] for row in m.hinges if counts(row)], dtype=np.int64)
        hinges = np.bincount(vertices, minlength=len(cortex)).astype(np.float64)
        fields["hinges_per_cm2"] = Ratio(100 * hinges * cortex, middle)
    return fields


def region_numbers(labels: Ints, count: int, fields: Fields, keys: Sequence[str] = REGION_MEASURES) -> Array:
    """Numbers (K, count) of regions by their labels (N,), -1 for none; NaN for a field or a region that is empty."""
    inside = labels >= 0
    at = labels[inside]
    numbers = np.full((len(keys), count), np.nan)
    for row, key in zip(numbers, keys):
        field = fields.get(key)
        if isinstance(field, Ratio):
            over, under = (np.bincount(at, part[inside], count) for part in field)
            np.divide(over, under, out=row, where=under > 0)
        elif isinstance(field, Median):
            row[:] = _medians(labels, count, field.values)
    return numbers


def _medians(labels: Ints, count: int, values: Array) -> Array:
    known = np.isfinite(values) & (labels >= 0)
    order = np.argsort(labels[known].astype(np.int16), kind="stable")  # by radix, which is fast
    ends = np.cumsum(np.bincount(labels[known], minlength=count))[:-1]
    return np.array([np.median(v) if len(v) else np.nan for v in np.split(values[known][order], ends)])


def spearman(x: Array, y: Array) -> float:
    """Rank correlation of two samples (R,) where both are known; NaN for fewer than five or no spread."""
    both = np.isfinite(x) & np.isfinite(y)
    if both.sum() < LEAST_REGIONS:
        return float("nan")
    a, b = (rankdata(v[both]) for v in (x, y))
    a, b = a - a.mean(), b - b.mean()
    size = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / size if size > 0 else float("nan")


def correlations(regions: RegionNumbers, weights: Array) -> Statistic:
    """Rank correlations over regions of the person with each of the three bodies, under spins of the labels.

    Bodies that have a measure get the same regions.

    Parameters
    ----------
    regions : RegionNumbers
    weights : (P,) float64
        Area of the target points, 0 off the cortex.

    Returns
    -------
    function of (nearest, turn) to (3 K,) float64
        Those of the first body first. Regions with less than half of their points on the cortex are left out, as in a
        spin onto the medial wall.
    """
    count = len(regions.names)

    def statistic(nearest: Ints, turn: Array) -> Array:
        labels = regions.labels[nearest]
        on_cortex = np.where(weights > 0, labels, -1)
        points, covered = (np.bincount(at[at >= 0], minlength=count) for at in (labels, on_cortex))
        enough = np.where((points > 0) & (covered >= LEAST_COVERED_SHARE * points), 0.0, np.nan)
        numbers = np.stack([region_numbers(on_cortex, count, fields) for fields in regions.fields]) + enough
        known = np.isfinite(numbers)
        unshared = (~known & known.any(axis=2, keepdims=True)).any(axis=0)
        numbers[:, unshared] = np.nan
        return np.array([spearman(x, y) for body in numbers for x, y in zip(regions.person, body)])

    return statistic


def numbers_of_bodies(bodies: Bodies) -> RegionNumbers | None:
    """Numbers of the person's regions in all bodies; None without regions."""
    regions, person, grown = bodies.person.measures.cortex.regions, bodies.person, bodies.grown
    if regions is None:
        return None
    no_cortex = [k for k, name in enumerate(regions.names) if is_no_cortex(name)]
    labels = np.where(person.cortex & ~np.isin(regions.labels, no_cortex), regions.labels, -1)
    at_grown = np.where(grown.cortex, bodies.to_grown.of_nearest(labels), -1)
    in_person = region_fields(person.measures, bodies.person_areas, person.cortex, 1.0)
    in_grown = region_fields(grown.measures, bodies.areas, grown.cortex, grown.scale)
    in_smooth, in_deepened = (
        {key: mean_field(maps[name], bodies.weights) for key, name in SMOOTH_MAPS.items() if name in maps}
        for maps in (bodies.smooth_maps, bodies.deepened_maps)
    )
    return RegionNumbers(
        regions.names,
        labels,
        region_numbers(labels, len(regions.names), in_person),
        region_numbers(at_grown, len(regions.names), in_smooth),
        region_numbers(at_grown, len(regions.names), in_grown),
        (in_grown, in_smooth, in_deepened),
    )


def region_agreements(regions: RegionNumbers, values: Array, null: Array, grown: Measures) -> tuple[Agreement, ...]:
    """Correlations over regions of the measures that person and grown body have; Holm's correction is over these."""
    maps = (grown.cortex.info.get("grown_from") or {}).get("maps", [])
    given = {MEASURES_OF_GIVEN_MAPS.get(name) for name in maps}
    values, null = values.reshape(3, -1), null.reshape(len(null), 3, -1)
    agreements = []
    for k, key in enumerate(REGION_MEASURES):
        if np.isfinite(values[0, k]):
            (tested, _), (deepened, _) = best_controls(values[:, k], null[:, :, k])
            n = int(np.isfinite(regions.person[k] + regions.grown[k]).sum())
            agreements.append(Agreement(key, tested, deepened, n=n, p_corrected=tested.p, given=key in given))
    corrected = iter(holm(np.array([row.tested.p for row in agreements if not row.given])).tolist())
    return tuple(row if row.given else replace(row, p_corrected=next(corrected)) for row in agreements)


def region_table(regions: RegionNumbers, hemi: str) -> tuple[dict[str, Any], ...]:
    """A row for each region of the person that has vertices: each measure of person, smooth and grown body."""
    numbers = {
        f"{body}_{key}": values[k].tolist()
        for k, key in enumerate(REGION_MEASURES)
        for body, values in (("person", regions.person), ("smooth", regions.smooth), ("grown", regions.grown))
        if body != "smooth" or key in SMOOTH_MAPS
    }
    return tuple(
        {"hemi": hemi, "region": regions.names[r]} | {column: json_value(v[r]) for column, v in numbers.items()}
        for r in np.unique(regions.labels[regions.labels >= 0]).tolist()
    )
