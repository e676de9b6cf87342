"""Simulation folders with known folds, written without simulating."""

import json
from pathlib import Path

import numpy as np
import pytest
import reference

from morphofold.shapes import icosphere
from morphofold.sim.output.simulation_folder import FolderWriter, Simulation
from morphofold.sim.radial_run import RadialRun
from morphofold.sim.run import simulate
from morphofold.sim.scene.scene_files import load_scene
from morphofold.surface import Surface

LEVEL = 4  # 2,562 vertices


#: of a run of the scene ``demo`` that takes half a second, with a checkpoint after every measurement
TINY = [
    "geometry.portion=octant",
    "accuracy.edge=9.82",
    "accuracy.precision=double",
    "growth.rate=4",
    "growth.final=1.2",
    "output.stages=[1.1]",
    "output.checkpoint_minutes=1e-6",
    "effects.perturbation.wavelength=20",
]


class Stop(Exception):
    """Raised by a test from within a run, as if that was stopped."""


def stop_run(out, settings=TINY, share=0.85, **options):
    """Stop a run of ``demo`` when a share of it is done and it has a checkpoint; returns its folder."""

    def stop(done, text):
        if done > share and (out / "checkpoint.npz").exists():
            raise Stop

    with pytest.raises(Stop):
        simulate("demo", out, settings=settings, progress=stop, **options)
    return out


def cut(path):
    """Cut a file in half, TOML at an equals sign: half of its lines may be a scene of its own."""
    half = path.read_bytes()[: path.stat().st_size // 2]
    path.write_bytes(half[: half.rindex(b"=") + 1] if path.suffix == ".toml" else half)


def with_arrays(**changes):
    """A function that writes a checkpoint anew with arrays changed, or left out where they are None."""

    def damage(path):
        with np.load(path) as file:
            arrays = {**file, **changes}
        np.savez(path, **{name: array for name, array in arrays.items() if array is not None})

    return damage


def harmonic(verts, l, m):
    """Real harmonic of degree l and order m > 0 at vertices around the origin, mean square 1."""
    direction = verts / np.linalg.norm(verts, axis=1)[:, None]
    return np.sqrt(8 * np.pi) * reference.harmonic(direction, l, m).real


def three_mm(cortex):
    """Maps of a stage that cost nothing."""
    return {"thickness": np.full(cortex.n_vertices, 3.0)}


def made_simulation(
    out,
    scene,
    settings=(),
    *,
    height=lambda g, verts: 0 * verts[:, 0],
    warnings=(),
    describe=three_mm,
    log=({"growth": 1.0, "effects": {}},),
):
    """A sphere whose pial surface lies ``height(g, verts)`` [mm] outside of 50 mm at growth g, white 2 mm below."""
    scene = load_scene(scene, settings)
    out = Path(out)
    if scene.geometry.shape == "radial":
        writer = FolderWriter(out, scene, lambda cortex: {})
        RadialRun(scene, writer, lambda share, text: None, lambda: False).go()
        return Simulation(out, scene)
    writer = FolderWriter(out, scene, describe)
    writer.begin()
    verts, faces = icosphere(LEVEL, scene.geometry.radius)
    stages = [{"growth": g, "crossings": 0, "deepest_crossing": 0.0} for g in scene.stages]
    for g, numbers in zip(scene.stages, stages):
        pial = verts * (1 + height(g, verts) / scene.geometry.radius)[:, None]
        writer.stage(
            g,
            Surface(pial * 0.96, faces, name="lh.white"),
            Surface(pial, faces, name="lh.pial"),
            portion=0.5,
            reference_radius=scene.geometry.radius,
            numbers=numbers,
            warnings=[],
        )
    writer.log(list(log))
    writer.health(stages, list(warnings), elements=len(faces), steps=7, seconds=1.5)
    return Simulation(out, scene)


class MadeRuns:
    """What figures ask for: ``grow`` as given; ``shown`` are the works whose progress would have been shown."""

    draft = False

    def __init__(self, grow):
        self.grow, self.shown, self.done = grow, [], {}

    def once(self, words, work):
        if words not in self.done:
            self.shown.append(words)
            self.done[words] = work(lambda share, text="": None)
        return self.done[words]


def settle(path):
    """The numbers of an index without those that differ from run to run."""
    index = json.loads(Path(path).read_text(encoding="utf-8"))
    for figure in index["figures"].values():
        figure.pop("seconds")
        for simulation in figure.get("simulations", ()):
            simulation.pop("seconds")
    return index
