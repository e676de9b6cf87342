"""The gallery: each script of examples/ with its picture and what it prints.

``python -m morphofold.studies.pages.gallery examples docs/gallery`` runs every example (some minutes); its picture and
its output go to the second folder, the list of all to README.md in the first. As a hook of MkDocs this module makes a
page and a notebook of each example.
"""

import ast
import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

from PIL import Image

from morphofold.digests_and_json import strict_json
from morphofold.io.files import write_text

ORDER = {
    "Grow": (
        "wrinkles_of_a_strip figure_5_in_six_pictures crease_at_a_notch ellipsoid_folds growth_by_a_map "
        "person_unfolded theory_of_wrinkles stress_through_the_cortex price_of_a_run"
    ),
    "Measure": (
        "curvature_of_a_torus hinges_of_a_person hinges_of_a_known_net local_gyrification gyral_thickness_by_region "
        "areas_beside_freesurfer wavelength_of_a_bumpy_sphere folding_across_scales"
    ),
    "Compare": "model_beside_brain group_difference nilearn_plots",
    "Extend": "material_of_your_own effect_of_your_own measure_of_your_own",
}
WIDTH_PX = 1000  # of a picture, at most
INTRODUCTION = (
    "One idea each, with a picture and one number beside its known value, which the tests hold. Run one in an empty "
    "folder: `python ../morphofold/examples/curvature_of_a_torus.py`."
)


class Example(NamedTuple):
    """A script: its name, and title, idea and code as it stands there."""

    name: str
    title: str
    idea: str
    code: str


def read_example(script: Path) -> Example:
    """An example from its file, whose docstring has the title in its first line, then the idea."""
    text = script.read_text("utf-8")
    statements = ast.parse(text).body
    title, _, idea = (ast.get_docstring(ast.parse(text)) or "").partition("\n")
    code = "\n".join(text.splitlines()[statements[0].end_lineno or 0 :]).strip() + "\n"
    return Example(script.stem, title.rstrip("."), " ".join(idea.split()), code)


def run_example(script: Path, folder: Path) -> str:
    """Run a script in an empty folder, keep its picture in ``folder``, and return what it printed."""
    with TemporaryDirectory() as work:
        command, env = [sys.executable, str(script.resolve())], {**os.environ, "MPLBACKEND": "Agg"}
        printed = subprocess.run(command, cwd=work, env=env, stdout=subprocess.PIPE, text=True, check=True).stdout
        picture = Image.open(Path(work) / f"{script.stem}.png").convert("RGB")
    picture.thumbnail((WIDTH_PX, WIDTH_PX))
    picture.quantize(256).save(folder / f"{script.stem}.png", optimize=True)
    return printed


def write_gallery(examples: Path, folder: Path, only: Sequence[str] = ()) -> None:
    """Run all examples, or only those named, and write their pictures and outputs, and README.md beside the scripts."""
    folder.mkdir(exist_ok=True)
    for name in only or " ".join(ORDER.values()).split():
        write_text(folder / f"{name}.txt", run_example(examples / f"{name}.py", folder))
    write_text(examples / "README.md", gallery_page(examples, "../docs/gallery/", ".py"))


def gallery_page(examples: Path, pictures: str, ending: str) -> str:
    """A table of pictures and titles for each part, linked to scripts or, in the site, to their pages."""
    lines = ["# Gallery", "", INTRODUCTION, ""]
    target = "gallery/" if ending == ".md" else ""
    for part, names in ORDER.items():
        cells = []
        for name in names.split():
            title = read_example(examples / f"{name}.py").title
            cells.append(
                f"[![{title}]({pictures}{name}.png)]({target}{name}{ending}) [{title}]({target}{name}{ending})"
            )
        rows = [cells[k : k + 3] for k in range(0, len(cells), 3)]
        rows[-1] += [""] * (3 - len(rows[-1]))
        lines += [f"## {part}", "", "| | | |", "| --- | --- | --- |", *(f"| {' | '.join(row)} |" for row in rows), ""]
    return "\n".join(lines)


def page_of(example: Example, printed: str) -> str:
    """The page of an example in the site."""
    parts = [
        f"# {example.title}",
        example.idea,
        f"![{example.title}]({example.name}.png)",
        f"```text\n{printed}```",
        f"```python\n{example.code}```",
        f"[As a notebook]({example.name}.ipynb)",
    ]
    return "\n\n".join(parts) + "\n"


def notebook_of(example: Example) -> str:
    """An example as a notebook, without outputs; its last cell shows the picture."""
    show = f'from IPython.display import Image\n\nImage("{example.name}.png")'
    cells: list[dict[str, Any]] = [_cell("markdown", f"# {example.title}\n\n{example.idea}", 0)]
    cells += [_cell("code", code, k) for k, code in enumerate((example.code, show), 1)]
    kernel = {"name": "python3", "display_name": "Python 3", "language": "python"}
    return strict_json({"cells": cells, "metadata": {"kernelspec": kernel}, "nbformat": 4, "nbformat_minor": 5})


def _cell(kind: str, source: str, number: int) -> dict[str, Any]:
    of_code: dict[str, Any] = {"outputs": [], "execution_count": None} if kind == "code" else {}
    return {"cell_type": kind, "id": f"cell-{number}", "metadata": {}, "source": source.strip(), **of_code}


def generated(root: Path) -> Iterator[tuple[str, str]]:
    """Path and content of every file of the gallery that the site has beside pictures."""
    examples, folder = root / "examples", root / "docs" / "gallery"
    yield "gallery.md", gallery_page(examples, "gallery/", ".md")
    for name in " ".join(ORDER.values()).split():
        example = read_example(examples / f"{name}.py")
        yield f"gallery/{name}.md", page_of(example, (folder / f"{name}.txt").read_text("utf-8"))
        yield f"gallery/{name}.ipynb", notebook_of(example)


def on_files(files: Any, *, config: Any) -> Any:
    """Hook of MkDocs: add the files of the gallery."""
    from mkdocs.structure.files import File

    for path, content in generated(Path(config["docs_dir"]).parent):
        files.append(File.generated(config, path, content=content))
    return files


if __name__ == "__main__":
    write_gallery(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3:])
