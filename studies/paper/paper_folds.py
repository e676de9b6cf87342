"""Figs. 5, 6 and 7 of Razavi et al. (2015) from simulations: pictures of the folds and the table of their numbers.

The paper gives neither the growth nor the scale of its pictures. Our pictures have one scale per figure and growths
that we chose; the first is at most 0.06 beyond that of the first wrinkles by linear stability.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from morphofold.report.pictures.pixel_canvas import png_bytes
from morphofold.sim.run import Simulation
from morphofold.studies.folds.fold_measures import COLUMN_TEXTS, Row, fold_rows
from morphofold.studies.folds.fold_pictures import DISPLACEMENT, Panel, displaced, picture, row_limits
from morphofold.studies.runs import Runs, run_record
from morphofold.tables import write_table

#: growths at which all folds are written; 1 is the reference of displacement and height
STAGE_GROWTHS = (1.0, 1.2, 1.25, 1.3, 1.35, 1.4, 1.45, 1.5, 1.6, 1.8, 2.0)
FIG5 = ((1.25, 1.35, 1.5), (1.6, 1.8, 2.0))
OTHER_SEEDS = (1, 2)  # of imperfections that are grown as octants, for the numbers alone; the pictures have seed 0


@dataclass(frozen=True)
class Column:
    """One body of a figure: its built-in scene, its title, and the growth of its three pictures.

    The middle columns of Figs. 6 and 7 show the body of Fig. 5, which is grown once for all three figures.
    """

    scene: str
    title: str
    growths: tuple[float, float, float]


FIG6 = (
    Column("fig6-thin", "thin, T/C = 1/50", (1.25, 1.6, 2.0)),
    Column("fig5", "normal, T/C = 2/50", (1.25, 1.6, 2.0)),
    Column("fig6-thick", "thick, T/C = 3/50", (1.25, 1.6, 2.0)),
)
FIG7 = (
    Column("fig7-ratio1", "cortex : core = 1 : 1", (1.35, 1.6, 2.0)),
    Column("fig5", "2 : 1", (1.25, 1.6, 2.0)),
    Column("fig7-ratio4", "4 : 1", (1.2, 1.6, 2.0)),
)


def reproduce_fig5(folder: Path, runs: Runs) -> dict[str, Any]:
    """Write fig5.png and fig5.tsv into ``folder``; returns their entry for an index."""
    simulation = grow_scene("fig5", runs)
    panel_letters = iter("abcdef")
    panels = [[displaced(simulation, g, f"({next(panel_letters)})  g = {g:.2f}") for g in row] for row in FIG5]
    return {
        "shows": "a bilayer sphere that folds; the outer surface is seen along the axis of the simulated half",
        **_write("fig5", folder, runs, panels, (), [simulation]),
        "parameters": {"thickness_mm": 2, "outer_radius_mm": 50, "mu_ratio": 2, "growth": [g for r in FIG5 for g in r]},
    }


def reproduce_fig6(folder: Path, runs: Runs) -> dict[str, Any]:
    """Write fig6.png and fig6.tsv into ``folder``; returns their entry for an index."""
    return {
        "shows": "folds of a thin, a normal and a thick cortex at three growths, with the view of fig5",
        **_columns("fig6", folder, runs, FIG6),
        "parameters": {"thickness_mm": [1, 2, 3], "outer_radius_mm": 50, "mu_ratio": 2},
    }


def reproduce_fig7(folder: Path, runs: Runs) -> dict[str, Any]:
    """Write fig7.png and fig7.tsv into ``folder``; returns their entry for an index."""
    return {
        "shows": "folds of a cortex as stiff as the core (shear moduli), twice and four times as stiff, at three "
        "growths; the first is soon after each began to fold; with the view of fig5",
        **_columns("fig7", folder, runs, FIG7),
        "parameters": {"thickness_mm": 2, "outer_radius_mm": 50, "mu_ratio": [1, 2, 4]},
    }


def _columns(figure_name: str, folder: Path, runs: Runs, columns: Sequence[Column]) -> dict[str, Any]:
    simulations = [grow_scene(column.scene, runs) for column in columns]
    panels = [[displaced(run, column.growths[row]) for run, column in zip(simulations, columns)] for row in range(3)]
    return _write(figure_name, folder, runs, panels, [column.title for column in columns], simulations)


def grow_scene(scene_name: str, runs: Runs) -> Simulation:
    stages = drawn_stages(scene_name) if runs.draft else STAGE_GROWTHS
    return runs.grow(scene_name, scene_name, [f"output.stages={list(stages)}", "output.volume=false"])


def drawn_stages(scene_name: str) -> tuple[float, ...]:
    """The growths of a scene's pictures, and 1, in ascending order."""
    column_growths = {g for column in (*FIG6, *FIG7) if column.scene == scene_name for g in column.growths}
    return tuple(sorted({1.0, *column_growths, *(g for row in FIG5 for g in row if scene_name == "fig5")}))


def _write(
    figure_name: str,
    folder: Path,
    runs: Runs,
    panels: Sequence[Sequence[Panel]],
    column_titles: Sequence[str],
    simulations: Sequence[Simulation],
) -> dict[str, Any]:
    """Write the picture and the table of a figure; returns their entry for an index."""
    colour_limits = [row_limits(panel_row) for panel_row in panels]
    limits_text = ", ".join(f"{highest:g}" for _, highest in colour_limits)
    (folder / f"{figure_name}.png").write_bytes(png_bytes(picture(panels, DISPLACEMENT, colour_limits, column_titles)))
    rows: list[Row] = []
    for simulation in simulations:
        rows += runs.once(f"measure the folds of {simulation.scene.name}", partial(fold_rows, simulation))
    write_table(folder / f"{figure_name}.tsv", list(rows[0]), rows)
    seed_rows = [row for simulation in simulations for row in _rows_of_other_seeds(simulation.scene.name, runs)]
    write_table(folder / f"{figure_name}-seeds.tsv", list(seed_rows[0]), seed_rows)
    return {
        "files": [f"{figure_name}.png", f"{figure_name}.tsv", f"{figure_name}-seeds.tsv"],
        "columns": COLUMN_TEXTS,
        "limits": f"one scale, with a scale bar; colours of a row from 0 to {limits_text} mm",
        "simulations": [run_record(simulation) for simulation in simulations],
    }


def _rows_of_other_seeds(scene_name: str, runs: Runs) -> list[Row]:
    settings = [f"output.stages={list(drawn_stages(scene_name))}", "output.volume=false", "geometry.portion=octant"]
    rows: list[Row] = []
    for seed in OTHER_SEEDS:
        run_name = f"{scene_name}-octant-seed-{seed}"
        simulation = runs.grow(run_name, scene_name, [*settings, f"effects.perturbation.seed={seed}"])
        folds = runs.once(f"measure the folds of {run_name}", partial(fold_rows, simulation))
        rows += [{"seed": seed, **row} for row in folds]
    return rows
