"""States of runs read back: the checkpoint and the log of a run to resume, and the state of another run to begin at."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from morphofold.digests_and_json import Row, sha256_of
from morphofold.errors import DamagedFile, DoesNotApply, Mismatch, MissingPart, OutOfRange
from morphofold.frozen_arrays import Array
from morphofold.io.files import decoding, existing_file
from morphofold.sim.output.run_inputs import AND_GROW_AGAIN, begun_with, scene_digest, stage_folder
from morphofold.sim.output.stage_records import VOLUME_FILE, read_stage, read_volume, stages_with_volume
from morphofold.sim.scene import Scene
from morphofold.sim.scene.scene_files import load_scene

if TYPE_CHECKING:
    from morphofold.sim.body import Body
    from morphofold.sim.dynamics import State

#: what differs if these arrays of a checkpoint do
MARKS = {"scene": "another scene or mesh", "version": "another version of morphofold"}
POSITION_ROUND_OFF = 1e-9  # difference of reference positions, over the size of the body, that counts as none


def read_checkpoint(path: Path, run_arrays: Mapping[str, NDArray]) -> dict[str, NDArray]:
    """Arrays by name from the checkpoint of a run; names, shapes and kinds must be those of ``run_arrays``.

    Raises
    ------
    Mismatch
        If ``scene`` or ``version`` is another in the file.
    DamagedFile
        If the file differs otherwise; its checksums reveal a single changed byte.
    """
    cure = f"Delete it {AND_GROW_AGAIN}."
    with decoding(path, "a checkpoint of this run", cure):
        with np.load(existing_file(path, "checkpoint"), allow_pickle=False) as npz_file:
            arrays = dict(npz_file)
        mismatches = [run for name, run in MARKS.items() if name in arrays and (arrays[name] != run_arrays[name]).any()]
        kinds, run_kinds = ({key: (a.shape, a.dtype.kind) for key, a in part.items()} for part in (arrays, run_arrays))
        if not mismatches and kinds != run_kinds:
            raise DamagedFile("its arrays are not those of this run")
    if mismatches:
        raise Mismatch(f"{path}: belongs to a run with {mismatches[0]}. {cure}")
    return arrays


def as_lines(log: Sequence[Mapping[str, Any]]) -> str:
    """The text of ``log.jsonl``."""
    return "".join(json.dumps(line, allow_nan=False) + "\n" for line in log)


def as_bytes(text: str) -> NDArray[np.uint8]:
    """SHA-256 of a text, as a checkpoint holds it: (32,) uint8."""
    return np.frombuffer(hashlib.sha256(text.encode()).digest(), np.uint8)


def read_log(out: Path, n_lines: int, digest: NDArray[np.uint8]) -> list[Row]:
    """The first ``n_lines`` lines of ``log.jsonl``, whose SHA-256 must be ``digest``.

    The log is written before its checkpoint: a process killed between the two leaves more lines, which are dropped.

    Raises
    ------
    DamagedFile
        If the log is not as the run left it beside its checkpoint.
    """
    log_path = out / "log.jsonl"
    with decoding(log_path, "the log of this run", f"Delete {out / 'checkpoint.npz'} {AND_GROW_AGAIN}."):
        log_lines = existing_file(log_path, "log").read_text("utf-8").splitlines(keepends=True)[:n_lines]
        if (as_bytes("".join(log_lines)) != digest).any():
            raise DamagedFile("its lines do not belong to this checkpoint")
        return [json.loads(text) for text in log_lines]


def restart_of(out: Path, scene: Scene, start_path: str | Path | None) -> Row | None:
    """The entry of ``inputs.json`` for the state at which a run in ``out`` begins; None if it begins ungrown.

    For a resumed run this is the entry in its ``inputs.json``. A new run begins at ``start_path``, the folder of a
    stage or of a run; of a run, the state of the largest growth is taken.

    Raises
    ------
    FileNotFoundError, ValueError
        If there is no such state, it is damaged, or its growth is beyond the scene's final one.
    """
    begun_inputs = begun_with(out)
    if begun_inputs or start_path is None:
        return begun_inputs.get("restart")
    folder = Path(os.path.abspath(start_path))
    run_folder = folder.parent.parent if (folder / "stage.json").is_file() else folder
    if not (run_folder / "scene.toml").is_file():
        raise FileNotFoundError(f"{folder}: is not the folder of a run or of a stage. Name one to restart from.")
    with decoding(run_folder / "scene.toml", "a scene as a run writes it"):
        other_scene = load_scene(run_folder / "scene.toml")
    all_effects = [*scene.effects.items(), *other_scene.effects.items()]
    if names := [name for name, options in all_effects if options.history]:
        raise DoesNotApply(
            f"{folder}: with effects.{names[0]} a run can't begin at the state of another one, whose files do not hold "
            "the growth of the core. Let it grow from the start."
        )
    volume_files = {g: stage_folder(run_folder, g) / VOLUME_FILE for g in stages_with_volume(run_folder, other_scene)}
    states = [(g, file) for g, file in volume_files.items() if folder in (run_folder, file.parent)]
    checkpoint = run_folder / "checkpoint.npz"
    if folder == run_folder and checkpoint.is_file() and other_scene.not_nested:
        states.append((_read_state(checkpoint)[-1], checkpoint))
    if not states:
        raise MissingPart(
            f"{folder}: holds no state to restart from: no checkpoint of one mesh, and no stage with {VOLUME_FILE}. A "
            "run with output.volume = false or of one dimension writes no volume. Name another run."
        )
    growth, file = max(states, key=lambda state: state[0])  # of two at the same growth the first, a stage
    if growth > scene.growth.final:
        raise OutOfRange(
            f"{file}: is at g = {growth:g}, beyond growth.final = {scene.growth.final:g} of {scene.name}. Raise "
            "growth.final, or restart from the folder of an earlier stage."
        )
    if file.name == VOLUME_FILE:
        read_stage(run_folder, growth)  # raises if it is damaged
    return {"file": str(file), "sha256": sha256_of(file), "scene_sha256": scene_digest(run_folder), "growth": growth}


def state_of(restart: Mapping[str, Any], body: Body, scene: Scene) -> State:
    """The state at which a run begins: positions, growth and, from a checkpoint, velocities.

    Raises
    ------
    FileNotFoundError, ValueError
        If its file is missing, has changed, or has another mesh than the body.
    """
    from morphofold.sim.dynamics import State

    path = existing_file(restart["file"], "state to restart from")
    if (now := sha256_of(path)) != restart["sha256"]:
        raise Mismatch(
            f"{path}: has changed since a run was started from it (sha256 {restart['sha256'][:12]}... then, {now[:12]}"
            "... now). Restore the old file, or choose another folder."
        )
    x, v, X, _ = _read_state(path)
    check_mesh(path, X, body.X, scene)
    if scene.real_time:  # velocities are per step, and its length differs
        v[:] = 0.0
    return State(x, v, growth=restart["growth"])


def check_mesh(state_file: Path, X: Array, body_X: Array, scene: Scene) -> None:
    """Raise ``Mismatch`` unless the reference positions X equal those of the body."""
    difference_text = f"has {len(X):,} nodes, but the body of {scene.name} has {len(body_X):,}"
    if X.shape == body_X.shape:
        distances = np.linalg.norm(X - body_X, axis=1)
        if distances.max() <= POSITION_ROUND_OFF * np.ptp(body_X, axis=0).max():
            return
        node = distances.argmax()
        difference_text = f"has node {node} {distances[node]:.3g} mm from its position in the body of {scene.name}"
    raise Mismatch(
        f"{state_file}: {difference_text} before growth. Use the geometry, mesh and imperfection of the run to continue"
        f"{_wavelength_advice(state_file, scene)}."
    )


def _read_state(state_file: Path) -> tuple[Array, Array, Array, float]:
    """Positions, velocities, reference positions (N, 3) and growth of a checkpoint. A volume has no velocities and no
    growth: they are returned as 0 and 1."""
    with decoding(state_file, "a state to restart from"):
        if state_file.name == VOLUME_FILE:
            X, x = read_volume(state_file)
            v, growth = np.zeros(x.shape), 1.0
        else:
            with np.load(existing_file(state_file), allow_pickle=False) as arrays:
                x, v, X = (arrays[name].astype(np.float64) for name in ("x", "v", "reference"))
                v *= "inertia.dt" not in arrays.files  # with inertia they are per step of another length
                growth = float(arrays["growth"])
        if not (x.shape == v.shape == X.shape and growth >= 1 and np.isfinite([x, v, X]).all()):
            raise DamagedFile("its positions, velocities, nodes and growth are not those of a body")
    return np.ascontiguousarray(x), v, X, growth


def _wavelength_advice(file: Path, scene: Scene) -> str:
    """How to set the imperfection of the other run; its wavelength depends on the material unless it is set."""
    from morphofold.sim.effects.perturbation import build

    with suppress(OSError, ValueError):
        other_scene = load_scene((file.parent if file.suffix == ".npz" else file.parents[2]) / "scene.toml")
        if "perturbation" in scene.effects and "perturbation" in other_scene.effects:
            other_value, own = (build(each.effects["perturbation"], each).wavelength for each in (other_scene, scene))
            if other_value != own:
                return f": effects.perturbation.wavelength = {other_value!r}, for example"
    return ""
