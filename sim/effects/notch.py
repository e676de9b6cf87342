"""Narrow grooves in the pial surface, where creases can begin; a smooth surface gets none until it loses its stability.

A block that is held laterally grows isotropically by g, in plane strain too. Its surface is compressed to 1/g along and
across, and stretched to g^2 along its normal (incompressible). For a neo-Hookean surface only the ratio of normal to
lateral stretch counts, g^3, not the stretch in the other lateral direction:

- 2.4: a crease of any size costs no energy (Hong, Zhao, Suo 2009, Appl. Phys. Lett. 95, 111901, as in Eq. 7 of Razavi
  et al. 2015): g = 1.339, a lateral stretch of 0.747, or a compression of 0.354 where the other direction keeps its
  length;
- 3.383: waves of any length grow (Biot 1963): g = 1.501, a lateral stretch of 0.666, or a compression of 0.456.

These are ``theory.CREASE`` and ``theory.BIOT``. Between them a smooth surface creases only after a disturbance of
finite size. docs/solver.md, section 6, shows the effect of notches there.
"""

from collections.abc import Sequence
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from morphofold.errors import DoesNotApply, OutOfRange
from morphofold.frozen_arrays import Array
from morphofold.sim.effects import Effect
from morphofold.sim.mesh.brick_mesh import Bilayer
from morphofold.sim.scene import Scene
from morphofold.sim.scene.table_bases import EffectOptions, Length, Point, key


class Options(EffectOptions):
    """Narrow pits in the pial surface at points ``at`` [mm], or with ``line`` one groove from each point to the next.
    In a strip: grooves across it at their x. ``depth`` over the thickness; ``width`` [mm], by default the thickness."""

    theory = True
    at_onset = False
    counted = "once, within rest"
    example = "{at = [[0, 0, 50]]}"

    at: Annotated[
        tuple[Annotated[Point, Field(strict=False)], ...],
        key(
            "points of the pial surface; their nearest nodes are used; in a strip only their x counts",
            "mm",
            strict=False,
            min_length=1,
        ),
    ]
    line: Annotated[bool, key("one groove along straight lines from each point to the next, not a pit at each")] = False
    depth: Annotated[float, key("depth of the groove over the thickness", gt=0, le=0.5)] = 0.1
    width: Annotated[Length | None, key("from edge to edge; by default the thickness", "mm")] = None

    def check(self, scene: Scene) -> None:
        if self.line and (scene.geometry.shape == "strip" or len(self.at) == 1):
            raise DoesNotApply(
                "effects.notch.line needs two points or more, and no strip, where grooves run across; leave it out"
            )


def build(options: Options, scene: Scene) -> Effect:
    thickness = scene.geometry.cortex_thickness
    return Notch(
        options.at, options.depth * thickness, options.width or thickness, options.line, scene.geometry.shape == "strip"
    )


class Notch(Effect):
    """Pits, or a groove, cut out of the thickness of the cortex; the profile is one period of a raised cosine.

    Parameters
    ----------
    at : (P, 3) float
        Points of the pial surface [mm]; its nodes nearest to them are used.
    depth, width : float
        Largest depth, and width from edge to edge [mm].
    line : bool
        One groove along the straight lines from each point to the next, instead of a pit at each.
    strip : bool
        Only x counts: grooves across a strip.

    Raises
    ------
    OutOfRange
        By ``reshape``, if a point is farther from the pial surface than a width plus an edge.
    """

    def __init__(self, at: ArrayLike, depth: float, width: float, line: bool = False, strip: bool = False):
        self._at, self._depth, self._width = np.asarray(at, dtype=np.float64), depth, width
        self._line, self._axes = line, [0] if strip else [0, 1, 2]

    def reshape(self, bilayer: Bilayer, X: Array) -> Array:
        """Move the pial surface inwards along the thickness; the white surface stays, linear in between."""
        X, cortex_nodes = X.copy(), np.flatnonzero(bilayer.share > 0)
        feet = bilayer.foot[:, self._axes]
        node_points = self._node_points_near(feet[: bilayer.n_surface], self._width + bilayer.edge)
        segments = list(zip(node_points, node_points[1:] if self._line else node_points))
        radius_share = np.min(
            [_distance_from_segment(feet[cortex_nodes], start, end) for start, end in segments], axis=0
        ) / (0.5 * self._width)
        depths = self._depth * bilayer.share[cortex_nodes] * 0.5 * (1 + np.cos(np.pi * np.minimum(radius_share, 1.0)))
        X[cortex_nodes] -= depths[:, None] * bilayer.radial[cortex_nodes]
        return X

    def _node_points_near(self, pial: Array, max_distance: float) -> Sequence[Array]:
        """The pial node nearest to each point, so that on every mesh a node is at the full depth."""
        node_points = []
        for point in self._at:
            distance = np.linalg.norm(pial - point[self._axes], axis=1)
            if distance.min() > max_distance:
                raise OutOfRange(
                    f"effects.notch.at: {point.tolist()} lies {distance.min():.3g} mm from the pial surface; give a "
                    "point on the part of the surface that is simulated (geometry.portion)."
                )
            node_points.append(pial[np.argmin(distance)])
        return node_points


def _distance_from_segment(points: Array, start: Array, end: Array) -> Array:
    """Distance (P,) of points (P, D) from the straight line between two points."""
    direction = end - start
    fraction = np.clip((points - start) @ direction / max(float(direction @ direction), 1e-300), 0.0, 1.0)
    return np.linalg.norm(points - start - fraction[:, None] * direction, axis=1)
