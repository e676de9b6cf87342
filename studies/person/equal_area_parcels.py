"""Parcels of about equal area on a sphere, for surfaces with and without a parcellation of their own."""

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from morphofold.analysis.thickness.gyral_thickness import GyralThickness, gyral_thickness, weighted_quantile
from morphofold.frozen_arrays import Array, Ints
from morphofold.geometry import unit
from morphofold.shapes import even_directions
from morphofold.surface import Cortex

N_PARCELS = 40  # on the whole sphere: as large as regions of a usual parcellation
LEAST_CONTOUR_IN_WIDTHS = 2.0  # as in tables of regions: less is a single fold


def parcel_of(points: Array) -> Ints:
    """Number of the parcel of points (P, 3) of the unit sphere."""
    return np.asarray(cKDTree(even_directions(N_PARCELS)).query(points)[1])


class Widths(NamedTuple):
    """Gyral thickness of each parcel (N_PARCELS,) [mm], NaN where folds are too few; its median over the surface."""

    of_parcel: Array
    median: float


def gyral_widths(cortex: Cortex) -> Widths:
    """Median gyral thickness by parcel of a surface with a sphere, without its medial wall."""
    assert cortex.sphere is not None
    thickness: GyralThickness = gyral_thickness(cortex)
    sample_points = unit(cortex.sphere.verts)[cortex.faces[thickness.triangle]].mean(axis=1)
    parcel_index, parcel_widths = parcel_of(sample_points), np.full(N_PARCELS, np.nan)
    for k in range(N_PARCELS):
        is_in_parcel = (parcel_index == k) & np.isfinite(thickness.width)
        if thickness.weight[is_in_parcel].sum() >= LEAST_CONTOUR_IN_WIDTHS * thickness.median:
            parcel_widths[k] = weighted_quantile(thickness.width[is_in_parcel], thickness.weight[is_in_parcel], 0.5)
    return Widths(parcel_widths, thickness.median)


def parcel_means(values: Array, parcel_index: Ints, weights: Array) -> Array:
    """Weighted mean (N_PARCELS,) of values (P,) by parcel; NaN where there is no weight."""
    total_weights = np.bincount(parcel_index, weights, N_PARCELS)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.bincount(parcel_index, weights * values, N_PARCELS) / total_weights
