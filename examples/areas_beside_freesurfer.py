"""Areas of regions beside FreeSurfer's own table.

A part of one person's white surface, with the numbers that FreeSurfer wrote for it. An area per vertex is a third of
the triangles around it, and the area of a region the sum over its vertices.
"""

import csv

import matplotlib.pyplot as plt
import numpy as np

import morphofold as mf
from morphofold.analysis import vertex_areas

folder = mf.sample_path("subject1_excerpt")
excerpt = np.load(folder / "excerpt.npz")
ours = vertex_areas(excerpt["patch_verts"], excerpt["patch_faces"])
whole = excerpt["patch_complete"]  # vertices with all of their triangles

figure, ax = plt.subplots(figsize=(4.5, 4.5))
ax.plot(excerpt["patch_area"][whole], ours[whole], ".", markersize=2)
ax.set(xlabel="area of a vertex by FreeSurfer [mm²]", ylabel="by morphofold [mm²]", aspect="equal")
figure.savefig("areas_beside_freesurfer.png", dpi=110)

with open(folder / "lh.aparc.stats.tsv", newline="") as stats:
    table = {row["StructName"]: float(row["SurfArea"]) for row in csv.DictReader(stats, delimiter="\t")}
labels = excerpt["labels"][excerpt["labels"] < 3]  # of the patch's three regions, whose vertices are whole
for number, region in enumerate(excerpt["region_names"][:3]):
    measured, known = float(ours[whole][labels == number].sum()), table[str(region)]
    print(f"{region}: {measured:.0f} mm²; FreeSurfer's table: {known:.0f} mm²")
