"""Spheres with ridges along a known net: gyri with exactly known hinges, crests and widths."""

import numpy as np

from morphofold.frozen_arrays import Array
from morphofold.geometry import mean_edge_length
from morphofold.shapes import icosphere
from morphofold.shapes.spherical_nets import SphericalNet
from morphofold.studies.irregular_spheres import irregular_sphere
from morphofold.surface import Faces, Surface, Verts


def ridged_net(
    net: SphericalNet,
    level: int | tuple[Verts, Faces],
    width: float = 6.0,
    *,
    height: float = 4.0,
    radius: float = 50.0,
    dip: float = 0.0,
    blind: Array | None = None,
    noise: float = 0.0,
    rng: np.random.Generator | int | None = None,
) -> Surface:
    """Sphere with a ridge along every arc of a net; crests lie at ``radius + height`` if they do not dip.

    Its radius is ``radius + height 2^-(2 s / width)^2``. Here s is the arc length on the sphere of ``radius`` to the
    nearest arc.

    Parameters
    ----------
    net : SphericalNet
    level : int, or (verts, faces)
        Level of the icosphere, with 10 4^level + 2 vertices; or any mesh of the unit sphere.
    width, height, radius : float
        Full width at half height of a ridge, its height, radius of the floor [mm].
    dip : float
        Share of its height by which a ridge is lower at the middle between its nodes; sin^2 along the arc.
    blind : (B, 2, 3) float64, optional
        Further ridges that are not arcs of the net, as pairs of directions: from the net to their tips.
    noise : float
        Standard deviation of the displacement of every vertex along each axis [mean edges].
    rng : generator or int, optional
        For an irregular mesh: its seed and that of the noise. None: the icosphere, and noise of seed 0.
    """
    generator = np.random.default_rng(0 if rng is None else rng)
    if isinstance(level, tuple):
        verts, faces = level
    else:
        verts, faces = icosphere(level) if rng is None else irregular_sphere(level, rng=generator)
    heights = np.zeros(len(verts))
    arcs = [(net.nodes[arc_start], net.nodes[arc_end], dip) for arc_start, arc_end in net.arcs.tolist()]
    arcs += [(arc_start, arc_end, 0.0) for arc_start, arc_end in (() if blind is None else blind)]
    for arc_start, arc_end, arc_dip in arcs:
        angle, fraction = from_arc(verts, arc_start, arc_end)
        ridge = height * (1 - arc_dip * np.sin(np.pi * fraction) ** 2) * np.exp2(-((2 * radius * angle / width) ** 2))
        heights = np.maximum(heights, ridge)
    verts = verts * (radius + heights)[:, None]
    if noise:
        verts = verts + noise * mean_edge_length(verts, faces) * generator.standard_normal(verts.shape)
    return Surface(verts, faces, name="ridged net")


def from_arc(points: Verts, arc_start: Array, arc_end: Array) -> tuple[Array, Array]:
    """Angle (N,) [rad] of unit directions from the great arc between two, and the place, 0 to 1, nearest on it."""
    pole = np.cross(arc_start, arc_end)
    pole /= np.linalg.norm(pole)
    start_direction = np.cross(pole, arc_start)
    arc_angle = np.arctan2(arc_end @ start_direction, arc_end @ arc_start)
    angle_along = np.arctan2(points @ start_direction, points @ arc_start)
    to_a, to_b = (np.arccos(np.clip(points @ end, -1, 1)) for end in (arc_start, arc_end))
    is_over_arc = (angle_along >= 0) & (angle_along <= arc_angle)
    distance = np.where(is_over_arc, np.abs(np.arcsin(np.clip(points @ pole, -1, 1))), np.minimum(to_a, to_b))
    return distance, np.where(is_over_arc, angle_along / arc_angle, np.where(to_a < to_b, 0.0, 1.0))
