"""The study of gyri and hinges over bundles of fibres."""

import dataclasses

import numpy as np
import pytest

from morphofold.analysis import measure
from morphofold.analysis.graph.graph_rows import amounts
from morphofold.shapes.folded_ball import folded_ball
from morphofold.sim.scene.scene_files import load_scene
from morphofold.studies import fibre_study
from morphofold.studies.fibre_study import KINDS, QUANTITIES, Found
from morphofold.surface import Surface

pytestmark = pytest.mark.slow  # studies are not shipped: run them when they change


def made(rng, shift, seeds=10, turns=200):
    """Runs whose shares of hinges are ``shift`` standard deviations above chance."""
    runs = []
    for _ in range(seeds):
        values = rng.normal(0.05, 0.02, 1 + turns)
        values[0] += 0.02 * shift
        runs.append(Found(values, values, values, 80))
    return runs


def test_a_shift_is_found_and_none_is_not(rng):
    none, some = (fibre_study.summary(made(rng, shift), "hinges") for shift in (0.0, 2.0))
    assert none["low"] < 0 < none["high"]
    assert none["p"] > 0.05
    assert 0 < some["low"] < 0.04 < some["high"]
    assert some["p"] < 0.01
    assert some["mean"] - some["chance"] == pytest.approx(0.04, abs=0.02)


def test_bundles_at_hinges_have_more_hinges_than_turned_ones():
    ball = folded_ball(4000)
    directions = ball.white.verts / np.linalg.norm(ball.white.verts, axis=1, keepdims=True)
    cortex = dataclasses.replace(ball, sphere=Surface(100 * directions, ball.faces, name="lh.sphere"))
    graph = measure(cortex, only=["hinges"]).graph
    hinges = np.flatnonzero(amounts(graph, len(directions))["hinges"])
    found = fibre_study.over_bundles(cortex, directions[hinges[:6]], seed=0)
    assert found.n_hinges == len(hinges)
    assert found.hinges[0] >= 6 / len(hinges)
    assert found.hinges[0] > 2 * found.hinges[1:].mean()
    assert found.crests[0] > found.crests[1:].mean()
    assert found.depth[0] < found.depth[1:].mean()  # hinges are on gyri


def test_the_scene_of_each_kind_loads_with_bundles_spread_over_the_sphere(monkeypatch, tmp_path):
    seen = {}

    class Grown:
        def cortex(self):
            return None

    def simulate(scene, out, **options):
        seen[out.name] = scene
        return Grown()

    monkeypatch.setattr(fibre_study, "simulate", simulate)
    for kind in KINDS:
        fibre_study.grown(tmp_path, kind, 3)
    assert "fibres" not in seen["none-3"].effects
    with_fibres = [scene.effects["fibres"] for name, scene in seen.items() if name != "none-3"]
    assert len({options.model_dump_json() for options in with_fibres}) == len(KINDS) - 1
    centres = np.array([bundle.centre for bundle in with_fibres[0].bundles])
    np.testing.assert_allclose(np.linalg.norm(centres, axis=1), 50.0)
    apart = np.linalg.norm(centres[:, None] - centres, axis=2) + 1e3 * np.eye(len(centres))
    assert apart.min() > 2 * fibre_study.RADIUS_MM  # they do not overlap
    assert load_scene("demo").geometry.radius == fibre_study.BODY_MM


def test_the_row_and_the_picture_of_a_kind(rng, tmp_path):
    found = {kind.name: made(rng, 0.0) for kind in KINDS}
    assert len(fibre_study.row_of(KINDS[0], found[KINDS[0].name])) == 3 + 3 * len(QUANTITIES)
    fibre_study.draw(tmp_path / "fibres.png", found)
    assert (tmp_path / "fibres.png").stat().st_size > 5_000
