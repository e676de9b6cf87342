"""A surface across scales: shells, self-similar surfaces and harmonics, whose areas, dimension and power are known."""

import math

import numpy as np
import pytest
import pyvista
import reference
import trimesh

from morphofold.analysis import across_scales, fractal_dimension, law_across_scales, power_spectrum
from morphofold.analysis.gyrification.power_spectrum import LARGEST_DEGREE
from morphofold.errors import DoesNotApply, NotFinite, OpenSurface, OutOfRange, TooLarge, WrongShape
from morphofold.geometry import mean_edge_length
from morphofold.shapes import icosphere
from morphofold.studies.known_shapes import bumpy_sphere, sphere, torus
from morphofold.surface import Cortex, Surface
from morphofold.unfolding.harmonics import degrees, harmonics

SCALES = (0.0, 1.0, 2.0, 3.0, 8.0)


def shell(inner=30.0, outer=33.0, turn=None):
    verts, faces = icosphere(4)
    verts = verts if turn is None else verts @ turn
    return Cortex(Surface(inner * verts, faces), Surface(outer * verts, faces))


@pytest.fixture(scope="module")
def rows():
    return across_scales(shell(), SCALES)


def test_cubes_of_a_shell_have_the_volume_of_their_rule(rows):
    """A cube is white if its farthest corner is inside: its centre is deeper than half the sum of the components of
    the normal. It is pial if its fourth corner is: half the largest less the others."""
    normals = np.sort(np.abs(icosphere(5)[0]), axis=1)
    pial, white = 0.5 * np.abs(normals @ [-1, -1, 1]).mean(), 0.5 * normals.sum(axis=1).mean()
    assert rows[0].terms.thickness == pytest.approx((33.0**3 - 30.0**3) / 33.0**2 / 3, rel=5e-3)
    for row in rows[1:4]:
        volume = 4 / 3 * np.pi * ((33.0 + pial * row.scale) ** 3 - (30.0 - white * row.scale) ** 3)
        assert row.terms.thickness * row.terms.total == pytest.approx(volume, rel=0.025)
        assert row.terms.total == pytest.approx(1.1 * 4 * np.pi * 33.0**2, rel=0.03)
        assert 1 < row.terms.exposed / (4 * np.pi * 33.0**2) < (1 + row.scale / 33.0) ** 2


def test_the_law_of_a_shell_is_that_of_an_independent_program():
    """Plain NumPy, all 36 scales of the source, gave a slope of 1.171 and an exponent of -0.064."""
    law = law_across_scales(across_scales(shell(48.0, 50.5), [0.0, *np.geomspace(0.45, 7.2, 17)]))
    assert (law.finest, law.coarsest) == pytest.approx((0.45, 7.2))
    assert law.slope == pytest.approx(1.171, abs=0.01)
    assert law.exponent == pytest.approx(-0.064, abs=0.01)
    assert law.slope_low < law.slope < law.slope_high
    assert law.exponent_low < law.exponent < law.exponent_high


def snowflake(size, generations):
    """Corners (N, 2) of Koch's snowflake."""
    corners = size * np.exp(-2j * np.pi * np.arange(3) / 3)
    for _ in range(generations):
        step = (np.roll(corners, -1) - corners) / 3
        tip = corners + step + step * np.exp(1j * np.pi / 3)
        corners = np.column_stack([corners, corners + step, tip, corners + 2 * step]).ravel()
    return np.column_stack([corners.real, corners.imag])


def prism(outline, height, levels):
    """A closed prism over a polygon (N, 2), its walls in ``levels``: vertices and triangles."""
    n = len(outline)
    z = np.linspace(0.0, height, levels + 1)
    verts = np.column_stack([np.tile(outline, (levels + 1, 1)), np.repeat(z, n)])
    flat = pyvista.PolyData(np.column_stack([outline, np.zeros(n)]), [n, *range(n)]).triangulate()
    cap = flat.regular_faces
    start = np.arange(levels * n)
    after = start - start % n + (start + 1) % n
    wall = [np.column_stack([start, after, after + n]), np.column_stack([start, after + n, start + n])]
    return verts, np.concatenate([cap[:, ::-1], *wall, cap + levels * n]).astype(np.int64)


def within(verts, faces):
    """A cortex with this pial surface; the white one has half its size."""
    middle = verts.mean(axis=0)
    return Cortex(Surface(middle + 0.5 * (verts - middle), faces), Surface(verts, faces))


@pytest.mark.slow
def test_the_wall_of_a_self_similar_surface_falls_with_its_dimension():
    """Between the edges of the last generation and its size, the length of a chain of cubes along Koch's snowflake goes
    with their size to the power of 1 - log 4 / log 3, the mean over places of the snowflake in the grid."""
    scales = (1.0, 1.5, 2.0, 3.0, 4.5)  # whole numbers of cubes in 36 mm
    lengths = np.zeros(len(scales))
    for size in np.linspace(55.0, 65.0, 7):
        flat = snowflake(size, 5)
        low, high = (across_scales(within(*prism(flat, h, int(h))), scales) for h in (20.0, 56.0))
        lengths += [(b.terms.total - a.terms.total) / size for a, b in zip(low, high)]  # without caps
    exponent = np.polyfit(np.log(scales), np.log(lengths), 1)[0]
    assert exponent == pytest.approx(1 - np.log(4) / np.log(3), abs=0.04)


@pytest.mark.slow
def test_k_does_not_depend_on_size_nor_on_the_direction_of_the_grid():
    turn = trimesh.transformations.rotation_matrix(0.7, [1, 2, 3])[:3, :3]
    row, rotated = across_scales(shell(), [4.0])[0], across_scales(shell(turn=turn), [4.0])[0]
    assert row.terms.log_k == pytest.approx(rotated.terms.log_k, abs=3e-3)
    twice = across_scales(shell(60.0, 66.0), [8.0])[0]
    assert twice.terms.log_k == pytest.approx(row.terms.log_k, abs=1e-6)
    assert twice.terms.size == pytest.approx(row.terms.size + 6 * np.log10(2), abs=1e-5)


def test_a_furrow_narrower_than_the_scale_is_filled():
    outline = np.array([[-20, 0], [20, 0], [20, 20], [1.5, 20], [1.5, 8], [-1.5, 8], [-1.5, 20], [-20, 20]], float)
    cortex = within(*prism(outline, 40.0, 20))
    itself, open_, filled = (row.terms for row in across_scales(cortex, [0.0, 1.0, 4.0]))
    assert itself.total - itself.exposed == pytest.approx(2 * 12 * 40 - 2 * 3 * 12, rel=1e-6)
    assert open_.total - open_.exposed == pytest.approx(itself.total - itself.exposed, rel=0.2)
    assert filled.total == pytest.approx(filled.exposed, rel=1e-6)


def test_scales_at_which_no_gray_matter_is_left_have_no_row():
    assert [row.scale for row in across_scales(shell(5.0, 8.0), [4.0, 30.0])] == [4.0]


@pytest.mark.slow
def test_the_default_scales_are_those_of_the_source():
    scales = [row.scale for row in across_scales(shell(30.0, 36.0))]
    assert len(scales) == 37
    assert scales[:3] == pytest.approx([0, 0.225, 0.25])
    assert scales[-1] == pytest.approx(7.2)


def test_a_scale_that_is_none_or_too_small_and_an_open_surface_are_refused():
    cortex = shell()
    for scale, error in (-1.0, OutOfRange), (np.nan, OutOfRange), (0.05, TooLarge):
        with pytest.raises(error):
            across_scales(cortex, [scale])
    cut = cortex.faces[1:]
    with pytest.raises(OpenSurface):
        across_scales(Cortex(Surface(cortex.white.verts, cut), Surface(cortex.pial.verts, cut)))


def test_a_law_needs_scale_0_and_three_others(rows):
    for few in rows[:3], rows[1:]:
        with pytest.raises(OutOfRange):
            law_across_scales(few)


VERTS, FACES = icosphere(5, radius=50.0)


def harmonic(l, m, verts=VERTS):
    """Real harmonic of degree l and order m >= 0, mean square 1 over the sphere."""
    norm = math.sqrt(4 * math.pi * (1 if m == 0 else 2))
    return reference.harmonic(verts / np.linalg.norm(verts, axis=1)[:, None], l, m).real * norm


@pytest.mark.parametrize(("l", "m"), [(1, 1), (6, 0), (25, 25)])
def test_one_harmonic_has_its_power_in_its_degree_alone(l, m):
    spectrum = power_spectrum(VERTS, FACES, 51 + 3 * harmonic(l, m))
    assert spectrum.power[l] == pytest.approx(9, rel=5e-3)
    assert np.delete(spectrum.power, l).max() < 9e-4
    assert spectrum.rms == pytest.approx(3, rel=3e-3)
    assert spectrum.share == pytest.approx(1, abs=1e-3)
    assert spectrum.degree == pytest.approx(l, abs=0.05)
    assert spectrum.wavelength == pytest.approx(2 * math.pi * 50 / math.sqrt(l * (l + 1)), rel=5e-3)


def test_the_degree_of_two_harmonics_is_weighed_by_their_power_and_the_share_tells_of_one_beyond_the_last():
    both = 2 * harmonic(12, 3) + harmonic(20, 7)
    assert power_spectrum(VERTS, FACES, both).degree == pytest.approx((4 * 12 + 20) / 5, abs=0.02)
    assert power_spectrum(VERTS, FACES, both, 15).share == pytest.approx(4 / 5, abs=0.01)


def test_power_converges_at_second_order():
    spheres = [icosphere(level) for level in (3, 4, 5)]
    errors = [abs(power_spectrum(v, f, harmonic(8, 2, v), 16).power[8] - 1) for v, f in spheres]
    assert np.diff(np.log2(errors)) == pytest.approx([-2, -2], abs=0.2)


def test_turning_the_sphere_does_not_change_the_power(rng):
    height = harmonic(9, 4) + 0.5 * harmonic(14, 0)
    turn, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    turn *= np.sign(np.linalg.det(turn))
    before, after = (power_spectrum(v, FACES, height, 20).power for v in (VERTS, VERTS @ turn.T))
    np.testing.assert_allclose(before, after, atol=1e-6)


@pytest.mark.parametrize("direction", [[0.6, 0.0, 0.8], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
def test_harmonics_of_high_degrees_lose_no_digits(direction):
    """By the addition theorem the squares of degree l sum to (2 l + 1) / 4 pi."""
    squares = harmonics(np.array([direction]), LARGEST_DEGREE)[0] ** 2
    l = np.arange(LARGEST_DEGREE + 1)
    np.testing.assert_allclose(np.bincount(degrees(LARGEST_DEGREE), squares) * 4 * np.pi, 2 * l + 1, rtol=1e-9)


def test_the_largest_degree_has_waves_of_four_edges():
    last = len(power_spectrum(VERTS, FACES, VERTS[:, 2]).power) - 1
    edge = np.linalg.norm(VERTS[FACES[:, 0]] - VERTS[FACES[:, 1]], axis=1).mean()
    assert 2 * math.pi * 50 / last == pytest.approx(4 * edge, rel=0.05)


def test_a_constant_has_no_wavelength():
    spectrum = power_spectrum(VERTS, FACES, np.full(len(VERTS), 2.5))
    assert spectrum.rms == 0
    assert np.isnan([spectrum.degree, spectrum.wavelength, spectrum.share]).all()


@pytest.mark.parametrize(
    ("verts", "faces", "inward"),
    [(VERTS + [60, 0, 0], FACES, r"[1-9]\d*"), (VERTS, FACES[:, ::-1], "20480"), (VERTS, FACES[1:], "0")],
)
def test_what_is_no_sphere_around_the_origin_is_refused(verts, faces, inward):
    with pytest.raises(DoesNotApply, match=rf" {inward} of {len(faces)}\b"):
        power_spectrum(verts, faces, VERTS[:, 0])


def test_values_and_degrees_that_make_no_sense_are_refused():
    for values, error in (np.full(len(VERTS), np.nan), NotFinite), (np.ones(3), WrongShape):
        with pytest.raises(error, match=r"\b10242\b"):
            power_spectrum(VERTS, FACES, values)
    for last in (0, 1001):
        with pytest.raises(OutOfRange, match=rf"\b1 to 1000\b.*\b{last}\b"):
            power_spectrum(VERTS, FACES, VERTS[:, 0], last)


def koch_curve(level):
    """Points of the curve from (0, 0) to (1, 0), of dimension log 4 / log 3."""
    points = np.array([0, 1], dtype=complex)
    for _ in range(level):
        step = np.diff(points)
        bumps = [points[:-1] + step * fraction for fraction in (0, 1 / 3, 0.5 + 1j / (2 * 3**0.5), 2 / 3)]
        points = np.append(np.stack(bumps, axis=1).ravel(), points[-1])
    return np.stack([points.real, points.imag], axis=1)


def curtain(curve, height, steps):
    """A curve drawn out along the third axis."""
    n = len(curve)
    verts = np.concatenate([np.column_stack([curve, np.full(n, z)]) for z in np.linspace(0, height, steps)])
    i, j = (k.ravel() for k in np.meshgrid(np.arange(n - 1), np.arange(steps - 1)))
    a = j * n + i
    return verts, np.concatenate([np.stack([a, a + 1, a + n], axis=1), np.stack([a + 1, a + n + 1, a + n], axis=1)])


@pytest.mark.parametrize("shape", [sphere(6, rng=2), torus()], ids=lambda shape: shape.name)
def test_a_smooth_surface_has_two(shape):
    assert fractal_dimension(shape.verts, shape.faces) == pytest.approx(2, abs=0.06)


@pytest.mark.slow
def test_a_curtain_along_a_koch_curve_has_one_more_than_the_curve():
    verts, faces = curtain(100 * koch_curve(5), 400.0, 500)
    dimension = fractal_dimension(verts, faces, finest=2.0, coarsest=16.0)
    assert dimension == pytest.approx(1 + np.log(4) / np.log(3), abs=0.05)


@pytest.mark.slow
def test_rotation_and_unit_change_little_and_the_seed_says_the_rest(rng):
    shape = bumpy_sphere(6)
    turn = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    dimension = fractal_dimension(shape.verts, shape.faces)
    assert fractal_dimension(shape.verts, shape.faces) == dimension
    assert fractal_dimension(0.001 * shape.verts, shape.faces) == pytest.approx(dimension, abs=1e-9)
    assert fractal_dimension(shape.verts @ turn.T, shape.faces) == pytest.approx(dimension, abs=0.02)


def test_sizes_that_the_mesh_can_not_bear_are_refused():
    shape = sphere(4)
    least = 2 * mean_edge_length(shape.verts, shape.faces)
    for finest, coarsest, expected in ((0.1, None, r"0\.1 to \d"), (20.0, 10.0, r"20 to 10\.")):
        with pytest.raises(OutOfRange, match=rf" {least:.3g} .*{expected}"):
            fractal_dimension(shape.verts, shape.faces, finest=finest, coarsest=coarsest)
