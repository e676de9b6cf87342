"""Rays against a surface: what they hit first, and whether they stay inside."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from morphofold.analysis import _mesh
from morphofold.surface import Surface


class Scanner:
    """First hits of rays on a surface (embree finds the triangle in single, we the place in double precision)."""

    def __init__(self, surface: Surface) -> None:
        try:
            from embreex.mesh_construction import TriangleMesh
            from embreex.rtcore_scene import EmbreeScene
        except ImportError as error:
            raise ImportError("gyral thickness casts rays with embree; it is missing: pip install embreex") from error
        self.verts, self.faces = surface.verts, surface.faces
        self.normals = _mesh.face_normals(surface.verts, surface.faces)
        self.edge = _mesh.mean_edge_length(surface.verts, surface.faces)
        self._origin, self._unit = surface.verts.mean(axis=0), float(np.ptp(surface.verts, axis=0).max())
        self._scene = EmbreeScene()
        TriangleMesh(self._scene, self._scaled(surface.verts), surface.faces.astype(np.int32))

    def _scaled(self, points: NDArray[np.float64]) -> NDArray[np.float32]:
        """Around 0 and of size 1, whatever the unit and place: embree's tolerances are absolute."""
        return ((points - self._origin) / self._unit).astype(np.float32)

    def shoot(
        self, origins: NDArray[np.float64], directions: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.float64]]:
        """Distance (R,) of the first hit (inf: none), its triangle (R,), cosine of ray and outward normal (R,)."""
        triangle = np.asarray(self._scene.run(self._scaled(origins), directions.astype(np.float32)), dtype=np.int64)
        normal = self.normals[triangle]
        cosine = np.sum(normal * directions, axis=1)
        ahead = np.sum((self.verts[self.faces[triangle, 0]] - origins) * normal, axis=1)
        hit = (triangle >= 0) & (np.abs(cosine) > 1e-6)
        return np.divide(ahead, cosine, out=np.full(len(origins), np.inf), where=hit), triangle, cosine

    def stays_white(
        self, origins: NDArray[np.float64], directions: NDArray[np.float64], lengths: NDArray[np.float64], slack: float
    ) -> NDArray[np.bool_]:
        """True (R,) where no stretch between leaving this surface and entering it again is longer than slack."""
        good = np.ones(len(origins), dtype=bool)
        live, gone, left = np.arange(len(origins)), np.zeros(len(origins)), np.full(len(origins), np.nan)
        for _ in range(32):                     # who grazes more often is judged by what it did so far
            far, _, cosine = self.shoot(origins[live] + gone[live, None] * directions[live], directions[live])
            at = gone[live] + np.maximum(far, 0)
            within, leaving = at < lengths[live], cosine > 0
            good[live[within & ~leaving & (at - left[live] > slack)]] = False
            left[live[leaving]] = at[leaving]
            gone[live] = at + 1e-3 * self.edge
            live = live[within & good[live]]
            if not len(live):
                break
        return good
