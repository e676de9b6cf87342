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
    tet_across = mesh.f2t[:, mesh.t2f].sum(axis=0) - np.arange(mesh.nelements)  # the other tetrahedron at a face
    tet_across[material[tet_across] != material] = -1  # also -1, at the boundary
    tets = np.ascontiguousarray(mesh.t.T)
    tet_across = np.ascontiguousarray(tet_across.T)
    n_free = ((tet_across >= 0) & (patch[tet_across] < 0)).sum(axis=1)  # neighbours without a patch
    n_patches = _grow_patches(tets, tet_across, X[tets].mean(axis=1), patch, n_free, n_rings)
    tet_order = np.argsort(patch, kind="stable")
    sizes = np.bincount(patch, minlength=n_patches)
    patches = np.full((n_patches, PATCH_TETS), -1)
    patches[patch[tet_order], np.arange(mesh.nelements) - np.repeat(np.cumsum(sizes) - sizes, sizes)] = tet_order
    lowest_node = tets.min(axis=1)[patches].min(axis=1, where=patches >= 0, initial=len(X))
    return patches[np.argsort(lowest_node, kind="stable")]


def _ring_patches(mesh: MeshTet, X: Array, material: Ints) -> tuple[Ints, int]:
    """Patch of each tetrahedron, -1 for none yet, and the number of patches: rings of six around their longest edge.

    Only inner edges with six tetrahedra around them count. Each tetrahedron chooses its longest one. If all six choose
    the same edge, they form a patch. In a brick split along its diagonal this edge is the diagonal.
    """
    end0, end1 = mesh.edges
    n_edges = len(end0)
    n_around = np.bincount(mesh.t2e.ravel(), minlength=n_edges)
    n_around[mesh.boundary_edges()] = 0  # six at the boundary form a fan of nine nodes, not a ring
    ring_edge_length = np.where(n_around == PATCH_TETS, np.linalg.norm(X[end0] - X[end1], axis=1), 0.0)
    longest_edge = np.take_along_axis(mesh.t2e, ring_edge_length[mesh.t2e].argmax(axis=0)[None], axis=0)[0]
    lowest_material, highest_material = np.full(n_edges, material.max()), np.full(n_edges, material.min())
    np.minimum.at(lowest_material, longest_edge, material)
    np.maximum.at(highest_material, longest_edge, material)
    n_choosing = np.bincount(longest_edge, minlength=n_edges)
    is_ring = (n_around == PATCH_TETS) & (n_choosing == PATCH_TETS) & (lowest_material == highest_material)
    return np.where(is_ring, np.cumsum(is_ring) - 1, -1)[longest_edge], int(is_ring.sum())


@kernel
def _shared_corner_count(nodes, n_nodes, tet):
    """Number of corners of ``tet`` among the first ``n_nodes`` of ``nodes``."""
    n_shared = 0
    for corner in range(4):
        for i in range(n_nodes):
            n_shared += nodes[i] == tet[corner]
    return n_shared


@kernel
def _best_neighbour(tets, tet_across, centre, patch, n_free, members, n_members, nodes, n_nodes):
    """The neighbour by which a patch should grow, or -1."""
    best_tet, best_rank = -1, (0, 0, 0.0, 0)
    mean_x = np.zeros(3)
    for member in range(n_members):
        mean_x += centre[members[member]] / n_members
    for member in range(n_members):
        for face in range(4):
            e = tet_across[members[member], face]
            if e < 0 or patch[e] >= 0:
                continue
            n_shared = _shared_corner_count(nodes, n_nodes, tets[e])
            if n_nodes + 4 - n_shared > PATCH_NODES:
                continue
            dist2 = (centre[e, 0] - mean_x[0]) ** 2 + (centre[e, 1] - mean_x[1]) ** 2 + (centre[e, 2] - mean_x[2]) ** 2
            rank = (4 - n_shared, n_free[e], dist2, e)
            if best_tet < 0 or rank < best_rank:
                best_tet, best_rank = e, rank
    return best_tet


@kernel
def _grow_patches(tets, tet_across, centre, patch, n_free, n_patches):
    """Assign a patch to each tetrahedron without one, numbered from ``n_patches``; returns the number of patches."""
    heap = [(n_free[tet], tet) for tet in range(len(tets)) if patch[tet] < 0]
    heapq.heapify(heap)
    members, nodes = np.empty(PATCH_TETS, np.int64), np.empty(PATCH_NODES, np.int64)
    while len(heap):
        n_queued, tet = heapq.heappop(heap)
        if patch[tet] >= 0 or n_queued != n_free[tet]:  # an entry that is out of date
            continue
        n_members, n_nodes = 0, 0
        while tet >= 0:
            patch[tet], members[n_members] = n_patches, tet
            n_members += 1
            for node in tets[tet]:
                if not (nodes[:n_nodes] == node).any():
                    nodes[n_nodes] = node
                    n_nodes += 1
            for face in range(4):
                neighbour = tet_across[tet, face]
                if neighbour >= 0:
                    n_free[neighbour] -= 1
                    if patch[neighbour] < 0:
                        heapq.heappush(heap, (n_free[neighbour], neighbour))
            if n_members == PATCH_TETS:
                break
            tet = _best_neighbour(tets, tet_across, centre, patch, n_free, members, n_members, nodes, n_nodes)
        n_patches += 1
    return n_patches
