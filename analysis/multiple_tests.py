"""Correction of p-values for the number of tests."""

import numpy as np

from morphofold.frozen_arrays import Array

SIGNIFICANCE = 0.05


def holm(p: Array) -> Array:
    """p-values (N,) corrected for their number by Holm's step-down method (1979); NaN (no test) stays NaN."""
    corrected = np.full(len(p), np.nan)
    order = np.argsort(p, kind="stable")  # NaN last
    order = order[np.isfinite(p[order])]
    corrected[order] = np.minimum(np.maximum.accumulate(np.arange(len(order), 0, -1) * p[order]), 1.0)
    return corrected
