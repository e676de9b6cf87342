"""The page of a sweep: phase diagrams with theory, pial surfaces in the same order, numbers, failures.

In go the phases of :mod:`morphofold.group.sweep`, out come ``report.html`` and ``figures/``; ``sweep`` calls it.
Sentences are in ``templates/phases.html``.
"""

import math
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from morphofold import geometry
from morphofold.group.sweep import Phases, RunResult
from morphofold.group_pages import phase_plots as plots
from morphofold.io import read_surface
from morphofold.progress_callbacks import Progress, logged
from morphofold.report.pages.page_writer import Pictures, picture_entry, write_page
from morphofold.report.pictures.surfaces import extent
from morphofold.report.plots.figure_style import save
from morphofold.sim.scene import LEVELS
from morphofold.surface import Surface


def phase_report(phases: Phases, folder: Path, progress: Progress = logged) -> Path:
    """Write ``folder/report.html`` and ``folder/figures/`` of a sweep; return the path of the page."""
    figures_folder, grid = folder / "figures", phases.grid
    figures_folder.mkdir(parents=True, exist_ok=True)
    measures, diagrams = plots.plotted_measures(phases), []
    for k, measure in enumerate(measures):
        progress(0.5 * k / len(measures), measure.label)
        if grid.axes and plots.values_of(phases.runs, measure.key):
            title = f"{measure.label} over {' and '.join(axis.label for axis in grid.axes[:2])}"
            draw = lambda index, q=measure: plots.diagram(phases, q, index) if grid.axes[1:] else plots.curve(phases, q)
            diagrams += _write_slices(phases, figures_folder, measure.key, title, draw)
    progress(0.5, "surfaces")
    accuracy_levels = {scene.accuracy.level for scene in grid.scenes.values() if scene.geometry.shape != "mesh"}
    mean_wavelength = lambda index: plots.cell(phases, index, plots.WAVELENGTH_KEY).mean
    wavelength_ratios = [mean_wavelength(index) / theory.wavelength for index, theory in phases.theory.items()]
    page_file = write_page(
        folder / "report.html",
        "phases.html",
        title=f"Sweep of {grid.name}",
        phases=phases,
        plots=plots,
        levels=[level for level in LEVELS if level in accuracy_levels],
        measures=measures,
        diagrams=diagrams,
        pictures=_write_thumbnails(phases, figures_folder),
        known=any(math.isfinite(theory.g_crit) for theory in phases.theory.values()),
        unknown=Counter(theory.reason for theory in phases.theory.values() if math.isnan(theory.g_crit)),
        ratios=[*filter(math.isfinite, wavelength_ratios)],
    )
    progress(1.0, "done")
    return page_file


# pictures ----------------------------------------------------------------------------------------------------


def _write_slices(
    phases: Phases, folder: Path, file_stem: str, title: str, draw_slice: Callable[[plots.GridIndex], Any]
) -> Pictures:
    """Write the figure that ``draw_slice`` makes at each place on axes from the third on; return an entry for each."""
    entries = []
    for k, slice_index in enumerate(plots.slices(phases), start=1):
        figure_file = folder / (f"{file_stem}-{k}.png" if slice_index else f"{file_stem}.png")
        save(draw_slice(slice_index), figure_file)
        slice_title = title + plots.fixed_parameters_text(phases, slice_index)
        entries.append(picture_entry(figure_file, figure_file.read_bytes(), slice_title))
    return entries


def _write_thumbnails(phases: Phases, folder: Path) -> Pictures:
    """Write thumbnails of the first seed, pial surfaces or sections of strips: one grid per diagram, all at one
    scale."""
    surface_at = {grid_index: _drawn_surface(phases.runs_at[grid_index][0]) for grid_index in phases.runs_at}
    shape = phases.grid.points[0].scene.geometry.shape
    view = "top" if shape in ("patch", "strip") else "lateral"
    largest = max((extent(pial, view).max() for pial in surface_at.values() if isinstance(pial, Surface)), default=0.0)

    def draw(slice_index: plots.GridIndex) -> Any:
        surfaces = {grid_index: surface for grid_index, surface in surface_at.items() if grid_index[2:] == slice_index}
        return plots.thumbnails(phases, surfaces, view, largest)

    title = "Sections" if shape == "strip" else "Pial surfaces"
    return _write_slices(phases, folder, "surfaces", title, draw) if largest else []


def _drawn_surface(run: RunResult) -> Surface | str:
    """The pial surface of a run, or the section of a strip; a text if it cannot be read."""
    missing_text = "failed" if run.reason else "no surface"
    if run.pial is None:
        return missing_text
    try:
        pial = read_surface(run.pial)
        if run.point.scene.geometry.shape != "strip":
            return pial
        return section(pial, read_surface(run.pial.with_name(run.pial.name.replace("pial", "white"))))
    except (OSError, ValueError):
        return missing_text


def section(pial: Surface, white: Surface) -> Surface:
    """The cortex of a strip from the side, in the plane z = 0, with the strip's x to the right and z up.

    It lies between the edges of both surfaces at the least y.
    """
    edges, y = geometry.edges(pial.faces), pial.verts[:, 1]
    start, end = edges[np.isclose(y[edges], y.min(), atol=1e-3 * np.ptp(y)).all(axis=1)].T
    n = len(y)
    faces = np.concatenate([np.stack([start, end, end + n], axis=1), np.stack([start, end + n, start + n], axis=1)])
    verts = np.concatenate([pial.verts, white.verts])[:, [0, 2, 1]]
    verts[:, 2] = 0.0
    is_downward = geometry.face_vectors(verts, faces)[:, 2] < 0
    faces[is_downward] = faces[is_downward][:, [0, 2, 1]]  # so that all faces point up
    return Surface(*geometry.in_use(verts, faces)[1:])
