"""The notebooks of the tutorials run from beginning to end, and are kept without outputs."""

import importlib.util
import re
from pathlib import Path

import pytest

NOTEBOOKS = Path(__file__).resolve().parent.parent / "docs" / "notebooks"
pytestmark = [
    pytest.mark.skipif(not NOTEBOOKS.is_dir(), reason="needs a checkout"),
    pytest.mark.skipif(
        any(importlib.util.find_spec(name) is None for name in ("nbclient", "ipykernel")),
        reason="nbclient or ipykernel is not installed: pip install -e .[test]",
    ),
]
#: what the outputs of a notebook must show, in this order
SHOWN = {
    "neuroimager": ["Cortex fsaverage5", "Measures of fsaverage5, left", "1.65", "34 regions", "insula", "1.66"],
    "mechanician": ["Forecast", "Simulation demo", "healthy", "wrinkles at g", "{1.3: 1.0", "model", "2.66"],
}
PICTURES = {"neuroimager": 4, "mechanician": 4}


def read(name):
    import nbformat

    return nbformat.read(NOTEBOOKS / f"{name}.ipynb", as_version=4)


def test_every_notebook_is_run():
    assert {path.stem for path in NOTEBOOKS.glob("*.ipynb")} == set(SHOWN)


@pytest.mark.parametrize("name", SHOWN)
def test_a_notebook_is_valid_and_kept_without_outputs(name):
    import nbformat

    notebook = read(name)
    nbformat.validate(notebook)
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert all(cell.outputs == [] and cell.execution_count is None for cell in code)
    assert notebook.metadata["kernelspec"]["name"] == "python3"  # any computer has it


@pytest.mark.slow
@pytest.mark.parametrize("name", SHOWN)
def test_a_notebook_runs_and_shows_its_numbers_and_pictures(name, tmp_path, monkeypatch):
    """In a kernel of its own, in an empty folder, as a person runs it."""
    from nbclient import NotebookClient

    for variable in ("IPYTHONDIR", "JUPYTER_CONFIG_DIR", "JUPYTER_DATA_DIR", "JUPYTER_RUNTIME_DIR"):
        monkeypatch.setenv(variable, str(tmp_path / variable))
    notebook, work = read(name), tmp_path / "work"
    work.mkdir()
    NotebookClient(notebook, timeout=900, kernel_name="python3", resources={"metadata": {"path": str(work)}}).execute()
    outputs = [out for cell in notebook.cells if cell.cell_type == "code" for out in cell.outputs]
    assert [out.text for out in outputs if out.get("name") == "stderr"] == []
    outputs_shown = [out.get("data", {"text/plain": out.get("text", "")}) for out in outputs]
    text = " ".join(data.get("text/html") or data["text/plain"] for data in outputs_shown)
    assert re.search(".*".join(map(re.escape, SHOWN[name])), re.sub(r"base64,[^\"]*", "", text), re.S)
    has_picture = ["image/png" in data or "data:image/png" in data.get("text/html", "") for data in outputs_shown]
    assert sum(has_picture) == PICTURES[name]
