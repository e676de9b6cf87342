"""A part between symmetry planes, mirrored to the whole: faces, and where each vertex of the whole comes from."""

from __future__ import annotations

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
    origin : (V,) int
        The vertex of the part of which each is the image; ``values[origin]`` are its values.
    flipped : (V, 3) bool
        Axes along which it is mirrored.
    planes : tuple of Plane
    """

    faces: Ints
    origin: Ints
    flipped: Bools
    planes: tuple[Plane, ...]

    def positions(self, x: Array) -> Array:
        """Positions (V, 3) of the whole from those of the part [mm]."""
        found = x[self.origin]
        for plane in self.planes:
            there = self.flipped[:, plane.axis]
            found[there, plane.axis] = 2 * plane.at - found[there, plane.axis]
        return found


def mirror(faces: Ints, on_plane: Bools, planes: Sequence[Plane]) -> Whole:
    """Mirror ``faces`` (F, k) at planes, one after the other; both sides share the vertices on a plane.

    ``on_plane`` (N, 3): whether a vertex of the part lies on the plane of each axis.
    """
    origin, flipped = np.arange(len(on_plane)), np.zeros(on_plane.shape, dtype=bool)
    for axis, _, _ in planes:
        off = np.flatnonzero(~on_plane[origin, axis])
        image = np.arange(len(origin))
        image[off] = len(origin) + np.arange(len(off))
        across = flipped[off]
        across[:, axis] = True
        origin, flipped = np.concatenate([origin, origin[off]]), np.concatenate([flipped, across])
        faces = np.concatenate([faces, image[faces][:, ::-1]])
    return Whole(faces, origin, flipped, tuple(planes))
