"""All measures of one cortex: ``measure(cortex)``, the same code for simulated and FreeSurfer surfaces."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from morphofold import geometry
from morphofold.analysis import notes, region_tables, relief
from morphofold.analysis.curvatures import curvature, scale_of_curvature, scale_of_folding
from morphofold.analysis.diffusion import diffusion
from morphofold.analysis.graph import depth_potential
from morphofold.analysis.graph.gyral_tables import gyral_tables
from morphofold.analysis.gyrification import hull_measures
from morphofold.analysis.gyrification.folding_indices import folding_indices
from morphofold.analysis.gyrification.local_gyrification import CLOSING_RADIUS_MM, local_gyrification_index
from morphofold.analysis.maps import each_map
from morphofold.analysis.measures_result import COLUMNS, GRAPH_SCALARS, SCALARS, SLOPE_SCALARS, Measures
from morphofold.analysis.resampled_cortex import accuracy_of, as_given, resampled
from morphofold.analysis.steps import Step, run_steps, steps_for
from morphofold.analysis.thickness.gyral_thickness import GyralThickness
from morphofold.analysis.thickness.robust_slope import through_regions
from morphofold.errors import NothingToDo, UnknownName
from morphofold.mesh_quality import cortex_checks, defects, repair as mending
from morphofold.note_texts import NOTES, note
from morphofold.number_texts import listed
from morphofold.progress_callbacks import Progress, logged
from morphofold.surface import Cortex, PerVertex, Surface
from morphofold.threads import one_blas_thread
from morphofold.timing import Stages
from morphofold.validators import check_kind

if TYPE_CHECKING:
    import networkx as nx

Values = dict[str, Any]  # maps and scalars by name
Result = tuple[Values, notes.Notes]
CURVATURE_MAPS = ("H", "K", "k1", "k2", "shape_index", "curvedness")
FOLDING_INDICES = ("folding_index", "intrinsic_curvature_index")
MEAN_THICKNESSES = ("mean_cortical_thickness_mm", "mean_cortical_thickness_area_weighted_mm")
GYRAL_THICKNESS = ("gyral_thickness", "median_gyral_thickness_mm", "wavelength_mm")
LOCAL_GYRIFICATION = ("local_gyrification_index", "mean_local_gyrification_index")
GIVEN_THICKNESS = "thickness_file"  # a map only of a cortex that came with a thickness
# share of crossed triangles of white, above which the net is taken midway to pial; a person has 0.00003
LARGEST_CROSSED_SHARE = 0.01
VOLUMES = ("volume_white_mm3", "volume_pial_mm3")
#: of one surface alone these are None; its area and volume are those of pial
SCALARS_OF_TWO_SURFACES = ("gray_volume_mm3", "area_white_mm2", "volume_white_mm3", *MEAN_THICKNESSES, *SLOPE_SCALARS)
STEPS_OF_TWO_SURFACES = ("cortical thickness", "slopes", "shapes")
APART_TEXT = "where white and pial differ"  # part of every cortex mask


@one_blas_thread()
def measure(
    cortex: Cortex | Surface,
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
    cortex : Cortex or Surface
        White and pial surface [mm]. Its mask, regions and maps are used where it has them. One Surface, or
        :meth:`Cortex.of_surface`, has all measures that do not need two: not thickness of the cortex, volume of gray
        matter, and what follows from them; ``area_pial_mm2`` and ``volume_pial_mm3`` are those of the surface.
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
    check_kind(cortex, (Cortex, Surface), "measure: cortex")
    cortex = Cortex.of_surface(cortex) if isinstance(cortex, Surface) else cortex
    names = requested_names(cortex, only)
    steps = _possible_steps(cortex) if names is None else steps_for(names, _possible_steps(cortex))
    requested = names, frozenset(step.name for step in steps)
    work = _Measurement(cortex, *requested, accuracy, repair, thickness_cap, curvature_scale, gyral or {}, gyral_width)
    steps = [step for step in steps if step.run]
    measures_step = Step("measures", [step.name for step in steps], (), _Measurement.measures, 0.01, "regions")
    progress = progress or logged
    run_steps([*steps, measures_step], work, work.results, progress, clock or Stages())
    progress(1.0, "done")
    measures: Measures = work.results["measures"]
    return measures


def requested_names(cortex: Cortex, only: Sequence[str] | None) -> tuple[str, ...] | None:
    """Names of what to measure of a cortex: everything (None), or ``only`` these scalars, maps and tables.

    Raises
    ------
    ValueError
        If ``only`` is empty or has an unknown name; the message lists what can be asked for.
    """
    if only is None:
        return None
    if isinstance(only, str):
        raise TypeError(f"measure: only must be a list of names, not a text. Pass only=[{only!r}].")
    made_names = [name for step in _possible_steps(cortex) for name in step.makes]
    impossible = [GIVEN_THICKNESS] * ("thickness" not in cortex.maps)
    impossible += SCALARS_OF_TWO_SURFACES if cortex.is_one_surface else ()
    possible = [name for name in made_names if name not in impossible]
    if not only:
        raise NothingToDo(f"measure: only is empty. Name what to measure: {', '.join(possible)}.")
    if unknown_names := [name for name in only if name not in possible]:
        raise UnknownName(
            f"{cortex.called}: only has {', '.join(map(repr, unknown_names))}, which can't be measured. Name some of "
            f"these: {', '.join(possible)}."
        )
    return tuple(dict.fromkeys(only))


def _possible_steps(cortex: Cortex) -> list[Step]:
    return [step for step in STEPS if not (cortex.is_one_surface and step.name in STEPS_OF_TWO_SURFACES)]


@dataclass
class _Measurement:
    """The measurement of one cortex. Each step gives maps and scalars by name, and notes on them."""

    original: Cortex
    names: tuple[str, ...] | None
    steps: frozenset[str]
    accuracy: str
    repair: bool
    cap: float | None
    curvature_scale: float | None
    gyral_options: Mapping[str, Any]
    gyral_width: float | None

    def __post_init__(self) -> None:
        self.preset = accuracy_of(self.accuracy)
        self.gyral: GyralThickness | None = None
        self.graph: nx.MultiGraph | None = None
        self.used_scales = dict.fromkeys(("curvature", "folding"), np.nan)
        self.results: dict[str, Any] = {}

    def _on_cortex(self, values: PerVertex) -> PerVertex:
        return np.where(self.mask, values, np.nan)

    def surfaces(self) -> Result:
        """Repair and check the surfaces; mask, areas and volumes."""
        self.mended = mending.measurable(self.original, repair=self.repair)
        self.cortex = cortex = self.mended.cortex
        self.resampled = as_given(cortex)
        self.mask = mask = cortex_checks.cortex_mask(cortex)
        texts = notes.of_input(cortex) | self.mended.notes | defects.remarks(cortex, mask, self.mended.original)
        texts |= defects.input_remarks(cortex) | note("gray_volume_mm3")
        faces = cortex.faces
        self.is_closed, self.n_pieces = geometry.is_closed(faces), geometry.components(cortex.n_vertices, faces)[0]
        self.euler = geometry.euler_characteristic(faces)
        self.area_white, self.area_pial = (geometry.vertex_areas(s.verts, faces) for s in (cortex.white, cortex.pial))
        values = {
            "area": self.area_white,
            "n_vertices": cortex.n_vertices,
            "euler_characteristic": self.euler,
            "area_pial_mm2": float(self.area_pial.sum()),
            "area_white_mm2": float(self.area_white.sum()),
            "gray_volume_mm3": float(region_tables.gray_volumes(cortex)[mask].sum()),
        }
        if self.is_closed:
            volumes = [cortex_checks.volume(surface) for surface in (cortex.white, cortex.pial)]
            values |= dict(zip(VOLUMES, volumes, strict=True))
        texts |= note("volume" if self.is_closed else "no_volume", *VOLUMES)
        if cortex.is_one_surface:
            values |= dict.fromkeys(SCALARS_OF_TWO_SURFACES)
            texts |= note("one_surface") | note("one_surface", *SCALARS_OF_TWO_SURFACES)
        return values, texts

    def prepare(self) -> None:
        """Compute what several steps need of the surfaces, beside the checks; it is kept with them."""
        cortex = self.original
        white, pial = (cortex.white, depth_potential.COTANGENT_BOUNDS), (cortex.pial, relief.COTANGENT_BOUNDS)
        for (surface, clip), step_name in ((white, "gyral graph"), (pial, "gyral thickness")):
            if step_name in self.steps:
                diffusion(surface.verts, surface.faces, clip)
            geometry.vertex_normals(surface.verts, surface.faces)
        geometry.incident_faces(cortex.n_vertices, cortex.faces)

    def resample(self) -> None:
        """The mesh on which thicknesses and the gyral net are measured."""
        self.resampled = resampled(self.cortex, self.preset)

    def depth(self) -> Result:
        """Maps that need the surfaces alone."""
        values: Values = {name: self._on_cortex(values(self.cortex)) for name, values in each_map().items()}
        values["mean_sulcal_depth_mm"] = _mean_or_none(values["sulcal_depth"], self.area_pial)
        return values, note("mean_sulcal_depth_mm")

    def hull(self) -> Result:
        """The gyrification index."""
        pial, scalar_name = self.cortex.pial, "gyrification_index"
        if self.is_closed and self.n_pieces == 1:
            return {scalar_name: hull_measures.gyrification_index(pial.verts, pial.faces)}, note(scalar_name)
        topology_text = f"is in {self.n_pieces} pieces" if self.n_pieces > 1 else "has a border"
        return {}, note("no_gyrification_index", scalar_name, what=topology_text)

    def cortical_thickness(self) -> Result:
        cortex, cap, (mean_name, weighted_name) = self.cortex, self.cap, MEAN_THICKNESSES
        thickness = self._on_cortex(self.resampled.cortical_thickness(mode="surface", cap=cap))
        by_area = _mean_or_none(thickness, self.area_white + self.area_pial)
        values: Values = {"cortical_thickness": thickness, mean_name: _mean_or_none(thickness), weighted_name: by_area}
        texts, file_text = defects.at_cap(thickness, cap), ""
        if "thickness" in cortex.maps:
            values[GIVEN_THICKNESS], gap_texts = defects.given_thickness(cortex, self.mask)
            texts |= gap_texts | defects.against_file(values[GIVEN_THICKNESS], thickness)
            file_text = " The map thickness_file holds the thickness from the file."
        bound_text = f"each at most {cap:g} mm." if cap else "without an upper bound."
        definition = f"of half the sum of the closest distances from white to pial and from pial to white, {bound_text}"
        return values, texts | note(mean_name, what=definition, file=file_text) | note(weighted_name, what=definition)

    def curvature(self) -> Result:
        """Curvature of pial."""
        scale, remark_text = scale_of_curvature(self.cortex, self.curvature_scale)
        self.used_scales["curvature"] = scale
        curvatures = curvature(self.cortex.pial.verts, self.cortex.faces, scale)
        texts = {"curvature_scale": remark_text} if remark_text else {}
        return {name: self._on_cortex(getattr(curvatures, name)) for name in CURVATURE_MAPS}, texts

    def folding(self) -> Result:
        """Folding indices of white."""
        scale = scale_of_curvature(self.cortex, self.curvature_scale)[0]
        if self.curvature_scale is None:
            scale = scale_of_folding(self.cortex, scale)
        self.used_scales["folding"] = scale
        indices = folding_indices(self.cortex.white.verts, self.cortex.faces, scale)
        required_text = f"; Gauss-Bonnet requires {self.euler / 2:g}" if self.is_closed else ""
        values = {name: getattr(indices, name) for name in FOLDING_INDICES}
        return values, note("folding", *FOLDING_INDICES, scale=scale, total=indices.total, required=required_text)

    def gyral_thickness(self) -> Result:
        self.gyral = gyral = self.resampled.gyral_thickness(**self.gyral_options)
        (map_name, median_name, wavelength_name), width_map = GYRAL_THICKNESS, self._on_cortex(gyral.per_vertex)
        values = {map_name: width_map, median_name: _finite_or_none(gyral.median)}
        values[wavelength_name] = _finite_or_none(gyral.wavelength)
        if gyral.reason:
            return values, dict.fromkeys((median_name, wavelength_name), gyral.reason)
        return values, note(median_name, across=gyral) | note(wavelength_name)

    def self_crossings(self) -> Result:
        texts, self.crossed_share = defects.self_crossings(self.cortex, self.mask)
        return {}, texts

    def gyral_graph(self) -> Result:
        """Crests and hinges."""
        self.graph = self.resampled.gyral_graph(self.gyral_width, use_midway=self.crossed_share > LARGEST_CROSSED_SHARE)
        return {"spectral_wavelength_mm": _finite_or_none(self.graph.graph["wavelength"])}, {}

    def local_gyrification(self) -> Result:
        (map_name, mean_name), pial, units, reason = LOCAL_GYRIFICATION, self.cortex.pial, self.cortex.units, ""
        radius = geometry.equal_area_radius(pial.verts, pial.faces)
        if not self.is_closed or self.n_pieces != 1:
            reason = "the pial surface is not one closed piece"
        elif units != "mm":
            reason = f"lengths are in {units!r}, not mm"
        elif not 1 <= radius / CLOSING_RADIUS_MM <= 20:
            ball_text = f"a ball of {CLOSING_RADIUS_MM:g} mm"
            reason = f"a sphere of its area has a radius of {radius:.3g}, which does not suit {ball_text}"
        if reason:
            return {}, note("no_local_gyrification_index", mean_name, why=reason)
        voxel = CLOSING_RADIUS_MM / self.preset.radius_voxels
        local_index = self._on_cortex(local_gyrification_index(pial.verts, pial.faces, voxel=voxel))
        return {map_name: local_index, mean_name: _mean_or_none(local_index, self.area_pial)}, note(mean_name)

    def measures(self) -> Measures:
        """All results, with the tables of regions, crests and hinges, at the vertices that were given."""
        values, texts = Values(), notes.Notes()
        for result in filter(None, self.results.values()):
            values |= result[0]
            texts |= result[1]
        maps = {name: value for name, value in values.items() if isinstance(value, np.ndarray)}
        if self.steps & {"regions", "slopes"}:
            values["regions"] = region_tables.region_table(self.cortex, maps, self.gyral, self.graph)
        if "shapes" in self.steps:
            values["shapes"] = region_tables.thickness_by_shape(self.cortex, maps)
        if self.graph is not None:
            values |= gyral_tables(self.cortex, self.graph, maps)
            texts |= notes.of_gyral_graph(self.graph, self.gyral.median if self.gyral else np.nan)
        texts |= notes.of_accuracy(self.accuracy, self.cortex.n_vertices, self.resampled.cortex.n_vertices)
        if region_rows := values.get("regions", []):
            texts |= note("regions")
        if "slopes" in self.steps:
            slope_line, slope_note = through_regions(region_rows)
            if slope_line is not None:
                slope_values = (slope_line.robust, slope_line.low, slope_line.high, slope_line.slope, slope_line.r)
                values |= dict(zip(SLOPE_SCALARS, map(_finite_or_none, slope_values)))
            texts |= dict.fromkeys(SLOPE_SCALARS, slope_note if region_rows else NOTES["parcellation"])
        all_measures = Measures(
            self.cortex,
            {name: values.get(name) for name in SCALARS},
            maps,
            parameters=self._parameters() | self.mended.numbers,
            notes=texts,
            graph=self.graph,
            **{table: values.get(table, []) for table in COLUMNS},
        )
        return _part(_at_given_vertices(all_measures, self.mended), self.names)

    def _parameters(self) -> dict[str, Any]:
        """Scales and options of the steps that ran."""
        gyral, scales = self.gyral, self.graph and self.graph.graph["scales"]
        apart_text = "" if self.cortex.is_one_surface else APART_TEXT
        step_parameters = [
            ("curvature", "curvature_scale_mm", self.used_scales["curvature"]),
            ("folding", "folding_scale_mm", self.used_scales["folding"]),
            ("curvature", "curvature_map_surface", "pial"),
            ("folding", "folding_index_surface", "one surface" if self.cortex.is_one_surface else "white"),
            ("cortical thickness", "cortical_thickness_mode", "surface"),
            ("cortical thickness", "cortical_thickness_cap_mm", self.cap),
            (
                "surfaces",
                "cortex_mask",
                ", ".join(filter(None, (cortex_checks.cortex_label(self.cortex)[1], apart_text))),
            ),
            ("surfaces", "cortex_vertices", int(np.count_nonzero(self.mask))),
            ("gyral thickness", "gyral_scale_mm", gyral and _finite_or_none(gyral.scale)),
            ("gyral thickness", "gyral_coverage", gyral and _finite_or_none(gyral.coverage)),
            *(("gyral graph", f"graph_{name}_mm", value) for name, value in (asdict(scales) if scales else {}).items()),
            ("surfaces", "accuracy", self.accuracy),
            ("surfaces", "accuracy_vertices", self.resampled.cortex.n_vertices),
            ("local gyrification", "local_gyrification_voxel_mm", CLOSING_RADIUS_MM / self.preset.radius_voxels),
        ]
        return {name: value for step, name, value in step_parameters if step in self.steps}


_SURFACES, _RESAMPLED, _THICKNESSES = ("surfaces",), ("resampling",), ("cortical thickness", "gyral thickness")
_SIZE_NAMES = (
    "area n_vertices euler_characteristic area_pial_mm2 area_white_mm2 gray_volume_mm3 volume_white_mm3 volume_pial_mm3"
).split()
_NET_NAMES = ("arms", *GRAPH_SCALARS, "spectral_wavelength_mm")
_CORTICAL = ("cortical_thickness", GIVEN_THICKNESS, *MEAN_THICKNESSES)
_TABLE_STEPS = ("gyral graph", *_THICKNESSES, "curvature")
#: the steps of a measurement; each needs only some that stand before it. Those without a function end the work
STEPS = (
    Step("surfaces", (), _SIZE_NAMES, _Measurement.surfaces, 0.1),
    Step("operators", (), (), _Measurement.prepare),
    Step("resampling", ("surfaces", "operators"), (), _Measurement.resample, 0.0, "cortical thickness"),
    Step("depth", _SURFACES, (*each_map(), "mean_sulcal_depth_mm"), _Measurement.depth, 0.02),
    Step("hull", _SURFACES, ("gyrification_index",), _Measurement.hull),
    Step("cortical thickness", _RESAMPLED, _CORTICAL, _Measurement.cortical_thickness, 0.1, "cortical thickness"),
    Step("curvature", _SURFACES, CURVATURE_MAPS, _Measurement.curvature, 0.1, "curvature"),
    Step("folding", _SURFACES, FOLDING_INDICES, _Measurement.folding, 0.1, "curvature"),
    # gyral thickness takes the distances of cortical thickness, which are found once and timed as that
    Step(
        "gyral thickness",
        (*_RESAMPLED, "cortical thickness"),
        GYRAL_THICKNESS,
        _Measurement.gyral_thickness,
        0.2,
        "gyral thickness",
    ),
    Step("self-crossings", _SURFACES, (), _Measurement.self_crossings, 0.02),
    Step("gyral graph", ("resampling", "self-crossings"), _NET_NAMES, _Measurement.gyral_graph, 0.25, "gyral graph"),
    Step(
        "local gyrification", _SURFACES, LOCAL_GYRIFICATION, _Measurement.local_gyrification, 0.1, "local gyrification"
    ),
    Step("hinges", ("gyral graph", "cortical thickness"), ("hinges",)),
    Step("crests", _TABLE_STEPS, ("crests",)),
    Step("slopes", _THICKNESSES, SLOPE_SCALARS),
    Step("regions", (*_TABLE_STEPS, "local gyrification"), ("regions",)),
    Step("shapes", ("cortical thickness", "curvature", "depth"), ("shapes",)),
)


def _part(all_measures: Measures, names: tuple[str, ...] | None) -> Measures:
    """The measures without what was not asked for.

    Where a number that was not asked for can't be computed, its note stays: it is the reason for empty maps, too.
    """
    if names is None:
        return all_measures
    scalars = {name: value if name in names else None for name, value in all_measures.scalars.items()}
    unasked_names = {name for name, value in all_measures.scalars.items() if name not in names and value is not None}
    texts = {name: text for name, text in all_measures.notes.items() if name not in unasked_names}
    return replace(
        all_measures,
        scalars=scalars,
        maps={name: values for name, values in all_measures.maps.items() if name in names},
        parameters={**all_measures.parameters, "only": list(names)},
        notes=texts | note("only", names=listed(names)),
        **{table: getattr(all_measures, table) if table in names else [] for table in COLUMNS},
    )


def _at_given_vertices(measures: Measures, mended: mending.Mended) -> Measures:
    """The measures of a repaired cortex at the given vertices, so that maps fit the files that were read.

    A vertex that was joined with another has the values of that one, and a vertex that was left out has none. A
    vertex that was separated has the values of the sheet with most of its triangles. For areas, a joined vertex has
    0 and a separated vertex has the sum, so totals stay the same. The triangles are the repaired ones. Those that
    pinched an edge do so again, because separating them needs vertices that the files do not have.
    """
    if mended.cortex is mended.original:
        return measures
    faces = mended.source[mended.cortex.faces]
    original_surfaces = {name: getattr(mended.original, name) for name in ("white", "pial", "inflated", "sphere")}
    surfaces = {name: surface and replace(surface, faces=faces) for name, surface in original_surfaces.items()}
    maps = {name: values[mended.target] for name, values in measures.maps.items()}
    maps["area"] = np.bincount(mended.source, measures.maps["area"], mended.original.n_vertices).astype(np.float64)
    maps = {name: np.where(mended.target < 0, np.nan, values) for name, values in maps.items()}
    if measures.graph is not None:
        for _, node in measures.graph.nodes(data=True):
            node["vertex"] = int(mended.source[node["vertex"]])
        for *_, crest in measures.graph.edges(data=True):
            crest["vertices"] = mended.source[crest["vertices"]]
    hinges = [{**row, "vertex": int(mended.source[row["vertex"]])} for row in measures.hinges]
    return replace(measures, cortex=replace(mended.original, **surfaces), maps=maps, hinges=hinges)


def _mean_or_none(values: PerVertex, weights: PerVertex | None = None) -> float | None:
    """Mean over the finite values; None if there are none."""
    is_finite = np.isfinite(values)
    if not is_finite.any():
        return None
    return float(np.average(values[is_finite], weights=None if weights is None else weights[is_finite]))


def _finite_or_none(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
