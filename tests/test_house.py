"""The plan of the house: arrows between rooms, what ships, and what a bare import costs."""

import ast
import importlib.util
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import morphofold

ROOT = Path(__file__).resolve().parent.parent
ROOMS = {
    "morphofold": ROOT / "morphofold",
    "morphofold.sim": ROOT / "sim",
    "morphofold.analysis": ROOT / "analysis",
}

# who may not be imported by whom; a name stands for itself and all below it
GROUND = ("clock", "crossings", "records", "surface", "io", "shapes", "tables", "threads")
UPSTAIRS = ("results", "comparison", "simulation", "report", "accuracy", "forecasts", "cohort")
FORBIDDEN = {
    **{room: ("sim", "analysis", *UPSTAIRS, "cli") for room in GROUND},
    "sim": ("analysis", *UPSTAIRS, "cli"),
    "analysis": ("sim", *UPSTAIRS, "cli"),
    **{room: ("cli",) for room in UPSTAIRS},
}
PICTURES_AND_FILES = ("matplotlib", "pyvista", "vtkmodules", "meshio", "nibabel", "trimesh", "morphofold.io")

in_a_checkout = pytest.mark.skipif(not (ROOT / "pyproject.toml").is_file(), reason="needs a checkout")


def modules():
    """Name and file of every module of the three rooms."""
    for package, folder in ROOMS.items():
        for file in sorted(folder.rglob("*.py")):     # follows no symlinks, so every file comes once
            inside = file.relative_to(folder).with_suffix("").parts
            yield ".".join((package, *inside)).removesuffix(".__init__"), file


def imports(name, file):
    """Every name that a module imports, anywhere in it, made absolute."""
    package = name if file.name == "__init__.py" else name.rpartition(".")[0]
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = importlib.util.resolve_name("." * node.level + (node.module or ""), package)
            yield from (f"{base}.{alias.name}" for alias in node.names)


def room(name):
    """``sim`` of ``morphofold.sim.mesh.bilayer``; empty for other packages and for the front hall itself."""
    return name.split(".")[1] if name.startswith("morphofold.") else ""


@in_a_checkout
def test_every_room_is_looked_at():
    rooms = {room(name) for name, _ in modules()}
    assert {"surface", "io", "shapes", "sim", "analysis"} <= rooms


@in_a_checkout
def test_imports_point_one_way_through_the_house():
    wrong = [
        f"{name} imports {imported}"
        for name, file in modules()
        for imported in imports(name, file)
        if room(imported) in FORBIDDEN.get(room(name), ())
    ]
    assert not wrong


@in_a_checkout
def test_kernels_know_neither_pictures_nor_file_formats():
    wrong = [
        f"{name} imports {imported}"
        for name, file in modules()
        if name.rpartition(".")[2].strip("_").endswith("kernels")
        for imported in imports(name, file)
        if any(imported == p or imported.startswith(p + ".") for p in PICTURES_AND_FILES)
    ]
    assert not wrong


@in_a_checkout
def test_every_folder_with_an_init_is_a_listed_package():
    config = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["setuptools"]
    there = {name for name, file in modules() if file.name == "__init__.py"} | {"morphofold.data_samples"}
    assert (ROOT / "data_samples" / "__init__.py").is_file()
    assert set(config["packages"]) == there


@in_a_checkout
@pytest.mark.parametrize("name", ["sim", "analysis"])
def test_a_room_refuses_to_be_imported_from_the_top_level(name):
    code = f"import sys; sys.path.insert(0, {str(ROOT)!r}); import {name}"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, check=False)
    assert done.returncode == 1
    assert f"ImportError: this folder is imported as morphofold.{name}" in done.stderr


@in_a_checkout
@pytest.mark.parametrize("name", ["sim", "analysis"])
def test_both_ways_to_a_room_lead_to_the_same_files(name):
    package = importlib.import_module(f"morphofold.{name}")
    assert package.__file__ is not None
    if not Path(package.__file__).is_relative_to(ROOT):
        pytest.skip("morphofold is installed elsewhere")
    assert Path(package.__file__).samefile(ROOT / name / "__init__.py")


def test_type_checkers_are_told_that_the_package_is_typed():
    assert (Path(morphofold.__file__).parent / "py.typed").is_file()


def test_importing_morphofold_loads_none_of_its_dependencies():
    assert loaded_by("import morphofold") == ""


def test_help_loads_no_heavy_package():
    cli = importlib.import_module("morphofold.cli") if importlib.util.find_spec("morphofold.cli") else None
    if not hasattr(cli, "main"):
        pytest.skip("no command line yet")
    assert loaded_by("""
from morphofold.cli import main
assert main(["--help"]) == 0
""") == ""  # fmt: skip


def loaded_by(code):
    heavy = ("numpy", "scipy", "pyvista", "trimesh", "numba", "skfem", "nibabel", "pydantic", "meshio")
    tail = f"\nimport sys; print('LOADED', *[m for m in {heavy!r} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code + tail], capture_output=True, text=True, check=True)
    return done.stdout.rpartition("LOADED")[2].strip()
