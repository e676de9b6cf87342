"""Measures as files of the FreeSurfer subject that was measured; FreeSurfer's own files are never replaced."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from functools import partial
from pathlib import Path
from typing import Any

from morphofold import __version__
from morphofold.analysis.measures import Measures
from morphofold.errors import DoesNotApply
from morphofold.io import atomic_file, write_morph
from morphofold.io.folders import MARKER_FILE
from morphofold.io.json_files import Record, read_json
from morphofold.provenance import sha256_of, strict_json
from morphofold.results.gyral_stats import stats_name, write_gyral_stats

RECORD_FILE = "stats/morphofold.json"  # in the subject: SHA-256 of the files that morphofold wrote there
#: names in surf/ without the hemisphere, and the maps that they hold; pial_lgi is the name of recon-all -localGI
SURF_FILES = {"gyral_thickness": "gyral_thickness", "pial_lgi": "local_gyrification_index"}
#: files that a subject does not have: a simulation, one of its stages, an analysis
_NOT_IN_A_SUBJECT = ("stages", "stage.json", "summary.json", MARKER_FILE)


class _WrittenRecord(Record):
    """``stats/morphofold.json``; ``before`` has digests of files that were replaced last."""

    files: dict[str, str]
    before: dict[str, str] = {}


def check_subject(folder: str | Path) -> Path:
    """The folder of a FreeSurfer subject into which files can be written.

    Raises
    ------
    DoesNotApply
        If it is something else: a simulation, an analysis, a folder of GIFTI surfaces.
    OSError, ValueError
        If it can't be written to, or the record in it is damaged.
    """
    folder = Path(folder)
    folder = folder.parent if folder.name == "surf" else folder
    of_freesurfer = any((folder / "surf" / f"{hemi}.white").is_file() for hemi in ("lh", "rh"))
    if not of_freesurfer or any(os.path.lexists(folder / name) for name in _NOT_IN_A_SUBJECT):
        raise DoesNotApply(
            f"{folder}: is not a FreeSurfer subject (with surf/?h.white of FreeSurfer), so nothing is written into it. "
            "Leave out --into-subject."
        )
    stats = folder / "stats"
    for place in (folder / "surf", stats if stats.exists() else folder):
        if not os.access(place, os.W_OK | os.X_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), os.fspath(place))
    _read_record(folder)
    return folder


def write_into_subject(measures: Sequence[Measures], folder: str | Path) -> tuple[list[str], list[str]]:
    """Write measures into the FreeSurfer subject that they are of, all files or none.

    Parameters
    ----------
    measures : sequence of Measures
        One or both hemispheres.
    folder : str or path
        Of the subject, as for :func:`check_subject`.

    Returns
    -------
    written, kept : list of str
        Names in the folder: ``surf/?h.gyral_thickness``, ``surf/?h.pial_lgi`` (the local gyrification index; both 0
        where there is no value) and ``stats/?h.aparc.gyral.stats`` if there are regions. A file that morphofold did not
        write, or that was changed since, is kept; ``stats/morphofold.json`` has the digests of those it wrote.

    Raises
    ------
    OSError, ValueError
        As :func:`check_subject`; or if a file can't be written.
    """
    folder = check_subject(folder)
    stats, known = folder / "stats", _read_record(folder)
    made = not stats.exists()
    stats.mkdir(exist_ok=True)
    written: dict[str, str] = {}
    kept: list[str] = []
    try:
        with ExitStack() as moves:  # every file is moved to its place at the end, or none
            for name, write in _writers(measures).items():
                if os.path.lexists(folder / name) and not _is_ours(folder / name, name, known):
                    kept.append(name)
                    continue
                temporary = moves.enter_context(atomic_file(folder / name))
                write(temporary)
                written[name] = sha256_of(temporary)
            # a run that is killed between two moves leaves old and new files: both are known
            before = {name: known["files"][name] for name in written if name in known["files"]}
            content = {"morphofold": __version__, "files": {**known["files"], **written}, "before": before}
            with atomic_file(folder / RECORD_FILE) as record:
                record.write_text(strict_json(content), encoding="utf-8")
    except BaseException:
        if made:
            with suppress(OSError):
                stats.rmdir()
        raise
    return list(written), kept


def _writers(measures: Sequence[Measures]) -> dict[str, Callable[[Path], object]]:
    """What writes each file, by its name in the subject."""
    found: dict[str, Callable[[Path], object]] = {}
    for m in measures:
        for name, key in SURF_FILES.items():
            if key in m.maps:
                found[f"surf/{m.cortex.hemi}.{name}"] = partial(write_morph, values=m.maps[key], nan=0.0)
        if m.regions:
            found[f"stats/{stats_name(m)}"] = partial(write_gyral_stats, m=m)
    return found


def _read_record(folder: Path) -> dict[str, Any]:
    if not os.path.lexists(folder / RECORD_FILE):
        return {"files": {}}
    return read_json(folder / RECORD_FILE, _WrittenRecord, "Remove it; the files that are there are then kept.")


def _is_ours(path: Path, name: str, known: dict[str, Any]) -> bool:
    digests = (known["files"].get(name), known.get("before", {}).get(name))
    return path.is_file() and sha256_of(path) in digests
