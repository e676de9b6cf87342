"""Correction of p-values for the number of tests."""

import numpy as np

from morphofold.frozen_arrays import Array

SIGNIFICANCE = 0.05


def holm(p: Array) -> Array:
    """p-values (N,) corrected for their number by Holm's step-down method (1979); NaN (no test) stays NaN."""
    corrected_p = np.full(len(p), np.nan)
    p_order = np.argsort(p, kind="stable")  # NaN last
    p_order = p_order[np.isfinite(p[p_order])]
    corrected_p[p_order] = np.minimum(np.maximum.accumulate(np.arange(len(p_order), 0, -1) * p[p_order]), 1.0)
    return corrected_p
