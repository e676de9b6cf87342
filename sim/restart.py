"""Begin a run at the state of another run: at one of its stages, or at its checkpoint."""

from __future__ import annotations

import os
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from morphofold.arrays import Array
from morphofold.errors import DamagedFile, DoesNotApply, Mismatch, MissingPart, OutOfRange
from morphofold.io.files import decoding, existing_file
from morphofold.provenance import sha256_of
from morphofold.sim.output.inputs import begun_with, scene_digest
from morphofold.sim.output.run_files import stage_folder
from morphofold.sim.output.stages import read_stage
from morphofold.sim.output.volume import VOLUME_FILE, read_volume, stages_with_volume
from morphofold.sim.scene import Scene
from morphofold.sim.scene.files import load_scene

if TYPE_CHECKING:
    from morphofold.sim.body import Body
    from morphofold.sim.dynamics import State

POSITION_ROUND_OFF = 1e-9  # difference of reference positions, over the size of the body, that counts as none


def restart_of(out: Path, scene: Scene, place: str | Path | None) -> dict[str, Any] | None:
    """The entry of ``inputs.json`` for the state at which a run in ``out`` begins; None if it begins ungrown.

    For a resumed run this is the entry in its ``inputs.json``. A new run begins at ``place``, the folder of a stage or
    of a run; of a run, the state of the largest growth is taken.

    Raises
    ------
    FileNotFoundError, ValueError
        If there is no such state, it is damaged, or its growth is beyond the scene's final one.
    """
    begun = begun_with(out)
    if begun or place is None:
        return begun.get("restart")
    place = Path(os.path.abspath(place))
    run = place.parent.parent if (place / "stage.json").is_file() else place
    if not (run / "scene.toml").is_file():
        raise FileNotFoundError(f"{place}: is not the folder of a run or of a stage. Name one to restart from.")
    with decoding(run / "scene.toml", "a scene as a run writes it"):
        other = load_scene(run / "scene.toml")
    for name in (name for one in (scene, other) for name, options in one.effects.items() if options.history):
        raise DoesNotApply(
            f"{place}: with effects.{name} a run can't begin at the state of another one, whose files do not hold "
            "the growth of the core. Let it grow from the start."
        )
    stages = {g: stage_folder(run, g) for g in stages_with_volume(run, other)}
    found = [(g, folder / VOLUME_FILE) for g, folder in stages.items() if place in (run, folder)]
    if place == run and (run / "checkpoint.npz").is_file():
        found.append((_read_state(run / "checkpoint.npz")[-1], run / "checkpoint.npz"))
    if not found:
        raise MissingPart(
            f"{place}: holds no state to restart from: no checkpoint and no stage with {VOLUME_FILE}. A scene with "
            "output.volume = false or of one dimension writes no volume. Name another run."
        )
    growth, file = max(found, key=lambda state: state[0])  # of two at the same growth the first, a stage
    if growth > scene.growth.final:
        raise OutOfRange(
            f"{file}: is at g = {growth:g}, beyond growth.final = {scene.growth.final:g} of {scene.name}. Raise "
            "growth.final, or restart from the folder of an earlier stage."
        )
    if file.name == VOLUME_FILE:
        read_stage(run, growth)  # raises if it is damaged
    return {"file": str(file), "sha256": sha256_of(file), "scene_sha256": scene_digest(run), "growth": growth}


def state_of(restart: Mapping[str, Any], body: Body, scene: Scene) -> State:
    """The state at which a run begins: positions, growth and, from a checkpoint, velocities.

    Raises
    ------
    FileNotFoundError, ValueError
        If its file is missing, has changed, or has another mesh than the body.
    """
    from morphofold.sim.dynamics import State

    file = existing_file(restart["file"], "state to restart from")
    if (now := sha256_of(file)) != restart["sha256"]:
        raise Mismatch(
            f"{file}: has changed since a run was started from it (sha256 {restart['sha256'][:12]}... then, {now[:12]}"
            "... now). Restore the old file, or choose another folder."
        )
    x, v, X, _ = _read_state(file)
    check_mesh(file, X, body.X, scene)
    if scene.real_time:  # velocities are per step, and its length differs
        v[:] = 0.0
    return State(x, v, growth=restart["growth"])


def check_mesh(file: Path, X: Array, mine: Array, scene: Scene) -> None:
    """Raise ``Mismatch`` unless the reference positions X equal those of the body, ``mine``."""
    difference = f"has {len(X):,} nodes, but the body of {scene.name} has {len(mine):,}"
    if X.shape == mine.shape:
        apart = np.linalg.norm(X - mine, axis=1)
        if apart.max() <= POSITION_ROUND_OFF * np.ptp(mine, axis=0).max():
            return
        difference = f"has node {apart.argmax()} {apart.max():.3g} mm from its place in the body of {scene.name}"
    raise Mismatch(
        f"{file}: {difference} before growth. Use the geometry, mesh and imperfection of the run to continue"
        f"{_wavelength_advice(file, scene)}."
    )


def _read_state(file: Path) -> tuple[Array, Array, Array, float]:
    """Positions, velocities, reference positions (N, 3) and growth of a checkpoint. A volume has no velocities and no
    growth: they are returned as 0 and 1."""
    with decoding(file, "a state to restart from"):
        if file.name == VOLUME_FILE:
            X, x = read_volume(file)
            v, growth = np.zeros(x.shape), 1.0
        else:
            with np.load(existing_file(file), allow_pickle=False) as arrays:
                if sum(entry.file_size for entry in arrays.zip.infolist()) > file.stat().st_size:
                    raise DamagedFile("it is compressed")  # no run compresses it
                x, v, X = (arrays[name].astype(np.float64) for name in ("x", "v", "reference"))
                v *= "inertia.dt" not in arrays.files  # with inertia they are per step of another length
                growth = float(arrays["growth"].item())
        if not (x.ndim == 2 and x.shape[1] == 3 and x.shape == v.shape == X.shape):
            raise DamagedFile(f"its positions have shape {x.shape}, its velocities {v.shape}, its nodes {X.shape}")
        if not (growth >= 1 and all(np.isfinite(array).all() for array in (x, v, X, growth))):
            raise DamagedFile("it has values that are not finite, or a growth below 1")
    return np.ascontiguousarray(x, np.float64), v, X, growth


def _wavelength_advice(file: Path, scene: Scene) -> str:
    """How to set the imperfection of the other run; its wavelength depends on the material unless it is set."""
    from morphofold.sim.effects.perturbation import build

    with suppress(OSError, ValueError):
        other = load_scene((file.parent if file.suffix == ".npz" else file.parents[2]) / "scene.toml")
        if "perturbation" in scene.effects and "perturbation" in other.effects:
            theirs = build(other.effects["perturbation"], other).wavelength
            if theirs != build(scene.effects["perturbation"], scene).wavelength:
                return f": effects.perturbation.wavelength = {theirs!r}, for example"
    return ""
