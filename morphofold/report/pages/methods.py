"""A methods paragraph for a paper, with references, from what a page shows and the scales that were used."""

from __future__ import annotations

from collections.abc import Sequence

from morphofold.analysis.measures import Measures
from morphofold.report.pages.contents import Entry
from morphofold.words import number

#: references, by the form in which the paragraph cites them
REFERENCES = {
    "Alexander-Bloch et al. 2018": "Alexander-Bloch AF et al. (2018). On testing for spatial correspondence between "
    "maps of human brain structure and function. NeuroImage 178, 540.",
    "Chen and Hutchinson 2004": "Chen X, Hutchinson JW (2004). Herringbone buckling patterns of compressed thin films "
    "on compliant substrates. J. Appl. Mech. 71, 597.",
    "Fischl and Dale 2000": "Fischl B, Dale AM (2000). Measuring the thickness of the human cerebral cortex from "
    "magnetic resonance images. PNAS 97, 11050.",
    "Holm 1979": "Holm S (1979). A simple sequentially rejective multiple test procedure. Scand. J. Stat. 6, 65.",
    "Iglewicz and Hoaglin 1993": "Iglewicz B, Hoaglin DC (1993). How to detect and handle outliers. ASQC "
    "Quality Press.",
    "Mota and Herculano-Houzel 2015": "Mota B, Herculano-Houzel S (2015). Cortical folding scales universally with "
    "surface area and thickness, not number of neurons. Science 349, 74.",
    "Razavi et al. 2015": "Razavi MJ, Zhang T, Li X, Liu T, Wang X (2015). Role of mechanical factors in cortical "
    "folding development. Phys. Rev. E 92, 032701.",
    "Schaer et al. 2008": "Schaer M et al. (2008). A surface-based approach to quantify local cortical gyrification. "
    "IEEE Trans. Med. Imaging 27, 161.",
}

_MATERIAL_NAMES = {"neo-hookean": "neo-Hookean", "mooney-rivlin": "Mooney-Rivlin"}


def methods(entries: Sequence[Entry], version: str, *, theory: bool, spins: int = 0) -> tuple[str, list[str]]:
    """The methods as one paragraph, with this version of morphofold, and the references that it cites.

    ``theory``: whether the page has a line of linear theory. ``spins``: rotations by which grown cortices were tested
    against the people that they grew from, 0 if none was.
    """
    sentences = [*_growth_sentences(entries), *measured([e.measures for e in entries], version)]
    if any(e.folding is not None for e in entries):
        sentences.append(
            "The law of folding is total area times the root of thickness over exposed area to the power 5/4 (Mota and "
            "Herculano-Houzel 2015), with the convex hull as exposed area."
        )
    if theory:
        sentences.append("The wavelength of the first wrinkles is that of a stiff film (Chen and Hutchinson 2004).")
    if spins:
        sentences.append(
            "A cortex that grew from a person's unfolded surface was compared with the person's own at the same points "
            f"of the person's sphere, tested by {spins} random rotations of it (Alexander-Bloch et al. 2018), with the "
            "smooth body before growth as control; p-values of measures of regions are corrected (Holm 1979)."
        )
    return cited(sentences)


def cited(sentences: Sequence[str]) -> tuple[str, list[str]]:
    """Join sentences to one paragraph; return it with the references that it cites."""
    text = " ".join(sentences)
    return text, [work for name, work in REFERENCES.items() if name in text]


def _growth_sentences(entries: Sequence[Entry]) -> list[str]:
    """One sentence for each simulated cortex."""
    sentences = []
    for e in entries:
        info = e.measures.cortex.info
        material = str(info.get("material", "neo-hookean"))
        if e.measures.cortex.origin == "simulation" and None not in (info.get(key) for key in ("g", "law", "mu_ratio")):
            sentences.append(
                f"{e.name} was grown by finite elements: a {_MATERIAL_NAMES.get(material, material)} cortex, "
                f"{number(float(info['mu_ratio']))} times as stiff as its core, with {info['law']} growth to a stretch "
                f"of {number(float(info['g']))} (after Razavi et al. 2015)."
            )
    return sentences


def measured(measures: Sequence[Measures], version: str) -> list[str]:
    """Sentences on how white and pial surfaces were measured; without measures, only what holds for all.

    What no surface has, because only a part was asked for, is left out.
    """
    scales = sorted(float(mm) for m in measures if (mm := m.parameters.get("curvature_scale_mm")))
    within = " or ".join(dict.fromkeys(number(mm, 2) for mm in scales)) or "a few"
    caps = {m.parameters.get("cortical_thickness_cap_mm") for m in measures}
    bounds = " or ".join(f"{cap:g}" for cap in sorted(cap for cap in caps if cap))
    where = " in some of them" if None in caps else ""
    simulated = {m.cortex.origin == "simulation" for m in measures} == {True, False}
    there = {name for m in measures for name in (*m.maps, *(k for k, v in m.scalars.items() if v is not None))}
    sentences = {
        ("H", "K", "k1", "k2", "shape_index", "curvedness"): (
            f"Curvature is that of a cubic surface fitted to the vertices within {within} mm along the surface; it is "
            "positive where the surface is convex."
        ),
        ("cortical_thickness", "mean_cortical_thickness_mm", "mean_cortical_thickness_area_weighted_mm"): (
            "Cortical thickness is half the sum of the distances from white to pial surface and back, each to the "
            "closest point that lies outward (inward) and faces the same way"
            f"{f', each {bounds} mm at most{where}' * bool(bounds)} (Fischl and Dale 2000)."
        ),
        ("gyral_thickness", "median_gyral_thickness_mm"): (
            "Gyral thickness is the length of the horizontal chord through a gyrus, from wall to wall, at half the "
            "height of the fold."
        ),
        ("n_hinges", "n_crests", "crest_length_mm"): (
            "The gyral net is the net of crests, and a hinge is a point where three or more crests meet (after Razavi "
            "et al. 2015)."
        ),
        ("gyrification_index",): (
            "The gyrification index is the area of the pial surface over that of its convex hull."
        ),
        ("local_gyrification_index", "mean_local_gyrification_index"): (
            "The local gyrification index is the area within 25 mm over that of the closing by a ball of 15 mm (Schaer "
            "et al. 2008)."
        ),
        ("sulcal_depth", "mean_sulcal_depth_mm"): "Sulcal depth is the distance to the convex hull.",
    }
    return [
        f"White and pial surfaces were measured with morphofold {version}"
        f"{', with the same code for simulated and reconstructed cortex' * simulated}.",
        *_resampling_sentences(measures),
        *(text for names, text in sentences.items() if not there or there & set(names)),
    ]


def _resampling_sentences(measures: Sequence[Measures]) -> list[str]:
    """Sentences on surfaces measured with more or fewer vertices (resampled), or in coarser or finer voxels."""
    sentences = []
    for kind, how in (("draft", "thinned"), ("fine", "finer")):
        counts = sorted(
            {
                int(m.parameters["accuracy_vertices"])
                for m in measures
                if m.parameters.get("accuracy") == kind and m.parameters["accuracy_vertices"] != m.cortex.n_vertices
            }
        )
        if counts:
            sizes = " or ".join(f"{n:,}" for n in counts)
            sentences.append(
                f"Cortical and gyral thickness and the gyral net were measured on resampled surfaces ({how}) with "
                f"{sizes} vertices."
            )
    usual = 1.25
    voxels = {float(m.parameters.get("local_gyrification_voxel_mm", usual)) for m in measures}
    if voxels - {usual}:
        sentences.append(
            f"Local gyrification was measured on voxels of {' or '.join(f'{v:g}' for v in sorted(voxels))} mm."
        )
    return sentences
