"""Compare a cortex with the folds of the person it grew from, and both with the smooth body as control."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from morphofold.analysis.measures import Measures
from morphofold.analysis.multiple_tests import holm
from morphofold.arrays import Array, Ints
from morphofold.comparison.person.agreement import agreement_of_axes, agreement_of_classes, classes
from morphofold.comparison.person.axes import fold_axes, forwardness, smooth_axes
from morphofold.comparison.person.bodies import Bodies, Body, bodies_of
from morphofold.comparison.person.pairs import find_pairs
from morphofold.comparison.person.regions import (
    REGION_MEASURES,
    Fields,
    correlations,
    mean_field,
    region_fields,
    region_numbers,
)
from morphofold.comparison.person.results import Agreement, PersonComparison, RegionAgreement
from morphofold.comparison.person.spins import SPINS, Statistic, Tested, beside_null, spun
from morphofold.errors import MissingPart, Refusal
from morphofold.geometry import mean_edge_length
from morphofold.quantities import RELIEF
from morphofold.spheres.spins import NearestTable, rotations
from morphofold.words import listed, number

LIKE_SIZES = (0.8, 1.25)  # of a grown cortex over the person's, within which maps in mm are compared as they are
CONTROLS = (RELIEF, "H")  # maps of a smooth body that are controls of both agreements of sulci and gyri
KEYS = [measure.key for measure in REGION_MEASURES]


class _Question(NamedTuple):
    """An agreement: its statistic gives the number of the grown body, then those of the maps of the smooth body, and
    those of the same maps of the deepened one."""

    what: str
    statistic: Statistic
    controls: tuple[str, ...]


class _Regions(NamedTuple):
    """Regions of a pair: numbers (K, R) of the three bodies, and fields of grown, smooth and deepened body."""

    person: Array
    smooth: Array
    grown: Array
    fields: tuple[Fields, Fields, Fields]


def beside_people(
    named: Mapping[str, Measures], *, spins: int = SPINS, seed: int = 0
) -> tuple[tuple[PersonComparison, ...], tuple[str, ...]]:
    """Each cortex that grew from a person who is also there, beside that person; and remarks, as on who is missing."""
    pairs, remarks = find_pairs(named)
    found = []
    for person, grown, level in pairs:
        try:
            one = compare_with_person(named[person], named[grown], level, names=(person, grown), spins=spins, seed=seed)
        except Refusal as error:
            remarks.append(f"{grown} is not compared with the folds of {person}, from which it grew: {error}")
            continue
        found.append(one)
        if not LIKE_SIZES[0] <= one.scale <= LIKE_SIZES[1]:
            remarks.append(
                f"The hull of {grown} has the area of {person}'s only if its lengths are multiplied by "
                f"{number(one.scale, 2)}, but curvature and local gyrification were measured at the same scales in mm. "
                "Grow it with a radius multiplied by that."
            )
    return tuple(found), tuple(remarks)


def compare_with_person(
    person: Measures,
    grown: Measures,
    level: float,
    *,
    names: tuple[str, str] = ("person", "grown"),
    spins: int = SPINS,
    seed: int = 0,
) -> PersonComparison:
    """Compare a grown cortex with the person it grew from.

    Parameters
    ----------
    person, grown : Measures
        Of cortices with a sphere, on which both have points.
    level : float
        At which the person was unfolded.
    names : (str, str)
    spins : int
        Number of rotations of the person's sphere.
    seed : int

    Raises
    ------
    ValueError
        If one was measured in part (``only``), and as :func:`morphofold.comparison.person.bodies.bodies_of`.

    Notes
    -----
    Agreements are taken at the vertices of the grown cortex, weighted by the area of the smooth body, without the
    medial walls of both. The control of an agreement is the map of the smooth body that agrees best. A second control
    is the smooth body with its dents deepened: on fsaverage5 at level 0.03 its curvature agrees with the person's depth
    on 0.84 of the area, that of the smooth body itself on 0.76, so what beats only the latter is no more than what
    unfolding left.
    """
    for name, m in zip(names, (person, grown)):
        if "only" in m.parameters:
            raise MissingPart(f"{name}: was measured in part, only {listed(m.parameters['only'])}. Measure it whole.")
    bodies = bodies_of(person, grown, level)
    axes, forward = _question_of_axes(bodies)
    questions = [*_questions_of_classes(bodies), axes]
    statistics = [question.statistic for question in questions]
    regions = _regions(bodies)
    if regions is not None:
        assert bodies.labels is not None
        statistics.append(correlations(regions.person, regions.fields, bodies.labels, bodies.weights, KEYS))

    def numbers(nearest: Ints, turn: Array) -> Array:
        return np.concatenate([statistic(nearest, turn) for statistic in statistics])

    found = numbers(bodies.to_grown.nearest, np.eye(3))
    null = spun(numbers, bodies.grown.points, NearestTable(bodies.person.points), rotations(spins, seed))
    agreements, first = [], 0
    for question in questions:
        count = len(question.controls)
        bests = [k + int(found[k : k + count].argmax()) for k in (first + 1, first + 1 + count)]
        one, other = (
            beside_null(float(found[first]), null[:, first], float(found[best]), null[:, best]) for best in bests
        )
        maps = [question.controls[(best - first - 1) % count] for best in bests]
        agreements.append(Agreement(question.what, one, maps[0], other, maps[1]))
        first += 1 + 2 * count
    return PersonComparison(
        *names,
        person.cortex.hemi,
        level,
        bodies.grown.scale,
        spins,
        tuple(agreements),
        forward,
        () if regions is None else _region_agreements(regions, found[first:], null[:, first:], grown),
        () if regions is None else _region_rows(bodies, regions),
        bodies,
    )


def _questions_of_classes(bodies: Bodies) -> list[_Question]:
    """Agreements of sulci and gyri by depth and by curvature.

    Both maps of a smooth body are controls of both, so that growth does not win by another measure of the same folds.
    """
    weights, person, grown = bodies.weights, bodies.person, bodies.grown
    controls = [classes(maps[key], weights) for maps in (bodies.smooth_maps, bodies.deepened_maps) for key in CONTROLS]
    found = []
    for what, theirs, mine in (
        ("depth", person.height, grown.height),
        ("curvature", person.curvature, grown.curvature),
    ):
        reference = classes(theirs, bodies.person_areas)
        statistic = agreement_of_classes([classes(mine, weights), *controls], reference, weights)
        found.append(_Question(what, statistic, CONTROLS))
    return found


def _question_of_axes(bodies: Bodies) -> tuple[_Question, dict[str, float]]:
    """Agreement of fold axes, and the mean cos 2a of each body with the front-back axis."""
    person, grown = (_axes(body) for body in (bodies.person, bodies.grown))
    at = bodies.grown.points
    smooth, deepened = (
        (along, strength * bodies.grown.cortex)
        for along, strength in (smooth_axes(body, at) for body in (bodies.smooth, bodies.deepened))
    )
    statistic = agreement_of_axes([grown, smooth, deepened], person, bodies.weights, at)
    forward = {
        "person": forwardness(*person, bodies.smooth, bodies.person.points, bodies.person_areas),
        "smooth": forwardness(*smooth, bodies.smooth, at, bodies.areas),
        "grown": forwardness(*grown, bodies.smooth, at, bodies.areas),
    }
    return _Question("axes", statistic, ("axes",)), forward


def _axes(body: Body) -> tuple[Array, Array]:
    """Fold axes at the scale at which curvature was measured."""
    pial = body.pial
    scale = body.measures.parameters.get("curvature_scale_mm") or 3 * mean_edge_length(pial.verts, pial.faces)
    return fold_axes(pial, body.points, float(scale), body.cortex)


def _regions(bodies: Bodies) -> _Regions | None:
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


def _region_agreements(regions: _Regions, found: Array, null: Array, grown: Measures) -> tuple[RegionAgreement, ...]:
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


def _region_rows(bodies: Bodies, regions: _Regions) -> tuple[dict[str, Any], ...]:
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
