"""Writes a page from its template: one file that opens offline, with every name escaped; and the pictures beside it.

In go the values of a page, out come its file and what it shows of a picture; the other modules of this folder call it.
Also the methods paragraph of a page, from what it shows and the scales that were used. Its sentences are in
``templates/methods.txt``, with the references that they cite.
"""

import base64
import hashlib
import platform
from collections.abc import Callable, Iterable, Mapping, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader
from markupsafe import Markup

from morphofold import __version__
from morphofold.analysis.measures_result import Measures
from morphofold.digests_and_json import CONTROL_PATTERN
from morphofold.number_texts import number, percent, span
from morphofold.quantities import COLUMN_WORDS, scalar_words
from morphofold.report.pictures.pixel_canvas import Picture, halved, in_page, png_bytes, safe_name

REPORTED_PACKAGES = ("numpy", "scipy", "trimesh", "nibabel", "networkx", "numba", "pyvista")
SIDES = {"lh": "left", "rh": "right"}
PictureEntry = dict[str, Any]  # title, file and data of a picture, and what else a template says of it
Pictures = list[PictureEntry]
REFERENCES = "References, of which those are listed that the text names\n"
MOST_VALUES_LISTED = 3  # values of a scale; of more, the least and the greatest


def write_page(path: Path, template_name: str, scripts: Sequence[str] = (), **template_values: Any) -> Path:
    """Render a template with ``template_values`` and write the page; it may run only these ``scripts``."""
    script = "\n".join(LOADER.get_source(TEMPLATES, script_name)[0] for script_name in scripts)
    script_hash = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    html = render(template_name, script=Markup(script), digest=script_hash, **template_values)
    path.write_text(CONTROL_PATTERN.sub("\ufffd", html), encoding="utf-8", errors="backslashreplace")
    return path


def write_picture(path: Path, image: Picture, title: str, **more_fields: Any) -> PictureEntry:
    """Write a picture; return what a template needs to show it at half size, with ``more_fields``."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(png_bytes(image))
    return picture_entry(path, png_bytes(halved(image)), title, **more_fields)


def picture_entry(path: Path, png: bytes, title: str, **more_fields: Any) -> PictureEntry:
    """What a template needs to show a picture: its file, from the folder of the page, its data, and ``more_fields``."""
    return {"title": title, "file": f"{path.parent.name}/{path.name}", "data": in_page(png), **more_fields}


def versions() -> list[tuple[str, str]]:
    """Name and version of the packages that the numbers depend on, morphofold first."""
    package_versions = ((name, metadata.version(name)) for name in REPORTED_PACKAGES)
    return [("morphofold", __version__), *package_versions, ("Python", platform.python_version())]


def plural(count: int, word: str) -> str:
    """A number of things: ``1 subject``, ``2 subjects``."""
    return f"{number(count)} {word}{'' if count == 1 else 's'}"


LOADER = PackageLoader("morphofold.report", "templates")
TEMPLATES = Environment(loader=LOADER, autoescape=True, trim_blocks=True, lstrip_blocks=True)
TEMPLATES.globals |= {f.__name__: f for f in (number, percent, plural, safe_name, scalar_words, span, versions)}
TEMPLATES.globals["column_meaning"] = lambda key: COLUMN_WORDS.get(key, "")
#: each file of the folder is a section of the page of an analysis and of a comparison
TEMPLATES.globals["own_sections"] = lambda: [name for name in LOADER.list_templates() if name.startswith("sections/")]
TEMPLATES.filters |= {
    "short": lambda x: f"{x:.4g}".replace("-", "−"),
    "px": lambda x: f"{x:.2f}".rstrip("0").rstrip("."),
    "side": lambda hemi, other="": SIDES.get(hemi, other),
    "rule": lambda mask: mask.rpartition(", ")[0],  # by which a cortex was marked
    "resampled": lambda s: s["accuracy_vertices"] if s["accuracy_vertices"] != s["n_vertices"] else None,
    "atlas": lambda s: (s["annotation"].removesuffix(f".{s['annotation_from']}"), s["annotation_from"] or ""),
}


def render(template_name: str, **template_values: Any) -> str:
    """HTML of a template with ``template_values``."""
    return TEMPLATES.get_template(template_name).render(**template_values)


# methods -----------------------------------------------------------------------------------------------------


def methods_of(measures: Iterable[Measures], **page_values: Any) -> tuple[str, list[str]]:
    """How cortices were measured, in one paragraph, and the references it cites; ``page_values`` go to the template."""
    settings, measured_names = [], set[str]()
    for measured in measures:
        cortex = measured.cortex
        cortex_settings = {
            **measured.parameters,
            "origin": cortex.origin,
            "n_vertices": cortex.n_vertices,
            "annotation": measured.regions and cortex.regions and cortex.regions.name,
            "annotation_from": cortex.info.get("annotation_from"),
        }
        settings.append(cortex_settings)
        measured_names.update(measured.maps, (key for key, value in measured.scalars.items() if value is not None))
    return paragraph(settings, measured_names, **page_values)


def paragraph(settings: Sequence[Mapping[str, Any]], measured_names: set[str], **values: Any) -> tuple[str, list[str]]:
    """How white and pial surfaces were measured, as one paragraph, and the references that it cites.

    ``settings`` are parameters of measures with ``origin``, ``n_vertices``, ``annotation`` and ``annotation_from``.
    ``measured_names`` are maps and scalars that any surface has; methods of others are left out. ``values`` go to the
    template.
    """
    text = render(
        "methods.txt",
        has=lambda *any_of: not measured_names or not measured_names.isdisjoint(any_of),
        listed=_listed,
        settings=settings,
        **values,
    )
    methods_text, _, references_text = text.partition(REFERENCES)
    reference_rows = [row_text.split(" | ") for row_text in references_text.strip().splitlines()]
    return Markup(" ".join(methods_text.split())), [work for name, work in reference_rows if name in methods_text]


def _listed(values: Iterable[float], text_of: Callable[[float], str]) -> str:
    """``a``, ``a or b``, or ``a to z`` if there are more than three; a text is given once."""
    texts = [*dict.fromkeys(map(text_of, sorted(map(float, values))))]
    return f"{texts[0]} to {texts[-1]}" if len(texts) > MOST_VALUES_LISTED else " or ".join(texts)
