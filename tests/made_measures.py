"""Measures made by hand of generated shapes, for tests of results, comparison and report."""

from dataclasses import replace

import numpy as np

from morphofold.analysis.graph.hinges import ARM_COLUMNS, HINGE_COLUMNS
from morphofold.analysis.measures_result import SCALARS, Measures
from morphofold.io import read_cortex, sample_path
from morphofold.studies.known_shapes import bumpy_sphere
from morphofold.surface import Cortex, Regions, Surface

REGIONS = ("front", "middle", "back")


def made_cortex(hemi="lh", *, level=3, name="bump", regions=True, mask=True, origin="files", **more):
    """A bumpy sphere 4 mm within another: 642 vertices at level 3."""
    shape = bumpy_sphere(level, radius=40.0)
    inner = shape.verts * (1 - 4 / np.linalg.norm(shape.verts, axis=1, keepdims=True))
    white, pial = (Surface(v, shape.faces, f"{hemi}.{n}") for v, n in ((inner, "white"), (shape.verts, "pial")))
    labels = np.digitize(shape.verts[:, 1], [-12.0, 12.0])
    labels[0] = -1
    colours = np.array([[200, 10, 10], [10, 200, 10], [10, 10, 200]], dtype=np.uint8)
    return Cortex(
        white,
        pial,
        hemi=hemi,
        name=name,
        origin=origin,
        maps={"thickness": np.full(len(inner), 4.0)},
        cortex=shape.verts[:, 2] > -35 if mask else None,
        regions=Regions(labels, REGIONS, colours) if regions else None,
        inflated=Surface(shape.verts * 1.2, shape.faces, f"{hemi}.inflated"),
        **more,
    )


def made_measures(hemi="lh", **options):
    """Measures whose numbers are chosen, not measured: gyral thickness is exactly 1 + 3 times cortical thickness."""
    cortex = made_cortex(hemi, **options)
    z = cortex.pial.verts[:, 2]
    thickness = 3 + z / 40
    maps = {
        "H": np.sin(z / 5) / 5,
        "cortical_thickness": thickness,
        "gyral_thickness": np.where(z > 0, 1 + 3 * thickness, np.nan),
        "sulcal_depth": np.abs(z) / 4,
    }
    if cortex.cortex is not None:
        maps = {k: np.where(cortex.cortex, v, np.nan) for k, v in maps.items()}
    rows = []
    if cortex.regions is not None:
        for i, (region, t) in enumerate(zip(REGIONS, (2.0, 2.5, 3.5))):
            n = int(np.count_nonzero(cortex.regions.labels == i))
            row = dict(hemi=hemi, region=region, n_vertices=n, area_mm2=10.0 * n, cortical_thickness_mm=t)
            row |= dict(cortical_thickness_sd_mm=0.25, gyral_thickness_mm=1 + 3 * t)
            rows.append(row | dict(n_hinges=None, crest_length_mm=None))
    scalars = dict.fromkeys(SCALARS) | dict(
        n_vertices=cortex.n_vertices, euler_characteristic=2, gyrification_index=1.25
    )
    scalars |= dict(mean_cortical_thickness_mm=2.5, median_gyral_thickness_mm=10.0)
    hinge = [hemi, 0, 1.5, -2.0, 30.0, 3, "Y", 110.0, 130.0, "front", 5, 8.0, None, 1, 0.75, 2.75]
    hinges = [dict(zip(HINGE_COLUMNS, hinge, strict=True))]
    arms = [
        dict(zip(ARM_COLUMNS, [hemi, 0, k, 120.0 * k, 8.0, 0.01, None, 4.0, 1.5, int(k == 2), k], strict=True))
        for k in range(3)
    ]
    return Measures(
        cortex,
        scalars,
        maps,
        rows,
        hinges=hinges,
        arms=arms,
        parameters={"curvature_scale_mm": 3.0},
        notes={"n_hinges": "Hinges were not counted."},
    )


SUBJECT_MAPS = tuple(
    "H K k1 k2 curvedness shape_index cortical_thickness gyral_thickness sulcal_depth local_gyrification_index area "
    "thickness_file".split()
)


def large_pair(rng):
    """One person's left hemisphere, 153,000 vertices, and its mirror image, with all that a subject may bring."""
    left = read_cortex(sample_path("S1"))
    x, y, z = left.pial.verts.T
    names = tuple(f"region {k}" for k in range(34))
    labels = np.floor(34 * np.argsort(np.argsort(y)) / len(y)).astype(np.int64)
    regions = Regions(labels, names, np.zeros((34, 3), dtype=np.uint8))
    noisy = lambda f: np.sin(f / 5) + 0.05 * rng.standard_normal(len(f))  # as rough as curvature is
    maps = {name: noisy(x + k * y - z) for k, name in enumerate(SUBJECT_MAPS)}
    pair = []
    for hemi, flip in (("lh", 1.0), ("rh", -1.0)):
        surfaces = {n: getattr(left, n).verts * [flip, 1, 1] for n in ("white", "pial")}
        surfaces["inflated"] = 1.3 * surfaces["pial"]
        faces = left.faces if hemi == "lh" else left.faces[:, ::-1]
        shapes = {n: Surface(v, faces) for n, v in surfaces.items()}
        cortex = replace(left, **shapes, hemi=hemi, regions=regions)
        rows = [{**made_measures().regions[0], "hemi": hemi, "region": name} for name in names]
        pair.append(Measures(cortex, {}, maps, rows))
    return pair
