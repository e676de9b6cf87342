"""Error against time of the solver for a folded body: compared with the finest mesh, and along each axis."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from morphofold import analysis
from morphofold.forecasts.richardson import coarser, meshed, stage_estimate
from morphofold.frozen_arrays import Array
from morphofold.io import atomic_file
from morphofold.io.files import decoding, existing_file
from morphofold.progress_callbacks import Progress, logged
from morphofold.sim.dynamics import State
from morphofold.sim.effects import build_effects
from morphofold.sim.nested_meshes import NestedDynamics
from morphofold.sim.output.stage_surfaces import whole_surfaces
from morphofold.studies.accuracy.error_points import RERUN_ADVICE, Point, Timing
from morphofold.studies.accuracy.solver_settings import FINEST_SETTING, Setting
from morphofold.studies.surface_distance import distance
from morphofold.surface import Surface
from morphofold.timing import working_seconds

STAGE_GROWTHS = (1.5, 2.0)  # growths at which folds are measured: sulci are closed; the end of growth
FINEST_MESH = "finest mesh"
OWN_LIMIT = "limit of its folds"  # without the error of the mesh: StageEstimate.corrected
#: longest edge over T, and fewest elements through the cortex, for which there is such a limit: folds are lost on
#: coarser meshes, and one element bursts there
MOST_EDGE_OF_LIMIT, LEAST_LAYERS_OF_LIMIT = 0.65, 2
#: axes whose last setting is the most accurate; for the other axes it is the finest mesh
LIMIT_AXES = ("layers", "kappa", "pace", "contact", "precision")
NUMBER_NAMES = ("gyrification index", "wavelength", "strain energy")


class Folds(NamedTuple):
    """A grown body at one growth: its pial surface and its measured numbers.

    Attributes
    ----------
    pial : Surface
        Closed [mm].
    measures : mapping
        ``NUMBER_NAMES`` by name: the gyrification index of the pial surface, the wavelength [mm] of the power spectrum
        of its height on the ungrown sphere, the energy of the body in units of the modulus of the core times mm^3.
    n_elements, n_steps : int
    seconds : float
        Wall time of all steps of the whole run.
    error : float
        Of the gyrification index, from the mesh alone; NaN if it is not known.
    """

    pial: Surface
    measures: Mapping[str, float]
    n_elements: int
    n_steps: int
    seconds: float
    error: float = math.nan


def simulated_folds(setting: Setting, cache: Path, show: Progress = logged) -> dict[float, Folds]:
    """Folds at each of ``STAGE_GROWTHS``, read from the file ``cache`` (.npz), or grown now and written there."""
    if not cache.exists():
        arrays = _grow(setting, show)
        with atomic_file(cache) as temporary_path, temporary_path.open("wb") as cache_file:
            np.savez(cache_file, **arrays)  # type: ignore[arg-type]
    with decoding(cache, "folds of a study", RERUN_ADVICE), np.load(existing_file(cache, "file of folds")) as arrays:
        return {g: _folds(arrays, g) for g in STAGE_GROWTHS}


def _grow(setting: Setting, show: Progress) -> dict[str, Array]:
    scene, final_growth = setting.scene(), STAGE_GROWTHS[-1]
    on_one_mesh = setting.dynamics(with_folds=True)
    body, meshes = on_one_mesh.body, []
    dynamics = NestedDynamics(scene, build_effects(scene)) if setting.nested else on_one_mesh
    is_fine_enough = setting.edge <= MOST_EDGE_OF_LIMIT and setting.through >= LEAST_LAYERS_OF_LIMIT
    if setting.element == "brick" and is_fine_enough:
        meshes = [meshed(scene), meshed(coarser(scene))]
    show_growth = lambda state: show((state.growth - 1) / (final_growth - 1), f"{setting.label}, g {state.growth:.2f}")
    sphere_verts = whole_surfaces(body, np.ascontiguousarray(body.bilayer.mesh.p.T))[1].verts
    arrays: dict[str, Any] = {}
    seconds = 0.0
    for g in STAGE_GROWTHS:
        began_at = working_seconds()
        dynamics.grow_to(g, show_growth)
        dynamics.settle(show_growth, lambda: None)
        seconds += working_seconds() - began_at
        pial = whole_surfaces(body, dynamics.state.x)[1]
        spectrum = analysis.power_spectrum(sphere_verts, pial.faces, np.linalg.norm(pial.verts, axis=1))
        fold_numbers = (
            analysis.gyrification_index(pial.verts, pial.faces),
            spectrum.wavelength,
            dynamics.state.record["strain_energy"] / body.bilayer.portion,
        )
        state = State(dynamics.state.x.copy(), np.zeros_like(body.X), growth=g)
        error = stage_estimate(state, *meshes).error if meshes else math.nan
        arrays |= {f"{g}.verts": pial.verts, f"{g}.faces": pial.faces, f"{g}.numbers": np.array(fold_numbers)}
        arrays[f"{g}.error"] = np.array(error)
    return {**arrays, "work": np.array([body.elements.n, dynamics.state.step, seconds])}


def _folds(arrays: Any, g: float) -> Folds:
    n_elements, n_steps, seconds = arrays["work"]
    return Folds(
        Surface(arrays[f"{g}.verts"], arrays[f"{g}.faces"], name="pial"),
        dict(zip(NUMBER_NAMES, arrays[f"{g}.numbers"].tolist(), strict=True)),
        int(n_elements),
        int(n_steps),
        float(seconds),
        arrays[f"{g}.error"].item(),
    )


def pairs(settings: Sequence[Setting], finest: Setting = FINEST_SETTING) -> list[tuple[Setting, Setting, str]]:
    """Pairs to compare: a setting, the more accurate setting, and a description of the latter.

    On an axis with a limit, settings are compared with the last one, because settings are ordered with the most
    accurate last. All others are compared with the finest mesh (``FINEST_MESH``). For a coarse mesh of another pace,
    for example, that comparison would contain two errors, which may cancel.
    """
    best_by_axis = {setting.axis: setting for setting in settings if setting.axis in LIMIT_AXES}
    setting_pairs = []
    for setting in settings:
        if setting.axis not in best_by_axis:
            setting_pairs.append((setting, finest, FINEST_MESH))
        elif setting.name != best_by_axis[setting.axis].name:
            setting_pairs.append((setting, best_by_axis[setting.axis], best_by_axis[setting.axis].label))
    return setting_pairs


def fold_points(
    setting: Setting, folds_by_g: Mapping[float, Folds], finer_by_g: Mapping[float, Folds], against: str
) -> list[Point]:
    """Errors of the folds of a setting, compared with those of a better setting, both by growth.

    Returns
    -------
    list of Point
        The relative difference of each of ``NUMBER_NAMES``, of the gyrification index also from the limit of its own
        folds (``OWN_LIMIT``) where the reference is the finest mesh, and ``pial distance``, :func:`distance` over the
        thickness of the cortex. Names of quantities end with the growth, as in ``"wavelength, g = 1.5"``.
    """
    points = []
    for g, folds in folds_by_g.items():
        finer = finer_by_g[g]
        errors = {quantity: abs(folds.measures[quantity] / finer.measures[quantity] - 1) for quantity in NUMBER_NAMES}
        errors["pial distance"] = distance(folds.pial, finer.pial) / setting.scene().geometry.cortex_thickness
        timing = Timing.of([folds.seconds])
        points += [
            setting.point(f"{quantity}, g = {g:g}", error, against, folds.n_elements, timing)
            for quantity, error in errors.items()
        ]
        if against == FINEST_MESH and not math.isnan(folds.error):
            quantity = f"{NUMBER_NAMES[0]}, g = {g:g}"
            points.append(setting.point(quantity, abs(folds.error), OWN_LIMIT, folds.n_elements, timing))
    return points
