"""Patches of a tetrahedral mesh: groups of up to six tetrahedra of one material that share faces.

A single linear tetrahedron is too stiff; six of them with one pressure and one mean gradient behave like a brick. If a
mesh was made from bricks, each split into six around a diagonal, the patches are the bricks. In other meshes they grow
greedily: from the tetrahedron with the fewest free neighbours, by the neighbour that adds the fewest new nodes, else by
the one with the fewest free neighbours, else by the nearest. Nothing is random. Most patches have five or six.
"""

import heapq

import numpy as np
from skfem import MeshTet

from morphofold.frozen_arrays import Array, Ints
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
    patch, n_rings = _ring_patches(mesh, X, material)
    across = mesh.f2t[:, mesh.t2f].sum(axis=0) - np.arange(mesh.nelements)  # the other tetrahedron at a face
    across[material[across] != material] = -1  # also -1, at the boundary
    tets = np.ascontiguousarray(mesh.t.T)
    across = np.ascontiguousarray(across.T)
    free_neighbours = ((across >= 0) & (patch[across] < 0)).sum(axis=1)  # neighbours without a patch
    n_patches = _grow_patches(tets, across, X[tets].mean(axis=1), patch, free_neighbours, n_rings)
    order = np.argsort(patch, kind="stable")
    sizes = np.bincount(patch, minlength=n_patches)
    patches = np.full((n_patches, PATCH_TETS), -1)
    patches[patch[order], np.arange(mesh.nelements) - np.repeat(np.cumsum(sizes) - sizes, sizes)] = order
    lowest_node = tets.min(axis=1)[patches].min(axis=1, where=patches >= 0, initial=len(X))
    return patches[np.argsort(lowest_node, kind="stable")]


def _ring_patches(mesh: MeshTet, X: Array, material: Ints) -> tuple[Ints, int]:
    """Patch of each tetrahedron, -1 for none yet, and the number of patches: rings of six around their longest edge.

    Only inner edges with six tetrahedra around them count. Each tetrahedron chooses its longest one. If all six choose
    the same edge, they form a patch. In a brick split along its diagonal this edge is the diagonal.
    """
    a, b = mesh.edges
    n_edges = len(a)
    tets_around = np.bincount(mesh.t2e.ravel(), minlength=n_edges)
    tets_around[mesh.boundary_edges()] = 0  # six at the boundary form a fan of nine nodes, not a ring
    ring_edge_length = np.where(tets_around == PATCH_TETS, np.linalg.norm(X[a] - X[b], axis=1), 0.0)
    longest_edge = np.take_along_axis(mesh.t2e, ring_edge_length[mesh.t2e].argmax(axis=0)[None], axis=0)[0]
    lowest_material, highest_material = np.full(n_edges, material.max()), np.full(n_edges, material.min())
    np.minimum.at(lowest_material, longest_edge, material)
    np.maximum.at(highest_material, longest_edge, material)
    n_choosing = np.bincount(longest_edge, minlength=n_edges)
    is_ring = (tets_around == PATCH_TETS) & (n_choosing == PATCH_TETS) & (lowest_material == highest_material)
    return np.where(is_ring, np.cumsum(is_ring) - 1, -1)[longest_edge], int(is_ring.sum())


@kernel
def _shared_corner_count(nodes, n_nodes, tet):
    """Number of corners of ``tet`` among the first ``n_nodes`` of ``nodes``."""
    n_shared = 0
    for c in range(4):
        for k in range(n_nodes):
            n_shared += nodes[k] == tet[c]
    return n_shared


@kernel
def _best_neighbour(tets, across, centre, patch, free_neighbours, members, n_members, nodes, n_nodes):
    """The neighbour by which a patch should grow, or -1."""
    best_tet, best_rank = -1, (0, 0, 0.0, 0)
    middle = np.zeros(3)
    for k in range(n_members):
        middle += centre[members[k]] / n_members
    for k in range(n_members):
        for i in range(4):
            e = across[members[k], i]
            if e < 0 or patch[e] >= 0:
                continue
            n_shared = _shared_corner_count(nodes, n_nodes, tets[e])
            if n_nodes + 4 - n_shared > PATCH_NODES:
                continue
            far = (centre[e, 0] - middle[0]) ** 2 + (centre[e, 1] - middle[1]) ** 2 + (centre[e, 2] - middle[2]) ** 2
            rank = (4 - n_shared, free_neighbours[e], far, e)
            if best_tet < 0 or rank < best_rank:
                best_tet, best_rank = e, rank
    return best_tet


@kernel
def _grow_patches(tets, across, centre, patch, free_neighbours, n_patches):
    """Assign a patch to each tetrahedron without one, numbered from ``n_patches``; returns the number of patches."""
    heap = [(free_neighbours[tet], tet) for tet in range(len(tets)) if patch[tet] < 0]
    heapq.heapify(heap)
    members, nodes = np.empty(PATCH_TETS, np.int64), np.empty(PATCH_NODES, np.int64)
    while len(heap):
        n_free, tet = heapq.heappop(heap)
        if patch[tet] >= 0 or n_free != free_neighbours[tet]:  # an entry that is out of date
            continue
        n_members, n_nodes = 0, 0
        while tet >= 0:
            patch[tet], members[n_members] = n_patches, tet
            n_members += 1
            for n in tets[tet]:
                if not (nodes[:n_nodes] == n).any():
                    nodes[n_nodes] = n
                    n_nodes += 1
            for i in range(4):
                neighbour = across[tet, i]
                if neighbour >= 0:
                    free_neighbours[neighbour] -= 1
                    if patch[neighbour] < 0:
                        heapq.heappush(heap, (free_neighbours[neighbour], neighbour))
            if n_members == PATCH_TETS:
                break
            tet = _best_neighbour(tets, across, centre, patch, free_neighbours, members, n_members, nodes, n_nodes)
        n_patches += 1
    return n_patches
