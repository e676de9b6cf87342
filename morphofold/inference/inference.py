"""What comes of an inference: bodies with and without the person's map, beside the person and all controls.

In go the runs of :mod:`~morphofold.inference.inference_runs` once they are grown and measured, out come the least
spread of growth at which the folds stand where the person's do, tables and a page; :mod:`morphofold.cli.infer` calls
this.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import combinations
from pathlib import Path
from typing import Any, Literal

import numpy as np

from morphofold.analysis.measures_result import Measures
from morphofold.analysis.measuring import measure
from morphofold.comparison.person.compare_person import PersonComparison, compare_with_person
from morphofold.comparison.person.fold_heights import band, fold_heights
from morphofold.digests_and_json import Row, json_value
from morphofold.errors import NothingToDo
from morphofold.group.sweep import RUNS_FOLDER
from morphofold.group.task_records import read_record
from morphofold.inference.inference_runs import HELD_FROM, LEVEL, RADIUS, InferenceRun, Plan, write_values
from morphofold.io import atomic_folder
from morphofold.io.json_files import write_json
from morphofold.progress_callbacks import Progress, logged
from morphofold.quantities import RELIEF
from morphofold.results import read_analysis
from morphofold.sim.output.stage_records import read_health
from morphofold.tables import write_table
from morphofold.threads import run_parallel


@dataclass(frozen=True, eq=False)
class Grown:
    """A grown body beside the person."""

    run: InferenceRun
    applied: float
    comparison: PersonComparison
    is_healthy: bool
    warnings: tuple[str, ...]

    @cached_property
    def folds(self) -> Any:
        """Coefficients of the heights of its folds, in degrees 7 to 30."""
        body = self.comparison.bodies.grown
        return band(fold_heights(body.points, body.measures.maps[RELIEF], body.weights)).coefficients[:, 0]

    @property
    def agreement(self) -> float:
        """Correlation of its folds with the person's."""
        return self.comparison.agreements[0].tested.value

    @property
    def beats_controls(self) -> bool:
        """Whether that is above spins, the body before growth and its deepened sulci, each with p < 0.05."""
        return self.comparison.agreements[0].verdict == "above control"

    def row(self) -> Row:
        """Its row of ``runs.tsv``."""
        found = {row.what: row for row in self.comparison.agreements}
        folds, valleys = found["folds"], found["valleys"]
        crests = found.get("crests")
        bands = {f"folds_{row['low']}_{row['high']}": row["grown"] for row in self.comparison.bands}
        gyrification = self.comparison.bodies.grown.measures.scalars.get("gyrification_index")
        return {
            "run": self.run.name,
            "spread": self.run.spread,
            "applied_spread": self.applied,
            "seed": self.run.seed,
            "turned": self.run.turn,
            "folds": folds.tested.value,
            "p": folds.tested.p,
            "p_above_before": folds.tested.difference_p,
            "p_above_deepened": folds.deepened.difference_p,
            **bands,
            "valleys": valleys.tested.value,
            "valleys_by_chance": valleys.tested.null_mean,
            "crests": None if crests is None else crests.tested.value,
            "crests_by_chance": None if crests is None else crests.tested.null_mean,
            "depth": found["depth"].tested.value,
            "gyrification_index": gyrification,
            "healthy": self.is_healthy,
            "warnings": "; ".join(self.warnings),
        }


@dataclass(frozen=True, eq=False)
class Inference:
    """All bodies of a plan that could be grown, beside the person."""

    plan: Plan
    person: Measures
    grown: tuple[Grown, ...]

    @property
    def controls(self) -> dict[str, float]:
        """Correlation with the person's folds of what has no map of the person: the largest of each kind."""
        folds = self.grown[0].comparison.agreements[0]
        values = {"before growth": folds.tested.control or 0.0, "sulci deepened": folds.deepened.control or 0.0}
        for name, members in (
            ("grown evenly", [body for body in self.grown if not body.run.spread]),
            ("map turned away", [body for body in self.grown if body.run.turn]),
        ):
            if members:
                values[name] = max(body.agreement for body in members)
        return values

    @cached_property
    def by_spread(self) -> dict[float, list[Grown]]:
        """The bodies with the person's map, by its spread; 0 is without a map."""
        spreads = sorted({body.run.spread for body in self.grown})
        return {a: [body for body in self.grown if body.run.spread == a and not body.run.turn] for a in spreads}

    def between_seeds(self, spread: float) -> float:
        """Mean correlation of the folds of bodies that differ in their imperfection alone; NaN for fewer than two."""
        pairs = combinations([body.folds for body in self.by_spread[spread]], 2)
        return float(np.mean([np.corrcoef(*pair)[0, 1] for pair in pairs] or [math.nan]))

    @property
    def least_spread(self) -> float | None:
        """The least spread at which the folds of every body, from every seed, stand where the person's do: more than
        in all controls, and against spins, the body before growth and its deepened sulci with p < 0.05; None if there
        is none, or a seed or a kind of control could not be grown within the limits of the solver."""
        n_seeds, controls = len({run.seed for run in self.plan.runs if not run.turn}), self.controls
        if len(controls) < 4:
            return None  # a control could not be grown
        for spread, bodies in self.by_spread.items():
            valid = [body for body in bodies if body.is_healthy and body.beats_controls]
            if spread and len(valid) == n_seeds and min(body.agreement for body in valid) > max(controls.values()):
                return spread
        return None

    @property
    def shown_spread(self) -> float:
        """The least spread, or the largest with a body if there is none."""
        return self.least_spread or max(spread for spread, bodies in self.by_spread.items() if bodies)

    @property
    def final_factors(self) -> Any:
        """Factors (N,) on the growth at its end that the solver applies at ``shown_spread``, 1 in the mean."""
        return 1 + HELD_FROM * (self.plan.target.map_values(self.shown_spread / HELD_FROM)[1] - 1)

    @property
    def sentence(self) -> str:
        """The result in one sentence."""
        largest_control, name = max(self.controls.values()), self.person.cortex.name
        if (spread := self.least_spread) is None:
            best = max(body.agreement for spread, bodies in self.by_spread.items() if spread for body in bodies)
            missing = f" {len(self.not_grown)} of {len(self.plan.runs)} runs are missing." if self.not_grown else ""
            return (
                f"No map that was tried makes this simulated cortex fold like {name} from every seed, clearly more "
                f"than all controls do: the heights of folds correlate by at most {best:.2f} (1 would be the same "
                f"folds), those of the controls by up to {largest_control:.2f}.{missing}"
            )
        values = [body.agreement for body in self.by_spread[spread]]
        thin_text = (
            f", and a cortex thinner there by {100 * self.plan.thin_crowns:.0f} %," if self.plan.thin_crowns else ","
        )
        return (
            f"Growth by a map made from the folds of {name}, with a standard deviation of {100 * spread:g} % of its "
            f"mean{thin_text} makes this simulated cortex fold partly like {name}: the heights of folds correlate by "
            f"{min(values):.2f} to {max(values):.2f} in {len(values)} runs (1 would be the same folds), and by at most "
            f"{largest_control:.2f} in all controls."
        )

    @property
    def not_grown(self) -> list[str]:
        """Names of the runs that have no result."""
        names = {body.run.name for body in self.grown}
        return [run.name for run in self.plan.runs if run.name not in names]

    @property
    def lines(self) -> list[str]:
        """What is printed: a line for each control and spread, and the result."""
        lines = [f"{name}: folds correlate with the person's by {value:.2f}" for name, value in self.controls.items()]
        for spread, bodies in self.by_spread.items():
            if spread and bodies:
                values = ", ".join(f"{body.agreement:.2f}" for body in bodies)
                seeds_text = f"between seeds {self.between_seeds(spread):.2f}"
                lines.append(f"growth differs by {100 * spread:g} %: {values}; {seeds_text}")
        return [*lines, self.sentence]

    def to_dict(self) -> Row:
        """Everything but maps, as plain values for JSON."""
        plan = self.plan
        content = {
            "subject": self.person.cortex.name,
            "hemi": self.person.cortex.hemi,
            "fold_degree": plan.target.fold_degree,
            "map_degree": plan.target.map_degree,
            "cortical_thickness_mm": plan.thickness,
            "radius_mm": RADIUS,
            "unfold": LEVEL,
            "growth": plan.growth,
            "thin_crowns": plan.thin_crowns,
            "controls": self.controls,
            "between_seeds": {f"{spread:g}": self.between_seeds(spread) for spread in self.by_spread},
            "least_heterogeneity": self.least_spread,
            "result": self.sentence,
            "not_grown": self.not_grown,
            "runs": [body.row() for body in self.grown],
        }
        return json_value(content)


def person_of(plan: Plan) -> Measures:
    """The person, measured as the grown bodies are."""
    return measure(plan.cortex, accuracy="draft")


def result_of(
    plan: Plan, person: Measures, out: Path, applied: Mapping[str, float], *, spins: int, progress: Progress = logged
) -> Inference:
    """Compare each body that was grown and measured in a folder with the person.

    Raises
    ------
    NothingToDo
        If none could be grown.
    """
    done_names = list[str]()

    def compared(run: InferenceRun) -> Grown:
        folder = out / RUNS_FOLDER / run.name
        (measures,) = read_analysis(folder / "analysis")
        named = replace(measures, cortex=replace(measures.cortex, name=run.name))
        comparison = compare_with_person(person, named, LEVEL, names=(person.cortex.name, run.name), spins=spins)
        health = read_health(folder / "simulation")
        done_names.append(run.name)
        progress(len(done_names) / len(plan.runs), run.name)
        return Grown(run, applied[run.name], comparison, health["healthy"], tuple(health["warnings"]))

    runs = [run for run in plan.runs if read_record(out / "records" / f"{run.name}.json").get("results")]
    grown = run_parallel(*(partial(compared, run) for run in runs))
    if not any(body.run.spread and not body.run.turn for body in grown):
        raise NothingToDo(f"{out}: no body with a map could be grown; the logs there say why.")
    return Inference(plan, person, tuple(grown))


def write_result(
    inference: Inference, out: Path, *, report: Callable[[Inference, Path], object] | Literal[False] = False
) -> Path:
    """Write ``out/result`` completely or not at all: runs.tsv, inference.json, the map of the least spread at which all
    agree (or of the largest) at the person's vertices, and the page; return the path of the page."""
    plan = inference.plan
    with atomic_folder(out / "result") as folder:
        write_table(folder / "runs.tsv", (), [body.row() for body in inference.grown])
        write_values(plan, inference.final_factors, folder / f"{plan.cortex.hemi}.growth_map")
        write_json(folder / "inference.json", inference.to_dict())
        if report:
            report(inference, folder)
    return out / "result" / "report.html"
