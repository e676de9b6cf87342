"""Analyses on disk, written and read in either layout: ``write_analysis``, ``write_dataset``, ``read_analysis``."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

from morphofold import __version__
from morphofold.analysis.measures_result import COLUMNS, SURFACE_COLUMNS, Measures
from morphofold.analysis.region_tables import wide_table
from morphofold.digests_and_json import Row, changed_since, digests, printable, records_as_read
from morphofold.errors import MissingPart, NamedTwice, NothingToDo, WrongFile
from morphofold.forecasts.cost_record import WRITING_STAGE, cost_of_analysis
from morphofold.io import atomic_folder, read_surface
from morphofold.io.atomic_folders import refuse_overlap
from morphofold.io.cifti import write_dscalar, write_pscalar
from morphofold.io.cortices import SurfaceRecord
from morphofold.io.files import StrPath
from morphofold.io.json_files import Count, FileWord, Number, Record, file_word, read_json, write_json
from morphofold.mesh_quality.cortex_checks import cortex_label
from morphofold.results.hemisphere_files import in_scanner, read_hemisphere, read_map, write_hemisphere
from morphofold.results.layouts import MISSING_DESCRIPTION, REANALYSE_ADVICE, Layout, begin_dataset, subject_place
from morphofold.surface import Cortex, PerVertex, Surface
from morphofold.tables import write_table
from morphofold.timing import Stages

NAN_RULE = "A vertex without a value is NaN in maps/*.shape.gii and 0 in the FreeSurfer and MGH maps beside them."
#: draws the page of an analysis: called as ``page(measures, path, failed=, inputs=, stages=, clock=)``
DrawPage = Callable[..., object]


class SurfaceSummary(SurfaceRecord):
    """An entry of ``surfaces`` in a summary."""

    transform: list[list[Number]] | None
    measures: dict[str, Number | None]
    notes: dict[str, str]
    parameters: Row
    maps: list[FileWord]
    came_with: list[FileWord]
    inflated: bool
    sphere: bool = False
    cortex_label: bool
    graph: bool
    annotation: FileWord | None
    files: list[str]


class Summary(Record):
    """``summary.json`` of an analysis, or the provenance file of a subject in a BIDS dataset."""

    morphofold: str
    inputs: list[Row]
    parameters: Row
    rows: dict[str, Count]
    written: dict[str, str] = {}  # digests of surfaces, maps and tables, in the plain layout only
    surfaces: list[SurfaceSummary]


def check_wide(cortices: Sequence[Cortex]) -> None:
    """Raise for a table with a column per region if the surfaces have no regions."""
    if not any(cortex.regions for cortex in cortices):
        raise MissingPart(
            f"{cortices[0].name}: regions_wide.tsv has a column per region, but no parcellation (label/?h.aparc.annot) "
            "came with the surfaces. Leave out --wide (wide=True)."
        )


def write_analysis(
    measures: Sequence[Measures],
    out: StrPath,
    *,
    failed: Mapping[str, str] | None = None,
    inputs: Iterable[str | Path] = (),
    parameters: Mapping[str, Any] | None = None,
    report: DrawPage | Literal[False] = False,
    stages: Sequence[Cortex] = (),
    mgh: bool = False,
    cifti: bool = False,
    wide: bool = False,
    clock: Stages | None = None,
    subject: str = "",
) -> Path:
    """Write an analysis, completely or not at all.

    Parameters
    ----------
    measures : sequence of Measures
        One hemisphere, or a left and a right one.
    out : str or path
        Folder to write. A folder of an earlier run is replaced; any other folder that is not empty is refused.
    failed : mapping, optional
        Hemispheres that could not be measured, and why; recorded, and shown on the page.
    inputs : iterable of path
        Files to record with their SHA-256, in addition to the files of the cortices.
    parameters : mapping, optional
        Recorded for the whole run; each surface's own ``Measures.parameters`` are recorded with it.
    report : callable or False
        Draws report.html and figures/*.png: :func:`morphofold.report.analysis_report`, or a similar function.
    stages : sequence of Cortex
        Stages of the measured body, if there is only one; the page draws it as it grows.
    mgh : bool
        Whether to write the maps also as MGH, in addition to FreeSurfer's format and GIFTI.
    cifti : bool
        Whether to write also CIFTI: each map of both hemispheres (``maps/NAME.dscalar.nii``), at the vertices of the
        cortex, and the numbers of all regions (``maps/regions.pscalar.nii``); not in a BIDS dataset.
    wide : bool
        Whether to write also regions_wide.tsv: the region table as one row.
    clock : Stages, optional
        The clock of the measuring. With it cost.json and the page give the cost of the analysis. These are the only
        files that are not byte for byte the same the next time.
    subject : str
        Its name, if ``out`` is its folder in a BIDS dataset, which :func:`write_dataset` writes.

    Returns
    -------
    out : Path

    Raises
    ------
    ValueError
        If there is no surface, two of one hemisphere, no parcellation for a wide table, or ``out`` is, holds or lies in
        a subject from which the surfaces were read: writing would replace it or add to it.
    FileExistsError
        If ``out`` contains something that morphofold did not write.
    """
    out, cortices = Path(out), [m.cortex for m in measures]
    if clock is not None:
        clock.begin(WRITING_STAGE)
    _check_hemispheres(cortices)
    records = records_as_read(cortices, inputs)
    refuse_overlap(out, (row["path"] for row in records))
    if wide:
        check_wide(cortices)
    with atomic_folder(out) as folder:
        layout = Layout(folder, out.name if subject else "")
        layout.new("map")  # its folder, even if nothing was mapped
        placed_measures = [in_scanner(m) for m in measures] if layout.bids else measures
        for m in placed_measures:
            write_hemisphere(m, layout, mgh=mgh)
        for name, columns in COLUMNS.items():
            layout.write_table(name, columns, [row for m in placed_measures for row in getattr(m, name)])
        layout.write_table("surfaces", ("hemi", *SURFACE_COLUMNS), [m.surface_row for m in measures])
        if cifti and not layout.bids:
            _write_cifti(measures, folder / "maps")
        if wide and not layout.bids:
            wide_rows = wide_table({cortices[0].name: [row for m in measures for row in m.regions]})
            write_table(folder / "regions_wide.tsv", ("subject",), wide_rows)
        summary = _summary_of(measures, records, parameters or {}, failed or {})
        if layout.bids:
            summary = {"subject": subject, **summary, "nan": f"{MISSING_DESCRIPTION}; n/a in tables"}
        else:
            summary["written"] = digests(folder)
        write_json(layout.path("summary"), summary)
        if report:
            stage_measures = [Measures(cortex, {}, {}) for cortex in stages]
            page = folder / "report.html"
            report(measures, page, failed=failed or {}, inputs=records, stages=stage_measures, clock=clock)
        if clock is not None:
            write_json(layout.path("cost"), cost_of_analysis(measures, clock).as_dict())
    return out


def _write_cifti(measures: Sequence[Measures], folder: Path) -> None:
    is_cortex = {m.cortex.hemi: cortex_label(m.cortex)[0] for m in measures}
    for name in dict.fromkeys(name for m in measures for name in m.maps):
        map_of_hemi = {m.cortex.hemi: m.maps[name] for m in measures if name in m.maps}
        write_dscalar(folder / f"{name}.dscalar.nii", {name: map_of_hemi}, is_cortex)
    regions = {m.cortex.hemi: m.cortex.regions for m in measures if m.cortex.regions is not None}
    if rows := [row for m in measures for row in m.regions]:
        write_pscalar(folder / "regions.pscalar.nii", regions, COLUMNS["regions"][2:], rows)


def _summary_of(
    measures: Sequence[Measures], inputs: list[Row], parameters: Mapping[str, Any], failed: Mapping[str, str]
) -> Row:
    """Content of summary.json: input files, parameters, numbers of rows, an entry per surface, and what failed."""
    return {
        "morphofold": __version__,
        "inputs": inputs,
        "parameters": parameters,
        "nan": NAN_RULE,
        "rows": {name: sum(len(getattr(m, name)) for m in measures) for name in COLUMNS},
        "surfaces": [_surface_entry(m) for m in measures],
        "failed": failed,
    }


def _surface_entry(measures: Measures) -> Row:
    cortex = measures.cortex
    return {
        **{key: getattr(cortex, key) for key in ("hemi", "name", "origin", "units", "portion", "info", "transform")},
        "measures": measures.scalars,
        "notes": measures.notes,
        "parameters": measures.parameters,
        "maps": sorted(measures.maps),
        "came_with": sorted(cortex.maps),
        "inflated": cortex.inflated is not None,
        "sphere": cortex.sphere is not None,
        "cortex_label": cortex.cortex is not None,
        "graph": measures.graph is not None,
        "annotation": None if cortex.regions is None else file_word(cortex.regions.name),
        "files": cortex.files,
    }


def write_dataset(measures: Sequence[Measures], dataset: StrPath, name: str, **options: Any) -> Path:
    """Write an analysis as a subject of a BIDS derivatives dataset, completely or not at all.

    Parameters
    ----------
    measures : sequence of Measures
        As for :func:`write_analysis`.
    dataset : str or path
        Folder of the dataset: new, empty, or one that this function wrote; its other subjects stay.
    name : str
        Name of the subject; only its letters and digits are kept in BIDS. Results of an earlier run with this name are
        replaced.
    options
        ``failed``, ``inputs``, ``parameters``, ``report``, ``stages`` and ``clock`` of :func:`write_analysis`; the cost
        is in ``sub-NAME_desc-morphofold_cost.json``. There are no MGH maps and no wide table.

    Returns
    -------
    Path
        ``dataset/sub-NAME``.

    Raises
    ------
    ValueError
        As ``write_analysis``; or if ``name`` has no letters or digits.
    FileExistsError
        If morphofold did not write ``dataset`` or ``sub-NAME`` in it, or ``sub-NAME`` is a subject with another name
        that shortens to the same.

    Notes
    -----
    Surfaces, hinges and gyral graph are in scanner coordinates if the surfaces' footer gives the transform, as other
    BIDS software expects of GIFTI; otherwise they keep their coordinates. ``inflated`` never moves. ``curv`` has
    FreeSurfer's sign; other measured curvatures are positive where convex. ``desc-input`` maps came with the surfaces
    and are unchanged.
    """
    dataset = Path(dataset)
    folder = write_analysis(measures, subject_place(dataset, name), subject=name, **options)
    begin_dataset(dataset)
    return folder


def _check_hemispheres(cortices: Sequence[Cortex]) -> None:
    hemis = [cortex.hemi for cortex in cortices]
    if not hemis or len(set(hemis)) < len(hemis):
        raise (NamedTwice if hemis else NothingToDo)(
            f"an analysis holds one left and/or one right hemisphere, got {', '.join(hemis) or 'none'}. "
            "Write each subject to a folder of its own."
        )


def read_analysis(folder: StrPath) -> list[Measures]:
    """Read what ``write_analysis`` wrote, or a subject that ``write_dataset`` wrote.

    Maps are read from GIFTI, so NaN stays NaN; coordinates and maps have the precision of float32. What a BIDS dataset
    has in scanner coordinates gets its original coordinates; of the footer of its FreeSurfer surfaces only the
    transform is left.

    Raises
    ------
    FileNotFoundError
        If ``folder`` or a file in it is missing.
    ValueError
        If a file cannot be read; the message names it.
    """
    layout = Layout.of(Path(folder))
    if not layout.path("summary").is_file():
        raise FileNotFoundError(f"{folder}: {_why_no_analysis(layout.folder)}")
    summary = read_json(layout.path("summary"), Summary, REANALYSE_ADVICE)
    n_rows = summary["rows"]  # an older version did not write all tables
    tables = {name: layout.read_table(name, n_rows[name]) if name in n_rows else [] for name in COLUMNS}
    records = {row["path"]: row for row in summary["inputs"]}
    return [
        read_hemisphere(entry | {"inputs": [records[f] for f in entry["files"] if f in records]}, tables, layout)
        for entry in summary["surfaces"]
    ]


def _why_no_analysis(folder: Path) -> str:
    """What a folder is instead of an analysis, and what to do."""
    advice = "Name a folder that `morphofold analyze` wrote."
    if not folder.is_dir():
        return f"no such folder. {advice}"
    if (folder / "surf").is_dir():
        advice = f"It is a subject: run `morphofold analyze {folder}` first, and name the folder that it wrote."
    elif (folder / "dataset_description.json").is_file():
        names = sorted(str(anat_folder.parent) for anat_folder in folder.glob("sub-*/anat")) or ["sub-NAME"]
        more_text = f" and {len(names) - 4} more" if len(names) > 4 else ""
        advice = f"It is a BIDS dataset; name a subject of it: {', '.join(names[:4])}{more_text}."
    return f"holds no summary.json. {advice}"


def read_pial(folder: StrPath, hemi: str, name: str) -> tuple[Surface, PerVertex | None]:
    """Read the pial surface of one hemisphere of an analysis, and its map ``name`` (N,), None if it has none; raises as
    :func:`read_analysis`. In a BIDS dataset the surface is in scanner coordinates."""
    layout = Layout.of(Path(folder))
    pial = read_surface(layout.path("surface", hemi, "pial"))
    has_map = layout.path("map", hemi, name).is_file()
    return pial, read_map(layout, hemi, name, len(pial.verts)) if has_map else None


def read_stages(folder: StrPath) -> list[Measures]:
    """Read the analyses of the stages of one simulation: ``folder``/g1.20 and so on, in the order of their growth.

    Raises
    ------
    FileNotFoundError
        If there is none.
    ValueError
        If one cannot be read, or has two hemispheres.
    """
    folder = Path(folder)
    stage_folders = sorted(stage for stage in folder.glob("g*") if (stage / "summary.json").is_file())
    if not stage_folders:
        raise FileNotFoundError(f"{folder}: holds no stages. Name a folder that `morphofold analyze --stages` wrote.")
    stages = []
    for stage in stage_folders:
        measures = read_analysis(stage)
        if len(measures) != 1:
            raise WrongFile(f"{stage}: has two hemispheres, so it is not a stage of a simulation. Name another folder.")
        stages += measures
    return stages


def is_analysis_of(folder: StrPath, cortex: Cortex, parameters: Mapping[str, Any]) -> bool:
    """Whether ``folder`` is an unchanged analysis by this version, of the same files as ``cortex``, with these
    parameters."""
    folder = Path(folder)
    try:
        summary = read_json(folder / "summary.json", Summary, REANALYSE_ADVICE)
    except (OSError, ValueError):  # there is none, or it can't be used
        return False
    old_digests = {row["path"]: row["sha256"] for row in summary["inputs"]}
    new_digests = {printable(row["path"]): row["sha256"] for row in records_as_read([cortex])}
    if (summary["morphofold"], summary["parameters"], old_digests) != (__version__, dict(parameters), new_digests):
        return False
    digests = summary.get("written", {})
    return bool(digests) and not changed_since(digests, {name: folder / name for name in digests})
