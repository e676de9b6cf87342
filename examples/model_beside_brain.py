"""A model beside a brain, on one page.

A simulated cortex and a real one are measured by the same code and compared on one interactive page.
"""

import trimesh

import morphofold as mf

sphere = mf.simulate("demo", "demo-run", settings=["geometry.portion=octant", "accuracy.edge=2.5"])
model = mf.measure(sphere.cortex())
brain = mf.measure(mf.read_cortex(mf.sample_path("fsaverage5"), hemi="lh"))

comparison = mf.compare({"model": model, "average brain": brain})
page = comparison.report("model-beside-brain")
print(f"{page}: open it in a browser")
model.plot("H", views=["lateral", "top"]).save("model_beside_brain.png")

hull = trimesh.Trimesh(brain.cortex.pial.verts, brain.cortex.faces, process=False)
measured, known = brain.scalars["gyrification_index"], float(hull.area / hull.convex_hull.area)
print(f"gyrification index of the average brain: {measured:.4f}; by trimesh: {known:.4f}")
