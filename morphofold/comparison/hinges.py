"""Three-hinge patterns of one group of surfaces compared with another (Fig. 9 of Razavi et al. 2015)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np

from morphofold.analysis.graph.hinge_shapes import (
    PLANAR_NET_FEATURES,
    HingeShapes,
    TwoSample,
    random_net,
    shape_distance,
    together,
    two_sample,
)
from morphofold.arrays import Array

SHORTEST_ARM_IN_WIDTHS = (
    0.5  # shortest arm of a random net, in crown widths: a gyral graph merges hinges that are nearer
)
MOST_HINGES_PER_AREA = (
    0.7  # hinges per square of the crown width: with more, not all arms can be as long as SHORTEST_ARM_IN_WIDTHS
)
RANDOM_NET_HINGES = 2000
RANDOM_NET_NAME = "random net"
PERMUTATIONS = 999


@dataclass(frozen=True)
class Match:
    """A hinge and the hinge of the other group with the most similar shape.

    ``surface`` and ``hinge`` identify the first, ``other_surface`` and ``other`` the second, by names of surfaces and
    numbers in their tables of hinges; ``pose`` places the second on the first, see
    :func:`morphofold.analysis.graph.hinge_shapes.shape_distance`; ``kind`` is the shape of the first.
    """

    surface: str
    hinge: int
    other_surface: str
    other: int
    distance: float
    pose: int
    kind: str


@dataclass(frozen=True)
class NumberRow:
    """One number of hinge shapes in two groups: medians, and the Kolmogorov-Smirnov distance of the distributions."""

    number: str
    median: float
    other_median: float
    ks: float
    p: float


@dataclass(frozen=True)
class Control:
    """Distances from hinges of some source to the nearest hinge of the second group, by angles and lengths of arms.

    ``median`` is that of the distances. ``p`` compares it with the median of the first group: how often a random
    division of both sets of distances differs as much in its medians; 1 for the first group itself.
    """

    source: str
    median: float
    n: int
    p: float


@dataclass(frozen=True, eq=False)
class HingeComparison:
    """Hinges of group ``one`` compared with those of group ``other``.

    ``surfaces`` are the numbers of surfaces. ``shape`` compares the distributions of whole shapes, ``numbers`` those of
    single numbers. ``matches`` has one entry per hinge of ``one``, the nearest first. ``controls`` are the first group,
    the second group itself (each hinge left out in turn), and a random net, if one with as many hinges per square of
    the crown width exists.
    """

    one: str
    other: str
    surfaces: tuple[int, int]
    shape: TwoSample
    numbers: tuple[NumberRow, ...]
    controls: tuple[Control, ...]
    matches: tuple[Match, ...] = field(repr=False)


def compare_hinges(
    shapes: Mapping[str, HingeShapes], groups: Mapping[str, Sequence[str]], *, seed: int = 0
) -> list[HingeComparison]:
    """Compare every two groups, in their order; a group with fewer than two hinges of three arms is left out.

    Parameters
    ----------
    shapes : mapping of surface name to HingeShapes
    groups : mapping of group name to the names of its surfaces
        No surface may be in two. Surfaces without shapes are ignored.
    seed : int
        Of permutations and of the random net.
    """
    members = {group: [name for name in names if name in shapes] for group, names in groups.items()}
    held = {group: names for group, names in members.items() if sum(len(shapes[name]) for name in names) > 1}
    return [
        _compare_groups(one, other, {n: shapes[n] for n in held[one]}, {n: shapes[n] for n in held[other]}, seed)
        for one, other in combinations(held, 2)
    ]


def _compare_groups(
    one: str, other: str, mine: Mapping[str, HingeShapes], theirs: Mapping[str, HingeShapes], seed: int
) -> HingeComparison:
    a, b = together(list(mine.values())), together(list(theirs.values()))
    pooled = np.concatenate([a, b])
    across, _ = shape_distance(pooled, pooled)
    return HingeComparison(
        one,
        other,
        (len(mine), len(theirs)),
        two_sample(across, len(a), permutations=PERMUTATIONS, seed=seed),
        _compare_numbers(mine, theirs),
        _control_distances(one, other, a, b, theirs, seed),
        _nearest_matches(a, b, mine, theirs),
    )


def _compare_numbers(mine: Mapping[str, HingeShapes], theirs: Mapping[str, HingeShapes]) -> tuple[NumberRow, ...]:
    from scipy import stats

    rows = []
    ours, other = ([s.numbers() for s in group.values()] for group in (mine, theirs))
    for key in ours[0]:
        x, y = (np.concatenate([numbers[key] for numbers in group]) for group in (ours, other))
        found = stats.ks_2samp(x, y)
        medians = float(np.median(x)), float(np.median(y))
        rows.append(NumberRow(key, *medians, float(found.statistic), float(found.pvalue)))
    return tuple(rows)


def _control_distances(
    one: str, other: str, a: Array, b: Array, theirs: Mapping[str, HingeShapes], seed: int
) -> tuple[Control, ...]:
    within, _ = shape_distance(b, b, of=PLANAR_NET_FEATURES)
    np.fill_diagonal(within, np.inf)
    nearest = {one: shape_distance(a, b, of=PLANAR_NET_FEATURES)[0].min(axis=1), f"{other} itself": within.min(axis=1)}
    net = net_at_chance([s for s in theirs.values() if len(s)], seed=seed)
    if net is not None:
        nearest[RANDOM_NET_NAME] = shape_distance(net, b, of=PLANAR_NET_FEATURES)[0].min(axis=1)
    first = nearest[one]
    return tuple(
        Control(name, float(np.median(d)), len(d), 1.0 if d is first else median_difference(first, d, seed=seed))
        for name, d in nearest.items()
    )


def net_at_chance(shapes: Sequence[HingeShapes], *, seed: int = 0) -> Array | None:
    """Hinges of :func:`morphofold.analysis.random_net` as dense as those of some surfaces; None if impossible."""
    per_area = float(np.mean([s.per_area for s in shapes]))
    if not 0 < per_area < MOST_HINGES_PER_AREA:
        return None
    return random_net(RANDOM_NET_HINGES, shortest=SHORTEST_ARM_IN_WIDTHS, per_area=per_area, seed=seed)


def median_difference(x: Array, y: Array, *, permutations: int = PERMUTATIONS, seed: int = 0) -> float:
    """p-value of the difference of the medians of two samples (N,) and (M,), from random divisions, two-sided."""
    pooled, n = np.concatenate([x, y]), len(x)
    rng = np.random.default_rng(seed)

    def difference(values: Array) -> float:
        return abs(float(np.median(values[:n]) - np.median(values[n:])))

    found = difference(pooled)
    as_much = sum(difference(rng.permutation(pooled)) >= found - 1e-12 for _ in range(permutations))
    return (1 + as_much) / (1 + permutations)


def _nearest_matches(
    a: Array, b: Array, mine: Mapping[str, HingeShapes], theirs: Mapping[str, HingeShapes]
) -> tuple[Match, ...]:
    distance, pose = shape_distance(a, b)
    one, other = (
        [(name, int(hinge), str(kind)) for name, s in group.items() for hinge, kind in zip(s.hinge, s.kinds)]
        for group in (mine, theirs)
    )
    nearest = distance.argmin(axis=1)
    found = [
        Match(one[i][0], one[i][1], other[j][0], other[j][1], float(distance[i, j]), int(pose[i, j]), one[i][2])
        for i, j in enumerate(nearest.tolist())
    ]
    return tuple(sorted(found, key=lambda match: match.distance))


def examples(
    matches: Sequence[Match], count: int = 6, *, wanted: Callable[[Match], bool] = lambda match: True
) -> list[Match]:
    """The best matches of different kinds, no hinge twice: the best of each of Y, T and V, then the next best.

    Only matches for which ``wanted`` is true are taken.
    """
    chosen: list[Match] = []
    for kinds in (True, False):
        for match in matches:
            new = (match.other_surface, match.other) not in {(m.other_surface, m.other) for m in chosen}
            if len(chosen) < count and match not in chosen and new:
                if (not kinds or match.kind not in {m.kind for m in chosen}) and wanted(match):
                    chosen.append(match)
    return sorted(chosen, key=lambda match: match.distance)
