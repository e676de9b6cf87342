"""Resampling of maps from one surface to another, registered by their spheres (FreeSurfer's ?h.sphere.reg)."""

from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from morphofold.arrays import Array, Ints
from morphofold.errors import WrongShape
from morphofold.spheres.places import Places, T, places
from morphofold.surface import Surface
from morphofold.unfolding.unfold import points_on_sphere

LEAST_GATHERED = 4  # source vertices around a target vertex, from which on their mean is taken
LEAST_KNOWN_SHARE = 0.5  # of the weights of a target vertex, below which it has no value


class Resampling:
    """Brings maps from the N vertices of a source to the P vertices of a target.

    Parameters
    ----------
    source, target : Surface
        Spheres about the origin, of any radius, on which the two surfaces are registered: ``?h.sphere.reg`` of a
        subject; that, or ``?h.sphere``, of a template. For the way back exchange them.

    Raises
    ------
    ValueError
        If one of the two is not a sphere: a border, vertices at different distances from the origin, or triangles that
        cover it more than once.

    Notes
    -----
    Where the target is finer, values are interpolated linearly in the triangles of the source. Where it is coarser,
    that would use few of the source's vertices, so values are averaged: each source vertex is shared among the corners
    of the target's triangle that holds it, in proportion to its barycentric coordinates. The second is the transpose of
    interpolation from target to source, so it keeps sums. Workbench's ADAP_BARY_AREA chooses between the two in a
    similar way. Means are of second order in the edge of an even target, such as FreeSurfer's templates, and of first
    order where its triangles are uneven.
    """

    def __init__(self, source: Surface, target: Surface):
        self._source, self._target = source, target
        self._from, self._to = (points_on_sphere(sphere, sphere) for sphere in (source, target))

    def __repr__(self) -> str:
        return f"Resampling({len(self._source.verts):,} to {len(self._target.verts):,} vertices)"

    @cached_property
    def places(self) -> Places:
        """Places of the target's vertices in the source's triangles."""
        return places(self._from, self._source.faces, self._to)

    @cached_property
    def shares(self) -> sparse.csr_array:
        """Shares (P, N) of each source vertex that fall to the target's vertices; columns sum to 1."""
        back = places(self._to, self._target.faces, self._from)
        one = np.repeat(np.arange(len(self._from)), 3)
        return _matrix(back.corners.ravel(), one, back.shares.ravel(), (len(self._to), len(self._from)))

    def values(self, values: Array) -> Array:
        """Values (N,) at the target's vertices (P,), by linear interpolation; beside a NaN those of the nearest vertex.

        Exact where a target's vertex is one of the source's, and of second order in the edge elsewhere.
        """
        return self.places.values(_checked(values, len(self._from)))

    def means(self, values: Array, areas: Array) -> Array:
        """Means (P,) of values (N,) over the area around each target's vertex; ``areas`` (N,) of the source's [mm^2].

        Where the target is as fine as the source or finer, this is ``values``. NaN where less than half of the weight
        is of values that are known.
        """
        values, weights = _checked(values, len(self._from)), self._weights(areas)
        known = np.isfinite(values)
        total, share = weights.sum(axis=1), weights @ known.astype(np.float64)
        mean = weights @ np.where(known, values, 0.0)
        enough = (share >= LEAST_KNOWN_SHARE * total) & (share > 0)
        return np.divide(mean, share, out=np.full(len(mean), np.nan), where=enough)

    def sums(self, amounts: Array) -> Array:
        """Amounts (P,) such as areas or counts: the source's (N,) are divided among the target's vertices.

        Their sum stays the same to round-off. NaN counts as nothing.
        """
        amounts = _checked(amounts, len(self._from))
        found: Array = self.shares @ np.where(np.isfinite(amounts), amounts, 0.0)
        return found

    def labels(self, labels: Ints, areas: Array) -> Ints:
        """The label (P,) with the largest area around each target's vertex, of labels (N,); the least of equal ones."""
        labels, weights = _checked(labels, len(self._from)), self._weights(areas)
        names, number = np.unique(labels, return_inverse=True)
        of_names = sparse.csr_array((np.ones(len(number)), number, np.arange(len(number) + 1)))
        found: Ints = names[(weights @ of_names).toarray().argmax(axis=1)]
        return found

    def _weights(self, areas: Array) -> sparse.csr_array:
        """Weights (P, N) of means: shares times areas, or those of interpolation where few source vertices are near."""
        gathered = self.shares @ sparse.diags_array(_checked(areas, len(self._from)))
        few = np.diff(self.shares.indptr) < LEAST_GATHERED
        row = np.repeat(np.flatnonzero(few), 3)
        inside = _matrix(row, self.places.corners[few].ravel(), self.places.shares[few].ravel(), gathered.shape)
        return (sparse.diags_array((~few).astype(np.float64)) @ gathered + inside).tocsr()


def _matrix(rows: Ints, columns: Ints, values: Array, shape: tuple[int, int]) -> sparse.csr_array:
    """Entries that are not 0, those at the same place added."""
    some = values > 0
    return sparse.coo_array((values[some], (rows[some], columns[some])), shape=shape).tocsr()


def _checked(values: NDArray[T], n: int) -> NDArray[T]:
    if np.shape(values) != (n,):
        raise WrongShape(f"the map has shape {np.shape(values)}, the source sphere has {n} vertices.")
    return np.asarray(values)
