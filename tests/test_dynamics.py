import numba
import numpy as np
import pytest

from morphofold.sim import dynamics
from morphofold.sim.body import Body
from morphofold.sim.dynamics import STEPS_PER_INCREMENT, STEPS_PER_MEASUREMENT, Dynamics, UnstableError, restlessness
from morphofold.sim.effects.contact import Contact
from morphofold.sim.effects.perturbation import Perturbation
from morphofold.sim.effects.symmetry import Symmetry
from morphofold.sim.mesh.brick_mesh import bilayer_sphere
from morphofold.threads import using_threads


def make_run(
    T=3.0, n=16, portion="octant", law="isotropic", amplitude=None, contact=False, kappa_ratio=50.0, steps=1500
):
    bilayer = bilayer_sphere(50, T, 25, portion, n)
    X = None if amplitude is None else Perturbation(amplitude * T, 24.0, seed=0).reshape(bilayer, bilayer.mesh.p.T)
    body = Body(bilayer, mu_cortex=1.0, mu_core=1.0, kappa_ratio=kappa_ratio, law=law, X=X)
    return Dynamics(body, [Contact(), Symmetry()] if contact else [], steps_per_unit=steps)


@pytest.mark.parametrize(("law", "T"), [("isotropic", 3.0), ("tangential", 1.0)])
def test_radius_before_onset_follows_equation_11(law, T):
    """c^3 = B^3 + det(G) (C^3 - B^3): Eq. (11), and its twin from r^2 dr = g^2 R^2 dR for tangential growth."""
    run = make_run(T, law=law)
    run.grow_to(1.2)
    run.relax(600)
    g, B, C = 1.2, 50 - T, 50.0
    exact = (B**3 + (g**3 if law == "isotropic" else g**2) * (C**3 - B**3)) ** (1 / 3)
    radius = np.linalg.norm(run.state.x[: run.body.n_surface], axis=1)
    assert radius.mean() == pytest.approx(exact, rel=3e-3)
    assert abs(radius.mean() - exact) < 0.03 * (exact - C)  # three per cent of the displacement itself
    assert np.ptp(radius) < 2e-3 * exact  # still a sphere


def test_growth_of_one_leaves_the_body_bitwise_at_rest():
    run = make_run(amplitude=0.02, contact=True, portion="half")
    run.relax(50)
    assert np.array_equal(run.state.x, run.body.X)
    assert not run.state.v.any()


def test_the_hole_and_the_planes_hold():
    run = make_run(amplitude=0.05, portion="quarter")
    run.grow_to(1.2)
    x, X = run.state.x, run.body.X
    hole = np.linalg.norm(X, axis=1) < 25 * (1 + 1e-9)
    assert np.array_equal(x[hole], X[hole])
    for axis in (1, 2):
        assert not x[run.body.on_plane[:, axis], axis].any()


def test_past_onset_the_sphere_folds_and_growth_before_it_does_not():
    run = make_run(3.0, n=20, amplitude=0.02, contact=True, steps=2000)
    run.grow_to(1.3)
    n = run.body.n_surface
    before = np.linalg.norm(run.state.x[:n], axis=1).std()
    run.grow_to(1.6)
    after = np.linalg.norm(run.state.x[:n], axis=1).std()
    assert before < 0.1 * 3.0 < 3.0 < after
    assert run.state.record["min_J"] > 0.1
    assert run.state.record["kinetic_over_strain"] < 2e-2


def _pairs_on_the_way(run, g):
    """Pairs in contact at each measurement while growing to g."""
    pairs = []
    run.grow_to(g, lambda state: pairs.append(state.record["effects"]["contact"]["pairs"]))
    return pairs


@pytest.mark.skipif(numba.get_num_threads() < 2, reason="needs two threads")
def test_a_folded_run_is_bitwise_the_same_for_one_and_two_threads():
    results = []
    for threads in (1, 2):
        numba.set_num_threads(threads)
        run = make_run(3.0, n=12, amplitude=0.05, contact=True, steps=600, portion="half")
        pairs = _pairs_on_the_way(run, 1.9)
        assert max(pairs) > 0  # contact took part
        results.append(run.state.x.copy())
    assert np.array_equal(*results)


@pytest.mark.skipif(numba.get_num_threads() < 2, reason="needs two threads")
def test_a_small_body_steps_in_one_thread(monkeypatch):
    run, seen = make_run(n=6), []
    monkeypatch.setattr(run.body, "grow", lambda g: seen.append(numba.get_num_threads()))
    for nodes, threads in ((dynamics.NODES_PER_THREAD, 1), (len(run.body.X), 2)):
        monkeypatch.setattr(dynamics, "NODES_PER_THREAD", nodes)
        with using_threads(2):
            run.grow_to(run.state.growth + 1e-4)
            assert numba.get_num_threads() == 2
        assert set(seen) == {threads}
        seen.clear()


def test_a_run_taken_up_from_a_checkpoint_ends_bitwise_the_same():
    whole = make_run(n=12, amplitude=0.05, contact=True, steps=600)
    saved = []
    whole.grow_to(1.7, lambda s: saved.append(whole.save()) if s.step == 40 * STEPS_PER_MEASUREMENT else None)
    again = make_run(n=12, amplitude=0.05, contact=True, steps=600)
    again.load(saved[0])
    again.grow_to(1.7)
    assert again.state.step == whole.state.step
    assert np.array_equal(again.state.x, whole.state.x)


def test_a_run_taken_up_during_relaxation_takes_only_the_steps_left():
    whole, again = (make_run(n=8, amplitude=0.05, steps=300) for _ in range(2))
    whole.grow_to(1.2)
    saved = []
    whole.relax(100, lambda s: saved.append(whole.save()) if s.relaxed == 4 * STEPS_PER_MEASUREMENT else None)
    again.load(saved[0])
    again.relax(100)
    assert again.state.step == whole.state.step
    assert np.array_equal(again.state.x, whole.state.x)


def test_recorded_energies_are_those_of_the_state():
    run = make_run(n=12, amplitude=0.05, steps=600)
    run.grow_to(1.5)
    body, state = run.body, run.state
    kinetic = 0.5 * np.sum(body.mass[:, None] * state.v**2) / body.levels.lightness
    assert state.record["kinetic_energy"] == pytest.approx(kinetic, rel=1e-12)
    body.update_state(state.x)
    strain = body.elements.state()["energy"].sum() + body.filter.energy(state.x)
    assert body.filter.energy(state.x) > 1e-6 * strain
    assert state.record["strain_energy"] == pytest.approx(strain, rel=1e-12)
    assert state.lowest_J <= state.record["min_J"]


def test_growth_slows_down_while_the_kinetic_energy_is_high(monkeypatch):
    steps = {}
    for limit in (1.0, 1e-9):
        monkeypatch.setattr("morphofold.sim.dynamics.KINETIC_LIMIT", limit)
        run = make_run(n=8, steps=600)
        run.grow_to(1.3)
        steps[limit] = run.state.step
    full_pace = 180
    assert full_pace < steps[1.0] < 1.25 * full_pace  # the start is soft
    assert steps[1e-9] == pytest.approx(full_pace / dynamics.SLOWEST_PACE, rel=0.05)


def test_growth_starts_softly(monkeypatch):
    monkeypatch.setattr("morphofold.sim.dynamics.KINETIC_LIMIT", 1e9)
    run = make_run(n=8, steps=1000)
    growth = [1.0]
    run.grow_to(1.1, lambda state: growth.append(state.growth))
    pace = np.diff(growth)[:-1] / (STEPS_PER_MEASUREMENT * run.rate)
    assert pace[0] == pytest.approx(dynamics.FIRST_PACE)
    assert pace[:4].tolist() == sorted(pace[:4])
    assert pace.max() == pytest.approx(1.0)


def test_a_smooth_body_moves_as_its_growth_asks_and_does_not_shake():
    """Increments of growth as rare as the measurements shake it to 123 times this energy."""
    run = make_run(2.0, n=20, steps=3000)
    run.grow_to(1.1)
    x, step = run.state.x.copy(), run.state.step
    run.grow_to(1.13)
    even = (run.state.x - x) / (run.state.step - step)
    assert run.state.record["kinetic_energy"] < 3 * run.body.kinetic_energy(even)


def test_no_wave_is_as_fast_as_the_increments_of_growth():
    """A wave of stiffness over mass w^2 advances by 2 asin(w / 2) a step; meshes of flat, cubic and tall bricks."""
    for n, layers in ((8, 3), (24, 2), (24, 6)):
        body = Body(
            bilayer_sphere(50, 3.0, 25, "octant", n, layers), mu_cortex=2, mu_core=1, kappa_ratio=50, law="isotropic"
        )
        fastest = body.fastest_wave(np.ones(len(body.X), dtype=bool), body.mass, body.levels)
        assert 2.0 < fastest < 2.75
        assert 2 * np.arcsin(0.5 * fastest**0.5) < 2 * np.pi / STEPS_PER_INCREMENT


def bulged_swing(n, layers, crossings, **options):
    """A sphere let go with a smooth bulge: crossings done, energies, and how much of the bulge is left (1 at first)."""
    body = Body(
        bilayer_sphere(50, 3.0, 25, "octant", n, layers), mu_cortex=2.0, mu_core=1.0, kappa_ratio=50.0, law="isotropic"
    )
    run = Dynamics(body, steps_per_unit=1.0, **options)
    r, volume = np.linalg.norm(body.X, axis=1, keepdims=True), body.nodal_volumes()[:, None]
    bulge = 1e-3 * body.X * (((body.X / r) ** 4).sum(axis=1, keepdims=True) - 0.6) * (r / 25 - 1)
    run.state.x += np.where(body.free, bulge, 0.0)
    time, energy, left = [], [], []

    def record(state):
        time.append(state.step / body.crossing)
        energy.append(state.record["strain_energy"] + state.record["kinetic_energy"])
        left.append(np.sum(volume * bulge * (state.x - body.X)) / np.sum(volume * bulge**2))

    run.relax(round(crossings * body.crossing), record)
    return body.crossing, np.array(time), np.array(energy), np.array(left)


def test_a_swing_takes_as_many_crossings_on_every_mesh():
    """The clock is a time of the body: on meshes on which it takes 11 to 21 steps, a bulge is gone at the same time."""
    steps, gone = [], []
    for n, layers in ((16, 2), (16, 3), (32, 3), (32, 6)):
        crossing, time, _, left = bulged_swing(n, layers, 5, damping=0.0)
        first = np.flatnonzero(left < 0)[0]
        steps.append(crossing)
        gone.append(np.interp(0.0, left[[first, first - 1]], time[[first, first - 1]]))
    assert max(steps) > 1.8 * min(steps)
    assert max(gone) < 1.5 * min(gone)


def test_the_clock_has_neither_length_nor_modulus():
    def crossing(length, modulus):
        bilayer = bilayer_sphere(50 * length, 3 * length, 25 * length, "octant", 8)
        return Body(bilayer, mu_cortex=2 * modulus, mu_core=modulus, kappa_ratio=50.0, law="isotropic").crossing

    assert [crossing(1e-3, 1.0), crossing(1.0, 1e6)] == pytest.approx(2 * [crossing(1.0, 1.0)], rel=1e-9)


def test_free_swings_lose_their_energy_at_the_rate_of_the_damping():
    _, time, energy, _ = bulged_swing(16, 2, 28)
    late = time > 1
    assert np.polyfit(time[late], np.log(energy[late]), 1)[0] == pytest.approx(-dynamics.DAMPING_PER_CROSSING, rel=0.03)


def test_before_folds_can_form_kinetic_energy_is_held_against_the_strain_energy_to_come():
    constant = [restlessness(g, 1.0 / (g - 1) ** 2) for g in (1.01, 1.05, 1.15, 1.2)]
    assert constant == pytest.approx([constant[-1]] * 4)
    assert restlessness(1.5, 0.25) == 0.25


def test_the_imperfection_is_a_function_of_position_and_seed_alone():
    coarse, fine = (bilayer_sphere(50, 3, 25, "octant", n) for n in (8, 16))
    fields = []
    for bilayer, seed in ((coarse, 0), (fine, 0), (coarse, 1)):
        X = Perturbation(0.15, 24.0, seed=seed).reshape(bilayer, bilayer.mesh.p.T)
        r, n = np.linalg.norm(X, axis=1), bilayer.n_surface
        np.testing.assert_allclose(r[3 * n : 4 * n], 47.0)  # the white surface stays
        fields.append(dict(zip(map(tuple, np.round(bilayer.mesh.p.T[:n], 9)), r[:n] - 50)))
    common = fields[0].keys() & fields[1].keys()
    assert len(common) >= len(fields[0]) // 2
    for point in common:
        assert fields[0][point] == pytest.approx(fields[1][point], abs=1e-9)
    assert max(abs(fields[0][point] - fields[2][point]) for point in fields[0]) > 0.05
    full = bilayer_sphere(50, 3, 25, "full", 24)
    full = Perturbation(0.15, 24.0, seed=0).reshape(full, full.mesh.p.T)
    rms = np.std(np.linalg.norm(full[: 6 * 24**2 + 2], axis=1))
    assert rms == pytest.approx(0.05 * 3, rel=0.25)


def test_a_node_that_is_not_finite_stops_the_run_and_is_named():
    run = make_run(n=8)
    run.state.x[17, 1] = np.nan
    with pytest.raises(UnstableError, match=rf"\bof {len(run.body.X)} .*\bg = 1\.\d+\b.*\bnode 17\b"):
        run.grow_to(1.1)


def test_an_element_turned_inside_out_stops_the_run_and_is_named():
    run = make_run(n=8)
    corner = run.body.bilayer.mesh.t[:, 5]
    centre = run.state.x[corner].mean(axis=0)
    run.state.x[corner] = centre - 3 * (run.state.x[corner] - centre)
    with pytest.raises(UnstableError, match=rf"\bof {run.body.elements.n} .*\bv/V = -"):
        run._measure()


def sink(run, node, by):
    """Measure the run with a pial node ``by`` mm below its place."""
    run.state.x[node] = run.body.X[node] - by * run.body.bilayer.radial[node]
    run._measure()


def inner_node(run):
    """The pial node at the corner of the cubed sphere, off the symmetry planes: three bricks meet there."""
    return int(np.argmin(np.abs(run.body.X[: run.body.n_surface] - 50 / 3**0.5).sum(axis=1)))


def test_growth_halves_as_an_element_collapses_and_crawls_while_one_is_inside_out():
    """A corner that sinks by a share s of its brick leaves J = 1 - 0.62 s at the nearest of the Gauss points."""
    run = make_run(n=16)
    run.state.growth = 1.5  # past the soft start
    node, seen = inner_node(run), []
    for by in (0.0, 0.05, 0.3, 0.3, 1.75, 0.05, 0.05):  # bricks are 1 mm thick
        sink(run, node, by)
        seen.append((run.state.record["inverted"], run._pace()))
    assert -0.2 < run.state.lowest_J < 0  # of all times, not of the last
    assert seen == [(0, 1.0), (0, 1.0), (0, 0.5), (0, 1.0), (3, dynamics.SLOWEST_PACE), (0, 1.0), (0, 1.0)]


def test_a_run_taken_up_has_the_pace_that_it_had():
    """Growth slows down for what J was at the measurement before, too: here far below 1 throughout."""
    run, again = make_run(n=8), make_run(n=8)
    run.state.growth = 1.5
    run.body.grow(1.5)
    node, paces = inner_node(run), []
    for by in (0.0, 0.05, 0.1, 0.6):
        sink(run, node, by)
        again.load(run.save())
        assert again._pace() == run._pace()
        paces.append(run._pace())
    assert run.state.before_J < 0.4
    assert paces == [0.5, 1.0, 1.0, 0.5]


def test_relaxation_takes_the_steps_it_is_asked_for_once():
    run = make_run(n=8)
    run.relax(8 * STEPS_PER_MEASUREMENT - 5)  # rounded up
    assert run.state.step == 8 * STEPS_PER_MEASUREMENT
    for steps in (8 * STEPS_PER_MEASUREMENT, 50):
        run.relax(steps)
        assert run.state.step == 8 * STEPS_PER_MEASUREMENT


def test_a_step_from_rest_follows_the_forces_of_elements_and_filter(rng):
    """v = f/m, with the mass of the coarse levels included: Newton's law with a step of one."""
    run = make_run(n=8)
    body, n = run.body, run.body.n_surface
    run.state.x[:n] += 0.1 * rng.standard_normal((n, 3)) * body.free[:n]
    run._measure()
    force = body.forces(run.state.x)
    filtered = body.filter.forces(run.state.x).copy()
    assert np.abs(filtered).max() > 0.01 * np.abs(force).max()
    force[:n] += filtered
    want = np.where(body.free, body.levels.accelerations(force * body.free, body.mass), 0.0)
    run._run(1)
    np.testing.assert_allclose(run.state.v, want, atol=1e-12 * np.abs(want).max())


def test_a_gauss_point_that_bursts_stops_the_run_though_its_element_has_volume():
    run = make_run(n=16)
    node = inner_node(run)
    sink(run, node, -8.0)  # J near 6
    assert 5 < run.state.record["max_J"] < run.body.elements.LARGEST_J
    with pytest.raises(UnstableError, match=rf"^3 of {run.body.elements.n} .*\bv/V = 4\."):
        sink(run, node, -14.0)
