"""Fibres in the core: bundles of axons that are stretched with it, and may grow.

In an element of the core fibres have one direction a before growth, a density d, and the stretch l = |F a| with the
element's mean deformation gradient F. For each reference volume they add to its energy

    W = d k mu g_f / 2 (l / g_f - 1)^2,

with mu of the core and g_f the growth stretch of the fibres. So the material is transversely isotropic: a matrix, and
fibres whose energy depends on their stretch alone. Their tension is linear in the elastic stretch l / g_f, and
at small strain they raise the modulus along a by d k mu. In terms of the positions of the corners,
F a = f = sum_c b_c x_c with b_c the mean of grad N_c . a, and with n = f / l and the volume V

    force on c = -V b_c d k mu (l / g_f - 1) n,
    stiffness between c and e = V b_c b_e d k mu / g_f [n n^T + (1 - g_f / l) (I - n n^T)],

which is at most V b_c b_e d k mu / g_f I in any state.
"""

import math
from collections.abc import Sequence
from typing import Annotated

import numpy as np
from numba import njit, prange
from numpy.typing import ArrayLike
from scipy import sparse
from skfem import Basis, ElementHex1, ElementTetP1, MeshHex, MeshTet

from morphofold.errors import DoesNotApply, ImpossibleBody, OutOfRange
from morphofold.frozen_arrays import Array, Ints
from morphofold.kernels import kernel
from morphofold.sim.body import Body
from morphofold.sim.effects import Effect, need_growth
from morphofold.sim.mesh.brick_mesh import spot_factors
from morphofold.sim.scene import Scene
from morphofold.sim.scene.table_bases import Direction, EffectOptions, Length, Point, Table, key

ELEMENTS_PER_CHUNK = 1 << 14  # set up at once, to limit memory
LARGEST_MODULUS = 200.0  # of fibres anywhere, over mu of the core
LEAST_LENGTH = 0.1  # of the mean thickness direction of an element's corners


class Bundle(Table):
    """A bundle below a pial point ``centre``: it adds ``density`` there, and nothing beyond ``radius``."""

    centre: Annotated[Point, key("point of the outer surface from which it runs inwards", "mm", strict=False)]
    radius: Annotated[Length, key("distance beyond which it adds nothing", "mm")]
    density: Annotated[float, key("what it adds to the density at its centre", gt=0, le=20)] = 1.0


class Options(EffectOptions):
    """Fibres in the core, everywhere or in bundles. They resist stretch, and may grow with the cortex."""

    example = "{density = 0.1, bundles = [{centre = [0, 0, 50], radius = 20}], growth = 1.2}"

    stiffness: Annotated[
        float, key("modulus of fibres of density 1 over the shear modulus of the core", gt=0, le=100)
    ] = 5.0
    density: Annotated[float, key("density outside of the bundles", ge=0, le=20)] = 1.0
    bundles: Annotated[tuple[Bundle, ...], key("where fibres are denser", strict=False)] = ()
    direction: Annotated[
        Direction | None, key("vector along which all fibres run before growth; by default the thickness", strict=False)
    ] = None
    growth: Annotated[float, key("growth stretch of the fibres at the final growth of the cortex", gt=0.5, le=4)] = 1.0
    buckle: Annotated[bool, key("fibres shorter than their grown length bear nothing: they never push")] = False

    def check(self, scene: Scene) -> None:
        if self.density == 0 and not self.bundles:
            raise DoesNotApply("effects.fibres: there are none; give a density above 0, or bundles")
        if self.direction is not None and not 1e-6 < math.hypot(*self.direction) < 1e6:
            raise OutOfRange(
                f"effects.fibres.direction must have a length between 1e-6 and 1e6, got {list(self.direction)}"
            )
        if self.growth != 1:
            need_growth(scene, "effects.fibres.growth")

    def share(self, scene: Scene) -> float:
        """Growth g_f - 1 of the fibres over that of the cortex."""
        return 0.0 if self.growth == 1 else (self.growth - 1) / (scene.growth.final - 1)


def build(options: Options, scene: Scene) -> Effect:
    return Fibres(
        options.stiffness,
        options.density,
        [(bundle.centre, bundle.radius, bundle.density) for bundle in options.bundles],
        options.direction,
        options.share(scene),
        options.buckle,
    )


class Fibres(Effect):
    """Fibres in the elements of the core.

    Parameters
    ----------
    stiffness : float
        Modulus of fibres of density 1, over the shear modulus of the core.
    density : float
        Outside of the bundles.
    bundles : sequence of (centre, radius, density)
        Pial points (3,) and radii [mm], and what they add to the density: all of it at the centre, half a cosine to 0
        at the radius, the same all along the thickness.
    direction : (3,) float, optional
        Of all fibres before growth, of any length; along the thickness if not given.
    share : float
        Growth g_f - 1 of the fibres over that of the cortex.
    buckle : bool
        Fibres with l < g_f bear nothing.

    Attributes
    ----------
    elements : (F,) int
        Elements with fibres.
    density : (F,) float64
        Density of their fibres.
    slopes : (F, N) csr_matrix
        b_c of the module [1/mm].

    Raises
    ------
    OutOfRange
        By ``prepare``, if a bundle reaches no element of the core, or fibres are too stiff somewhere.
    ImpossibleBody
        By ``prepare``, if the thickness directions at the corners of an element cancel out.
    """

    def __init__(
        self,
        stiffness: float,
        density: float = 1.0,
        bundles: Sequence[tuple[ArrayLike, float, float]] = (),
        direction: ArrayLike | None = None,
        share: float = 0.0,
        buckle: bool = False,
    ):
        self._modulus, self._outer_density, self._bundles = stiffness, density, bundles
        self._direction, self._share, self._buckle = direction, share, buckle

    def prepare(self, body: Body) -> None:
        core_elements = np.asarray(body.bilayer.mesh.subdomains["core"])
        density = self._densities(body.bilayer.foot[body.bilayer.mesh.t[:, core_elements]].mean(axis=0))
        self.elements, self.density = core_elements[density > 0], density[density > 0]
        modulus = self._modulus * self.density * body.mu[self.elements]
        self._volume, self._full = body.elements.volume[self.elements], modulus * body.elements.volume[self.elements]
        self.slopes = _mean_slopes(body, self.elements, self._directions(body))
        self._slopes_T = sparse.csr_matrix(self.slopes.T)
        blocks = body.elements.blocks
        self._force_rows = blocks.rows[blocks.first[:-1]]  # one of the rows of each node
        self._stretch, self._pull = np.ones(len(self.elements)), np.zeros((len(self.elements), 3))
        self._ungrown = np.ones(len(self.elements))
        self._measure(body, body.X)
        self._ungrown = self._stretch.copy()  # 1 but for round-off: no forces before growth, to the bit
        absolute_slopes = abs(self.slopes)
        stiffness_bound = absolute_slopes.T @ (self._full * (absolute_slopes @ np.ones(absolute_slopes.shape[1])))
        body.added_stiffness.append(lambda g: stiffness_bound / self._growth(g))

    def refresh(self, run) -> None:
        self._measure(run.body, run.state.x)

    def add_element_forces(self, body: Body, x: Array, v: Array) -> None:
        self._measure(body, x)
        add_pulls(*_arrays(self._slopes_T), self._pull, self._force_rows, body.elements.blocks.force)

    def stiffness(self, body: Body, x: Array) -> sparse.csr_matrix:
        g = self._growth(body.growth)
        f = self.slopes @ x
        l = np.linalg.norm(f, axis=1)
        n = f / l[:, None]
        nn = n[:, :, None] * n[:, None, :]
        curvature = nn + (1 - g / (l / self._ungrown))[:, None, None] * (np.eye(3) - nn)
        is_bearing = (l >= g * self._ungrown) | (not self._buckle)
        blocks = (self._full / g * is_bearing)[:, None, None] * curvature
        size = len(blocks)
        block_matrix = sparse.bsr_matrix((blocks, np.arange(size), np.arange(size + 1)), shape=(3 * size, 3 * size))
        slopes3 = sparse.csr_matrix(sparse.kron(self.slopes, np.eye(3)))
        return sparse.csr_matrix(slopes3.T @ block_matrix @ slopes3)

    def energy(self) -> float:
        """Energy of the fibres at the last measurement, or step."""
        elastic_strain = self._stretch / self._growth_f - 1
        if self._buckle:
            elastic_strain = np.maximum(elastic_strain, 0.0)
        return 0.5 * self._growth_f * float((self._full * elastic_strain**2).sum())

    def record(self) -> dict[str, float]:
        """Growth stretch of the fibres; largest and smallest stretch l, and its mean weighted by density."""
        fibre_weights = self.density * self._volume
        return {
            "growth": self._growth_f,
            "largest_stretch": float(self._stretch.max()),
            "smallest_stretch": float(self._stretch.min()),
            "mean_stretch": float((self._stretch * fibre_weights).sum() / fibre_weights.sum()),
        }

    def _growth(self, g: float) -> float:
        return 1 + (g - 1) * self._share

    def _measure(self, body: Body, x: Array) -> None:
        self._growth_f = self._growth(body.growth)
        pull_fibres(
            *_arrays(self.slopes), x, self._ungrown, self._full, self._growth_f, self._buckle, self._stretch, self._pull
        )

    def _densities(self, pial_points: Array) -> Array:
        """Density (E,) below pial points (E, 3)."""
        density = np.full(len(pial_points), self._outer_density)
        for centre, radius, centre_density in self._bundles:
            added_density = centre_density * (spot_factors(pial_points, [(centre, radius, 2.0)]) - 1)
            if not added_density.any():
                nearest = np.linalg.norm(pial_points - np.asarray(centre), axis=1).min()
                raise OutOfRange(
                    f"effects.fibres.bundles: nothing lies within {radius:g} mm of {np.asarray(centre).tolist()}; the "
                    f"nearest element is below a point {nearest:.3g} mm away. Give a point of the outer surface that "
                    "is simulated (geometry.portion), or a larger radius."
                )
            density += added_density
        if density.max() * self._modulus > LARGEST_MODULUS:
            raise OutOfRange(
                f"effects.fibres: where they are densest, {density.max():.3g}, their modulus is "
                f"{density.max() * self._modulus:.3g} times the shear modulus of the core; it may be "
                f"{LARGEST_MODULUS:g}. Reduce stiffness or density."
            )
        return density

    def _directions(self, body: Body) -> Array:
        """Unit directions (F, 3) of the fibres."""
        if self._direction is not None:
            direction = np.broadcast_to(np.asarray(self._direction, dtype=np.float64), (len(self.elements), 3))
            return direction / np.linalg.norm(direction, axis=1, keepdims=True)
        direction = body.bilayer.radial[body.bilayer.mesh.t[:, self.elements]].mean(axis=0)
        mean_length = np.linalg.norm(direction, axis=1)
        bad = np.flatnonzero(~(mean_length > LEAST_LENGTH))
        if bad.size:
            raise ImpossibleBody(
                f"effects.fibres: the thickness directions at the corners of {len(bad)} of {len(direction):,} elements "
                f"cancel out; the first is {self.elements[bad[0]]}. Give effects.fibres.direction as a vector."
            )
        return direction / mean_length[:, None]


def _mean_slopes(body: Body, elements: Ints, direction: Array) -> sparse.csr_matrix:
    """Mean over each element of grad N . a for the shape functions of its corners: (F, N), at the body's X [1/mm]."""
    t = body.bilayer.mesh.t
    points = np.ascontiguousarray(body.X.T)
    is_brick = isinstance(body.bilayer.mesh, MeshHex)
    mesh = MeshHex(points, t, validate=False) if is_brick else MeshTet(points, t, validate=False)
    means = np.empty((len(elements), len(t)))
    for first in range(0, len(elements), ELEMENTS_PER_CHUNK):
        chunk = slice(first, first + ELEMENTS_PER_CHUNK)
        basis = Basis(mesh, ElementHex1() if is_brick else ElementTetP1(), intorder=3, elements=elements[chunk])
        for corner in range(len(t)):
            slope = np.einsum("req,er->eq", basis.basis[corner][0].grad, direction[chunk])
            means[chunk, corner] = (slope * basis.dx).sum(axis=1) / basis.dx.sum(axis=1)
    starts = len(t) * np.arange(len(elements) + 1)
    slopes = sparse.csr_matrix((means.ravel(), t[:, elements].T.ravel(), starts), shape=(len(elements), len(body.X)))
    slopes.sort_indices()  # now: scipy would do it later, and sums in another order have other round-off
    return slopes


def _arrays(matrix: sparse.csr_matrix) -> tuple[Ints, Ints, Array]:
    return matrix.indptr, matrix.indices, matrix.data


@njit(inline="always")
def _row_times(row_starts, columns, weights, vectors, row):
    """A row of a sparse matrix times vectors (M, 3), in fixed order."""
    sum0, sum1, sum2 = 0.0, 0.0, 0.0
    for entry_index in range(row_starts[row], row_starts[row + 1]):
        weight, vector_row = weights[entry_index], columns[entry_index]
        sum0 += weight * vectors[vector_row, 0]
        sum1 += weight * vectors[vector_row, 1]
        sum2 += weight * vectors[vector_row, 2]
    return sum0, sum1, sum2


@kernel(parallel=True)
def pull_fibres(row_starts, nodes, slopes, x, first_length, energy_scale, growth, buckle, stretch, pull):
    """Stretch (F,), and d k mu V (l / g_f - 1) n (F, 3), at positions ``x`` (N, 3); ``energy_scale``: d k mu V."""
    for e in prange(len(first_length)):
        f0, f1, f2 = _row_times(row_starts, nodes, slopes, x, e)
        length = np.sqrt(f0 * f0 + f1 * f1 + f2 * f2)
        stretch[e] = length / first_length[e]
        elastic_strain = stretch[e] / growth - 1.0
        pull_over_length = 0.0 if buckle and elastic_strain < 0.0 else energy_scale[e] * elastic_strain / length
        pull[e, 0], pull[e, 1], pull[e, 2] = pull_over_length * f0, pull_over_length * f1, pull_over_length * f2


@kernel(parallel=True)
def add_pulls(row_starts, elements, slopes, pull, force_rows, force):
    """Add the forces of the fibres to a row of ``force`` (R, 3) of each node: sums in fixed order."""
    for node in prange(len(force_rows)):
        pull_x, pull_y, pull_z = _row_times(row_starts, elements, slopes, pull, node)
        if row_starts[node + 1] > row_starts[node]:
            force_row = force_rows[node]
            force[force_row, 0] -= pull_x
            force[force_row, 1] -= pull_y
            force[force_row, 2] -= pull_z
