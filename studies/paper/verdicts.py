"""Comparison of each figure with that of the paper, in a few sentences made from the numbers in its tables."""

import math
from collections.abc import Callable, Sequence
from itertools import pairwise

from morphofold.number_texts import listed
from morphofold.sim.theory import critical_growth
from morphofold.studies.markdown import Row
from morphofold.studies.paper.figure_parts import Tables
from morphofold.studies.paper.paper_folds import FIG7
from morphofold.studies.paper.paper_theory import ONE_D, THREE_D

AGREEMENT = 0.01  # a simulation agrees with theory if it differs by less than this share
UNFOLDED_TEXT = "Not as in the paper: a body has no folds, or too few folded stages."


def _fig3(tables: Tables) -> str:
    def worst(file: str, source: str, folded: int = 0) -> float:
        rows = [row for row in tables[file] if row["source"] == source and (row.get("folded") or 0) == folded]
        return max((abs(row["over_theory"]) for row in rows if row["over_theory"] is not None), default=math.nan)

    radius, stress, mean_radius = worst("fig3a.tsv", THREE_D), worst("fig3b.tsv", ONE_D), worst("fig3a.tsv", THREE_D, 1)
    agrees = radius < AGREEMENT and stress < AGREEMENT
    text = (
        f"{_as(agrees)} in the paper, finite elements are within {100 * AGREEMENT:g} % of theory until the sphere "
        f"folds: radius within {100 * radius:.2g} %, stress within {100 * stress:.2g} %."
    )
    if math.isnan(mean_radius):
        return text
    return text + f" After folding, the mean radius is up to {100 * mean_radius:.2g} % off, because growth forms folds."


def _fig4(tables: Tables) -> str:
    rows = tables["fig4.tsv"]

    def crease(law: str, thickness: float) -> float:
        law_rows = [row for row in rows if row["law"] == law and row["g_crease"] is not None]
        return float(min(law_rows, key=lambda row: abs(row["T_over_C"] - thickness))["g_crease"])

    thin_g, iso_g, tan_g = crease("isotropic", 0.0), crease("isotropic", 0.04), crease("tangential", 0.04)
    return (
        f"A thin cortex can crease from g = {thin_g:.2f} on; the paper gives 1.34. A cortex with T/C = 0.04 can crease "
        f"from {iso_g:.2f} if growth is isotropic, from {tan_g:.2f} if tangential. This is the criterion of the paper; "
        "wrinkles come earlier (Fig. 5)."
    )


def _fig5(tables: Tables) -> str:
    rows = _folded(tables["fig5.tsv"])
    if len(rows) < 3:
        return UNFOLDED_TEXT
    first_row, last_row = rows[0], rows[-1]
    GI = [row["gyrification_index"] for row in rows]

    def is_rising(rows: Sequence[Row]) -> bool:
        return _falls([row["gyrification_index"] for row in rows][:0:-1])  # the first is of a sphere that hardly folds

    return (
        f"{_verdict(tables, 'fig5', is_rising)}, folds deepen steadily: GI is {GI[0]:.2f} at g = "
        f"{first_row['growth']:g} and {GI[-1]:.2f} at {last_row['growth']:g}. Theory of the whole sphere "
        f"gives first wrinkles at g = {first_row['theory_g']:.3f}, with degree {first_row['theory_degree']:.0f}; the "
        f"first simulated folds have degree {first_row['degree']:.1f}."
    )


def _fig6(tables: Tables) -> str:
    rows_by_body = _by_body(tables["fig6.tsv"], "thickness_mm")
    if not all(rows_by_body):
        return UNFOLDED_TEXT
    last_rows = [rows[-1] for rows in rows_by_body]
    T, n_sulci, widths = ([row[key] for row in last_rows] for key in ("thickness_mm", "sulci", "gyral_thickness_mm"))
    shortest = [min(row["wavelength_mm"] for row in rows) / thickness for rows, thickness in zip(rows_by_body, T)]
    theory = [row["theory_wavelength_mm"] / thickness for row, thickness in zip(last_rows, T)]

    def are_fewer_and_wider(rows: Sequence[Row]) -> bool:
        bodies = _by_body(rows, "thickness_mm")
        last = [rows_of_body[-1] for rows_of_body in bodies if rows_of_body]
        return (
            len(last) == len(bodies)
            and _falls([row["sulci"] for row in last])
            and _falls([row["gyral_thickness_mm"] for row in last][::-1])
        )

    return (
        f"{_verdict(tables, 'fig6', are_fewer_and_wider)}, thick cortices have fewer and wider folds: "
        f"{_listed(n_sulci, '{:.0f}')} sulci and gyri {_listed(widths, '{:.1f}')} mm wide at T = {_listed(T, '{:g}')} "
        f"mm. The shortest waves are {_span(shortest)} T long; theory of the whole sphere gives {_span(theory)} "
        f"T, the formula of the paper for a stiff film {last_rows[0]['film_wavelength_mm'] / T[0]:.1f} T."
    )


def _fig7(tables: Tables) -> str:
    rows = _first_pictures(tables["fig7.tsv"])
    if len(rows) < len(FIG7):
        return UNFOLDED_TEXT
    skewness, wrinkle_growths = ([row[name] for row in rows] for name in ("height_skewness", "theory_g"))
    crease_growth = float(critical_growth(1 / (1 - rows[0]["T_over_C"]), rows[0]["law"]))
    before_text = "all" if max(wrinkle_growths) < crease_growth else "not all"
    touching_text = ""
    if all(row["first_contact_g"] is not None for row in rows):
        delays = [max(0.0, row["first_contact_g"] - row["theory_g"]) for row in rows]
        touching_text = f" Walls of folds first touch {_listed(delays, '{:.2f}')} of growth after those wrinkles."

    def are_less_skewed(rows: Sequence[Row]) -> bool:
        return _falls([row["height_skewness"] for row in _first_pictures(rows)][::-1])

    return (
        f"{_verdict(tables, 'fig7', are_less_skewed)}, soft cortices begin with narrow furrows, stiff ones with waves: "
        f"when folds are {_span([row['height_rms_mm'] for row in rows])} mm high (rms), the skewness of the height is "
        f"{_listed(skewness, '{:.2f}').replace('-', '−')} at ratios "
        f"{_listed([row['mu_ratio'] for row in rows], '{:g}')}. But linear stability gives wrinkles at g = "
        f"{_listed(wrinkle_growths, '{:.2f}')}, {before_text} before the creases of Eq. (12) at {crease_growth:.2f}. "
        f"In the paper, creases come first at small ratios.{touching_text}"
    )


def _fig8(tables: Tables) -> str:
    rows = tables["fig8.tsv"]
    (bodies_row,) = [row for row in rows if row["points"] == "bodies"]
    region_rows = [row for row in rows if row["points"].startswith("regions") and row["slope"] is not None]
    crests = [row for row in rows if row["points"] == "crests"]
    ratio_columns = ("gyral_over_cortical", "gyral_over_cortical_at_crests")
    if bodies_row["slope"] is None or any(row[key] is None for row in crests for key in ratio_columns):
        return UNFOLDED_TEXT
    ratios = [
        [_span([row[key] for row in crests if row["surface"].startswith("T =") == model]) for model in (True, False)]
        for key in ratio_columns
    ]
    intercept_text = f"{'+' if bodies_row['intercept_mm'] > 0 else '−'} {abs(bodies_row['intercept_mm']):.1f}"
    return (
        f"{_as(bodies_row['slope'] > 0)} in the paper, gyri are wider in bodies with a thicker cortex: W = "
        f"{bodies_row['slope']:.2f} t {intercept_text} mm. Over regions of the average brain, two hemispheres with two "
        f"thicknesses each, the robust slope is positive in {sum(r['robust_slope'] > 0 for r in region_rows)} "
        f"of {len(region_rows)} fits, above 0 with 95 % confidence in {_above_0(region_rows)} (by least squares "
        f"{sum(r['slope'] > 0 for r in region_rows)} and {sum(r['slope_low'] > 0 for r in region_rows)}). From crest "
        f"to crest of one surface it is above 0 with 95 % confidence in {_above_0(crests)} of {len(crests)}. "
        f"At their crests, gyri are {ratios[1][0]} times as wide as the cortex is thick in the models, "
        f"{ratios[1][1]} times in a person; over all the cortex {ratios[0][0]} and {ratios[0][1]} times."
    )


def _fig9(tables: Tables) -> str:
    shape_row = next(row for row in tables["fig9-numbers.tsv"] if row["number"] == "shape")
    angle_row = next(row for row in tables["fig9-numbers.tsv"] if row["number"].startswith("largest angle"))
    model_row, person_row, *_ = tables["fig9-nearest.tsv"]
    return (
        f"{model_row['verdict']} For other hinges of the person it is {person_row['to_other']:.3f} and "
        f"{person_row['from_other']:.3f}. The paper calls such pairs counterparts. The distributions of the shapes "
        f"{'differ' if shape_row['p'] < 0.05 else 'do not differ significantly'} (energy distance "
        f"{shape_row['energy']:.3f}, p = {shape_row['p']:.2g}); the largest angle is {angle_row['median']:.0f}° "
        f"in models, {angle_row['other_median']:.0f}° in the person."
    )


def _folded(rows: Sequence[Row]) -> list[Row]:
    """The rows of a folded surface; just after the onset its gyri may have no width yet."""
    needed_columns = ("wavelength_mm", "sulci", "height_skewness")
    return [row for row in rows if all(row[column] is not None for column in needed_columns)]


def _first_pictures(rows: Sequence[Row]) -> list[Row]:
    """The folded rows of the first pictures of Fig. 7, the softest cortex first."""
    places = [(column.scene, column.growths[0]) for column in FIG7]
    first_rows = [row for row in _folded(rows) if (row["scene"], row["growth"]) in places]
    return sorted(first_rows, key=lambda row: float(row["mu_ratio"]))


def _verdict(tables: Tables, figure: str, claim: Callable[[Sequence[Row]], bool]) -> str:
    """Whether a claim holds as in the paper, for the figure's own bodies and for each other seed."""
    seed_rows = tables[f"{figure}-seeds.tsv"]
    by_seed = [[row for row in seed_rows if row["seed"] == seed] for seed in sorted({row["seed"] for row in seed_rows})]
    holds = [claim(_folded(rows)) for rows in (tables[f"{figure}.tsv"], *by_seed)]
    if all(holds) or not any(holds):
        return f"{_as(all(holds))} in the paper and for each of {len(holds)} seeds"
    return f"Not as in the paper for {holds.count(False)} of {len(holds)} seeds"


def _by_body(rows: Sequence[Row], column: str) -> list[list[Row]]:
    """The rows of each body whose gyri have a width, ordered by a number of the body."""
    rows_with_width = [row for row in _folded(rows) if row["gyral_thickness_mm"] is not None]
    return [[row for row in rows_with_width if row[column] == value] for value in sorted({row[column] for row in rows})]


def _fig8_grown(tables: Tables) -> str:
    pair_row, control_row = (
        next(row for row in tables["fig8-grown.tsv"] if (row["subject"], row["kind"]) == ("all", kind))
        for kind in ("pair", "control")
    )
    is_wider = pair_row["low"] is not None and pair_row["low"] > 0 and pair_row["slope"] > (control_row["high"] or 0)
    bounds_text = "one pair" if pair_row["low"] is None else f"{pair_row['low']:.2f} to {pair_row['high']:.2f}"
    text = (
        f"{_as(is_wider)} in the paper, a thicker cortex makes wider gyri: width goes with thickness to the power "
        f"{pair_row['slope']:.2f} ({bounds_text})."
    )
    if control_row["high"] is None:
        return text
    return f"{text} Of two seeds, which differ by chance alone, 95 % have powers below {control_row['high']:.2f}."


def _above_0(rows: Sequence[Row]) -> int:
    """Number of fits whose robust slope is above 0 with 95 % confidence."""
    return sum(row["robust_low"] is not None and row["robust_low"] > 0 for row in rows)


def _falls(values: Sequence[float]) -> bool:
    return all(later < earlier for earlier, later in pairwise(values))


def _as(agrees: bool) -> str:
    return "As" if agrees else "Not as"


def _listed(values: Sequence[float], number_format: str) -> str:
    return listed([number_format.format(value) for value in values])


def _span(values: Sequence[float]) -> str:
    least, largest = f"{min(values):.1f}", f"{max(values):.1f}"
    return least if least == largest else f"{least} to {largest}"


#: figure -> its comparison with the paper, from its tables by file name
VERDICT_MAKERS: dict[str, Callable[[Tables], str]] = {
    "fig3": _fig3,
    "fig4": _fig4,
    "fig5": _fig5,
    "fig6": _fig6,
    "fig7": _fig7,
    "fig8": _fig8,
    "fig9": _fig9,
    "fig8-grown": _fig8_grown,
}
