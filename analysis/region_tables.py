"""Tables over the parts of a cortex: one row for each region, and for each part by shape and depth."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from morphofold.analysis.graph.gyral_tables import mean_or_none, region_columns
from morphofold.frozen_arrays import Bools
from morphofold.geometry import face_vectors, norms, vertex_areas
from morphofold.mesh_quality.cortex_checks import is_no_cortex
from morphofold.surface import Cortex, PerVertex
from morphofold.validators import check_kind, same_length

if TYPE_CHECKING:
    import networkx as nx

    from morphofold.analysis.thickness.gyral_thickness import GyralThickness

REGION_COLUMNS = tuple(
    "hemi region n_vertices area_mm2 cortical_thickness_mm cortical_thickness_sd_mm gyral_thickness_mm n_hinges "
    "crest_length_mm gyrification_index gyral_contour_mm thickness_file_mm gray_volume_mm3 mean_H_per_mm".split()
)
SHAPE_COLUMNS = tuple("hemi by part n_vertices area_mid_mm2 thickness_mm thickness_sd_mm column_mm".split())
#: columns that have the meaning of FreeSurfer's ``aparcstats2table --meas`` with these names
FREESURFER_NAMES = {
    "area_mm2": "area",
    "gray_volume_mm3": "volume",
    "cortical_thickness_mm": "thickness",
    "cortical_thickness_sd_mm": "thicknessstd",
}
#: columns that are of a map over the vertices of a region
REGION_MEANS = (
    ("cortical_thickness_mm", "cortical_thickness", np.mean),
    ("cortical_thickness_sd_mm", "cortical_thickness", np.std),
    ("gyral_thickness_mm", "gyral_thickness", np.median),
    ("thickness_file_mm", "thickness_file", np.mean),
)
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
        With the keys of ``REGION_COLUMNS``. ``n_vertices`` counts every vertex of the label, and ``area_mm2`` sums
        their white areas. ``cortical_thickness_mm`` and ``_sd_mm`` are the mean and standard deviation (over n, not n -
        1) of the vertices that have a thickness, not weighted by area. All these are computed as in
        ``mris_anatomical_stats``. ``gyral_thickness_mm`` is the median. With ``gyral`` it is given only where the
        contour of the samples (``gyral_contour_mm``) is at least twice the median gyral thickness: less is one fold.
        ``thickness_file_mm`` is the mean of the thickness from the file. ``gray_volume_mm3`` sums :func:`gray_volumes`
        over the vertices in the cortex label. ``mean_H_per_mm`` is the mean of H over pial area, convex positive. It is
        *not* FreeSurfer's MeanCurv, which is the mean of absolute values on white. ``gyrification_index`` is the mean
        of the local index over pial area. A value is None where there is nothing to average. Vertices without a region,
        and labels such as ``unknown`` and ``corpuscallosum``, have no row.

    Raises
    ------
    WrongShape
        If the length of a map differs from that of the surfaces.
    """
    check_kind(cortex, Cortex, "region_table: cortex")
    for map_name, values in maps.items():
        same_length(values, cortex.n_vertices, f"{cortex.name}: map {map_name}")
    if cortex.regions is None:
        return []
    vertex_area = maps["area"] if "area" in maps else vertex_areas(cortex.white.verts, cortex.faces)
    gray_volume = gray_volumes(cortex) * (True if cortex.cortex is None else cortex.cortex)
    pial_area = vertex_areas(cortex.pial.verts, cortex.faces)
    net_by_region = {} if graph is None else region_columns(cortex, graph)
    rows = []
    for region_index, region in enumerate(cortex.regions.names):
        is_in = cortex.regions.labels == region_index
        vertices = np.flatnonzero(is_in)
        if len(vertices) == 0 or is_no_cortex(region):
            continue
        row: dict[str, Any] = dict.fromkeys(REGION_COLUMNS)
        row.update(hemi=cortex.hemi, region=region, n_vertices=len(vertices))
        row.update(area_mm2=float(np.sum(vertex_area[vertices])))
        row.update({} if cortex.is_one_surface else {"gray_volume_mm3": float(gray_volume[vertices].sum())})
        for column, map_name, mean_of in REGION_MEANS:
            row[column] = mean_or_none(mean_of, maps.get(map_name), vertices)
        if gyral is not None:
            contour_mm, thickness = gyral.contour_where(is_in, cortex.faces), gyral.median_where(is_in, cortex.faces)
            is_enough = contour_mm >= LEAST_CONTOUR_IN_WIDTHS * gyral.median and np.isfinite(thickness)
            row.update(gyral_contour_mm=contour_mm, gyral_thickness_mm=thickness if is_enough else None)
        for column, map_name in (("mean_H_per_mm", "H"), ("gyrification_index", "local_gyrification_index")):
            known_vertices = vertices[np.isfinite(maps[map_name][vertices])] if map_name in maps else vertices[:0]
            if pial_area[known_vertices].any():
                row[column] = float(np.average(maps[map_name][known_vertices], weights=pial_area[known_vertices]))
        if region in net_by_region:
            row["n_hinges"], row["crest_length_mm"] = net_by_region[region]
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
    weighted_surfaces = ((1, white), (4, (white + pial) / 2), (1, pial))
    swept_vectors = sum(weight * face_vectors(verts, faces) for weight, verts in weighted_surfaces)
    wedge_volumes = np.abs(np.sum((pial - white)[faces].mean(axis=1) * swept_vectors, axis=1)) / 6
    return np.bincount(faces.ravel(), np.repeat(wedge_volumes / 3, 3), cortex.n_vertices).astype(np.float64)


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
            f"{row['hemi']}_{row['region']}_{FREESURFER_NAMES.get(column, column)}": row.get(column)
            for row in region_rows
            for column in REGION_COLUMNS[2:]
        }
        for name, region_rows in subjects.items()
    ]
    columns = dict.fromkeys(column for row in rows for column in row)
    return [{column: row.get(column) for column in columns} for row in rows]


RIDGE = 0.5  # shape index of a ridge, and less than 0 of a groove: there one principal curvature is 0
#: shares of the area of the cortex in the order of depth: the shallowest, the middle and the deepest part
DEPTHS = {"crown": (0.0, 0.15), "wall": (0.35, 0.65), "fundus": (0.85, 1.0)}
EQUAL_DEPTH_TOLERANCE = 1e-7  # of the root of the area of the cortex


def thickness_by_shape(cortex: Cortex, maps: Mapping[str, PerVertex]) -> list[dict[str, Any]]:
    """Thickness over the parts of a cortex that its shape, and its depth, make.

    Parameters
    ----------
    cortex : Cortex
    maps : mapping of str to (N,) float64
        ``cortical_thickness`` [mm], ``shape_index`` of pial, and ``sulcal_depth`` [mm]; NaN where undefined. Without a
        map of shape or depth, its rows are missing.

    Returns
    -------
    list of dict
        Six rows: ``by`` is ``"shape"`` for the parts ``concave``, ``saddle`` and ``convex``, and ``"depth"`` for
        ``crown``, ``wall`` and ``fundus``. ``area_mid_mm2`` is the mean of the areas of white and pial, by which the
        other numbers are weighted: ``thickness_mm`` and ``thickness_sd_mm``, mean and standard deviation of cortical
        thickness (closest points), and ``column_mm``, the mean distance from a vertex of white to its own on pial. None
        where a part has no vertex.

    Notes
    -----
    Convex, concave: both principal curvatures are positive, or negative; a shape index above 1/2, or below -1/2
    (Koenderink, van Doorn 1992). A surface parallel to pial, such as the one midway to white, has the same parts, since
    an offset changes the size of principal curvatures and not their sign. Crown, wall and fundus are 15, 30 and 15 % of
    the cortex by area, in the order of sulcal depth: its first part, its middle and its last. Vertices of equal depth,
    as on a convex body, are all in a part or all outside.
    """
    check_kind(cortex, Cortex, "thickness_by_shape: cortex")
    thickness = maps["cortical_thickness"]
    white_area, pial_area = (vertex_areas(surface.verts, cortex.faces) for surface in (cortex.white, cortex.pial))
    area = 0.5 * (white_area + pial_area)
    column_length = norms(cortex.pial.verts - cortex.white.verts)
    rows = []
    for grouping, parts in _parts(maps, area, np.isfinite(thickness)):
        for part_name, is_in_part in parts.items():
            row: dict[str, Any] = dict.fromkeys(SHAPE_COLUMNS)
            row.update(hemi=cortex.hemi, by=grouping, part=part_name, n_vertices=int(is_in_part.sum()))
            weights = area[is_in_part]
            if weights.sum() > 0:
                mean_thickness = float(np.average(thickness[is_in_part], weights=weights))
                deviation = float(np.sqrt(np.average((thickness[is_in_part] - mean_thickness) ** 2, weights=weights)))
                row.update(area_mid_mm2=float(weights.sum()), thickness_mm=mean_thickness, thickness_sd_mm=deviation)
                row.update(column_mm=float(np.average(column_length[is_in_part], weights=weights)))
            rows.append(row)
    return rows


def _parts(maps: Mapping[str, PerVertex], area: PerVertex, is_known: Bools) -> Iterator[tuple[str, dict[str, Bools]]]:
    """Which vertices (N,) are in each part."""
    if "shape_index" in maps:
        shape_index = maps["shape_index"]
        has_shape = is_known & np.isfinite(shape_index)
        masks = {"concave": shape_index < -RIDGE, "saddle": np.abs(shape_index) <= RIDGE, "convex": shape_index > RIDGE}
        yield "shape", {part_name: has_shape & is_in_part for part_name, is_in_part in masks.items()}
    if "sulcal_depth" in maps:
        depth = maps["sulcal_depth"]
        measured_vertices = np.flatnonzero(is_known & np.isfinite(depth))
        depth_order = measured_vertices[np.argsort(depth[measured_vertices], kind="stable")]
        area_rank = np.cumsum(area[depth_order]) - 0.5 * area[depth_order]
        area_rank /= max(float(area[depth_order].sum()), np.finfo(float).tiny)
        depth_parts: dict[str, Bools] = {}
        tolerance = EQUAL_DEPTH_TOLERANCE * area[depth_order].sum() ** 0.5
        for part_name, (low_rank, high_rank) in DEPTHS.items():
            depths = depth[depth_order[(area_rank >= low_rank) & (area_rank <= high_rank)]]
            least_depth, largest_depth = depths.min(initial=np.inf) - tolerance, depths.max(initial=-np.inf) + tolerance
            depth_parts[part_name] = is_known & (depth >= least_depth) & (depth <= largest_depth)
        yield "depth", depth_parts
