"""Writes a page from its template: one file that opens offline, with every name escaped."""

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
from morphofold.words import number

REPORTED_PACKAGES = ("morphofold", "numpy", "scipy", "trimesh", "nibabel", "networkx", "numba", "pyvista")


def write_page(path: Path, template: str, scripts: Sequence[str] = (), **values: Any) -> Path:
    """Render ``template`` with ``values`` and write the page; it may run only these ``scripts``."""
    folder = resources.files("morphofold.report").joinpath("templates")
    script = "\n".join(folder.joinpath(name).read_text(encoding="utf-8") for name in scripts)
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    policy = f"'sha256-{digest}'" if scripts else ""
    page = render(template, script=Markup(script), policy=policy, versions=versions(), **values)
    path.write_text(CONTROLS.sub("\ufffd", page), encoding="utf-8", errors="backslashreplace")
    return path


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
    env.globals["number"] = number
    env.filters["short"] = lambda x: f"{x:.4g}".replace("-", "−")
    env.filters["px"] = lambda x: f"{x:.2f}".rstrip("0").rstrip(".")
    return env


def versions() -> list[tuple[str, str]]:
    """Name and version of the packages that the numbers depend on."""

    def version(name: str) -> str:
        try:
            return metadata.version(name)
        except metadata.PackageNotFoundError:
            return "not installed as a package"

    return [*((name, version(name)) for name in REPORTED_PACKAGES), ("Python", platform.python_version())]
