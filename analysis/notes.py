"""Notes that need more than a text: on the input of a measurement, how its cortex was found, and the gyral net."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from morphofold.analysis.graph.hinges import LEAST_CONFIDENCE, LEAST_STRICT_CONFIDENCE
from morphofold.analysis.measures_result import GRAPH_SCALARS, HINGE_SCALARS
from morphofold.mesh_quality.cortex_checks import cortex_label, off_pial
from morphofold.note_texts import MASK_SOURCES, note
from morphofold.surface import Cortex

if TYPE_CHECKING:
    import networkx as nx

Notes = dict[str, str]

AVERAGE_BRAINS = ("fsaverage", "cvs_avg")  # names of the averages that come with FreeSurfer
# crown width over gyral thickness in people, and the factor beyond which it is noted
USUAL_WIDTH_RATIO, LARGEST_RATIO_FACTOR = 0.7, 2.0
LEAST_WIDTH_IN_EDGES = 4.0  # crown width in mean edges, below which the mesh is noted as coarse


def of_gyral_graph(graph: nx.MultiGraph, gyral_thickness: float) -> Notes:
    """Notes on how crests and hinges were found, and on whether the mesh is fine enough for them.

    Adds the note ``gyral_width`` if the gyri of the net do not have the size of ``gyral_thickness`` [mm], the median;
    NaN if it is not known.
    """
    scales, surface_name, mean_edge = (graph.graph[name] for name in ("scales", "surface", "edge"))
    if scales is None:
        return note("no_gyri", *GRAPH_SCALARS, "spectral_wavelength_mm", surface=surface_name)
    ratio, texts = scales.width / gyral_thickness, Notes()
    if ratio < USUAL_WIDTH_RATIO / LARGEST_RATIO_FACTOR or ratio > USUAL_WIDTH_RATIO * LARGEST_RATIO_FACTOR:
        texts = note("gyral_width", width=scales.width, ratio=ratio, thickness=gyral_thickness, usual=USUAL_WIDTH_RATIO)
    texts |= note("net", *GRAPH_SCALARS, scales=scales, surface=surface_name)
    if mean_edge > scales.width / LEAST_WIDTH_IN_EDGES:
        coarse_text = note("coarse_net", edge=mean_edge, least=LEAST_WIDTH_IN_EDGES)["coarse_net"]
        texts |= {name: f"{texts[name]} {coarse_text}" for name in GRAPH_SCALARS}
    scores = [node["confidence"] for _, node in graph.nodes(data=True) if node["degree"] > 2]
    n_low, n_usual = (sum(score >= least for score in scores) for least in (LEAST_STRICT_CONFIDENCE, LEAST_CONFIDENCE))
    bounds = {"least": LEAST_CONFIDENCE, "strict": LEAST_STRICT_CONFIDENCE}
    texts |= note("hinges", *HINGE_SCALARS, net=texts["n_hinges"], low=n_low, usual=n_usual, high=len(scores), **bounds)
    return texts | note("spectral_wavelength_mm")


def of_input(cortex: Cortex) -> Notes:
    """Notes on an average brain, on missing files, and on the health and rest of a simulation."""
    texts, info = Notes(), cortex.info
    subjects = [Path(surface_file).resolve().parent.parent.name for surface_file in cortex.files[:2]]  # white and pial
    if average_name := next((name for name in subjects if name.startswith(AVERAGE_BRAINS)), ""):
        texts |= note("average", name=average_name)
    texts |= of_cortex_mask(cortex)
    if cortex.regions is not None and (template := info.get("annotation_from")):
        texts |= note("annotation_from", name=cortex.regions.name, template=template, hemi=cortex.hemi)
    texts |= note("template_space", origin=cortex.origin) if info.get("in_template_space") else {}
    texts |= {"sphere_unlike": info["sphere_unlike"]} if "sphere_unlike" in info else {}
    if excluded := info.get("excluded"):
        texts |= note("excluded", whole=cortex.n_vertices, **excluded)
    if warnings := info.get("warnings"):
        texts["simulation"] = "; ".join(map(str, warnings))
    health = info.get("health", {})
    if health.get("at_rest") is False:
        texts |= note("rest", distance=health["distance_over_T"])
    return texts


def of_cortex_mask(cortex: Cortex) -> Notes:
    """Notes on how the medial wall was found without a cortex label, and on a missing parcellation."""
    if cortex.origin == "simulation":
        return {}
    is_cortex, mask_source = cortex_label(cortex)
    if mask_source == "label":
        return {} if cortex.regions else note("parcellation")
    n_vertices, n_met = cortex.n_vertices, np.count_nonzero(~off_pial(cortex))
    if not mask_source and n_met == n_vertices:  # one surface, which is unfolded
        return {}
    rest_text = f"; only {n_met:,} of {n_vertices:,} vertices, where they coincide, are left out." if n_met else "."
    excluded_text = f"{np.count_nonzero(~is_cortex):,} of {n_vertices:,} vertices"
    mask_source = mask_source or ("one_surface" if cortex.is_one_surface else "none")
    source_text = MASK_SOURCES[mask_source].format(out=excluded_text, hemi=cortex.hemi, rest=rest_text)
    lacking = "cortex label" if cortex.regions else "cortex label and no parcellation (so there is no table of regions)"
    return note("cortex_mask", lacking=lacking, how=source_text)


def of_accuracy(accuracy: str, n_vertices: int, n_used: int) -> Notes:
    """``n_used``: vertices of the mesh used for thicknesses and the net. The standard accuracy has no note."""
    if accuracy == "standard":
        return {}
    copy_text = (
        f"cortical and gyral thickness and the gyral net are measured on resampled surfaces with {n_used:,} vertices "
        f"in place of {n_vertices:,}"
        if n_used != n_vertices
        else "all surfaces are measured without resampling"
    )
    voxel_text = "coarser" if accuracy == "draft" else "finer"
    return note("accuracy", name=accuracy.capitalize(), copy=copy_text, voxel=voxel_text)
