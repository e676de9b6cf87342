"""A notch has the depth and width that it should on every mesh, and creases begin at it when theory lets them."""

import numba
import numpy as np
import pytest

from morphofold.errors import DoesNotApply, NotReadable, OutOfRange, WrongShape
from morphofold.sim.build import build_body
from morphofold.sim.dynamics import Dynamics
from morphofold.sim.effects import build_effects
from morphofold.sim.effects.notch import Notch
from morphofold.sim.mesh.brick_mesh import bilayer_patch, bilayer_sphere
from morphofold.sim.scene.scene_files import load_scene
from morphofold.sim.theory import BIOT, CREASE
from morphofold.studies.speed.solver_speed import cut_bricks

CREASES, WAVES = CREASE ** (1 / 3), BIOT ** (1 / 3)  # growth at which a held block can crease, and can't be smooth
SPHERE = bilayer_sphere(50.0, 3.0, 25.0, "octant", 16)
CORNER = np.full(3, 50 / 3**0.5)


def lowered(bilayer, notch):
    """How far each node has moved inwards along the thickness (N,), and nothing else."""
    moved = notch.reshape(bilayer, bilayer.mesh.p.T) - bilayer.mesh.p.T
    depth = -np.einsum("ij,ij->i", moved, bilayer.radial)
    np.testing.assert_allclose(moved, -depth[:, None] * bilayer.radial, atol=1e-12)
    return depth


@pytest.mark.parametrize("bilayer", [SPHERE, cut_bricks(SPHERE)], ids=["bricks", "tetrahedra"])
@pytest.mark.parametrize("off", [0.0, 1.0])
def test_a_pit_has_its_full_depth_at_one_node_and_ends_at_half_its_width(bilayer, off):
    depth = lowered(bilayer, Notch([CORNER + [off, -off, 0.0]], 0.3, 12.0))
    at = depth[: bilayer.n_surface]
    assert at.max() == pytest.approx(0.3)
    deepest = bilayer.mesh.p.T[np.argmax(at)]
    assert np.linalg.norm(deepest - CORNER) <= off * 2**0.5 + bilayer.edge
    away = np.linalg.norm(bilayer.foot - deepest, axis=1)
    assert np.all(depth[away >= 6.0] == 0)
    assert np.all(depth[(away < 5.9) & (bilayer.share > 0)] > 0)
    np.testing.assert_allclose(depth[bilayer.share == 0], 0)  # white surface and core
    section = 0.15 * (1 + np.cos(np.pi * np.minimum(away / 6.0, 1.0)))
    np.testing.assert_allclose(depth, bilayer.share * section, atol=1e-12)


def test_a_line_is_one_groove_along_all_its_points():
    bilayer = bilayer_patch((12.0, 8.0), 10.0, 2.0, 1.0)
    points = [[3.0, 0.0, 0.0], [3.0, 4.0, 0.0], [9.0, 8.0, 0.0]]
    depth = lowered(bilayer, Notch(points, 0.2, 3.0, line=True))[: bilayer.n_surface]
    x, y, _ = bilayer.mesh.p[:, : bilayer.n_surface]
    np.testing.assert_allclose(depth[(x == 3) & (y <= 4)], 0.2)
    np.testing.assert_allclose(depth[(x == 6) & (y == 6)], 0.2)  # half way to the third
    assert depth[(x == 9) & (y == 2)] == 0
    pits = lowered(bilayer, Notch(points, 0.2, 3.0))[: bilayer.n_surface]
    assert np.count_nonzero(pits > 0.199) == 3


def test_a_notch_of_a_strip_runs_across_it():
    scene = load_scene("strip", ["effects.notch={at = [[40.0, 0.0, 0.0]]}"])
    body = build_body(scene, [effect for effect in build_effects(scene) if effect.name == "notch"])
    depth = -body.X[: body.n_surface, 2].reshape(-1, 2)  # both sides of each place
    assert np.array_equal(depth[:, 0], depth[:, 1])
    assert depth.max() == pytest.approx(0.1 * 2.5)
    assert np.count_nonzero(depth[:, 0]) == 5  # of cells of 0.5 mm in a width of 2.5


@pytest.mark.parametrize(
    ("notch", "kind", "named"),
    [
        ("{}", NotReadable, "at"),
        ("{at = []}", WrongShape, "at"),
        ("{at = [[0, 0]]}", NotReadable, "at"),
        ("{at = [[9, 0, 0]], depth = 2}", OutOfRange, "depth"),
        ("{at = [[9, 0, 0]], line = true}", DoesNotApply, "line"),
    ],
)
def test_a_notch_that_makes_no_sense_is_refused(notch, kind, named):
    with pytest.raises(kind, match=rf"effects\.notch\.{named}\b"):
        load_scene("patch", [f"effects.notch={notch}"])


def test_a_line_in_a_strip_and_a_point_off_the_surface_are_refused():
    with pytest.raises(DoesNotApply, match=r"effects\.notch\.line\b"):
        load_scene("strip", ["effects.notch={at = [[10, 0, 0], [20, 0, 0]], line = true}"])
    with pytest.raises(OutOfRange, match=r"effects\.notch\.at: \[0\.0, 0\.0, 30\.0\]"):
        Notch([[0.0, 0.0, 30.0]], 0.3, 3.0).reshape(SPHERE, SPHERE.mesh.p.T)


def grown(notch, *settings, final, back=None):
    """Growth and pairs in contact at all measurements of a homogeneous block, held laterally, that grows as a whole; a
    section of 20 mm by 25."""
    scene = load_scene(
        "strip",
        [
            "geometry.length=20",
            "material.mu_ratio=1.0",
            f"growth.final={final}",
            f"effects.core_growth.final={final}",
            "output.stages=[]",
            *settings,
            *([f"effects.notch={notch}"] if notch else []),
        ],
    )
    scene = scene.without("perturbation")
    effects = build_effects(scene)
    body = build_body(scene, effects)
    run = Dynamics(body, effects, steps_per_unit=scene.steps_per_unit(body.crossing))
    seen, threads = [], numba.get_num_threads()
    numba.set_num_threads(1)  # so small a body takes longer by two
    for to in (final, back) if back else (final,):
        run.grow_to(to, lambda state: seen.append((state.growth, state.record["effects"]["contact"]["pairs"])))
    numba.set_num_threads(threads)
    return np.array(seen).T


RATE, FINE = "growth.rate=0.3", ("accuracy.edge=0.25", "accuracy.elements_through_cortex=10")


@pytest.mark.slow
@pytest.mark.parametrize(("shape", "settings"), [("depth = 0.05", ()), ("depth = 0.02, width = 1.25", FINE)])
def test_a_small_notch_folds_into_a_crease_that_opens_where_theory_lets_creases_begin(shape, settings):
    """It closes at 1.379 and 1.388: a small notch has to wait for more than the least growth, and yet comes well before
    waves. As growth falls it opens where a crease begins to cost energy: at 1.348 and 1.341, theory has 1.339."""
    g, pairs = grown(f"{{at = [[10.0, 0.0, 0.0]], {shape}}}", RATE, *settings, final=1.42, back=1.31)
    closed, top = np.argmax(pairs > 0), np.argmax(g)
    opened = top + np.argmax(pairs[top:] == 0)
    assert CREASES - 0.02 < g[closed] < WAVES - 0.09
    assert pairs[opened] == 0 < pairs[top]
    assert g[opened] == pytest.approx(CREASES, abs=0.02)


@pytest.mark.slow
def test_without_a_notch_a_block_stays_smooth_until_waves_grow():
    g, pairs = grown(None, "growth.rate=1.0", final=1.49)
    assert g.max() > WAVES - 0.015
    assert pairs.max() == 0
