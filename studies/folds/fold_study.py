"""How far simulated folds can be trusted: the same bodies grown on several meshes and with several imperfections.

``python3 run.py bench folds`` grows them and writes the tables. ``python -m morphofold.studies.folds.fold_study OUT
PAGE`` writes the tables into the Markdown page PAGE.
"""

import platform
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from itertools import product
from pathlib import Path
from typing import Any

from morphofold import __version__
from morphofold.errors import DoesNotApply, MissingPart, NamedTwice, NothingToDo, OptionsClash, OutOfRange, UnknownName
from morphofold.io.json_files import write_json
from morphofold.shapes import even_directions
from morphofold.sim.run import Simulation
from morphofold.sim.scene import LEVELS
from morphofold.sim.scene.scene_files import load_scene
from morphofold.studies.folds.fold_agreement import (
    N_DIRECTIONS,
    SCENES_BY_LAW,
    RadiiByRun,
    convergence_rows,
    outer_radius,
    slope_rows,
    spread_rows,
)
from morphofold.studies.folds.fold_measures import COLUMN_TEXTS, Row, fold_rows
from morphofold.studies.index_schemas import write_tables
from morphofold.studies.runs import Runs, run_record

LARGEST_GROWTH = 4.0

#: meaning of the columns of the tables, in addition to those of the folds
MORE_COLUMNS = {
    "seed": "of the imperfection (effects.perturbation.seed)",
    "edge_mm": "largest surface edge of the level",
    "correlation": "Pearson correlation of the outer radius of coarser and finer mesh at one growth, over "
    f"{N_DIRECTIONS:,} directions of a Fibonacci lattice on the whole sphere, including the mirrored part; the "
    "radius is the first hit from outside, exact on the triangles",
    "folded": "1 if both meshes are folded (height rms at least a tenth of T)",
    "*_change_percent": "finer over coarser, less 1",
    "*_sd": "standard deviation over seeds, n - 1; none if a seed is not folded",
    "slope, standard_error, intercept, r": "least squares on the cortical thickness T before growth, over all seeds "
    "of a level: mm per mm, mm, mm, correlation",
    "theory_*": "the same line through the wavelengths of the first wrinkles by linear stability",
    "film_*": "the same line through 2 pi T (mu ratio / 3)^(1/3)",
}


@dataclass(frozen=True)
class Study:
    """What is grown: every scene at every level with the first seed, and at one level also with the other seeds.

    Attributes
    ----------
    scenes : tuple of str
        Built-in names or TOML files; spheres with an imperfection.
    levels : tuple of str
        Levels of accuracy, in any order.
    seeds : tuple of int
        Seeds of the imperfection; the meshes are compared at the first seed.
    portion : str
        Part of the sphere that is simulated.
    growths : tuple of float
        Growth stretches at which folds are measured; the largest is the final one.
    """

    scenes: tuple[str, ...]
    levels: tuple[str, ...]
    seeds: tuple[int, ...]
    portion: str
    growths: tuple[float, ...]

    @property
    def ordered(self) -> tuple[str, ...]:
        """The levels from coarse to fine."""
        return tuple(sorted(self.levels, key=lambda level: -LEVELS[level]))

    @property
    def repeated(self) -> str:
        """The level that is grown with every seed: the second finest, or the only one."""
        return self.ordered[-2:][0]


@dataclass(frozen=True)
class Planned:
    """One run."""

    name: str
    scene_source: str
    scene: str
    level: str
    seed: int
    settings: tuple[str, ...]


def planned(study: Study) -> list[Planned]:
    """The runs of a study, coarse ones first. Writes nothing.

    Raises
    ------
    ValueError, FileNotFoundError
        If the study has nothing to grow, has a repeated or unknown name, or has a scene whose folds can't be
        compared: not a sphere, no imperfection, or a mesh that no level changes.
    """
    _check(study)
    name_by_source = {source: _comparable(source) for source in study.scenes}
    repeated_names = {name for name in name_by_source.values() if list(name_by_source.values()).count(name) > 1}
    if repeated_names:
        raise NamedTwice(f"scenes: {min(repeated_names)} is the name of two scenes; rename one.")
    shared_settings = (
        f"geometry.portion={study.portion}",
        f"growth.final={max(study.growths)}",
        "output.volume=false",
        f"output.stages={sorted({1.0, *study.growths})}",
    )
    planned_runs = []
    for level, (source, scene_name) in product(study.ordered, name_by_source.items()):
        for seed in study.seeds if level == study.repeated else study.seeds[:1]:
            settings = (*shared_settings, f"accuracy.level={level}", f"effects.perturbation.seed={seed}")
            name = f"{scene_name}-{study.portion}-{level}-seed{seed}"
            planned_runs.append(Planned(name, source, scene_name, level, seed, settings))
            load_scene(source, settings)  # reports errors now instead of after an hour
    return planned_runs


def _check(study: Study) -> None:
    for option, values, example_text in (
        ("scenes", study.scenes, "fig5"),
        ("levels", study.levels, "draft,standard"),
        ("seeds", study.seeds, "0,1,2"),
        ("growth", study.growths, "1.5,2.0"),
    ):
        if not values:
            raise NothingToDo(f"{option}: the list is empty; name at least one, such as {example_text}.")
        if len(set(values)) < len(values):
            raise NamedTwice(f"{option}: {','.join(map(str, values))} names one item twice; name it once.")
    for level in study.levels:
        if level not in LEVELS:
            raise UnknownName(f"levels: {level!r} is not a level of accuracy; the levels are {', '.join(LEVELS)}.")
    for g in study.growths:
        if not 1 < g <= LARGEST_GROWTH:
            raise OutOfRange(f"growth: {g:g} is not above 1 and at most {LARGEST_GROWTH:g}, the range of folds.")
        if round(g, 2) != g:
            raise OutOfRange(f"growth: {g:g} has more than two decimals, which names of stages have; round it.")


def _comparable(scene_source: str) -> str:
    """Name of a scene; refused unless its folds can be compared between levels and seeds."""
    scene = load_scene(scene_source)
    if scene.geometry.shape != "sphere":
        raise DoesNotApply(
            f"{scene.name}: is not a sphere but a body of shape {scene.geometry.shape!r}; name a sphere."
        )
    if "perturbation" not in scene.effects:
        raise MissingPart(f"{scene.name}: has no [effects.perturbation], so no seed changes its folds; add one.")
    if scene.accuracy.edge is not None:
        raise OptionsClash(
            f"{scene.name}: sets accuracy.edge = {scene.accuracy.edge:g}, so every level has the same mesh; remove it."
        )
    return scene.name


def run_study(study: Study, folder: Path, runs: Runs) -> dict[str, Any]:
    """Grow and measure all, and write the tables and ``summary.json`` into ``folder``; returns the summary.

    A table without data (a single level, a single seed, no three thicknesses) is not written, and ``left_out`` gives
    the reason.
    """
    planned_runs = planned(study)
    directions = even_directions(N_DIRECTIONS)
    rows: list[Row] = []
    radii_by_run: RadiiByRun = {}
    simulations = []
    for run_number, run in enumerate(planned_runs, start=1):
        simulation = runs.grow(run.name, run.scene_source, run.settings)
        task_label = f"measure {run.name} ({run_number} of {len(planned_runs)})"
        rows += [_of_run(run, simulation, row) for row in runs.once(task_label, partial(fold_rows, simulation))]
        if run.seed == study.seeds[0]:
            radii_by_run |= {
                (run.scene, run.level, run.seed, g): outer_radius(simulation.cortex(g).pial, directions)
                for g in simulation.stages
                if g > 1
            }
        simulations.append({**run_record(simulation), "seed": run.seed})
    return _write(study, folder, rows, radii_by_run, simulations)


def _of_run(run: Planned, simulation: Simulation, row: Row) -> Row:
    """A row of folds with its seed and its mesh."""
    run_info = {"scene": run.scene, "level": run.level, "seed": run.seed, "edge_mm": simulation.scene.edge}
    return {**run_info, "growth": row["growth"], **{key: value for key, value in row.items() if key not in run_info}}


def _write(
    study: Study, folder: Path, rows: Sequence[Row], radii_by_run: RadiiByRun, simulations: Sequence[dict[str, Any]]
) -> dict[str, Any]:
    """The tables of a study and ``summary.json``."""
    scene_rank = {scene: scene_index for scene_index, scene in enumerate(dict.fromkeys(row["scene"] for row in rows))}
    rows = sorted(rows, key=lambda r: (scene_rank[r["scene"]], study.ordered.index(r["level"]), r["seed"], r["growth"]))
    scenes_text = " or ".join(", ".join(scenes) for scenes in SCENES_BY_LAW)
    tables: dict[str, tuple[Sequence[Row], str]] = {
        "folds": (rows, ""),
        "convergence": (
            convergence_rows(rows, radii_by_run, study.ordered, study.seeds[0]),
            f"meshes can't be compared: the only level is {study.repeated}",
        ),
        "spread": (
            spread_rows(rows, study.repeated) if len(study.seeds) > 1 else [],
            f"there is no spread: the only seed is {study.seeds[0]}",
        ),
        "slope": (slope_rows(rows), f"there is no line through three thicknesses: that takes {scenes_text}"),
    }
    summary: dict[str, Any] = {
        "morphofold": __version__,
        "shows": "folds of the same bodies on several meshes, and with several seeds of their imperfection",
        "python": platform.python_version(),
        **{package: version(package) for package in ("numpy", "scipy", "numba")},
        "parameters": {
            "scenes": list(scene_rank),
            "levels": list(study.ordered),
            "seeds": list(study.seeds),
            "all_seeds_at_level": study.repeated,
            "portion": study.portion,
            "growth": sorted(study.growths),
            "directions": N_DIRECTIONS,
        },
        **write_tables(folder, tables),
        "columns": {**COLUMN_TEXTS, **MORE_COLUMNS},
        "lengths": "mm; only ratios matter",
        "warnings": [f"{run['folder'].rpartition('/')[2]}: {text}" for run in simulations for text in run["warnings"]],
        "simulations": list(simulations),
    }
    write_json(folder / "summary.json", summary)
    return summary


if __name__ == "__main__":
    from morphofold.studies.folds.fold_page import write_page

    print(*write_page(Path(sys.argv[1]), Path(sys.argv[2])))
