"""Other programs beside ours on the same large surfaces, in turn: time and error of the same quantity."""

import math
import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from morphofold import geometry
from morphofold.analysis.curvatures import curvature
from morphofold.analysis.shortest_paths import path_graph, shorten
from morphofold.analysis.thickness.cortical_thickness import cortical_thickness
from morphofold.io import read_morph, write_surface
from morphofold.progress_callbacks import Progress, logged
from morphofold.shapes import icosphere
from morphofold.studies.accuracy.error_points import OUR_CODE
from morphofold.studies.accuracy.measuring_errors import GAP, both_ways, parallel_pair, relative_rms
from morphofold.studies.accuracy.peer_packages import H, Peer, closest_peers, curvature_peers
from morphofold.studies.known_shapes import Shape, bumpy_sphere
from morphofold.surface import Faces, PerVertex, Surface, Verts

SPHERE_LEVEL = 7  # of the icosphere: 163,842 vertices
SCALES_IN_EDGES = (2.2, 3.0, 4.5)  # of our curvature
MOST_RINGS = 5  # of libigl's
SPHERE_RADIUS_MM = 50.0
WORKBENCH = "wb_command"


@dataclass(frozen=True)
class Runner:
    """A program that computes a quantity (N,), and the exact values, or None where it can only be timed."""

    quantity: str
    program: str
    compute: Callable[[], PerVertex]
    exact: PerVertex
    vertex_areas: PerVertex


def race(level: int = SPHERE_LEVEL, repeats: int = 3, progress: Progress = logged) -> list[dict[str, Any]]:
    """Times and errors of mean curvature, closest points (thickness) and geodesic distance.

    Parameters
    ----------
    level : int
        Of the icosphere from which the bodies are made; 7: 163,842 vertices.
    repeats : int
        Of each program, in turn, after one that compiles and loads.

    Returns
    -------
    list of dict
        ``quantity``, ``program`` (ours first), ``vertices``, median ``seconds``, and ``error``: area-weighted rms over
        the rms of the exact values. Workbench's seconds include starting it and reading its files.
    """
    with tempfile.TemporaryDirectory() as folder:
        runners = [*_curvatures(level, Path(folder)), *_thicknesses(level, Path(folder)), *_geodesics(level)]
        seconds = np.zeros((1 + repeats, len(runners)))
        errors = [math.nan] * len(runners)
        for repeat in range(1 + repeats):
            for k, runner in enumerate(runners):
                progress((repeat * len(runners) + k) / seconds.size, runner.program)
                began_at = time.perf_counter()
                computed = runner.compute()
                seconds[repeat, k] = time.perf_counter() - began_at
                errors[k] = relative_rms(computed, runner.exact, runner.vertex_areas)
    medians = np.median(seconds[1:], axis=0).tolist()
    return [
        {"quantity": run.quantity, "program": run.program, "vertices": len(run.exact), "seconds": median, "error": rms}
        for run, median, rms in zip(runners, medians, errors, strict=True)
    ]


def _curvatures(ico_level: int, gifti_folder: Path) -> Iterator[Runner]:
    body = bumpy_sphere(ico_level, radius=SPHERE_RADIUS_MM)
    make_runner = partial(Runner, H, exact=body.H, vertex_areas=geometry.vertex_areas(body.verts, body.faces))
    edge_length = geometry.mean_edge_length(body.verts, body.faces)
    for edge_scale in SCALES_IN_EDGES:
        yield make_runner(f"{OUR_CODE}, {edge_scale:g} edges", partial(_our_curvature, body, edge_scale * edge_length))
    for peer in curvature_peers():
        if peer.reach <= MOST_RINGS and len(body.verts) <= peer.most_vertices:
            yield make_runner(peer.name, partial(_peer_curvature, peer, body))
    if shutil.which(WORKBENCH):
        write_surface(gifti_folder / "shape.surf.gii", body.surface)
        yield make_runner(f"{WORKBENCH} -surface-curvature", partial(_workbench_curvature, gifti_folder))


def _our_curvature(body: Shape, scale: float) -> PerVertex:
    return curvature(body.verts, body.faces, scale).H


def _peer_curvature(peer: Peer, body: Shape) -> PerVertex:
    return np.asarray(peer.call(body.verts, body.faces)[H])


def _workbench_curvature(gifti_folder: Path) -> PerVertex:
    """Its sign is convex negative."""
    _workbench("-surface-curvature", gifti_folder / "shape.surf.gii", "-mean", gifti_folder / "mean.func.gii")
    mean_curvature = np.asarray(read_morph(gifti_folder / "mean.func.gii"), dtype=np.float64)
    return mean_curvature if np.mean(mean_curvature) > 0 else -mean_curvature


def _thicknesses(ico_level: int, gifti_folder: Path) -> Iterator[Runner]:
    white, pial = parallel_pair(ico_level)
    make_runner = partial(
        Runner,
        "cortical thickness",
        exact=np.full(len(pial.verts), GAP),
        vertex_areas=geometry.vertex_areas(pial.verts, pial.faces),
    )
    # surfaces that are new each time, so that nothing is kept from the time before
    yield make_runner(OUR_CODE, lambda: cortical_thickness(Surface(white.verts + 0.0, white.faces), pial))
    for peer in closest_peers():
        if len(pial.verts) <= peer.most_vertices:
            yield make_runner(peer.name, partial(both_ways, peer, white, pial))
    if shutil.which(WORKBENCH):
        for name, surface in (("white", white), ("pial", pial)):
            write_surface(gifti_folder / f"{name}.surf.gii", surface)
        yield make_runner(f"{WORKBENCH} -signed-distance-to-surface", partial(_workbench_thickness, gifti_folder))


def _workbench_thickness(gii_folder: Path) -> PerVertex:
    distances = []
    for start, target in (("white", "pial"), ("pial", "white")):
        distance_file = gii_folder / f"{start}.func.gii"
        _workbench(
            "-signed-distance-to-surface", *(gii_folder / f"{name}.surf.gii" for name in (start, target)), distance_file
        )
        distances.append(np.abs(np.asarray(read_morph(distance_file), dtype=np.float64)))
    return (distances[0] + distances[1]) / 2


def _geodesics(ico_level: int) -> Iterator[Runner]:
    verts, faces = icosphere(ico_level, radius=SPHERE_RADIUS_MM)
    polar_angle = np.arctan2(np.linalg.norm(np.cross(verts, verts[0]), axis=1), verts @ verts[0])
    exact_distance, vertex_areas = SPHERE_RADIUS_MM * polar_angle, geometry.vertex_areas(verts, faces)
    make_runner = partial(Runner, "geodesic distance", exact=exact_distance, vertex_areas=vertex_areas)
    yield make_runner(f"{OUR_CODE}, paths over two triangles", partial(_our_geodesics, verts, faces))
    if find_spec("potpourri3d"):
        yield make_runner("potpourri3d heat method", partial(_potpourri, verts, faces))
    if find_spec("lapy"):
        yield make_runner("LaPy heat diffusion", partial(_lapy, verts, faces))
    if find_spec("igl"):
        yield make_runner("libigl heat_geodesics", partial(_libigl, verts, faces))


def _our_geodesics(verts: Verts, faces: Faces) -> PerVertex:
    distance = np.full(len(verts), np.inf)
    shorten(path_graph(verts, faces), distance, np.array([0]), np.ones(len(verts), dtype=bool))
    return distance


def _potpourri(verts: Verts, faces: Faces) -> PerVertex:
    import potpourri3d

    return np.asarray(potpourri3d.MeshHeatMethodDistanceSolver(verts, faces).compute_distance(0))


def _lapy(verts: Verts, faces: Faces) -> PerVertex:
    import lapy
    from lapy import diffgeo, heat

    mesh = lapy.TriaMesh(verts, faces)
    distance = np.asarray(diffgeo.compute_geodesic_f(mesh, heat.diffusion(mesh, np.array([0]), m=1.0)))
    return distance - distance[0]


def _libigl(verts: Verts, faces: Faces) -> PerVertex:
    import igl

    heat_data = igl.HeatGeodesicsData()
    igl.heat_geodesics_precompute(verts, faces, heat_data)
    return np.asarray(igl.heat_geodesics_solve(heat_data, np.array([0])))


def _workbench(*arguments: str | Path) -> None:
    subprocess.run([WORKBENCH, *map(str, arguments)], check=True, capture_output=True)
