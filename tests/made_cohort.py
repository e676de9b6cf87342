"""Small subjects on disk, and workers that are this process."""

import csv
from contextlib import nullcontext

import numpy as np

from morphofold.analysis.measures_result import SCALARS, Measures
from morphofold.group.measure_subject import Participant
from morphofold.group.task_records import TaskFolder
from morphofold.io import write_annotation, write_morph, write_surface
from morphofold.studies.known_shapes import bumpy_sphere
from morphofold.surface import Regions, Surface

REGIONS = ("front", "back")


def write_subject(folder, size=1.0, hemis=("lh", "rh"), level=2):
    """A bumpy sphere 4 mm within another, with thickness and two regions, as FreeSurfer would write it."""
    shape = bumpy_sphere(level, radius=40.0 * size)
    inner = shape.verts * (1 - 4 / np.linalg.norm(shape.verts, axis=1, keepdims=True))
    for name in ("surf", "label"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    for hemi in hemis:
        for name, verts in (("white", inner), ("pial", shape.verts)):
            write_surface(folder / "surf" / f"{hemi}.{name}", Surface(verts.astype(np.float32), shape.faces))
        write_morph(folder / "surf" / f"{hemi}.thickness", np.full(len(inner), 4.0))
        regions = Regions((shape.verts[:, 1] > 0).astype(int), REGIONS, np.array([[9, 9, 9], [99, 9, 9]], np.uint8))
        write_annotation(folder / "label" / f"{hemi}.aparc.annot", regions)
    return folder


def quick_measure(cortex, *, progress=None, **options):
    """In place of ``measure``: the numbers that cost nothing, in the form of all."""
    scalars = dict.fromkeys(SCALARS)
    radius = float(np.linalg.norm(cortex.pial.verts, axis=1).mean())
    scalars.update(n_vertices=cortex.n_vertices, mean_cortical_thickness_mm=radius / 10, gyrification_index=1.5)
    rows = [
        {
            "hemi": cortex.hemi,
            "region": name,
            "n_vertices": int((cortex.regions.labels == i).sum()),
            "cortical_thickness_mm": radius / 10 + i,
            "gyral_thickness_mm": radius / 4,
        }
        for i, name in enumerate(cortex.regions.names if cortex.regions else ())
    ]
    maps = {"H": np.full(cortex.n_vertices, 1 / radius)}
    scalars.update(n_hinges=20, folding_index=30.0)
    how = {
        "curvature_scale_mm": options.get("curvature_scale") or 3.0,
        "folding_scale_mm": options.get("curvature_scale") or 3.0,
        "accuracy": options.get("accuracy", "standard"),
        "graph_width_mm": options.get("gyral_width") or 9.0,
    }
    return Measures(cortex, scalars, maps, rows, parameters=how, notes={})


def participants(folders, out, run="1", **options):
    return [Participant(f.name, str(f), TaskFolder(str(out), f.name, run), **options) for f in folders]


class HereWorkers:
    """Does tasks one after the other in this process."""

    label = "here"

    def run(self, work, tasks):
        for task in tasks:
            yield task, work(task)


def work_here(monkeypatch, measure=quick_measure):
    """Commands for groups work in this process, with another function in place of ``measure``."""
    monkeypatch.setattr("morphofold.group.workers.open_workers", lambda *options: nullcontext(HereWorkers()))
    monkeypatch.setattr("morphofold.analysis.measuring.measure", measure)


def table(path):
    """Rows of a table as text."""
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file, delimiter="\t"))
