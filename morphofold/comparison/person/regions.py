"""Numbers of the regions of a person, of the cortex that grew from it, and of the smooth body between them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import rankdata

from morphofold.analysis.graph.hinges import counts
from morphofold.analysis.measures import Measures
from morphofold.analysis.multiple_tests import holm
from morphofold.arrays import Array, Bools, Ints
from morphofold.comparison.person.agreement import RegionAgreement, Statistic, Tested, beside_null
from morphofold.comparison.person.bodies import Bodies
from morphofold.geometry import vertex_areas
from morphofold.quantities import find

LEAST_REGIONS = 5  # for a correlation
LEAST_KEPT_SHARE = 0.5  # of the points of a region that must be cortex after a spin


class Ratio(NamedTuple):
    """A number of a region: the sum of ``over`` (N,) in it over the sum of ``under`` (N,)."""

    over: Array
    under: Array


class Median(NamedTuple):
    """A number of a region: the median of ``values`` (N,) in it, NaN where there is none."""

    values: Array


Fields = Mapping[str, Ratio | Median]


@dataclass(frozen=True)
class RegionMeasure:
    """A measure of regions: its column, and whether the smooth body has it, too."""

    key: str
    smooth: bool = False


REGION_MEASURES = (
    RegionMeasure("gyrification_index", smooth=True),
    RegionMeasure("sulcal_depth_mm", smooth=True),
    RegionMeasure("gyral_thickness_mm"),
    RegionMeasure("cortical_thickness_mm"),
    RegionMeasure("hinges_per_cm2"),
    RegionMeasure("area_expansion"),
)


def mean_field(values: Array | None, weights: Array) -> Ratio | None:
    """The weighted mean of values (N,) over the vertices that have one."""
    if values is None or not np.isfinite(values).any():
        return None
    known = np.isfinite(values)
    return Ratio(np.where(known, values, 0.0) * weights, known * weights)


def region_fields(m: Measures, smooth_area: Array, cortex: Bools, scale: float) -> dict[str, Ratio | Median]:
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
    c = m.cortex
    white, pial = (vertex_areas(s.verts, c.faces) * cortex for s in (c.white, c.pial))
    middle = 0.5 * scale**2 * (white + pial)
    map_of = lambda key, by=1.0: None if (found := find(m.maps, key)) is None else by * found
    found: dict[str, Ratio | Median | None] = {
        "gyrification_index": mean_field(map_of("local_gyrification_index"), pial),
        "sulcal_depth_mm": mean_field(map_of("sulcal_depth", scale), pial),
        "cortical_thickness_mm": mean_field(map_of("cortical_thickness", scale), cortex.astype(np.float64)),
    }
    widths = map_of("gyral_thickness", scale)
    if widths is not None and np.isfinite(widths).any():
        found["gyral_thickness_mm"] = Median(np.where(cortex, widths, np.nan))
    if m.graph is not None or m.hinges:
        at = [row["vertex"] for row in m.hinges if counts(row)]
        hinges = np.bincount(np.array(at, dtype=np.int64), minlength=c.n_vertices).astype(np.float64)
        found["hinges_per_cm2"] = Ratio(100 * hinges * cortex, middle)
    flat = smooth_area * cortex
    found["area_expansion"] = Ratio(middle / middle.sum(), flat / flat.sum())
    return {key: field for key, field in found.items() if field is not None}


def region_numbers(labels: Ints, count: int, fields: Fields, keys: Sequence[str]) -> Array:
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
    known = np.flatnonzero(np.isfinite(values) & (labels >= 0))
    known = known[np.argsort(values[known], kind="stable")]
    known = known[np.argsort(labels[known].astype(np.int16), kind="stable")]
    size = np.bincount(labels[known], minlength=count)
    first, found = np.cumsum(size) - size, np.full(count, np.nan)
    full = size > 0
    low, high = (values[known[(first + (size - side) // 2)[full]]] for side in (1, 0))
    found[full] = 0.5 * (low + high)
    return found


def spearman(x: Array, y: Array) -> float:
    """Rank correlation of two samples (R,) where both are known; NaN for fewer than five or no spread."""
    both = np.isfinite(x) & np.isfinite(y)
    if both.sum() < LEAST_REGIONS:
        return float("nan")
    a, b = (rankdata(v[both]) for v in (x, y))
    a, b = a - a.mean(), b - b.mean()
    size = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / size if size > 0 else float("nan")


def correlations(
    person: Array, bodies: Sequence[Fields], labels: Ints, weights: Array, keys: Sequence[str]
) -> Statistic:
    """Rank correlations over regions of the person with each of several bodies, under spins of the labels.

    Parameters
    ----------
    person : (K, R) float64
        Numbers of the person's regions.
    bodies : sequence of mappings of key to field at the P target points
        Those that have a measure get the same regions.
    labels : (N,) int64
        Regions of the person's vertices.
    weights : (P,) float64
        Area of the target points, 0 off the cortex.

    Returns
    -------
    function of (nearest, turn) to (bodies * K,) float64
        Those of the first body first. Regions with less than half of their points on the cortex are left out, as in a
        spin onto the medial wall.
    """
    count = person.shape[1]

    def statistic(nearest: Ints, turn: Array) -> Array:
        there = labels[nearest]
        points = np.bincount(there[there >= 0], minlength=count)
        on_cortex = np.bincount(there[(there >= 0) & (weights > 0)], minlength=count)
        kept = np.where((points > 0) & (on_cortex >= LEAST_KEPT_SHARE * points), 0.0, np.nan)
        there = np.where(weights > 0, there, -1)
        found = np.stack([region_numbers(there, count, fields, keys) for fields in bodies]) + kept
        has = np.isfinite(found).any(axis=2, keepdims=True)
        unshared = (~np.isfinite(found) & has).any(axis=0)
        found[:, unshared] = np.nan
        return np.array([spearman(x, y) for body in found for x, y in zip(person, body)])

    return statistic


KEYS = [measure.key for measure in REGION_MEASURES]


class _Regions(NamedTuple):
    """Regions of a pair: numbers (K, R) of the three bodies, and fields of grown, smooth and deepened body."""

    person: Array
    smooth: Array
    grown: Array
    fields: tuple[Fields, Fields, Fields]


def regions_of(bodies: Bodies) -> _Regions | None:
    regions = bodies.person.measures.cortex.regions
    if regions is None or bodies.labels is None:
        return None
    count, person, grown = len(regions.names), bodies.person, bodies.grown
    in_person = region_fields(person.measures, bodies.person_areas, person.cortex, 1.0)
    in_grown = region_fields(grown.measures, bodies.areas, grown.cortex, grown.scale)
    in_smooth, in_deepened = (
        _smooth_fields(maps, bodies.weights) for maps in (bodies.smooth_maps, bodies.deepened_maps)
    )
    there = np.where(grown.cortex, bodies.to_grown.of_nearest(bodies.labels), -1)
    return _Regions(
        region_numbers(bodies.labels, count, in_person, KEYS),
        region_numbers(there, count, in_smooth, KEYS),
        region_numbers(there, count, in_grown, KEYS),
        (in_grown, in_smooth, in_deepened),
    )


def _smooth_fields(maps: Mapping[str, Array], weights: Array) -> Fields:
    names = {"gyrification_index": "local_gyrification_index", "sulcal_depth_mm": "sulcal_depth"}
    found = {key: mean_field(maps.get(name), weights) for key, name in names.items()}
    return {key: field for key, field in found.items() if field is not None}


#: map that a body was given -> measure of regions that it has from it
GIVEN_BY = {"thickness_map": "cortical_thickness_mm", "growth_map": "area_expansion"}


def region_agreements(regions: _Regions, found: Array, null: Array, grown: Measures) -> tuple[RegionAgreement, ...]:
    """Correlations over regions of the measures that person and grown body have; Holm's correction is over these."""
    maps = (grown.cortex.info.get("grown_from") or {}).get("maps", [])
    given = {GIVEN_BY[name] for name in maps if name in GIVEN_BY}
    rows: list[tuple[str, Tested, Tested, int]] = []
    for k, key in enumerate(KEYS):
        if np.isfinite(found[k]):
            one, other = (
                beside_null(float(found[k]), null[:, k], float(found[c]), null[:, c])
                for c in (k + len(KEYS), k + 2 * len(KEYS))
            )
            rows.append((key, one, other, int((np.isfinite(regions.person[k]) & np.isfinite(regions.grown[k])).sum())))
    corrected = iter(holm(np.array([one.p for key, one, *_ in rows if key not in given])).tolist())
    return tuple(
        RegionAgreement(key, one, other, n, one.p if key in given else next(corrected), key in given)
        for key, one, other, n in rows
    )


def region_table(bodies: Bodies, regions: _Regions) -> tuple[dict[str, Any], ...]:
    """A row for each region of the person that has vertices: each measure of person, smooth and grown body."""
    known = bodies.person.measures.cortex.regions
    assert known is not None
    assert bodies.labels is not None
    size = np.bincount(bodies.labels[bodies.labels >= 0], minlength=len(known.names))
    kinds = {"person": regions.person, "smooth": regions.smooth, "grown": regions.grown}
    return tuple(
        {"hemi": bodies.person.measures.cortex.hemi, "region": name}
        | {
            f"{kind}_{measure.key}": float(values[k, r]) if np.isfinite(values[k, r]) else None
            for k, measure in enumerate(REGION_MEASURES)
            for kind, values in kinds.items()
            if kind != "smooth" or measure.smooth
        }
        for r, name in enumerate(known.names)
        if size[r]
    )
