"""Whether the residual variance of a linear model depends on what is tested."""

import numpy as np
from scipy import stats

from morphofold.arrays import Array

LEAST_FREEDOM = 1e-6


def variance_trend(errors: Array, freedom: Array, regressor: Array) -> tuple[float, float]:
    """Largest over smallest residual variance along a regressor, and p that it does not depend on it.

    Parameters
    ----------
    errors : (S, N) float64
        Residuals of the whole model.
    freedom : (S,) float64
        Degrees of freedom of each subject's residuals, between 0 and 1.
    regressor : (S,) float64

    Returns
    -------
    ratio, p : float
        NaN if the regressor has one value.

    Notes
    -----
    Squared residuals over their mean at each vertex are averaged over the vertices: a number for each subject. Their
    logarithms are fitted by the regressor and its square, and p is that of the F test, as Breusch and Pagan 1979
    (Econometrica 47) do for one variable. Subjects are the units, so vertices may depend on each other.
    """
    known = freedom > LEAST_FREEDOM
    scale = (errors**2).mean(axis=0)
    relative = (errors[:, scale > 0] ** 2 / scale[scale > 0]).mean(axis=1)[known] / freedom[known]
    logs, x = np.log(np.maximum(relative, np.finfo(float).tiny)), regressor[known]
    x = (x - x.mean()) / (np.ptp(x) or 1.0)
    powers = np.column_stack([np.ones(len(x)), x, x**2])[:, : min(len(np.unique(x.round(9))), 3)]
    if powers.shape[1] < 2 or len(x) <= powers.shape[1]:
        return np.nan, np.nan
    fitted = powers @ np.linalg.lstsq(powers, logs, rcond=None)[0]
    explained, left = ((fitted - logs.mean()) ** 2).sum(), ((logs - fitted) ** 2).sum()
    df = powers.shape[1] - 1, len(x) - powers.shape[1]
    return float(np.exp(np.ptp(fitted))), float(stats.f.sf(explained / df[0] * df[1] / max(left, 1e-300), *df))
