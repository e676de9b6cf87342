"""The runs of an inference: bodies without a map, with the person's map at each spread, and with it turned away.

In go a subject and spreads of growth, out come scenes, as the tasks of a sweep, and their growth maps in files;
``inference`` reads their results.
"""

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from morphofold.errors import ImpossibleBody, Mismatch, MissingPart
from morphofold.group.sweep import Run
from morphofold.group.task_records import TaskFolder
from morphofold.inference.growth_target import Target, target_of, weighted_mean_and_sd
from morphofold.io import read_cortex, write_morph
from morphofold.io.json_files import write_json
from morphofold.mesh_quality.repair import unfoldable
from morphofold.progress_callbacks import Progress, logged
from morphofold.sim.hemisphere.subject_maps import THICKEST, Subject, subject_of_cortex
from morphofold.sim.scene import Scene
from morphofold.sim.scene.scene_files import load_scene
from morphofold.spheres.spins import rotations
from morphofold.surface import Cortex
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
    """What is to be grown for a person, and from what.

    Attributes
    ----------
    subject : Subject
        The person's white surface, repaired, and what it unfolds to.
    cortex : Cortex
        The person, with pial and sphere.
    target : Target
        The person's folds.
    thickness : float
        Of the cortex that grows [mm], on a body with the area of a sphere of 50 mm.
    growth : float
        Final growth stretch g.
    runs : tuple of InferenceRun
    settings : tuple of str
        Settings of the scene that all runs share.
    thin_crowns : float
        Standard deviation of the thickness over its mean, thinner where a gyrus is to be; 0 is even.
    """

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
    progress: Progress = logged,
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

    Raises
    ------
    FileNotFoundError, ValueError
        If the subject cannot be read or unfolded, lacks a sphere (``MissingPart``), needs different repairs with and
        without pial (``Mismatch``), or takes no cortex of 2.5 mm (``ImpossibleBody``).
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
        raise ImpossibleBody(
            f"{cortex.called}: unfolded, it bends too sharply for a cortex of {THINNEST_T:g} mm; {thickest:.2g} mm "
            "would fit. Check the surface, or leave out --thin-crowns."
        )
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
    write_values(plan, values, path)
    return path, HELD_FROM * weighted_mean_and_sd(as_applied, plan.target.weights)[1]


def write_values(plan: Plan, values: Any, path: Path) -> None:
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
            write_values(plan, plan.target.map_values(-plan.thin_crowns, run.rotation)[0], thickness_path)
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
