"""Make hemisphere.vtu: a smooth hemisphere of fetal size in tetrahedra, from the pial surface of fsaverage5.

Run it in its own folder: python make.py. Seen from the middle, the farthest pial point in each direction is a radius;
spherical harmonics up to degree DEGREE of it, with the three axes made equal first, keep the shape of the hemisphere
and lose its folds.
"""

import meshio
import numpy as np
import trimesh
from scipy.spatial import ConvexHull
from scipy.special import sph_harm_y

import morphofold as mf
from morphofold.shapes import icosphere

DEGREE = 4
LENGTH = 70.0  # from front to back [mm], that of a hemisphere halfway through pregnancy or a little later
CORTEX = 1.6  # thickness [mm]
HOLLOW = 0.45, 0.6, 0.55  # size of the ventricle over that of the hemisphere, along each axis
VERTICES = 5500  # of the pial surface
CORE = np.cumsum([0.0, 1.0, 1.3, 1.5, 1.5]) / 5.3  # depths of the core's layers, as shares
ROUNDS = 300  # of moving each vertex to the middle of its neighbours along the surface


def even_sphere(n):
    """Points (n, 3) of a Fibonacci lattice on the unit sphere, and their Delaunay triangles seen from outside."""
    k = np.arange(n) + 0.5
    z, angle = 1 - 2 * k / n, np.pi * (1 + 5**0.5) * k
    verts = np.column_stack([np.sqrt(1 - z**2) * np.cos(angle), np.sqrt(1 - z**2) * np.sin(angle), z])
    faces = ConvexHull(verts).simplices
    inward = np.linalg.det(verts[faces]) < 0
    faces[inward] = faces[inward][:, ::-1]
    return verts, faces


def harmonics(directions):
    """Real spherical harmonics up to DEGREE at unit directions (P, 3), (P, (DEGREE + 1)^2)."""
    x, y, z = directions.T
    theta, phi = np.arccos(np.clip(z, -1, 1)), np.arctan2(y, x)
    return np.stack(
        [
            getattr(sph_harm_y(l, abs(m), theta, phi), "imag" if m < 0 else "real")
            for l in range(DEGREE + 1)
            for m in range(-l, l + 1)
        ],
        axis=1,
    )


def smooth_pial():
    """Function that gives the pial point (P, 3) in directions (P, 3), around the middle of the hemisphere [mm]."""
    surface = mf.read_surface(mf.sample_path("fsaverage5/surf/lh.pial"))
    low, high = surface.verts.min(axis=0), surface.verts.max(axis=0)
    axes, rays = (high - low) / 2, icosphere(5)[0]
    folded = trimesh.Trimesh((surface.verts - (low + high) / 2) / axes, surface.faces, process=False)
    at, ray, _ = folded.ray.intersects_location(np.zeros_like(rays), rays)
    farthest = np.zeros(len(rays))
    np.maximum.at(farthest, ray, np.linalg.norm(at, axis=1))
    weights = np.linalg.lstsq(harmonics(rays), farthest, rcond=None)[0]
    axes *= LENGTH / 2 / axes[1]

    def pial(directions):
        d = directions / axes
        d /= np.linalg.norm(d, axis=1, keepdims=True)
        return axes * d * (harmonics(d) @ weights)[:, None]

    return pial


def main():
    project, (at, faces) = smooth_pial(), even_sphere(VERTICES)
    ring = trimesh.Trimesh(at, faces, process=False).edges_sparse.astype(float)
    ring = ring.maximum(ring.T)
    pial = project(at)
    for _ in range(ROUNDS):
        pial = project(ring @ pial)  # a sum will do: only its direction counts
    normal = np.array(trimesh.Trimesh(pial, faces, process=False).vertex_normals)
    white = pial - CORTEX * normal
    hollow = pial * HOLLOW
    levels = [pial + s * (white - pial) for s in (0, 1 / 3, 2 / 3)] + [white + s * (hollow - white) for s in CORE]
    columns, S = np.sort(faces, axis=1).T, len(pial)  # prisms, cut by the order of their columns
    tets = []
    for k in range(len(levels) - 1):
        (a, b, c), (d, e, f) = columns + k * S, columns + (k + 1) * S
        tets += [np.stack(t, axis=1) for t in ((a, b, c, f), (a, b, e, f), (a, d, e, f))]
    corners = np.concatenate(levels)[np.concatenate(tets)]
    volume = np.linalg.det(corners[:, 1:] - corners[:, :1])
    cortex = np.arange(len(volume)) < 9 * len(faces)
    layered = [np.concatenate(tets).astype(np.int32)]
    layered[0][volume < 0] = layered[0][volume < 0][:, [1, 0, 2, 3]]
    meshio.Mesh(
        np.concatenate(levels).round(4).astype(np.float32),
        [("tetra", layered[0])],
        cell_data={"cortex": [cortex.astype(np.int8)]},
    ).write("hemisphere.vtu", compression="lzma")
    print(
        f"{len(volume):,} tetrahedra, {len(levels) * S:,} points, {np.ptp(pial, axis=0).round(1)} mm, "
        f"least volume {np.abs(volume).min() / 6:.3g} mm3"
    )


if __name__ == "__main__":
    main()
