"""``simulate``: grow a scene, and write each stage with the maps of a FreeSurfer subject, measured by the same code."""

from functools import wraps
from pathlib import Path
from typing import Any

import numpy as np

from morphofold import analysis
from morphofold.analysis.relief import relief
from morphofold.frozen_arrays import Array
from morphofold.geometry import vertex_areas
from morphofold.io import flip_curvature_sign
from morphofold.sim import run
from morphofold.sim.run import Simulation
from morphofold.sim.scene import Scene
from morphofold.surface import Cortex


def freesurfer_maps(cortex: Cortex) -> dict[str, Array]:
    """``thickness``, ``curv``, ``sulc`` and ``area`` of a cortex as in a FreeSurfer subject, (N,) each.

    thickness [mm]: symmetric closest distance between white and pial; curv [1/mm]: mean curvature of white, positive
    in sulci; sulc [mm]: depth below a surface smoothed at a fifth of the mean radius, positive in sulci, mean zero
    over the area; area [mm^2]: a third of the white triangles around each vertex.
    """
    white, faces = cortex.white.verts, cortex.faces
    area = vertex_areas(white, faces)
    scale = 0.2 * float(np.sqrt(area.sum() / (4 * np.pi)))
    height = relief(white, faces, scale).height
    return {
        "thickness": analysis.cortical_thickness(cortex.white, cortex.pial),
        "curv": flip_curvature_sign(analysis.curvature(white, faces).H),
        "sulc": flip_curvature_sign(height - np.average(height, weights=area)),
        "area": area,
    }


@wraps(run.simulate, assigned=())  # its signature
def simulate(source: str | Path | Scene, out: str | Path | None = None, **options: Any) -> Simulation:
    """Grow a scene and write its simulation folder, with the options of :func:`morphofold.sim.run.simulate`.

    Each stage is a FreeSurfer-shaped subject: ``surf/lh.white``, ``lh.pial`` and the maps of
    :func:`freesurfer_maps`.
    """
    return run.simulate(source, out, **{"describe": freesurfer_maps, **options})
