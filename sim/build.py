"""Build the body of a scene from its geometry."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from morphofold.errors import DoesNotApply
from morphofold.geometry import unit
from morphofold.sim.body import Body
from morphofold.sim.effects import Effect
from morphofold.sim.mesh.brick_mesh import Bilayer, bilayer_ellipsoid, bilayer_patch, spot_factors
from morphofold.sim.scene import Ellipsoid, MeshFile, Patch, Scene, Sphere, Strip, UnfoldedCortex


def build_bilayer(scene: Scene) -> Bilayer:
    """The mesh of a scene's body; raises ``DoesNotApply`` if it has none (a radial scene)."""
    geometry, cortex_layers = scene.geometry, scene.elements_through_cortex
    if isinstance(geometry, Sphere | Ellipsoid):
        return bilayer_ellipsoid(
            geometry.semi_axes, _thickness(geometry), geometry.hole_share, geometry.portion, scene.cells, cortex_layers
        )
    if isinstance(geometry, Patch | Strip):
        patch_size = geometry.size if isinstance(geometry, Patch) else (geometry.length, 0.0)
        return bilayer_patch(patch_size, geometry.depth, geometry.cortex_thickness, scene.edge, cortex_layers)
    if isinstance(geometry, UnfoldedCortex):
        from morphofold.sim.hemisphere.hemisphere_body import bilayer_of_cortex

        return bilayer_of_cortex(geometry, scene.cells, cortex_layers)
    if isinstance(geometry, MeshFile):
        from morphofold.sim.mesh.from_file import bilayer_from_file

        return bilayer_from_file(geometry)
    raise DoesNotApply(f"{scene.name}: a {geometry.shape} scene has no mesh.")


def _thickness(geometry: Sphere | Ellipsoid) -> Any:
    """Thickness of the cortex [mm], or a function of it (S,) at pial points (S, 3)."""
    T, spots = geometry.cortex_thickness, [(spot.centre, spot.radius, spot.factor) for spot in geometry.thickness_spots]
    if geometry.thickness_map is None:
        return (lambda pial: T * spot_factors(pial, spots)) if spots else T
    from morphofold.sim.hemisphere.subject_maps import thickness_factor

    factor_at = thickness_factor(geometry.thickness_map, geometry)
    return lambda pial: T * factor_at(unit(pial / np.array(geometry.semi_axes))) * spot_factors(pial, spots)


def build_body(scene: Scene, effects: Sequence[Effect] = (), bilayer: Bilayer | None = None) -> Body:
    """The body of a scene at rest, in the shape that the effects give it; on ``bilayer`` if that is given."""
    bilayer = build_bilayer(scene) if bilayer is None else bilayer
    X, stiffness = np.ascontiguousarray(bilayer.mesh.p.T), np.ones(bilayer.mesh.nelements)
    for effect in effects:
        X = effect.reshape(bilayer, X)
        stiffness = stiffness * effect.moduli(bilayer)
    return Body(
        bilayer,
        mu_cortex=scene.material.mu_ratio,
        mu_core=1.0,
        kappa_ratio=scene.material.kappa_ratio,
        law=scene.growth.law,
        X=X,
        single=scene.accuracy.precision == "single",
        split_bulk=scene.splits_bulk,
        material=scene.material.build(),
        stiffness=stiffness,
        thickening=scene.growth.thickening if scene.growth.thickness else None,
    )
