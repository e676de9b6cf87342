"""The plan of the code: imports between packages, what ships, and what a bare import costs."""

import ast
import importlib.metadata
import importlib.util
import os
import subprocess
import sys
import tomllib
from collections import Counter
from pathlib import Path

import networkx as nx
import pytest

import morphofold
from morphofold.errors import Refusal
from morphofold.studies.import_layers import APART_PAIR, PACKAGE_ORDER, arrows, imports, modules, package_of

ROOT = Path(__file__).resolve().parent.parent
PICTURES_AND_FILES = ("matplotlib", "pyvista", "vtkmodules", "meshio", "nibabel", "trimesh", "morphofold.io")

in_a_checkout = pytest.mark.skipif(not (ROOT / "pyproject.toml").is_file(), reason="needs a checkout")


@in_a_checkout
def test_every_module_is_in_a_package_of_the_list():
    assert {package_of(name) for name, _ in modules()} == set(PACKAGE_ORDER)


@in_a_checkout
def test_a_package_imports_only_what_stands_before_it():
    stands = {name: k for k, name in enumerate(PACKAGE_ORDER)}
    wrong = {
        (name, target)
        for name, target in arrows()
        if stands[package_of(target)] > stands[package_of(name)] or {package_of(name), package_of(target)} == APART_PAIR
    }
    assert wrong == set()


@in_a_checkout
def test_no_files_import_each_other_in_a_circle():
    """Imports in functions and those for types alone count as well."""
    graph = nx.DiGraph(set(arrows()))
    assert [circle for circle in nx.strongly_connected_components(graph) if len(circle) > 1] == []


@in_a_checkout
def test_no_two_files_have_the_same_name():
    """But for the packages' own files, and the commands, which are called what they do."""
    names = Counter(file.name for name, file in modules() if not name.startswith("morphofold.cli."))
    assert [name for name, count in names.items() if count > 1 and name != "__init__.py"] == []


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
def test_every_package_is_listed_but_for_studies_that_no_command_needs():
    config = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["setuptools"]
    there = {name for name, file in modules() if file.name == "__init__.py"} | {"morphofold.data_samples"}
    assert (ROOT / "data_samples" / "__init__.py").is_file()
    of_a_checkout = {f"morphofold.studies.{name}" for name in ("accuracy", "pages", "speed")}  # not of reproduce
    assert set(config["packages"]) == there - of_a_checkout


@in_a_checkout
@pytest.mark.parametrize("name", ["sim", "analysis"])
def test_a_package_refuses_to_be_imported_from_the_top_level(name):
    code = f"import sys; sys.path.insert(0, {str(ROOT)!r}); import {name}"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, check=False)
    assert done.returncode == 1
    assert f"ImportError: this folder is imported as morphofold.{name}" in done.stderr


@in_a_checkout
@pytest.mark.parametrize("name", ["sim", "analysis", "studies"])
def test_both_paths_to_a_package_lead_to_the_same_files(name):
    package = importlib.import_module(f"morphofold.{name}")
    assert package.__file__ is not None
    if not Path(package.__file__).is_relative_to(ROOT):
        pytest.skip("morphofold is installed elsewhere")
    assert Path(package.__file__).samefile(ROOT / name / "__init__.py")


@in_a_checkout
def test_scripts_beside_a_checkout_find_the_package(tmp_path):
    """Python takes any folder of that name for the package, unless there is a better one later on its path."""
    if "morphofold" not in (d.name for d in importlib.metadata.distributions()):
        pytest.skip("morphofold is not installed")
    (tmp_path / "morphofold").symlink_to(ROOT, target_is_directory=True)
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    code = "import morphofold as mf; mf.read_cortex(mf.sample_path('S1'), hemi='lh'); import morphofold.sim"
    subprocess.run([sys.executable, "-c", code], cwd=tmp_path, env=environment, check=True)


def test_type_checkers_are_told_that_the_package_is_typed():
    assert (Path(morphofold.__file__).parent / "py.typed").is_file()


def test_importing_morphofold_loads_none_of_its_dependencies():
    assert loaded_by("import morphofold") == ""


def test_measuring_loads_no_package_that_few_measures_need():
    heavy = ("scipy.signal", "scipy.stats", "scipy.optimize", "networkx", "pandas", "pyvista", "matplotlib", "nibabel")
    assert loaded_by("import morphofold.analysis.measuring", heavy) == ""


def test_help_loads_no_heavy_package():
    cli = importlib.import_module("morphofold.cli") if importlib.util.find_spec("morphofold.cli") else None
    if not hasattr(cli, "main"):
        pytest.skip("no command line yet")
    assert (
        loaded_by("""
from morphofold.cli import main
assert main(["--help"]) == 0
""")
        == ""
    )


def loaded_by(code, heavy=("numpy", "scipy", "pyvista", "trimesh", "numba", "skfem", "nibabel", "pydantic", "meshio")):
    tail = f"\nimport sys; print('LOADED', *[m for m in {heavy!r} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code + tail], capture_output=True, text=True, check=True)
    return done.stdout.rpartition("LOADED")[2].strip()


@in_a_checkout
def test_every_refusal_is_of_a_kind_and_every_kind_refuses_something():
    raised = {
        node.exc.func.id
        for _, file in modules()
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8")))
        if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call) and isinstance(node.exc.func, ast.Name)
    }
    assert "ValueError" not in raised
    assert {kind.__name__ for kind in Refusal.__subclasses__()} <= raised
