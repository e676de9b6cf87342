"""Patches of a tetrahedral mesh: groups of up to six tetrahedra of one material that share faces.

A single linear tetrahedron is too stiff; six of them with one pressure and one mean gradient behave like a brick. If a
mesh was made from bricks, each split into six around a diagonal, the patches are the bricks. In other meshes they grow
greedily: from the tetrahedron with the fewest free neighbours, by the neighbour that adds the fewest new nodes, else by
the one with the fewest free neighbours, else by the nearest. Nothing is random. Most patches have five or six.
"""

import heapq

import numpy as np
from skfem import MeshTet

from morphofold.arrays import Array, Ints
from morphofold.kernels import kernel
from morphofold.sim.elements.tet_kernels import PATCH_NODES, PATCH_TETS


def cluster(mesh: MeshTet, X: Array, material: Ints) -> Ints:
    """Group tetrahedra into patches of at most 6 with at most 8 nodes.

    Parameters
    ----------
    mesh : skfem.MeshTet
    X : (N, 3) float64
        Positions of its nodes.
    material : (E,) int
        Only tetrahedra of the same number share a patch.

    Returns
    -------
    patches : (P, 6) int
        Tetrahedra of each patch, -1 where it has fewer; every tetrahedron is in one patch. Patches are ordered by their
        lowest node, so neighbours have close numbers if their nodes have.
    """
    patch, rings = _ring_patches(mesh, X, material)
    across = mesh.f2t[:, mesh.t2f].sum(axis=0) - np.arange(mesh.nelements)  # the other tetrahedron at a face
    across[material[across] != material] = -1  # also -1, at the boundary
    tets = np.ascontiguousarray(mesh.t.T)
    across = np.ascontiguousarray(across.T)
    free = ((across >= 0) & (patch[across] < 0)).sum(axis=1)  # neighbours without a patch
    count = _grow_patches(tets, across, X[tets].mean(axis=1), patch, free, rings)
    order = np.argsort(patch, kind="stable")
    size = np.bincount(patch, minlength=count)
    patches = np.full((count, PATCH_TETS), -1)
    patches[patch[order], np.arange(mesh.nelements) - np.repeat(np.cumsum(size) - size, size)] = order
    lowest = tets.min(axis=1)[patches].min(axis=1, where=patches >= 0, initial=len(X))
    return patches[np.argsort(lowest, kind="stable")]


def _ring_patches(mesh: MeshTet, X: Array, material: Ints) -> tuple[Ints, int]:
    """Patch of each tetrahedron, -1 for none yet, and the number of patches: rings of six around their longest edge.

    Only inner edges with six tetrahedra around them count. Each tetrahedron chooses its longest one. If all six choose
    the same edge, they form a patch. In a brick split along its diagonal this edge is the diagonal.
    """
    a, b = mesh.edges
    count = len(a)
    around = np.bincount(mesh.t2e.ravel(), minlength=count)
    around[mesh.boundary_edges()] = 0  # six at the boundary form a fan of nine nodes, not a ring
    length = np.where(around == PATCH_TETS, np.linalg.norm(X[a] - X[b], axis=1), 0.0)
    longest = np.take_along_axis(mesh.t2e, length[mesh.t2e].argmax(axis=0)[None], axis=0)[0]
    lowest, highest = np.full(count, material.max()), np.full(count, material.min())
    np.minimum.at(lowest, longest, material)
    np.maximum.at(highest, longest, material)
    named = np.bincount(longest, minlength=count)
    ring = (around == PATCH_TETS) & (named == PATCH_TETS) & (lowest == highest)
    return np.where(ring, np.cumsum(ring) - 1, -1)[longest], int(ring.sum())


@kernel
def _shared_corner_count(nodes, count, tet):
    """Number of corners of ``tet`` among the first ``count`` of ``nodes``."""
    known = 0
    for c in range(4):
        for k in range(count):
            known += nodes[k] == tet[c]
    return known


@kernel
def _best_neighbour(tets, across, centre, patch, free, members, size, nodes, count):
    """The neighbour by which a patch should grow, or -1."""
    best, score = -1, (0, 0, 0.0, 0)
    middle = np.zeros(3)
    for k in range(size):
        middle += centre[members[k]] / size
    for k in range(size):
        for i in range(4):
            e = across[members[k], i]
            if e < 0 or patch[e] >= 0:
                continue
            known = _shared_corner_count(nodes, count, tets[e])
            if count + 4 - known > PATCH_NODES:
                continue
            far = (centre[e, 0] - middle[0]) ** 2 + (centre[e, 1] - middle[1]) ** 2 + (centre[e, 2] - middle[2]) ** 2
            rank = (4 - known, free[e], far, e)
            if best < 0 or rank < score:
                best, score = e, rank
    return best


@kernel
def _grow_patches(tets, across, centre, patch, free, count):
    """Assign a patch to each tetrahedron without one, numbered from ``count``; returns the number of patches."""
    heap = [(free[e], e) for e in range(len(tets)) if patch[e] < 0]
    heapq.heapify(heap)
    members, nodes = np.empty(PATCH_TETS, np.int64), np.empty(PATCH_NODES, np.int64)
    while len(heap):
        f, e = heapq.heappop(heap)
        if patch[e] >= 0 or f != free[e]:  # an entry that is out of date
            continue
        size, known = 0, 0
        while e >= 0:
            patch[e], members[size] = count, e
            size += 1
            for n in tets[e]:
                if not (nodes[:known] == n).any():
                    nodes[known] = n
                    known += 1
            for i in range(4):
                o = across[e, i]
                if o >= 0:
                    free[o] -= 1
                    if patch[o] < 0:
                        heapq.heappush(heap, (free[o], o))
            if size == PATCH_TETS:
                break
            e = _best_neighbour(tets, across, centre, patch, free, members, size, nodes, known)
        count += 1
    return count
