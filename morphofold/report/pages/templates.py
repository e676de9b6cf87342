"""Writes a page from its template: one file that opens offline, with every name escaped; and the pictures beside it."""

from __future__ import annotations

import base64
import hashlib
import platform
from collections.abc import Sequence
from functools import cache
from importlib import metadata, resources
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, select_autoescape
from markupsafe import Markup

from morphofold.provenance import CONTROLS
from morphofold.quantities import scalar_words
from morphofold.report.pictures.sheet import Picture, halved, png_bytes, safe_name
from morphofold.words import number, percent, span

REPORTED_PACKAGES = ("morphofold", "numpy", "scipy", "trimesh", "nibabel", "networkx", "numba", "pyvista")
SIDES = {"lh": "left", "rh": "right"}


def write_page(path: Path, template: str, scripts: Sequence[str] = (), **values: Any) -> Path:
    """Render ``template`` with ``values`` and write the page; it may run only these ``scripts``."""
    folder = resources.files("morphofold.report").joinpath("templates")
    script = "\n".join(folder.joinpath(name).read_text(encoding="utf-8") for name in scripts)
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    policy = f"'sha256-{digest}'" if scripts else ""
    page = render(template, script=Markup(script), policy=policy, **values)
    path.write_text(CONTROLS.sub("\ufffd", page), encoding="utf-8", errors="backslashreplace")
    return path


def write_picture(path: Path, image: Picture, title: str, **values: Any) -> dict[str, Any]:
    """Write a picture; return what a template needs to show it at half size, with more ``values``."""
    path.write_bytes(png_bytes(image))
    return {"title": title, **picture_entry(path, png_bytes(halved(image))), **values}


def picture_entry(path: Path, png: bytes) -> dict[str, Any]:
    """The file of a picture, from the folder of the page, and its data."""
    return {"file": f"{path.parent.name}/{path.name}", "data": base64.b64encode(png).decode()}


def versions() -> list[tuple[str, str]]:
    """Name and version of the packages that the numbers depend on."""

    def version(name: str) -> str:
        try:
            return metadata.version(name)
        except metadata.PackageNotFoundError:
            return "not installed as a package"

    return [*((name, version(name)) for name in REPORTED_PACKAGES), ("Python", platform.python_version())]


def plural(n: int, word: str) -> str:
    """A number of things: ``1 subject``, ``2 subjects``."""
    return f"{number(n)} {word}{'' if n == 1 else 's'}"


#: what every template may call
FUNCTIONS = {f.__name__: f for f in (number, percent, plural, safe_name, scalar_words, span, versions)}
FILTERS = {
    "short": lambda x: f"{x:.4g}".replace("-", "−"),
    "px": lambda x: f"{x:.2f}".rstrip("0").rstrip("."),
    "side": lambda hemi, other="": SIDES.get(hemi, other),
}


def render(template: str, **values: Any) -> str:
    """HTML of a template with ``values``."""
    return _template_environment().get_template(template).render(**values)


@cache
def _template_environment() -> Environment:
    """The templates of the report, all with escaping."""
    env = Environment(
        loader=PackageLoader("morphofold.report", "templates"),
        autoescape=select_autoescape(default=True, default_for_string=True),
        trim_blocks=True,
        lstrip_blocks=True,
    )
    env.globals.update(FUNCTIONS)
    env.filters.update(FILTERS)
    return env
