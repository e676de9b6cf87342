"""A part between symmetry planes, mirrored to the whole: faces, and where each vertex of the whole comes from."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from morphofold.arrays import Array, Bools, Ints
from morphofold.sim.mesh.brick_mesh import Plane


class Whole(NamedTuple):
    """A surface and its mirror images as one; the vertices and faces of the part come first.

    Attributes
    ----------
    faces : (F, k) int
        Images have the reverse order of corners.
    node : (V,) int
        The vertex of the part of which each is the image; ``values[node]`` are its values.
    sign : (V, 3) float64
        -1 along the axes at whose planes it is mirrored, else 1.
    shift : (3,) float64
        Twice the coordinates of the planes [mm].
    """

    faces: Ints
    node: Ints
    sign: Array
    shift: Array

    def positions(self, x: Array) -> Array:
        """Positions (V, 3) of the whole from those of the part [mm]."""
        return x[self.node] * self.sign + np.where(self.sign < 0, self.shift, 0.0)


def mirror(faces: Ints, on_plane: Bools, planes: Sequence[Plane]) -> Whole:
    """Mirror ``faces`` (F, k) at planes, one after the other; both sides share the vertices on a plane.

    ``on_plane`` (N, 3): whether a vertex of the part lies on the plane of each axis.
    """
    node, sign, shift = np.arange(len(on_plane)), np.ones(on_plane.shape), np.zeros(3)
    for axis, at, _ in planes:
        off = np.flatnonzero(~on_plane[node, axis])
        image = np.arange(len(node))
        image[off] = len(node) + np.arange(len(off))
        flipped = sign[off]
        flipped[:, axis] = -1
        node, sign = np.concatenate([node, node[off]]), np.concatenate([sign, flipped])
        faces = np.concatenate([faces, image[faces][:, ::-1]])
        shift[axis] = 2 * at
    return Whole(faces, node, sign, shift)
