"""Sweeps made by hand, for tests of their diagrams and their page."""

from morphofold.group.sweep import HINGES_PER_AREA, Phases, RunResult, SphereTheory
from morphofold.group.sweep_grid import make_grid
from morphofold.group_pages.phase_plots import SHOWN_MEASURES, WAVELENGTH_KEY

GI, LENGTH, HINGES = SHOWN_MEASURES
VARY = ("cortex_thickness=1,2,3", "growth.final=1.2,1.8")


def gi(at, seed):
    """A made-up gyrification index, other at each point: 1.2 to 1.7, and 0.1 more or less with the seeds."""
    return 1.2 + 0.1 * sum(at[:1]) + 0.3 * sum(at[1:]) + (0.1 if seed else -0.1)


def made_sweep(vary=VARY, *, broken=(), pial=None, seeds=2, theory=None, scene="demo", **numbers):
    """A sweep with made-up measures; ``broken`` are (place, seed) that failed."""
    grid = make_grid(scene, vary, seeds=seeds)
    runs = []
    for point in grid.points:
        if (point.grid_index, point.seed) in broken:
            runs.append(RunResult(point, "left its bounds <at once>"))
            continue
        values = {GI.key: gi(point.grid_index, point.seed), WAVELENGTH_KEY: 20.0, HINGES_PER_AREA: 3.0, **numbers}
        finite = {key: value for key, value in values.items() if value is not None}
        runs.append(RunResult(point, "", finite, {WAVELENGTH_KEY: "no folds"}, pial=pial))
    theories = dict.fromkeys(grid.scenes, theory or SphereTheory(1.5, 1.6, 10.0))
    return Phases(grid, tuple(runs), theories)
