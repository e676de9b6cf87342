"""Measures of several cortices side by side: one table, one plot, one page (Fig. 8 of Razavi et al. 2015).

Nothing here knows whether a ``Measures`` came from a simulation; ``cortex.origin`` and ``cortex.info`` are
shown as labels, and ``info["mu_ratio"]``, where there is one, gives the theoretical line.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from morphofold.analysis.graph.hinge_shapes import hinge_shapes
from morphofold.analysis.gyrification.scaling import ShapeTerms, shape_terms_of
from morphofold.analysis.measures import SCALARS, Measures
from morphofold.comparison.growth import GrowthCurve, growth_curve, matching_growth
from morphofold.comparison.hinges import HingeComparison, compare_hinges
from morphofold.comparison.thickness import Cloud, Theory, thickness_clouds, thickness_ratios, wrinkling_wavelength
from morphofold.progress import Progress, silent
from morphofold.quantities import CATEGORICAL, CREST_RATIO, RATIO
from morphofold.surface import check_kind
from morphofold.tables import write_table
from morphofold.words import listed, number


@dataclass(frozen=True, eq=False)
class Comparison:
    """What ``compare`` found: one entry of ``measures`` and ``clouds`` per name, in the same order.

    ``table`` has one row per scalar: ``measure`` and one value per name, None where it could not be had.
    ``theory`` are lines for each ratio of stiffness that occurs, none for brains alone. ``groups`` hold the names of
    each group and ``colours`` the colour of each name, "#0072b2", that of its group unless it was given one. ``hinges``
    has what every two groups say of each other's three-hinge patterns. ``folding`` are the terms of the law of folding,
    None for a surface that isn't closed; ``growth`` has numbers of bodies as they grow, ``stages`` what they were taken
    from. ``notes`` say what was left out, ``cautions`` which scales and options differ between the surfaces.
    """

    names: tuple[str, ...]
    measures: tuple[Measures, ...] = field(repr=False)
    table: tuple[dict[str, Any], ...] = field(repr=False)
    clouds: tuple[Cloud, ...] = field(repr=False)
    theory: tuple[Theory, ...] = ()
    groups: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    colours: Mapping[str, str] = field(default_factory=dict, repr=False)
    hinges: tuple[HingeComparison, ...] = field(default=(), repr=False)
    folding: tuple[ShapeTerms | None, ...] = field(default=(), repr=False)
    growth: tuple[GrowthCurve, ...] = field(default=(), repr=False)
    stages: Mapping[str, tuple[Measures, ...]] = field(default_factory=dict, repr=False)
    notes: tuple[str, ...] = field(default=(), repr=False)
    cautions: tuple[str, ...] = field(default=(), repr=False)

    def to_dict(self) -> dict[str, Any]:
        """Everything but the maps, as plain values for JSON."""
        return {
            "names": list(self.names),
            "table": [dict(row) for row in self.table],
            "gyral_against_cortical_thickness": {n: asdict(c) for n, c in zip(self.names, self.clouds)},
            "theory": [asdict(line) for line in self.theory],
            "groups": {group: list(names) for group, names in self.groups.items()},
            "colours": dict(self.colours),
            "hinges": [asdict(found) for found in self.hinges],
            "growth": {c.name: self._met(c) for c in self.growth},
            "folding": {n: None if t is None else asdict(t) for n, t in zip(self.names, self.folding)},
            "notes": list(self.notes),
            "cautions": list(self.cautions),
        }

    def _met(self, curve: GrowthCurve) -> dict[str, Any]:
        """A curve as plain values, with the growths at which it has the numbers of each surface."""
        return {
            "growth": curve.growth.tolist(),
            "numbers": {key: [_plain(x) for x in values.tolist()] for key, values in curve.numbers.items()},
            "as": {name: matching_growth(curve, m) for name, m in zip(self.names, self.measures)},
        }

    def report(self, out: str | Path, *, progress: Progress = silent) -> Path:
        """Write ``out/`` whole or not at all: report.html, figures/*.png, comparison.json, comparison.tsv.

        Returns the path of the page. ``progress`` is told the share done, 0 to 1, and what is being drawn.
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
        return Path(out) / "report.html"


def compare(
    surfaces: Mapping[str, Measures | Sequence[Measures]], *, mu_ratio: float | None = None,
    groups: Mapping[str, Sequence[str]] | None = None, growth: Mapping[str, Sequence[Measures]] | None = None,
    colours: Mapping[str, str] | None = None, seed: int = 0,
) -> Comparison:  # fmt: skip
    """Put the measures of several cortices side by side.

    Parameters
    ----------
    surfaces : mapping of name to Measures, or to a sequence of them
        Two hemispheres under one name become ``"name lh"`` and ``"name rh"``.
    mu_ratio : float, optional
        Stiffness of cortex over core for the theoretical line; None: every ``cortex.info["mu_ratio"]`` there
        is, and no line if there is none.
    groups : mapping of group to names of ``surfaces``, optional
        Whose hinges are pooled and compared with those of other groups, in this order; None: each name is a group.
        Names in no group are compared in everything else.
    growth : mapping of name to stages of one body, optional
        Their numbers are drawn over growth, those of ``surfaces`` beside them. A body with the name of a surface, and
        its mesh, can be seen growing on the page.
    colours : mapping of a name or group to a colour such as "#0072b2", optional
        Those of names go before those of their groups; None: one for each group.
    seed : int
        Of permutations.

    Returns
    -------
    Comparison

    Raises
    ------
    ValueError
        If there is nothing to compare, two surfaces end up with one name, ``mu_ratio`` is not positive, or a group
        names what is not there or is in another, or stages do not say their growth, or a colour is none or of nothing.
    """
    check_kind(surfaces, Mapping, "compare: surfaces")
    named = _named(surfaces)
    grouped = _grouped(surfaces, groups)
    shapes = {name: found for name, m in named.items() if (found := hinge_shapes(m)) is not None}
    notes = [
        f"{name}: {what} ({why})"
        for name, m in named.items()
        for what, why in sorted(m.notes.items())
        if m.scalars.get(what) is None
    ]
    clouds = thickness_clouds(list(named.values()))
    return Comparison(
        names=tuple(named),
        measures=tuple(named.values()),
        table=tuple(
            {"measure": key, **dict(zip(named, values))} for key, values in numbers(list(named.values())).items()
        ),
        clouds=clouds,
        theory=theory_lines(named, mu_ratio),
        groups=grouped,
        colours=_coloured(surfaces, grouped, colours or {}),
        hinges=tuple(compare_hinges(shapes, grouped, seed=seed)),
        folding=tuple(shape_terms_of(m) for m in named.values()),
        stages={name: tuple(stages) for name, stages in (growth or {}).items()},
        growth=tuple(growth_curve(name, stages) for name, stages in (growth or {}).items()),
        notes=(*notes, *plot_notes(named, clouds)),
        cautions=tuple(cautions(named)),
    )


def _grouped(
    surfaces: Mapping[str, Measures | Sequence[Measures]], groups: Mapping[str, Sequence[str]] | None
) -> dict[str, tuple[str, ...]]:
    """Names of the surfaces, hemispheres apart, of each group."""
    full = {name: tuple(_named({name: entry})) for name, entry in surfaces.items()}
    if groups is None:
        return full
    asked = [name for names in groups.values() for name in names]
    for name in asked:
        if name not in full:
            raise ValueError(f"a group names {name!r}, which is not among {', '.join(full)}.")
        if asked.count(name) > 1:
            raise ValueError(f"{name!r} is in two groups; hinges can't be compared with themselves.")
    return {group: tuple(n for name in names for n in full[name]) for group, names in groups.items()}


def _coloured(
    surfaces: Mapping[str, Measures | Sequence[Measures]], groups: Mapping[str, tuple[str, ...]],
    asked: Mapping[str, str],
) -> dict[str, str]:  # fmt: skip
    """A colour for each surface, hemispheres apart: what was asked for it, or for its group, or the next of ours."""
    full = {name: tuple(_named({name: entry})) for name, entry in surfaces.items()}
    each = {name: (name,) for names in full.values() for name in names}
    grouped = {name for names in groups.values() for name in names}
    families = [*groups.values(), *(names for names in full.values() if not grouped & set(names))]
    colours = {n: CATEGORICAL[k % len(CATEGORICAL)] for k, names in enumerate(families) for n in names}
    for name, colour in asked.items():
        if name not in {*groups, *full, *each}:
            raise ValueError(f"a colour is given to {name!r}, which is not among {', '.join({**groups, **full})}.")
        if not re.fullmatch("#[0-9a-fA-F]{6}", colour):
            raise ValueError(f"{colour!r} is no colour for {name}; write it as red, green and blue, such as #0072b2.")
    for known in (groups, full, each):
        for name in [name for name in asked if name in known]:
            colours.update(dict.fromkeys(known[name], asked[name].lower()))
    return {name: colours[name] for name in each}


def _named(surfaces: Mapping[str, Measures | Sequence[Measures]]) -> dict[str, Measures]:
    named: dict[str, Measures] = {}
    for name, entry in surfaces.items():
        several: list[Any] = list(entry) if isinstance(entry, list | tuple) else [entry]
        for m in several:
            check_kind(m, Measures, f"compare: {name}")
            full = name if len(several) == 1 else f"{name} {m.cortex.hemi}"
            if full in named:
                raise ValueError(
                    f"{full!r} names two surfaces ({named[full].cortex.name} and {m.cortex.name}, both "
                    f"{m.cortex.hemi}). Give them different names."
                )
            named[full] = m
    if not named:
        raise ValueError('nothing to compare: pass at least one surface, e.g. {"model": measures}.')
    return named


def theory_lines(named: Mapping[str, Measures], mu_ratio: float | None = None) -> tuple[Theory, ...]:
    """The wavelength of theory at ``mu_ratio``, or at each ratio of stiffness that the surfaces say."""
    if mu_ratio is not None:
        ratios = [mu_ratio]
    else:
        known = (m.cortex.info.get("mu_ratio") for m in named.values())
        ratios = sorted({float(mu) for mu in known if mu is not None})
    for mu in ratios:
        if not 0 < mu < np.inf:
            raise ValueError(f"mu_ratio must be a positive number, got {mu}.")
    return tuple(map(wrinkling_wavelength, ratios))


def plot_notes(named: Mapping[str, Measures], clouds: Sequence[Cloud]) -> list[str]:
    """What a reader should know of the points of each surface in the plot of gyral against cortical thickness."""
    notes = [
        f"{name}: not in the plot of gyral against cortical thickness, it lacks one of the two."
        for name, cloud in zip(named, clouds) if not cloud.points
    ]  # fmt: skip
    by_kind = zip(named, named.values(), clouds)
    if crests := [name for name, m, cloud in by_kind if cloud.kind == "crest" and m.regions]:
        notes.append(
            f"{listed(crests)}: by crests here, because not every surface has regions; slopes over regions are under "
            "All measures."
        )
    if mirrored := [name for name, m in named.items() if m.cortex.portion != 1]:
        notes.append(
            f"{listed(mirrored)}: a part was simulated and the rest is its mirror image, which intervals and p count "
            "as further evidence: they are too narrow, and too small."
        )
    if whole := [name for name, cloud in zip(named, clouds) if cloud.kind == "whole" and cloud.points]:
        notes.append(
            f"{listed(whole)}: no regions, so one point (median gyral, mean cortical thickness) and bins of vertices "
            "stand for the surface."
        )
    return notes


def cautions(named: Mapping[str, Measures]) -> list[str]:
    """A sentence for each scale or option that is not the same for all surfaces and makes their numbers differ."""
    said = []
    if differing := _by_value(named, "curvature_scale_mm", lambda mm: f"{number(float(mm), 2)} mm"):
        where = listed([f"{mm} on {listed(names)}" for mm, names in differing.items()])
        said.append(f"Curvature was taken within {where}; compare H, folding indices and the sharpness of "
            "hinges with care.")
    if differing := _by_value(named, "cortical_thickness_cap_mm", lambda mm: f"at {mm:g} mm" if mm else "nowhere"):
        where = listed([f"{at} on {listed(names)}" for at, names in differing.items()])
        said.append(f"Cortical thickness was capped {where}; compare thick cortex with care.")
    if differing := _by_value(named, "graph_width_mm", lambda mm: f"{number(float(mm), 2)} mm"):
        where = listed([f"{mm} on {listed(names)}" for mm, names in differing.items()])
        said.append(f"Hinges are those of nets at a gyral width of {where}; compare them per square of that width.")
    if differing := _by_value(named, "accuracy", str):
        where = listed([f"{kind} on {listed(names)}" for kind, names in differing.items()])
        said.append(f"Accuracy was {where}; hinges and local gyrification hang on it where meshes are coarse.")
    if differing := _by_value(named, "cortex_mask", str):
        where = listed([f"by '{mask}' on {listed(names)}" for mask, names in differing.items()])
        said.append(f"Cortex was marked out {where}; means where nothing marks the medial wall may count it as cortex.")
    return said


def _by_value(named: Mapping[str, Measures], key: str, words: Callable[[Any], str]) -> dict[str, list[str]]:
    """Names of surfaces by their parameter ``key`` in words; empty unless two surfaces differ."""
    found: dict[str, list[str]] = {}
    for name, m in named.items():
        if key in m.parameters:
            found.setdefault(words(m.parameters[key]), []).append(name)
    return found if len(found) > 1 else {}


def numbers(measures: Sequence[Measures]) -> dict[str, list[Any]]:
    """Every scalar, and both ratios of gyral to cortical thickness: the value of each surface, or None."""
    extra = sorted({key for m in measures for key in m.scalars} - set(SCALARS))
    found = {key: [_plain(m.scalars.get(key)) for m in measures] for key in (*SCALARS, *extra)}
    ratios = [[_plain(ratio) for ratio in thickness_ratios(m)] for m in measures]
    return {**found, **{key: list(values) for key, values in zip((RATIO, CREST_RATIO), zip(*ratios))}}


def _plain(value: Any) -> Any:
    if value is None or isinstance(value, str | bool):
        return value
    number = float(value)
    if not np.isfinite(number):
        return None
    return int(number) if isinstance(value, int | np.integer) else number
