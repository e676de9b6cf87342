"""What commands write, as text: names of files, columns, keys, and numbers to three digits; and forces of the solver.

After a change that is meant, ``MORPHOFOLD_RENEW_PAGES=1 pytest tests/test_golden_outputs.py`` writes them again.
"""

import json
import math
import os
from itertools import zip_longest
from pathlib import Path

import numpy as np
import pytest

from morphofold.cli import main
from morphofold.io import write_annotation, write_label, write_surface
from morphofold.sim.body import Body
from morphofold.sim.materials.mooney_rivlin import MooneyRivlin
from morphofold.sim.materials.neo_hookean import NeoHookean
from morphofold.sim.mesh.brick_mesh import bilayer_sphere
from morphofold.studies.folded_ball import folded_ball
from morphofold.surface import Regions

GOLDEN = Path(__file__).parent / "golden"
RENEW = "MORPHOFOLD_RENEW_PAGES"
#: keys whose values are of this run, machine or version; what is below them is left out, too
VARY = set(
    "morphofold time date inputs cost packages folder Version sha256 seconds written notes stages memory_GiB".split()
)


def cell(text):
    """A cell of a table or a value; numbers with three digits."""
    try:
        number = float(text)
    except (TypeError, ValueError):
        return str(text)
    return f"{number:.3g}" if math.isfinite(number) else str(text)


def json_lines(content, name):
    if isinstance(content, dict):
        for key, value in content.items():
            yield from [f"{name}.{key} ..."] if VARY & {key} else json_lines(value, f"{name}.{key}")
    elif isinstance(content, list) and content:
        yield f"{name}: {len(content)} items"
        yield from json_lines(content[0], f"{name}[0]")
    else:
        yield f"{name}: {cell(content)}"


def folder_lines(folder):
    """Files of a folder; of tables the columns and the first row, of JSON its keys and values."""
    for file in sorted(path for path in folder.rglob("*") if path.is_file()):
        yield f"--- {file.relative_to(folder)}"
        if file.suffix == ".tsv":
            head, *rows = [line.split("\t") for line in file.read_text(encoding="utf-8").splitlines()]
            yield f"{len(rows)} rows"
            yield from (f"{name}: {cell(value)}" for name, value in zip(head, rows[0] if rows else head, strict=True))
        elif file.suffix == ".json" and file.name != "cost.json":
            yield from json_lines(json.loads(file.read_text(encoding="utf-8")), "")


def analyses(folder):
    """Both layouts of one body, every measure, and a comparison."""
    cortex, subject = folded_ball(2500), folder / "ball"
    for name in ("surf", "label"):
        (subject / name).mkdir(parents=True)
    write_surface(subject / "surf" / "lh.white", cortex.white)
    write_surface(subject / "surf" / "lh.pial", cortex.pial)
    upper = (cortex.white.verts[:, 2] > 0).astype(np.int64)
    colours = np.array([[20, 30, 40], [200, 100, 50]], dtype=np.uint8)
    write_annotation(subject / "label" / "lh.aparc.annot", Regions(upper, ("below", "above"), colours))
    write_label(subject / "label" / "lh.cortex.label", cortex.white.verts[:, 0] < 50, cortex.white.verts)
    pair = ["analyze", "ball", "-q", "--no-report"]
    assert main([*pair, "-o", "plain", "--wide", "--mgh"]) == 0
    assert main([*pair, "-o", "bids", "--layout", "bids"]) == 0
    assert main(["compare", "a=plain", "b=bids/sub-ball", "-q", "-o", "compared"]) == 0
    for name in ("plain", "bids"):
        yield from folder_lines(folder / name)
    yield from json_lines(json.loads((folder / "compared" / "comparison.json").read_text(encoding="utf-8")), "compared")


def forces(materials):
    """Root of the mean square of forces, energy and smallest J, by material, growth law, growth and deformation."""
    random = np.random.default_rng(0)
    bilayer = bilayer_sphere(50, 3, 25, "octant", 6)
    for material in materials:
        for law in ("isotropic", "tangential"):
            body = Body(bilayer, mu_cortex=2.0, mu_core=1.0, kappa_ratio=50.0, law=law, material=material)
            for g in (1.0, 1.4, 0.9):
                body.grow(g)
                for amplitude in (0.01, 0.6):
                    x = body.X + amplitude * random.standard_normal(body.X.shape)
                    force = np.sqrt(np.mean(body.forces(x) ** 2))
                    body.update_state(x)
                    state = [np.mean(values) for values in body.elements.state().values()]
                    yield [float(f"{value:.12g}") for value in (force, *state)]


def test_what_commands_write_is_as_it_was(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    lines, file = list(analyses(tmp_path)), GOLDEN / "outputs.txt"
    if os.environ.get(RENEW):
        file.write_text("\n".join(lines) + "\n", encoding="utf-8")
    for k, (line, golden) in enumerate(zip_longest(lines, file.read_text(encoding="utf-8").splitlines()), start=1):
        assert line == golden, f"line {k} differs; renew it if that is meant ({RENEW}=1)"


@pytest.mark.slow  # compiles the kernels for a second material
def test_forces_of_both_materials_are_as_they_were():
    rows, file = list(forces([NeoHookean(), MooneyRivlin(0.4)])), GOLDEN / "forces.txt"
    if os.environ.get(RENEW):
        file.write_text("".join(" ".join(map(repr, row)) + "\n" for row in rows), encoding="utf-8")
    np.testing.assert_allclose(rows, np.loadtxt(file), rtol=1e-9)


def test_forces_are_as_they_were_and_a_change_of_a_column_or_a_force_is_seen(tmp_path):
    (tmp_path / "a.tsv").write_text("hemi\tH\nlh\t1.2345\n")
    assert list(folder_lines(tmp_path)) == ["--- a.tsv", "1 rows", "hemi: lh", "H: 1.23"]
    rows = list(forces([NeoHookean()]))
    golden = np.loadtxt(GOLDEN / "forces.txt")[: len(rows)]
    np.testing.assert_allclose(rows, golden, rtol=1e-9)
    with pytest.raises(AssertionError):
        np.testing.assert_allclose(rows, golden * (1 + 1e-8), rtol=1e-9)
