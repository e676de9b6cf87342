"""Interactive pages that stand in the site as commands write them: a demo, a person, a grown cortex.

``python -m morphofold.studies.pages.pages_to_try .pages`` makes those that the folder lacks (five minutes on two
cores). As a hook of MkDocs this module adds them to the site, and a page that lists them.
"""

import shutil
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from morphofold.cli import main
from morphofold.io import sample_path

PAGES = {
    "demo": "**The demo**: a cortex that was grown until it folded, a person and an average. `morphofold demo`",
    "person": "**A person**: all that is measured of one hemisphere. `morphofold analyze data_samples/S1`",
    "grown": "**A grown cortex beside what it was unfolded from**: here an average brain; with a subject, a person. "
    "`morphofold simulate hemisphere`, then `morphofold compare`",
}
INTRODUCTION = (
    "Interactive pages as morphofold writes them: one file each, which needs no network. Turn a surface with the "
    "mouse, choose a map, point at a vertex."
)
SETTINGS = ("geometry.subject=fsaverage5", "accuracy.level=draft")


def write_pages(folder: Path) -> None:
    """Make each page that the folder lacks."""
    folder.mkdir(exist_ok=True)
    with TemporaryDirectory() as work:
        grown = ["simulate", "hemisphere", *(word for setting in SETTINGS for word in ("--set", setting))]
        commands = {
            "demo": [["demo", "-o", f"{work}/demo"]],
            "person": [["analyze", str(sample_path("S1")), "-o", f"{work}/person"]],
            "grown": [
                [*grown, "-o", f"{work}/run"],
                ["analyze", f"{work}/run", "-o", f"{work}/cortex"],
                ["analyze", str(sample_path("fsaverage5")), "--hemi", "lh", "-o", f"{work}/subject"],
                ["compare", f"grown={work}/cortex", f"average={work}/subject", "-o", f"{work}/grown"],
            ],
        }
        report = {"demo": "demo/comparison", "person": "person", "grown": "grown"}
        for name, lines in commands.items():
            page = folder / f"{name}.html"
            if not page.exists():
                codes = [main(line) for line in lines]
                if any(codes):
                    raise SystemExit(max(codes))
                shutil.copyfile(f"{work}/{report[name]}/report.html", page)


def on_files(files: Any, *, config: Any) -> Any:
    """Hook of MkDocs: add the pages that were made, and the page that lists them."""
    from mkdocs.structure.files import File

    lines = ["# Pages to try", "", INTRODUCTION, "", "![The page of the demo](demo.png)", ""]
    for name, text in PAGES.items():
        page = Path(config["docs_dir"]).parent / ".pages" / f"{name}.html"
        if page.exists():
            files.append(File.generated(config, f"try/{name}.html", abs_src_path=str(page)))
        lines.append(f"- {text}: [open it](try/{name}.html)" if page.exists() else f"- {text}")
    files.append(File.generated(config, "pages-to-try.md", content="\n".join(lines) + "\n"))
    return files


if __name__ == "__main__":
    write_pages(Path(sys.argv[1]))
