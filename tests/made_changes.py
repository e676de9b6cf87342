"""Changes of a cortex that change nothing that is measured."""

from dataclasses import replace

import numpy as np

from morphofold.surface import Regions

NOISE, SHIFT = 1e-9, 1e6  # [mm]; far from the origin doubles are 1e-10 apart
CHANGES = ("noise", "numbers", "shift", "mirror")


def changed(cortex, change, seed=0):
    """The cortex after one of the ``CHANGES``, the number (N,) of each of its vertices in it, and how to turn points
    (P, 3) back."""
    rng, n = np.random.default_rng(seed), cortex.n_vertices
    order, faces = np.arange(n), cortex.faces
    back = move = np.array
    if change == "noise":
        noise = [rng.uniform(-NOISE, NOISE, (n, 3)) for _ in range(2)]

        def move(points):
            return points + noise.pop()

    elif change == "shift":

        def move(points):
            return points + SHIFT * np.array([1.0, -0.7, 0.4])

        def back(points):
            return points - SHIFT * np.array([1.0, -0.7, 0.4])

    elif change == "mirror":
        faces = faces[:, [0, 2, 1]]

        def move(points):
            return points * [-1, 1, 1]

        back = move
    else:
        order = rng.permutation(n)
        faces = np.argsort(order)[rng.permutation(faces)]
        turn = (rng.integers(3, size=len(faces))[:, None] + np.arange(3)) % 3
        faces = np.take_along_axis(faces, turn, axis=1)
    white, pial = (replace(s, verts=move(s.verts)[order], faces=faces) for s in (cortex.white, cortex.pial))
    regions = cortex.regions
    if regions is not None:
        regions = Regions(regions.labels[order], regions.names, regions.colours, regions.name)
    label = None if cortex.cortex is None else cortex.cortex[order]
    new = replace(
        cortex,
        white=white,
        pial=pial,
        cortex=label,
        regions=regions,
        maps={name: values[order] for name, values in cortex.maps.items()},
        inflated=None,
        sphere=None,
    )
    return new, np.argsort(order), back
