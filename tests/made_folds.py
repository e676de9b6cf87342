"""Surfaces whose folds touch or pass through each other by a known amount."""

from dataclasses import replace

import numpy as np

from morphofold.shapes import icosphere
from morphofold.studies.irregular_spheres import irregular_sphere
from morphofold.studies.known_shapes import corrugated_sheet
from morphofold.surface import Surface


def pressed_sphere(level=4, *, press=1.5, irregular=False):
    """Sphere of radius 10 with a dent along y, whose flanks are pressed together in the middle of its depth.

    At ``press`` 1 they meet in the plane x = 0, beyond they pass through each other. Regular, it is its own mirror
    image there, vertex for vertex.
    """
    verts, faces = irregular_sphere(level, 10.0, rng=1) if irregular else icosphere(level, radius=10.0)
    x, y, z = verts.T
    dent = 10 * np.exp(-((x / 2.5) ** 2) - (y / 5) ** 2) * (z > 0)
    z = z - dent
    narrow = np.exp(-(((z - 4) / 2) ** 2) - (y / 4) ** 2 - (x / 4) ** 6)
    return Surface(np.column_stack([x * (1 - press * narrow), y, z]), faces, name="pressed sphere")


def two_spheres(gap, level=5):
    """Spheres of radius 10, apex to apex along a line, ``gap`` apart; negative: ``-gap`` deep in each other."""
    verts, faces = icosphere(level, radius=10.0)
    return joined(verts, verts + (2 + gap / 10) * verts[0], faces=faces)


def joined(*bodies, faces):
    """One surface of several bodies with the same faces."""
    count = len(bodies[0])
    return Surface(np.concatenate(bodies), np.concatenate([faces + k * count for k in range(len(bodies))]))


def bulged(by, edge=1.0, height=12.0):
    """A corrugated sheet whose gyri are wider than its sulci, and their width at mid-height: half of 15 plus 2 by.

    From 3.75 on the walls of a sulcus pass through each other there; its floor stays open.
    """
    sheet, width = corrugated_sheet(edge, height=height)
    out = by * np.sin(2 * np.pi * sheet.verts[:, 0] / 15) ** 3
    return replace(sheet, verts=sheet.verts + out[:, None] * [1, 0, 0]), width + 2 * by
