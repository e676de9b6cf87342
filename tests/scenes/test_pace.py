"""Folds hang on the pace of growth no more than on the seed, unless a stage reports that it is not at rest."""

import numpy as np
import pytest
from scipy.fft import dctn

from morphofold import analysis
from morphofold.sim.build import build_body
from morphofold.sim.dynamics import Dynamics
from morphofold.sim.effects import build_effects
from morphofold.sim.equilibrium.wrinkle_onset import first_wrinkles
from morphofold.sim.output.stage_surfaces import whole_surfaces
from morphofold.sim.scene.scene_files import load_scene
from morphofold.sim.stage_checks import BOUNDS


def run_of(scene):
    effects = build_effects(scene)
    body = build_body(scene, effects)
    return Dynamics.of(scene, body, effects)


def folds(seed, rate):
    """Gyrification index, wavelength [mm] and distance from rest [T] of each stage of Fig. 6's thick cortex."""
    options = [f"effects.perturbation.seed={seed}", f"growth.rate={rate}", "output.patience=7"]
    scene = load_scene("fig6-thick", ["geometry.portion=octant", *options])
    run = run_of(scene)
    sphere = whole_surfaces(run.body, np.ascontiguousarray(run.body.bilayer.mesh.p.T))[1].verts
    rows = []
    for g in scene.stages:
        run.grow_to(g)
        run.settle()
        pial = whole_surfaces(run.body, run.state.x)[1]
        waves = analysis.power_spectrum(sphere, pial.faces, np.linalg.norm(pial.verts, axis=1))
        rows.append(
            (analysis.gyrification_index(pial.verts, pial.faces), waves.wavelength, run.state.record["distance_over_T"])
        )
    return np.array(rows).T


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_folds_at_standard_differ_from_those_of_a_quarter_of_the_pace_no_more_than_between_seeds(seed):
    """Standard deviations between seeds are 2 % of GI and 5 % of the wavelength (docs/folds.md)."""
    gi, wave, distance = folds(seed, 1.0)
    slow_gi, slow_wave, _ = folds(seed, 0.25)
    rests = distance < BOUNDS["distance_over_T"][0]
    assert rests[:3].all()
    assert np.abs(gi / slow_gi - 1)[rests].max() < 0.02
    assert np.abs(wave / slow_wave - 1)[rests].max() < 0.05


@pytest.mark.slow
def test_a_stiff_patch_wrinkles_in_the_waves_of_theory():
    """Found with waves of 22 mm once. Waves of a square of 80 mm are 160 mm over the root of a sum of two squares."""
    scene = load_scene(
        "patch",
        [
            "geometry.size=[80, 80]",
            "material.mu_ratio=30",
            "growth.rate=1.0",
            "growth.final=1.1",
            "output.stages=[]",
            "accuracy.edge=1.6",
        ],
    )
    expected = first_wrinkles(scene)
    run = run_of(scene)
    run.grow_to(expected.growth + 0.01)
    run.settle()
    n = run.body.n_surface
    side = round(n**0.5)
    x, y = np.rint(run.body.bilayer.mesh.p[:2, :n] * (side - 1) / 80).astype(int)
    height = np.empty((side, side))
    height[x, y] = run.state.x[:n, 2]
    power = dctn(height - height.mean(), type=1) ** 2
    k = np.pi / 80 * np.hypot(*np.meshgrid(np.arange(side), np.arange(side), indexing="ij"))
    wave = 2 * np.pi / np.sqrt((power * k**2).sum() / power.sum())
    assert height.std() > 0.1 * 2.5
    assert wave == pytest.approx(expected.wavelength_over_T * 2.5, rel=0.1)
