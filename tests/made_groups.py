"""Groups made by hand, for tests of their statistics and their page."""

import numpy as np

from morphofold.analysis.measures_result import SCALARS
from morphofold.group.group_tables import Group

#: mean of made-up measures, and how far they lie from it at most
MEASURES = {
    "area_pial_mm2": (110_000, 9000),
    "gyrification_index": (2.8, 0.12),
    "mean_cortical_thickness_mm": (2.5, 0.1),
    "median_gyral_thickness_mm": (11.0, 0.6),
    "mean_sulcal_depth_mm": (9.0, 0.5),
    "wavelength_mm": (30.0, 1.5),
}


def made_group(n, *, seed=0, failures=(), remarks=None, results=None, same=(), names=None, simulated=0, **scalars):
    """``n`` subjects with measures spread evenly, nobody far out, the same on both sides but for noise; Euler number 2.

    ``scalars`` (n, 2) take the place of those made up; measures that are neither are unknown.
    """
    rng = np.random.default_rng(seed)
    names = tuple(names or (f"sub-{k:05d}" for k in range(n)))
    values = {name: np.full((n, 2), np.nan) for name in SCALARS}
    for name, (mean, most) in MEASURES.items():
        values[name] = mean + most * (rng.uniform(-0.9, 0.9, (n, 1)) + rng.uniform(-0.1, 0.1, (n, 2)))
    values["euler_characteristic"] = np.full((n, 2), 2.0)
    values |= scalars
    regions = {}
    for name, cortical in (("cuneus", 1.9), ("insula", 3.0), ("precentral", 2.5), ("superiorfrontal", 2.8)):
        side = [[n, cortical, 0.1], [n, 3 * cortical + 2, 0.5]]
        regions[name] = np.array([side, side])
    if not n:
        regions = {}
    results = results or {name: f"nowhere/{name}" for name in names}
    return Group(names, values, regions, list(failures), dict(remarks or {}), results, list(same), simulated)


def failed_group(n, reason="lh.white: no such file."):
    """A group of which nobody could be measured."""
    group = made_group(n)
    nothing = {name: np.full((n, 2), np.nan) for name in SCALARS}
    failures = [
        {"subject": name, "hemi": hemi, "reason": reason, "log": f"logs/{name}.log"}
        for name in group.subjects
        for hemi in ("lh", "rh")
    ]
    return Group(group.subjects, nothing, {}, failures, {}, group.result_folders)
