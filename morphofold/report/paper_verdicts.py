"""How each figure compares with the paper's, in a sentence or two made of the numbers in its tables."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise

from morphofold.report.markdown import Row
from morphofold.report.paper_parts import Tables
from morphofold.report.paper_theory import ONE_D, THREE_D

AGREES = 0.01           # share by which a simulation may miss theory and still be said to agree
UNFOLDED = "Not as in the paper: there is a body without folds."
NEARER = 0.8            # of the distance of chance: matches below are more than chance


def _fig3(tables: Tables) -> str:
    def worst(file: str, source: str, folded: int = 0) -> float:
        rows = [row for row in tables[file] if row["source"] == source and not (row.get("folded") or 0) - folded]
        return max((abs(row["over_theory"]) for row in rows if row["over_theory"] is not None), default=0.0)

    radius, stress, folded = worst("fig3a.tsv", THREE_D), worst("fig3b.tsv", ONE_D), worst("fig3a.tsv", THREE_D, 1)
    said = f"radius within {100 * radius:.2g} %, stress within {100 * stress:.2g} %"
    if max(radius, stress) < AGREES:
        text = f"As in the paper, finite elements are where theory has them until the sphere folds: {said}."
    else:
        text = f"Unlike in the paper, finite elements are not where theory has them: {said}."
    return text + (f" Once folded, the mean radius is up to {100 * folded:.2g} % off, as growth goes into folds.")


def _fig4(tables: Tables) -> str:
    rows = tables["fig4.tsv"]

    def crease(law: str, thickness: float) -> float:
        mine = [row for row in rows if row["law"] == law and row["g_crease"] is not None]
        return float(min(mine, key=lambda row: abs(row["T_over_C"] - thickness))["g_crease"])

    thin, even, flat = crease("isotropic", 0.0), crease("isotropic", 0.04), crease("tangential", 0.04)
    return (
        f"A thin cortex can crease from g = {thin:.2f} on, the paper's 1.34; one of T/C = 0.04 from {even:.2f} if "
        f"growth is isotropic, from {flat:.2f} if tangential. That is the paper's criterion; wrinkles come earlier "
        "(Fig. 5)."
    )


def _fig5(tables: Tables) -> str:
    rows = _folded(tables["fig5.tsv"])
    if not rows:
        return UNFOLDED
    first, last = rows[0], rows[-1]
    index = [row["gyrification_index"] for row in rows]
    rising = _falls(index[:0:-1])                                        # the first is of a sphere that hardly folds
    return (
        f"{_as(rising)} in the paper folds deepen steadily: GI is {index[0]:.2f} at g = {first['growth']:g} and "
        f"{index[-1]:.2f} at {last['growth']:g}. Theory of the whole sphere has first wrinkles at g = "
        f"{first['theory_g']:.3f}, with degree "
        f"{first['theory_degree']:.0f}; the first folds seen have {first['degree']:.1f}."
    )


def _fig6(tables: Tables) -> str:
    bodies = _by_body(tables["fig6.tsv"], "thickness_mm")
    if not all(bodies):
        return UNFOLDED
    last = [rows[-1] for rows in bodies]
    T, sulci, width = ([row[key] for row in last] for key in ("thickness_mm", "sulci", "gyral_thickness_mm"))
    shortest = [min(row["wavelength_mm"] for row in rows) / t for rows, t in zip(bodies, T)]
    exact = [row["theory_wavelength_mm"] / t for row, t in zip(last, T)]
    return (
        f"{_as(_falls(sulci) and _falls(width[::-1]))} in the paper, thick cortices have fewer and wider folds: "
        f"{_listed(sulci, '{:.0f}')} sulci and gyri {_listed(width, '{:.1f}')} mm wide at T = {_listed(T, '{:g}')} mm. "
        f"Waves are {_span(shortest)} T long at their shortest; theory of the whole sphere has {_span(exact)} T, the "
        f"paper's formula of a stiff film {last[0]['film_wavelength_mm'] / T[0]:.1f} T."
    )


def _fig7(tables: Tables) -> str:
    bodies = _by_body(tables["fig7.tsv"], "mu_ratio")
    if not all(bodies):
        return UNFOLDED
    skewed = [min(row["height_skewness"] for row in rows) for rows in bodies]
    return (
        f"{_as(_falls(skewed[::-1]))} in the paper, soft cortices begin with narrow furrows, stiff ones with waves: "
        f"the height is skewed by {_listed(skewed, '{:.2f}').replace('-', '−')} at ratios "
        f"{_listed([rows[0]['mu_ratio'] for rows in bodies], '{:g}')}. But linear stability has wrinkles first at "
        "every ratio, where the paper has creases first at small ones."
    )


def _fig8(tables: Tables) -> str:
    rows = tables["fig8.tsv"]
    (bodies,) = [row for row in rows if row["points"] == "bodies"]
    regions = [row for row in rows if row["points"].startswith("regions") and row["slope"] is not None]
    crests = {row["surface"]: row["gyral_over_cortical"] for row in rows if row["points"] == "crests"}
    if None in crests.values() or bodies["slope"] is None:
        return UNFOLDED
    models = [ratio for name, ratio in crests.items() if name.startswith("T =")]
    people = [ratio for name, ratio in crests.items() if not name.startswith("T =")]
    apart = min(people) > 1.1 * max(models) or max(people) < min(models) / 1.1
    start = f"{'+' if bodies['intercept_mm'] > 0 else '−'} {abs(bodies['intercept_mm']):.1f}"
    return (
        f"{_as(bodies['slope'] > 0)} in the paper gyri widen with the cortex from body to body: W = "
        f"{bodies['slope']:.2f} t {start} mm. Over regions of the average brain the slope is positive in "
        f"{sum(r['slope'] > 0 for r in regions)} of {len(regions)} fits, and above 0 with 95 % confidence in "
        f"{sum(r['slope_low'] > 0 for r in regions)}. Gyri are {_span(models)} times as wide as the cortex is thick "
        f"in the models, {_span(people)} times in a person: "
        f"{'two laws of proportion, not one' if apart else 'one law of proportion'}."
    )


def _fig9(tables: Tables) -> str:
    shape = next(row for row in tables["fig9-numbers.tsv"] if row["number"] == "shape")
    largest = next(row for row in tables["fig9-numbers.tsv"] if row["number"].startswith("largest angle"))
    model, *controls = tables["fig9-nearest.tsv"]
    near = model["median"] < NEARER * min(row["median"] for row in controls)
    others = ", ".join(f"{row['source']} {row['median']:.3f}" for row in controls)
    return (
        f"As in the paper every hinge of a model has its like on a person's brain, {model['median']:.3f} away (median "
        f"of angles and lengths), {'nearer than chance' if near else 'which says little, as chance comes as near'}: "
        f"{others}. As distributions the shapes {'differ' if shape['p'] < 0.05 else 'are not told apart'} (energy "
        f"distance {shape['energy']:.3f}, p = {shape['p']:.2g}); the largest angle is {largest['median']:.0f}° in "
        f"models, {largest['other_median']:.0f}° in the person."
    )


def _folded(rows: Sequence[Row]) -> list[Row]:
    return [row for row in rows if row["wavelength_mm"] is not None]


def _by_body(rows: Sequence[Row], key: str) -> list[list[Row]]:
    """The folded rows of each body, in the order of a number of the body."""
    return [[row for row in _folded(rows) if row[key] == value] for value in sorted({row[key] for row in rows})]


def _falls(values: Sequence[float]) -> bool:
    return all(b < a for a, b in pairwise(values))


def _as(same: bool) -> str:
    return "As" if same else "Not as"


def _listed(values: Sequence[float], how: str) -> str:
    words = [how.format(value) for value in values]
    return f"{', '.join(words[:-1])} and {words[-1]}"


def _span(values: Sequence[float]) -> str:
    low, high = f"{min(values):.1f}", f"{max(values):.1f}"
    return low if low == high else f"{low} to {high}"


#: figure -> how it compares with the paper's, from its tables by the names of their files
VERDICTS: dict[str, Callable[[Tables], str]] = {
    "fig3": _fig3, "fig4": _fig4, "fig5": _fig5, "fig6": _fig6, "fig7": _fig7, "fig8": _fig8, "fig9": _fig9,
}  # fmt: skip
