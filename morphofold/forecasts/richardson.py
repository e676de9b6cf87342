"""Errors of the gyrification index of a finished run by Richardson extrapolation at equal folds.

Each stage is carried to one coarser mesh, and held for the same time there and on its own. Its folds stay, so the
index differs by the mesh alone. A run on a coarser mesh would fold into another pattern, whose index differs by as much
as the error.
"""

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from pydantic import TypeAdapter

from morphofold.analysis import gyrification_index
from morphofold.digests_and_json import Row, sha256_of
from morphofold.errors import DoesNotApply, MissingPart, NoSolution
from morphofold.forecasts.sizes import edge_by_rule, refuse_without_edge
from morphofold.frozen_arrays import Array
from morphofold.io.atomic_folders import alone
from morphofold.io.json_files import Amount, Number, Record, read_json, write_json
from morphofold.number_texts import percent
from morphofold.progress_callbacks import Progress, logged
from morphofold.sim.body import Body
from morphofold.sim.build import build_body
from morphofold.sim.dynamics import Dynamics, State
from morphofold.sim.effects import build_effects
from morphofold.sim.nested_meshes import carry
from morphofold.sim.output.checkpoint import check_mesh
from morphofold.sim.output.run_inputs import begun_with, remove_temporaries, stage_folder
from morphofold.sim.output.stage_records import VOLUME_FILE, read_volume, stages_with_volume
from morphofold.sim.output.stage_surfaces import whole_surfaces
from morphofold.sim.run import Simulation
from morphofold.sim.scene import Scene
from morphofold.sim.scene.scene_files import load_scene
from morphofold.threads import one_blas_thread, using_threads
from morphofold.validators import check_kind

COARSER_EDGE_RATIO = 1.35  # edges of the coarser mesh over those of the run: folds survive longer ones not always
LEAST_EDGE_RATIO = 1.2  # least ratio as built, after rounding to whole cells: similar meshes do not extrapolate
HOLD_TICKS = 24.0  # for which a stage is held on both meshes: few rest, and what they move is not due to the mesh
ORDER = 1  # of the error in the edge: docs/folds.md, "What the mesh alone changes"
ERROR_FILE = "error.json"  # in the folder of the run


@dataclass(frozen=True)
class StageEstimate:
    """Gyrification index of a stage: as written; held for longer, on the mesh of the run and on the coarser one;
    extrapolated from these to an edge of 0; and the relative error of the run, negative if its index is too low."""

    growth: Number
    index: Amount
    held: Amount
    coarser: Amount
    corrected: Amount
    error: Number


@dataclass(frozen=True)
class Estimate:
    """Errors of the gyrification index of a run's stages, by its folds on a coarser mesh.

    Attributes
    ----------
    edge_over_T, ratio : float
        Largest surface edge of the run over the thickness of the (thinnest) cortex; edge of the coarser mesh over it.
    stages : tuple of StageEstimate
    """

    edge_over_T: Amount
    ratio: Amount
    stages: tuple[StageEstimate, ...]

    def __repr__(self) -> str:
        return f"Estimate({self.words})"

    @property
    def words(self) -> str:
        """The corrected index of each stage, in a line."""
        stages = (
            f"{s.index:.3f} -> {s.corrected:.3f} at g = {s.growth:g} ({percent(abs(s.error))})" for s in self.stages
        )
        return f"gyrification index, corrected for the mesh by its folds on one {self.ratio:.2f} times as coarse: " + (
            ", ".join(stages)
        )

    def as_dict(self) -> Row:
        """Plain values."""
        return asdict(self)


def coarser(scene: Scene) -> Scene:
    """The scene on the coarser mesh: longer edges, as many elements through the cortex, all else the same.

    Raises
    ------
    ValueError
        If its body is not closed or has no edge that could be longer, it does not grow, its states cannot be carried to
        another mesh, or it is too small for edges that are clearly longer.
    """
    refuse_without_edge(scene, "--estimate carries stages to a coarser mesh")
    if scene.growth.final == 1:
        raise DoesNotApply(f"--estimate: {scene.name} doesn't grow, so there is no error to estimate. Leave it out.")
    if scene.geometry.shape in ("patch", "strip"):
        raise DoesNotApply(f"--estimate: {scene.name} has no closed surface, so no gyrification index. Leave it out.")
    if bound := scene.bound_to_mesh:
        raise DoesNotApply(f"--estimate carries stages to a coarser mesh, but in {scene.name} {bound}. Leave it out.")
    if not scene.output.volume:
        raise DoesNotApply(f"--estimate: {scene.name} has output.volume = false, so its stages can't be read. Set it.")
    layers = f"accuracy.elements_through_cortex={scene.elements_through_cortex}"
    coarse = load_scene(scene, [f"accuracy.edge={COARSER_EDGE_RATIO * scene.edge!r}", layers])
    edge, coarse_edge = edge_by_rule(scene), edge_by_rule(coarse)
    if coarse_edge < LEAST_EDGE_RATIO * edge:
        raise NoSolution(
            f"--estimate: the edges of {scene.name} are {edge:.3g} mm, those of a coarser mesh only {coarse_edge:.3g}: "
            "the body is too small for a coarser mesh. Take a shorter accuracy.edge."
        )
    return coarse


@one_blas_thread()
def estimate_error(run: Simulation, *, threads: int | None = None, progress: Progress = logged) -> Estimate:
    """Correct the gyrification index of each stage of a finished run for its mesh; written as ``error.json`` there.

    Parameters
    ----------
    run : Simulation
        Finished, with the volumes of its stages.
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
        As :func:`coarser`; if the run restarted from another one or has effects that its caller passed, or a volume is
        missing.
    FileExistsError
        If another process writes into the run's folder.
    UnstableError
        If a stage cannot be held on the coarser mesh; the run itself is not affected.

    Notes
    -----
    With edges r times as long, an error of first order in the edge is ``(Q - Q_coarser) / (r - 1)``. What the mesh does
    to the choice of the folds is not in it: docs/folds.md compares both.
    """
    check_kind(run, Simulation, "estimate_error: run")
    if passed := [kind for kind in ("effects", "restart") if kind in begun_with(run.path)]:
        raise DoesNotApply(
            f"{run.path}: has {' and '.join(passed)} in inputs.json, but not in its scene, so its stages can't be "
            "carried to another mesh."
        )
    scene, coarse_scene = run.scene, coarser(run.scene)
    if missing := sorted({*run.stages} - {*stages_with_volume(run.path, scene)}):
        raise MissingPart(f"{stage_folder(run.path, missing[0])}: has no {VOLUME_FILE}. Grow the run again.")
    with using_threads(threads), alone(run.path):
        own, coarse = meshed(scene), meshed(coarse_scene)
        edge, ratio = own.body.bilayer.edge, coarse.body.bilayer.edge / own.body.bilayer.edge
        stages = []
        for n_done, (growth, x) in enumerate(_states(run, own.body)):
            progress(n_done / len(run.stages), f"g {growth:.3f} on a coarser mesh")
            stages.append(stage_estimate(State(x, np.zeros_like(x), growth=growth), own, coarse))
        estimate = Estimate(edge / scene.thinnest, ratio, tuple(stages))
        remove_temporaries(run.path)  # a finished run no longer does it
        content = {**estimate.as_dict(), "health_sha256": sha256_of(run.path / "health.json")}
        write_json(run.path / ERROR_FILE, content)
    progress(1.0, "done")
    return estimate


def _states(run: Simulation, body: Body) -> Iterator[tuple[float, Array]]:
    """Growth and positions (N, 3) [mm] of each stage."""
    for growth in run.stages:
        file = stage_folder(run.path, growth) / VOLUME_FILE
        X, x = read_volume(file)
        check_mesh(file, X, body.X, run.scene)
        yield growth, np.ascontiguousarray(x)


def meshed(scene: Scene) -> Dynamics:
    """The dynamics of a scene on one mesh, ungrown."""
    effects = build_effects(scene)
    return Dynamics.of(scene, build_body(scene, effects), effects)


def stage_estimate(state: State, own: Dynamics, coarse: Dynamics) -> StageEstimate:
    """Estimate for a ``state`` of a body, by its own dynamics and those of a coarser mesh."""
    body, index = own.body, gyrification_of(own.body, state.x)
    carry(body, state, coarse)  # it measures the body in this state
    own.enter(state.x, state.v, state, body.elements.state()["volume_ratio"])
    for mesh in (own, coarse):
        mesh.hold(HOLD_TICKS)
    held, coarser_index = (gyrification_of(mesh.body, mesh.state.x) for mesh in (own, coarse))
    ratio = coarse.body.bilayer.edge / own.body.bilayer.edge
    corrected = held + (held - coarser_index) / (ratio**ORDER - 1)
    return StageEstimate(state.growth, index, held, coarser_index, corrected, index / corrected - 1)


def gyrification_of(body: Body, x: Array) -> float:
    """Gyrification index of the whole pial surface of a body at positions x (N, 3)."""
    pial = whole_surfaces(body, x)[1]
    return gyrification_index(pial.verts, pial.faces)


def stored_estimate(folder: Path) -> Estimate | None:
    """The estimate of the run in a folder; None if it has none, or it is incomplete or of an earlier version."""
    try:
        content = read_json(folder / ERROR_FILE, Record, "")  # the fields of an estimate, and a digest
        is_of_run = content.get("health_sha256") == sha256_of(folder / "health.json")
        return TypeAdapter(Estimate).validate_python(content) if is_of_run else None
    except (OSError, ValueError):
        return None
