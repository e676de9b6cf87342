"""Tables of measures: their columns, the types of these, and rows as a pandas DataFrame."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from morphofold.analysis.regions import COLUMNS as REGION_COLUMNS

if TYPE_CHECKING:
    import pandas as pd

COLUMNS = {
    "regions": REGION_COLUMNS,
    "crests": (
        "hemi",
        "crest",
        "from_hinge",
        "to_hinge",
        "length_mm",
        "gyral_thickness_mm",
        "cortical_thickness_mm",
        "mean_H_per_mm",
        "region",
        "altitude_mm",
        "strength_mm",
        "blind",
    ),
    "hinges": (
        "hemi",
        "hinge",
        "x",
        "y",
        "z",
        "degree",
        "shape",
        "min_angle_deg",
        "max_angle_deg",
        "region",
        "vertex",
        "mean_arm_length_mm",
        "persistence_mm",
        "blind",
        "confidence",
    ),
    "arms": (
        "hemi",
        "hinge",
        "arm",
        "angle_deg",
        "length_mm",
        "curvature_per_mm",
        "to_hinge",
        "altitude_mm",
        "lowest_altitude_mm",
        "blind",
        "crest",
    ),
    "shapes": ("hemi", "by", "part", "n_vertices", "area_mid_mm2", "thickness_mm", "thickness_sd_mm", "column_mm"),
}
#: FreeSurfer's own numbers in ``Cortex.info``, from ``stats/aseg.stats``: not measured here
FREESURFER_VALUES = (
    "etiv_mm3",
    "surface_holes",
    "freesurfer_cortex_mm3",
    "freesurfer_white_matter_mm3",
    "freesurfer_total_gray_mm3",
    "freesurfer_subcortical_gray_mm3",
    "freesurfer_supratentorial_mm3",
    "freesurfer_brain_mm3",
    "freesurfer_brain_without_ventricles_mm3",
)
TEXT_COLUMNS = {"name", "hemi", "region", "shape", "by", "part"}  # text even where it looks like a number
WHOLE_NUMBERS = {  # and those that begin with n_
    "euler_characteristic",
    "surface_holes",
    "crest",
    "hinge",
    "arm",
    "from_hinge",
    "to_hinge",
    "degree",
    "vertex",
    "blind",
}


def column_type(column: str) -> str:
    """The pandas type of a column: ``"string"``, ``"Int64"`` (whole numbers, some missing) or ``"float64"``."""
    if column in TEXT_COLUMNS:
        return "string"
    return "Int64" if column in WHOLE_NUMBERS or column.startswith("n_") else "float64"


def frame(rows: Sequence[Mapping[str, Any]], columns: Sequence[str]) -> pd.DataFrame:
    """Rows of a table as a DataFrame with these columns, typed also where there is no row."""
    import pandas as pd

    return pd.DataFrame({key: pd.array([row.get(key) for row in rows], dtype=column_type(key)) for key in columns})
