"""Errors of a finished run by Richardson extrapolation: a run in, an ``Estimate`` and its file ``error.json`` out.

The run is compared with a coarser run of the same scene, and the coarser run with a slower run, which grows at half the
pace. Both are grown inside the folder of the run.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from pydantic import TypeAdapter

from morphofold.analysis import gyrification_index
from morphofold.digests_and_json import Row, sha256_of
from morphofold.errors import DoesNotApply, MissingPart, NoSolution
from morphofold.forecasts.cost_record import TABLE, errors_of_run
from morphofold.forecasts.forecasting import Forecast, forecast
from morphofold.forecasts.sizes import edge_by_rule, refuse_without_edge
from morphofold.io.atomic_folders import alone
from morphofold.io.json_files import Amount, Number, Record, read_json, write_json
from morphofold.number_texts import percent
from morphofold.progress_callbacks import Progress, part_of, silent
from morphofold.sim.dynamics import UnstableError
from morphofold.sim.output.run_inputs import begun_with, remove_temporaries
from morphofold.sim.run import Simulation, simulate
from morphofold.sim.scene import SLOWEST_RATE, Scene
from morphofold.sim.scene.scene_files import load_scene
from morphofold.surface import Surface
from morphofold.validators import check_kind

COARSER_EDGE_RATIO = 1.5  # edges of the coarser run over those of the run: it takes about a third of the run's time
LEAST_EDGE_RATIO = 1.2  # least ratio as built, after rounding to whole cells: similar runs do not extrapolate
#: mean distance between the pial surfaces over T, beyond which two patterns are different: folds of two seeds lie 1.1
#: to 1.3 T apart, an eighth of their wavelength (docs/accuracy.md)
SAME_PATTERN_DISTANCE = 0.5
#: errors scale with these powers of the edge if meshes fold into one pattern, with three elements through the cortex:
#: on meshes of an octant of fig6-thick from 1.2 to 0.27 T, whose stages were not at rest; at rest no patterns agreed
CONVERGENCE_POWERS = {"gyrification index": 1.32, "pial distance": 1.16}
COARSER_RUN, SLOWER_RUN, ERROR_FILE = "coarser", "slower", "error.json"  # in the folder of the run


@dataclass(frozen=True)
class Estimated:
    """One quantity of the last stage: its difference between the run and the coarser run, the power of the edge with
    which its error scales, and the error of the run, change / (ratio^power - 1); None if the coarser run folded into
    another pattern."""

    change: Amount
    power: Number
    error: Amount | None


@dataclass(frozen=True)
class Estimate:
    """Errors of a run by Richardson extrapolation from a coarser run.

    Attributes
    ----------
    growth : float
        Of the last stage, which is compared.
    edge_over_T, ratio : float
        Largest surface edge of the run over the thickness of the (thinnest) cortex; edge of the coarser run over the
        edge of the run.
    errors : mapping
        Quantity to ``Estimated``: relative error of the ``gyrification index`` (closed bodies only), and the
        ``pial distance``, the mean distance between two pial surfaces over T.
    how : str
    doubts : tuple of str
    not_studied : tuple of str
        Properties of the scene for which the powers were not studied
        (:func:`morphofold.forecasts.cost_record.not_studied`).
    pace : mapping, optional
        Quantity to its change, not extrapolated, if the coarser run grows at half the pace; None if the scene has no
        slower run (:func:`companions`), and in estimates of versions without slower runs.
    """

    growth: Number
    edge_over_T: Amount
    ratio: Amount
    errors: Mapping[str, Estimated]
    how: str
    doubts: tuple[str, ...]
    not_studied: tuple[str, ...] = ()
    pace: Mapping[str, Amount] | None = None

    def __repr__(self) -> str:
        return f"Estimate({self.words})"

    @property
    def words(self) -> str:
        """All errors in a line, and reasons to doubt them."""
        errors = _joined_with_values({name: item.error for name, item in self.errors.items() if item.error is not None})
        sentences = [f"error of the mesh at g = {self.growth:g}, {self.how}: {errors or 'not known'}."]
        if self.pace is not None:
            pace_text = _joined_with_values(self.pace)
            sentences.append(f"Half the pace of growth changes the coarser run by: {pace_text} of T.")
        return " ".join([*sentences, *self.doubts])

    def as_dict(self) -> Row:
        """Plain values."""
        return asdict(self)


class Grown(NamedTuple):
    """The last stage of a run: its pial surface, its largest edge before growth [mm], and its warnings."""

    pial: Surface
    edge: float
    warnings: list[str]


def coarser(scene: Scene) -> Scene:
    """The scene of the coarser run: edges 1.5 times as long, as many elements through the cortex, all else the same.

    Raises
    ------
    ValueError
        If it has no edge that could be longer, doesn't grow, or is too small for edges that are clearly longer.
    """
    refuse_without_edge(scene, "--estimate grows a coarser run")
    if scene.growth.final == 1:
        raise DoesNotApply(f"--estimate: {scene.name} doesn't grow, so there is no error to estimate. Leave it out.")
    layers = f"accuracy.elements_through_cortex={scene.elements_through_cortex}"
    coarse = load_scene(scene, [f"accuracy.edge={COARSER_EDGE_RATIO * scene.edge!r}", layers, "output.volume=false"])
    edge, coarse_edge = edge_by_rule(scene), edge_by_rule(coarse)
    if coarse_edge < LEAST_EDGE_RATIO * edge:
        raise NoSolution(
            f"--estimate: the edges of {scene.name} are {edge:.3g} mm, those of its coarser run only "
            f"{coarse_edge:.3g}: the body is too small for a coarser run. Take a shorter accuracy.edge."
        )
    return coarse


def companions(scene: Scene) -> dict[str, Scene]:
    """The scenes of the coarser and the slower run by their folders: :func:`coarser`, and the same at half of
    ``growth.rate``. There is no slower run if time is real (inertia) or the pace would be too slow. Raises as
    :func:`coarser`. Both runs pass the first wrinkles at the same pace, which ``slow_growth`` limits at any rate."""
    scenes, slower_rate = {COARSER_RUN: coarser(scene)}, scene.growth.rate / 2
    if not scene.real_time and slower_rate >= SLOWEST_RATE:
        scenes[SLOWER_RUN] = load_scene(scenes[COARSER_RUN], [f"growth.rate={slower_rate!r}"])
    return scenes


def companion_forecasts(scene: Scene, threads: int | None = None) -> dict[str, Forecast]:
    """Forecasts of the coarser and the slower run of a scene, without their errors and doubts, which are not needed."""
    forecasts = {}
    for folder, companion in companions(scene).items():
        cost = forecast(companion, threads)
        sources = {quantity: source for quantity, source in cost.how.items() if quantity != "errors"}
        forecasts[folder] = replace(cost, errors={}, not_studied=(), how=sources, doubts=())
    return forecasts


def estimate_error(run: Simulation, *, threads: int | None = None, progress: Progress = silent) -> Estimate:
    """Estimate the error of a finished run's last stage, and write it as ``error.json`` into its folder.

    Parameters
    ----------
    run : Simulation
        Finished. The other two runs are grown in its folders ``coarser`` and ``slower``; stopped ones continue, and
        finished ones are read.
    threads : int, optional
        As of :func:`morphofold.simulate`.
    progress : callable
        Called with the share done (0 to 1) and a line of text.

    Returns
    -------
    Estimate

    Raises
    ------
    ValueError
        As :func:`coarser`; if the run doesn't record the length of its edges, restarted from another run, or has
        effects that its caller passed.
    FileExistsError
        If another process writes into the run's folder.
    UnstableError
        If the coarser or the slower run becomes unstable; the run itself is not affected.

    Notes
    -----
    An error that scales with the power p of the edge is ``|Q - Q_coarser| / (r^p - 1)`` if the edges of the coarser run
    are r times as long. p is from a study with three elements through the cortex; docs/accuracy.md shows how far such
    estimates are from true errors, and why wavelength and strain energy have none.
    """
    check_kind(run, Simulation, "estimate_error: run")
    if passed := [kind for kind in ("effects", "restart") if kind in begun_with(run.path)]:
        raise DoesNotApply(
            f"{run.path}: has {' and '.join(passed)} in inputs.json, but not in its scene, so no coarser run of it can "
            "be grown."
        )
    scenes = companions(run.scene)
    surfaces = [_grown_surface(run)]
    for n_done, (folder, companion) in enumerate(scenes.items()):
        reporting, path = part_of(progress, n_done / len(scenes), 1 / len(scenes)), run.path / folder
        try:
            surfaces.append(_grown_surface(simulate(companion, path, resume=True, threads=threads, progress=reporting)))
        except UnstableError as error:
            raise UnstableError(f"{path}: {error} The run itself is complete.", error.sound) from error
    estimate = errors_from_runs(run.scene, *surfaces)
    with alone(run.path):
        remove_temporaries(run.path)  # a finished run no longer does it
        content = {**estimate.as_dict(), "health_sha256": sha256_of(run.path / "health.json")}
        write_json(run.path / ERROR_FILE, content)
    return estimate


def stored_estimate(folder: Path) -> Estimate | None:
    """The estimate of the run in a folder; None if it has none, or it is incomplete."""
    try:
        content = read_json(folder / ERROR_FILE, Record, "")  # the fields of an estimate, and a digest
        is_of_run = content.get("health_sha256") == sha256_of(folder / "health.json")
        return TypeAdapter(Estimate).validate_python(content) if is_of_run else None
    except (OSError, ValueError):
        return None


def errors_from_runs(scene: Scene, run: Grown, coarse: Grown, slow: Grown | None = None) -> Estimate:
    """Estimate from the last stages of the run, the coarser run and, if there is one, the slower run."""
    changes, ratio, T = _changes_between_runs(scene, run, coarse), coarse.edge / run.edge, scene.thinnest
    pace = None if slow is None else _changes_between_runs(scene, coarse, slow)
    is_same_pattern = changes["pial distance"] <= SAME_PATTERN_DISTANCE
    errors = {}
    for name, change in changes.items():
        power = CONVERGENCE_POWERS[name]
        errors[name] = Estimated(change, power, change / (ratio**power - 1) if is_same_pattern else None)
    runs = {"run": run, "coarser run": coarse, "slower run": slow}
    doubts = [f"The {name} isn't healthy: {text}" for name, grown in runs.items() if grown for text in grown.warnings]
    if not is_same_pattern:
        doubts.append(
            f"The coarser run folded into another pattern (they differ by: {_joined_with_values(changes)} of T), so no "
            "error follows from it: with such edges the pattern depends on the mesh. Take a shorter edge."
        )
    if pace is not None and pace["pial distance"] > SAME_PATTERN_DISTANCE:
        doubts.append(
            "The slower run folded into another pattern than the coarser run: the folds depend on the pace of growth."
        )
    if (run_errors := errors_of_run(scene, run.edge / T)).not_studied:
        doubts.append(f"The powers are {run_errors.how}.")
    how = (
        f"from a coarser run ({coarse.edge / T:.2f} T beside {run.edge / T:.2f} T), powers from the study "
        f"of {TABLE['errors']['subject']}, three elements through the cortex"
    )
    return Estimate(scene.growth.final, run.edge / T, ratio, errors, how, tuple(doubts), run_errors.not_studied, pace)


def _changes_between_runs(scene: Scene, run: Grown, other_run: Grown) -> dict[str, float]:
    """Differences of the last stages of two runs: quantities and units are those of ``Estimate.errors``."""
    changes = {"pial distance": distance(run.pial, other_run.pial) / scene.geometry.cortex_thickness}
    if scene.geometry.shape in ("sphere", "ellipsoid"):
        run_index, other_index = (gyrification_index(grown.pial.verts, grown.pial.faces) for grown in (run, other_run))
        changes = {"gyrification index": abs(other_index / run_index - 1), **changes}
    return changes


def _joined_with_values(shares: Mapping[str, float]) -> str:
    return ", ".join(f"{name} {percent(fraction)}" for name, fraction in shares.items())


def _grown_surface(run: Simulation) -> Grown:
    health = run.health
    if "surface_edge_mm" not in health:
        raise MissingPart(
            f"{run.path / 'health.json'}: has no surface_edge_mm, because an early version wrote it. Grow it again."
        )
    return Grown(run.cortex().pial, health["surface_edge_mm"], health["warnings"])


def distance(surface: Surface, other: Surface) -> float:
    """Mean distance [mm] of the vertices of one surface to the nearest point of the other; mean of both directions."""
    import pyvista

    mean_distances = []
    for from_surface, to_surface in ((surface, other), (other, surface)):
        mesh: Any = pyvista.PolyData.from_regular_faces(to_surface.verts, to_surface.faces)  # type: ignore[arg-type]
        _, nearest = mesh.find_closest_cell(from_surface.verts, return_closest_point=True)
        mean_distances.append(np.linalg.norm(from_surface.verts - nearest, axis=1).mean())
    return 0.5 * sum(mean_distances)
