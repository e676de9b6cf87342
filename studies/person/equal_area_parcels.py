"""Parcels of about equal area on a sphere, for surfaces with and without a parcellation of their own."""

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from morphofold.analysis.thickness.gyral_thickness import GyralThickness, gyral_thickness, weighted_quantile
from morphofold.frozen_arrays import Array, Ints
from morphofold.geometry import unit
from morphofold.shapes import even_directions
from morphofold.surface import Cortex

PARCELS = 40  # on the whole sphere: as large as regions of a usual parcellation
LEAST_CONTOUR_IN_WIDTHS = 2.0  # as in tables of regions: less is a single fold


def parcel_of(points: Array) -> Ints:
    """Number of the parcel of points (P, 3) of the unit sphere."""
    return np.asarray(cKDTree(even_directions(PARCELS)).query(points)[1])


class Widths(NamedTuple):
    """Gyral thickness of each parcel (PARCELS,) [mm], NaN where folds are too few; its median over the surface."""

    of_parcel: Array
    median: float


def gyral_widths(cortex: Cortex) -> Widths:
    """Median gyral thickness by parcel of a surface with a sphere, without its medial wall."""
    assert cortex.sphere is not None
    gyri: GyralThickness = gyral_thickness(cortex)
    points = unit(cortex.sphere.verts)[cortex.faces[gyri.triangle]].mean(axis=1)
    parcel, widths = parcel_of(points), np.full(PARCELS, np.nan)
    for k in range(PARCELS):
        is_in_parcel = (parcel == k) & np.isfinite(gyri.width)
        if gyri.weight[is_in_parcel].sum() >= LEAST_CONTOUR_IN_WIDTHS * gyri.median:
            widths[k] = weighted_quantile(gyri.width[is_in_parcel], gyri.weight[is_in_parcel], 0.5)
    return Widths(widths, gyri.median)


def parcel_means(values: Array, parcel: Ints, weights: Array) -> Array:
    """Weighted mean (PARCELS,) of values (P,) by parcel; NaN where there is no weight."""
    total_weights = np.bincount(parcel, weights, PARCELS)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.bincount(parcel, weights * values, PARCELS) / total_weights
