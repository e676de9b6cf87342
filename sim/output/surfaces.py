"""Closed pial and white surfaces of the deformed body: quads are split along the best diagonals, parts mirrored."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from morphofold.arrays import Array, Ints
from morphofold.io import write_annotation, write_label, write_surface
from morphofold.sim.body import Body
from morphofold.surface import Surface

MOST_SWEEPS = 8
SPHERE_RADIUS_MM = 100.0  # of the spheres that FreeSurfer writes

# Corner opposite to side s (from corner s to s + 1) in the triangle of that side, for diagonals 0-2 and 1-3
_OPPOSITE_CORNER = np.array([[2, 0, 0, 2], [3, 3, 1, 1]])


class Whole(NamedTuple):
    """Vertices of the closed surfaces: the pial node of each (V,), and the signs of its coordinates (V, 3)."""

    node: Ints
    sign: Array


def whole_surfaces(body: Body, x: Array) -> tuple[Surface, Surface]:
    """Closed white and pial surfaces of the body at positions ``x`` (N, 3), with the same faces [mm].

    A part of a sphere is mirrored at its symmetry planes; both halves share the nodes on a plane. Each quad is split
    along the diagonal that bends the pial surface least (see :func:`smooth_diagonals`). A fixed diagonal would make
    saw-teeth on walls that run along the other diagonal.
    """
    bilayer, n = body.bilayer, body.n_surface
    faces = bilayer.faces if bilayer.faces.shape[1] == 3 else smooth_diagonals(x[:n], bilayer.faces)
    whole, faces = _whole(body, faces)
    white, pial = (part[whole.node] * whole.sign for part in (np.asarray(bilayer.white @ x), x[:n]))
    return tuple(Surface(part, faces, name=f"{bilayer.hemi}.{name}") for part, name in ((white, "white"), (pial, "pial")))


def _whole(body: Body, faces: NDArray[np.int64]) -> tuple[Whole, NDArray[np.int64]]:
    """The vertices of the whole surfaces, and their faces, from those of the part that is simulated."""
    seam = body.on_plane[: body.n_surface]
    whole = Whole(np.arange(body.n_surface), np.ones((body.n_surface, 3)))
    for axis in body.bilayer.mirrored:
        count = len(whole.node)
        image = np.arange(count)
        off = np.flatnonzero(~seam[whole.node, axis])
        image[off] = count + np.arange(len(off))
        flipped = whole.sign[off] * np.where(np.arange(3) == axis, -1.0, 1.0)
        whole = Whole(np.concatenate([whole.node, whole.node[off]]), np.concatenate([whole.sign, flipped]))
        faces = np.concatenate([faces, image[faces][:, ::-1]])
    return whole, faces


def write_labels(folder: Path, body: Body, white: Surface) -> None:
    """Write what is known of the vertices of a stage with the surface ``white``: ``surf/?h.sphere``,
    ``label/?h.aparc.annot``, ``label/?h.cortex.label``."""
    bilayer, hemi = body.bilayer, body.bilayer.hemi
    whole, _ = _whole(body, bilayer.faces)
    if bilayer.sphere is not None:
        points = SPHERE_RADIUS_MM * bilayer.sphere[whole.node] * whole.sign
        write_surface(folder / "surf" / f"{hemi}.sphere", Surface(points, white.faces, name=f"{hemi}.sphere"))
    if bilayer.regions is None and bilayer.cortex is None:
        return
    (folder / "label").mkdir()
    if bilayer.regions is not None:
        regions = replace(bilayer.regions, labels=bilayer.regions.labels[whole.node])
        write_annotation(folder / "label" / f"{hemi}.aparc.annot", regions)
    if bilayer.cortex is not None:
        write_label(folder / "label" / f"{hemi}.cortex.label", bilayer.cortex[whole.node], white.verts)


def smooth_diagonals(x: Array, quads: NDArray[np.int64]) -> NDArray[np.int64]:
    """Split quads (Q, 4) into triangles (2 Q, 3) along the diagonals that bend the surface least.

    Each quad takes the diagonal with the smaller sum of squared dihedral angles over the diagonal and its four sides,
    for the present choice of its neighbours. Sweeps in a fixed order repeat until nothing changes, at most eight times.
    """
    a, b = quads, np.roll(quads, -1, axis=1)
    key = np.minimum(a, b) * (quads.max() + 1) + np.maximum(a, b)
    order = np.argsort(key.ravel(), kind="stable")
    other = np.full(quads.size, -1)
    same = np.flatnonzero(key.ravel()[order][1:] == key.ravel()[order][:-1])
    other[order[same]], other[order[same + 1]] = order[same + 1], order[same]
    choice = np.zeros(len(quads), dtype=np.int64)
    _choose_diagonals(x, quads, other.reshape(-1, 4), choice, _OPPOSITE_CORNER)
    first = np.where(choice[:, None] == 0, quads[:, [0, 1, 2]], quads[:, [0, 1, 3]])
    second = np.where(choice[:, None] == 0, quads[:, [0, 2, 3]], quads[:, [1, 2, 3]])
    return np.concatenate([first, second])


@njit(cache=True)
def _squared_dihedral_angle(p, q, left, right):
    """Squared dihedral angle at edge pq between the triangles to its left and right, 0 if flat."""
    e = q - p
    n = np.cross(e, left - p)
    m = np.cross(right - p, e)
    sine = np.dot(np.cross(n, m), e) / np.sqrt(np.dot(e, e))
    return np.arctan2(sine, np.dot(n, m)) ** 2


@njit(cache=True)
def _choose_diagonals(x, quads, other, choice, opposite):
    for _ in range(MOST_SWEEPS):
        changed = 0
        for q in range(len(quads)):
            c = quads[q]
            cost = np.zeros(2)
            cost[0] = _squared_dihedral_angle(x[c[0]], x[c[2]], x[c[3]], x[c[1]])
            cost[1] = _squared_dihedral_angle(x[c[1]], x[c[3]], x[c[0]], x[c[2]])
            for s in range(4):
                if other[q, s] < 0:
                    continue
                r, side = other[q, s] // 4, other[q, s] % 4
                beyond = quads[r][opposite[choice[r], side]]
                for d in range(2):
                    cost[d] += _squared_dihedral_angle(x[c[s]], x[c[(s + 1) % 4]], x[c[opposite[d, s]]], x[beyond])
            best = 1 if cost[1] < cost[0] else 0
            if best != choice[q]:
                choice[q] = best
                changed += 1
        if changed == 0:
            break
