"""Small studies on a template, as ``cohort --space`` writes them."""

import json

import numpy as np

from morphofold.io import write_annotation, write_label, write_surface
from morphofold.shapes import icosphere
from morphofold.surface import Regions, Surface
from morphofold.tables import write_table

RADIUS = 50.0
VERTS, FACES = icosphere(3, radius=RADIUS)


def write_space(study, maps, *, hemis=("lh", "rh"), name="ball", **about):
    """Write ``maps``, arrays (S, N) by file name such as ``lh.area``, on a ball of 642 vertices whose south is no
    cortex; return the names of the subjects."""
    folder = study / "spaces" / name / "group"
    subjects = [f"s{k:02}" for k in range(len(next(iter(maps.values()))))]
    for part in ("surf", "label"):
        (folder / part).mkdir(parents=True)
    for hemi in hemis:
        for kind in ("white", "sphere"):
            write_surface(folder / "surf" / f"{hemi}.{kind}", Surface(VERTS, FACES))
        write_label(folder / "label" / f"{hemi}.cortex.label", VERTS[:, 2] > -40, VERTS)
        colours = np.array([[9, 9, 9], [99, 9, 9]], np.uint8)
        regions = Regions((VERTS[:, 2] > 0).astype(int), ("south", "north"), colours)
        write_annotation(folder / "label" / f"{hemi}.aparc.annot", regions)
    for file, values in maps.items():
        np.save(folder / f"{file}.npy", np.asarray(values, dtype=np.float32))
    sides = {hemi: any(file.startswith(hemi) for file in maps) for hemi in ("lh", "rh")}
    rows = [{"participant_id": subject} | {hemi: int(has) for hemi, has in sides.items()} for subject in subjects]
    write_table(folder / "participants.tsv", ("participant_id", "lh", "rh"), rows)
    (folder / "space.json").write_text(json.dumps(about))
    return subjects
