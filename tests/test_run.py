import errno
import json
import re
import subprocess
import sys
import time

import meshio
import numpy as np
import pytest
from made_simulations import TINY, stop_run

import morphofold as mf
from morphofold.sim.dynamics import STEPS_PER_MEASUREMENT, Dynamics, UnstableError
from morphofold.sim.equilibrium.wrinkle_onset import first_wrinkles
from morphofold.sim.run import simulate
from morphofold.sim.scene.scene_files import load_scene
from morphofold.sim.stage_checks import BOUNDS, broken_bounds
from morphofold.timing import peak_memory

SMALL = [
    "geometry.portion=octant",
    "accuracy.edge=6.55",
    "accuracy.precision=double",
    "growth.final=1.6",
    "growth.rate=4",
    "output.stages=[1.2]",
    "effects.perturbation.amplitude=0.05",
]

COARSE = [*TINY, "output.stages=[]"]

#: the corners that each corner of VTK's hexahedron shares an edge with, right-handed
VTK_HEXAHEDRON = [(1, 3, 4), (2, 0, 5), (3, 1, 6), (0, 2, 7), (7, 5, 0), (4, 6, 1), (5, 7, 2), (6, 4, 3)]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("sim") / "small"
    mf.simulate("demo", out, settings=SMALL)
    return out


def test_a_simulation_folder_holds_what_was_promised(folder):
    assert load_scene(folder / "scene.toml") == load_scene("demo", SMALL)
    stages = sorted(p.name for p in (folder / "stages").iterdir())
    assert stages == ["g1.20", "g1.60"]
    for stage in stages:
        files = {p.name for p in (folder / "stages" / stage / "surf").iterdir()}
        surfaces = {"lh.white", "lh.pial"}
        assert files == {*surfaces, "lh.sphere", "lh.thickness", "lh.curv", "lh.sulc", "lh.area"}
    health = json.loads((folder / "health.json").read_text())
    assert health["effects"] == ["contact", "perturbation", "symmetry"]
    assert set(health["seconds_by_phase"]) >= {"elements", "contact"}
    assert health["threads"] == 1  # of a body so small
    assert 0 < health["peak_memory_GiB"] <= peak_memory()
    assert not (folder / "checkpoint.npz").exists()
    assert not [p for p in folder.rglob(".*") if p.name != ".morphofold"]  # no temporary files are left
    lines = [json.loads(line, parse_constant=pytest.fail) for line in (folder / "log.jsonl").read_text().splitlines()]
    assert len(lines) > 20
    assert np.all(np.diff([line["step"] for line in lines]) >= 0)
    assert np.all(np.diff([line["growth"] for line in lines]) >= 0)
    assert lines[-1]["growth"] == 1.6
    assert {"strain_energy", "kinetic_energy", "min_J", "seconds", "effects"} <= set(lines[0])


@pytest.mark.parametrize("precision", ["single", "double"])
def test_the_work_of_growth_in_the_log_is_what_the_body_has_and_what_was_damped(tmp_path, precision):
    """Of a strip that folds until walls touch, with a bulk modulus that is split, and whole."""
    size = ["geometry.length=28", "geometry.depth=12", "accuracy.edge=1.0", "accuracy.elements_through_cortex=3"]
    more = ["growth.final=2.0", "output.stages=[1.4]", "output.volume=false", f"accuracy.precision={precision}"]
    simulate("strip", tmp_path / "run", settings=[*size, *more], threads=1)
    line = json.loads((tmp_path / "run" / "log.jsonl").read_text().splitlines()[-1])
    energy = line["strain_energy"] + line["kinetic_energy"] + line["effects"]["contact"]["energy"]
    assert energy + line["dissipated_energy"] == pytest.approx(line["work"], rel=0.01)
    assert line["dissipated_energy"] > 0.005 * line["work"]
    assert line["effects"]["contact"]["pairs"] > 0


def test_stages_read_back_as_cortices_of_a_whole_sphere(folder):
    first, last = (mf.read_cortex(folder / "stages" / g) for g in ("g1.20", "g1.60"))
    assert mf.read_cortex(folder).info["g"] == 1.6
    assert first.origin == "simulation"
    assert first.portion == 0.125
    assert first.info["reference_thickness"] == 3.0
    # before onset the cortex is a shell between the radii of Eq. (11) and the hardly moved white surface
    exact = (47.0**3 + 1.2**3 * (50.0**3 - 47.0**3)) ** (1 / 3)
    assert np.linalg.norm(first.pial.verts, axis=1).mean() == pytest.approx(exact, rel=5e-3)
    thickness = np.linalg.norm(first.pial.verts, axis=1).mean() - np.linalg.norm(first.white.verts, axis=1).mean()
    assert first.maps["thickness"].mean() == pytest.approx(thickness, rel=0.02)
    assert first.maps["area"].sum() == pytest.approx(4 * np.pi * 47.0**2, rel=0.02)
    assert first.maps["curv"].mean() == pytest.approx(-1 / 47.0, rel=0.1)  # FreeSurfer's sign: convex is negative
    assert np.linalg.norm(last.pial.verts, axis=1).std() > 3 * np.linalg.norm(first.pial.verts, axis=1).std()


def test_the_volume_opens_with_its_layers_and_ratios(folder):
    mesh = meshio.read(folder / "stages" / "g1.20" / "volume.vtu")
    corners = mesh.points[mesh.cells_dict["hexahedron"]]
    for corner, ends in enumerate(VTK_HEXAHEDRON):
        x, y, z = (corners[:, k] - corners[:, corner] for k in ends)
        assert np.einsum("ij,ij->i", np.cross(x, y), z).min() > 0  # VTK's corner order
    layers = mesh.cell_data["cortex"][0]
    assert 0 < layers.mean() < 1
    np.testing.assert_allclose(mesh.points, mesh.point_data["reference"] + mesh.point_data["displacement"], atol=1e-12)
    np.testing.assert_allclose(mesh.cell_data["volume_ratio"][0], 1.0, atol=0.2)


def test_a_stopped_run_goes_on_and_ends_with_the_same_bytes(folder, tmp_path):
    often = [*SMALL, "output.checkpoint_minutes=1e-6"]
    out = stop_run(tmp_path / "small", often, 0.75)
    assert (out / "stages" / "g1.20").exists()
    with (out / "log.jsonl").open("r+") as log:  # as if killed between log and checkpoint, at the end of a rest
        log.write(log.readlines()[-1])
    simulate("demo", out, settings=often, resume=True)
    for name in ("lh.pial", "lh.white"):
        ends = [(o / "stages" / "g1.60" / "surf" / name).read_bytes() for o in (folder, out)]
        assert _geometry(ends[0]) == _geometry(ends[1])
    logs = [[json.loads(line) for line in (o / "log.jsonl").read_text().splitlines()] for o in (folder, out)]
    assert [line["step"] for line in logs[0]] == [line["step"] for line in logs[1]]
    for time_of in (lambda line: line["elapsed"], lambda line: line["seconds"]["elements"]):  # they go on counting
        assert np.all(np.diff([time_of(line) for line in logs[1]]) >= 0)


def _geometry(raw):
    """A FreeSurfer surface without its comment lines, which hold the time."""
    return raw[raw.index(b"\n\n") :]


def test_a_finished_run_is_not_repeated(folder):
    before = (folder / "health.json").stat().st_mtime_ns
    assert mf.simulate("demo", folder, settings=SMALL, resume=True).stages == (1.2, 1.6)
    assert (folder / "health.json").stat().st_mtime_ns == before


def test_a_run_that_breaks_down_leaves_its_log_and_its_last_sound_state(tmp_path, monkeypatch):
    step = Dynamics._run

    def break_down(self, steps, growth=None):
        if self.state.step >= 10 * steps:
            self.state.x[7] = np.nan
        step(self, steps, growth)

    monkeypatch.setattr(Dynamics, "_run", break_down)
    with pytest.raises(UnstableError, match=r"\bnode 7\b"):
        simulate("demo", tmp_path / "x", settings=SMALL)
    with np.load(tmp_path / "x" / "last-sound-state.npz", allow_pickle=False) as sound:
        assert np.isfinite(sound["x"]).all()
        assert sound["step"] == 10 * STEPS_PER_MEASUREMENT
    assert json.loads((tmp_path / "x" / "log.jsonl").read_text().splitlines()[-1])["step"] <= 10 * STEPS_PER_MEASUREMENT
    assert not (tmp_path / "x" / "health.json").exists()


def test_a_run_that_breaks_a_bound_is_not_healthy_and_says_why(tmp_path):
    """So compressible a cortex gives way instead of growing."""
    soft = ["growth.final=1.3", "growth.rate=1", "material.kappa_ratio=5"]
    simulation = simulate("demo", tmp_path / "soft", settings=[*COARSE, *soft])
    stage = json.loads(next(simulation.path.glob("stages/*/stage.json")).read_text())
    assert not simulation.health["healthy"]
    assert simulation.health["warnings"] == stage["warnings"]
    assert [warning.split()[0] for warning in stage["warnings"]] == ["volume_drift"]


def test_waves_without_a_length_do_not_judge_the_mesh(tmp_path):
    """A cortex softer than its core wrinkles first in the shortest waves of all."""
    settings = ["geometry.portion=octant", "accuracy.edge=8", "material.mu_ratio=0.1", "output.volume=false"]
    run = simulate("fig6-thick", tmp_path / "run", settings=[*settings, "growth.final=1.9", "output.stages=[]"])
    assert first_wrinkles(run.scene).wavelength_over_T == 0
    assert first_wrinkles(run.scene).growth < 1.9
    (stage,) = run.health["stages"]
    assert stage["cell_over_wave"] is None
    assert stage["cell_over_T"] > 1


@pytest.mark.slow
def test_a_mesh_too_coarse_for_its_folds_is_not_healthy_but_a_smooth_body_on_it_is(tmp_path):
    """Edges of 1.2 T; first wrinkles are expected at 1.23."""
    for name, settings, sound in (
        ("edges", ["accuracy.edge=3.6"], False),
        ("both", ["accuracy.edge=2.1", "accuracy.elements_through_cortex=2"], True),
    ):
        run = [*TINY[:1], *TINY[2:4], "growth.final=1.25", "output.stages=[1.2]", *settings]
        smooth, folded = simulate("fig6-thick", tmp_path / name, settings=run).health["stages"]
        assert smooth["cell_over_T"] is None
        assert (folded["cell_over_T"] <= BOUNDS["cell_over_T"][0]) == sound
        assert (not any("cell_over_T" in line for line in broken_bounds(folded))) == sound


@pytest.mark.parametrize(
    ("scene", "law", "settings"),
    [
        ("strip", "isotropic", ["geometry.length=8", "accuracy.elements_through_cortex=3"]),
        ("patch", "tangential", ["geometry.size=[4, 4]"]),
    ],
)
def test_the_drift_of_a_body_that_is_not_closed_is_from_its_grown_volume(scene, law, settings, tmp_path):
    settings = [
        *settings,
        "geometry.depth=8",
        "accuracy.edge=2",
        "accuracy.precision=double",
        "growth.final=1.15",
        f"growth.law={law}",
        "output.stages=[]",
    ]
    (stage,) = simulate(scene, tmp_path / "x", settings=settings).health["stages"]
    assert stage["volume_drift"] < 0.03  # det G is 1.52 and 1.32


def test_folders_of_others_are_left_alone(folder, tmp_path):
    with pytest.raises(FileExistsError, match=rf"{re.escape(str(folder))}: .*\bresume\b"):
        simulate("demo", folder, settings=SMALL)
    with pytest.raises(FileExistsError, match=rf"{re.escape(str(folder))}: (?!.*\bresume\b)"):
        simulate("fig5", folder, resume=True)
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(FileExistsError, match=rf"{re.escape(str(tmp_path))}: (?!.*\bresume\b)"):
        simulate("demo", tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == ["notes.txt"]


@pytest.mark.slow
def test_a_killed_process_loses_one_interval_at_most_and_ends_with_the_same_bytes(folder, tmp_path):
    out = tmp_path / "small"
    often = [*SMALL, "output.checkpoint_minutes=1e-6"]
    code = f"import morphofold as mf; mf.simulate('demo', {str(out)!r}, settings={often!r})"
    process = subprocess.Popen([sys.executable, "-c", code])
    while not (out / "stages" / "g1.20").exists() or not (out / "checkpoint.npz").exists():
        assert process.poll() is None, "ended before it could be killed"
        time.sleep(0.01)
    process.kill()
    process.wait()
    with np.load(out / "checkpoint.npz", allow_pickle=False) as checkpoint:
        assert checkpoint["growth"] >= 1.2 - 0.02
    simulate("demo", out, settings=often, resume=True)
    for name in ("lh.pial", "lh.white"):
        ends = [(o / "stages" / "g1.60" / "surf" / name).read_bytes() for o in (folder, out)]
        assert _geometry(ends[0]) == _geometry(ends[1])


def test_a_full_disk_is_said_and_leaves_what_was_written(tmp_path, monkeypatch):
    out = tmp_path / "small"
    write = type(out).write_bytes

    def full(self, content):
        if self.name.startswith(".") and "checkpoint" in self.name and (out / "checkpoint.npz").exists():
            raise OSError(errno.ENOSPC, "No space left on device", str(self))
        return write(self, content)

    monkeypatch.setattr(type(out), "write_bytes", full)
    with pytest.raises(OSError, match=r"\bg = 1\.0.*--resume\b"):
        simulate("demo", out, settings=TINY)
    with np.load(out / "checkpoint.npz", allow_pickle=False) as checkpoint:
        assert np.isfinite(checkpoint["x"]).all()
    assert not list(out.glob(".*checkpoint*"))  # no half-written file is left


@pytest.mark.slow
def test_a_body_of_tetrahedra_that_has_not_grown_has_not_drifted(tmp_path):
    """Its white surface cuts through tetrahedra and encloses another volume than theirs."""
    simulation = simulate("mesh", tmp_path / "mesh", settings=["growth.final=1.0", "output.stages=[]"])
    assert simulation.health["stages"][-1]["volume_drift"] < 1e-12
    assert simulation.health["healthy"]
