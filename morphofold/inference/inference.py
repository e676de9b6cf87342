"""Infer a growth map with which a body folds where a person does, beside all its controls.

In go a subject and spreads of growth, out come runs: without a map, with the person's map at each spread, and with the
map turned away from the person, each from several imperfections; and the least spread at which the folds stand where
the person's do. Runs are grown and measured as those of a sweep; :mod:`morphofold.cli.infer` calls this.
"""

import json
import math
from collections.abc import Callable, Mapping, Sequence
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
from morphofold.errors import ImpossibleBody, Mismatch, MissingPart, NothingToDo
from morphofold.group.sweep import RUNS_FOLDER, Run
from morphofold.group.task_records import TaskFolder, read_record
from morphofold.inference.growth_target import Target, target_of, weighted_mean_and_sd
from morphofold.io import atomic_folder, read_cortex, write_morph
from morphofold.io.json_files import write_json
from morphofold.mesh_quality.repair import unfoldable
from morphofold.progress_callbacks import Progress, silent
from morphofold.quantities import RELIEF
from morphofold.results import read_analysis
from morphofold.sim.hemisphere.subject_maps import THICKEST, Subject, subject_of_cortex
from morphofold.sim.output.stage_records import read_health
from morphofold.sim.scene import Scene
from morphofold.sim.scene.scene_files import load_scene
from morphofold.spheres.spins import rotations
from morphofold.surface import Cortex
from morphofold.tables import write_table
from morphofold.threads import run_parallel
from morphofold.unfolding.unfold import unfolding_numbers

SCENE = "hemisphere-soft"
LEVEL, RADIUS = 0.08, 50.0  # of unfolding, and of the body [mm]
THINNEST_T, THICKEST_T = 2.5, 4.0  # thickness of the cortex of such a body [mm]: a thicker one flares without a skull
#: final growth, by thickness [mm]: thicker ones fold later
FINAL_GROWTH = {2.5: 1.75, 3.5: 1.85, 4.0: 1.9}
PATIENCE = 2.0  # of the last stage, so that most bodies come to rest
HELD_FROM = 0.5  # of the final growth: from there the differences of lengths stay, at twice the final spread
MAPS_FOLDER, PLAN_FILE = "maps", "plan.json"


@dataclass(frozen=True)
class InferenceRun:
    """A body to grow: the spread of its growth (0: no map), its seed, and the number of its map's turn (0: none)."""

    spread: float
    seed: int
    turn: int = 0

    @property
    def name(self) -> str:
        kind = f"turned{self.turn}-" if self.turn else ""
        return f"{kind}spread{100 * self.spread:g}-seed{self.seed}" if self.spread else f"even-seed{self.seed}"

    @property
    def rotation(self) -> Any:
        """That of its map (3, 3), None if it is not turned."""
        return rotations(self.turn, seed=1)[-1] if self.turn else None


@dataclass(frozen=True, eq=False)
class Plan:
    """What is to be grown for a person, and from what."""

    subject: Subject
    cortex: Cortex
    target: Target
    thickness: float
    growth: float
    runs: tuple[InferenceRun, ...]
    settings: tuple[str, ...]
    thin_crowns: float = 0.0


def make_plan(
    subject: Path,
    hemi: str,
    spreads: Sequence[float],
    *,
    seeds: int = 2,
    turns: int = 2,
    thin_crowns: float = 0.0,
    progress: Progress = silent,
) -> Plan:
    """Plan the runs for a hemisphere of a subject with a sphere.

    Parameters
    ----------
    spreads : sequence of float
        Standard deviations of the growth g - 1 over its mean, at the end of growth.
    seeds : int
        Imperfections from which each body is grown.
    turns : int
        Maps that are turned away from the person, at the largest spread.
    thin_crowns : float
        Standard deviation of the thickness, thinner where a gyrus is to be. This is against anatomy: crowns of people
        are thicker.
    """
    settings = (
        f"geometry.subject={subject.absolute()}",
        f"geometry.hemi={hemi}",
        f"geometry.unfold={LEVEL}",
        f"geometry.radius={RADIUS}",
        "geometry.held=hole",
        "output.volume=false",
    )
    mended = unfoldable(read_cortex(subject, hemi))
    cortex = mended.cortex
    if cortex.sphere is None:
        raise MissingPart(f"{cortex.called}: has no surf/{hemi}.sphere, on which bodies are compared. Add it.")
    progress(0.0, "unfolding")
    person = subject_of_cortex(load_scene(SCENE, settings).geometry)  # type: ignore[arg-type]
    if not np.array_equal(mended.source, person.mended.source):
        raise Mismatch(
            f"{cortex.called}: white and pial need different repairs. Repair them first (analyze says what)."
        )
    target = target_of(person, cortex.pial)
    most_over_mean = THICKEST if thin_crowns else 1.0  # of a thickness map
    thickest = min(THICKEST_T, unfolding_numbers(person.unfolding)["thickest_cortex_mm"] / most_over_mean)
    if thickest < THINNEST_T:
        raise ImpossibleBody(f"{cortex.called}: the unfolded surface takes no cortex of {THINNEST_T:g} mm.")
    thickness = math.floor(100 * float(np.clip(target.thickness(RADIUS), THINNEST_T, thickest))) / 100
    growth = round(float(np.interp(thickness, [*FINAL_GROWTH], [*FINAL_GROWTH.values()])), 2)
    each_seed = range(1, seeds + 1)
    runs = [InferenceRun(spread, seed) for spread in (0.0, *sorted(spreads)) for seed in each_seed]
    runs += [InferenceRun(max(spreads), 1, turn) for turn in range(1, turns + 1)]
    return Plan(person, cortex, target, thickness, growth, tuple(runs), settings, thin_crowns)


def write_map(plan: Plan, run: InferenceRun, folder: Path) -> tuple[Path, float]:
    """Write the growth map of a run, as FreeSurfer's "curv" and as GIFTI; its path, and the spread that is applied.

    The values are factors on the growth at ``HELD_FROM`` of it, where they have twice the spread.
    """
    path = folder / f"{plan.subject.mended.cortex.hemi}.{run.name.rpartition('-')[0]}"
    values, as_applied = plan.target.map_values(run.spread / HELD_FROM, run.rotation)
    _write_values(plan, values, path)
    return path, HELD_FROM * weighted_mean_and_sd(as_applied, plan.target.weights)[1]


def _write_values(plan: Plan, values: Any, path: Path) -> None:
    """Write values at the vertices of the person's files; those that repair left out have 1."""
    mended = plan.subject.mended
    whole = np.ones(mended.original.n_vertices)
    whole[mended.source] = values
    path.parent.mkdir(parents=True, exist_ok=True)
    write_morph(path, whole)
    write_morph(path.with_name(f"{path.name}.shape.gii"), whole)


def scene_of(plan: Plan, run: InferenceRun, folder: Path) -> tuple[Scene, float]:
    """The scene of a run, and the spread of growth that it applies; its maps are written to a folder."""
    settings = [
        *plan.settings,
        f"geometry.cortex_thickness={plan.thickness}",
        f"growth.final={plan.growth}",
        f"output.stages=[{plan.growth}]",
        f"output.patience={PATIENCE:g}",
        f"effects.perturbation.seed={run.seed}",
    ]
    applied = 0.0
    if run.spread:
        path, applied = write_map(plan, run, folder)
        degree, held_from = plan.target.map_degree, 1 + HELD_FROM * (plan.growth - 1)
        settings += [
            f"effects.growth_map.file={path}",
            f"effects.growth_map.degree={degree}",
            f"effects.growth_map.held_from={held_from:g}",
        ]
        if plan.thin_crowns:
            thickness_path = path.with_name(f"{path.name}-thickness")
            _write_values(plan, plan.target.map_values(-plan.thin_crowns, run.rotation)[0], thickness_path)
            settings.append(f'geometry.thickness_map={{file="{thickness_path}", degree={degree}}}')
    return load_scene(SCENE, settings), applied


def tasks_of(plan: Plan, out: Path, run_id: str, threads: int) -> tuple[list[Run], dict[str, float]]:
    """The runs as those of a sweep in a folder, and the spread that each applies, by name."""
    check_plan_file(plan, out)
    tasks, applied = [], {}
    for run in plan.runs:
        scene, applied[run.name] = scene_of(plan, run, out / MAPS_FOLDER)
        tasks.append(Run(TaskFolder(str(out), run.name, run_id), scene, threads, options={"accuracy": "draft"}))
    return tasks, applied


def check_plan_file(plan: Plan, out: Path) -> None:
    """Record in a folder whose inference it is; raise ``FileExistsError`` if it is that of another one."""
    whose = {"white": plan.cortex.called, "hemi": plan.cortex.hemi, "thin_crowns": plan.thin_crowns}
    file = out / PLAN_FILE
    if file.is_file() and json.loads(file.read_text("utf-8")) != whose:
        raise FileExistsError(f"{out}: is the inference of another subject, hemisphere or option. Name a new folder.")
    out.mkdir(parents=True, exist_ok=True)
    write_json(file, whose)


# results -----------------------------------------------------------------------------------------------------


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
    plan: Plan, person: Measures, out: Path, applied: Mapping[str, float], *, spins: int, progress: Progress = silent
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
        _write_values(plan, inference.final_factors, folder / f"{plan.cortex.hemi}.growth_map")
        write_json(folder / "inference.json", inference.to_dict())
        if report:
            report(inference, folder)
    return out / "result" / "report.html"
