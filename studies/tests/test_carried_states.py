"""States of one mesh that are carried to another mesh of the same body."""

import numpy as np
import pytest

from morphofold.studies.folds.carried_states import carried, gyrification, limit_of_first_order, meshed_octant, rested

EDGES = (2.4, 1.2)  # of the surface cells, in T


@pytest.fixture(scope="module")
def octants():
    return [meshed_octant("demo", edge, 0) for edge in (*EDGES, 0.9)]


def field(octant):
    """A smooth vector at each node: of the direction, times the distance from the centre."""
    points = octant.body.bilayer.mesh.p.T
    radius = np.linalg.norm(points, axis=1, keepdims=True)
    x, y, z = (points / radius).T
    return radius * np.column_stack([np.sin(3 * x + y), np.cos(2 * y - z), x * y * np.exp(z)])


def test_a_field_comes_over_with_fourth_order_in_the_edge_and_exactly_to_its_own_mesh(octants):
    *sources, target = octants
    errors = [np.abs(carried(source, target, field(source)) - field(target)).max() for source in sources]
    assert np.log2(errors[0] / errors[1]) / np.log2(sources[1].cells / sources[0].cells) > 3
    assert errors[1] < 1e-3 * np.abs(field(target)).max()
    np.testing.assert_allclose(carried(target, target, field(target)), field(target), atol=1e-11)


def test_a_smooth_sphere_stays_one_on_another_mesh(octants):
    source, target = octants[1:]
    x = 1.02 * source.body.X
    assert gyrification(source.body, x) == pytest.approx(1.0, abs=2e-3)
    assert rested(source, target, x, 1.02) == pytest.approx(1.0, abs=2e-3)


def test_the_limit_is_that_of_a_line_through_the_two_coarsest():
    assert limit_of_first_order({0.6: 1.4, 0.4: 1.6}) == pytest.approx(2.0)
