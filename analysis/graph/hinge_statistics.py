"""Shapes of three-hinge gyral patterns, independent of rotation, mirror and scale, and a random net to compare."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from morphofold.analysis.graph.hinges import counts
from morphofold.errors import MissingPart, NoSolution, OutOfRange
from morphofold.frozen_arrays import Array, Bools, Ints
from morphofold.shapes.spherical_nets import irregular_net
from morphofold.validators import check_kind

if TYPE_CHECKING:
    from morphofold.analysis.measures_result import Measures

FEATURES = ("angle", "length", "curvature", "sharpness")
#: features of any planar net; the others need a surface
PLANAR_NET_FEATURES = ("angle", "length")
#: arms, and angles to the next arm, in the three rotations of a hinge and the three of its mirror image
ARM_PERMUTATIONS = np.array([[(s + sense * k) % 3 for k in range(3)] for sense in (1, -1) for s in range(3)])
ANGLE_PERMUTATIONS = np.concatenate([ARM_PERMUTATIONS[:3], (ARM_PERMUTATIONS[3:] - 1) % 3])


@dataclass(frozen=True, eq=False)
class HingeShapes:
    """The K hinges of one surface that have three arms and are not doubtful.

    Attributes
    ----------
    hinge : (K,) int64
        Hinge numbers in the table of hinges.
    features : (K, 3, 4) float64
        For each arm, counter-clockwise seen from outside: the angle to the next arm [rad]; the natural logarithm of its
        length over the crown width; its mean geodesic curvature, and the mean curvature of the crown along it, both
        times the crown width. Each feature spreads by 0.3 to 0.5 over the hinges of a brain, so none outweighs the
        others in a sum.
    kinds : (K,) str
        ``Y``, ``T`` or ``V``, see :class:`morphofold.analysis.Hinge`.
    width : float
        Crown width of the surface [mm].
    per_area : float
        Number of all hinges with three arms or more that are not doubtful, per square of the crown width, on the white
        surface of the cortex.
    """

    hinge: Ints
    features: Array
    kinds: NDArray[np.str_]
    width: float
    per_area: float

    def __repr__(self) -> str:
        return f"HingeShapes({len(self)} hinges with three arms, crown width {self.width:.3g} mm)"

    def __len__(self) -> int:
        return len(self.hinge)

    def numbers(self) -> dict[str, Array]:
        """Plotted quantities of each hinge (K,): least and largest angle [degrees], geometric mean of the arm lengths
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
    """Shapes of the three-armed hinges of a cortex, from its tables, without doubtful ones (confidence below 0.25).

    An arm without mean curvature (its crest is outside the cortex) gets the mean of the other arms of its hinge. A
    hinge is left out if none of its arms has one.

    Returns
    -------
    HingeShapes or None
        None if the cortex has no gyral graph, or was measured without its tables or areas.

    Raises
    ------
    MissingPart
        If the table of arms does not name their crests, as in older analyses.
    """
    from morphofold.analysis.measures_result import Measures

    check_kind(measures, Measures, "hinge_shapes: measures")
    width, vertex_area = measures.parameters.get("graph_width_mm"), measures.maps.get("area")
    measured_tables = measures.parameters.get("only", ("crests", "hinges", "arms"))
    if not width or vertex_area is None or not {"crests", "hinges", "arms"} <= set(measured_tables):
        return None
    if any("crest" not in row for row in measures.arms):
        raise MissingPart(f"{measures.cortex.name}: the table of arms does not name their crests. Analyze it again.")
    H_by_crest = {row["crest"]: row["mean_H_per_mm"] for row in measures.crests}
    arm_rows: dict[int, list[list[float]]] = {}
    for row in measures.arms:
        arm_sharpness = H_by_crest.get(row["crest"])
        arm_rows.setdefault(row["hinge"], []).append(
            [
                np.radians(row["angle_deg"]),
                np.log(row["length_mm"] / width),
                row["curvature_per_mm"] * width,
                np.nan if arm_sharpness is None else arm_sharpness * width,
            ]
        )
    sure_hinges = [row for row in measures.hinges if counts(row)]
    three_armed = [row for row in sure_hinges if row["degree"] == 3]
    features = np.array([arm_rows[row["hinge"]] for row in three_armed], dtype=np.float64).reshape(-1, 3, len(FEATURES))
    is_known = np.isfinite(features[:, :, 3])
    mean_sharpness = np.where(is_known, features[:, :, 3], 0).sum(axis=1) / np.maximum(is_known.sum(axis=1), 1)
    features[:, :, 3] = np.where(is_known, features[:, :, 3], mean_sharpness[:, None])
    has_sharpness = is_known.any(axis=1)
    cortex_area = float(vertex_area[np.isfinite(measures.maps["H"])].sum())
    return HingeShapes(
        np.array([row["hinge"] for row in three_armed], dtype=np.int64)[has_sharpness],
        features[has_sharpness],
        np.array([row["shape"] for row in three_armed], dtype=np.str_)[has_sharpness],
        float(width),
        len(sure_hinges) * float(width) ** 2 / cortex_area,
    )


def together(shapes: Sequence[HingeShapes]) -> Array:
    """Features (sum of K, 3, 4) of the hinges of several surfaces, concatenated."""
    return np.concatenate([shape.features for shape in shapes]) if shapes else np.empty((0, 3, len(FEATURES)))


def shape_distance(a: Array, b: Array, *, of: Sequence[str] = FEATURES) -> tuple[Array, Ints]:
    """Distances between hinges, and the pose of the second hinge in which it is nearest.

    Parameters
    ----------
    a, b : (K, 3, 4) and (L, 3, 4) float64
        Features as in :class:`HingeShapes`.
    of : sequence of str
        The :data:`FEATURES` to use, which must be known of every arm.

    Returns
    -------
    distance : (K, L) float64
        Root mean square difference of the features, the least over the six poses of one hinge on another: three
        rotations, and three of the mirror image.
    pose : (K, L) int64
        0 to 2: the arm of ``b`` that lies on the first arm of ``a``; the others follow in the same sense. 3 to 5: arm
        ``pose - 3``, with the others in the opposite sense.
    """
    feature_index = [FEATURES.index(name) for name in of]
    least_square, pose = np.full((len(a), len(b)), np.inf), np.zeros((len(a), len(b)), dtype=np.int64)
    for pose_number, (arm_order, angle_order) in enumerate(zip(ARM_PERMUTATIONS, ANGLE_PERMUTATIONS)):
        posed_b = b[:, arm_order].copy()
        posed_b[:, :, 0] = b[:, angle_order, 0]
        square_sum = np.zeros(least_square.shape)
        for feature in feature_index:
            for arm in range(3):
                square_sum += (a[:, None, arm, feature] - posed_b[None, :, arm, feature]) ** 2
        is_nearer = square_sum < least_square
        least_square[is_nearer], pose[is_nearer] = square_sum[is_nearer], pose_number
    return np.sqrt(least_square / (3 * len(feature_index))), pose


@dataclass(frozen=True)
class TwoSample:
    """Energy distance of two samples, and how often a random division has at least as much.

    ``statistic`` is 0 for two identical samples, and tends to 0 with growing size for two samples of one distribution.
    ``p`` is the p-value of a permutation test; ``n`` and ``m`` are the sizes.
    """

    statistic: float
    p: float
    n: int
    m: int


def two_sample(distance: Array, n: int, *, permutations: int = 999, seed: int = 0) -> TwoSample:
    """Test whether the first ``n`` hinges have the same shapes as the others, from all distances between them.

    Parameters
    ----------
    distance : (N, N) float64
        Symmetric, 0 on the diagonal.
    n : int
        Size of the first sample, 0 < n < N.
    permutations, seed : int
        Number and seed of the random divisions.

    Returns
    -------
    TwoSample

    Notes
    -----
    The statistic is ``2 E|X - Y| - E|X - X'| - E|Y - Y'|`` (Szekely and Rizzo 2013, J. Stat. Plan. Inference 143). Its
    p-value assumes that hinges are exchangeable. Hinges of one surface are neighbours and share arms, so a small p is
    weaker evidence than it seems.
    """
    n_hinges = len(distance)
    rng, in_first = np.random.default_rng(seed), np.arange(n_hinges) < n
    energy = _energy_distance(distance, in_first[None])[0]
    divisions = np.array([rng.permutation(in_first) for _ in range(permutations)])
    n_as_large = np.count_nonzero(_energy_distance(distance, divisions) >= energy - 1e-12)
    return TwoSample(float(energy), float(1 + n_as_large) / (1 + permutations), n, n_hinges - n)


def _energy_distance(distance: Array, in_first: Bools) -> Array:
    """Energy distance of each division (D, N) into a first and a second sample."""
    membership = in_first.astype(np.float64)
    distance_sums, n = membership @ distance, in_first[0].sum()
    m, within_first = in_first.shape[1] - n, np.sum(distance_sums * membership, axis=1)
    across_samples = distance_sums.sum(axis=1) - within_first
    within_second = distance.sum() - 2 * across_samples - within_first
    return np.asarray(2 * across_samples / (n * m) - within_first / n**2 - within_second / m**2)


def random_net(hinges: int, *, shortest: float, per_area: float, seed: int = 0) -> Array:
    """Features (K, 3, 4) of the hinges of a random net: the Voronoi borders between random points on a sphere.

    Parameters
    ----------
    hinges : int
        Approximate number of hinges of the net.
    shortest : float
        Least length of arms in crown widths. A gyral graph merges the two hinges of a shorter arm into one hinge with
        four arms, so both are left out.
    per_area : float
        Hinges with any number of arms per square of the crown width; it sets the scale.
    seed : int
        Seed of the random points.

    Raises
    ------
    ValueError
        If a number is not positive (``shortest``: negative), or no scale gives that many hinges.

    Notes
    -----
    The net is the Voronoi net of a Poisson process, with straight arms and random angles and lengths. Curvature and
    sharpness are NaN: compare by :data:`PLANAR_NET_FEATURES`.
    """
    if not (hinges > 0 and shortest >= 0 and 0 < per_area < np.inf):
        raise OutOfRange(
            f"a net needs positive numbers, got {hinges} hinges, a shortest arm of {shortest} and {per_area} hinges "
            "per area."
        )
    net = irregular_net(max(hinges // 2 + 2, 6), seed, n_rounds=0)
    width = _width_of_density(net.lengths, len(net.nodes), shortest, per_area)
    points = net.nodes
    ends = np.concatenate([net.arcs, net.arcs[:, ::-1]])
    neighbours = ends[np.argsort(ends[:, 0], kind="stable"), 1].reshape(-1, 3)  # every node of this net has three arcs
    offset = points[neighbours] - np.sum(points[neighbours] * points[:, None], axis=2, keepdims=True) * points[:, None]
    across = np.cross(points, offset[:, 0])
    azimuth = np.arctan2(np.sum(offset * across[:, None], axis=2), np.sum(offset * offset[:, :1], axis=2)) % (2 * np.pi)
    arm_order = np.argsort(azimuth, axis=1)
    azimuth = np.take_along_axis(azimuth, arm_order, axis=1)
    arm_length = np.arccos(np.clip(np.sum(points[neighbours] * points[:, None], axis=2), -1, 1)) / width
    features = np.full((len(points), 3, len(FEATURES)), np.nan)
    features[:, :, 0] = np.diff(azimuth, axis=1, append=2 * np.pi + azimuth[:, :1])
    features[:, :, 1] = np.log(np.take_along_axis(arm_length, arm_order, axis=1))
    return features[arm_length.min(axis=1) >= shortest]


def _width_of_density(lengths: Array, n_nodes: int, shortest: float, per_area: float) -> float:
    """Crown width [rad] where ``n_nodes``, less one for each arc that is too short, have the density ``per_area``."""
    n_hinges = n_nodes
    for _ in range(100):
        width = float(np.sqrt(per_area * 4 * np.pi / n_hinges))
        n_long_enough = n_nodes - int(np.count_nonzero(lengths < shortest * width))
        if n_long_enough == n_hinges:
            return width
        if n_long_enough <= n_nodes // 4:
            break
        n_hinges = n_long_enough
    raise NoSolution(f"{per_area:g} hinges per square of the width are too dense for arms of {shortest:g} widths.")
