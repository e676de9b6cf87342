"""Shapes of three-hinge gyral patterns, free of rotation, mirror and scale, and what to compare them with."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from morphofold.ridges import irregular_net

if TYPE_CHECKING:
    from morphofold.analysis.measures import Measures

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

FEATURES = ("angle", "length", "curvature", "sharpness")
#: features that any planar net has; the others need a surface
OF_A_NET = ("angle", "length")
#: arms, and angles to the next arm, in the three turns of a hinge and the three of its mirror image
ARMS = np.array([[(s + sense * k) % 3 for k in range(3)] for sense in (1, -1) for s in range(3)])
ANGLES = np.concatenate([ARMS[:3], (ARMS[3:] - 1) % 3])


@dataclass(frozen=True, eq=False)
class HingeShapes:
    """The K hinges of one surface that have three arms.

    Attributes
    ----------
    hinge : (K,) int64
        Their numbers in the table of hinges.
    features : (K, 3, 4) float64
        For each arm, counter-clockwise seen from outside: the angle to the next arm [rad], the natural logarithm of
        its length over the gyral width, its mean geodesic curvature, and the mean curvature of the crown along it, both
        times the gyral width. 0 where the surface has no such value (a net alone).
    kinds : (K,) str
        ``Y``, ``T`` or ``V``, see :class:`morphofold.analysis.Hinge`.
    width : float
        Gyral width of the surface [mm].
    per_area : float
        All its hinges, with three arms or more, per square of the gyral width.
    """

    hinge: Ints = field(repr=False)
    features: Array = field(repr=False)
    kinds: NDArray[np.str_] = field(repr=False)
    width: float
    per_area: float

    def __len__(self) -> int:
        return len(self.hinge)

    def numbers(self) -> dict[str, Array]:
        """What is plotted of each hinge (K,): least and largest angle [degrees], geometric mean of the arms' lengths
        over the width, mean of their curvature and of their sharpness, both times the width."""
        angle, length, curvature, sharpness = np.moveaxis(self.features, 2, 0)
        return {
            "smallest angle, degrees": np.degrees(angle.min(axis=1)),
            "largest angle, degrees": np.degrees(angle.max(axis=1)),
            "length / width": np.exp(length.mean(axis=1)),
            "curvature × width": curvature.mean(axis=1),
            "sharpness × width": sharpness.mean(axis=1),
        }


def hinge_shapes(measures: Measures) -> HingeShapes | None:
    """Shapes of the three-armed hinges of a cortex, from its tables; None if it has no gyral graph.

    A crest without mean curvature (all of it off the cortex) counts as having the mean of the others of its hinge.
    """
    width = measures.parameters.get("graph_width_mm")
    area = measures.scalars.get("area_pial_mm2")
    if not width or not area:
        return None
    bent = {row["crest"]: row["mean_H_per_mm"] for row in measures.crests}
    arms: dict[int, list[list[float]]] = {}
    for row in measures.arms:
        sharp = bent.get(row.get("crest"))
        arms.setdefault(row["hinge"], []).append([
            np.radians(row["angle_deg"]), np.log(row["length_mm"] / width), row["curvature_per_mm"] * width,
            np.nan if sharp is None else sharp * width,
        ])  # fmt: skip
    mine = [row for row in measures.hinges if row["degree"] == 3]
    features = np.array([arms[row["hinge"]] for row in mine], dtype=np.float64).reshape(-1, 3, len(FEATURES))
    features[:, :, 3] = _filled(features[:, :, 3])
    return HingeShapes(
        np.array([row["hinge"] for row in mine], dtype=np.int64), features,
        np.array([row["shape"] for row in mine], dtype=np.str_), float(width),
        len(measures.hinges) * float(width) ** 2 / float(area),
    )  # fmt: skip


def _filled(values: Array) -> Array:
    """NaN replaced by the mean of the row, or 0 where the row has none."""
    known = np.isfinite(values)
    total = np.where(known, values, 0).sum(axis=1, keepdims=True)
    return np.where(known, values, total / np.maximum(known.sum(axis=1, keepdims=True), 1))


def together(shapes: Sequence[HingeShapes]) -> Array:
    """Features (sum K, 3, 4) of several surfaces."""
    return np.concatenate([s.features for s in shapes]) if shapes else np.empty((0, 3, len(FEATURES)))


def shape_distance(a: Array, b: Array, *, of: Sequence[str] = FEATURES) -> tuple[Array, Ints]:
    """Distances between hinges, and the pose of the second in which it is nearest.

    Parameters
    ----------
    a, b : (K, 3, 4) and (L, 3, 4) float64
        Features as in :class:`HingeShapes`.
    of : sequence of str
        Those of :data:`FEATURES` that count.

    Returns
    -------
    distance : (K, L) float64
        Root mean square difference of the features, the least over the six ways to lay one hinge on another: three
        turns, and three of the mirror image.
    pose : (K, L) int64
        0 to 2: the arm of ``b`` that lies on the first of ``a``, the others following in the same sense; 3 to 5: arm
        ``pose - 3``, in the other sense.
    """
    chosen = [FEATURES.index(name) for name in of]
    least, pose = np.full((len(a), len(b)), np.inf), np.zeros((len(a), len(b)), dtype=np.int64)
    for k, (arms, angles) in enumerate(zip(ARMS, ANGLES)):
        laid = b[:, arms].copy()
        laid[:, :, 0] = b[:, angles, 0]
        square = np.zeros(least.shape)
        for f in chosen:
            for arm in range(3):
                square += (a[:, None, arm, f] - laid[None, :, arm, f]) ** 2
        nearer = square < least
        least[nearer], pose[nearer] = square[nearer], k
    return np.sqrt(least / (3 * len(chosen))), pose


@dataclass(frozen=True)
class TwoSample:
    """Energy distance of two samples, and how often a division at chance has as much.

    ``statistic`` is 0 for equal distributions; ``p`` that of a permutation test; ``n``, ``m`` the sizes.
    """

    statistic: float
    p: float
    n: int
    m: int


def two_sample(distance: Array, n: int, *, permutations: int = 999, seed: int = 0) -> TwoSample:
    """Whether the first ``n`` of some hinges are shaped as the others, from all distances between them.

    Parameters
    ----------
    distance : (N, N) float64
        Symmetric, 0 on the diagonal.
    n : int
        Size of the first sample, 0 < n < N.
    permutations, seed : int
        Of the divisions at chance.

    Notes
    -----
    ``2 E|X - Y| - E|X - X'| - E|Y - Y'|`` (Szekely and Rizzo 2013, J. Stat. Plan. Inference 143). Its p-value takes
    hinges as exchangeable: those of one surface are neighbours and share arms, so a small p says less than it seems.

    Raises
    ------
    ValueError
        If a sample is empty.
    """
    size = len(distance)
    if not 0 < n < size:
        raise ValueError(f"two samples are needed, got {n} of {size}.")
    rng, first = np.random.default_rng(seed), np.arange(size) < n
    inside = np.stack([first, *(rng.permutation(first) for _ in range(permutations))])
    energy = np.array([_energy(distance, mine) for mine in inside])
    as_much = np.count_nonzero(energy[1:] >= energy[0] - 1e-12)
    return TwoSample(float(energy[0]), (1 + as_much) / (1 + permutations), n, size - n)


def _energy(distance: Array, first: NDArray[np.bool_]) -> float:
    rows = distance[first]
    across, mine = rows[:, ~first], rows[:, first]
    return float(2 * across.mean() - mine.mean() - distance[~first][:, ~first].mean())


def random_net(hinges: int, *, shortest: float, per_area: float, seed: int = 0) -> Array:
    """Features (K, 3, 4) of the hinges of a net at chance: the borders between points put on a sphere at random.

    Parameters
    ----------
    hinges : int
        About how many the net has.
    shortest : float
        Arms are no shorter, in gyral widths; hinges with such an arm are left out, as a gyral graph joins those.
    per_area : float
        Hinges per square of the gyral width, which sets the scale.
    seed : int

    Notes
    -----
    A Voronoi net of a Poisson process: straight arms, angles and lengths as chance has them. Curvature and sharpness
    are 0: compare by :data:`OF_A_NET`.
    """
    net = irregular_net(max(hinges // 2 + 2, 6), seed, rounds=0)
    at, width = net.nodes, np.sqrt(per_area * 4 * np.pi / len(net.nodes))
    ends = np.concatenate([net.arcs, net.arcs[:, ::-1]])
    to = ends[np.argsort(ends[:, 0], kind="stable"), 1].reshape(-1, 3)      # every node of such a net has three arcs
    flat = at[to] - np.sum(at[to] * at[:, None], axis=2, keepdims=True) * at[:, None]
    across = np.cross(at, flat[:, 0])
    azimuth = np.arctan2(np.sum(flat * across[:, None], axis=2), np.sum(flat * flat[:, :1], axis=2)) % (2 * np.pi)
    order = np.argsort(azimuth, axis=1)
    azimuth = np.take_along_axis(azimuth, order, axis=1)
    angle = np.diff(azimuth, axis=1, append=2 * np.pi + azimuth[:, :1])
    length = np.arccos(np.clip(np.sum(at[to] * at[:, None], axis=2), -1, 1)) / width
    length = np.take_along_axis(length, order, axis=1)
    found = np.zeros((len(at), 3, len(FEATURES)))
    found[:, :, 0], found[:, :, 1] = angle, np.log(length)
    return found[length.min(axis=1) >= shortest]
