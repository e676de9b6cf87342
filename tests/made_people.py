"""A person with chosen folds, and cortices that grew from it, on any mesh of the sphere."""

import numpy as np

from morphofold.analysis.curvatures import curvature
from morphofold.analysis.measures_result import SCALARS, Measures
from morphofold.geometry import vertex_areas
from morphofold.shapes import icosphere
from morphofold.surface import Cortex, Regions, Surface
from morphofold.unfolding.harmonics import degrees, harmonics

DEGREE = 16
AXES = np.array([0.65, 1.0, 0.8])
LEVEL = 0.03


def random_folds(rng, low=7, high=DEGREE):
    """Coefficients (., 1) of a random function on the sphere with degrees from ``low`` to ``high``, of variance 1."""
    l = degrees(DEGREE)
    folds = np.where((l >= low) & (l <= high), rng.standard_normal(len(l)), 0.0)
    return folds / np.linalg.norm(folds) * np.sqrt(4 * np.pi)


def values(folds, points):
    """The function at points (P, 3) of the unit sphere, (P,)."""
    return harmonics(points, DEGREE) @ folds


def made_person(folds, *, mesh=None, hemi="lh", name="person", grown_from=None, regions=True, sphere=True, size=60.0):
    """Measures of an ellipsoid with folds 5 % of its size high: maps H, thickness and depth, 24 regions, a wall."""
    points, faces = icosphere(4) if mesh is None else mesh
    height = 1 + 0.05 * values(folds, points)
    pial, white = (size * (height - t)[:, None] * AXES * points for t in (0.0, 0.05))
    centres = icosphere(1)[0][:24]
    labels = (points @ centres.T).argmax(axis=1)
    surfaces = {
        "white": Surface(white, faces, f"{hemi}.white"),
        "pial": Surface(pial, faces, f"{hemi}.pial"),
        "sphere": Surface(100 * points, faces, f"{hemi}.sphere") if sphere else None,
    }
    path = f"{name}/surf/{hemi}.white"
    cortex = Cortex(
        **surfaces,
        hemi=hemi,
        name=name,
        maps={"sulc": -height},
        cortex=points[:, 0] < 0.9,
        regions=Regions(labels, tuple(f"part {k}" for k in range(24)), np.arange(72, dtype=np.uint8).reshape(24, 3))
        if regions
        else None,
        info={} if grown_from is None else {"grown_from": grown_from},
        files=(path,),
        inputs=({"path": path, "sha256": f"digest of {name} {hemi}", "bytes": 1},),
    )
    return measures_of(cortex)


def measures_of(cortex):
    """Measures of a cortex: its curvature, and two maps that follow from its heights."""
    scale = 3 * np.sqrt(vertex_areas(cortex.pial.verts, cortex.faces).mean())
    bent = curvature(cortex.pial.verts, cortex.faces, float(scale))
    radius = np.linalg.norm(cortex.pial.verts / AXES, axis=1)
    maps = {"H": bent.H, "cortical_thickness": 2 + radius / 60, "sulcal_depth": radius.max() - radius}
    maps = {key: np.where(cortex.cortex, values, np.nan) for key, values in maps.items()}
    return Measures(cortex, dict.fromkeys(SCALARS), maps, parameters={"curvature_scale_mm": float(scale)})


def source(name="person", hemi="lh", **more):
    """The record of the person a cortex grew from."""
    return {"subject": name, "sha256": {"surface": f"digest of {name} {hemi}", **more}, "unfold": LEVEL}
