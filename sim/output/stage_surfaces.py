"""Closed pial and white surfaces of the deformed body: quads are split along the best diagonals, parts mirrored."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from morphofold.frozen_arrays import Array
from morphofold.geometry import cross, dot, less, position
from morphofold.io import write_annotation, write_label, write_surface
from morphofold.kernels import kernel
from morphofold.sim.body import Body
from morphofold.sim.mesh.brick_mesh import Whole, mirror
from morphofold.sim.mesh.quad_coarsening import quad_neighbours
from morphofold.surface import Surface

MOST_SWEEPS = 8
SPHERE_RADIUS_MM = 100.0  # of the spheres that FreeSurfer writes

# Corner opposite to side s (from corner s to s + 1) in the triangle of that side, for diagonals 0-2 and 1-3
_OPPOSITE_CORNER = np.array([[2, 0, 0, 2], [3, 3, 1, 1]])
_TRIANGLES = np.array([[[0, 1, 2], [0, 2, 3]], [[0, 1, 3], [1, 2, 3]]])  # of a quad with these diagonals


def whole_surfaces(body: Body, x: Array) -> tuple[Surface, Surface, NDArray[np.int64]]:
    """Closed white and pial surfaces of the body at positions ``x`` (N, 3), with the same faces [mm]; and for each
    vertex (V,) that of the simulated part of which it is the image.

    A part of a body is mirrored at its symmetry planes; both halves share the nodes on a plane. Each quad is split
    along the diagonal that bends the pial surface least (see :func:`smooth_diagonals`). A fixed diagonal would make
    saw-teeth on walls that run along the other diagonal.
    """
    bilayer, n_surface = body.bilayer, body.n_surface
    faces = bilayer.faces if bilayer.faces.shape[1] == 3 else smooth_diagonals(x[:n_surface], bilayer.faces)
    whole_mesh = _whole(body, faces)
    white, pial = (
        Surface(whole_mesh.positions(part_verts), whole_mesh.faces, name=f"{bilayer.hemi}.{name}")
        for name, part_verts in (("white", np.asarray(bilayer.white @ x)), ("pial", x[:n_surface]))
    )
    return white, pial, whole_mesh.node


def _whole(body: Body, faces: NDArray[np.int64]) -> Whole:
    """The vertices and faces of the whole surfaces, from faces of the part that is simulated."""
    planes = [plane for plane in body.bilayer.planes if plane.axis in body.bilayer.mirrored]
    return mirror(faces, body.on_plane[: body.n_surface], planes)


def write_labels(folder: Path, body: Body, white: Surface) -> None:
    """Write what is known of the vertices of a stage with the surface ``white``: ``surf/?h.sphere``,
    ``label/?h.aparc.annot``, ``label/?h.cortex.label``."""
    bilayer, hemi = body.bilayer, body.bilayer.hemi
    whole_mesh = _whole(body, bilayer.faces)
    if bilayer.sphere is not None:
        points = SPHERE_RADIUS_MM * bilayer.sphere[whole_mesh.node] * whole_mesh.sign
        write_surface(folder / "surf" / f"{hemi}.sphere", Surface(points, white.faces, name=f"{hemi}.sphere"))
    label_folder = folder / "label"
    if bilayer.regions is not None:
        label_folder.mkdir()
        regions = replace(bilayer.regions, labels=bilayer.regions.labels[whole_mesh.node])
        write_annotation(label_folder / f"{hemi}.aparc.annot", regions)
    if bilayer.cortex is not None:
        label_folder.mkdir(exist_ok=True)
        write_label(label_folder / f"{hemi}.cortex.label", bilayer.cortex[whole_mesh.node], white.verts)


def smooth_diagonals(x: Array, quads: NDArray[np.int64]) -> NDArray[np.int64]:
    """Split quads (Q, 4) into triangles (2 Q, 3) along the diagonals that bend the surface least.

    Each quad takes the diagonal with the smaller sum of squared dihedral angles over the diagonal and its four sides,
    for the present choice of its neighbours. Sweeps in a fixed order repeat until nothing changes, at most eight times.
    """
    diagonals = np.zeros(len(quads), dtype=np.int64)
    _choose_diagonals(x, quads, quad_neighbours(quads, int(quads.max()) + 1), diagonals, _OPPOSITE_CORNER)
    triangles = np.take_along_axis(quads[:, None], _TRIANGLES[diagonals], axis=2)
    return np.concatenate([triangles[:, 0], triangles[:, 1]])


@kernel
def _squared_dihedral_angle(p, q, left, right):
    """Squared dihedral angle at edge pq between the triangles to its left and right, 0 if flat."""
    edge = less(q, p)
    n_left, n_right = cross(edge, less(left, p)), cross(less(right, p), edge)
    return math.atan2(dot(cross(n_left, n_right), edge) / math.sqrt(dot(edge, edge)), dot(n_left, n_right)) ** 2


@kernel
def _choose_diagonals(x, quads, neighbour_side, diagonals, opposite_corner):
    cost = np.empty(2)
    for _ in range(MOST_SWEEPS):
        n_changed = 0
        for quad in range(len(quads)):
            node = quads[quad]
            p0, p1, p2, p3 = position(x, node[0]), position(x, node[1]), position(x, node[2]), position(x, node[3])
            cost[0], cost[1] = _squared_dihedral_angle(p0, p2, p3, p1), _squared_dihedral_angle(p1, p3, p0, p2)
            for side in range(4):
                if neighbour_side[quad, side] < 0:
                    continue
                neighbour, other_side = neighbour_side[quad, side] // 4, neighbour_side[quad, side] % 4
                far_vertex = quads[neighbour][opposite_corner[diagonals[neighbour], other_side]]
                p, p_next, p_far = position(x, node[side]), position(x, node[(side + 1) % 4]), position(x, far_vertex)
                for d in range(2):
                    cost[d] += _squared_dihedral_angle(p, p_next, position(x, node[opposite_corner[d, side]]), p_far)
            best_diagonal = 1 if cost[1] < cost[0] else 0
            n_changed += best_diagonal != diagonals[quad]
            diagonals[quad] = best_diagonal
        if n_changed == 0:
            break
