"""Rays against a surface: the first hit, and whether they stay inside."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from morphofold import geometry
from morphofold.arrays import Array, Bools, Ints
from morphofold.surface import Surface


class RayCaster:
    """First hit of rays on a surface. embree finds the triangle in single precision, this class the point in double."""

    def __init__(self, surface: Surface) -> None:
        try:
            from embreex.mesh_construction import TriangleMesh
            from embreex.rtcore_scene import EmbreeScene
        except ImportError as error:
            raise ImportError(
                "gyral thickness needs embree to cast rays, but it is missing: pip install embreex"
            ) from error
        self.verts, self.faces = surface.verts, surface.faces
        self.normals = geometry.face_normals(surface.verts, surface.faces)
        self.edge = geometry.mean_edge_length(surface.verts, surface.faces)
        self._origin, self._unit = surface.verts.mean(axis=0), float(np.ptp(surface.verts, axis=0).max())
        self._scene = EmbreeScene()
        TriangleMesh(self._scene, self._scaled(surface.verts), surface.faces.astype(np.int32))

    def _scaled(self, points: Array) -> NDArray[np.float32]:
        """Points moved to 0 and scaled to size 1, because embree's tolerances are absolute."""
        return ((points - self._origin) / self._unit).astype(np.float32)

    def shoot(self, origins: Array, directions: Array) -> tuple[Array, Ints, Array]:
        """Distance (R,) of the first hit (inf: none), its triangle (R,), cosine of ray and outward normal (R,)."""
        triangle = np.asarray(self._scene.run(self._scaled(origins), directions.astype(np.float32)), dtype=np.int64)
        normal = self.normals[triangle]
        cosine = np.sum(normal * directions, axis=1)
        ahead = np.sum((self.verts[self.faces[triangle, 0]] - origins) * normal, axis=1)
        hit = (triangle >= 0) & (np.abs(cosine) > 1e-6)
        return np.divide(ahead, cosine, out=np.full(len(origins), np.inf), where=hit), triangle, cosine

    def crossings(
        self, origins: Array, directions: Array, lengths: Array | float, wanted: Bools
    ) -> Iterator[tuple[Ints, Array, Ints, Array]]:
        """Successive hits of rays, up to their lengths: the first hits of all rays, then the second hits, and so on.

        Yields the rays (L,) that hit, and the distances, triangles and cosines (L,). Rays whose ``wanted`` (R,) is or
        becomes False are not followed. There are 32 hits at most, because of rays that graze the surface.
        """
        gone, lengths = np.zeros(len(origins)), np.broadcast_to(lengths, len(origins))
        for _ in range(32):
            live = np.flatnonzero(wanted)
            if not len(live):
                return
            far, triangle, cosine = self.shoot(origins[live] + gone[live, None] * directions[live], directions[live])
            at = gone[live] + np.maximum(far, 0)
            within = at < lengths[live]
            wanted[live[~within]] = False
            live, at = live[within], at[within]
            gone[live] = at + 1e-3 * self.edge
            yield live, at, triangle[within], cosine[within]

    def bodies(self, origins: Array, directions: Array, longest: float) -> Ints:
        """Number of bodies in which each point (R,) lies: the largest count of exits less entries along its ray."""
        depth, deepest = np.zeros(len(origins), dtype=np.int64), np.zeros(len(origins), dtype=np.int64)
        for live, _, _, cosine in self.crossings(origins, directions, longest, np.ones(len(origins), dtype=bool)):
            depth[live] += np.where(cosine > 0, 1, -1)
            np.maximum(deepest, depth, out=deepest)
        return deepest

    def exits(self, origins: Array, directions: Array, number: Ints, longest: float) -> tuple[Array, Ints, Array]:
        """As ``shoot``, but for the ``number``-th (R,) exit of each ray from the surface; entries are skipped.

        The distance is inf where there is no such exit within ``longest``.
        """
        distance, found = np.full(len(origins), np.inf), np.zeros(len(origins), dtype=np.int64)
        slope, still, wanted = np.zeros(len(origins)), np.array(number), np.ones(len(origins), dtype=bool)
        for live, at, triangle, cosine in self.crossings(origins, directions, longest, wanted):
            still[live] -= cosine > 0
            last = still[live] == 0
            wanted[live[last]] = False
            distance[live[last]], found[live[last]], slope[live[last]] = at[last], triangle[last], cosine[last]
        return distance, found, slope

    def stays_white(self, origins: Array, directions: Array, lengths: Array, slack: float) -> Bools:
        """True (R,) where no stretch between leaving this surface and entering it again is longer than ``slack``."""
        good, left = np.ones(len(origins), dtype=bool), np.full(len(origins), np.nan)
        wanted = good.copy()
        for live, at, _, cosine in self.crossings(origins, directions, lengths, wanted):
            leaving = cosine > 0
            out = live[~leaving & (at - left[live] > slack)]
            good[out], wanted[out] = False, False
            left[live[leaving]] = at[leaving]
        return good
