"""Error against time of the solver for a folded body: compared with the finest mesh, and along each axis."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from morphofold import analysis
from morphofold.forecasts.richardson import distance
from morphofold.frozen_arrays import Array
from morphofold.io import atomic_file
from morphofold.io.files import decoding, existing_file
from morphofold.progress_callbacks import Progress, silent
from morphofold.sim.output.stage_surfaces import whole_surfaces
from morphofold.studies.accuracy.error_points import ANEW, Point, Timing
from morphofold.studies.accuracy.solver_settings import FINEST, Setting
from morphofold.surface import Surface
from morphofold.timing import working_seconds

STAGES = (1.5, 2.0)  # growths at which folds are measured: sulci are closed; the end of growth
MESH = "finest mesh"
#: axes whose last setting is the most accurate; for the other axes it is the finest mesh
WITH_A_LIMIT = ("layers", "kappa", "pace", "contact", "precision")
NUMBERS = ("gyrification index", "wavelength", "strain energy")


class Folds(NamedTuple):
    """A grown body at one growth: its pial surface and its measured numbers.

    Attributes
    ----------
    pial : Surface
        Closed [mm].
    numbers : mapping
        ``NUMBERS`` by name: the gyrification index of the pial surface, the wavelength [mm] of the power spectrum of
        its height on the ungrown sphere, the energy of the body in units of the modulus of the core times mm^3.
    elements, steps : int
    seconds : float
        Wall time of all steps of the whole run.
    """

    pial: Surface
    numbers: Mapping[str, float]
    elements: int
    steps: int
    seconds: float


def simulated_folds(setting: Setting, cache: Path, show: Progress = silent) -> dict[float, Folds]:
    """Folds at each of ``STAGES``, read from the file ``cache`` (.npz), or grown now and written there."""
    if not cache.exists():
        arrays = _grow(setting, show)
        with atomic_file(cache) as temporary, temporary.open("wb") as file:
            np.savez(file, **arrays)  # type: ignore[arg-type]
    with decoding(cache, "folds of a study", ANEW), np.load(existing_file(cache, "file of folds")) as arrays:
        return {g: _folds(arrays, g) for g in STAGES}


def _grow(setting: Setting, show: Progress) -> dict[str, Array]:
    dynamics = setting.dynamics(folds=True)
    body, final_growth = dynamics.body, STAGES[-1]
    show_growth = lambda state: show((state.growth - 1) / (final_growth - 1), f"{setting.label}, g {state.growth:.2f}")
    sphere = whole_surfaces(body, np.ascontiguousarray(body.bilayer.mesh.p.T))[1].verts
    arrays: dict[str, Any] = {}
    seconds = 0.0
    for g in STAGES:
        began_at = working_seconds()
        dynamics.grow_to(g, show_growth)
        dynamics.settle(show_growth)
        seconds += working_seconds() - began_at
        pial = whole_surfaces(body, dynamics.state.x)[1]
        spectrum = analysis.power_spectrum(sphere, pial.faces, np.linalg.norm(pial.verts, axis=1))
        fold_numbers = (
            analysis.gyrification_index(pial.verts, pial.faces),
            spectrum.wavelength,
            dynamics.state.record["strain_energy"] / body.bilayer.portion,
        )
        arrays |= {f"{g}.verts": pial.verts, f"{g}.faces": pial.faces, f"{g}.numbers": np.array(fold_numbers)}
    return {**arrays, "work": np.array([body.elements.n, dynamics.state.step, seconds])}


def _folds(arrays: Any, g: float) -> Folds:
    elements, steps, seconds = arrays["work"]
    return Folds(
        Surface(arrays[f"{g}.verts"], arrays[f"{g}.faces"], name="pial"),
        dict(zip(NUMBERS, arrays[f"{g}.numbers"].tolist(), strict=True)),
        int(elements),
        int(steps),
        float(seconds),
    )


def pairs(settings: Sequence[Setting], finest: Setting = FINEST) -> list[tuple[Setting, Setting, str]]:
    """Pairs to compare: a setting, the more accurate setting, and a description of the latter.

    On an axis with a limit, settings are compared with the last one, because settings are ordered with the most
    accurate last. All others are compared with the finest mesh (``MESH``). For a coarse mesh of another pace, for
    example, that comparison would contain two errors, which may cancel.
    """
    most_accurate = {s.axis: s for s in settings if s.axis in WITH_A_LIMIT}
    setting_pairs = []
    for s in settings:
        if s.axis not in most_accurate:
            setting_pairs.append((s, finest, MESH))
        elif s.name != most_accurate[s.axis].name:
            setting_pairs.append((s, most_accurate[s.axis], most_accurate[s.axis].label))
    return setting_pairs


def fold_points(s: Setting, own: Mapping[float, Folds], better: Mapping[float, Folds], against: str) -> list[Point]:
    """Errors of the folds of a setting, compared with those of a better setting, both by growth.

    Returns
    -------
    list of Point
        The relative difference of each of ``NUMBERS``, and ``pial distance``, :func:`distance` over the thickness of
        the cortex. Names of quantities end with the growth, as in ``"wavelength, g = 1.5"``.
    """
    points = []
    for g, folds in own.items():
        better_folds = better[g]
        errors = {quantity: abs(folds.numbers[quantity] / better_folds.numbers[quantity] - 1) for quantity in NUMBERS}
        errors["pial distance"] = distance(folds.pial, better_folds.pial) / s.scene().geometry.cortex_thickness
        timing = Timing.of([folds.seconds])
        points += [
            s.point(f"{quantity}, g = {g:g}", error, against, folds.elements, timing)
            for quantity, error in errors.items()
        ]
    return points
