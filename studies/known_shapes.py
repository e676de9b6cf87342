"""Surfaces with known answers: plain, bumpy and ridged spheres, ellipsoid, torus, cylinder, sheet, and regular nets of
ridges. The study of accuracy and the tests measure them."""

from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import Delaunay

from morphofold.errors import OutOfRange
from morphofold.frozen_arrays import Array
from morphofold.shapes import icosphere
from morphofold.shapes.spherical_nets import SphericalNet
from morphofold.studies.irregular_spheres import irregular_sphere
from morphofold.surface import Cortex, Faces, PerVertex, Surface, Verts

GOLDEN_RATIO = (1 + 5**0.5) / 2

#: corners of the regular solids, not scaled to a unit sphere
REGULAR_SOLIDS = {
    "tetrahedron": [[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]],
    "cube": list(product((-1, 1), repeat=3)),
    "octahedron": [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]],
    "icosahedron": [
        np.roll([0, a, b * GOLDEN_RATIO], k).tolist() for a, b in product((-1, 1), repeat=2) for k in range(3)
    ],
    "dodecahedron": [
        *product((-1, 1), repeat=3),
        *(
            np.roll([0, a / GOLDEN_RATIO, b * GOLDEN_RATIO], k).tolist()
            for a, b in product((-1, 1), repeat=2)
            for k in range(3)
        ),
    ],
}


@dataclass(frozen=True, eq=False)
class Shape:
    """A triangle mesh of a smooth surface, with the exact fields of that surface at the vertices.

    ``normals`` (N, 3) are outward unit normals; ``k1 >= k2`` (N,) [1/mm] principal curvatures, convex positive;
    ``d1`` (N, 3) the unit direction of k1 (arbitrary where k1 = k2, and up to sign).
    """

    verts: Verts = field(repr=False)
    faces: Faces = field(repr=False)
    normals: NDArray[np.float64] = field(repr=False)
    k1: PerVertex = field(repr=False)
    k2: PerVertex = field(repr=False)
    d1: NDArray[np.float64] = field(repr=False)
    name: str = "shape"

    @property
    def H(self) -> PerVertex:
        return (self.k1 + self.k2) / 2

    @property
    def K(self) -> PerVertex:
        return self.k1 * self.k2

    @property
    def surface(self) -> Surface:
        return Surface(self.verts, self.faces, name=self.name)


def _unit_sphere(level: int, rng: np.random.Generator | int | None) -> tuple[Verts, Faces]:
    return icosphere(level) if rng is None else irregular_sphere(level, rng=rng)


def sphere(level: int, radius: float = 50.0, *, rng: np.random.Generator | int | None = None) -> Shape:
    """Sphere [mm] with its exact curvature; irregular if ``rng`` (a generator or a seed) is given."""
    return replace(ellipsoid(level, (radius, radius, radius), rng=rng), name="sphere")


def ellipsoid(
    level: int, axes: tuple[float, float, float] = (50.0, 40.0, 30.0), *, rng: np.random.Generator | int | None = None
) -> Shape:
    """Ellipsoid with three semi-axes [mm]; irregular if ``rng`` (a generator or a seed) is given."""
    verts, faces = _unit_sphere(level, rng)
    semi_axes = np.asarray(axes, dtype=float)
    verts = verts * semi_axes
    hessian = np.broadcast_to(np.diag(2 / semi_axes**2), (len(verts), 3, 3))
    return _shape_of_level_set(verts, faces, 2 * verts / semi_axes**2, hessian, "ellipsoid")


def bumpy_sphere(
    level: int | tuple[Verts, Faces],
    radius: float = 50.0,
    amplitude: float = 0.2,
    *,
    rng: np.random.Generator | int | None = None,
) -> Shape:
    """Sphere with hills, ``r = radius (1 + amplitude Y)``, with Y the real orthonormal harmonic of degree 6, order 3.

    Y lies between -0.65 and 0.65. At amplitude 0.2 the surface has hills, valleys and saddles with curvatures
    several times 1/radius. Irregular if ``rng`` (a generator or a seed) is given; ``level`` may also be any mesh of the
    unit sphere, (verts, faces).
    """
    verts, faces = level if isinstance(level, tuple) else _unit_sphere(level, rng)
    harmonic, _, _ = _harmonic_6_3(verts)
    verts = verts * (radius * (1 + amplitude * harmonic))[:, None]
    radii = np.linalg.norm(verts, axis=1)[:, None]
    _, harmonic_gradient, harmonic_hessian = _harmonic_6_3(verts)
    normal = verts / radii
    normal_outer = normal[:, :, None] * normal[:, None, :]
    return _shape_of_level_set(
        verts,
        faces,
        normal - radius * amplitude * harmonic_gradient,
        (np.eye(3) - normal_outer) / radii[:, :, None] - radius * amplitude * harmonic_hessian,
        "bumpy sphere",
    )


def _harmonic_6_3(x: Verts) -> tuple[PerVertex, NDArray[np.float64], NDArray[np.float64]]:
    """Y(x / |x|), its gradient (N, 3) and Hessian (N, 3, 3): Y = p / |x|^6 with the harmonic polynomial
    p = c q s, q = x^3 - 3 x y^2, s = 8 z^3 - 3 z (x^2 + y^2), c = sqrt(2730 / pi) / 32."""
    X, Y, Z = x.T
    c = (2730 / np.pi) ** 0.5 / 32
    xy_squared = X * X + Y * Y
    q, s = X**3 - 3 * X * Y**2, 8 * Z**3 - 3 * Z * xy_squared
    zero = np.zeros_like(X)
    dq = np.stack([3 * X**2 - 3 * Y**2, -6 * X * Y, zero], axis=1)
    ds = np.stack([-6 * X * Z, -6 * Y * Z, 24 * Z**2 - 3 * xy_squared], axis=1)
    ddq = np.moveaxis(np.array([[6 * X, -6 * Y, zero], [-6 * Y, -6 * X, zero], [zero, zero, zero]]), 2, 0)
    dds = np.moveaxis(np.array([[-6 * Z, zero, -6 * X], [zero, -6 * Z, -6 * Y], [-6 * X, -6 * Y, 48 * Z]]), 2, 0)
    dq_ds = dq[:, :, None] * ds[:, None, :]
    p = c * q * s
    dp = c * (dq * s[:, None] + ds * q[:, None])
    ddp = c * (ddq * s[:, None, None] + dds * q[:, None, None] + dq_ds + dq_ds.transpose(0, 2, 1))
    r2 = np.sum(x**2, axis=1)
    gradient = dp / r2[:, None] ** 3 - 6 * (p / r2**4)[:, None] * x
    dp_x = dp[:, :, None] * x[:, None, :]
    hessian = (
        ddp / r2[:, None, None] ** 3
        - 6 * (dp_x + dp_x.transpose(0, 2, 1)) / r2[:, None, None] ** 4
        - 6 * (p / r2**4)[:, None, None] * np.eye(3)
        + 48 * (p / r2**5)[:, None, None] * x[:, :, None] * x[:, None, :]
    )
    return p / r2**3, gradient, hessian


def torus(
    n_around: int = 120,
    n_tube: int = 48,
    major: float = 40.0,
    minor: float = 16.0,
    *,
    rng: np.random.Generator | int | None = None,
) -> Shape:
    """Torus about z: ``n_around`` rows along the circle of radius ``major``, ``n_tube`` around the tube [mm].

    Irregular if ``rng`` (a generator or a seed) is given: vertices move by up to 0.45 of their spacing and are
    triangulated again (Delaunay in the two angles, stretched to lengths).
    """
    row, column = np.meshgrid(np.arange(n_around), np.arange(n_tube), indexing="ij")
    grid = np.stack([row + 0.5 * (column % 2), column], axis=-1).reshape(-1, 2).astype(float)
    if n_tube % 2:
        raise OutOfRange(f"n_tube must be even (every second row is shifted by half a step), got {n_tube}.")
    if rng is not None:
        grid += np.random.default_rng(rng).uniform(-0.45, 0.45, grid.shape)
    faces = _periodic_delaunay(grid, (n_around, n_tube), (2 * np.pi * major / n_around, 2 * np.pi * minor / n_tube))
    u, v = 2 * np.pi * grid.T / np.array([[n_around], [n_tube]])
    ring_directions = np.stack([np.cos(u), np.sin(u), np.zeros_like(u)], axis=1)
    normals = np.cos(v)[:, None] * ring_directions + np.sin(v)[:, None] * np.array([0.0, 0.0, 1.0])
    verts = major * ring_directions + minor * normals
    ring_curvature = np.cos(v) / (major + minor * np.cos(v))
    d1 = np.cos(v)[:, None] * np.array([0.0, 0.0, 1.0]) - np.sin(v)[:, None] * ring_directions
    return Shape(verts, faces, normals, np.full_like(v, 1 / minor), ring_curvature, d1, "torus")


def _periodic_delaunay(grid: NDArray[np.float64], n_steps: tuple[int, int], step_lengths: tuple[float, float]) -> Faces:
    """Delaunay triangles of points in a doubly periodic plane, each once, counter-clockwise."""
    n_points, periods = len(grid), np.array(n_steps, dtype=float)
    tiles = np.array([(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1)], dtype=float)
    tiled_points = (grid[None, :, :] + (tiles * periods)[:, None, :]).reshape(-1, 2)
    point_index = np.tile(np.arange(n_points), len(tiles))
    is_near = ((tiled_points > -8) & (tiled_points < periods + 8)).all(axis=1)
    tiled_points, point_index = tiled_points[is_near], point_index[is_near]
    triangles = Delaunay(tiled_points * np.array(step_lengths)).simplices
    centroids = tiled_points[triangles].mean(axis=1)
    is_inside = ((centroids >= 0) & (centroids < periods)).all(axis=1)
    triangles = triangles[is_inside]
    a, b, c = (tiled_points[triangles[:, k]] for k in range(3))
    is_clockwise = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0]) < 0
    triangles[is_clockwise] = triangles[is_clockwise][:, ::-1]
    return point_index[triangles].astype(np.int64)


def cylinder(radius: float = 10.0, length: float = 40.0, n_around: int = 64, n_along: int = 41) -> Shape:
    """Open cylinder about z [mm]: two border loops, ``n_around * n_along`` vertices."""
    i, j = np.meshgrid(np.arange(n_around), np.arange(n_along), indexing="ij")
    angle = (2 * np.pi * (i + 0.5 * (j % 2)) / n_around).ravel()
    ring_directions = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=1)
    verts = radius * ring_directions
    verts[:, 2] = (length * (j / (n_along - 1) - 0.5)).ravel()
    vertex_of = lambda i, j: (i % n_around) * n_along + j
    i, j = np.meshgrid(np.arange(n_around), np.arange(n_along - 1), indexing="ij")
    is_odd = j % 2
    lower_triangles = np.stack([vertex_of(i, j), vertex_of(i + 1, j), vertex_of(i + is_odd, j + 1)], axis=-1)
    upper_triangles = np.stack([vertex_of(i, j + 1), vertex_of(i + 1 - is_odd, j), vertex_of(i + 1, j + 1)], axis=-1)
    faces = np.concatenate([lower_triangles.reshape(-1, 3), upper_triangles.reshape(-1, 3)]).astype(np.int64)
    d1 = np.stack([-np.sin(angle), np.cos(angle), np.zeros_like(angle)], axis=1)
    return Shape(verts, faces, ring_directions, np.full(len(verts), 1 / radius), np.zeros(len(verts)), d1, "cylinder")


def ridged_sphere(
    level: int,
    width: float = 6.0,
    *,
    ridges: int = 10,
    height: float = 4.0,
    radius: float = 50.0,
    thickness: float = 1.5,
    rng: np.random.Generator | int | None = None,
) -> tuple[Cortex, float]:
    """Sphere with ``ridges`` equal gyri along circles of latitude, and their exact width at half height.

    The pial radius is ``radius + height 2^-(2 s / width)^2``. Here s is the arc length on the sphere of that radius to
    the nearest circle. The circles divide the meridian evenly; the poles lie in sulci. White is the same with radius
    less ``thickness`` and ridges narrower by twice that, at least a fifth as wide: a blade inside each gyrus. Choose
    width below half the spacing ``pi radius / ridges``, so that sulci reach the floor. Irregular if ``rng`` (a
    generator or a seed) is given.

    Returns
    -------
    cortex : Cortex
        White and pial [mm].
    chord : float
        ``2 (radius + height / 2) sin(width / (2 radius))`` [mm], straight line from wall to wall at half height.
    """
    verts, faces = _unit_sphere(level, rng)
    ridge_period = np.pi / ridges
    arc_length = radius * np.abs(np.arccos(np.clip(verts[:, 2], -1, 1)) % ridge_period - ridge_period / 2)
    ridged = lambda base, full_width: verts * (base + height * np.exp2(-((2 * arc_length / full_width) ** 2)))[:, None]
    cortex = Cortex(
        white=Surface(ridged(radius - thickness, max(width - 2 * thickness, width / 5)), faces, name="ridged white"),
        pial=Surface(ridged(radius, width), faces, name="ridged pial"),
        name="ridged sphere",
    )
    return cortex, 2 * (radius + height / 2) * float(np.sin(width / (2 * radius)))


def corrugated_sheet(
    edge: float,
    *,
    wavelength: float = 15.0,
    height: float = 6.0,
    size: float = 120.0,
    rng: np.random.Generator | int | None = None,
) -> tuple[Surface, float]:
    """Square sheet ``z = height / 2 cos(2 pi x / wavelength)`` over a grid of squares of ``edge``, each cut in two.

    Points inside are moved by up to a quarter of an edge along x and y if ``rng`` (a generator or a seed) is given.

    Returns
    -------
    sheet : Surface
        The sheet [mm]; up is outward.
    width : float
        Width of a gyrus and of a sulcus at half height: half a wavelength [mm].
    """
    n_side = round(size / edge) + 1
    grid_coordinates = np.linspace(0, size, n_side)
    x, y = np.meshgrid(grid_coordinates, grid_coordinates, indexing="ij")
    if rng is not None:
        shift = np.random.default_rng(rng).uniform(-0.25, 0.25, (2, n_side - 2, n_side - 2)) * edge
        x[1:-1, 1:-1] += shift[0]
        y[1:-1, 1:-1] += shift[1]
    verts = np.column_stack([x.ravel(), y.ravel(), 0.5 * height * np.cos(2 * np.pi * x.ravel() / wavelength)])
    vertex = np.arange(n_side * n_side).reshape(n_side, n_side)
    a, b, c, d = (corner.ravel() for corner in (vertex[:-1, :-1], vertex[1:, :-1], vertex[1:, 1:], vertex[:-1, 1:]))
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    return Surface(verts, faces, name="corrugated sheet"), wavelength / 2


def with_noise(shape: Shape, fraction: float = 0.01, *, rng: np.random.Generator | int = 0) -> Shape:
    """The shape with vertices moved along the exact normal by normal noise with an sd of ``fraction`` mean edges.

    The exact fields stay those of the clean surface.
    """
    edges = np.concatenate([shape.faces[:, [0, 1]], shape.faces[:, [1, 2]], shape.faces[:, [2, 0]]])
    mean_edge = np.linalg.norm(shape.verts[edges[:, 0]] - shape.verts[edges[:, 1]], axis=1).mean()
    normal_shift = fraction * mean_edge * np.random.default_rng(rng).standard_normal(len(shape.verts))
    return replace(shape, verts=shape.verts + normal_shift[:, None] * shape.normals)


def _shape_of_level_set(
    verts: Verts, faces: Faces, gradient: NDArray[np.float64], hessian: NDArray[np.float64], name: str
) -> Shape:
    """Exact normals and curvatures of a level set, from its outward gradient and its Hessian at the vertices.

    The second fundamental form is the Hessian in the tangent plane, divided by the length of the gradient.
    """
    gradient_length = np.linalg.norm(gradient, axis=1)
    normals = gradient / gradient_length[:, None]
    least_axis = np.eye(3)[np.argmin(np.abs(normals), axis=1)]
    t1 = np.cross(normals, least_axis)
    t1 /= np.linalg.norm(t1, axis=1, keepdims=True)
    t2 = np.cross(normals, t1)
    tangent_frame = np.stack([t1, t2], axis=1)  # (N, 2, 3)
    fundamental_form = tangent_frame @ hessian @ tangent_frame.transpose(0, 2, 1) / gradient_length[:, None, None]
    curvatures, directions = np.linalg.eigh(fundamental_form)
    d1 = np.einsum("nk,nkx->nx", directions[:, :, 1], tangent_frame)
    return Shape(verts, faces, normals, curvatures[:, 1], curvatures[:, 0], d1, name)


def regular_net(solid: str) -> SphericalNet:
    """Corners and edges of a regular solid: ``tetrahedron``, ``cube``, ``octahedron``, ``icosahedron``,
    ``dodecahedron``; degrees 3, 3, 4, 5, 3."""
    nodes = np.array(REGULAR_SOLIDS[solid], dtype=np.float64)
    nodes /= np.linalg.norm(nodes, axis=1, keepdims=True)
    node_distance = np.linalg.norm(nodes[:, None] - nodes[None], axis=2) + 9 * np.eye(len(nodes))
    edges = np.argwhere(node_distance < 1.01 * node_distance.min())
    return SphericalNet(nodes, edges[edges[:, 0] < edges[:, 1]])


def arm_angles(net: SphericalNet, node: int) -> Array:
    """Angles between neighbouring arcs at a node, ascending [deg]; they add up to 360."""
    node_position = net.nodes[node]
    tips = [net.nodes[end if start == node else start] for start, end in net.arcs.tolist() if node in (start, end)]
    least_axis = np.eye(3)[np.argmin(np.abs(node_position))]
    u = np.cross(node_position, least_axis)
    v = np.cross(node_position, u)
    azimuths = np.sort(
        np.degrees([np.arctan2(tip @ v / np.linalg.norm(v), tip @ u / np.linalg.norm(u)) for tip in tips])
    )
    return np.sort(np.diff(np.r_[azimuths, azimuths[0] + 360]))
