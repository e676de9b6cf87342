"""What a run costs, before it runs.

A forecast counts the elements of a mesh, times a few steps on this machine, and takes errors from runs that were
compared with finer meshes: time and error of each level of accuracy.
"""

import matplotlib.pyplot as plt

import morphofold as mf
from morphofold.sim.build import build_body
from morphofold.sim.scene.scene_files import load_scene

levels = ("draft", "standard", "finest")
octant = "geometry.portion=octant"
forecasts = [mf.forecast("fig6-thick", settings=[octant, f"accuracy.level={level}"]) for level in levels]

figure, ax = plt.subplots(figsize=(6, 4))
for level, forecast in zip(levels, forecasts):
    error = forecast.errors["gyrification index"].error
    ax.loglog(forecast.seconds, 100 * error, "o")
    ax.annotate(f" {level}\n {forecast.elements:,} bricks", (forecast.seconds, 100 * error))
ax.set(xlabel="seconds on this machine", ylabel="error of the gyrification index [%]")
ax.margins(0.5)
figure.savefig("price_of_a_run.png", dpi=110)

measured = forecasts[0].elements
known = build_body(load_scene("fig6-thick", [octant, "accuracy.level=draft"])).elements.n
print(f"the forecast of draft counts {measured:,} bricks; the mesh has {known:,}")
