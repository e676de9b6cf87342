"""``compare``: measures of several cortices in, one ``Comparison`` out (Fig. 8 of Razavi et al. 2015).

A ``Comparison`` gathers the table of measures, the plot of gyral against cortical thickness, hinges, growth curves and
persons, and writes them to a folder with its page. Simulations and brains are treated the same: ``cortex.origin`` and
``cortex.info`` are shown as labels, and ``info["mu_ratio"]``, if there is one, gives the theoretical line. Texts of the
comparison are in ``side_by_side.toml``.
"""

import re
import tomllib
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import cycle
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from morphofold import __version__
from morphofold.analysis.graph.hinge_statistics import hinge_shapes
from morphofold.analysis.gyrification.folding_indices import ShapeTerms, shape_terms_of
from morphofold.analysis.measures_result import SCALARS, Measures
from morphofold.comparison.hinge_comparison import HingeComparison, compare_hinges
from morphofold.comparison.person.compare_person import MeasuresByName, PersonComparison, compare_people, write_people
from morphofold.comparison.person.person_agreement import SPINS
from morphofold.comparison.thickness_plot_data import (
    Cloud,
    TheoryLine,
    thickness_cloud,
    thickness_ratios,
    wrinkling_wavelength,
)
from morphofold.digests_and_json import Row, json_value
from morphofold.errors import DoesNotApply, MissingPart, NamedTwice, NothingToDo, NotReadable, OutOfRange, UnknownName
from morphofold.frozen_arrays import Array
from morphofold.io import atomic_folder
from morphofold.io.json_files import write_json
from morphofold.lazy import draw
from morphofold.number_texts import listed, number
from morphofold.progress_callbacks import Progress, logged
from morphofold.quantities import CATEGORICAL_COLOURS, CREST_THICKNESS_RATIO, THICKNESS_RATIO
from morphofold.tables import write_table
from morphofold.validators import check_kind

#: names of single hemispheres, by the name of both hemispheres or of their group
HemisphereNames = Mapping[str, tuple[str, ...]]
#: parameters that make numbers differ, and the text of a value
PARAMETER_TEXTS: Mapping[str, Callable[[Any], str]] = {
    "curvature_scale_mm": lambda mm: f"{number(float(mm), 2)} mm",
    "cortical_thickness_cap_mm": lambda mm: f"at {mm:g} mm" if mm else "nowhere",
    "graph_width_mm": lambda mm: f"{number(float(mm), 2)} mm",
    "accuracy": str,
    "cortex_mask": lambda mask: f"by '{mask}'",
}
PARAMETER_CAUTIONS, POINT_NOTES = tomllib.loads(Path(__file__).with_suffix(".toml").read_text("utf-8")).values()


class GrowthCurve(NamedTuple):
    """Numbers of a body over its growth.

    Attributes
    ----------
    name : str
    growth : (G,) float64
        Growth stretches, ascending.
    numbers : mapping of str to (G,) float64
        As :func:`dimensionless_numbers`; NaN if a stage doesn't have one (it isn't folded yet).
    folding : (G,) tuple of ShapeTerms or None
        Terms of the law of folding at each stage.
    """

    name: str
    growth: Array
    numbers: Mapping[str, Array]
    folding: tuple[ShapeTerms | None, ...]


@dataclass(frozen=True, eq=False)
class Comparison:
    """Result of ``compare``: one entry of ``measures`` and ``clouds`` per name, in the same order.

    ``table`` has one row per scalar: ``measure`` and one value per name, None if there is no value. ``theory`` has a
    line for each ratio of stiffness that occurs, none if there are only brains. ``groups`` has the names in each group.
    ``colours`` has the colour of each name, such as "#0072b2": its own if one was given, else that of its group.
    ``hinges`` compares the three-hinge patterns of every two groups. ``folding`` has the terms of the law of folding,
    None for a surface that isn't closed. ``growth`` has numbers of bodies as they grow, ``stages`` the measures they
    are from. ``people`` has a comparison for each cortex that grew from a person who is compared, too. ``notes`` list
    what was left out, ``cautions`` the scales and options that differ between surfaces.
    """

    names: tuple[str, ...]
    measures: tuple[Measures, ...]
    table: tuple[Row, ...]
    clouds: tuple[Cloud, ...]
    theory: tuple[TheoryLine, ...]
    groups: HemisphereNames
    colours: Mapping[str, str]
    hinges: tuple[HingeComparison, ...]
    folding: tuple[ShapeTerms | None, ...]
    growth: tuple[GrowthCurve, ...]
    stages: Mapping[str, tuple[Measures, ...]]
    people: tuple[PersonComparison, ...]
    notes: tuple[str, ...]
    cautions: tuple[str, ...]

    def __repr__(self) -> str:
        names = ", ".join(map(repr, self.names))
        return f"Comparison({names}; {len(self.groups)} groups, {len(self.people)} compared with their person)"

    def _repr_html_(self) -> str:
        return draw("html", self)

    @property
    def named(self) -> MeasuresByName:
        """The measures by name."""
        return dict(zip(self.names, self.measures))

    def to_dict(self) -> Row:
        """Everything but the maps, as plain values for JSON."""
        content = {
            "names": self.names,
            "table": self.table,
            "gyral_against_cortical_thickness": dict(zip(self.names, self.clouds)),
            "theory": self.theory,
            "groups": self.groups,
            "colours": self.colours,
            "hinges": [{**vars(compared), "verdict": compared.verdict} for compared in self.hinges],
            "growth": {
                curve.name: {
                    "growth": curve.growth,
                    "numbers": curve.numbers,
                    "as": {name: matching_growth(curve, m) for name, m in self.named.items()},
                }
                for curve in self.growth
            },
            "folding": dict(zip(self.names, self.folding)),
            "notes": self.notes,
            "cautions": self.cautions,
            **({"people": [person.to_dict() for person in self.people]} if self.people else {}),
        }
        return json_value(content)

    def report(self, out: str | Path, *, progress: Progress = logged) -> Path:
        """Write ``out/`` completely or not at all: report.html, figures/*.png, comparison.json, comparison.tsv.

        With ``people`` also person.tsv, person_regions.tsv and carried/.

        Returns the path of the page. ``progress`` is called with the share done, 0 to 1, and what is being drawn.
        """
        with atomic_folder(out) as folder:
            draw("comparison_page", self, folder, progress=progress)
            write_json(folder / "comparison.json", {"morphofold": __version__, **self.to_dict()})
            write_table(folder / "comparison.tsv", ("measure", *self.names), self.table)
            write_people(self.people, folder)
        return Path(out) / "report.html"


def compare(
    surfaces: Mapping[str, Measures | Sequence[Measures]],
    *,
    mu_ratio: float | None = None,
    groups: Mapping[str, Sequence[str]] | None = None,
    growth: Mapping[str, Sequence[Measures]] | None = None,
    colours: Mapping[str, str] | None = None,
    spins: int = SPINS,
    seed: int = 0,
) -> Comparison:
    """Put the measures of several cortices side by side.

    Parameters
    ----------
    surfaces : mapping of name to Measures, or to a sequence of them
        Two hemispheres under one name become ``"name lh"`` and ``"name rh"``.
    mu_ratio : float, optional
        Stiffness of cortex over core for the theoretical line; None: each ``cortex.info["mu_ratio"]``, and no line
        if there is none.
    groups : mapping of group to names of ``surfaces``, optional
        The hinges of a group are pooled and compared with those of other groups, in this order; None: each name is a
        group. Names in no group are compared in everything else.
    growth : mapping of name to stages of one body, optional
        Their numbers are drawn over growth, with those of ``surfaces``. If a body has the name of a surface, and its
        mesh, the page shows it growing.
    colours : mapping of a name or group to a colour such as "#0072b2", optional
        A colour of a name overrides that of its group; None: one for each group.
    spins : int
        Rotations of the sphere, if a cortex grew from a person who is compared, too.
    seed : int
        Of permutations and rotations.

    Returns
    -------
    Comparison

    Raises
    ------
    ValueError
        If there is nothing to compare, two surfaces end up with one name, ``mu_ratio`` is not positive, a group has an
        unknown name or one of another group, stages have no growth, or a colour or its name can't be used.
    """
    check_kind(surfaces, Mapping, "compare: surfaces")
    if spins < 1:
        raise OutOfRange(f"spins must be 1 or more, got {spins}.")
    measures_by_name, names = named_surfaces(surfaces)
    names_by_group, stages = grouped_names(names, groups), {name: tuple(body) for name, body in (growth or {}).items()}
    shapes_by_name = {name: hinges for name, m in measures_by_name.items() if (hinges := hinge_shapes(m)) is not None}
    measures = tuple(measures_by_name.values())
    clouds = tuple(map(thickness_cloud, measures))
    people, person_remarks = compare_people(measures_by_name, spins=spins, seed=seed)
    return Comparison(
        names=tuple(measures_by_name),
        measures=measures,
        table=table_of(measures_by_name),
        clouds=clouds,
        theory=theory_lines(measures_by_name, mu_ratio),
        groups=names_by_group,
        colours=colours_of(names, names_by_group, colours or {}),
        hinges=tuple(compare_hinges(shapes_by_name, names_by_group, seed=seed)),
        folding=tuple(map(shape_terms_of, measures)),
        stages=stages,
        growth=tuple(map(growth_curve, stages, stages.values())),
        people=tuple(people),
        notes=(*notes(measures_by_name), *plot_notes(measures_by_name, clouds)),
        cautions=(*cautions(measures_by_name), *person_remarks),
    )


def theory_lines(measures_of: MeasuresByName, mu_ratio: float | None) -> tuple[TheoryLine, ...]:
    """Theoretical wavelength at ``mu_ratio``, or at each ratio of stiffness in ``cortex.info`` of the surfaces."""
    stiffness_ratios = {m.cortex.info.get("mu_ratio") for m in measures_of.values()} if mu_ratio is None else {mu_ratio}
    known_ratios = sorted({float(ratio) for ratio in stiffness_ratios if ratio is not None})
    for ratio in known_ratios:
        if not 0 < ratio < np.inf:
            raise OutOfRange(f"mu_ratio must be a positive number, got {ratio}.")
    return tuple(map(wrinkling_wavelength, known_ratios))


def table_of(measures_of: MeasuresByName) -> tuple[Row, ...]:
    """A row for every scalar and both ratios of gyral to cortical thickness: the value of each surface, or None."""
    scalars = {name: {**measures.scalars, **thickness_ratios(measures)} for name, measures in measures_of.items()}
    other_keys = sorted({key for measures in measures_of.values() for key in measures.scalars})
    keys = dict.fromkeys((*SCALARS, *other_keys, THICKNESS_RATIO, CREST_THICKNESS_RATIO))
    return tuple({"measure": key} | {name: json_value(row.get(key)) for name, row in scalars.items()} for key in keys)


def named_surfaces(surfaces: Mapping[str, Any]) -> tuple[MeasuresByName, HemisphereNames]:
    """Single hemispheres by name, and these names by the names that were given.

    Raises
    ------
    ValueError
        If there is nothing to compare, or two surfaces end up with one name.
    """
    measures_by_name: dict[str, Measures] = {}
    hemisphere_names = defaultdict[str, tuple[str, ...]](tuple)
    for name, entry in surfaces.items():
        hemispheres = entry if isinstance(entry, list | tuple) else [entry]
        for measures in hemispheres:
            check_kind(measures, Measures, f"compare: {name}")
            hemisphere_name = name if len(hemispheres) == 1 else f"{name} {measures.cortex.hemi}"
            if hemisphere_name in measures_by_name:
                raise NamedTwice(
                    f"{hemisphere_name!r} names two surfaces ({measures_by_name[hemisphere_name].cortex.name} and "
                    f"{measures.cortex.name}, both {measures.cortex.hemi}). Give them different names."
                )
            measures_by_name[hemisphere_name] = measures
            hemisphere_names[name] += (hemisphere_name,)
    if not surfaces or len(hemisphere_names) < len(surfaces):
        raise NothingToDo('nothing to compare: pass at least one surface, e.g. {"model": measures}.')
    return measures_by_name, hemisphere_names


def grouped_names(sides: HemisphereNames, groups: Mapping[str, Sequence[str]] | None) -> HemisphereNames:
    """Names of the surfaces of each group; raises ``ValueError`` for a name that is not there, or in two groups."""
    if groups is None:
        return dict(sides)
    names_in_groups = [name for names in groups.values() for name in names]
    for name in names_in_groups:
        if name not in sides:
            raise UnknownName(f"a group has the name {name!r}, but the surfaces are {', '.join(sides)}.")
        if names_in_groups.count(name) > 1:
            raise NamedTwice(f"{name!r} is in two groups; hinges can't be compared with themselves.")
    return {group: tuple(side for name in names for side in sides[name]) for group, names in groups.items()}


def colours_of(sides: HemisphereNames, groups: HemisphereNames, requested: Mapping[str, str]) -> dict[str, str]:
    """A colour for each surface: the one given to it or to its group, or the next of ours.

    Raises
    ------
    ValueError
        If a colour can't be read, or its name is unknown.
    """
    single_surfaces = {name: (name,) for names in sides.values() for name in names}
    colours, next_colours = dict[str, str](), cycle(CATEGORICAL_COLOURS)
    for names in (*groups.values(), *sides.values()):
        if not colours.keys() & names:
            colours |= dict.fromkeys(names, next(next_colours))
    for name, colour in requested.items():
        if name not in {*groups, *sides, *single_surfaces}:
            raise UnknownName(f"a colour is given to {name!r}, which is not among {', '.join({**groups, **sides})}.")
        if not re.fullmatch("#[0-9a-fA-F]{6}", colour):
            raise NotReadable(f"{colour!r} is not a colour ({name}); write it as red, green and blue, such as #0072b2.")
    for surfaces_by_name in (groups, sides, single_surfaces):
        for name in requested.keys() & surfaces_by_name:
            colours |= dict.fromkeys(surfaces_by_name[name], requested[name].lower())
    return {name: colours[name] for name in single_surfaces}


def cautions(measures_of: MeasuresByName) -> list[str]:
    """A sentence for each scale or option that differs between surfaces and makes their numbers differ."""
    sentences = []
    for parameter, text_of in PARAMETER_TEXTS.items():
        names_by_value = defaultdict[str, list[str]](list)
        for name, measures in measures_of.items():
            if parameter in measures.parameters:
                names_by_value[text_of(measures.parameters[parameter])].append(name)
        if len(names_by_value) > 1:
            values_text = listed([f"{value} on {listed(names)}" for value, names in names_by_value.items()])
            sentences.append(PARAMETER_CAUTIONS[parameter].format(values_text))
    return sentences


def notes(measures_of: MeasuresByName) -> list[str]:
    """Numbers that were left out, and why."""
    return [
        f"{name}: {scalar} ({reason})"
        for name, measures in measures_of.items()
        for scalar, reason in sorted(measures.notes.items())
        if measures.scalars.get(scalar) is None
    ]


def plot_notes(measures_of: MeasuresByName, clouds: Sequence[Cloud]) -> list[str]:
    """Notes on the points of each surface in the plot of gyral against cortical thickness."""
    names = defaultdict[str, list[str]](list)
    for name, cloud in zip(measures_of, clouds):
        names[cloud.kind if cloud.points else "none"].append(name)
    names["mirrored"] = [name for name, measures in measures_of.items() if measures.cortex.portion != 1]
    sentences = [POINT_NOTES["none"].format(name) for name in names["none"]]
    if names["crest"] and names["region"]:
        sentences.append(POINT_NOTES["unlike"].format(listed(names["crest"]), listed(names["region"])))
    return sentences + [POINT_NOTES[kind].format(listed(names[kind])) for kind in ("mirrored", "whole") if names[kind]]


# growth beside morphology ------------------------------------------------------------------------------------


def dimensionless_numbers(measures: Measures) -> dict[str, float | None]:
    """Numbers of a body without unit, so that bodies of any size can be compared; None where it has none."""
    ratios, wavelength = thickness_ratios(measures), measures.scalars.get("wavelength_mm")
    thickness = measures.scalars.get("mean_cortical_thickness_mm")
    return {
        "gyrification index": measures.scalars.get("gyrification_index"),
        "k of the law of folding": getattr(shape_terms_of(measures), "k", None),  # None without terms
        "hinges per gyral width²": getattr(hinge_shapes(measures), "per_area", None),
        "gyral over cortical thickness": ratios[THICKNESS_RATIO],
        "gyral over cortical, at crests": ratios[CREST_THICKNESS_RATIO],
        "wavelength over cortical thickness": None if wavelength is None or not thickness else wavelength / thickness,
    }


def growth_curve(name: str, stages: Sequence[Measures]) -> GrowthCurve:
    """The curve of the stages of one body; the growth of a stage is ``cortex.info["g"]``.

    Raises
    ------
    ValueError
        If a stage has no growth, two have the same, or there are fewer than two.
    """
    if len(stages) < 2:
        raise MissingPart(f"{name}: growth needs at least two stages, got {len(stages)}.")
    if stages_without_growth := [stage.cortex.name for stage in stages if "g" not in stage.cortex.info]:
        raise DoesNotApply(f"{name}: {stages_without_growth[0]} has no growth; only stages of a simulation have one.")
    stages = sorted(stages, key=lambda stage: stage.cortex.info["g"])
    growth = np.array([float(stage.cortex.info["g"]) for stage in stages])
    if (repeated_growths := growth[:-1][np.diff(growth) == 0]).size:
        raise NamedTwice(f"{name}: two stages are at g = {repeated_growths[0]:g}. Leave one out.")
    number_rows = list(map(dimensionless_numbers, stages))
    numbers = {key: np.array([row[key] for row in number_rows], dtype=np.float64) for key in number_rows[0]}
    return GrowthCurve(name, growth, numbers, tuple(map(shape_terms_of, stages)))


def matching_growth(curve: GrowthCurve, measures: Measures) -> dict[str, list[float]]:
    """Growths at which each number of the curve equals that of another cortex, by linear interpolation of stages.

    Returns
    -------
    dict of str to list of float
        Ascending; empty where the curve never has that number, or the cortex has none.
    """
    growths = {}
    for key, value in dimensionless_numbers(measures).items():
        excess = curve.numbers[key] - (np.nan if value is None else value)
        is_finite = np.isfinite(excess)
        growth, excess = curve.growth[is_finite], excess[is_finite]
        k = np.flatnonzero(excess[:-1] * excess[1:] < 0)
        crossings = growth[k] + (growth[k + 1] - growth[k]) * excess[k] / (excess[k] - excess[k + 1])
        growths[key] = sorted([*growth[excess == 0].tolist(), *crossings.tolist()])
    return growths
