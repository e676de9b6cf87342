"""What ``measure(cortex, only=[...])`` runs: the steps that make the names asked for, and the steps that these need."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from morphofold.analysis.maps import each_map
from morphofold.analysis.measures import SCALARS, SLOPE_SCALARS, Measures
from morphofold.analysis.notes import GRAPH_SCALARS
from morphofold.errors import NothingToDo, UnknownName
from morphofold.surface import Cortex
from morphofold.words import listed

TABLES = ("regions", "crests", "hinges", "arms", "shapes")
CURVATURE_MAPS = ("H", "K", "k1", "k2", "shape_index", "curvedness")
GIVEN_THICKNESS = "thickness_file"  # a map only of a cortex that came with a thickness
#: step -> the scalars, maps and tables that it makes
MAKES: Mapping[str, tuple[str, ...]] = {
    "surfaces": (
        "area",
        "n_vertices",
        "euler_characteristic",
        "area_pial_mm2",
        "area_white_mm2",
        "gray_volume_mm3",
        "volume_white_mm3",
        "volume_pial_mm3",
    ),
    "depth": (*each_map(), "mean_sulcal_depth_mm"),
    "hull": ("gyrification_index",),
    "cortical thickness": (
        "cortical_thickness",
        GIVEN_THICKNESS,
        "mean_cortical_thickness_mm",
        "mean_cortical_thickness_area_weighted_mm",
    ),
    "curvature": CURVATURE_MAPS,
    "folding": ("folding_index", "intrinsic_curvature_index"),
    "gyral thickness": ("gyral_thickness", "median_gyral_thickness_mm", "wavelength_mm"),
    "gyral graph": ("hinges", "arms", *GRAPH_SCALARS, "spectral_wavelength_mm"),
    "local gyrification": ("local_gyrification_index", "mean_local_gyrification_index"),
    "crests": ("crests",),
    "slopes": SLOPE_SCALARS,
    "regions": ("regions",),
    "shapes": ("shapes",),
}
#: step -> the steps that it uses; all use "surfaces"
NEEDS: Mapping[str, tuple[str, ...]] = {
    "cortical thickness": ("resampling",),
    "gyral thickness": ("resampling",),
    "gyral graph": ("resampling",),
    "crests": ("gyral graph", "cortical thickness", "gyral thickness", "curvature"),
    "slopes": ("cortical thickness", "gyral thickness"),
    "shapes": ("cortical thickness", "curvature", "depth"),
    "regions": ("gyral graph", "cortical thickness", "gyral thickness", "curvature", "local gyrification"),
}


@dataclass(frozen=True)
class Asked:
    """The names asked for, None for all, and the steps that are run for them."""

    names: tuple[str, ...] | None
    steps: frozenset[str]

    def chains(self, *chains: Iterable[tuple[Any, ...]]) -> list[list[tuple[Any, ...]]]:
        """Chains of steps that begin with their name: those that run, without it."""
        found = ([step[1:] for step in chain if step[0] in self.steps] for chain in chains)
        return [chain for chain in found if chain]

    def part_of(self, whole: Measures) -> Measures:
        """The measures without what was not asked for.

        Where a number that was not asked for can't be computed, its note stays: it is the reason for empty maps, too.
        """
        if self.names is None:
            return whole
        unasked = {name for name in SCALARS if name not in self.names}
        said = {k: text for k, text in whole.notes.items() if k not in unasked or whole.scalars[k] is None}
        said["only"] = f"Asked for: {listed(self.names)}. Other scalars are None, other maps and tables are left out."
        return replace(
            whole,
            scalars={name: None if name in unasked else value for name, value in whole.scalars.items()},
            maps={name: values for name, values in whole.maps.items() if name in self.names},
            parameters={**whole.parameters, "only": list(self.names)},
            notes=said,
            **{table: getattr(whole, table) if table in self.names else [] for table in TABLES},
        )


def asked(cortex: Cortex, only: Sequence[str] | None) -> Asked:
    """What to measure of a cortex: everything (None), or ``only`` these scalars, maps and tables.

    Raises
    ------
    ValueError
        If ``only`` is empty or has an unknown name; the message lists what can be asked for.
    """
    if only is None:
        return Asked(None, frozenset(_with_needs(set(MAKES))))
    if isinstance(only, str):
        raise TypeError(f"measure: only must be a list of names, not a text. Pass only=[{only!r}].")
    can = [n for made in MAKES.values() for n in made if n != GIVEN_THICKNESS or "thickness" in cortex.maps]
    if not only:
        raise NothingToDo(f"measure: only is empty. Name what to measure: {', '.join(can)}.")
    if unknown := [name for name in only if name not in can]:
        raise UnknownName(
            f"{cortex.called}: only has {', '.join(map(repr, unknown))}, which can't be measured. Name some of these: "
            f"{', '.join(can)}."
        )
    makers = {step for step, made in MAKES.items() if set(made) & set(only)}
    return Asked(tuple(dict.fromkeys(only)), frozenset(_with_needs({"surfaces", *makers})))


def _with_needs(steps: set[str]) -> set[str]:
    more = steps | {need for step in steps for need in NEEDS.get(step, ())}
    return more if more == steps else _with_needs(more)
