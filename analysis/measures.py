"""``Measures``, the result of the analysis of one cortex: names of the numbers, and what each depends on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from morphofold.analysis.frames import COLUMNS, FREESURFER_VALUES, frame
from morphofold.errors import UnknownName
from morphofold.lazy import draw
from morphofold.surface import Cortex, PerVertex

if TYPE_CHECKING:
    import networkx as nx
    import pandas as pd
    from PIL.Image import Image

SLOPE_SCALARS = (
    "gyral_to_cortical_slope_robust",
    "gyral_to_cortical_slope_low",
    "gyral_to_cortical_slope_high",
    "gyral_to_cortical_slope",
    "gyral_to_cortical_r",
)
SCALARS = (
    "n_vertices",
    "euler_characteristic",
    "area_pial_mm2",
    "area_white_mm2",
    "gyrification_index",
    "folding_index",
    "intrinsic_curvature_index",
    "mean_cortical_thickness_mm",
    "median_gyral_thickness_mm",
    "mean_sulcal_depth_mm",
    "wavelength_mm",
    "n_hinges",
    "n_hinges_3",
    "n_hinges_4",
    "n_hinges_low",
    "n_hinges_high",
    "n_crests",
    "crest_length_mm",
    *SLOPE_SCALARS,
    "mean_local_gyrification_index",
    "spectral_wavelength_mm",
    "gray_volume_mm3",
    "volume_white_mm3",
    "volume_pial_mm3",
    "mean_cortical_thickness_area_weighted_mm",
)
#: columns of each table as a DataFrame
FRAMES: Mapping[str, tuple[str, ...]] = {
    "scalars": ("name", "hemi", *SCALARS, *FREESURFER_VALUES),
    **{table: ("name", *columns) for table, columns in COLUMNS.items()},
}
#: parameters that numbers depend on besides the surfaces, and that may differ between two cortices
PARAMETERS = (
    "folding_scale_mm",
    "graph_width_mm",
    "cortical_thickness_cap_mm",
    "cortex_mask",
    "accuracy",
    "annotation",
)
_NET_PARAMETERS = ("graph_width_mm", "cortex_mask", "accuracy")
#: which of PARAMETERS a scalar depends on; one without an entry may depend on all of them
PARAMETERS_OF_SCALAR: Mapping[str, tuple[str, ...]] = {
    **dict.fromkeys(
        (
            "n_vertices",
            "euler_characteristic",
            "area_pial_mm2",
            "area_white_mm2",
            "gyrification_index",
            "volume_white_mm3",
            "volume_pial_mm3",
        ),
        (),
    ),
    **dict.fromkeys(("folding_index", "intrinsic_curvature_index"), ("folding_scale_mm",)),
    **dict.fromkeys(("mean_sulcal_depth_mm", "gray_volume_mm3"), ("cortex_mask",)),
    **dict.fromkeys(
        ("mean_cortical_thickness_mm", "mean_cortical_thickness_area_weighted_mm"),
        ("cortical_thickness_cap_mm", "cortex_mask", "accuracy"),
    ),
    **dict.fromkeys(
        ("median_gyral_thickness_mm", "wavelength_mm", "mean_local_gyrification_index"), ("cortex_mask", "accuracy")
    ),
    **dict.fromkeys(
        (
            "n_hinges",
            "n_hinges_3",
            "n_hinges_4",
            "n_hinges_low",
            "n_hinges_high",
            "n_crests",
            "crest_length_mm",
            "spectral_wavelength_mm",
        ),
        _NET_PARAMETERS,
    ),
    **dict.fromkeys(SLOPE_SCALARS, ("cortical_thickness_cap_mm", "cortex_mask", "accuracy", "annotation")),
}


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
    maps: Mapping[str, PerVertex] = field(repr=False)
    regions: list[dict[str, Any]] = field(default_factory=list, repr=False)
    crests: list[dict[str, Any]] = field(default_factory=list, repr=False)
    hinges: list[dict[str, Any]] = field(default_factory=list, repr=False)
    arms: list[dict[str, Any]] = field(default_factory=list, repr=False)
    shapes: list[dict[str, Any]] = field(default_factory=list, repr=False, kw_only=True)
    parameters: Mapping[str, Any] = field(default_factory=dict, repr=False)
    notes: Mapping[str, str] = field(default_factory=dict, repr=False)
    graph: nx.MultiGraph | None = field(default=None, repr=False)

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
        known = sum(value is not None for value in self.scalars.values())
        return (
            f"Measures of {self.cortex!r}: {known} scalars, {len(self.maps)} maps, {len(self.regions)} regions, "
            f"{len(self.hinges)} hinges, {len(self.notes)} notes"
        )

    def to_frame(self, table: str = "scalars") -> pd.DataFrame:
        """A table as a pandas DataFrame.

        Parameters
        ----------
        table : {"scalars", "regions", "crests", "hinges", "arms", "shapes"}
            ``"scalars"`` has one row: the numbers of ``scalars``, and FreeSurfer's own from ``stats/aseg.stats``.

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
        rows = [{**self.cortex.info, **self.scalars}] if table == "scalars" else getattr(self, table)
        here = {"name": self.cortex.name, "hemi": self.cortex.hemi}
        return frame([{**row, **here} for row in rows], FRAMES[table])
