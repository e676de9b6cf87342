"""The series that ParaView opens: times, files, and what becomes of it in stopped and damaged folders."""

import json
from xml.etree import ElementTree

import meshio
import numpy as np
import pytest
import pyvista
from made_simulations import Stop

from morphofold.cli import main
from morphofold.sim.output.run_inputs import clear_run, files_of_run
from morphofold.sim.output.stage_records import read_volume
from morphofold.sim.run import simulate

TINY = [
    "geometry.portion=octant",
    "accuracy.edge=9.82",
    "growth.rate=4",
    "growth.final=1.2",
    "output.stages=[1.1, 1.125]",
    "output.checkpoint_minutes=1e-6",
]


@pytest.fixture
def run(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return simulate("demo", "run", settings=TINY).path


def series(folder):
    """Growth and file of each stage that ``stages.pvd`` names."""
    root = ElementTree.parse(folder / "stages.pvd").getroot()
    assert (root.tag, root.get("type")) == ("VTKFile", "Collection")
    return {float(row.get("timestep")): row.get("file") for row in root.findall("Collection/DataSet")}


def test_the_series_of_a_run_opens_with_the_growth_of_each_stage_as_its_time(run, tmp_path):
    reader = pyvista.PVDReader(str(run / "stages.pvd"))
    assert reader.time_values == [1.1, 1.125, 1.2]  # folders are named to two digits: g1.12
    for g, name in series(run).items():
        reader.set_active_time_value(g)
        _, x = read_volume(run / name)
        np.testing.assert_array_equal(reader.read()[0].points, x)
        assert json.loads((run / name).with_name("stage.json").read_text())["g"] == g
    run.rename(tmp_path / "elsewhere")  # names are from the series on
    assert all((tmp_path / "elsewhere" / name).is_file() for name in series(tmp_path / "elsewhere").values())


def test_positions_are_read_back_to_the_last_bit(tmp_path, rng):
    X, x = rng.standard_normal((2, 8, 3))
    mesh = meshio.Mesh(x, [("tetra", np.arange(8).reshape(2, 4))], point_data={"reference": X})
    mesh.write(tmp_path / "volume.vtu")
    for read, written in zip(read_volume(tmp_path / "volume.vtu"), (X, x)):
        assert read.dtype == np.float64
        np.testing.assert_array_equal(read, written)


def test_the_series_grows_with_the_stages_of_a_run_that_is_stopped_and_resumed(tmp_path):
    out = tmp_path / "run"

    def stop(share, text):
        if (out / "stages" / "g1.10").exists() and (out / "checkpoint.npz").exists():
            raise Stop

    with pytest.raises(Stop):
        simulate("demo", out, settings=TINY, progress=stop)
    assert series(out) == {1.1: "stages/g1.10/volume.vtu"}
    (out / "stages.pvd").unlink()  # as if killed between stage and series
    with pytest.raises(Stop):
        simulate("demo", out, settings=TINY, progress=stop, resume=True)
    assert list(series(out)) == [1.1]
    simulate("demo", out, settings=TINY, resume=True)
    assert list(series(out)) == [1.1, 1.125, 1.2]


@pytest.mark.parametrize(("scene", "settings"), [("demo", [*TINY, "output.volume=false"]), ("fig3", [])])
def test_a_run_without_volumes_has_no_series(scene, settings, tmp_path):
    assert not (simulate(scene, tmp_path / "run", settings=settings).path / "stages.pvd").exists()


def test_a_finished_run_with_a_damaged_series_is_made_whole(run):
    written = (run / "stages.pvd").read_bytes()
    (run / "stages.pvd").write_bytes(written[: len(written) // 2])
    command = ["simulate", "demo", "-o", "run", "-q", "--resume", *(word for s in TINY for word in ("--set", s))]
    before = (run / "health.json").stat().st_mtime_ns
    assert main(command) == 0
    assert (run / "stages.pvd").read_bytes() == written
    assert (run / "health.json").stat().st_mtime_ns == before


def test_the_series_is_a_file_of_the_run(run):
    assert "stages.pvd" in files_of_run(run)
    clear_run(run)
    assert not run.exists()
