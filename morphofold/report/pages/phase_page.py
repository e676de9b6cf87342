"""The page of a sweep: phase diagrams with theory, pial surfaces in the same order, numbers, failures.

Sentences are in ``templates/phases.html``.
"""

from __future__ import annotations

import math
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from morphofold import geometry
from morphofold.cohort.phases import Phases, RunResult
from morphofold.io import read_surface
from morphofold.progress import Progress, silent
from morphofold.quantities import Quantity
from morphofold.report.pages.templates import picture_entry, write_page
from morphofold.report.pictures.surfaces import extent
from morphofold.report.plots import phase_plots as plots
from morphofold.report.plots.line_plots import save
from morphofold.sim.scene import LEVELS
from morphofold.surface import Surface

MOST_ROWS = 400  # of the table of numbers and of the table of failures


def phase_report(phases: Phases, folder: Path, progress: Progress = silent) -> Path:
    """Write ``folder/report.html`` and ``folder/figures/`` of a sweep; return the path of the page."""
    (folder / "figures").mkdir(parents=True, exist_ok=True)
    measures, diagrams = plots.shown_of(phases), []
    for k, shown in enumerate(measures):
        progress(0.5 * k / len(measures), shown.label)
        if plots.values_of(phases.runs, shown.key):
            diagrams += _write_diagrams(phases, shown, folder / "figures")
    progress(0.5, "surfaces")
    grid, done = phases.grid, [run for run in phases.runs if not run.reason]
    levels = {scene.accuracy.level for scene in grid.scenes.values() if scene.geometry.shape != "mesh"}
    path = write_page(
        folder / "report.html",
        "phases.html",
        title=f"Sweep of {grid.name}",
        phases=phases,
        grid=grid,
        plots=plots,
        shape=_geometry_shape(phases),
        levels=[level for level in LEVELS if level in levels],
        measures=measures,
        done=done,
        failed=[run for run in phases.runs if run.reason],
        unhealthy=[run for run in phases.runs if run.warnings],
        without={shown: [run for run in done if shown.key not in run.measures] for shown in measures},
        diagrams=diagrams,
        pictures=_write_thumbnails(phases, folder / "figures"),
        known=any(math.isfinite(theory.g_crit) for theory in phases.theory.values()),
        unknown=Counter(theory.reason for theory in phases.theory.values() if math.isnan(theory.g_crit)),
        ratios=_wavelength_ratios(phases),
        most=MOST_ROWS,
    )
    progress(1.0, "done")
    return path


def _wavelength_ratios(phases: Phases) -> list[float]:
    """Measured wavelength over that of theory at each point where both are known."""
    ratios = []
    for at in phases.grid.places:
        ratio = plots.cell(phases, at, plots.WAVELENGTH_KEY).mean / phases.theory[at].wavelength
        ratios += [ratio] if math.isfinite(ratio) else []
    return ratios


# diagrams ----------------------------------------------------------------------------------------------------


def _write_diagrams(phases: Phases, shown: Quantity, folder: Path) -> list[dict[str, Any]]:
    """Write the diagrams of a measure; return an entry for each. Empty if only the seed is varied."""
    axes, entries = phases.grid.axes, []
    if len(axes) == 1:
        return [_saved(plots.curve(phases, shown), folder / f"{shown.key}.png", f"{shown.label} over {axes[0].label}")]
    for k, others in enumerate(plots.slices(phases) if axes else (), start=1):
        title = f"{shown.label} over {axes[0].label} and {axes[1].label}{_at(phases, others)}"
        path = folder / (f"{shown.key}-{k}.png" if others else f"{shown.key}.png")
        entries.append(_saved(plots.diagram(phases, shown, others), path, title))
    return entries


def _at(phases: Phases, others: tuple[int, ...]) -> str:
    """Where a diagram lies on the third and further axes, as the end of a title."""
    return f" at {plots.fixed_parameters_text(phases, others)}" if others else ""


def _saved(figure: Any, path: Path, title: str) -> dict[str, Any]:
    save(figure, path)
    return picture_entry(path, path.read_bytes(), title)


# surfaces ----------------------------------------------------------------------------------------------------


def _geometry_shape(phases: Phases) -> str:
    return phases.grid.points[0].scene.geometry.shape


def _write_thumbnails(phases: Phases, folder: Path) -> list[dict[str, Any]]:
    """Write thumbnails of the first seed, pial surfaces or sections of strips: one grid per diagram, all at one
    scale."""
    first, shape = {at: phases.at[at][0] for at in phases.grid.places}, _geometry_shape(phases)
    view = "top" if shape in ("patch", "strip") else "lateral"
    largest = max((_surface_extent(run, view) for run in first.values()), default=0.0)
    entries = []
    for k, others in enumerate(plots.slices(phases) if largest else (), start=1):
        shown = {
            at: _drawn_surface(run) or ("failed" if run.reason else "no surface")
            for at, run in first.items()
            if at[2:] == others
        }
        path = folder / (f"surfaces-{k}.png" if others else "surfaces.png")
        title = ("Sections" if shape == "strip" else "Pial surfaces") + _at(phases, others)
        entries.append(_saved(plots.thumbnails(phases, shown, view, largest), path, title))
    return entries


def _surface_extent(run: RunResult, view: str) -> float:
    """Larger side of a surface in the view [mm]; 0 for a run without a surface."""
    surface = _drawn_surface(run)
    return 0.0 if surface is None else float(extent(surface, view).max())


def _drawn_surface(run: RunResult) -> Surface | None:
    """The pial surface of a run, or the section of a strip; None if it cannot be read."""
    if run.pial is None:
        return None
    try:
        pial = read_surface(run.pial)
        if run.point.scene.geometry.shape != "strip":
            return pial
        return section(pial, read_surface(run.pial.with_name(run.pial.name.replace("pial", "white"))))
    except (OSError, ValueError):
        return None


def section(pial: Surface, white: Surface) -> Surface:
    """The cortex of a strip from the side, in the plane z = 0, with the strip's x to the right and z up.

    It lies between the edges of both surfaces at the least y.
    """
    edges, y = geometry.edges(pial.faces), pial.verts[:, 1]
    a, b = edges[np.isclose(y[edges], y.min(), atol=1e-3 * np.ptp(y)).all(axis=1)].T
    n = len(y)
    faces = np.concatenate([np.stack([a, b, b + n], axis=1), np.stack([a, b + n, a + n], axis=1)])
    verts = np.concatenate([pial.verts, white.verts])[:, [0, 2, 1]]
    verts[:, 2] = 0.0
    u, v = (verts[faces[:, k]] - verts[faces[:, 0]] for k in (1, 2))
    below = u[:, 0] * v[:, 1] < u[:, 1] * v[:, 0]
    faces[below] = faces[below][:, [0, 2, 1]]  # so that all faces point up
    return Surface(*geometry.in_use(verts, faces)[1:])
