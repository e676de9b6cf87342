"""Other people's curvatures and closest points, on the same arrays: found where they are installed, never required."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from morphofold.geometry import mean_edge_length
from morphofold.surface import Faces, PerVertex, Verts

H, K = "mean curvature", "Gaussian curvature"
EQUILATERAL = 2 * 3**0.5  # mean curvature of a sphere in LaPy's unit, times the mean edge


class Peer(NamedTuple):
    """A function of another package.

    Attributes
    ----------
    name : str
        The package and what is called, such as ``"libigl principal_curvature, 3 rings"``.
    packages : tuple of str
        What must be importable.
    call : callable
        Of curvature: ``call(verts, faces)`` gives fields (N,) by their quantity, mean curvature [1/mm] and, where the
        package has it, Gaussian [1/mm^2], convex positive. Of closest points: ``call(points, verts, faces)`` gives
        distances (P,) [mm].
    reach : float
        Of a neighbourhood, in mean edges; 1 for one ring.
    most : int
        Vertices beyond which it would take minutes.
    """

    name: str
    packages: tuple[str, ...]
    call: Callable[..., Any]
    reach: float = 1.0
    most: int = 1_000_000


def present(peers: Iterable[Peer]) -> list[Peer]:
    """Those whose packages are all installed."""
    return [p for p in peers if all(importlib.util.find_spec(package) is not None for package in p.packages)]


def curvature_peers() -> list[Peer]:
    """Those that are installed: libigl over several rings, trimesh within two balls, VTK and LaPy of one ring."""
    rings = [
        Peer(f"libigl principal_curvature, {k} rings", ("igl",), lambda v, f, k=k: _libigl(v, f, k), k)
        for k in (2, 3, 4, 5, 8)
    ]
    balls = [
        Peer(
            f"trimesh discrete_mean_curvature_measure, {k} edges",
            ("trimesh", "rtree"),
            lambda v, f, k=k: _trimesh(v, f, k),
            k,
            most=50_000,
        )
        for k in (2, 3)
    ]
    return present(
        [
            *rings,
            *balls,
            Peer("pyvista curvature", ("pyvista",), _pyvista),
            Peer("LaPy TriaMesh.curvature, unit turned to 1/mm", ("lapy",), _lapy),
        ]
    )


def closest_peers() -> list[Peer]:
    """Those that are installed: exact ones of libigl, VTK and trimesh, and the nearest vertex by scipy."""
    return present(
        [
            Peer("libigl point_mesh_squared_distance", ("igl",), _libigl_closest),
            Peer("scipy cKDTree of vertices", ("scipy",), _scipy_closest),
            Peer("pyvista find_closest_cell", ("pyvista",), _pyvista_closest),
            Peer("trimesh closest_point", ("trimesh", "rtree"), _trimesh_closest, most=3_000),
        ]
    )


def _libigl(verts: Verts, faces: Faces, rings: int) -> dict[str, PerVertex]:
    import igl

    k1, k2 = igl.principal_curvature(verts, faces, rings, True)[2:4]
    return {H: (k1 + k2) / 2, K: k1 * k2}


def _trimesh(verts: Verts, faces: Faces, edges: int) -> dict[str, PerVertex]:
    """Its measure is the integral of mean curvature in a ball, of which a sphere of any radius holds pi r^2."""
    import trimesh

    radius = edges * mean_edge_length(verts, faces)
    mesh = trimesh.Trimesh(verts, faces, process=False)
    return {H: trimesh.curvature.discrete_mean_curvature_measure(mesh, verts, radius) / (np.pi * radius**2)}


def _pyvista(verts: Verts, faces: Faces) -> dict[str, PerVertex]:
    import pyvista

    mesh = pyvista.PolyData.from_regular_faces(verts, faces.astype(int))
    return {H: mesh.curvature("mean"), K: mesh.curvature("gaussian")}


def _lapy(verts: Verts, faces: Faces) -> dict[str, PerVertex]:
    """Its tensor is the mean over the edges of a vertex of the angle at each, times the edge in mean edges, no matter
    how much area they bound: dihedral angles are edge / (sqrt(3) r) where triangles are equilateral, so that a sphere
    has ``mean edge / (2 sqrt(3) r)``. Concave positive. Not smoothed, which is its default, since it smears."""
    import lapy

    turned = -EQUILATERAL / mean_edge_length(verts, faces)
    k1, k2 = (turned * k for k in lapy.TriaMesh(verts, faces).curvature(smoothit=0)[2:4])
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
