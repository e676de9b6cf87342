"""The cost of accuracy in the analysis: curvature and thickness of shapes with known answers, compared with peers.

The error of a field is the root of the area-weighted mean square of its difference from the exact field, over that of
the exact field. A vertex without a value counts as 0, so its relative error is 1. Times exclude numba compilation. A
peer that fails has a point without error or seconds (NaN, no repeats); its setting gives the reason.
"""

import math
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from typing import Any

import numpy as np

from morphofold import geometry
from morphofold.analysis import cortical_thickness, curvature
from morphofold.analysis.curvatures import CURVATURE_SCALE_MM, LEAST_CURVATURE_SCALE_IN_EDGES
from morphofold.studies.accuracy.error_points import NO_TIMING, OUR_CODE, Case, Point, Timing, timed
from morphofold.studies.accuracy.peer_packages import H, K, Peer, closest_peers, curvature_peers
from morphofold.studies.irregular_spheres import irregular_sphere
from morphofold.studies.known_shapes import Shape, bumpy_sphere, ellipsoid, torus, with_noise
from morphofold.surface import Faces, PerVertex, Surface, Verts

ICO_LEVELS = (4, 5, 6, 7)  # of the icosphere: 2,562 to 163,842 vertices
SCALES_IN_EDGES = (1.6, 2.2, 3.0, 4.0, 5.0, 6.0, 8.0)  # mean edges
GAP, SLIDE = 2.5, 0.4  # thickness of the cortex [mm]; shift of its inner vertices along the surface, in mean edges
FieldMap = Mapping[str, PerVertex]


def relative_rms(values: PerVertex, exact_values: PerVertex, areas: PerVertex) -> float:
    """The error of the values (N,) of a field, as defined at the top of this file."""
    difference = np.where(np.isfinite(values), values, 0.0) - exact_values
    return float(np.sqrt(np.sum(areas * difference**2) / np.sum(areas * exact_values**2)))


def point(subject: str, quantity: str, error: float, timing: Timing, against: str = "exact", **fields: Any) -> Point:
    """A point of this half; ``fields`` are the other ones."""
    return Point("measuring", subject, quantity, error, against, **timing._asdict(), **fields)


def of_mesh(verts: Verts, faces: Faces) -> dict[str, Any]:
    """Position of a mesh on the axis of meshes: its number of vertices and mean edge [mm]."""
    n_vertices = len(verts)
    return {"setting": f"{n_vertices:,} vertices", "value": geometry.mean_edge_length(verts, faces), "size": n_vertices}


def cases() -> list[Case]:
    """The cases of this file."""
    makers: dict[str, tuple[Callable[[int], Shape], tuple[int, ...]]] = {
        "bumpy sphere": (partial(bumpy, noise=0.0), ICO_LEVELS),
        "bumpy sphere, 1 % noise": (partial(bumpy, noise=0.01), ICO_LEVELS),
        "torus": (ring, ICO_LEVELS[:3]),
        "ellipsoid": (lambda level: ellipsoid(level, rng=0), ICO_LEVELS[:3]),
    }
    all_cases = [
        Case(f"curvature-mesh-{_word(subject)}", partial(curvature_over_meshes, subject, make_shape, levels))
        for subject, (make_shape, levels) in makers.items()
    ]
    all_cases += [
        Case(f"curvature-scale-{_word(subject)}", partial(curvature_over_scales, subject, makers[subject][0], 6))
        for subject in ("bumpy sphere", "bumpy sphere, 1 % noise")
    ]
    all_cases.append(Case("cortical-thickness", partial(thickness_over_meshes, ICO_LEVELS)))
    return all_cases


def _word(shape_name: str) -> str:
    return shape_name.replace(", 1 % noise", "-noisy").replace(" ", "-")


def bumpy(level: int, noise: float) -> Shape:
    """Irregular bumpy sphere with hills and valleys of 12 to 50 mm."""
    shape = bumpy_sphere(level, rng=0)
    return with_noise(shape, noise, rng=1) if noise else shape


def ring(level: int) -> Shape:
    """Irregular torus with nearly as many vertices as an icosphere."""
    return torus(5 * 2**level, 2 * 2**level, rng=0)


def curvature_over_meshes(subject: str, make_shape: Callable[[int], Shape], levels: Iterable[int]) -> list[Point]:
    """Ours within three mean edges, and within 3 mm (at least 2.5 edges) as in ``measure``; peers at their scales."""
    points = []
    for level in levels:
        shape = make_shape(level)
        mesh_info = of_mesh(shape.verts, shape.faces)
        points += _fields(shape, subject, _ours, axis="mesh", **mesh_info)
        scale = max(CURVATURE_SCALE_MM, LEAST_CURVATURE_SCALE_IN_EDGES * mesh_info["value"])
        points += _fields(shape, subject, partial(_ours, scale=scale), axis="mesh at 3 mm", **mesh_info)
        for peer in curvature_peers():
            if peer.reach <= 5 and len(shape.verts) <= peer.most_vertices:
                points += _fields(shape, subject, peer.call, axis="mesh", method=peer.name, **mesh_info)
    return points


def curvature_over_scales(subject: str, make_shape: Callable[[int], Shape], level: int) -> list[Point]:
    """Ours over several scales, and the peers with a reach, on one mesh."""
    shape = make_shape(level)
    mean_edge = geometry.mean_edge_length(shape.verts, shape.faces)
    points = []
    for scale in SCALES_IN_EDGES:
        compute = partial(_ours, scale=scale * mean_edge)
        points += _fields(shape, subject, compute, axis="scale", setting=f"{scale:g} mean edges", value=scale)
    for peer in curvature_peers():
        if peer.reach > 1 and len(shape.verts) <= peer.most_vertices:
            text = f"{peer.reach:g} rings or edges"
            points += _fields(shape, subject, peer.call, axis="scale", setting=text, value=peer.reach, method=peer.name)
    return points


def _ours(verts: Verts, faces: Faces, scale: float | None = None) -> FieldMap:
    curvatures = curvature(verts, faces, scale)
    return {H: curvatures.H, K: curvatures.K}


def _fields(
    shape: Shape, subject: str, compute: Callable[[Verts, Faces], FieldMap], method: str = OUR_CODE, **more_fields: Any
) -> list[Point]:
    """A point for each field that a method computes for a shape."""
    areas = geometry.vertex_areas(shape.verts, shape.faces)
    more_fields = {"size": len(shape.verts), "method": method, **more_fields}
    field_by_name, timing = _tried(lambda: compute(shape.verts, shape.faces), method, more_fields)
    exact_by_name = {H: shape.H, K: shape.K}
    if field_by_name is None:
        return [point(subject, H, math.nan, NO_TIMING, **more_fields)]
    return [
        point(subject, name, relative_rms(field, exact_by_name[name], areas), timing, **more_fields)
        for name, field in field_by_name.items()
    ]


def _tried(compute: Callable[[], Any], method: str, more_fields: dict[str, Any]) -> tuple[Any, Timing]:
    """As ``timed``; for a peer that fails, None and the reason in the setting. Our own failures raise errors."""
    if method == OUR_CODE:
        return timed(compute)
    try:
        return timed(compute)
    except Exception as error:  # any error that another package may raise
        reason = str(error).splitlines()[0] if str(error) else "no reason given"
        more_fields["setting"] += f": failed, {type(error).__name__}: {reason}"
        return None, NO_TIMING


def thickness_over_meshes(levels: Iterable[int]) -> list[Point]:
    """Thickness of the parallel pair, the mean of both directions as ours; peers do not test which side is outward."""
    points = []
    for level in levels:
        white, pial = parallel_pair(level)
        mesh_info = of_mesh(pial.verts, pial.faces)
        for distance_mode in ("surface", "freesurfer"):
            axis_name = "mesh" if distance_mode == "surface" else "mesh, nearest vertex"
            compute = partial(cortical_thickness, white, pial, mode=distance_mode)
            points.append(_thickness(pial, compute, **mesh_info, axis=axis_name))
        for peer in closest_peers():
            if len(pial.verts) <= peer.most_vertices:
                points.append(
                    _thickness(pial, partial(both_ways, peer, white, pial), **mesh_info, axis="mesh", method=peer.name)
                )
    return points


def _thickness(pial: Surface, compute: Callable[[], PerVertex], method: str = OUR_CODE, **more_fields: Any) -> Point:
    thickness, timing = _tried(compute, method, more_fields)
    areas = geometry.vertex_areas(pial.verts, pial.faces)
    error = math.nan if thickness is None else relative_rms(thickness, np.full(len(areas), GAP), areas)
    return point("parallel surfaces", "cortical thickness", error, timing, method=method, **more_fields)


def both_ways(peer: Peer, white: Surface, pial: Surface) -> PerVertex:
    """Mean distance of a vertex and its partner from the other surface, by a peer."""
    white_to_pial = peer.call(white.verts, pial.verts, pial.faces)
    pial_to_white = peer.call(pial.verts, white.verts, white.faces)
    return np.asarray((white_to_pial + pial_to_white) / 2)


def parallel_pair(level: int) -> tuple[Surface, Surface]:
    """Irregular bumpy sphere and the surface exactly ``GAP`` within it, with vertices shifted by part of an edge.

    Every point of one surface is exactly ``GAP`` from the other, because no radius of curvature is as small. The mesh
    is rotated about an axis that is not an axis of the shape, so that no vertex lies opposite its partner.
    """
    verts, faces = irregular_sphere(level, rng=0)
    angle = SLIDE * geometry.mean_edge_length(verts, faces)
    axis = np.array([0.48, 0.6, 0.64])
    cross_axis = np.cross(axis, verts)
    rotated = np.cos(angle) * verts + np.sin(angle) * cross_axis + (1 - np.cos(angle)) * (verts @ axis)[:, None] * axis
    inner, outer = bumpy_sphere((rotated, faces)), bumpy_sphere((verts, faces))
    return Surface(inner.verts - GAP * inner.normals, faces, "inner"), Surface(outer.verts, faces, "outer")
