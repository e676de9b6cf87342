"""Shapes of three-hinges, where three gyral crests meet, compared between groups (Fig. 9 of Razavi et al. 2015).

In go the hinge shapes of each surface and its group; for each pair of groups comes a ``HingeComparison``: distances,
best matches, and a test against hinges of a random planar net. ``side_by_side`` calls it.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from operator import attrgetter

import numpy as np

from morphofold.analysis.graph import hinge_statistics
from morphofold.analysis.multiple_tests import SIGNIFICANCE
from morphofold.frozen_arrays import Array, Ints
from morphofold.spheres.spins import p_value

ShapesByName = Mapping[str, hinge_statistics.HingeShapes]  # of surfaces
#: shortest arm of a random net, in crown widths: a gyral graph merges hinges that are nearer
SHORTEST_ARM_IN_WIDTHS = 0.5
#: hinges per square of the crown width: with more, not all arms can be as long as SHORTEST_ARM_IN_WIDTHS
MOST_HINGES_PER_AREA = 0.7
RANDOM_NET_HINGES = 2000
RANDOM_NET_NAME = "random net"
PERMUTATIONS, DRAWS = 999, 100
MOST_TESTED_HINGES = 300  # hinges of a group and of the random net in the test of the two
LEAST_SURFACES_AS_UNITS = 6  # with fewer, signs alone never reach a p-value below 0.05


@dataclass(frozen=True)
class Match:
    """A hinge and the hinge of the other group with the most similar shape.

    ``surface`` and ``hinge`` identify the first, ``other_surface`` and ``other`` the second, by names of surfaces and
    numbers in their tables of hinges; ``pose`` places the second on the first, see
    :func:`morphofold.analysis.graph.hinge_statistics.shape_distance`; ``kind`` is the shape of the first.
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
    """One number of hinge shapes in two groups: medians, and the Kolmogorov-Smirnov distance of the distributions.

    There is no p-value: hinges of one surface are neighbours, so they are no sample of independent values.
    """

    number: str
    median: float
    other_median: float
    ks: float


@dataclass(frozen=True)
class Control:
    """How near in shape, by angles and lengths of arms, the hinges of some source are to those of the second group.

    ``to_other`` is the median distance from a hinge of the source to the nearest of the second group, ``from_other``
    that from a hinge of the second group to the nearest of the source: a single common shape has a small first number
    and a large second one. Both are means over random draws of ``n`` hinges on either side, the same ``n`` for all
    sources.
    """

    source: str
    to_other: float
    from_other: float
    n: int


@dataclass(frozen=True, eq=False)
class HingeComparison:
    """Hinges of group ``one`` compared with those of group ``other``.

    ``surfaces`` are the numbers of surfaces. ``shape`` compares the distributions of whole shapes, ``numbers`` those of
    single numbers. ``matches`` has one entry per hinge of ``one``, the nearest first. ``controls`` are the first group,
    other hinges of the second group, and a random net, if one with as many hinges per square of the crown width exists.
    ``p`` is that of the difference between the first group and the random net, over both directions, and None without
    one. Its ``units`` are hinges (random divisions of the hinges of the first group and of the net), or surfaces of the
    second group (random signs) if there are six or more and that p is larger: hinges of the first group are the same
    for all surfaces, so that surfaces alone do not tell them from others by chance.
    """

    one: str
    other: str
    surfaces: tuple[int, int]
    shape: hinge_statistics.TwoSample
    numbers: tuple[NumberRow, ...]
    controls: tuple[Control, ...]
    p: float | None
    units: str
    matches: tuple[Match, ...] = field(repr=False)

    @property
    def closer(self) -> bool:
        """Whether hinges of ``one`` are nearer to those of ``other`` than hinges of the random net, in both directions
        and with p < 0.05."""
        own_control, *_, net_control = self.controls
        is_nearer = own_control.to_other < net_control.to_other and own_control.from_other < net_control.from_other
        return is_nearer and (self.p or 1.0) < SIGNIFICANCE

    @property
    def verdict(self) -> str:
        """One sentence on ``closer``; empty without a random net."""
        if self.p is None:
            return ""
        own_control, *_, net_control = self.controls
        return (
            f"The hinge shapes of {self.one} are {'closer' if self.closer else 'no closer'} to those of {self.other} "
            f"than the hinge shapes of a random net: from {self.one} to {self.other} the median distance is "
            f"{own_control.to_other:.3f} (random net {net_control.to_other:.3f}), from {self.other} to {self.one} "
            f"{own_control.from_other:.3f} ({net_control.from_other:.3f}), p = {self.p:.2g} with {self.units} as units."
        )


def compare_hinges(
    shapes: ShapesByName, groups: Mapping[str, Sequence[str]], *, seed: int = 0
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
    group_items = [(group, {name: shapes[name] for name in names if name in shapes}) for group, names in groups.items()]
    groups_with_hinges = [group for group in group_items if sum(map(len, group[1].values())) > 1]
    return [_compare_groups(*pair, seed) for pair in combinations(groups_with_hinges, 2)]


NamedShapes = tuple[str, ShapesByName]  # name of a group, and its shapes by surface


def _compare_groups(first: NamedShapes, second: NamedShapes, seed: int) -> HingeComparison:
    from scipy.stats import ks_2samp  # takes a third of a second, which a page of one cortex saves

    (own_name, own_shapes), (other_name, other_shapes) = first, second
    shapes = list(other_shapes.values())
    own_set, other_set = hinge_statistics.together(list(own_shapes.values())), hinge_statistics.together(shapes)
    pooled_features, n_own = np.concatenate([own_set, other_set]), len(own_set)
    distances, poses = hinge_statistics.shape_distance(pooled_features, pooled_features)
    # numbers of pooled hinges, which depend on their features alone
    own_numbers, other_numbers = (replace(shapes[0], features=features).numbers() for features in (own_set, other_set))
    return HingeComparison(
        own_name,
        other_name,
        (len(own_shapes), len(other_shapes)),
        hinge_statistics.two_sample(distances, n_own, permutations=PERMUTATIONS, seed=seed),
        tuple(
            NumberRow(key, float(np.median(x)), float(np.median(y)), float(ks_2samp(x, y).statistic))
            for (key, x), y in zip(own_numbers.items(), other_numbers.values())
        ),
        *_compare_with_chance(own_name, own_set, other_name, other_set, shapes, seed),
        _nearest_matches(distances[:n_own, n_own:], poses[:n_own, n_own:], own_shapes, other_shapes),
    )


def _compare_with_chance(
    name: str,
    own_set: Array,
    other_name: str,
    other_set: Array,
    shapes: Sequence[hinge_statistics.HingeShapes],
    seed: int,
) -> tuple[tuple[Control, ...], float | None, str]:
    """Controls of the first group with features ``own_set``; p-value of its difference from chance, and its units."""
    rng, itself_name = np.random.default_rng(seed), f"{other_name} itself"
    net_features = net_at_chance(list(filter(len, shapes)), seed=seed)
    distances = {
        source: hinge_statistics.shape_distance(features, other_set, of=hinge_statistics.PLANAR_NET_FEATURES)[0]
        for source, features in ((name, own_set), (itself_name, other_set), (RANDOM_NET_NAME, net_features))
        if features is not None
    }
    size = min(len(other_set) // 2, *map(len, distances.values()))
    mean_distances = {source: np.zeros(2) for source in distances}
    for _ in range(DRAWS):
        order = rng.permutation(len(other_set))
        for source, distance in distances.items():
            rows = order[size : 2 * size] if source == itself_name else rng.choice(len(distance), size, replace=False)
            mean_distances[source] += _median_distances(distance[np.ix_(rows, order[:size])]) / DRAWS
    controls = tuple(Control(source, float(to), float(back), size) for source, (to, back) in mean_distances.items())
    if net_features is None:
        return controls, None, ""
    n_sample = min(len(own_set), len(net_features), MOST_TESTED_HINGES)
    pooled = np.concatenate([rng.permutation(distances[source])[:n_sample] for source in (name, RANDOM_NET_NAME)])
    null_differences = np.array([_difference(rng.permutation(pooled)) for _ in range(PERMUTATIONS)])
    p_by_unit = {"hinges": p_value(abs(_difference(pooled)), abs(null_differences))}
    if len(shapes) >= LEAST_SURFACES_AS_UNITS:
        surface_distances = np.split(pooled, np.cumsum([len(surface) for surface in shapes])[:-1], axis=1)
        surface_differences = np.array([_difference(part) for part in surface_distances if part.shape[1]])
        signs = rng.choice([-1.0, 1.0], size=(PERMUTATIONS, len(surface_differences)))
        p_by_unit["surfaces"] = p_value(abs(surface_differences.sum()), abs(signs @ surface_differences))
    unit = max(p_by_unit, key=p_by_unit.__getitem__)
    return controls, p_by_unit[unit], unit


def _median_distances(distance: Array) -> Array:
    """Medians of the least distance in each row and in each column."""
    return np.array([np.median(distance.min(axis=axis)) for axis in (1, 0)])


def _difference(distance: Array) -> float:
    """Sum of both medians for the first half of the rows, less that for the second."""
    n_half = len(distance) // 2
    return (_median_distances(distance[:n_half]) - _median_distances(distance[n_half:])).sum()


def net_at_chance(shapes: Sequence[hinge_statistics.HingeShapes], *, seed: int = 0) -> Array | None:
    """Hinges of a ``hinge_statistics.random_net`` as dense as those of some surfaces; None if impossible."""
    per_area = float(np.mean([surface.per_area for surface in shapes]))
    if not 0 < per_area < MOST_HINGES_PER_AREA:
        return None
    return hinge_statistics.random_net(RANDOM_NET_HINGES, shortest=SHORTEST_ARM_IN_WIDTHS, per_area=per_area, seed=seed)


def _nearest_matches(distance: Array, pose: Ints, own: ShapesByName, others: ShapesByName) -> tuple[Match, ...]:
    own_hinges, other_hinges = (
        [(name, *hinge) for name, table in group.items() for hinge in zip(table.hinge.tolist(), table.kinds.tolist())]
        for group in (own, others)
    )
    matches = []
    for i, j in enumerate(distance.argmin(axis=1)):
        (surface, hinge, kind), (other_surface, other_hinge, _) = own_hinges[i], other_hinges[j]
        matches.append(Match(surface, hinge, other_surface, other_hinge, float(distance[i, j]), int(pose[i, j]), kind))
    return tuple(sorted(matches, key=attrgetter("distance")))


def examples(
    matches: Sequence[Match], count: int = 6, *, accept: Callable[[Match], bool] = lambda match: True
) -> list[Match]:
    """The best matches of different kinds, no hinge twice: the best of each of Y, T and V, then the next best.

    Only matches for which ``accept`` is true are taken.
    """
    chosen: dict[tuple[str, int], Match] = {}
    for only_new in (True, False):
        for match in matches:
            other_hinge, taken_kinds = (match.other_surface, match.other), [m.kind for m in chosen.values() if only_new]
            if len(chosen) < count and other_hinge not in chosen and match.kind not in taken_kinds and accept(match):
                chosen[other_hinge] = match
    return sorted(chosen.values(), key=attrgetter("distance"))
