"""Measures of several cortices side by side: one table, one plot, one page (Fig. 8 of Razavi et al. 2015).

Simulations and brains are treated the same. ``cortex.origin`` and ``cortex.info`` are shown as labels, and
``info["mu_ratio"]``, if there is one, gives the theoretical line.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from morphofold.analysis.graph.hinge_shapes import hinge_shapes
from morphofold.analysis.gyrification.folding_law import ShapeTerms, shape_terms_of
from morphofold.analysis.measures import SCALARS, Measures
from morphofold.comparison.growth import GrowthCurve, growth_curve, matching_growth
from morphofold.comparison.hinges import HingeComparison, compare_hinges
from morphofold.comparison.names import colours_of, grouped_names, named_surfaces
from morphofold.comparison.person.agreement import SPINS
from morphofold.comparison.person.compare_person import PersonComparison, beside_people, write_people
from morphofold.comparison.remarks import cautions, notes, plot_notes
from morphofold.comparison.thickness import Cloud, TheoryLine, thickness_clouds, thickness_ratios, wrinkling_wavelength
from morphofold.display import html_of
from morphofold.errors import OutOfRange
from morphofold.progress import Progress, silent
from morphofold.quantities import CREST_THICKNESS_RATIO, THICKNESS_RATIO
from morphofold.surface import check_kind
from morphofold.tables import write_table

THICKNESS_RATIOS = (THICKNESS_RATIO, CREST_THICKNESS_RATIO)  # in the order of thickness_ratios


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
    measures: tuple[Measures, ...] = field(repr=False)
    table: tuple[dict[str, Any], ...] = field(repr=False)
    clouds: tuple[Cloud, ...] = field(repr=False)
    theory: tuple[TheoryLine, ...] = ()
    groups: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    colours: Mapping[str, str] = field(default_factory=dict, repr=False)
    hinges: tuple[HingeComparison, ...] = field(default=(), repr=False)
    folding: tuple[ShapeTerms | None, ...] = field(default=(), repr=False)
    growth: tuple[GrowthCurve, ...] = field(default=(), repr=False)
    stages: Mapping[str, tuple[Measures, ...]] = field(default_factory=dict, repr=False)
    people: tuple[PersonComparison, ...] = field(default=(), repr=False)
    notes: tuple[str, ...] = field(default=(), repr=False)
    cautions: tuple[str, ...] = field(default=(), repr=False)

    def __repr__(self) -> str:
        names = ", ".join(map(repr, self.names))
        return f"Comparison({names}; {len(self.groups)} groups, {len(self.people)} compared with their person)"

    def _repr_html_(self) -> str:
        return html_of(self)

    def to_dict(self) -> dict[str, Any]:
        """Everything but the maps, as plain values for JSON."""
        return {
            "names": list(self.names),
            "table": [dict(row) for row in self.table],
            "gyral_against_cortical_thickness": {n: asdict(c) for n, c in zip(self.names, self.clouds)},
            "theory": [asdict(line) for line in self.theory],
            "groups": {group: list(names) for group, names in self.groups.items()},
            "colours": dict(self.colours),
            "hinges": [{**asdict(found), "verdict": found.verdict} for found in self.hinges],
            "growth": {c.name: self._met(c) for c in self.growth},
            "folding": {n: None if t is None else asdict(t) for n, t in zip(self.names, self.folding)},
            "notes": list(self.notes),
            "cautions": list(self.cautions),
            **({"people": [found.to_dict() for found in self.people]} if self.people else {}),
        }

    def _met(self, curve: GrowthCurve) -> dict[str, Any]:
        """A curve as plain values, with the growths at which its numbers equal those of each surface."""
        return {
            "growth": curve.growth.tolist(),
            "numbers": {key: [_json_value(x) for x in values.tolist()] for key, values in curve.numbers.items()},
            "as": {name: matching_growth(curve, m) for name, m in zip(self.names, self.measures)},
        }

    def report(self, out: str | Path, *, progress: Progress = silent) -> Path:
        """Write ``out/`` completely or not at all: report.html, figures/*.png, comparison.json, comparison.tsv.

        With ``people`` also person.tsv, person_regions.tsv and carried/.

        Returns the path of the page. ``progress`` is called with the share done, 0 to 1, and what is being drawn.
        """
        import morphofold
        from morphofold.io import atomic_folder
        from morphofold.provenance import strict_json
        from morphofold.report.pages.page import comparison_report

        with atomic_folder(out) as folder:
            comparison_report(self, folder, progress=progress)
            content = {"morphofold": morphofold.__version__, **self.to_dict()}
            (folder / "comparison.json").write_text(strict_json(content), encoding="utf-8")
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
    named, full = named_surfaces(surfaces)
    grouped = grouped_names(full, groups)
    shapes = {name: found for name, m in named.items() if (found := hinge_shapes(m)) is not None}
    clouds = thickness_clouds(list(named.values()))
    people, remarks = beside_people(named, spins=spins, seed=seed)
    return Comparison(
        names=tuple(named),
        measures=tuple(named.values()),
        table=tuple(
            {"measure": key, **dict(zip(named, values))} for key, values in numbers(list(named.values())).items()
        ),
        clouds=clouds,
        theory=theory_lines(named, mu_ratio),
        groups=grouped,
        colours=colours_of(full, grouped, colours or {}),
        hinges=tuple(compare_hinges(shapes, grouped, seed=seed)),
        folding=tuple(shape_terms_of(m) for m in named.values()),
        stages={name: tuple(stages) for name, stages in (growth or {}).items()},
        growth=tuple(growth_curve(name, stages) for name, stages in (growth or {}).items()),
        people=people,
        notes=(*notes(named), *plot_notes(named, clouds)),
        cautions=(*cautions(named), *remarks),
    )


def theory_lines(named: Mapping[str, Measures], mu_ratio: float | None = None) -> tuple[TheoryLine, ...]:
    """Theoretical wavelength at ``mu_ratio``, or at each ratio of stiffness in ``cortex.info`` of the surfaces."""
    if mu_ratio is not None:
        ratios = [mu_ratio]
    else:
        known = (m.cortex.info.get("mu_ratio") for m in named.values())
        ratios = sorted({float(mu) for mu in known if mu is not None})
    for mu in ratios:
        if not 0 < mu < np.inf:
            raise OutOfRange(f"mu_ratio must be a positive number, got {mu}.")
    return tuple(map(wrinkling_wavelength, ratios))


def numbers(measures: Sequence[Measures]) -> dict[str, list[Any]]:
    """Every scalar, and both ratios of gyral to cortical thickness: the value of each surface, or None."""
    extra = sorted({key for m in measures for key in m.scalars} - set(SCALARS))
    own = [{**m.scalars, **dict(zip(THICKNESS_RATIOS, thickness_ratios(m)))} for m in measures]
    return {key: [_json_value(values.get(key)) for values in own] for key in (*SCALARS, *extra, *THICKNESS_RATIOS)}


def _json_value(value: Any) -> Any:
    if value is None or isinstance(value, str | bool):
        return value
    number = float(value)
    if not np.isfinite(number):
        return None
    return int(number) if isinstance(value, int | np.integer) else number
