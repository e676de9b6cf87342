"""An analysis as one subject of a BIDS derivatives dataset: ``write_dataset``.

Names follow the derivatives of the Brain Imaging Data Structure (Gorgolewski and others, Sci. Data 3, 160044, 2016;
https://bids-specification.readthedocs.io): ``sub-NAME/anat/sub-NAME_hemi-L_desc-gyral_thickness.shape.gii``, each
with a JSON file that says what it holds. What BIDS has no suffix for is a ``_morph``.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from morphofold.analysis.measures import SCALARS, Measures
from morphofold.io import atomic_file, atomic_folder, flip_curvature_sign, write_gifti_map
from morphofold.io.gifti import write_gifti_surface
from morphofold.records import strict_json
from morphofold.report.quantities import column_words, quantity
from morphofold.results import COLUMNS, checked_inputs, summary_of
from morphofold.surface import Cortex, Surface, Verts
from morphofold.tables import write_table

SIDES = {"lh": "L", "rh": "R"}
MAPS = {  # a map's name -> the end of its file's name
    "H": "curv", "cortical_thickness": "thickness", "gyral_thickness": "desc-gyral_thickness",
    "thickness_file": "desc-input_thickness", "area": "area",
}  # fmt: skip
CURV = "Mean curvature of the pial surface, positive in sulci (FreeSurfer's sign)"
MISSING = "NaN where there is no value, as on the medial wall"
IGNORED = "*.html\nfigures/\n*_morph.*\n*_provenance.json\n"
LEVELS = {"hemi": {"lh": "left", "rh": "right"}}


def write_dataset(
    measures: Sequence[Measures],
    dataset: str | Path,
    name: str,
    *,
    parameters: Mapping[str, Any] | None = None,
    report: bool = True,
    stages: Sequence[Cortex] = (),
) -> Path:
    """Write an analysis as a subject of a BIDS derivatives dataset, whole or not at all.

    Parameters
    ----------
    measures : sequence of Measures
        One hemisphere, or a left and a right one.
    dataset : str or path
        Folder of the dataset: new, empty, or one that this function wrote; its other subjects stay.
    name : str
        The subject's; BIDS leaves letters and digits of it, and what an earlier run wrote of that name is replaced.
    parameters : mapping, optional
        Recorded for the whole run.
    report : bool
        Whether to draw figures/*.png and report.html.
    stages : sequence of Cortex
        As for ``write_analysis``.

    Returns
    -------
    Path
        ``dataset/sub-NAME``.

    Raises
    ------
    ValueError
        As ``write_analysis``; or if nothing is left of ``name``.
    FileExistsError
        If ``dataset`` or ``sub-NAME`` in it is something else, or of a subject whose other name shortens to the same.

    Notes
    -----
    Surfaces and hinges are in scanner coordinates where the surfaces' footer leads there, as other BIDS software
    expects of GIFTI, and else where they were; ``inflated`` never moves. ``curv`` has FreeSurfer's sign, all else is
    positive where convex.
    """
    dataset = Path(dataset)
    place = subject_place(dataset, name)
    records = checked_inputs(measures, place)
    with atomic_folder(place) as folder:
        anat = folder / "anat"
        anat.mkdir()
        for m in measures:
            _write_hemisphere(m, anat, place.name)
        tables = {key: [row for m in measures for row in getattr(m, key)] for key in COLUMNS}
        tables["hinges"] = [row for m in measures for row in _moved_rows(m)]
        for key, columns in COLUMNS.items():
            _write_table(anat / f"{place.name}_desc-{key}_morph.tsv", columns, tables[key])
        scalars = [{"hemi": m.cortex.hemi, **m.scalars} for m in measures]
        _write_table(anat / f"{place.name}_desc-surfaces_morph.tsv", ("hemi", *SCALARS), scalars)
        said = {"subject": name, **summary_of(measures, records, parameters), "nan": f"{MISSING}; n/a in tables"}
        (anat / f"{place.name}_desc-morphofold_provenance.json").write_text(strict_json(said), encoding="utf-8")
        if report:
            from morphofold.report import analysis_report

            grown = [Measures(cortex, {}, {}) for cortex in stages]
            analysis_report(measures, folder / "report.html", inputs=records, stages=grown)
    _describe(dataset)
    return place


def subject_place(dataset: Path, name: str) -> Path:
    """Where in a dataset a subject of this name is written; raises as ``write_dataset`` says."""
    label = "".join(c for c in name.removeprefix("sub-") if c.isascii() and c.isalnum())
    if not label:
        raise ValueError(f"{name!r}: BIDS names subjects by letters and digits, and it has none. Pass another name.")
    if dataset.exists():
        names = sorted(p.name for p in dataset.iterdir() if not p.name.startswith(".")) if dataset.is_dir() else ["it"]
        if names and not _ours(dataset):
            raise FileExistsError(
                f"{dataset}: is not a BIDS dataset that morphofold wrote, whose dataset_description.json says so. "
                "Name such a one, or a new folder."
            )
    place = dataset / f"sub-{label}"
    known = _json(place / "anat" / f"{place.name}_desc-morphofold_provenance.json").get("subject", name)
    if known != name:
        raise FileExistsError(f"{place}: holds {known!r}, and BIDS shortens {name!r} to the same. Pass another name.")
    return place


def _ours(dataset: Path) -> bool:
    said = _json(dataset / "dataset_description.json")
    makers = said.get("GeneratedBy")
    made = isinstance(makers, list) and any(isinstance(m, dict) and m.get("Name") == "morphofold" for m in makers)
    return made and said.get("DatasetType") == "derivative"


def _json(path: Path) -> dict[str, Any]:
    """Content of a JSON object; empty if there is none to be read."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return {}
    return content if isinstance(content, dict) else {}


def _describe(dataset: Path) -> None:
    """Write what makes a folder a dataset; of one that is ours already only the version that wrote last."""
    import morphofold

    me = {"Name": "morphofold", "Version": morphofold.__version__}
    path = dataset / "dataset_description.json"
    if _ours(dataset):
        said = _json(path)
        said["GeneratedBy"] = [m for m in said["GeneratedBy"] if m.get("Name") != "morphofold"] + [me]
    else:
        said = {
            "Name": "Cortical morphometry by morphofold", "BIDSVersion": "1.10.0", "DatasetType": "derivative",
            "GeneratedBy": [me],
        }  # fmt: skip
        with atomic_file(dataset / ".bidsignore") as file:
            file.write_text(IGNORED, encoding="utf-8")
    with atomic_file(path) as file:
        file.write_text(strict_json(said), encoding="utf-8")


def _write_hemisphere(m: Measures, anat: Path, subject: str) -> None:
    """Surfaces and maps of one hemisphere, each map with what it is."""
    cortex, stem = m.cortex, f"{subject}_hemi-{SIDES[m.cortex.hemi]}"
    to = cortex.transform
    for kind, surface in (("white", cortex.white), ("pial", cortex.pial)):
        moved = surface if to is None else Surface(_moved(surface.verts, to), surface.faces, surface.name)
        write_gifti_surface(anat / f"{stem}_{kind}.surf.gii", moved, cortex.hemi, scanner=to is not None)
    if cortex.inflated is not None:
        nowhere = replace(cortex.inflated, geometry=None)
        write_gifti_surface(anat / f"{stem}_inflated.surf.gii", nowhere, cortex.hemi)
    for name, values in m.maps.items():
        end, what = MAPS.get(name, f"desc-{_joined(name)}_morph"), quantity(name)
        values = flip_curvature_sign(values) if name == "H" else values
        write_gifti_map(anat / f"{stem}_{end}.shape.gii", values, name=end, nan=np.nan, hemi=cortex.hemi)
        said = {"Description": CURV if name == "H" else what.label, "Units": _bids(what.unit), "Missing": MISSING}
        (anat / f"{stem}_{end}.json").write_text(strict_json(said), encoding="utf-8")


def _moved(verts: Verts, transform: np.ndarray) -> Verts:
    return np.asarray(verts @ transform[:3, :3].T + transform[:3, 3], dtype=np.float64)


def _moved_rows(m: Measures) -> list[dict[str, Any]]:
    """Hinges, where the surfaces that are written are."""
    if m.cortex.transform is None:
        return m.hinges
    to = m.cortex.transform
    return [row | dict(zip("xyz", _moved(np.array([row[k] for k in "xyz"]), to).tolist())) for row in m.hinges]


def _joined(name: str) -> str:
    """``shape_index`` as BIDS takes it: ``shapeIndex``."""
    first, *rest = ("".join(c for c in word if c.isascii() and c.isalnum()) for word in name.split("_"))
    return first + "".join(word[:1].upper() + word[1:] for word in rest)


def _write_table(path: Path, columns: Sequence[str], rows: Sequence[Mapping[str, Any]]) -> None:
    """A table, and beside it what each of its columns holds."""
    write_table(path, columns, rows)
    said: dict[str, Any] = {}
    for key in dict.fromkeys([*columns, *(k for row in rows for k in row)]):
        label, unit = column_words(key)
        said[key] = {"Description": label, **({"Units": _bids(unit)} if unit else {})}
        said[key] |= {"Levels": LEVELS[key]} if key in LEVELS else {}
    path.with_suffix(".json").write_text(strict_json(said), encoding="utf-8")


def _bids(unit: str) -> str:
    """A unit in the letters that BIDS asks for."""
    return unit.replace("²", "^2").replace("³", "^3") or "1"
