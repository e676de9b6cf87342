"""``simulate``: grow a scene, and write each stage with the maps of a FreeSurfer subject, measured by the same code."""

from functools import wraps
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import KDTree

from morphofold import analysis
from morphofold.analysis.relief import height_and_vertical
from morphofold.frozen_arrays import Array, Ints
from morphofold.geometry import mean_edge_length, norms, vertex_areas
from morphofold.io import flip_curvature_sign
from morphofold.sim import run
from morphofold.sim.run import Simulation
from morphofold.sim.scene import Scene
from morphofold.surface import Cortex, Surface

CURVATURE_SCALE_IN_EDGES = 3.0  # radius of the neighbourhood of ``curv``, in mean edges of white


def freesurfer_maps(cortex: Cortex) -> dict[str, Array]:
    """``thickness``, ``curv``, ``sulc`` and ``area`` of a cortex as in a FreeSurfer subject, (N,) each.

    thickness [mm]: symmetric closest distance between white and pial; curv [1/mm]: mean curvature of white, positive
    in sulci; sulc [mm]: depth below a surface smoothed at a fifth of the mean radius, positive in sulci, mean zero
    over the area; area [mm^2]: a third of the white triangles around each vertex.

    Of a mirrored part, thickness and curv are measured on the part and so far beyond it as they reach.
    """
    white, faces = cortex.white.verts, cortex.faces
    area = vertex_areas(white, faces)
    scale = 0.2 * float(np.sqrt(area.sum() / (4 * np.pi)))
    height, _ = height_and_vertical(white, faces, scale)
    curvature_scale = CURVATURE_SCALE_IN_EDGES * mean_edge_length(white, faces)
    part, images = _part_and_margin(cortex, 2 * curvature_scale)
    return {
        "thickness": analysis.cortical_thickness(part.white, part.pial)[images],
        "curv": flip_curvature_sign(analysis.curvature(part.white.verts, part.faces, curvature_scale).H)[images],
        "sulc": flip_curvature_sign(height - np.average(height, weights=area)),
        "area": area,
    }


def _part_and_margin(cortex: Cortex, margin: float) -> tuple[Cortex, Ints]:
    """The simulated part of a cortex with all within ``margin`` [mm], or the thickness of the cortex, beyond it; and
    the vertex of it of which each vertex of the whole is the image (N,)."""
    if cortex.images is None:
        return cortex, np.arange(cortex.n_vertices)
    white, pial, n_part = cortex.white.verts, cortex.pial.verts, int(cortex.images.max()) + 1
    reach = max(margin, float(norms(pial - white).max()))
    is_near = np.zeros(len(white), dtype=bool)
    for verts in (white, pial):
        is_near |= KDTree(verts[:n_part]).query(verts, distance_upper_bound=reach)[0] < np.inf
    faces = cortex.faces[is_near[cortex.faces].any(axis=1)]
    used_verts = np.union1d(np.arange(n_part), faces)  # the part comes first here, too
    new_faces = np.searchsorted(used_verts, faces)
    part_white, part_pial = (Surface(verts[used_verts], new_faces) for verts in (white, pial))
    return Cortex(part_white, part_pial, cortex.hemi, cortex.name), cortex.images


@wraps(run.simulate, assigned=())  # its signature
def simulate(source: str | Path | Scene, out: str | Path | None = None, **options: Any) -> Simulation:
    """Grow a scene and write its simulation folder, with the options of :func:`morphofold.sim.run.simulate`.

    Each stage is a FreeSurfer-shaped subject: ``surf/lh.white``, ``lh.pial`` and the maps of
    :func:`freesurfer_maps`.
    """
    return run.simulate(source, out, **{"describe": freesurfer_maps, **options})
