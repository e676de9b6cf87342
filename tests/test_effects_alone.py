"""An effect is imported and run if and only if its scene calls for it."""

import json
import subprocess
import sys

from morphofold.sim.effects import build_effects
from morphofold.sim.scene.scene_files import load_scene

PLAIN = """
name = "plain"
[geometry]
cortex_thickness = 3.0
portion = "PORTION"
[growth]
final = 1.02
rate = 4.0
[accuracy]
edge = 19.7
precision = "double"
[output]
volume = false
"""
MAP = 'file = "fsaverage5/surf/lh.area"\nsphere = "fsaverage5/surf/lh.sphere"\ndegree = 2'
ALONE = {
    "none": "",
    "contact": "[effects.contact]",
    "corner_barrier": "[effects.corner_barrier]",
    "perturbation": "[effects.perturbation]",
    "notch": "[effects.notch]\nat = [[50.0, 0.0, 0.0]]",
    "core_growth": "[effects.core_growth]\nfinal = 1.01",
    "stress_growth": "[effects.stress_growth]",
    "regional_growth": "[effects.regional_growth]\nspots = [{centre = [50.0, 0.0, 0.0], radius = 30.0, factor = 0.5}]",
    "growth_map": f"[effects.growth_map]\n{MAP}",
    "stiffness_map": f"[effects.stiffness_map]\n{MAP}",
    "ramp": '[effects.ramp]\nshape = "smooth"',
    "skull": "[effects.skull]\ngap = 5.0",
    "inertia": "[effects.inertia]\nduration = 50.0",
    "bulk_viscosity": "[effects.bulk_viscosity]",
    "fibres": "[effects.fibres]",
}
OF_THE_SHAPE = {  # effects that the geometry brings along
    "symmetry": (PLAIN.replace("PORTION", "octant") + ALONE["contact"], {"contact", "symmetry"}),
    "plane_strain": (
        'name = "plain"\n[geometry]\nshape = "strip"\nlength = 8.0\ndepth = 8.0\n[growth]\nfinal = 1.04\n'
        '[accuracy]\nedge = 2.0\nprecision = "double"\n[output]\nvolume = false\n',
        {"plane_strain"},
    ),
}
#: grows each scene in a process that has loaded no effect, or has forgotten those of the scene before
EACH_ALONE = """
import json, sys
from morphofold.sim.run import simulate
for name in sys.argv[1:]:
    simulate(f"{name}.toml", name, threads=1)
    effects = [m for m in sys.modules if m.startswith("morphofold.sim.effects.")]
    open(f"{name}.json", "w").write(json.dumps([m.rpartition(".")[2] for m in effects]))
    for m in effects:
        del sys.modules[m]
"""


def test_an_effect_is_loaded_and_run_if_and_only_if_its_scene_calls_for_it(tmp_path):
    scenes = {}
    for name, table in ALONE.items():
        portion = "full" if name == "contact" else "octant"  # planes need contact with them, too
        scenes[name] = PLAIN.replace("PORTION", portion) + table, {name} - {"none"}
    scenes |= OF_THE_SHAPE
    for name, (text, _) in scenes.items():
        (tmp_path / f"{name}.toml").write_text(text)
    subprocess.run([sys.executable, "-c", EACH_ALONE, *scenes], cwd=tmp_path, check=True)
    solver = {"elements", "filter", "advance", "balance", "measure", "grow"}
    for name, (_, called) in scenes.items():
        assert set(json.loads((tmp_path / f"{name}.json").read_text())) == called, name
        health = json.loads((tmp_path / name / "health.json").read_text())
        assert set(health["effects"]) == called
        assert set(health["seconds_by_phase"]) - solver <= called, name
        for line in (tmp_path / name / "log.jsonl").read_text().splitlines():
            assert set(json.loads(line)["effects"]) == called, name
    every = {name for _, called in scenes.values() for name in called}
    shipped = {type(effect).__module__.rpartition(".")[2] for effect in build_effects(load_scene("dynamic"))}
    assert shipped < every


def test_the_effects_tested_alone_are_all_there_are():
    from importlib.resources import files

    modules = {p.name.removesuffix(".py") for p in (files("morphofold.sim") / "effects").iterdir() if p.name[0] != "_"}
    assert modules == {*ALONE, *OF_THE_SHAPE, "midline"} - {"none"}  # a midline: test_skull_and_midline
