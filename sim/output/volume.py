"""Files for ParaView: the volume of each stage, and ``stages.pvd``, the series of volumes over growth."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from morphofold.arrays import Array
from morphofold.errors import DamagedFile
from morphofold.io.files import write_text
from morphofold.sim.output.run_files import stage_folder

if TYPE_CHECKING:
    from morphofold.sim.body import Body
    from morphofold.sim.scene import Scene

VOLUME_FILE, SERIES_FILE = "volume.vtu", "stages.pvd"


def write_volume(folder: Path, body: Body, x: Array) -> None:
    """Write ``volume.vtu``: the body at positions ``x`` (N, 3) [mm], its reference positions, and element fields.

    Stresses are in units of the core's shear modulus, energies in that unit times mm^3. Positions have 64 bits, element
    fields 32. Nothing is compressed: that would save a third of the file and take as long as 40 steps.
    """
    import meshio

    from morphofold.sim.elements.bricks import CORNERS_IN_KERNEL_ORDER
    from morphofold.sim.equilibrium.tangent import stress_of_elements

    element = body.elements.state()
    layer = np.zeros(body.elements.n, dtype=np.uint8)
    layer[: body.elements.n_cortex] = 1
    corners = body.bilayer.mesh.t.T
    bricks = corners.shape[1] == 8
    if bricks:
        corners = corners[:, CORNERS_IN_KERNEL_ORDER[[0, 4, 6, 2, 1, 5, 7, 3]]]  # VTK's order of i, j, k
    meshio.Mesh(
        x,
        [("hexahedron" if bricks else "tetra", corners.astype(np.int32))],
        point_data={"reference": body.X, "displacement": x - body.X},
        cell_data={
            "cortex": [layer],
            "volume_ratio": [element["volume_ratio"].astype(np.float32)],
            "min_J": [element["J_min"].astype(np.float32)],
            "energy": [element["energy"].astype(np.float32)],
            "cauchy_stress": [stress_of_elements(body, x).astype(np.float32)],
        },
    ).write(folder / VOLUME_FILE, compression=None)


def read_volume(path: Path) -> tuple[Array, Array]:
    """Reference and deformed positions X, x (N, 3) [mm] of a ``volume.vtu``, bitwise as they were written."""
    import meshio

    mesh = meshio.read(path)
    return np.asarray(mesh.point_data["reference"]), np.asarray(mesh.points)


def stages_with_volume(out: Path, scene: Scene) -> list[float]:
    """Growth of the stages in a run's folder that have a volume, ascending."""
    return [g for g in scene.stages if (stage_folder(out, g) / VOLUME_FILE).is_file()]


def write_series(out: Path, scene: Scene) -> None:
    """Write ``stages.pvd`` for the stages in the folder, unless it is up to date or no stage has a volume."""
    text = _series_text(out, scene)
    if text and _existing_series(out) != text.encode():
        write_text(out / SERIES_FILE, text)


def check_series(out: Path, scene: Scene) -> None:
    """Raise if ``stages.pvd`` does not match the stages in the folder; a missing file can be written again."""
    if _existing_series(out) not in (None, _series_text(out, scene).encode()):
        raise DamagedFile(f"{out / SERIES_FILE}: is not as the run wrote it. Delete it; --resume then writes it again.")


def _existing_series(out: Path) -> bytes | None:
    return (out / SERIES_FILE).read_bytes() if (out / SERIES_FILE).exists() else None


def _series_text(out: Path, scene: Scene) -> str:
    """Text of a collection of VTK files with the growth g as time; empty if there are none."""
    rows = [
        f'    <DataSet timestep="{g!r}" part="0" file="{stage_folder(Path(), g).as_posix()}/{VOLUME_FILE}"/>\n'
        for g in stages_with_volume(out, scene)
    ]
    if not rows:
        return ""
    return (
        '<?xml version="1.0"?>\n<VTKFile type="Collection" version="0.1">\n  <Collection>\n'
        f"{''.join(rows)}  </Collection>\n</VTKFile>\n"
    )
