"""Region tables: one row per region of a labelled cortex, and from those one row per subject."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from morphofold.analysis.graph.graph_rows import region_columns
from morphofold.errors import WrongShape
from morphofold.geometry import face_vectors, vertex_areas
from morphofold.mesh_quality.checks import is_no_cortex
from morphofold.surface import Cortex, PerVertex
from morphofold.validators import check_kind

if TYPE_CHECKING:
    import networkx as nx

    from morphofold.analysis.thickness.gyral import GyralThickness

COLUMNS = (
    "hemi",
    "region",
    "n_vertices",
    "area_mm2",
    "cortical_thickness_mm",
    "cortical_thickness_sd_mm",
    "gyral_thickness_mm",
    "n_hinges",
    "crest_length_mm",
    "gyrification_index",
    "gyral_contour_mm",
    "thickness_file_mm",
    "gray_volume_mm3",
    "mean_H_per_mm",
)
#: columns that have the meaning of FreeSurfer's ``aparcstats2table --meas`` with these names
FREESURFER_NAMES = {
    "area_mm2": "area",
    "gray_volume_mm3": "volume",
    "cortical_thickness_mm": "thickness",
    "cortical_thickness_sd_mm": "thicknessstd",
}
LEAST_CONTOUR_IN_WIDTHS = 2.0  # in multiples of the median gyral thickness: about 20 mm on an adult brain, one fold


def region_table(
    cortex: Cortex,
    maps: Mapping[str, PerVertex],
    gyral: GyralThickness | None = None,
    graph: nx.MultiGraph | None = None,
) -> list[dict[str, Any]]:
    """One row per region of the cortex that has vertices, in the order of its annotation.

    Parameters
    ----------
    cortex : Cortex
        With ``regions``; without them the table is empty.
    maps : mapping of str to (N,) float64
        ``area`` [mm^2], by default that of the white surface; ``cortical_thickness`` and ``gyral_thickness`` [mm], NaN
        where undefined; ``thickness_file`` [mm], from a file; ``H`` [1/mm] of pial and ``local_gyrification_index``. If
        a map is missing, its column is None.
    gyral : GyralThickness, optional
        Gives the gyral thickness of regions from its samples, weighted by contour length, instead of from the map.
    graph : networkx.MultiGraph, optional
        Gyral graph, for the number of hinges and the length of crests in a region.

    Returns
    -------
    list of dict
        With the keys of ``COLUMNS``. ``n_vertices`` counts every vertex of the label, and ``area_mm2`` sums their
        white areas. ``cortical_thickness_mm`` and ``_sd_mm`` are the mean and standard deviation (over n, not n - 1)
        of the vertices that have a thickness, not weighted by area. All these are computed as in
        ``mris_anatomical_stats``. ``gyral_thickness_mm`` is the median. With ``gyral`` it is given only where the
        contour of the samples (``gyral_contour_mm``) is at least twice the median gyral thickness: less is one fold.
        ``thickness_file_mm`` is the mean of the thickness from the file. ``gray_volume_mm3`` sums :func:`gray_volumes`
        over the vertices in the cortex label. ``mean_H_per_mm`` is the mean of H over pial area, convex positive. It
        is *not* FreeSurfer's MeanCurv, which is the mean of absolute values on white. ``gyrification_index`` is the
        mean of the local index over pial area. A value is None where there is nothing to average. Vertices without a
        region, and labels such as ``unknown`` and ``corpuscallosum``, have no row.

    Raises
    ------
    WrongShape
        If the length of a map differs from that of the surfaces.
    """
    check_kind(cortex, Cortex, "region_table: cortex")
    for name, values in maps.items():
        if np.shape(values) != (cortex.n_vertices,):
            raise WrongShape(f"{cortex.name}: map {name} has shape {np.shape(values)}, not ({cortex.n_vertices},).")
    if cortex.regions is None:
        return []
    area = maps["area"] if "area" in maps else vertex_areas(cortex.white.verts, cortex.faces)
    volume = gray_volumes(cortex) * (True if cortex.cortex is None else cortex.cortex)
    outside = vertex_areas(cortex.pial.verts, cortex.faces)
    crests = {} if graph is None else region_columns(cortex, graph)
    rows = []
    for index, region in enumerate(cortex.regions.names):
        at = np.flatnonzero(cortex.regions.labels == index)
        if len(at) == 0 or is_no_cortex(region):
            continue
        thickness = _finite_values_at(maps.get("cortical_thickness"), at)
        widths = _finite_values_at(maps.get("gyral_thickness"), at)
        across = float(np.median(widths)) if len(widths) else np.nan
        row: dict[str, Any] = dict.fromkeys(COLUMNS)
        if gyral is not None:
            length = gyral.contour_where(cortex.regions.labels == index, cortex.faces)
            enough = length >= LEAST_CONTOUR_IN_WIDTHS * gyral.median
            across = gyral.median_where(cortex.regions.labels == index, cortex.faces) if enough else np.nan
            row.update(gyral_contour_mm=length)
        row.update(hemi=cortex.hemi, region=region, n_vertices=len(at), area_mm2=float(np.sum(area[at])))
        row.update(gray_volume_mm3=float(volume[at].sum()))
        for column, name in (("mean_H_per_mm", "H"), ("gyrification_index", "local_gyrification_index")):
            known = at[np.isfinite(maps[name][at])] if name in maps else at[:0]
            if outside[known].any():
                row[column] = float(np.average(maps[name][known], weights=outside[known]))
        if region in crests:
            row.update(n_hinges=crests[region][0], crest_length_mm=crests[region][1])
        if len(thickness):
            row.update(cortical_thickness_mm=float(thickness.mean()), cortical_thickness_sd_mm=float(thickness.std()))
        if len(from_file := _finite_values_at(maps.get("thickness_file"), at)):
            row.update(thickness_file_mm=float(from_file.mean()))
        if np.isfinite(across):
            row.update(gyral_thickness_mm=across)
        rows.append(row)
    return rows


def gray_volumes(cortex: Cortex) -> PerVertex:
    """Gray matter of each vertex (N,) [mm^3]: a third of the volume between its triangles on white and on pial.

    Notes
    -----
    The wedge between a triangle on white and that on pial is what the triangle sweeps if each corner moves along a
    straight line: ``mean step . (a_white + 4 a_mid + a_pial) / 6`` with vector areas a. Neighbours share the sides, so
    that between closed surfaces the sum is the volume of pial less that of white, where no wedge is inverted; of those
    the absolute value counts. FreeSurfer since version 6 (``MRISvolumeTH3``, after Winkler and others 2018 [1]_) splits
    the same wedge into three tetrahedra, whose sum depends on the corner at which the triangle begins: by 0.1 % on
    fsaverage5, and by up to 8 % in single regions.

    References
    ----------
    .. [1] Winkler, Greve, Bjuland, Nichols, Sabuncu, Haberg, Skranes, Rimol. Joint analysis of cortical area and
       thickness as a replacement for the analysis of the volume of the cerebral cortex. Cereb. Cortex 28, 738 (2018).
    """
    check_kind(cortex, Cortex, "gray_volumes: cortex")
    white, pial, faces = cortex.white.verts, cortex.pial.verts, cortex.faces
    between = ((1, white), (4, (white + pial) / 2), (1, pial))
    swept = sum(share * face_vectors(verts, faces) for share, verts in between)
    wedge = np.abs(np.sum((pial - white)[faces].mean(axis=1) * swept, axis=1)) / 6
    return np.bincount(faces.ravel(), np.repeat(wedge / 3, 3), cortex.n_vertices).astype(np.float64)


def wide_table(subjects: Mapping[str, Iterable[Mapping[str, Any]]]) -> list[dict[str, Any]]:
    """One row per subject, one column per region and measure, as in ``aparcstats2table``.

    Parameters
    ----------
    subjects : mapping of str to rows
        Rows of ``region_table`` of one hemisphere or both, by the name of the subject.

    Returns
    -------
    list of dict
        ``subject``, then ``lh_bankssts_area`` and so on: FreeSurfer's name of a measure where ``FREESURFER_NAMES`` has
        one, else the name of the column. Every row has all columns; values of a region that a subject lacks are None.
    """
    rows = [
        {"subject": name}
        | {
            f"{row['hemi']}_{row['region']}_{FREESURFER_NAMES.get(key, key)}": row.get(key)
            for row in regions
            for key in COLUMNS[2:]
        }
        for name, regions in subjects.items()
    ]
    columns = dict.fromkeys(key for row in rows for key in row)
    return [{key: row.get(key) for key in columns} for row in rows]


def _finite_values_at(values: PerVertex | None, at: np.ndarray) -> PerVertex:
    """The finite values at some vertices."""
    some = np.empty(0) if values is None else np.asarray(values, dtype=np.float64)[at]
    return some[np.isfinite(some)]
