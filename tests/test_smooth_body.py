"""Bodies under smooth surfaces: even cells, well-shaped bricks, layers where they belong, refusals."""

import numpy as np
import pytest

from morphofold.errors import ImpossibleBody
from morphofold.geometry import unit
from morphofold.io import read_surface, sample_path
from morphofold.sim.hemisphere import hemisphere_body
from morphofold.sim.hemisphere.hemisphere_body import scaled_jacobians, smooth_body
from morphofold.sim.mesh.brick_mesh import cube_directions
from morphofold.unfolding.harmonics import SmoothSurface, fit
from morphofold.unfolding.unfold import unfold

AXES = np.array([60.0, 45.0, 40.0])
T, LAYERS = 2.5, 3


@pytest.fixture
def ellipsoid():
    s, _ = cube_directions(16)
    return SmoothSurface(fit(s, s * AXES, np.ones(len(s)), 3))


def levels_of(bilayer):
    return bilayer.mesh.p.T.reshape(-1, bilayer.n_surface, 3)


def edges_of(bilayer):
    pial = levels_of(bilayer)[0]
    return np.linalg.norm(pial[bilayer.faces] - pial[np.roll(bilayer.faces, -1, axis=1)], axis=2)


def test_layers_of_an_ellipsoid_lie_along_its_exact_normals(quick_searches, ellipsoid):
    bilayer = smooth_body(ellipsoid, T, T, 0.25).bricks(12, LAYERS)
    levels = levels_of(bilayer)
    pial = levels[0]
    np.testing.assert_allclose(np.sum((pial / AXES) ** 2, axis=1), 1, atol=1e-12)
    normal = pial / AXES**2
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    np.testing.assert_allclose(bilayer.radial[: bilayer.n_surface], normal, atol=1e-12)
    for k in range(LAYERS + 1):
        np.testing.assert_allclose(levels[k], pial - k * T / LAYERS * normal, atol=1e-10)
    np.testing.assert_allclose(bilayer.white @ bilayer.mesh.p.T, pial - T * normal, atol=1e-10)
    assert bilayer.edge == pytest.approx(edges_of(bilayer).max())
    assert set(bilayer.held) == set(range(bilayer.mesh.nvertices - bilayer.n_surface, bilayer.mesh.nvertices))


def test_cells_of_an_ellipsoid_are_evener_than_those_of_straight_directions(quick_searches, ellipsoid):
    directions, quads = cube_directions(16)
    unevenness = []
    for s in (directions, unit(directions + hemisphere_body.even_cells(ellipsoid, T)(directions))):
        pial = ellipsoid(s)
        edge = np.linalg.norm(pial[quads] - pial[np.roll(quads, -1, axis=1)], axis=2)
        unevenness.append(edge.max() / edge.mean())
    assert unevenness[1] < 1.3 < unevenness[0]


def test_the_gradient_of_the_search_for_even_cells_is_exact(ellipsoid, rng):
    directions, quads = cube_directions(6)
    excess = hemisphere_body._excess(ellipsoid, 6.0, directions, quads)
    at, direction = 1e-3 * rng.standard_normal((2, 3 * (hemisphere_body.SHIFT_DEGREE + 1) ** 2))
    slope = (excess(at + 1e-4 * direction, 3)[0] - excess(at - 1e-4 * direction, 3)[0]) / 2e-4
    assert excess(at, 3)[1] @ direction == pytest.approx(slope, rel=1e-5)


def test_the_gradient_of_the_search_for_good_bricks_is_exact(rng):
    directions, quads = cube_directions(4)
    levels = np.linspace(1, 0.4, 4)[:, None, None] * directions + 0.02 * rng.standard_normal((4, len(directions), 3))
    sizes, heights = np.full(4, 0.3), np.full((3, len(directions)), 0.2)
    slope, direction, h = np.zeros(levels.shape), rng.standard_normal(levels.shape), 1e-6

    def total(x):
        return hemisphere_body._sum_misshape(x, quads, sizes, heights, 2.0, 0.1, np.zeros(x.shape))

    hemisphere_body._sum_misshape(levels, quads, sizes, heights, 2.0, 0.1, slope)
    assert np.sum(slope * direction) == pytest.approx(
        (total(levels + h * direction) - total(levels - h * direction)) / (2 * h), rel=1e-5
    )


def test_scaled_jacobians_are_1_for_right_angles_and_negative_inside_out():
    square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], dtype=float)
    levels = np.stack([np.column_stack([square, np.full(4, z)]) for z in (1.0, 0.0)])
    quads = np.array([[0, 1, 2, 3]])
    assert scaled_jacobians(levels, quads) == pytest.approx(1)
    assert scaled_jacobians(levels[::-1].copy(), quads) == pytest.approx(-1)
    levels[0, :, 0] += 1  # sheared by 45 degrees
    assert scaled_jacobians(levels, quads) == pytest.approx(0.5**0.5)


def test_a_finer_mesh_keeps_the_points_of_the_coarser_one(quick_searches, ellipsoid):
    body = smooth_body(ellipsoid, T, T, 0.25)
    coarse, fine = (body.points(cube_directions(n)[0]) for n in (6, 12))
    distance = np.linalg.norm(coarse[:, None] - fine[None], axis=2).min(axis=1)
    assert distance.max() < 1e-12


def test_columns_under_a_mark_are_held_at_all_levels(quick_searches, ellipsoid):
    body = smooth_body(ellipsoid, T, T, 0.25)
    bilayer = body.bricks(8, LAYERS, held=lambda s: s[:, 0] > 0.9)
    held = np.zeros(bilayer.mesh.nvertices, dtype=bool)
    held[bilayer.held] = True
    marked = body.points(cube_directions(8)[0])[:, 0] > 0.9
    assert marked.any()
    assert (held.reshape(-1, bilayer.n_surface)[:-1] == marked).all()
    assert held.reshape(-1, bilayer.n_surface)[-1].all()


def test_a_cortex_too_thick_for_its_bends_or_its_hole_is_refused(quick_searches, ellipsoid):
    with pytest.raises(ImpossibleBody, match="radius"):
        smooth_body(ellipsoid, 25.0, 25.0, 0.3)
    with pytest.raises(ImpossibleBody, match="hole"):
        smooth_body(ellipsoid, 5.0, 5.0, 0.7)


@pytest.mark.slow
@pytest.mark.parametrize(("hemi", "level", "thickness"), [("rh", 0.03, 2.5), ("lh", 0.08, 4.0)])
def test_bricks_of_a_template_are_even_and_well_shaped_at_every_size(hemi, level, thickness):
    """The study's mesh: longest over mean edge 1.85, scaled Jacobians 0.61 in the cortex and 0.21 in the core."""
    white, sphere = (read_surface(sample_path(f"fsaverage5/surf/{hemi}.{name}")) for name in ("white", "sphere"))
    body = smooth_body(unfold(white, sphere, level, radius=50.0).surface, thickness, thickness, 0.25)
    for n in (24, 60):
        bilayer = body.bricks(n, LAYERS)
        shape = scaled_jacobians(levels_of(bilayer), bilayer.faces)
        assert shape[:LAYERS].min() > 0.6
        assert shape[LAYERS:].min() > 0.2
        edge = edges_of(bilayer)
        assert edge.max() < 1.4 * edge.mean()
