"""Reading of analyses in both layouts: ``read_analysis``, ``read_stages``."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from morphofold.analysis.measures import Measures
from morphofold.errors import WrongFile
from morphofold.io import read_surface
from morphofold.io.json_files import file_word, read_json
from morphofold.provenance import changed_since, printable, records_as_read
from morphofold.results import bids_hemisphere
from morphofold.results.bids import read_subject
from morphofold.results.plain import read_plain
from morphofold.results.summary import REANALYSE_ADVICE, Summary, sized_map
from morphofold.surface import Cortex, PerVertex, Surface


def read_analysis(folder: str | Path) -> list[Measures]:
    """Read what ``write_analysis`` wrote, or a subject that ``write_dataset`` wrote.

    Maps are read from GIFTI, so NaN stays NaN; coordinates and maps have the precision of float32.

    Raises
    ------
    FileNotFoundError
        If ``folder`` or a file in it is missing.
    ValueError
        If a file cannot be read; the message names it.
    """
    folder = Path(folder)
    path = folder / "summary.json"
    if not path.is_file() and (folder / "anat").is_dir():
        return read_subject(folder)
    if not path.is_file():
        what, how = "no such folder", "Name a folder that `morphofold analyze` wrote."
        if folder.is_dir():
            what = "holds no summary.json"
            if (folder / "surf").is_dir():
                how = f"It is a subject: run `morphofold analyze {folder}` first, and name the folder that it wrote."
            elif (folder / "dataset_description.json").is_file():
                names = sorted(str(place.parent) for place in folder.glob("sub-*/anat")) or ["sub-NAME"]
                more = f" and {len(names) - 4} more" if len(names) > 4 else ""
                how = f"It is a BIDS dataset; name a subject of it: {', '.join(names[:4])}{more}."
        raise FileNotFoundError(f"{folder}: {what}. {how}")
    return read_plain(folder)


def read_pial(folder: str | Path, hemi: str, name: str) -> tuple[Surface, PerVertex | None]:
    """Read the pial surface of one hemisphere of an analysis, and its map ``name`` (N,), None if it has none; raises as
    :func:`read_analysis`. In a BIDS dataset the surface is in scanner coordinates."""
    folder = Path(folder)
    if not (folder / "summary.json").is_file() and (folder / "anat").is_dir():
        return bids_hemisphere.read_pial(folder / "anat", folder.name, hemi, name)
    pial = read_surface(folder / "surf" / f"{hemi}.pial")
    path = folder / "maps" / f"{hemi}.{file_word(name)}.shape.gii"
    return pial, sized_map(path, len(pial.verts)) if path.is_file() else None


def read_stages(folder: str | Path) -> list[Measures]:
    """Read the analyses of the stages of one simulation: ``folder``/g1.20 and so on, in the order of their growth.

    Raises
    ------
    FileNotFoundError
        If there is none.
    ValueError
        If one cannot be read, or has two hemispheres.
    """
    folder = Path(folder)
    parts = sorted(part for part in folder.glob("g*") if (part / "summary.json").is_file())
    if not parts:
        raise FileNotFoundError(f"{folder}: holds no stages. Name a folder that `morphofold analyze --stages` wrote.")
    stages = []
    for part in parts:
        found = read_analysis(part)
        if len(found) != 1:
            raise WrongFile(f"{part}: has two hemispheres, so it is not a stage of a simulation.")
        stages += found
    return stages


def is_analysis_of(folder: str | Path, cortex: Cortex, parameters: Mapping[str, Any]) -> bool:
    """Whether ``folder`` is an unchanged analysis by this version, of the same files as ``cortex``, with these
    parameters."""
    import morphofold

    folder = Path(folder)
    try:
        summary = read_json(folder / "summary.json", Summary, REANALYSE_ADVICE)
    except (OSError, ValueError):  # there is none, or it can't be used
        return False
    known = {row["path"]: row["sha256"] for row in summary["inputs"]}
    files = {printable(row["path"]): row["sha256"] for row in records_as_read([cortex])}
    if (summary["morphofold"], summary["parameters"], known) != (morphofold.__version__, dict(parameters), files):
        return False
    written = summary.get("written", {})
    return bool(written) and not changed_since(written, {name: folder / name for name in written})
