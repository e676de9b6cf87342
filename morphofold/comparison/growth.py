"""Growth beside morphology: numbers of a growing body, and the growth at which they match those of another cortex."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from morphofold.analysis.graph.hinge_shapes import hinge_shapes
from morphofold.analysis.gyrification.folding_law import ShapeTerms, shape_terms_of
from morphofold.analysis.measures import Measures
from morphofold.arrays import Array
from morphofold.comparison.thickness import thickness_ratios
from morphofold.errors import DoesNotApply, MissingPart, NamedTwice


def _wavelength_over_thickness(m: Measures) -> float | None:
    wavelength, thickness = m.scalars.get("wavelength_mm"), m.scalars.get("mean_cortical_thickness_mm")
    return None if wavelength is None or not thickness else wavelength / thickness


#: numbers without unit, so that bodies of any size can be compared
DIMENSIONLESS_NUMBERS: dict[str, Callable[[Measures], float | None]] = {
    "gyrification index": lambda m: m.scalars.get("gyrification_index"),
    "k of the law of folding": lambda m: getattr(shape_terms_of(m), "k", None),  # None without terms
    "hinges per gyral width²": lambda m: getattr(hinge_shapes(m), "per_area", None),
    "gyral over cortical thickness": lambda m: thickness_ratios(m)[0],
    "gyral over cortical, at crests": lambda m: thickness_ratios(m)[1],
    "wavelength over cortical thickness": _wavelength_over_thickness,
}


@dataclass(frozen=True, eq=False)
class GrowthCurve:
    """Numbers of a body over its growth.

    Attributes
    ----------
    name : str
    growth : (G,) float64
        Growth stretches, ascending.
    numbers : mapping of str to (G,) float64
        The numbers in :data:`DIMENSIONLESS_NUMBERS`; NaN if a stage doesn't have one (it isn't folded yet).
    folding : (G,) tuple of ShapeTerms or None
        Terms of the law of folding at each stage.
    """

    name: str
    growth: Array
    numbers: Mapping[str, Array] = field(repr=False)
    folding: tuple[ShapeTerms | None, ...] = field(default=(), repr=False)


def growth_curve(name: str, stages: Sequence[Measures]) -> GrowthCurve:
    """The curve of the stages of one body; the growth of a stage is ``cortex.info["g"]``.

    Raises
    ------
    ValueError
        If a stage has no growth, two have the same, or there are fewer than two.
    """
    if len(stages) < 2:
        raise MissingPart(f"{name}: growth needs at least two stages, got {len(stages)}.")
    if missing := [m.cortex.name for m in stages if "g" not in m.cortex.info]:
        raise DoesNotApply(f"{name}: {missing[0]} has no growth; only stages of a simulation have one.")
    stages = sorted(stages, key=lambda m: float(m.cortex.info["g"]))
    growth = np.array([float(m.cortex.info["g"]) for m in stages])
    if (np.diff(growth) == 0).any():
        raise NamedTwice(f"{name}: two stages are at g = {growth[:-1][np.diff(growth) == 0][0]:g}. Leave one out.")
    numbers = {key: np.array(list(map(of, stages)), dtype=np.float64) for key, of in DIMENSIONLESS_NUMBERS.items()}
    return GrowthCurve(name, growth, numbers, tuple(shape_terms_of(m) for m in stages))


def matching_growth(curve: GrowthCurve, measures: Measures) -> dict[str, list[float]]:
    """Growths at which each number of the curve equals that of another cortex, by linear interpolation of stages.

    Returns
    -------
    dict of str to list of float
        Ascending; empty where the curve never has that number, or the cortex has none.
    """
    return {
        key: _growths_at_value(curve.growth, curve.numbers[key], of(measures))
        for key, of in DIMENSIONLESS_NUMBERS.items()
    }


def _growths_at_value(growth: Array, values: Array, number: float | None) -> list[float]:
    if number is None:
        return []
    known = np.isfinite(values)
    g, above = growth[known], values[known] - number
    k = np.flatnonzero(above[:-1] * above[1:] < 0)
    crossings = g[k] + (g[k + 1] - g[k]) * above[k] / (above[k] - above[k + 1])
    return sorted([*g[above == 0].tolist(), *crossings.tolist()])
