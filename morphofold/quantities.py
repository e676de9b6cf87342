"""Names of maps and scalars on pages: label, unit, sign, and limits of colours."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Quantity:
    """A per-vertex quantity as pages show it; ``limits`` are used when they suit the data."""

    key: str
    label: str
    unit: str = ""
    signed: bool = False
    limits: tuple[float, float] | None = None
    aliases: tuple[str, ...] = ()

    @property
    def title(self) -> str:
        return f"{self.label} [{self.unit}]" if self.unit else self.label


#: height above the smoothed surface about its median, a map that compare makes of a person and of what grew from it
RELIEF = "relief_height"

QUANTITIES = (
    Quantity("H", "Mean curvature H", "1/mm", True, (-0.3, 0.3), ("mean_curvature", "H_per_mm")),
    Quantity("cortical_thickness", "Cortical thickness", "mm", False, (1, 5), ("cortical_thickness_mm",)),
    Quantity("gyral_thickness", "Gyral thickness", "mm", False, (4, 20), ("gyral_thickness_mm",)),
    Quantity("sulcal_depth", "Sulcal depth", "mm", False, (0, 20), ("sulcal_depth_mm", "depth", "depth_mm")),
    Quantity("local_gyrification_index", "Local gyrification index", "", False, (1.0, 5.0), ("lgi",)),
    Quantity("K", "Gaussian curvature K", "1/mm²", True, (-0.1, 0.1), ("gaussian_curvature", "K_per_mm2")),
    Quantity("k1", "Largest curvature k₁", "1/mm", True, (-0.6, 0.6)),
    Quantity("k2", "Smallest curvature k₂", "1/mm", True, (-0.6, 0.6)),
    Quantity("curvedness", "Curvedness", "1/mm", False, (0.0, 0.6)),
    Quantity("shape_index", "Shape index", "", True, (-1.0, 1.0)),
    Quantity("area", "Vertex area on white", "mm²", False, None, ("area_mm2",)),
    Quantity(RELIEF, "Height of folds", "mm", True, (-8.0, 8.0)),
)
# Blue, vermilion and green of Okabe and Ito's palette, then plum, brown, sky and black: all seven stay apart for
# protanopes and deuteranopes, too.
CATEGORICAL_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#5b2a6e", "#7a3b00", "#3f9bd1", "#333333")
MAIN_MAPS = ("H", "cortical_thickness", "gyral_thickness", "sulcal_depth")

#: gyral over cortical thickness, made by compare: median over mean of the surface, and median of the ratio over crests
THICKNESS_RATIO, CREST_THICKNESS_RATIO = "gyral_to_cortical_ratio", "gyral_to_cortical_ratio_at_crests"

SCALAR_WORDS = {
    "n_vertices": ("Vertices", ""),
    "euler_characteristic": ("Euler characteristic", ""),
    "area_pial_mm2": ("Pial area", "mm²"),
    "area_white_mm2": ("White area", "mm²"),
    "gyrification_index": ("Gyrification index", ""),
    "folding_index": ("Folding index", ""),
    "intrinsic_curvature_index": ("Intrinsic curvature index", ""),
    "mean_cortical_thickness_mm": ("Cortical thickness, mean", "mm"),
    "median_gyral_thickness_mm": ("Gyral thickness, median", "mm"),
    "mean_sulcal_depth_mm": ("Sulcal depth, mean", "mm"),
    "wavelength_mm": ("Wavelength of folds", "mm"),
    "n_hinges": ("Hinges", ""),
    "n_hinges_3": ("Hinges with three arms", ""),
    "n_hinges_4": ("Hinges with four arms", ""),
    "n_hinges_low": ("Hinges, only the most certain", ""),
    "n_hinges_high": ("Hinges, with the doubtful ones", ""),
    "n_crests": ("Gyral crests", ""),
    "crest_length_mm": ("Length of crests", "mm"),
    "gyral_to_cortical_slope_robust": ("Robust slope, gyral on cortical thickness of regions", "mm/mm"),
    "gyral_to_cortical_slope_low": ("Robust slope, lower bound, 95 %", "mm/mm"),
    "gyral_to_cortical_slope_high": ("Robust slope, upper bound, 95 %", "mm/mm"),
    "gyral_to_cortical_slope": ("Slope by least squares, gyral on cortical thickness", "mm/mm"),
    "gyral_to_cortical_r": ("Correlation, gyral with cortical thickness", ""),
    "mean_local_gyrification_index": ("Local gyrification index, mean", ""),
    "spectral_wavelength_mm": ("Wavelength of folds, from their spectrum", "mm"),
    "gray_volume_mm3": ("Gray matter between white and pial", "mm³"),
    "volume_white_mm3": ("Volume within the white surface", "mm³"),
    "volume_pial_mm3": ("Volume within the pial surface", "mm³"),
    "etiv_mm3": ("Intracranial volume, estimated by FreeSurfer", "mm³"),
    "surface_holes": ("Holes of the surface that FreeSurfer repaired", ""),
    "freesurfer_cortex_mm3": ("Cortical gray matter of the hemisphere, by FreeSurfer", "mm³"),
    "freesurfer_white_matter_mm3": ("Cerebral white matter of the hemisphere, by FreeSurfer", "mm³"),
    "freesurfer_total_gray_mm3": ("Gray matter of the brain, by FreeSurfer", "mm³"),
    "freesurfer_subcortical_gray_mm3": ("Subcortical gray matter of the brain, by FreeSurfer", "mm³"),
    "freesurfer_supratentorial_mm3": ("Supratentorial volume, by FreeSurfer", "mm³"),
    "freesurfer_brain_mm3": ("Brain with ventricles (BrainSeg), by FreeSurfer", "mm³"),
    "freesurfer_brain_without_ventricles_mm3": ("Brain without ventricles (BrainSegNotVent), by FreeSurfer", "mm³"),
    "mean_cortical_thickness_area_weighted_mm": ("Cortical thickness, mean by area", "mm"),
    THICKNESS_RATIO: ("Gyral / cortical thickness", ""),
    "hinges_per_cm2": ("Hinges per area", "1/cm²"),
    "area_expansion": ("Area expansion", ""),
    CREST_THICKNESS_RATIO: ("Gyral / cortical at crests", ""),
}
#: the map from which a scalar is computed, if there is one
MAP_OF_SCALAR = {
    "mean_cortical_thickness_mm": "cortical_thickness",
    "mean_cortical_thickness_area_weighted_mm": "cortical_thickness",
    "median_gyral_thickness_mm": "gyral_thickness",
    "mean_sulcal_depth_mm": "sulcal_depth",
    "gyrification_index": "local_gyrification_index",
    "mean_local_gyrification_index": "local_gyrification_index",
    "folding_index": "curvedness",
    "intrinsic_curvature_index": "K",
    "gyral_to_cortical_slope_robust": "gyral_thickness",
    "gyral_to_cortical_slope": "gyral_thickness",
    "gyral_to_cortical_r": "gyral_thickness",
    THICKNESS_RATIO: "gyral_thickness",
}
#: meaning of the columns of tables, where SCALAR_WORDS and the name of the column are not enough
COLUMN_WORDS = {
    "name": "Name of the subject",
    "hemi": "Hemisphere, lh (left) or rh (right)",
    "region": "Region of the parcellation",
    "n_vertices": "Number of vertices",
    "area_mm2": "Area of the white surface",
    "cortical_thickness_mm": "Cortical thickness, mean over the vertices of the region or crest",
    "cortical_thickness_sd_mm": "Standard deviation of cortical thickness over vertices",
    "by": "What makes the parts: shape or depth",
    "part": "Part: concave, saddle, convex; or crown, wall, fundus",
    "area_mid_mm2": "Area midway between white and pial",
    "thickness_mm": "Cortical thickness, mean over the area",
    "thickness_sd_mm": "Standard deviation of cortical thickness over the area",
    "column_mm": "Distance from a vertex of white to its own on pial, mean over the area",
    "gyral_thickness_mm": "Gyral thickness from wall to wall, median over the region or crest",
    "gyral_contour_mm": "Length of the contour along which gyral thickness was measured",
    "thickness_file_mm": "Mean over vertices of the thickness map that came with the surfaces",
    "gray_volume_mm3": "Gray matter between white and pial surface",
    "mean_H_per_mm": "Mean curvature of the pial surface, positive where convex, mean over the region or crest",
    "crest": "Number of the gyral crest",
    "hinge": "Number of the gyral hinge",
    "arm": "Number of the arm of the hinge",
    "from_hinge": "Hinge at which the crest begins",
    "to_hinge": "Hinge at the other end of the crest",
    "length_mm": "Length along the crest",
    "altitude_mm": "Depth potential along the crest, high on crowns, median",
    "lowest_altitude_mm": "Depth potential along the crest, high on crowns, least",
    "strength_mm": "Depth potential minus itself smoothed over a crown width, median along the crest",
    "blind": "1 if it belongs to a dead-end gyrus, or is a hinge only because of dead-end gyri; else 0",
    "x": "Position, first coordinate",
    "y": "Position, second coordinate",
    "z": "Position, third coordinate",
    "degree": "Number of arms",
    "shape": "Y, T or V (three arms, by the angles between them), X (four) or star (more)",
    "min_angle_deg": "Least angle between neighbouring arms",
    "max_angle_deg": "Greatest angle between neighbouring arms",
    "vertex": "Number of the vertex at which the hinge lies, from 0",
    "mean_arm_length_mm": "Mean length of the arms",
    "confidence": "Confidence of the hinge, 0 to 1; below 0.25 it is doubtful, and not counted",
    "persistence_mm": "Least depth of pits of sulci, below the pass to a deeper one, up to which the node is a hinge",
    "angle_deg": "Angle to the next arm, counter-clockwise seen from outside",
    "curvature_per_mm": "Mean geodesic curvature of the crest, without sign",
}
HEADLINE_SCALARS = (
    "gyrification_index",
    "mean_cortical_thickness_mm",
    "median_gyral_thickness_mm",
    THICKNESS_RATIO,
    CREST_THICKNESS_RATIO,
    "mean_sulcal_depth_mm",
)

_UNIT_OF_SUFFIX = (
    ("_deg", "°"),
    ("_mm3", "mm³"),
    ("_per_mm2", "1/mm²"),
    ("_per_mm", "1/mm"),
    ("_mm2", "mm²"),
    ("_mm", "mm"),
)


def quantity(name: str, values: Iterable[np.ndarray] = ()) -> Quantity:
    """The ``Quantity`` of a map's name.

    An unknown name gets its label and unit from the name. It is signed if the 2nd and 98th percentiles of ``values``
    have different signs.
    """
    for known in QUANTITIES:
        if name == known.key or name in known.aliases:
            return known
    label, unit = _label_and_unit(name)
    ends = [np.percentile(v[np.isfinite(v)], [2, 98]) for v in values if np.isfinite(v).any()]
    signed = bool(ends) and bool(min(e[0] for e in ends) < 0 < max(e[1] for e in ends))
    return Quantity(name, label, unit, signed)


def scalar_words(name: str) -> tuple[str, str]:
    """Label and unit of a scalar's name."""
    return SCALAR_WORDS.get(name) or _label_and_unit(name)


def column_words(name: str) -> tuple[str, str]:
    """Meaning of a column of a table, and its unit."""
    label, unit = scalar_words(name)
    if name in ("x", "y", "z"):
        unit = "mm"
    elif name.endswith("_deg"):
        unit = "degree"
    return COLUMN_WORDS.get(name, label), unit


def _label_and_unit(name: str) -> tuple[str, str]:
    for suffix, unit in _UNIT_OF_SUFFIX:
        if name.endswith(suffix):
            words = name.removesuffix(suffix).replace("_", " ")
            return words[:1].upper() + words[1:], unit
    words = name.replace("_", " ")
    return words[:1].upper() + words[1:], ""


def common_limits(what: Quantity, values: Iterable[np.ndarray]) -> tuple[float, float]:
    """Common limits of colours for several surfaces; every surface has the same weight.

    The quantity's own limits are used if at least 80 % of every surface's values are inside, and the values fill at
    least 40 % of the range. Otherwise the limits are the least 2nd and the greatest 98th percentile of all surfaces,
    rounded outwards to two figures and, for a signed quantity, made symmetric about zero.
    """
    arrays = [np.asarray(v, dtype=np.float64).ravel() for v in values]
    arrays = [known for v in arrays if (known := v[np.isfinite(v)]).size]
    if not arrays:
        return what.limits or (0.0, 1.0)
    ends = np.array([np.percentile(v, [2, 98]) for v in arrays])
    low, high = float(ends[:, 0].min()), float(ends[:, 1].max())
    if what.limits is not None:
        a, b = what.limits
        inside = min(np.mean((v >= a) & (v <= b)) for v in arrays)
        if inside >= 0.8 and high - low >= 0.4 * (b - a):
            return what.limits
    if what.signed:
        top = round_out(max(abs(low), abs(high)))
        return (-top, top) if top > 0 else (-1.0, 1.0)
    if high - low <= 1e-9 * max(1.0, abs(high)):
        step = round_out(abs(high)) or 1.0
        return (low - 0.1 * step, high + 0.1 * step)
    unit = 10.0 ** np.floor(np.log10(high - low)) / 2
    return float(np.floor(low / unit) * unit), float(np.ceil(high / unit) * unit)


def round_out(x: float) -> float:
    """The next number with at most two figures whose second is 0 or 5, away from zero; 0 stays 0."""
    if x <= 0:
        return 0.0
    unit = 10.0 ** np.floor(np.log10(x)) / 2
    return float(f"{np.ceil(x / unit - 1e-9) * unit:.12g}")  # 0.15, not 0.15000000000000002


def find(maps: Mapping[str, np.ndarray], key: str) -> np.ndarray | None:
    """The map named ``key`` or one of its aliases; None if there is none."""
    what = quantity(key)
    return next((maps[name] for name in (what.key, *what.aliases) if name in maps), None)
