"""Measures as files of FreeSurfer: regions in its stats format, and files written into the subject that was measured.

``analyze`` writes the stats beside its tables, and with --into-subject into the subject.

``stats/?h.aparc.gyral.stats`` has the regions of a hemisphere as ``mris_anatomical_stats`` writes them;
``aparcstats2table --parc aparc.gyral --meas thickness`` makes a table of subjects from these files. FreeSurfer's own
files are never replaced.
"""

import os
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path

import numpy as np

from morphofold import __version__
from morphofold.analysis.measures_result import Measures
from morphofold.digests_and_json import Row, printable, sha256_of
from morphofold.errors import DoesNotApply
from morphofold.geometry import vertex_areas
from morphofold.io import atomic_file, write_morph
from morphofold.io.atomic_folders import MARKER_FILE
from morphofold.io.files import StrPath, check_above
from morphofold.io.json_files import Record, read_json, write_json
from morphofold.mesh_quality.cortex_checks import cortex_label

RECORD_FILE = "stats/morphofold.json"  # in the subject: SHA-256 of the files that morphofold wrote there
#: names in surf/ without the hemisphere, and the maps that they hold; pial_lgi is the name of recon-all -localGI
SURF_FILES = {"gyral_thickness": "gyral_thickness", "pial_lgi": "local_gyrification_index"}
#: files that a subject does not have: a simulation, one of its stages, an analysis
_NOT_IN_A_SUBJECT = ("stages", "stage.json", "summary.json", MARKER_FILE)
#: a row: name, vertices, area, volume, mean and standard deviation of thickness, and four curvatures
_ROW = "{:<40} {:5d} {:6.0f} {:6.0f} {:6.3f} {:6.3f} {:6.3f} {:6.3f} {:6.0f} {:6.1f}"


# regions in FreeSurfer's stats format -----------------------------------------------------------------------


def stats_name(measures: Measures) -> str:
    """Name of the file: ``lh.aparc.gyral.stats``."""
    parcellation = "aparc" if measures.cortex.regions is None else measures.cortex.regions.name
    return f"{measures.cortex.hemi}.{parcellation}.gyral.stats"


def write_gyral_stats(path: StrPath, side: Measures) -> None:
    """Write the regions of a hemisphere in FreeSurfer's stats format.

    Parameters
    ----------
    path : str or path
        ``aparcstats2table --parc aparc.gyral`` expects ``stats/lh.aparc.gyral.stats`` in a subject's folder.
    side : Measures
        With regions.

    Notes
    -----
    NumVert, SurfArea and GrayVol are FreeSurfer's (docs/measures/regions.md). ThickAvg is ``gyral_thickness_mm`` of
    the region, ThickStd the standard deviation (over n) of the map ``gyral_thickness`` over its vertices. A region
    without gyral thickness has ``nan`` in both, and keeps its row: ``aparcstats2table`` writes 0.0 for a row that one
    of its subjects lacks. Curvature columns are ``nan``: our curvature is not FreeSurfer's fit. In the header NumVert
    and WhiteSurfArea are of the cortex, as with ``-cortex ?h.cortex.label``, MeanThickness is the median gyral
    thickness of the hemisphere, and volumes of the brain are FreeSurfer's own.
    """
    Path(path).write_text("\n".join([*_head(side), *(_row(side, row) for row in side.regions)]) + "\n", "utf-8")


def _head(measures: Measures) -> list[str]:
    """The lines of stats_head.txt, without those whose value is not known."""
    cortex, mask, info = measures.cortex, cortex_label(measures.cortex)[0], measures.cortex.info
    value_of_field = {
        "version": __version__,
        "name": " ".join(printable(cortex.name).split()),
        "hemi": cortex.hemi,
        "annotation": None if "annotation_from" in info else stats_name(measures).replace(".gyral.stats", ".annot"),
        "vertices": mask.sum(),
        "area": vertex_areas(cortex.white.verts, cortex.faces)[mask].sum(),
        "thickness": measures.scalars.get("median_gyral_thickness_mm"),
        "brain": info.get("freesurfer_brain_without_ventricles_mm3"),
        "etiv": info.get("etiv_mm3"),
    }
    unknown_fields = [f"{{{key}" for key, value in value_of_field.items() if value is None]
    lines = Path(__file__).with_name("stats_head.txt").read_text("utf-8").splitlines()
    return [line.format(**value_of_field) for line in lines if not any(field in line for field in unknown_fields)]


def _row(measures: Measures, row: Row) -> str:
    regions, thickness_map = measures.cortex.regions, measures.maps.get("gyral_thickness")
    region_values = [row.get(key) for key in ("area_mm2", "gray_volume_mm3", "gyral_thickness_mm")]
    area, volume, thickness = np.array(region_values, np.float64)  # None is NaN
    thickness_sd = np.nan
    if regions is not None and thickness_map is not None and np.isfinite(thickness):
        label_numbers = [number for number, name in enumerate(regions.names) if name == row["region"]]
        is_in_region = np.isin(regions.labels, label_numbers) & np.isfinite(thickness_map)
        thickness_sd = thickness_map[is_in_region].std() if is_in_region.any() else np.nan
    name = "_".join(printable(row["region"]).replace("#", " ").split())  # a blank would end it, # the row
    return _ROW.format(name, row["n_vertices"], area, volume, thickness, thickness_sd, *[np.nan] * 4)


# files of the subject that was measured ---------------------------------------------------------------------


class _WrittenRecord(Record):
    """``stats/morphofold.json``; ``before`` has digests of files that were replaced last."""

    files: dict[str, str]
    before: dict[str, str] = {}


def check_subject(folder: StrPath) -> Path:
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
    if not any((folder / "surf").glob("[lr]h.white")) or any(
        os.path.lexists(folder / name) for name in _NOT_IN_A_SUBJECT
    ):
        raise DoesNotApply(
            f"{folder}: is not a FreeSurfer subject (with surf/?h.white of FreeSurfer), so nothing is written into it. "
            "Leave out --into-subject."
        )
    for name in ("surf/lh.pial_lgi", RECORD_FILE):
        check_above(folder / name)
    _read_record(folder)
    return folder


def write_into_subject(measures: Sequence[Measures], folder: StrPath) -> tuple[list[str], list[str]]:
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
    record = _read_record(folder)
    writers: dict[str, Callable[[Path], object]] = {}
    for side in measures:
        for name, map_name in SURF_FILES.items():
            if map_name in side.maps:
                writers[f"surf/{side.cortex.hemi}.{name}"] = partial(write_morph, values=side.maps[map_name], nan=0.0)
        if side.regions:
            writers[f"stats/{stats_name(side)}"] = partial(write_gyral_stats, side=side)
    (folder / "stats").mkdir(exist_ok=True)
    written_digests, unchanged_files = dict[str, str](), list[str]()
    with ExitStack() as moves:  # every file is moved to its place at the end, or none
        for name, write in writers.items():
            path, known_digests = folder / name, [digests.get(name) for digests in (record["files"], record["before"])]
            if os.path.lexists(path) and not (path.is_file() and sha256_of(path) in known_digests):
                unchanged_files.append(name)
                continue
            temporary = moves.enter_context(atomic_file(path))
            write(temporary)
            written_digests[name] = sha256_of(temporary)
        # a run that is killed between two moves leaves old and new files: both are known
        old_digests = {name: record["files"][name] for name in written_digests if name in record["files"]}
        content = {"morphofold": __version__, "files": {**record["files"], **written_digests}, "before": old_digests}
        write_json(folder / RECORD_FILE, content)
    return list(written_digests), unchanged_files


def _read_record(folder: Path) -> Row:
    path, empty_record = folder / RECORD_FILE, Row(files={}, before={})
    advice = "Remove it; the files that are there are then kept."
    return empty_record | read_json(path, _WrittenRecord, advice) if os.path.lexists(path) else empty_record
