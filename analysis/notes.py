"""Notes that ``measure`` adds to its numbers: definitions, reasons for missing values, and warnings on the input."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from morphofold.analysis.graph.hinges import LEAST_CONFIDENCE, LEAST_STRICT_CONFIDENCE
from morphofold.mesh_quality.checks import cortex_label, off_pial
from morphofold.surface import Cortex

if TYPE_CHECKING:
    import networkx as nx

    from morphofold.analysis.gyrification.folding import FoldingIndices
    from morphofold.analysis.thickness.gyral import GyralThickness

Notes = dict[str, str]

NO_REGIONS_NOTE = (
    "The surfaces have no parcellation (FreeSurfer keeps one in label/?h.aparc.annot), so there is no table of regions "
    "and no line fitted through regions."
)
AVERAGE_BRAINS = ("fsaverage", "cvs_avg")  # names of the averages that come with FreeSurfer
# crown width over gyral thickness in people, and the factor beyond which it is noted
USUAL_WIDTH_RATIO, LARGEST_RATIO_FACTOR = 0.7, 2.0
LEAST_WIDTH_IN_EDGES = 4.0  # crown width in mean edges, below which the mesh is noted as coarse

HINGE_SCALARS = ("n_hinges", "n_hinges_3", "n_hinges_4", "n_hinges_low", "n_hinges_high")
GRAPH_SCALARS = (*HINGE_SCALARS, "n_crests", "crest_length_mm")


def of_gyral_graph(graph: nx.MultiGraph, gyral_thickness: float) -> Notes:
    """Notes on how crests and hinges were found, and on whether the mesh is fine enough for them.

    Adds the note ``gyral_width`` if the gyri of the net do not have the size of ``gyral_thickness`` [mm], the median;
    NaN if it is not known.
    """
    scales, surface = graph.graph["scales"], graph.graph["surface"]
    if scales is None:
        why = f"{surface} has no gyri: no crest separates two basins of its depth potential."
        return dict.fromkeys((*GRAPH_SCALARS, "spectral_wavelength_mm"), why)
    text = (
        f"Net of crests on {surface}, crown width {scales.width:.2f} mm (over the crown from inflection to inflection; "
        "gyral thickness is from wall to wall of pial). Sulcal pits that are less than "
        f"{scales.persistence:.2f} mm below the pass to a deeper one are joined to it, hinges closer than "
        f"{scales.merge:.2f} mm are merged, and spurs shorter than {scales.prune:.2f} mm are removed. The number of "
        "hinges depends on these lengths: hinge_sensitivity gives the changes."
    )
    edge = graph.graph["edge"]
    if edge > scales.width / LEAST_WIDTH_IN_EDGES:
        text += (
            f" The mean edge, {edge:.2f} mm, is more than 1/{LEAST_WIDTH_IN_EDGES:g} of the crown width: a finer mesh "
            "may give other hinges."
        )
    sure = [node["confidence"] for _, node in graph.nodes(data=True) if node["degree"] > 2]
    low, usual = (sum(value >= least for value in sure) for least in (LEAST_STRICT_CONFIDENCE, LEAST_CONFIDENCE))
    counted = (
        f" {usual} hinges, {low} to {len(sure)} depending on the confidence asked for. n_hinges, n_hinges_3 and "
        f"n_hinges_4 leave out hinges with a confidence below {LEAST_CONFIDENCE:g} (an arm dips into a sulcus, two "
        "arms point almost the same way, or a pit or spur is just large enough). n_hinges_low leaves out those below "
        f"{LEAST_STRICT_CONFIDENCE:g}, n_hinges_high none. The table and the net contain all of them."
    )
    ratio = scales.width / gyral_thickness
    apart = {
        "gyral_width": f"The crown width, {scales.width:.2f} mm, is {ratio:.2f} of the gyral thickness, "
        f"{gyral_thickness:.2f} mm; {USUAL_WIDTH_RATIO:g} is usual. Hinges and crests are in doubt. Check the white "
        "surface, or set the width (--gyral-width)."
    }
    odd = (
        ratio < USUAL_WIDTH_RATIO / LARGEST_RATIO_FACTOR or ratio > USUAL_WIDTH_RATIO * LARGEST_RATIO_FACTOR
    )  # False for NaN: no gyral thickness
    return (
        (apart if odd else {})
        | dict.fromkeys(GRAPH_SCALARS, text)
        | dict.fromkeys(HINGE_SCALARS, text + counted)
        | {
            "spectral_wavelength_mm": "2 pi divided by the root mean square wavenumber of the depth potential along "
            "the white surface."
        }
    )


def of_input(cortex: Cortex) -> Notes:
    """Notes on an average brain, on missing files, and on the health and rest of a simulation."""
    notes = {}
    subjects = [Path(file).resolve().parent.parent.name for file in cortex.files[:2]]  # white and pial
    if average := next((name for name in subjects if name.startswith(AVERAGE_BRAINS)), ""):
        notes["average"] = (
            f"{average} is an average of many brains. Folds that differ between people are smoothed away, so its "
            "gyrification, hinges and gyral thickness are those of no person."
        )
    notes |= of_cortex_mask(cortex)
    if cortex.regions is not None and (template := cortex.info.get("annotation_from")):
        notes["annotation_from"] = (
            f"The subject has no parcellation of its own: {cortex.regions.name} was carried over from the template "
            f"{template} through {cortex.hemi}.sphere.reg. Borders of regions are those of the template."
        )
    if warnings := cortex.info.get("warnings"):
        notes["simulation"] = "; ".join(map(str, warnings))
    stage = cortex.info.get("health", {})
    if stage.get("at_rest") is False:
        notes["rest"] = f"Not at rest: about {stage['distance_over_T']:.2f} T away, and may still change its folds."
    return notes


def of_cortex_mask(cortex: Cortex) -> Notes:
    """Notes on how the medial wall was found without a cortex label, and on a missing parcellation."""
    if cortex.origin == "simulation":
        return {}
    label, word = cortex_label(cortex)
    if word == "label":
        return {} if cortex.regions else {"parcellation": NO_REGIONS_NOTE}
    out = f"{np.count_nonzero(~label):,} of {cortex.n_vertices:,} vertices"
    met = np.count_nonzero(~off_pial(cortex))
    if not word and met == cortex.n_vertices:  # one surface, which is unfolded
        return {}
    how = {
        "annotation": f"cortex is what the annotation's regions cover; this leaves out {out}.",
        "template": f"cortex is where fsaverage5 is, carried over by {cortex.hemi}.sphere.reg; this leaves out {out}.",
        "thickness": f"the medial wall is where their thickness file is 0; this leaves out {out}.",
        "geometry": f"the medial wall is where white and pial nearly meet; this leaves out {out}.",
        "": "every vertex counts as cortex, because white and pial nearly meet on no patch as large as a medial wall"
        + (f"; only {met:,} of {cortex.n_vertices:,} vertices, where they coincide, are left out." if met else "."),
    }[word]
    lacking = "cortex label" if cortex.regions else "cortex label and no parcellation (so there is no table of regions)"
    return {"cortex_mask": f"No {lacking} came with the surfaces: {how}"}


def of_volumes(closed: bool) -> Notes:
    """Definitions of the volumes: gray matter, and within white and pial."""
    enclosed = (
        "Volume that the whole surface encloses. FreeSurfer closes the surface across the medial wall, so white also "
        "encloses deep gray matter and ventricles."
        if closed
        else "The surface has a border, so it encloses no volume."
    )
    return {
        "gray_volume_mm3": "Sum over the cortex of the volume between the triangles of white and of pial, as "
        "mris_anatomical_stats computes it.",
        "volume_white_mm3": enclosed,
        "volume_pial_mm3": enclosed,
    }


def of_thickness(cap: float | None, with_file: bool) -> Notes:
    bound = f"each at most {cap:g} mm." if cap else "without an upper bound."
    what = f"of half the sum of the closest distances from white to pial and from pial to white, {bound}"
    file = " The map thickness_file holds the thickness from the file." * with_file
    return {
        "mean_cortical_thickness_mm": f"Unweighted mean over the vertices of the cortex, as in FreeSurfer, {what} "
        f"Dense parts of the mesh count more.{file}",
        "mean_cortical_thickness_area_weighted_mm": f"Mean over the cortex, weighted by white plus pial area, {what}",
    }


def of_folding(scale: float, folding: FoldingIndices, closed: bool, euler: int) -> Notes:
    """``euler`` is the Euler characteristic; the note compares with Gauss-Bonnet on closed surfaces only."""
    asked = f"; Gauss-Bonnet requires {euler / 2:g}" if closed else ""
    text = (
        f"Of the whole white surface, with curvature smoothed over {scale:.2f} mm. The integrals are FreeSurfer's, but "
        "FreeSurfer fits curvature to one or two rings, so values differ. They depend on the scale: compare them at "
        f"equal scale only. The integral of K divided by 4 pi is {folding.total:.2f}{asked}."
    )
    return dict.fromkeys(("folding_index", "intrinsic_curvature_index"), text)


def of_depth() -> Notes:
    return {"mean_sulcal_depth_mm": "Distance to the convex hull, averaged over the pial area of the cortex."}


def of_gyrification(closed: bool, pieces: int) -> Notes:
    if closed and pieces == 1:
        index = "Area of the whole pial surface divided by the area of its convex hull."
    else:
        what = f"is in {pieces} pieces" if pieces > 1 else "has a border"
        index = (
            f"The pial surface {what}, so the area of its convex hull is not the area that it would have unfolded. "
            "Sulcal depth is still the distance to that hull."
        )
    return {"gyrification_index": index}


def of_local_gyrification(unfit: str) -> Notes:
    """``unfit``: why there is no local index."""
    return {
        "mean_local_gyrification_index": f"No local gyrification index: {unfit}."
        if unfit
        else "Area of the pial surface within 25 mm divided by that of its closing by a ball of 15 mm, averaged over "
        "the pial area of the cortex."
    }


def of_gyral_thickness(across: GyralThickness) -> Notes:
    return {
        "median_gyral_thickness_mm": across.reason
        or (
            "Distance from wall to wall of a gyrus, at mid-height on the pial surface. Folds are defined by a "
            f"smoothing length of {across.scale:.1f} mm. {across.coverage:.0%} of the mid-height contour could be "
            f"measured; the quartiles are {across.lower:.1f} and {across.upper:.1f} mm. The map is empty on gyri "
            "without a measurement nearby."
        ),
        "wavelength_mm": across.reason
        or (
            "Twice the pial area of the cortex divided by the length of its mid-height contour: the distance along the "
            "surface from fundus to fundus."
        ),
    }


def of_accuracy(accuracy: str, vertices: int, measured: int) -> Notes:
    """``measured``: vertices of the mesh used for thicknesses and the net. The standard accuracy has no note."""
    if accuracy == "standard":
        return {}
    copy = (
        f"cortical and gyral thickness and the gyral net are measured on resampled surfaces with {measured:,} vertices "
        f"in place of {vertices:,}"
        if measured != vertices
        else "all surfaces are measured without resampling"
    )
    voxel = "coarser" if accuracy == "draft" else "finer"
    return {"accuracy": f"{accuracy.capitalize()} accuracy: {copy}; voxels of local gyrification are {voxel}."}


def of_regions() -> Notes:
    return {
        "regions": "NumVert, area and thickness are computed as in mris_anatomical_stats. A region whose measured "
        "contour is shorter than twice the gyral thickness has none. gyrification_index is the local index, "
        "averaged over the pial area of the region."
    }
