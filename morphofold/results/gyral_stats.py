"""``stats/?h.aparc.gyral.stats``: the regions of a hemisphere as FreeSurfer's ``mris_anatomical_stats`` writes them.

FreeSurfer's ``aparcstats2table --parc aparc.gyral --meas thickness`` makes a table of subjects from these files.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from morphofold import __version__
from morphofold.analysis.measures import Measures
from morphofold.geometry import vertex_areas
from morphofold.mesh_quality.checks import cortex_label
from morphofold.provenance import printable

#: columns: heading, its words in the file, unit, format
STATS_COLUMNS = (
    ("StructName", "Structure Name", "NA", "{:<40}"),
    ("NumVert", "Number of Vertices", "unitless", "{:5d}"),
    ("SurfArea", "Surface Area", "mm^2", "{:6.0f}"),
    ("GrayVol", "Gray Matter Volume", "mm^3", "{:6.0f}"),
    ("ThickAvg", "Gyral Thickness from wall to wall - median over contour length", "mm", "{:6.3f}"),
    ("ThickStd", "Gyral Thickness StdDev over vertices", "mm", "{:6.3f}"),
    ("MeanCurv", "not given", "mm^-1", "{:6.3f}"),
    ("GausCurv", "not given", "mm^-2", "{:6.3f}"),
    ("FoldInd", "not given", "unitless", "{:6.0f}"),
    ("CurvInd", "not given", "unitless", "{:6.1f}"),
)
REMARKS = (
    "ThickAvg and ThickStd are gyral thickness (from wall to wall of a gyrus) and not cortical thickness.",
    "nan: not known. A region with less contour than twice the gyral thickness has no gyral thickness; curvature by",
    "FreeSurfer's fit is in FreeSurfer's own stats of the same parcellation.",
)


def stats_name(m: Measures) -> str:
    """Name of the file: ``lh.aparc.gyral.stats``."""
    parcellation = "aparc" if m.cortex.regions is None else m.cortex.regions.name
    return f"{m.cortex.hemi}.{parcellation}.gyral.stats"


def write_gyral_stats(path: str | Path, m: Measures) -> None:
    """Write the regions of a hemisphere in FreeSurfer's stats format.

    Parameters
    ----------
    path : str or path
        ``aparcstats2table --parc aparc.gyral`` expects ``stats/lh.aparc.gyral.stats`` in a subject's folder.
    m : Measures
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
    Path(path).write_text("\n".join([*_head(m), *_rows(m)]) + "\n", encoding="utf-8")


def _head(m: Measures) -> list[str]:
    cortex, mask, info = m.cortex, cortex_label(m.cortex)[0], m.cortex.info
    areas = vertex_areas(cortex.white.verts, cortex.faces)
    measures = (
        ("Cortex, NumVert, Number of Vertices", int(mask.sum()), "unitless"),
        ("Cortex, WhiteSurfArea, White Surface Total Area", float(areas[mask].sum()), "mm^2"),
        ("Cortex, MeanThickness, Gyral Thickness Median", m.scalars.get("median_gyral_thickness_mm"), "mm"),
        (
            "BrainSegNotVent, BrainSegVolNotVent, Brain Segmentation Volume Without Ventricles",
            info.get("freesurfer_brain_without_ventricles_mm3"),
            "mm^3",
        ),
        ("EstimatedTotalIntraCranialVol, eTIV, Estimated Total Intracranial Volume", info.get("etiv_mm3"), "mm^3"),
    )
    lines = [
        "Table of cortical parcellation anatomical statistics",
        "",
        f"generating_program morphofold {__version__}",
        *REMARKS,
        "anatomy_type surface",
        f"subjectname {' '.join(printable(cortex.name).split())}",
        f"hemi {cortex.hemi}",
        *_annotation_line(m),
        *(f"Measure {words}, {value:.10g}, {unit}" for words, value, unit in measures if value is not None),
        f"NTableCols {len(STATS_COLUMNS)}",
    ]
    for k, (heading, words, unit, _) in enumerate(STATS_COLUMNS, start=1):
        lines += [f"TableCol {k:2d} {what}" for what in (f"ColHeader {heading}", f"FieldName {words}", f"Units {unit}")]
    lines.append(f"ColHeaders {' '.join(heading for heading, *_ in STATS_COLUMNS)}")
    return [f"# {line}".rstrip() for line in lines]


def _annotation_line(m: Measures) -> list[str]:
    """The file of the parcellation; none if it was carried over from a template."""
    if "annotation_from" in m.cortex.info:
        return []
    return [f"AnnotationFile ../label/{stats_name(m).replace('.gyral.stats', '.annot')}"]


def _rows(m: Measures) -> list[str]:
    regions, across = m.cortex.regions, m.maps.get("gyral_thickness")
    number = {} if regions is None else {name: k for k, name in enumerate(regions.names)}
    lines = []
    for row in m.regions:
        at = False if regions is None else regions.labels == number.get(row["region"])
        widths = np.empty(0) if across is None else across[at & np.isfinite(across)]
        thick = _or_nan(row.get("gyral_thickness_mm"))
        values = (
            "_".join(printable(row["region"]).replace("#", " ").split()),  # a blank would end it, # the row
            row["n_vertices"],
            _or_nan(row.get("area_mm2")),
            _or_nan(row.get("gray_volume_mm3")),
            thick,
            float(widths.std()) if np.isfinite(thick) and len(widths) else np.nan,
            *[np.nan] * 4,
        )
        lines.append(" ".join(form.format(value) for (*_, form), value in zip(STATS_COLUMNS, values)))
    return lines


def _or_nan(value: float | None) -> float:
    return np.nan if value is None else float(value)
