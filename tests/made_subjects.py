"""Small FreeSurfer subjects with known shapes, for bodies that are grown from a person."""

from pathlib import Path

import numpy as np

from morphofold.io import write_annotation, write_label, write_morph, write_surface
from morphofold.shapes import icosphere
from morphofold.surface import Regions, Surface

AXES = np.array([60.0, 45.0, 40.0])
WALL_COSINE = 0.8  # the medial wall is where x of the unit sphere is larger, or smaller than minus that on the right


def write_subject(root: Path, hemi: str = "lh", axes=AXES, label: bool = True, **maps) -> Path:
    """An ellipsoid with its sphere, two regions (below and above z = 0), a cortex label, and maps of the points."""
    s, faces = icosphere(4)
    (root / "surf").mkdir(parents=True, exist_ok=True)
    (root / "label").mkdir(exist_ok=True)
    write_surface(root / "surf" / f"{hemi}.white", Surface(s * axes, faces))
    write_surface(root / "surf" / f"{hemi}.sphere", Surface(100 * s, faces))
    if label:
        write_label(root / "label" / f"{hemi}.cortex.label", cortex_of(s, hemi), s * axes)
        colours = np.array([[20, 30, 40], [200, 100, 50]], dtype=np.uint8)
        regions = Regions((s[:, 2] > 0).astype(np.int64), ("below", "above"), colours)
        write_annotation(root / "label" / f"{hemi}.aparc.annot", regions)
    for name, of_points in maps.items():
        write_morph(root / "surf" / f"{hemi}.{name}", of_points(s))
    return root


def cortex_of(s, hemi: str = "lh"):
    """Where points (N, 3) of the unit sphere are cortex."""
    return (s[:, 0] if hemi == "lh" else -s[:, 0]) < WALL_COSINE


def scene_of(subject: Path, *lines: str, geometry: str = "", growth: str = "final = 1.04") -> str:
    """A scene that grows a subject, on a coarse mesh."""
    return "\n".join(
        [
            'name = "own"\n[geometry]\nshape = "cortex"',
            f"subject = {str(subject)!r}\ncortex_thickness = 4.0\n{geometry}",
            f"[growth]\n{growth}",
            "[accuracy]\nedge = 13.2\nelements_through_cortex = 2\n[output]\nvolume = false",
            *lines,
        ]
    )
