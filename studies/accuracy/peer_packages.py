"""Curvatures and closest points of other packages on the same arrays: used if installed, never required."""

import importlib.util
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from morphofold.geometry import mean_edge_length
from morphofold.surface import Faces, PerVertex, Verts

H, K = "mean curvature", "Gaussian curvature"
LAPY_FACTOR = 2 * 3**0.5  # mean curvature of a sphere in LaPy's unit, times the mean edge


class Peer(NamedTuple):
    """A function of another package.

    Attributes
    ----------
    name : str
        The package and the called function, such as ``"libigl principal_curvature, 3 rings"``.
    packages : tuple of str
        Packages that must be importable.
    call : callable
        For curvature, ``call(verts, faces)`` gives fields (N,) by quantity: mean curvature [1/mm] and, if the package
        has it, Gaussian [1/mm^2], convex positive. For closest points, ``call(points, verts, faces)`` gives distances
        (P,) [mm].
    reach : float
        Size of the neighbourhood, in mean edges; 1 for one ring.
    most_vertices : int
        Largest number of vertices; beyond it, the call would take minutes.
    """

    name: str
    packages: tuple[str, ...]
    call: Callable[..., Any]
    reach: float = 1.0
    most_vertices: int = 1_000_000


def present(peers: Iterable[Peer]) -> list[Peer]:
    """The peers whose packages are all installed."""
    return [peer for peer in peers if all(importlib.util.find_spec(package) is not None for package in peer.packages)]


def curvature_peers() -> list[Peer]:
    """The installed peers: libigl over several rings, trimesh within two balls, VTK and LaPy over one ring."""
    ring_peers = [
        Peer(f"libigl principal_curvature, {n} rings", ("igl",), lambda verts, faces, n=n: _libigl(verts, faces, n), n)
        for n in (2, 3, 4, 5, 8)
    ]
    ball_peers = [
        Peer(
            f"trimesh discrete_mean_curvature_measure, {n} edges",
            ("trimesh", "rtree"),
            lambda verts, faces, n=n: _trimesh(verts, faces, n),
            n,
            most_vertices=50_000,
        )
        for n in (2, 3)
    ]
    return present(
        [
            *ring_peers,
            *ball_peers,
            Peer("pyvista curvature", ("pyvista",), _pyvista),
            Peer("LaPy TriaMesh.curvature, unit turned to 1/mm", ("lapy",), _lapy),
        ]
    )


def closest_peers() -> list[Peer]:
    """The installed peers: exact closest points of libigl, VTK and trimesh, and the nearest vertex by scipy."""
    return present(
        [
            Peer("libigl point_mesh_squared_distance", ("igl",), _libigl_closest),
            Peer("scipy cKDTree of vertices", ("scipy",), _scipy_closest),
            Peer("pyvista find_closest_cell", ("pyvista",), _pyvista_closest),
            Peer("trimesh closest_point", ("trimesh", "rtree"), _trimesh_closest, most_vertices=3_000),
        ]
    )


def _libigl(verts: Verts, faces: Faces, n_rings: int) -> dict[str, PerVertex]:
    import igl

    k1, k2 = igl.principal_curvature(verts, faces, n_rings, True)[2:4]
    return {H: (k1 + k2) / 2, K: k1 * k2}


def _trimesh(verts: Verts, faces: Faces, n_edges: int) -> dict[str, PerVertex]:
    """trimesh integrates the mean curvature within a ball of radius r, which holds pi r^2 of any sphere."""
    import trimesh

    radius = n_edges * mean_edge_length(verts, faces)
    mesh = trimesh.Trimesh(verts, faces, process=False)
    return {H: trimesh.curvature.discrete_mean_curvature_measure(mesh, verts, radius) / (np.pi * radius**2)}


def _pyvista(verts: Verts, faces: Faces) -> dict[str, PerVertex]:
    import pyvista

    mesh = pyvista.PolyData.from_regular_faces(verts, faces.astype(int))
    return {H: mesh.curvature("mean"), K: mesh.curvature("gaussian")}


def _lapy(verts: Verts, faces: Faces) -> dict[str, PerVertex]:
    """The tensor of LaPy is the mean over the edges of a vertex of the dihedral angle times the edge in mean edges,
    without the area. For equilateral triangles the angles are edge / (sqrt(3) r), so a sphere has
    ``mean edge / (2 sqrt(3) r)``. Concave is positive. LaPy smooths by default; this is off, because it blurs."""
    import lapy

    unit_factor = -LAPY_FACTOR / mean_edge_length(verts, faces)
    k1, k2 = (unit_factor * principal for principal in lapy.TriaMesh(verts, faces).curvature(smoothit=0)[2:4])
    return {H: (k1 + k2) / 2, K: k1 * k2}


def _libigl_closest(points: Verts, verts: Verts, faces: Faces) -> NDArray[np.float64]:
    import igl

    return np.sqrt(igl.point_mesh_squared_distance(points, verts, faces)[0])


def _scipy_closest(points: Verts, verts: Verts, faces: Faces) -> NDArray[np.float64]:
    from scipy.spatial import cKDTree

    return np.asarray(cKDTree(verts).query(points)[0])


def _pyvista_closest(points: Verts, verts: Verts, faces: Faces) -> NDArray[np.float64]:
    import pyvista

    mesh = pyvista.PolyData.from_regular_faces(verts, faces.astype(int))
    return np.linalg.norm(mesh.find_closest_cell(points, return_closest_point=True)[1] - points, axis=1)


def _trimesh_closest(points: Verts, verts: Verts, faces: Faces) -> NDArray[np.float64]:
    import trimesh

    return np.asarray(trimesh.Trimesh(verts, faces, process=False).nearest.on_surface(points)[1])
