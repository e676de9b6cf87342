import json
import re
import subprocess
import sys

import numpy as np
import pytest

import morphofold as mf
from morphofold.cli import main
from morphofold.sim import theory
from morphofold.sim.materials.elastic import energy
from morphofold.sim.run import simulate
from morphofold.studies.accuracy.radial_finite_elements import radial_equilibrium

STRESSES = ("sigma_r", "sigma_theta")
COLUMNS = ["layer", "R_mm", "r_mm", *STRESSES, "J"]


@pytest.fixture(scope="module")
def fig3(tmp_path_factory):
    return simulate("fig3", tmp_path_factory.mktemp("radial") / "fig3", settings=["output.stages=[1.2, 1.5]"])


def profile(simulation, g):
    """Columns of a stage's profile by name, and whether each row lies in the cortex."""
    head, *rows = (simulation.path / "stages" / f"g{g:.2f}" / "profile.tsv").read_text().splitlines()
    assert head.split("\t") == COLUMNS
    layers, *columns = zip(*(row.split("\t") for row in rows))
    return dict(zip(COLUMNS[1:], np.array(columns, dtype=float))), np.array(layers) == "cortex"


def test_the_radius_of_fig_3a_follows_equation_11(fig3):
    assert fig3.stages == (1.2, 1.5, 2.0)
    for stage in fig3.health["stages"]:
        exact = 48 * theory.deformed_radius(stage["growth"], 50 / 48)
        assert stage["mean_radius_mm"] == pytest.approx(exact, rel=1.5e-3)  # kappa = 2000 mu, and p = -5 mu


def test_a_profile_goes_through_both_layers_in_mm(fig3):
    columns, cortex = profile(fig3, 1.5)
    assert columns["R_mm"][[0, -1]] == pytest.approx([25, 50])
    assert columns["R_mm"][cortex].min() == columns["R_mm"][~cortex].max() == pytest.approx(48)
    assert columns["r_mm"][0] == pytest.approx(25)  # the hole is held
    assert np.all(np.diff(columns["r_mm"][cortex]) > 0)
    interface = np.flatnonzero(columns["R_mm"] == 48)
    assert np.ptp(columns["r_mm"][interface]) < 1e-7
    assert np.ptp(columns["sigma_r"][interface]) < 1e-4  # equilibrium; sigma_theta jumps
    assert np.ptp(columns["sigma_theta"][interface]) > 1


@pytest.mark.parametrize("law", ["isotropic", "tangential"])
def test_the_profile_is_that_of_finite_elements_and_the_energy_its_integral(tmp_path, law):
    settings = [f"growth.law={law}", "output.stages=[]", "growth.final=1.5", "effects.core_growth.final=1.1"]
    simulation = simulate("fig3-thick", tmp_path / "x", settings=[*settings, "material.mu_ratio=2"])
    columns, cortex = profile(simulation, 1.5)
    exact = radial_equilibrium(1.5, 3 / 50, 2.0, law, 2000.0, g_core=1.1, elements=12)
    for layer, rows in (("core", ~cortex), ("cortex", cortex)):
        state = exact.at(columns["R_mm"][rows] / 50, layer)
        for name, values in (("r_mm", 50 * state.r), ("J", state.J), *((s, getattr(state, s)) for s in STRESSES)):
            np.testing.assert_allclose(columns[name][rows], values, rtol=1e-7, atol=1e-7)
    total = 0.0
    for layer, g, mu in ((~cortex, 1.1, 1.0), (cortex, 1.5, 2.0)):
        R, r, J = (columns[name][layer] for name in ("R_mm", "r_mm", "J"))
        beta = r / R / g
        A = np.zeros((len(R), 3, 3))
        A[:, 0, 0], A[:, 1, 1], A[:, 2, 2] = J / beta**2, beta, beta
        grown = g**2 if law == "tangential" and mu == 2 else g**3
        total += np.trapezoid(grown * energy(A, mu, 2000.0 * mu) * 4 * np.pi * R**2, R)
    assert simulation.health["stages"][0]["strain_energy"] == pytest.approx(total, rel=1e-3)


def test_a_scene_of_one_dimension_never_touches_the_solver_of_three(tmp_path):
    code = (
        "import sys, morphofold as mf; mf.simulate('fig3', 'x', settings=['output.stages=[1.5]'])\n"
        "print(*[m.removeprefix('morphofold.sim.') for m in sys.modules if m.startswith('morphofold.sim.')])"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True)
    loaded = set(done.stdout.split())
    assert {"radial_run", "sphere_theory.smooth_sphere"} <= loaded
    solver = {"dynamics", "body", "build", "health", "mesh", "elements"}
    assert not {name.partition(".")[0] for name in loaded} & solver
    assert not [name for name in loaded if name.startswith("effects.")]
    health = json.loads((tmp_path / "x" / "health.json").read_text())
    assert set(health["seconds_by_phase"]) == {"radial"}
    assert health["effects"] == []


def test_a_radial_stage_carries_the_maps_of_a_freesurfer_subject(tmp_path):
    cortex = mf.simulate("fig3-thick", tmp_path / "x", settings=["output.stages=[]", "growth.final=1.5"]).cortex()
    white, pial = (np.linalg.norm(s.verts, axis=1).mean() for s in (cortex.white, cortex.pial))
    assert 2_000 < len(cortex.pial.verts) < 10_000
    assert (cortex.portion, cortex.info["shape"], cortex.info["reference_radius"]) == (1.0, "radial", 50.0)
    assert cortex.maps["thickness"].mean() == pytest.approx(pial - white, rel=1e-2)
    assert cortex.maps["curv"].mean() == pytest.approx(-1 / white, rel=1e-2)


def test_a_stopped_radial_run_goes_on_with_the_stages_left(fig3, tmp_path):
    class Stop(Exception):
        pass

    def stop(share, text):
        raise Stop

    settings, out = ["output.stages=[1.2, 1.5]"], tmp_path / "fig3"
    with pytest.raises(Stop):
        simulate("fig3", out, settings=settings, progress=stop)
    assert [p.name for p in (out / "stages").iterdir()] == ["g1.20"]
    written = (out / "stages" / "g1.20" / "stage.json").stat().st_mtime_ns
    again = simulate("fig3", out, settings=settings, resume=True)
    assert (out / "stages" / "g1.20" / "stage.json").stat().st_mtime_ns == written
    assert again.stages == fig3.stages
    assert again.health["stages"] == fig3.health["stages"]
    lines = [json.loads(line) for line in (out / "log.jsonl").read_text().splitlines()]
    assert [line["growth"] for line in lines] == [1.2, 1.5, 2.0]
    with pytest.raises(FileExistsError, match=rf"{re.escape(str(out))}: .*\bresume\b"):
        simulate("fig3", out, settings=settings)


def test_the_command_tells_the_radius(tmp_path, capsys):
    out = tmp_path / "x"
    settings = ["--set", "growth.final=1.5", "--set", "output.stages=[]"]
    assert main(["simulate", "fig3", "-o", str(out), *settings, "-q"]) == 0
    printed = capsys.readouterr().out
    assert printed.startswith(f"{out}: 1 stages to g = 1.50, in one dimension in ")
    assert "outer radius 54.2" in printed
