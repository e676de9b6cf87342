"""``Measures``, the result of the analysis of one cortex: its numbers and what they depend on, its tables as frames."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from morphofold.analysis.graph.gyral_tables import CREST_COLUMNS
from morphofold.analysis.graph.hinges import ARM_COLUMNS, HINGE_COLUMNS
from morphofold.analysis.region_tables import REGION_COLUMNS, SHAPE_COLUMNS
from morphofold.errors import UnknownName
from morphofold.lazy import draw
from morphofold.note_texts import verdict
from morphofold.optional_packages import import_optional
from morphofold.surface import Cortex, PerVertex

if TYPE_CHECKING:
    import networkx as nx
    import pandas as pd
    from PIL.Image import Image

COLUMNS: Mapping[str, tuple[str, ...]] = {
    "regions": REGION_COLUMNS,
    "crests": tuple(CREST_COLUMNS),
    "hinges": tuple(HINGE_COLUMNS),
    "arms": tuple(ARM_COLUMNS),
    "shapes": SHAPE_COLUMNS,
}
#: FreeSurfer's own numbers in ``Cortex.info``, from ``stats/aseg.stats``: not measured here
FREESURFER_VALUES = tuple(
    "etiv_mm3 surface_holes freesurfer_cortex_mm3 freesurfer_white_matter_mm3 freesurfer_total_gray_mm3 "
    "freesurfer_subcortical_gray_mm3 freesurfer_supratentorial_mm3 freesurfer_brain_mm3 "
    "freesurfer_brain_without_ventricles_mm3".split()
)
VERDICT_COLUMNS = ("verdict", "verdict_reasons")  #: use, check or leave out; codes of the warnings that say why
#: text even where it looks like a number
TEXT_COLUMNS = {"name", "hemi", "region", "shape", "by", "part", *VERDICT_COLUMNS}
#: columns of whole numbers, beside those that begin with n_
WHOLE_NUMBERS = set(
    "euler_characteristic surface_holes crest hinge arm from_hinge to_hinge degree vertex blind".split()
)
_MASK = ("cortex_mask",)
_MEASURED = (*_MASK, "accuracy")
_NET, _THICKNESS = ("graph_width_mm", *_MEASURED), ("cortical_thickness_cap_mm", *_MEASURED)
#: parameters that numbers depend on besides the surfaces, and that may differ between two cortices
PARAMETERS = ("folding_scale_mm", "folding_index_surface", "graph_width_mm", *_THICKNESS, "annotation")
HINGE_SCALARS = ("n_hinges", "n_hinges_3", "n_hinges_4", "n_hinges_low", "n_hinges_high")
GRAPH_SCALARS = (*HINGE_SCALARS, "n_crests", "crest_length_mm")
SLOPE_SCALARS = tuple(f"gyral_to_cortical_{end}" for end in ("slope_robust", "slope_low", "slope_high", "slope", "r"))
#: the numbers of a cortex, and which of PARAMETERS each depends on
PARAMETERS_OF_SCALAR: Mapping[str, tuple[str, ...]] = {
    **dict.fromkeys("n_vertices euler_characteristic area_pial_mm2 area_white_mm2 gyrification_index".split(), ()),
    **dict.fromkeys(("folding_index", "intrinsic_curvature_index"), ("folding_scale_mm", "folding_index_surface")),
    "mean_cortical_thickness_mm": _THICKNESS,
    "median_gyral_thickness_mm": _MEASURED,
    "mean_sulcal_depth_mm": _MASK,
    "wavelength_mm": _MEASURED,
    **dict.fromkeys(GRAPH_SCALARS, _NET),
    **dict.fromkeys(SLOPE_SCALARS, (*_THICKNESS, "annotation")),
    "mean_local_gyrification_index": _MEASURED,
    "spectral_wavelength_mm": _NET,
    "gray_volume_mm3": _MASK,
    **dict.fromkeys(("volume_white_mm3", "volume_pial_mm3"), ()),
    "mean_cortical_thickness_area_weighted_mm": _THICKNESS,
}
SCALARS = tuple(PARAMETERS_OF_SCALAR)
#: numbers of a whole hemisphere
SURFACE_COLUMNS = (*VERDICT_COLUMNS, *SCALARS, *FREESURFER_VALUES)
#: columns of each table as a DataFrame
FRAMES: Mapping[str, tuple[str, ...]] = {
    "scalars": ("name", "hemi", *SURFACE_COLUMNS),
    **{table: ("name", *columns) for table, columns in COLUMNS.items()},
}


def verdict_columns(notes: Mapping[str, str]) -> dict[str, str | None]:
    """The verdict on a surface with these notes, and the codes that say why, as in a table."""
    text, reasons = verdict(notes)
    return dict(zip(VERDICT_COLUMNS, (text, " ".join(reasons) or None)))


def column_type(column: str) -> str:
    """The pandas type of a column: ``"string"``, ``"Int64"`` (whole numbers, some missing) or ``"float64"``."""
    if column in TEXT_COLUMNS:
        return "string"
    return "Int64" if column in WHOLE_NUMBERS or column.startswith("n_") else "float64"


def frame(rows: Sequence[Mapping[str, Any]], columns: Sequence[str]) -> pd.DataFrame:
    """Rows of a table as a DataFrame with these columns, typed also where there is no row."""
    pd = import_optional("pandas")
    return pd.DataFrame({key: pd.array([row.get(key) for row in rows], dtype=column_type(key)) for key in columns})


@dataclass(frozen=True, eq=False)
class Measures:
    """The result of the analysis of one cortex.

    ``scalars`` holds every name of ``SCALARS``. A value that cannot be computed is None, and ``notes`` gives the reason
    under the same name. If only a part was measured (``parameters["only"]``), all other values are None. ``maps`` are
    per-vertex arrays (N,), NaN where undefined, positive where convex. ``regions``, ``crests``, ``hinges``, ``arms``
    and ``shapes`` (cortical thickness by shape and depth) are tables with one dict per row. ``parameters`` are the
    scales and options used. ``graph`` is the gyral graph; None for measures read from a folder of an older version, or
    of a part that does not need it.
    """

    cortex: Cortex
    scalars: Mapping[str, float | int | None]
    maps: Mapping[str, PerVertex]
    regions: list[dict[str, Any]] = field(default_factory=list)
    crests: list[dict[str, Any]] = field(default_factory=list)
    hinges: list[dict[str, Any]] = field(default_factory=list)
    arms: list[dict[str, Any]] = field(default_factory=list)
    shapes: list[dict[str, Any]] = field(default_factory=list, kw_only=True)
    parameters: Mapping[str, Any] = field(default_factory=dict)
    notes: Mapping[str, str] = field(default_factory=dict)
    graph: nx.MultiGraph | None = None

    def plot(
        self,
        name: str,
        *,
        surface: str = "pial",
        views: str | Sequence[str] = ("lateral", "medial"),
        limits: tuple[float, float] | None = None,
    ) -> Image:
        """Picture of one map on a surface, with ruler and colour bar; vertices without a value are gray.

        Parameters
        ----------
        name : str
            A name of ``maps``.
        surface : {"pial", "white", "inflated"}
        views : str or sequence of str
            Any of ``"lateral"``, ``"medial"``, ``"top"``, ``"bottom"`` and ``"front"``.
        limits : (float, float), optional
            Values at the ends of the colours; None: those of the report.

        Returns
        -------
        PIL.Image.Image
            A notebook shows it; ``.save("thickness.png")`` writes it.

        Raises
        ------
        ValueError
            If there is no such map (the message lists the maps), surface or view, or ``limits`` are no interval.
        """
        picture: Image = draw("map_picture", self, name, surface, views, limits)
        return picture

    def _repr_html_(self) -> str:
        return str(draw("html", self))

    def __repr__(self) -> str:
        n_known = sum(value is not None for value in self.scalars.values())
        return (
            f"Measures of {self.cortex!r}: {n_known} scalars, {len(self.maps)} maps, {len(self.regions)} regions, "
            f"{len(self.hinges)} hinges, {len(self.notes)} notes"
        )

    @property
    def verdict(self) -> tuple[str, tuple[str, ...]]:
        """ "use", "check" or "leave out", and the codes of the warnings (docs/messages.md) that speak against it.

        "leave out" if a warning puts all numbers in doubt, such as surfaces that do not belong together, "check" if one
        puts some in doubt, such as holes or a coarse mesh.
        """
        return verdict(self.notes)

    @property
    def surface_row(self) -> dict[str, Any]:
        """The row of this cortex in ``surfaces.tsv``: verdict, scalars, and FreeSurfer's own numbers."""
        row = {"hemi": self.cortex.hemi, **verdict_columns(self.notes), **self.scalars}
        return row | {key: self.cortex.info.get(key) for key in FREESURFER_VALUES}

    def to_frame(self, table: str = "scalars") -> pd.DataFrame:
        """A table as a pandas DataFrame.

        Parameters
        ----------
        table : {"scalars", "regions", "crests", "hinges", "arms", "shapes"}
            ``"scalars"`` has one row: the ``verdict``, the numbers of ``scalars``, and FreeSurfer's own from
            ``stats/aseg.stats``.

        Returns
        -------
        pandas.DataFrame
            Columns, units and types as in docs/tables.md, also where there is no row. They begin with ``name`` and
            ``hemi``, so that frames of several subjects can be concatenated. Whole numbers are ``Int64``, lengths and
            other numbers ``float64``, words ``string``; a value that cannot be computed is missing.

        Raises
        ------
        UnknownName
            If there is no such table.

        Examples
        --------
        >>> import morphofold as mf
        >>> cortex = mf.read_cortex(mf.sample_path("fsaverage5"))
        >>> regions = mf.measure(cortex, accuracy="draft").to_frame("regions")
        >>> regions["gyral_thickness_mm"].median() > regions["cortical_thickness_mm"].median()
        True
        """
        if table not in FRAMES:
            raise UnknownName(f"{table!r}: no such table; they are {', '.join(FRAMES)}.")
        rows = [self.surface_row] if table == "scalars" else getattr(self, table)
        cortex_columns = {"name": self.cortex.name, "hemi": self.cortex.hemi}
        return frame([{**row, **cortex_columns} for row in rows], FRAMES[table])
