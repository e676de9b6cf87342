"""The universal scaling law of folded cortices, and the independent shape terms that follow from it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from morphofold.errors import OutOfRange

if TYPE_CHECKING:
    from morphofold.analysis.measures import Measures


@dataclass(frozen=True)
class ShapeTerms:
    """Size and folding of one closed cortex.

    Attributes
    ----------
    total, exposed : float
        Area of the pial surface and of its convex hull [mm^2].
    thickness : float
        Mean cortical thickness [mm].
    k : float
        ``total thickness^(1/2) / exposed^(5/4)``, without unit.
    log_k, size, shape : float
        Decimal logarithms of ``k``, of ``total exposed thickness^2``, and of the remaining term
        ``total^(3/2) exposed^(3/4) / thickness^(9/2)``. The source calls them K, I and S. K and S do not change with
        size.
    """

    total: float
    exposed: float
    thickness: float
    k: float
    log_k: float
    size: float
    shape: float


def shape_terms(total: float, exposed: float, thickness: float) -> ShapeTerms:
    """The shape terms of a cortex with these areas [mm^2] and thickness [mm].

    Raises
    ------
    OutOfRange
        If one of them is not a positive number.

    Notes
    -----
    The law ``A_total sqrt(T) = k A_exposed^(5/4)`` is that of Mota and Herculano-Houzel 2015 (Science 349, 74). In the
    space of ``log A_total``, ``log A_exposed`` and ``log T^2`` it is a plane with the normal (1, -5/4, 1/4), which
    gives ``log_k``. The direction (1, 1, 1) is growth without change of shape and gives ``size``. The direction at
    right angles to both gives ``shape`` (Wang and others 2021, NeuroImage 226, 117546).
    """
    for name, value in (("total", total), ("exposed", exposed), ("thickness", thickness)):
        if not (math.isfinite(value) and value > 0):
            raise OutOfRange(f"{name} must be a positive number, got {value!r}.")
    a, e, t = math.log10(total), math.log10(exposed), 2 * math.log10(thickness)
    log_k = a - 5 / 4 * e + t / 4
    return ShapeTerms(total, exposed, thickness, 10**log_k, log_k, a + e + t, 3 / 2 * a + 3 / 4 * e - 9 / 4 * t)


def shape_terms_of(measures: Measures) -> ShapeTerms | None:
    """The shape terms of a measured cortex; None if it lacks one of the three numbers (not closed, or no thickness).

    Areas are of the whole closed surfaces, including the medial wall; the exposed area is that of the convex hull. The
    thickness is the mean over the vertices of the cortex.
    """
    area, index, thickness = (
        measures.scalars.get(key) for key in ("area_pial_mm2", "gyrification_index", "mean_cortical_thickness_mm")
    )
    return shape_terms(area, area / index, thickness) if area and index and thickness else None
