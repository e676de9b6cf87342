"""Peaks of a function on a surface that rise above the passes to higher ground: gyri, or of -values sulci."""

import numpy as np

from morphofold import geometry
from morphofold.analysis.graph.watershed import Watershed
from morphofold.errors import NotFinite, OutOfRange, WrongShape
from morphofold.frozen_arrays import Ints
from morphofold.surface import Faces, PerVertex


def prominent_peaks(faces: Faces, values: PerVertex, least: float) -> Ints:
    """Vertices of the peaks that rise by ``least`` or more above the pass to higher ground.

    Parameters
    ----------
    faces : (M, 3) int64
        Triangles; vertices that no triangle uses are left out.
    values : (N,) float64
        Height, in any unit. Pass ``-values`` for the pits.
    least : float
        Least prominence of a peak, in the unit of the values; >= 0.

    Returns
    -------
    peaks : (P,) int64
        Vertices, the most prominent first, ties by height and then by number. The highest vertex of every connected
        piece is always among them. A piece of constant height has one peak.

    Raises
    ------
    ValueError
        If a used vertex has no finite height, there are too few values, or ``least`` is negative or NaN.

    Notes
    -----
    Imagine a flooded surface and a falling water level. A peak appears as an island, and islands join at passes. The
    prominence of a peak is its height above the pass at which its island joins one with a higher peak (its
    *persistence* in topology). If two heights on one mesh differ by e at most everywhere, then every peak of the first
    with prominence p > 2 e has its own partner of p - 2 e or more in the second (Cohen-Steiner, Edelsbrunner, Harer
    2007, Discrete Comput. Geom. 37, 103). So ripples of the mesh do not count, and the number of peaks changes only if
    prominences are near ``least``.
    """
    values = np.asarray(values, dtype=np.float64)
    if not least >= 0:
        raise OutOfRange(f"least must be a prominence of 0 or more, got {least}.")
    if len(values) <= faces.max():
        raise WrongShape(f"faces name vertex {faces.max()}, but there are {len(values)} values.")
    is_used = geometry.used(len(values), faces)
    if not np.isfinite(values[is_used]).all():
        n_bad = np.count_nonzero(~np.isfinite(values[is_used]))
        raise NotFinite(f"{n_bad} of {np.count_nonzero(is_used)} vertices have no finite height. Remove their faces.")
    edges = geometry.edges(faces)
    watershed = Watershed(edges, np.ones(len(edges)), np.where(is_used, -values, 0.0), np.zeros(len(values)))
    prominence = np.full(len(watershed.lowest), np.inf)
    prominence[watershed.filled] = watershed.heights
    is_peak = is_used[watershed.lowest] & (prominence >= least) & (prominence > 0)  # 0: a corner of a plateau
    peaks = watershed.lowest[is_peak]
    return peaks[np.lexsort((peaks, -values[peaks], -prominence[is_peak]))]
