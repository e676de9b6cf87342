"""The study of where a growing cortex is thick."""

import numpy as np
import pytest
from made_simulations import made_simulation

from morphofold.shapes import icosphere
from morphofold.shapes.folded_ball import folded_ball
from morphofold.sim.dynamics import UnstableError
from morphofold.studies import crowns
from morphofold.surface import Cortex, Surface


def test_thickness_of_each_part_by_points_and_columns():
    found = crowns.thickness(folded_ball(4000))
    assert set(found) == set(crowns.PARTS)
    assert np.isfinite([value for pair in found.values() for value in pair]).all()
    assert crowns.over(found, 0) == pytest.approx(found["crown"][0] / found["fundus"][0])


def test_a_body_that_bursts_gives_the_stages_before(tmp_path, monkeypatch):
    run = made_simulation(tmp_path / "isotropic-2", "fig5", ["output.stages=[1.2, 1.4]"])

    def burst(scene, out, resume):
        raise UnstableError("burst", {})

    monkeypatch.setattr(crowns, "simulate", burst)
    found = crowns.grown(tmp_path, "isotropic", 2.0)
    assert found.stages == run.stages == (1.2, 1.4, 2.0)


def test_thickness_over_curvature_of_a_shell_is_in_one_bin():
    """A shell of even thickness t has the mean curvature 1 / R midway, and everywhere its mean thickness."""
    verts, faces = icosphere(5)
    found = crowns.over_curvature(Cortex(Surface(16.0 * verts, faces), Surface(24.0 * verts, faces)))
    (known,) = np.flatnonzero(np.isfinite(found))
    assert crowns.BENDS[known] < 8.0 / 20.0 < crowns.BENDS[known + 1]
    assert found[known] == pytest.approx(1.0, abs=1e-3)
