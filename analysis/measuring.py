"""All measures of one cortex: ``measure(cortex)``, the same code for simulated and FreeSurfer surfaces."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from morphofold import geometry
from morphofold.analysis import notes, regions, relief, resampling
from morphofold.analysis.asked import CURVATURE_MAPS, Asked, asked
from morphofold.analysis.curvatures import curvature, scale_of_curvature, scale_of_folding
from morphofold.analysis.diffusion import diffusion
from morphofold.analysis.graph import depth_potential
from morphofold.analysis.graph.graph_rows import GyralTables, gyral_tables
from morphofold.analysis.gyrification import convex_hull
from morphofold.analysis.gyrification.folding import folding_indices
from morphofold.analysis.gyrification.local_gyrification import CLOSING_RADIUS_MM, local_gyrification_index
from morphofold.analysis.maps import each_map
from morphofold.analysis.measures import SCALARS, SLOPE_SCALARS, Measures
from morphofold.analysis.steps import Steps
from morphofold.analysis.thickness.by_shape import thickness_by_shape
from morphofold.analysis.thickness.gyral import GyralThickness
from morphofold.analysis.thickness.robust_slope import Line, through_regions
from morphofold.mesh_quality import checks, defects
from morphofold.mesh_quality import repair as mending
from morphofold.progress import Progress, silent
from morphofold.surface import Cortex, PerVertex
from morphofold.threads import one_blas_thread
from morphofold.validators import check_kind

if TYPE_CHECKING:
    import networkx as nx

    from morphofold.timing import Stages

# share of crossed triangles of white, above which the net is taken midway to pial; a person has 0.00003
LARGEST_CROSSED_SHARE = 0.01
APART = "where white and pial differ"  # part of every cortex mask


@one_blas_thread()
def measure(
    cortex: Cortex,
    *,
    only: Sequence[str] | None = None,
    curvature_scale: float | None = None,
    gyral: Mapping[str, Any] | None = None,
    gyral_width: float | None = None,
    thickness_cap: float | None = None,
    accuracy: str = "standard",
    repair: bool = True,
    progress: Progress | None = None,
    clock: Stages | None = None,
) -> Measures:
    """All measures of one cortex, by the same code for simulated and real surfaces.

    Parameters
    ----------
    cortex : Cortex
        White and pial surface [mm]. Its mask, regions and maps are used where it has them.
    only : sequence of str, optional
        Scalars, maps and tables (``regions``, ``crests``, ``hinges``, ``arms``, ``shapes``) to measure, such as
        ``["gyral_thickness"]``; None: all. Takes only the time that these need, and gives the same numbers.
    curvature_scale : float, optional
        Radius of the neighbourhoods for curvature, and smoothing length for the folding indices [mm]. None: 3, but at
        least 2.5 mean edges of either surface, and at least 1.5 for the indices. Pass one number to compare surfaces of
        different resolution.
    gyral : mapping, optional
        Options for :func:`morphofold.analysis.gyral_thickness`.
    gyral_width : float, optional
        For :func:`morphofold.analysis.gyral_graph` [mm]; None: measured.
    thickness_cap : float, optional
        Upper bound [mm] of each distance from which cortical thickness is computed; FreeSurfer's is 5. None: no bound,
        for any surface, because a cap is a length of adult human cortex.
    accuracy : {"draft", "standard", "fine"}
        ``"draft"``: surfaces with more than 50,000 vertices are thinned to that number before cortical and gyral
        thickness and the gyral net are measured; maps are carried back to all vertices. ``"fine"``: if they have fewer
        than 40,000 vertices, each triangle is split into four. Voxels of local gyrification are 2.5, 1.25 or 0.75 mm.
        Curvature, areas and depth are the same in all three (see docs/accuracy.md).
    repair : bool
        Whether to repair flipped triangles, pinched edges, torn seams and similar defects before measuring. The note
        ``repair`` and the parameters ``repaired_...`` record it. If False, such surfaces are refused.
    progress : callable, optional
        Called with the share of the work done, 0 to 1, and the name of the step that begins, from several threads.
    clock : Stages, optional
        The seconds of the steps are added to it.

    Returns
    -------
    Measures
        Maps ``H K k1 k2 shape_index curvedness`` (pial, convex positive), ``sulcal_depth`` (pial), ``area`` (white),
        ``cortical_thickness``, ``gyral_thickness``; and ``thickness_file`` if the cortex came with a thickness, also
        NaN where that is 0. All maps but ``area`` are NaN outside the cortex mask.

        With ``only``, other scalars are None, other maps and tables are left out, and the note ``only`` says so.

        ``notes`` gives the definition of each scalar whose name is not enough, and the reason where a scalar is None.
        It also holds warnings on the input: ``repair`` (what was repaired), ``mesh`` (unused vertices, pieces,
        borders), ``crossing`` (white outside pial), ``pair`` (so much of it that the two are hardly of one cortex),
        ``self_crossing``, ``thickness_file`` (gaps in it), ``thickness_unlike`` (it does not match the surfaces),
        ``thickness_cap``, ``curvature_scale``, ``gyral_width``, ``size``, ``side``, ``cortex_mask``,
        ``cortex_label``, ``parcellation`` and ``simulation``.

    Raises
    ------
    ValueError
        If ``only`` is empty or has an unknown name, or ``accuracy`` is none of the three. If a defect is not or cannot
        be repaired: an edge has more than two triangles, triangles are flipped or torn apart, or a closed surface or a
        piece of it is inside out. If white encloses more than pial, lies outside it on most of an open piece, or
        coincides with it up to rounding. If the two are of different cortices, the cortex label holds less than 1 % of
        the vertices, no vertex is cortex, the surfaces lie in a plane, or ``curvature_scale`` does not fit the mesh.

    Notes
    -----
    The cortex is defined by the first of these that is available: the cortex label; a parcellation (all regions but
    ``unknown``, ``corpuscallosum`` and similar names); the thickness that came with the surfaces, which is 0 on the
    medial wall; or the geometry, where large connected patches in which white and pial nearly meet are not cortex (a
    simulated body has none). Vertices where white and pial coincide are never cortex. Areas, Euler characteristic,
    gyrification and folding indices are of the whole surfaces, as in FreeSurfer; means and maps are of the cortex. A
    surface with a border, or of several pieces, has no gyrification index.
    """
    check_kind(cortex, Cortex, "measure: cortex")
    progress, wanted = progress or silent, asked(cortex, only)
    work, found = _Measurement(accuracy, wanted), list[Measures]()
    phases = [
        wanted.chains(
            [
                ("surfaces", "areas", 0.1, lambda: work.begin(cortex, repair)),
                ("resampling", "cortical thickness", 0.0, work.resample),
            ],
            [("resampling", "areas", 0.0, lambda: _prepare(cortex, wanted))],
        ),
        wanted.chains(
            [
                ("cortical thickness", "cortical thickness", 0.1, lambda: work.cortical_thickness(thickness_cap)),
                ("gyral thickness", "gyral thickness", 0.2, lambda: work.gyral_thickness(gyral or {})),
            ],
            [
                ("gyral graph", "areas", 0.02, work.self_crossings),
                ("gyral graph", "gyral graph", 0.25, lambda: work.gyral_graph(gyral_width)),
            ],
            [("folding", "curvature", 0.1, lambda: work.folding(curvature_scale))],
            [("curvature", "curvature", 0.1, lambda: work.curvature(curvature_scale))],
            [("local gyrification", "local gyrification", 0.1, work.local_gyrification)],
            [("depth", "areas", 0.02, work.depth), ("hull", "areas", 0.0, work.hull)],
        ),
        wanted.chains([("surfaces", "regions", 0.01, lambda: found.append(work.measures(thickness_cap)))]),
    ]
    whole = sum(share for chains in phases for chain in chains for _, share, _ in chain)
    steps = Steps(progress, clock, whole)
    for chains in phases:
        steps.run(*chains)
    progress(1.0, "done")
    return found[0]


def _prepare(cortex: Cortex, wanted: Asked) -> None:
    """Compute what several steps need of the surfaces, beside the checks; it is kept with them."""
    white, pial = (cortex.white, depth_potential.COTANGENT_BOUNDS), (cortex.pial, relief.COTANGENT_BOUNDS)
    for (surface, clip), step in ((white, "gyral graph"), (pial, "gyral thickness")):
        if step in wanted.steps:
            diffusion(surface.verts, surface.faces, clip)
        geometry.vertex_normals(surface.verts, surface.faces)
    geometry.incident_faces(cortex.n_vertices, cortex.faces)


class _Part:
    """Maps, numbers and notes that one step of a measurement finds."""

    def __init__(self) -> None:
        self.maps: dict[str, PerVertex] = {}
        self.scalars: dict[str, float | int | None] = {}
        self.notes: dict[str, str] = {}


class _Measurement:
    """The measurement of one cortex, with a method for each step; a step may run beside those that it does not need."""

    def __init__(self, accuracy: str, wanted: Asked):
        self.accuracy, self._chosen, self._wanted = accuracy, resampling.accuracy_of(accuracy), wanted
        self.across: GyralThickness | None = None
        self.graph: nx.MultiGraph | None = None
        self.curvature_scale, self.folding_scale = np.nan, np.nan
        names = ("begin", "depth", "thickness", "curvature", "folding", "gyral thickness", "gyral graph", "local")
        self._parts = {name: _Part() for name in names}

    def _put(self, part: _Part, name: str, values: PerVertex) -> PerVertex:
        """Store a map, NaN outside the cortex."""
        part.maps[name] = np.where(self.mask, values, np.nan)
        return part.maps[name]

    def begin(self, given: Cortex, repair: bool) -> None:
        """Repair and check the surfaces; mask, areas and volumes."""
        part = self._parts["begin"]
        self.mended = mending.measurable(given, repair=repair)
        self.cortex = cortex = self.mended.cortex
        self.copy = resampling.as_given(cortex)
        self.mask = mask = checks.cortex_mask(cortex)
        part.notes |= notes.of_input(cortex) | self.mended.notes | defects.remarks(cortex, mask, self.mended.of)
        part.notes |= defects.input_remarks(cortex)
        faces = cortex.faces
        self.closed, self.pieces = geometry.is_closed(faces), geometry.components(cortex.n_vertices, faces)[0]
        self.euler = geometry.euler_characteristic(faces)
        self.area_white, self.area_pial = (geometry.vertex_areas(s.verts, faces) for s in (cortex.white, cortex.pial))
        part.maps["area"] = self.area_white
        part.scalars.update(
            n_vertices=cortex.n_vertices,
            euler_characteristic=self.euler,
            area_pial_mm2=float(self.area_pial.sum()),
            area_white_mm2=float(self.area_white.sum()),
            gray_volume_mm3=float(regions.gray_volumes(cortex)[mask].sum()),
        )
        if self.closed:
            for surface, name in ((cortex.white, "white"), (cortex.pial, "pial")):
                part.scalars[f"volume_{name}_mm3"] = checks.volume(surface)
        part.notes |= notes.of_volumes(self.closed)

    def resample(self) -> None:
        """The mesh on which thicknesses and the gyral net are measured."""
        self.copy = resampling.resampled(self.cortex, self._chosen)

    def depth(self) -> None:
        """Maps that need the surfaces alone."""
        part = self._parts["depth"]
        for name, values in each_map().items():
            self._put(part, name, values(self.cortex))
        part.scalars["mean_sulcal_depth_mm"] = _mean_or_none(part.maps["sulcal_depth"], self.area_pial)
        part.notes |= notes.of_depth()

    def hull(self) -> None:
        """The gyrification index."""
        part, pial = self._parts["depth"], self.cortex.pial
        if self.closed and self.pieces == 1:
            part.scalars["gyrification_index"] = convex_hull.gyrification_index(pial.verts, pial.faces)
        part.notes |= notes.of_gyrification(self.closed, self.pieces)

    def self_crossings(self) -> None:
        found, self.crossed = defects.self_crossings(self.cortex, self.mask)
        self._parts["gyral graph"].notes |= found

    def cortical_thickness(self, cap: float | None) -> None:
        cortex, part = self.cortex, self._parts["thickness"]
        thickness = self._put(part, "cortical_thickness", self.copy.cortical_thickness(mode="surface", cap=cap))
        part.scalars["mean_cortical_thickness_mm"] = _mean_or_none(thickness)
        weights = self.area_white + self.area_pial
        part.scalars["mean_cortical_thickness_area_weighted_mm"] = _mean_or_none(thickness, weights)
        part.notes |= defects.at_cap(thickness, cap)
        if "thickness" in cortex.maps:
            part.maps["thickness_file"], gaps = defects.given_thickness(cortex, self.mask)
            part.notes |= gaps | defects.against_file(part.maps["thickness_file"], thickness)
        part.notes |= notes.of_thickness(cap, "thickness" in cortex.maps)

    def curvature(self, wanted: float | None) -> None:
        """Curvature of pial."""
        part = self._parts["curvature"]
        self.curvature_scale, remark = scale_of_curvature(self.cortex, wanted)
        bent = curvature(self.cortex.pial.verts, self.cortex.faces, self.curvature_scale)
        for name in CURVATURE_MAPS:
            self._put(part, name, getattr(bent, name))
        if remark:
            part.notes["curvature_scale"] = remark

    def folding(self, wanted: float | None) -> None:
        """Folding indices of white."""
        part, scale = self._parts["folding"], scale_of_curvature(self.cortex, wanted)[0]
        self.folding_scale = scale if wanted is not None else scale_of_folding(self.cortex, scale)
        found = folding_indices(self.cortex.white.verts, self.cortex.faces, self.folding_scale)
        part.scalars.update(
            folding_index=found.folding_index, intrinsic_curvature_index=found.intrinsic_curvature_index
        )
        part.notes |= notes.of_folding(self.folding_scale, found, self.closed, self.euler)

    def gyral_thickness(self, options: Mapping[str, Any]) -> None:
        part = self._parts["gyral thickness"]
        self.across = across = self.copy.gyral_thickness(**options)
        self._put(part, "gyral_thickness", across.per_vertex)
        part.scalars.update(
            median_gyral_thickness_mm=_finite_or_none(across.median), wavelength_mm=_finite_or_none(across.wavelength)
        )
        part.notes |= notes.of_gyral_thickness(across)

    def gyral_graph(self, width: float | None) -> None:
        """Crests and hinges; after ``self_crossings``."""
        self.graph = self.copy.gyral_graph(width, midway=self.crossed > LARGEST_CROSSED_SHARE)
        wavelength = _finite_or_none(self.graph.graph["wavelength"])
        self._parts["gyral graph"].scalars["spectral_wavelength_mm"] = wavelength

    def local_gyrification(self) -> None:
        part = self._parts["local"]
        local, unfit = _local_gyrification_or_reason(self.cortex, self.closed, self.pieces, self._chosen.voxels)
        if local is not None:
            local = self._put(part, "local_gyrification_index", local)
            part.scalars["mean_local_gyrification_index"] = _mean_or_none(local, self.area_pial)
        part.notes |= notes.of_local_gyrification(unfit)

    def measures(self, cap: float | None) -> Measures:
        """All results, with the tables of regions, crests and hinges, at the vertices that were given."""
        maps: dict[str, PerVertex] = {}
        scalars: dict[str, float | int | None] = dict.fromkeys(SCALARS)
        said: dict[str, str] = {}
        for part in self._parts.values():
            maps, scalars, said = maps | part.maps, scalars | part.scalars, said | part.notes
        rows, tables = self._regions(maps), GyralTables([], [], [], {})
        if self.graph is not None:
            tables = gyral_tables(self.cortex, self.graph, maps)
            scalars |= tables.scalars
            said |= notes.of_gyral_graph(self.graph, self.across.median if self.across else np.nan)
        said |= notes.of_accuracy(self.accuracy, self.cortex.n_vertices, self.copy.cortex.n_vertices)
        said |= notes.of_regions() if rows else {}
        if "slopes" in self._wanted.steps:
            fitted, why = through_regions(rows)
            scalars |= dict(zip(SLOPE_SCALARS, _slope_scalars(fitted)))
            said |= dict.fromkeys(SLOPE_SCALARS, why if rows else notes.NO_REGIONS_NOTE)
        whole = Measures(
            self.cortex,
            scalars,
            maps,
            rows,
            tables.crests,
            tables.hinges,
            tables.arms,
            self._parameters(cap) | self.mended.numbers,
            said,
            self.graph,
            shapes=thickness_by_shape(self.cortex, maps) if "shapes" in self._wanted.steps else [],
        )
        return self._wanted.part_of(_at_given_vertices(whole, self.mended))

    def _regions(self, maps: Mapping[str, PerVertex]) -> list[dict[str, Any]]:
        if not self._wanted.steps & {"regions", "slopes"}:
            return []
        return regions.region_table(self.cortex, maps, self.across, self.graph)

    def _parameters(self, cap: float | None) -> dict[str, Any]:
        """Scales and options of the steps that ran."""
        across, scales = self.across, self.graph and self.graph.graph["scales"]
        of_steps = [
            ("curvature", "curvature_scale_mm", self.curvature_scale),
            ("folding", "folding_scale_mm", self.folding_scale),
            ("curvature", "curvature_map_surface", "pial"),
            ("folding", "folding_index_surface", "white"),
            ("cortical thickness", "cortical_thickness_mode", "surface"),
            ("cortical thickness", "cortical_thickness_cap_mm", cap),
            ("surfaces", "cortex_mask", ", ".join(filter(None, (checks.cortex_label(self.cortex)[1], APART)))),
            ("surfaces", "cortex_vertices", int(np.count_nonzero(self.mask))),
            ("gyral thickness", "gyral_scale_mm", across and _finite_or_none(across.scale)),
            ("gyral thickness", "gyral_coverage", across and _finite_or_none(across.coverage)),
            *(("gyral graph", f"graph_{name}_mm", value) for name, value in (asdict(scales) if scales else {}).items()),
            ("surfaces", "accuracy", self.accuracy),
            ("surfaces", "accuracy_vertices", self.copy.cortex.n_vertices),
            ("local gyrification", "local_gyrification_voxel_mm", CLOSING_RADIUS_MM / self._chosen.voxels),
        ]
        return {name: value for step, name, value in of_steps if step in self._wanted.steps}


def _at_given_vertices(measures: Measures, mend: mending.Mended) -> Measures:
    """The measures of a repaired cortex at the given vertices, so that maps fit the files that were read.

    A vertex that was joined with another has the values of that one, and a vertex that was left out has none. A
    vertex that was separated has the values of the sheet with most of its triangles. For areas, a joined vertex has
    0 and a separated vertex has the sum, so totals stay the same. The triangles are the repaired ones. Those that
    pinched an edge do so again, because separating them needs vertices that the files do not have.
    """
    if mend.cortex is mend.of:
        return measures
    faces = mend.source[mend.cortex.faces]
    given = {name: getattr(mend.of, name) for name in ("white", "pial", "inflated", "sphere")}
    surfaces = {name: surface and replace(surface, faces=faces) for name, surface in given.items()}
    maps = {name: values[mend.place] for name, values in measures.maps.items()}
    maps["area"] = np.bincount(mend.source, measures.maps["area"], mend.of.n_vertices).astype(np.float64)
    maps = {name: np.where(mend.place < 0, np.nan, values) for name, values in maps.items()}
    if measures.graph is not None:
        for _, node in measures.graph.nodes(data=True):
            node["vertex"] = int(mend.source[node["vertex"]])
        for *_, crest in measures.graph.edges(data=True):
            crest["vertices"] = mend.source[crest["vertices"]]
    hinges = [{**row, "vertex": int(mend.source[row["vertex"]])} for row in measures.hinges]
    return replace(measures, cortex=replace(mend.of, **surfaces), maps=maps, hinges=hinges)


def _local_gyrification_or_reason(
    cortex: Cortex, closed: bool, pieces: int, voxels: float
) -> tuple[PerVertex | None, str]:
    """The index (N,) with ``voxels`` voxels in the radius of the closing, or the reason why there is none."""
    pial = cortex.pial
    if not closed or pieces != 1:
        return None, "the pial surface is not one closed piece"
    if cortex.units != "mm":
        return None, f"lengths are in {cortex.units!r}, not mm"
    radius = geometry.equal_area_radius(pial.verts, pial.faces)
    if not 1 <= radius / CLOSING_RADIUS_MM <= 20:
        return None, (
            f"a sphere of its area has a radius of {radius:.3g}, which does not suit a ball of {CLOSING_RADIUS_MM:g} mm"
        )
    return local_gyrification_index(pial.verts, pial.faces, voxel=CLOSING_RADIUS_MM / voxels), ""


def _mean_or_none(values: PerVertex, weights: PerVertex | None = None) -> float | None:
    """Mean over the finite values; None if there are none."""
    known = np.isfinite(values)
    if not known.any():
        return None
    return float(np.average(values[known], weights=None if weights is None else weights[known]))


def _slope_scalars(fitted: Line | None) -> list[float | None]:
    """Values of the scalars in ``SLOPE_SCALARS``; the bounds are None where there are too few regions for them."""
    if fitted is None:
        return [None] * len(SLOPE_SCALARS)
    return [_finite_or_none(value) for value in (fitted.robust, fitted.low, fitted.high, fitted.slope, fitted.r)]


def _finite_or_none(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
