"""Build the body of a scene from its geometry."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from morphofold.errors import DoesNotApply
from morphofold.sim.body import Body
from morphofold.sim.effects import Effect
from morphofold.sim.mesh.brick_mesh import Bilayer, bilayer_ellipsoid, bilayer_patch, spot_factors
from morphofold.sim.scene import Ellipsoid, MeshFile, Patch, Scene, Sphere, Strip, UnfoldedCortex


def build_bilayer(scene: Scene) -> Bilayer:
    """The mesh of a scene's body; raises ``DoesNotApply`` if it has none (a radial scene)."""
    geometry, layers = scene.geometry, scene.elements_through_cortex
    if isinstance(geometry, Sphere | Ellipsoid):
        thickness: Any = geometry.cortex_thickness
        if geometry.thickness_spots:
            spots = [(spot.centre, spot.radius, spot.factor) for spot in geometry.thickness_spots]
            thickness = lambda pial: geometry.cortex_thickness * spot_factors(pial, spots)
        return bilayer_ellipsoid(
            geometry.semi_axes, thickness, geometry.hole_share, geometry.portion, scene.cells, layers
        )
    if isinstance(geometry, Patch):
        return bilayer_patch(geometry.size, geometry.depth, geometry.cortex_thickness, scene.edge, layers)
    if isinstance(geometry, Strip):
        return bilayer_patch((geometry.length, 0.0), geometry.depth, geometry.cortex_thickness, scene.edge, layers)
    if isinstance(geometry, UnfoldedCortex):
        from morphofold.sim.mesh.unfolded_cortex import bilayer_of_cortex

        return bilayer_of_cortex(geometry, scene.cells, layers)
    if isinstance(geometry, MeshFile):
        from morphofold.sim.mesh.from_file import bilayer_from_file

        return bilayer_from_file(geometry)
    raise DoesNotApply(f"{scene.name}: a {geometry.shape} scene has no mesh.")


def build_body(scene: Scene, effects: Sequence[Effect] = (), bilayer: Bilayer | None = None) -> Body:
    """The body of a scene at rest, in the shape that the effects give it; on ``bilayer`` if that is given."""
    bilayer = build_bilayer(scene) if bilayer is None else bilayer
    X = np.ascontiguousarray(bilayer.mesh.p.T)
    for effect in effects:
        X = effect.reshape(bilayer, X)
    material = scene.material
    return Body(
        bilayer,
        mu_cortex=material.mu_ratio,
        mu_core=1.0,
        kappa_ratio=material.kappa_ratio,
        law=scene.growth.law,
        X=X,
        single=scene.accuracy.precision == "single",
        material=material.build(),
    )
