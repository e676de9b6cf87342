"""Nets of great arcs on a sphere: known ones, and random ones of given density."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import SphericalVoronoi

from morphofold.errors import NoSolution
from morphofold.frozen_arrays import Array, Ints


@dataclass(frozen=True, eq=False)
class SphericalNet:
    """Unit directions of the nodes (K, 3), and pairs of nodes (A, 2) joined by arcs of great circles."""

    nodes: Array
    arcs: Ints

    @property
    def degree(self) -> Ints:
        """Number of arcs at each node (K,)."""
        return np.bincount(self.arcs.ravel(), minlength=len(self.nodes))

    @property
    def lengths(self) -> Array:
        """Angles of the arcs (A,) [rad]."""
        return np.arccos(np.clip(np.sum(self.nodes[self.arcs[:, 0]] * self.nodes[self.arcs[:, 1]], axis=1), -1, 1))

    def rotated(self, rotation: Array) -> "SphericalNet":
        """The net rotated by a matrix (3, 3)."""
        return SphericalNet(self.nodes @ rotation.T, self.arcs)


def irregular_net(n_cells: int, seed: int = 0, *, shortest: float = 0.0, n_rounds: int = 3) -> SphericalNet:
    """Borders of the Voronoi cells of random points, 2 ``n_cells`` - 4 nodes of degree 3.

    The points move to the middle of their cells ``n_rounds`` times. They are drawn again, with the next seed, until no
    arc is shorter than ``shortest`` [rad].

    Raises
    ------
    NoSolution
        If all of 200 seeds give a shorter arc.
    """
    for n_failed in range(200):
        points = np.random.default_rng(seed + n_failed).standard_normal((n_cells, 3))
        for _ in range(n_rounds + 1):
            points /= np.linalg.norm(points, axis=1, keepdims=True)
            diagram = SphericalVoronoi(points)
            diagram.sort_vertices_of_regions()
            points = np.array([diagram.vertices[region].mean(axis=0) for region in diagram.regions])
        arcs = {tuple(sorted(pair)) for region in diagram.regions for pair in zip(region, np.roll(region, 1).tolist())}
        net = SphericalNet(diagram.vertices, np.array(sorted(arcs)))
        if net.lengths.min() >= shortest:
            return net
    raise NoSolution(f"200 nets of {n_cells} cells have arcs shorter than {shortest:g} rad; use a smaller length.")
