"""Whether regions of a person rank alike in the cortex grown from the unfolded person: a table, and an ``Agreement``.

From bodies on one sphere come the numbers of each region of the person's parcellation in the person, the smooth body
and the grown cortex (gyrification, depth, thicknesses, hinges, expansion), and for each measure the rank correlation
over regions between person and grown cortex. ``compare_person`` calls it.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from morphofold.analysis.graph.hinges import counts
from morphofold.analysis.multiple_tests import holm
from morphofold.comparison.person.common_sphere import Bodies, Body
from morphofold.comparison.person.person_agreement import Agreement, agreement_with_controls
from morphofold.digests_and_json import Row, json_value
from morphofold.frozen_arrays import Array, Ints
from morphofold.geometry import vertex_areas
from morphofold.mesh_quality.cortex_checks import is_no_cortex
from morphofold.quantities import find

LEAST_REGIONS = 5  # for a correlation
LEAST_COVERED_SHARE = 0.5  # of the points of a region that must be cortex after a spin

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

#: what the numbers of regions are made of, by measure: a pair (N,), (N,) whose sums in a region are divided, or values
#: (N,) of which a region has the median, NaN where there is none
Fields = Mapping[str, Array | tuple[Array, Array]]


class RegionNumbers(NamedTuple):
    """Numbers of R regions in a person, the smooth and the grown body.

    Attributes
    ----------
    names : tuple of str
    labels : (N,) int64
        Regions of the person's vertices, -1 off the cortex and where there is none.
    numbers : mapping of "person", "smooth" and "grown" to (K, R) float64
        The :data:`REGION_MEASURES` of each; NaN where a body does not have one.
    fields : sequence of Fields
        Of the grown, the smooth and the deepened smooth body.
    weights : (P,) float64
        Area of the grown vertices, 0 off the cortex.
    """

    names: tuple[str, ...]
    labels: Ints
    numbers: Mapping[str, Array]
    fields: Sequence[Fields]
    weights: Array

    def correlations(self, nearest: Ints, rotation: Array) -> Array:
        """Rank correlations (3, K) over regions of the person with each of the three bodies: a statistic for spins.

        Bodies that have a measure get the same regions. Regions with less than half of their points on the cortex are
        left out, as in a spin onto the medial wall.
        """
        n_regions, labels = len(self.names), self.labels[nearest]
        on_cortex = np.where(self.weights > 0, labels, -1)
        n_points, n_covered = (np.bincount(labels[labels >= 0], minlength=n_regions) for labels in (labels, on_cortex))
        zero_or_nan = np.where(n_covered >= LEAST_COVERED_SHARE * n_points, 0.0, np.nan)
        numbers = np.stack([region_numbers(on_cortex, n_regions, fields) for fields in self.fields]) + zero_or_nan
        is_missing = np.isnan(numbers)
        numbers[:, (is_missing & ~is_missing.all(axis=2, keepdims=True)).any(axis=0)] = np.nan
        return np.array([list(map(spearman, self.numbers["person"], body_numbers)) for body_numbers in numbers])

    def agreements(self, values: Array, null: Array, given_maps: Collection[str]) -> tuple[Agreement, ...]:
        """Correlations (3, K) with their values (T, 3, K) under spins, of the measures that person and grown body have.

        Holm's correction is over these, without those that the grown body has from ``given_maps`` of the person.
        """
        measures_given = {MEASURES_OF_GIVEN_MAPS.get(name) for name in given_maps}
        n_common = np.isfinite(self.numbers["person"] + self.numbers["grown"]).sum(axis=1).tolist()
        rows = [
            agreement_with_controls(key, values[:, k], null[:, :, k], n=n_common[k], given=key in measures_given)
            for k, key in enumerate(REGION_MEASURES)
            if np.isfinite(values[0, k])
        ]
        corrected_p = holm(np.array([np.nan if row.given else row.tested.p for row in rows])).tolist()
        return tuple(replace(row, p_corrected=row.tested.p if row.given else p) for row, p in zip(rows, corrected_p))

    def table(self, hemi: str) -> tuple[Row, ...]:
        """A row for each region of the person that has vertices: each measure of person, smooth and grown body."""
        columns = {
            f"{body}_{key}": numbers[k]
            for k, key in enumerate(REGION_MEASURES)
            for body, numbers in self.numbers.items()
            if body != "smooth" or key in SMOOTH_MAPS
        }
        return tuple(
            {"hemi": hemi, "region": self.names[row]} | {column: json_value(v[row]) for column, v in columns.items()}
            for row in np.unique(self.labels[self.labels >= 0])
        )


def numbers_of_regions(bodies: Bodies) -> RegionNumbers | None:
    """Numbers of the person's regions in all bodies; None without regions."""
    person, grown = bodies.person, bodies.grown
    regions = person.measures.cortex.regions
    if regions is None:
        return None
    n_regions = len(regions.names)
    no_cortex_labels = [label for label, name in enumerate(regions.names) if is_no_cortex(name)]
    labels = np.where(person.cortex & ~np.isin(regions.labels, no_cortex_labels), regions.labels, -1)
    grown_labels = np.where(grown.cortex, bodies.to_grown.of_nearest(labels), -1)
    smooth_fields, deepened_fields = (
        {key: mean_field(body.maps[name], grown.weights) for key, name in SMOOTH_MAPS.items() if name in body.maps}
        for body in bodies.controls.values()
    )
    grown_fields = region_fields(grown)
    numbers = {
        "person": region_numbers(labels, n_regions, region_fields(person)),
        "smooth": region_numbers(grown_labels, n_regions, smooth_fields),
        "grown": region_numbers(grown_labels, n_regions, grown_fields),
    }
    return RegionNumbers(regions.names, labels, numbers, (grown_fields, smooth_fields, deepened_fields), grown.weights)


def mean_field(values: Array, weights: Array | float) -> tuple[Array, Array]:
    """The weighted mean of values (N,) over the vertices that have one: its numerator and denominator by vertex."""
    is_finite = np.isfinite(values)
    return np.where(is_finite, values, 0.0) * weights, is_finite * weights


def region_fields(body: Body) -> Fields:
    """The fields of a measured cortex for which it has maps; regions leave out what is off the cortex.

    ``gyrification_index`` and ``sulcal_depth_mm`` are means over pial area, ``cortical_thickness_mm`` is one over
    vertices, as in the table of regions; ``gyral_thickness_mm`` is the median over vertices. ``hinges_per_cm2`` counts
    hinges without doubtful ones per area midway between white and pial; ``area_expansion`` is this area over that of
    the smooth body, 1 for the whole cortex.
    """
    m, is_cortex, scale, smooth_areas = body.measures, body.cortex, body.scale, body.weights
    white_areas, pial_areas = (vertex_areas(s.verts, s.faces) * is_cortex for s in (m.cortex.white, m.cortex.pial))
    mid_areas = 0.5 * scale**2 * (white_areas + pial_areas)
    fields: dict[str, Any] = {"area_expansion": (mid_areas / mid_areas.sum(), smooth_areas / smooth_areas.sum())}
    for key, name, factor, weights in (
        ("gyrification_index", "local_gyrification_index", 1.0, pial_areas),
        ("sulcal_depth_mm", "sulcal_depth", scale, pial_areas),
        ("cortical_thickness_mm", "cortical_thickness", scale, 1.0),
        ("gyral_thickness_mm", "gyral_thickness", scale, None),
    ):
        if (values := find(m.maps, name)) is not None:
            fields[key] = factor * values if weights is None else mean_field(factor * values, weights)
    if m.graph is not None or m.hinges:
        hinge_vertices = np.array([row["vertex"] for row in m.hinges if counts(row)], dtype=np.int64)
        fields["hinges_per_cm2"] = 100 * np.bincount(hinge_vertices, minlength=len(is_cortex)), mid_areas
    return fields


def region_numbers(labels: Ints, n_regions: int, fields: Fields) -> Array:
    """Numbers (K, count) of regions by their labels (N,), -1 for none; NaN for a field or a region that is empty."""
    numbers = np.full((len(REGION_MEASURES), n_regions), np.nan)
    for region_row, field in zip(numbers, map(fields.get, REGION_MEASURES)):
        if isinstance(field, tuple):
            numerators, denominators = (np.bincount(labels + 1, values, n_regions + 1)[1:] for values in field)
            np.divide(numerators, denominators, out=region_row, where=denominators > 0)
        elif field is not None:
            known = np.flatnonzero(np.isfinite(field) & (labels >= 0))
            order = known[np.argsort(labels[known].astype(np.int16), kind="stable")]  # by radix, which is fast
            value_sets = np.split(field[order], np.searchsorted(labels[order], np.arange(1, n_regions)))
            region_row[:] = [np.median(values) if len(values) else np.nan for values in value_sets]
    return numbers


def spearman(x: Array, y: Array) -> float:
    """Rank correlation of two samples (R,) where both are known; NaN for fewer than five or no spread."""
    from scipy.stats import rankdata  # takes a third of a second, which a page without regions saves

    is_known = np.isfinite(x + y)
    n = np.count_nonzero(is_known)
    if n < LEAST_REGIONS:
        return np.nan
    x_ranks, y_ranks = (rankdata(values[is_known]) - 0.5 * (n + 1) for values in (x, y))
    norm = np.sqrt((x_ranks @ x_ranks) * (y_ranks @ y_ranks))
    return x_ranks @ y_ranks / norm if norm > 0 else np.nan
