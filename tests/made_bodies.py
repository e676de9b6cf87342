"""Bodies with known answers: a free beam of two layers, and what theory says of it."""

import dataclasses

import numpy as np

from morphofold.sim.body import Body
from morphofold.sim.mesh.brick_mesh import bilayer_patch

THICKNESS, CORTEX = 4.0, 1.0  # of the beam, and of its cortex [mm]
RATIO = 3.0  # of shear moduli


def beam(half_length=16.0, half_width=1.0, edge=1.0, layers=2) -> Body:
    """A quarter of a beam of square-ish section, free but for one node at the bottom of its middle."""
    bilayer = bilayer_patch((half_length, half_width), THICKNESS, CORTEX, edge, layers)
    middle = np.flatnonzero((bilayer.mesh.p[0] == 0) & (bilayer.mesh.p[1] == 0) & (bilayer.mesh.p[2] == -THICKNESS))
    planes = tuple(plane for plane in bilayer.planes if plane.at == 0)
    free = dataclasses.replace(bilayer, planes=planes, held=middle)
    return Body(free, mu_cortex=RATIO, mu_core=1.0, kappa_ratio=50.0, law="isotropic")


def timoshenko(g: float) -> float:
    """Curvature [1/mm] of a free strip of two layers whose upper one grows by g (Timoshenko 1925, Eq. 4)."""
    m = CORTEX / (THICKNESS - CORTEX)
    return 6 * (g - 1) * (1 + m) ** 2 / (THICKNESS * (3 * (1 + m) ** 2 + (1 + m * RATIO) * (m**2 + 1 / (m * RATIO))))


def curvature(body: Body, x) -> float:
    """Of the line of the pial surface that the plane y = 0 cuts [1/mm], positive where the middle stands out."""
    line = np.flatnonzero(body.on_plane[: body.n_surface, 1])
    inside = line[body.X[line, 0] < 0.75 * body.X[line, 0].max()]  # the ends are not those of a long beam
    return -2 * float(np.polyfit(x[inside, 0] ** 2, x[inside, 2], 1)[0])
