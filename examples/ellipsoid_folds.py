"""An ellipsoid folds, and its cortex keeps its volume.

A body with the proportions of a brain. Growth multiplies the volume of the cortex by g^3; as the tissue is nearly
incompressible, the volume between pial and white surface must show just that, folded or not.
"""

import morphofold as mf

settings = ["geometry.portion=octant", "growth.final=1.6", "output.stages=[1.01, 1.3]", "accuracy.edge=2.5"]
ellipsoid = mf.simulate("ellipsoid", "ellipsoid", settings=settings)


def cortical_volume(cortex):
    """Volume between white and pial [mm3]."""
    return cortex.to_trimesh("pial").volume - cortex.to_trimesh("white").volume


first, last = ellipsoid.stages[0], ellipsoid.stages[-1]
folded = mf.measure(ellipsoid.cortex(last), only=["H"])
folded.plot("H", views=["top", "lateral"], limits=(-0.3, 0.3)).save("ellipsoid_folds.png")

measured = cortical_volume(folded.cortex) / cortical_volume(ellipsoid.cortex(first))
known = (last / first) ** 3
print(f"the volume of the cortex grew {measured:.3f} times; growth alone: {known:.3f}")
