"""Bodies of bricks or tetrahedra, and a free beam of two layers with what theory says of it."""

import dataclasses
from types import SimpleNamespace

import numpy as np

from morphofold.sim.body import Body
from morphofold.sim.mesh.brick_mesh import bilayer_patch, bilayer_sphere

THICKNESS, CORTEX = 4.0, 1.0  # of the beam, and of its cortex [mm]
RATIO = 3.0  # of shear moduli


def of_tets(bilayer):
    """The same body of tetrahedra, six a brick, those of the cortex first; the faces are not the quads' own."""
    tets = bilayer.mesh.to_meshtet()
    brick = np.arange(tets.nelements) % bilayer.mesh.nelements  # skfem stacks the six tetrahedra of all bricks
    cortex, n = brick < len(bilayer.mesh.subdomains["cortex"]), tets.nelements
    mesh = type(tets)(tets.p, np.ascontiguousarray(tets.t[:, np.argsort(~cortex, kind="stable")]))
    parts = {"cortex": np.arange(cortex.sum()), "core": np.arange(cortex.sum(), n)}
    faces = np.concatenate([bilayer.faces[:, [0, 1, 2]], bilayer.faces[:, [0, 2, 3]]])
    return dataclasses.replace(bilayer, mesh=mesh.with_subdomains(parts), faces=faces)


def body_of(bilayer, kind="bricks", **options) -> Body:
    """A body of ``kind`` "bricks" or "tetrahedra", of the same moduli in both layers unless options say other ones."""
    bilayer = bilayer if kind == "bricks" else of_tets(bilayer)
    return Body(bilayer, **{"mu_cortex": 1.0, "mu_core": 1.0, "kappa_ratio": 50.0, "law": "isotropic", **options})


def sphere(n=6, kind="bricks", thickness=3.0, portion="octant", **options) -> Body:
    return body_of(bilayer_sphere(50, thickness, 25, portion, n), kind, **options)


def block(size=(4.0, 4.0), depth=12.0, thickness=3.0, edge=1.0, kind="bricks", **options) -> Body:
    return body_of(bilayer_patch(size, depth, thickness, edge), kind, **options)


def standing(body, x, v=None):
    """What an effect sees of a run that stands at ``x``."""
    return SimpleNamespace(body=body, state=SimpleNamespace(x=x, v=np.zeros_like(x) if v is None else v, step=0))


def beam(half_length=16.0, half_width=1.0, edge=1.0, layers=2) -> Body:
    """A quarter of a beam of square-ish section, free but for one node at the bottom of its middle."""
    bilayer = bilayer_patch((half_length, half_width), THICKNESS, CORTEX, edge, layers)
    x, y, z = bilayer.mesh.p
    middle = np.flatnonzero((x == 0) & (y == 0) & (z == z.min()))
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
