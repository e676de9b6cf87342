"""The stages of a run: their files for ParaView, and ``stage.json`` and ``health.json`` read back; damaged files and
files of another run are refused."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
from pydantic import Field

from morphofold.digests_and_json import Row, sha256_of
from morphofold.errors import DamagedFile, Mismatch, MissingPart
from morphofold.frozen_arrays import Array
from morphofold.io import read_cortex
from morphofold.io.cortices import StageHealth, StageRecord
from morphofold.io.files import decoding, write_text
from morphofold.io.json_files import Amount, Count, Record, read_json
from morphofold.sim.output.run_inputs import AND_GROW_AGAIN, Digests, scene_digest, stage_folder, written_stages
from morphofold.sim.scene import Scene

if TYPE_CHECKING:
    from morphofold.sim.body import Body

VOLUME_FILE, SERIES_FILE = "volume.vtu", "stages.pvd"


class Health(Record):
    """What every ``health.json`` of a finished run has."""

    morphofold: str
    healthy: bool
    warnings: list[str]
    stages: Annotated[list[StageHealth], Field(min_length=1)]
    steps: Count
    seconds: Amount


def read_health(folder: Path) -> Row:
    """Contents of ``health.json`` of a finished run; raises as :func:`morphofold.io.json_files.read_json`."""
    return read_json(folder / "health.json", Health, f"Delete it {AND_GROW_AGAIN}.")


def read_stage(out: Path, g: float) -> Row:
    """Contents of ``stage.json`` at growth ``g``, after a check that the files of the stage are unchanged.

    If a stage has no ``files.json`` (digests of its files), its surfaces and maps must be readable. If it has no digest
    of its scene, the scene is not checked.

    Raises
    ------
    ValueError
        If something is missing, truncated or of another stage.
    """
    stage_path = stage_folder(out, g)
    others_text = "".join(f" and {out / name}" for name in ("checkpoint.npz", "health.json") if (out / name).exists())
    cure = f"Delete {stage_path}{others_text}; --resume then grows it again."
    stage_file, digests_file = stage_path / "stage.json", stage_path / "files.json"
    record = read_json(stage_file, StageRecord, cure)
    if record.get("scene_sha256", scene_digest(out)) != scene_digest(out):
        raise Mismatch(f"{stage_file}: belongs to a run with another scene or mesh. {cure}")
    if record.get("g") != g or record.get("health", {}).get("growth") != g:
        raise DamagedFile(f"{stage_file}: is for g = {record.get('g')!r} or has no health numbers for {g:g}. {cure}")
    digests = read_json(digests_file, Digests, cure) if digests_file.exists() else {}
    with decoding(stage_path, "a stage", cure):
        for name, digest in digests.items():
            if not (stage_path / name).is_file() or sha256_of(stage_path / name) != digest:
                raise DamagedFile(f"{name} is missing or has changed since it was written")
        read_cortex(stage_path)
    return record


def check_stages(out: Path, scene: Scene) -> dict[float, Row]:
    """The ``stage.json`` of each stage in the folder, by growth; raises if one is damaged or not of the scene."""
    growth_by_folder = {stage_folder(out, g): g for g in scene.stages}
    folders = sorted((out / "stages").glob("g*"))
    if other_folders := [path for path in folders if path not in growth_by_folder]:
        raise Mismatch(f"{other_folders[0]}: is not a stage of this scene. Move it away.")
    return {growth_by_folder[path]: read_stage(out, growth_by_folder[path]) for path in folders}


def check_written(out: Path, growths: Sequence[float], later: Path) -> None:
    """Raise if a stage is missing that was written before ``later``, since it could not be written any more."""
    for stage_path in (stage_folder(out, g) for g in growths):
        if not stage_path.exists():
            raise MissingPart(
                f"{stage_path}: is missing, and {later} is beyond g = {growths[-1]:g}. Delete {later} {AND_GROW_AGAIN}."
            )


def check_finished(out: Path, scene: Scene) -> None:
    """Raise if ``health.json`` of a finished run or one of its stages is missing or damaged."""
    read_health(out)
    check_stages(out, scene)
    check_written(out, written_stages(out, scene), out / "health.json")


def write_volume(folder: Path, body: Body, x: Array) -> None:
    """Write ``volume.vtu``: the body at positions ``x`` (N, 3) [mm], its reference positions, and element fields.

    Stresses are in units of the core's shear modulus, energies in that unit times mm^3. Positions have 64 bits, element
    fields 32. Nothing is compressed: that would save a third of the file and take as long as 40 steps.
    """
    from morphofold.io.meshio_files import Mesh, write_mesh
    from morphofold.sim.elements.bricks import CORNERS_IN_KERNEL_ORDER
    from morphofold.sim.equilibrium.tangent import stress_of_elements

    element_state = body.elements.state()
    is_cortex = (np.arange(body.elements.n) < body.elements.n_cortex).astype(np.uint8)
    corners = body.bilayer.mesh.t.T
    is_brick_mesh = corners.shape[1] == 8
    if is_brick_mesh:
        corners = corners[:, CORNERS_IN_KERNEL_ORDER[[0, 4, 6, 2, 1, 5, 7, 3]]]  # VTK's order of i, j, k
    cell_fields = {
        "volume_ratio": element_state["volume_ratio"],
        "min_J": element_state["J_min"],
        "energy": element_state["energy"],
        "cauchy_stress": stress_of_elements(body, x),
    }
    mesh = Mesh(
        x,
        [("hexahedron" if is_brick_mesh else "tetra", corners.astype(np.int32))],
        point_data={"reference": body.X, "displacement": x - body.X},
        cell_data={"cortex": [is_cortex], **{name: [field.astype(np.float32)] for name, field in cell_fields.items()}},
    )
    write_mesh(folder / VOLUME_FILE, mesh, compression=None)


def read_volume(path: Path) -> tuple[Array, Array]:
    """Reference and deformed positions X, x (N, 3) [mm] of a ``volume.vtu``, bitwise as they were written."""
    from morphofold.io.meshio_files import read_mesh

    mesh = read_mesh(path)
    return np.asarray(mesh.point_data["reference"]), np.asarray(mesh.points)


def stages_with_volume(out: Path, scene: Scene) -> list[float]:
    """Growth of the stages in a run's folder that have a volume, ascending."""
    return [g for g in scene.stages if (stage_folder(out, g) / VOLUME_FILE).is_file()]


def write_series(out: Path, scene: Scene) -> None:
    """Write ``stages.pvd``, a collection of VTK files with the growth as time, for the stages in the folder, unless it
    is up to date or no stage has a volume."""
    dataset_lines = [
        f'    <DataSet timestep="{g!r}" part="0" file="{stage_folder(Path(), g).as_posix()}/{VOLUME_FILE}"/>\n'
        for g in stages_with_volume(out, scene)
    ]
    header = '<?xml version="1.0"?>\n<VTKFile type="Collection" version="0.1">\n  <Collection>\n'
    series_text, path = f"{header}{''.join(dataset_lines)}  </Collection>\n</VTKFile>\n", out / SERIES_FILE
    if dataset_lines and not (path.exists() and path.read_bytes() == series_text.encode()):
        write_text(path, series_text)
