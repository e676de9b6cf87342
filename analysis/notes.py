"""What ``measure`` says beside its numbers: how each is defined, why one is missing, what to know of the input."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from morphofold.analysis.graph.hinges import DOUBTFUL, SURE
from morphofold.analysis.mesh_quality.checks import cortex_label
from morphofold.surface import Cortex

if TYPE_CHECKING:
    import networkx as nx

    from morphofold.analysis.gyrification.folding import FoldingIndices
    from morphofold.analysis.thickness.gyral import GyralThickness

Notes = dict[str, str]

NO_REGIONS = (
    "No parcellation came with the surfaces (FreeSurfer keeps one in label/?h.aparc.annot): no table of regions, and "
    "no line through them."
)
AVERAGES = ("fsaverage", "cvs_avg")  # how the averages that come with FreeSurfer are called
USUAL, TWICE = 0.7, 2.0  # gyral width over gyral thickness of people, and the factor beyond which it is remarked on
COARSEST = 4.0  # gyral width in mean edges, below which the mesh is remarked on

HINGES = ("n_hinges", "n_hinges_3", "n_hinges_4", "n_hinges_low", "n_hinges_high")
GRAPH = (*HINGES, "n_crests", "crest_length_mm")


def of_gyral_graph(graph: nx.MultiGraph, across: GyralThickness) -> Notes:
    """How crests and hinges were found, whether the mesh is fine enough for them, and the note ``gyral_width``: the net
    is of gyri of another size than those that ``across`` has measured."""
    scales, surface = graph.graph["scales"], graph.graph["surface"]
    if scales is None:
        why = f"{surface} has no gyri: no crest parts two basins of its depth potential."
        return dict.fromkeys((*GRAPH, "spectral_wavelength_mm"), why)
    text = (
        f"Net of crests on {surface}, gyral width {scales.width:.2f} mm (inflection to inflection); pits that persist "
        f"less than {scales.persistence:.2f} mm are joined, hinges nearer than {scales.merge:.2f} mm are one, spurs "
        f"shorter than {scales.prune:.2f} mm are none. The number of hinges depends on these: hinge_sensitivity says "
        "how much."
    )
    edge = graph.graph["edge"]
    if edge > scales.width / COARSEST:
        text += (
            f" The mean edge, {edge:.2f} mm, is more than a {COARSEST:g}th of the width: a finer mesh may have other "
            "hinges."
        )
    sure = [node["confidence"] for _, node in graph.nodes(data=True) if node["degree"] > 2]
    low, usual = (sum(value >= least for value in sure) for least in (SURE, DOUBTFUL))
    counted = (
        f" {usual} hinges, {low} to {len(sure)} by how sure they are: n_hinges, n_hinges_3 and n_hinges_4 leave out "
        f"those of a confidence below {DOUBTFUL:g} (an arm that dips into a sulcus, two arms almost in one direction, "
        f"a pit or a spur just large enough), n_hinges_low those below {SURE:g}, n_hinges_high none; all are in the "
        "table and in the net."
    )
    ratio = scales.width / across.median
    apart = {
        "gyral_width": f"The width of the gyral net, {scales.width:.2f} mm, is {ratio:.2f} of the gyral thickness, "
        f"{across.median:.2f} mm, where {USUAL:g} is usual: hinges and crests are in doubt. Look at the white surface, "
        "or give the width (--gyral-width)."
    }
    odd = ratio < USUAL / TWICE or ratio > USUAL * TWICE  # False for NaN: no gyral thickness
    return (
        (apart if odd else {})
        | dict.fromkeys(GRAPH, text)
        | dict.fromkeys(HINGES, text + counted)
        | {
            "spectral_wavelength_mm": "2 pi over the root mean square wavenumber of the depth potential along "
            "the white surface."
        }
    )


def of_input(cortex: Cortex) -> Notes:
    """An average in place of a brain, what was missing beside the surfaces, and the health warnings of a simulation."""
    notes = {}
    subjects = [Path(file).resolve().parent.parent.name for file in cortex.files]
    if average := next((name for name in subjects if name.startswith(AVERAGES)), ""):
        notes["average"] = (
            f"{average} is an average of many brains, in which folds that differ between people are smoothed away: its "
            "gyrification, hinges and gyral thickness are those of no person."
        )
    notes |= _of_mask(cortex)
    if warnings := cortex.info.get("warnings"):
        notes["simulation"] = "; ".join(map(str, warnings))
    return notes


def _of_mask(cortex: Cortex) -> Notes:
    """How cortex was told from the medial wall without a cortex label, and that there is no parcellation."""
    if cortex.origin == "simulation":
        return {}
    label, word = cortex_label(cortex)
    if word == "label":
        return {} if cortex.regions else {"parcellation": NO_REGIONS}
    out = f"{np.count_nonzero(~label):,} of {cortex.n_vertices:,} vertices"
    met = np.count_nonzero(np.all(cortex.white.verts == cortex.pial.verts, axis=1))
    how = {
        "annotation": f"cortex is what the annotation's regions cover, which leaves out {out}.",
        "thickness": f"the medial wall is where their thickness is 0, {out}, which are left out.",
        "geometry": f"the medial wall is where white and pial nearly meet, {out}, which are left out.",
        "": "every vertex counts as cortex, as white and pial nearly meet on no patch as large as a medial wall"
        + (f"; only {met:,} of {cortex.n_vertices:,} at which they coincide are left out." if met else "."),
    }[word]
    lacking = "cortex label" if cortex.regions else "cortex label and no parcellation (so there is no table of regions)"
    return {"cortex_mask": f"No {lacking} came with the surfaces: {how}"}


def of_volumes(closed: bool) -> Notes:
    """Gray matter, and what white and pial enclose."""
    enclosed = (
        "Volume that the whole surface encloses, as FreeSurfer closes it: across the medial wall, so that white holds "
        "deep gray matter and ventricles, too."
        if closed
        else "The surface has a border, so it encloses no volume."
    )
    return {
        "gray_volume_mm3": "Sum over the cortex of what lies between the triangles of white and of pial, as "
        "mris_anatomical_stats counts it.",
        "volume_white_mm3": enclosed,
        "volume_pial_mm3": enclosed,
    }


def of_thickness(cap: float | None, with_file: bool) -> Notes:
    bound = f"each at most {cap:g} mm." if cap else "without an upper bound."
    what = f"of half the sum of both closest distances between white and pial, {bound}"
    file = " The file's own thickness is the map thickness_file." * with_file
    return {
        "mean_cortical_thickness_mm": f"Plain mean over the vertices of the cortex, as FreeSurfer's, {what} It depends "
        f"on where the mesh is dense.{file}",
        "mean_cortical_thickness_area_weighted_mm": f"Mean over the cortex, by the sum of white and pial area, {what}",
    }


def of_folding(scale: float, folding: FoldingIndices, closed: bool, euler: int) -> Notes:
    """``euler`` is the Euler characteristic; Gauss-Bonnet binds closed surfaces only."""
    asked = f", where Gauss-Bonnet asks for {euler / 2:g}" if closed else ""
    text = (
        f"Of the whole white surface, curvature smoothed over {scale:.2f} mm; FreeSurfer's integrals, but its "
        "curvature is of one or two rings, so values differ. They depend on the scale: compare them at equal scale "
        f"only. The integral of K over 4 pi is {folding.total:.2f}{asked}."
    )
    return dict.fromkeys(("folding_index", "intrinsic_curvature_index"), text)


def of_gyrification(closed: bool, pieces: int) -> Notes:
    depth = "Mean over the pial area of the cortex of the distance to the convex hull."
    if closed and pieces == 1:
        index = "Area of the whole pial surface over the area of its convex hull."
    else:
        what = f"is in {pieces} pieces" if pieces > 1 else "has a border"
        index = (
            f"The pial surface {what}, so the area of its convex hull is not that of what it would be unfolded. "
            "Sulcal depth is still the distance to that hull."
        )
    return {"mean_sulcal_depth_mm": depth, "gyrification_index": index}


def of_local_gyrification(unfit: str) -> Notes:
    """``unfit``: why there is no local index."""
    return {
        "mean_local_gyrification_index": f"No local gyrification index: {unfit}."
        if unfit
        else "Mean over the pial area of the cortex of the area of the pial surface within 25 mm over that of its "
        "closing by a ball of 15 mm."
    }


def of_gyral_thickness(across: GyralThickness) -> Notes:
    return {
        "median_gyral_thickness_mm": across.reason
        or (
            f"Wall to wall at mid-height on the pial surface; folds by a smoothing length of {across.scale:.1f} mm; "
            f"{across.coverage:.0%} of the mid-height contour could be measured, quartiles {across.lower:.1f} and "
            f"{across.upper:.1f} mm. The map is empty on gyri without such a measurement nearby."
        ),
        "wavelength_mm": across.reason
        or (
            "Twice the pial area of the cortex over the length of its mid-height contour: the way along the surface "
            "from fundus to fundus."
        ),
    }


def of_accuracy(accuracy: str, vertices: int, measured: int) -> Notes:
    """``measured``: vertices of the copy that thicknesses and the net are of; nothing to say of the standard."""
    if accuracy == "standard":
        return {}
    copy = (
        f"cortical and gyral thickness and the gyral net are of a copy of the surfaces with {measured:,} vertices in "
        f"place of {vertices:,}"
        if measured != vertices
        else "all surfaces are measured as they are"
    )
    voxel = "coarser" if accuracy == "draft" else "finer"
    return {"accuracy": f"{accuracy.capitalize()} accuracy: {copy}; voxels of local gyrification are {voxel}."}


def of_regions() -> Notes:
    return {
        "regions": "NumVert, area and thickness as mris_anatomical_stats counts them. A region with less measured "
        "contour than two gyral widths has no gyral thickness. gyrification_index is the local one, its mean over the "
        "pial area of the region."
    }
