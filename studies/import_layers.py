"""The packages of the code and their order, read from its imports, for the tests and for a picture of the docs.

``python -m morphofold.studies.import_layers docs/packages.png`` draws the picture, in a checkout.
"""

import ast
import importlib.util
import io
import sys
import tokenize
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = {
    "morphofold": ROOT / "morphofold",
    "morphofold.sim": ROOT / "sim",
    "morphofold.analysis": ROOT / "analysis",
    "morphofold.studies": ROOT / "studies",
}
#: packages that stand beside each other, from the ground up: each imports only what is below it, or left of it
LAYERS = (
    ("ground",),
    ("io",),
    ("intersections", "shapes", "unfolding", "spheres", "mesh_quality"),
    ("sim", "analysis"),
    ("simulation",),
    ("comparison", "forecasts", "results"),
    ("report",),
    ("group",),
    ("inference",),
    ("group_pages",),
    ("cli",),
    ("studies",),
)
PACKAGE_ORDER = tuple(name for floor in LAYERS for name in floor)
GROUND_MODULES = (
    "frozen_arrays surface geometry quantities note_texts digests_and_json tables timing kernels threads "
    "progress_callbacks number_texts errors validators lazy optional_packages"
).split()
APART_PAIR = {"sim", "analysis"}  # they meet in a Cortex
PACKAGE_NOTES = {
    "ground": "Surface, Cortex, geometry of triangles, names and units, errors",
    "io": "files in and out",
    "intersections": "exact tests",
    "shapes": "spheres and nets",
    "unfolding": "smooth bodies",
    "spheres": "registered surfaces",
    "mesh_quality": "checks and repair",
    "sim": "scene, mesh, elements, effects, run, health, theory",
    "analysis": "curvature, crests, hinges, thickness, gyrification",
    "simulation": "grow a scene, measure its stages",
    "comparison": "side by side",
    "forecasts": "time and error",
    "results": "folders of analyses",
    "group": "many subjects, sweeps, models over subjects",
    "inference": "growth that would fold like a person",
    "report": "pictures and pages",
    "group_pages": "pages of groups, sweeps, inferences",
    "studies": "the paper's figures, benchmarks, these pages",
    "cli": "commands and their options",
}


NON_CODE_TYPES = (tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER)


def code_lines(source_text: str) -> set[int]:
    """Numbers of the lines of a Python file that are code; texts below fields, as in options, are docstrings, too."""
    line_numbers: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(source_text).readline):
        if token.type not in NON_CODE_TYPES:
            line_numbers.update(range(token.start[0], token.end[0] + 1))
    for node in ast.walk(ast.parse(source_text)):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            line_numbers.difference_update(range(node.lineno, (node.end_lineno or 0) + 1))
    return line_numbers


def modules() -> Iterator[tuple[str, Path]]:
    """Name and file of every module; the tests of the studies are none."""
    for package, folder in PACKAGES.items():
        for module_file in sorted(folder.rglob("*.py")):  # follows no symlinks, so every file comes once
            module_parts = module_file.relative_to(folder).with_suffix("").parts
            if "tests" in module_parts:
                continue
            yield ".".join((package, *module_parts)).removesuffix(".__init__"), module_file


def imports(module_name: str, module_file: Path) -> Iterator[str]:
    """Every name that a module imports, anywhere in it, made absolute."""
    package = module_name if module_file.name == "__init__.py" else module_name.rpartition(".")[0]
    for node in ast.walk(ast.parse(module_file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base_module = importlib.util.resolve_name("." * node.level + (node.module or ""), package)
            yield from (f"{base_module}.{alias.name}" for alias in node.names)


def package_of(module_name: str) -> str:
    """``sim`` of ``morphofold.sim.mesh.brick_mesh``; ``morphofold`` itself is of the ground floor."""
    package = module_name.split(".")[1] if "." in module_name else "ground"
    return {"__main__": "cli"}.get(package, "ground" if package in GROUND_MODULES else package)


def arrows() -> Iterator[tuple[str, str]]:
    """Every pair of modules of which the first imports the second."""
    file_of_module = dict(modules())
    for importer, module_file in file_of_module.items():
        for imported in imports(importer, module_file):
            while imported and imported not in file_of_module:
                imported = imported.rpartition(".")[0]
            if imported not in ("", importer):
                yield importer, imported


def draw(path: Path) -> None:
    """The packages as boxes with their lines of code, and what happens to a scene and to a surface, as PNG."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.patches import FancyBboxPatch

    lines = dict.fromkeys(PACKAGE_ORDER, 0)
    for name, module_file in modules():
        lines[package_of(name)] += len(code_lines(module_file.read_text(encoding="utf-8")))
    top_y = 0.68 * len(LAYERS) + 0.3
    figure = Figure(figsize=(9, top_y + 0.3), dpi=110)
    FigureCanvasAgg(figure)
    axes = figure.add_axes((0, 0, 1, 1), xlim=(0, 9), ylim=(-0.1, top_y + 0.2))
    axes.axis("off")
    for layer_index, layer in enumerate(LAYERS):
        width = 6.0 / len(layer)
        for k, name in enumerate(layer):
            x, y = 1.5 + k * width, 0.1 + 0.68 * layer_index
            box_colour = {"sim": "#fde3cf", "analysis": "#d6e8f7"}.get(name, "#f2f2f2")
            box_style: dict[str, Any] = {"boxstyle": "round,pad=0.02", "facecolor": box_colour, "edgecolor": "#999999"}
            axes.add_patch(FancyBboxPatch((x + 0.06, y), width - 0.12, 0.52, **box_style))
            text_position: dict[str, Any] = {"x": x + width / 2, "ha": "center", "va": "center"}
            axes.text(y=y + 0.36, s=name, weight="bold", size=11 if len(layer) < 4 else 9.5, **text_position)
            content_text = PACKAGE_NOTES[name] if len(layer) < 3 or len(PACKAGE_NOTES[name]) < 24 else ""
            axes.text(y=y + 0.16, s=content_text, size=7.5, color="#444444", **text_position)
            axes.text(x + width - 0.09, y + 0.04, f"{lines[name]:,}", ha="right", va="center", size=7, color="#888888")
    scene_steps = ["scene.toml", "sim.scene", "sim.build: a body", "sim.dynamics", "stages:\na Cortex each"]
    surface_steps = ["lh.white, lh.pial", "io: a Cortex", "analysis:\nMeasures", "comparison", "report: a page"]
    _draw_steps(axes, 0.75, "#c05a12", scene_steps)
    _draw_steps(axes, 8.25, "#1f6fb2", surface_steps)
    axes.text(4.5, top_y, "a package imports only what is below it, or left of it", ha="center", va="center", size=9)
    for x, title in ((0.75, "a scene"), (8.25, "a surface")):
        axes.text(x, top_y, title, ha="center", va="center", size=9, style="italic")
    figure.savefig(path, metadata={"Software": None})


def _draw_steps(axes, x: float, colour: str, step_texts: list[str]) -> None:  # type: ignore[no-untyped-def]
    """Steps from the ground up, with arrows between them."""
    step_heights = [0.4 + 1.5 * k for k in range(len(step_texts))]
    for y, text in zip(step_heights, step_texts):
        axes.text(x, y, text, ha="center", va="center", size=8.5, color=colour)
    for lower_y, upper_y in pairwise(step_heights):
        axes.annotate("", (x, upper_y - 0.25), (x, lower_y + 0.25), arrowprops={"arrowstyle": "->", "color": colour})


if __name__ == "__main__":
    draw(Path(sys.argv[1]))
