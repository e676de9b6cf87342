"""The page of a sweep: phase diagrams with theory, pial surfaces in the same order, numbers, failures."""

from __future__ import annotations

import base64
import math
from pathlib import Path
from typing import Any

import numpy as np

from morphofold import geometry
from morphofold.cohort.phases import Phases, RunResult
from morphofold.io import read_surface
from morphofold.progress import Progress, silent
from morphofold.report.pages.templates import write_page
from morphofold.report.pictures.sheet import Picture, png_bytes
from morphofold.report.pictures.surfaces import extent, thumbnails
from morphofold.report.plots.line_plots import save
from morphofold.report.plots.phase_plots import (
    WAVELENGTH_KEY,
    Shown,
    axis_title,
    beyond,
    cell,
    curve,
    diagram,
    fixed_parameters_text,
    measured,
    shown_of,
    slices,
)
from morphofold.sim.scene import LEVELS
from morphofold.surface import Surface
from morphofold.words import number

MOST_ROWS = 400  # of the table of numbers and of the table of failures
MOSAIC_WIDTH_PX = 1520  # [px] of a picture of thumbnails
SURFACES_TITLE, SECTIONS_TITLE = "Pial surfaces", "Sections"


def phase_report(phases: Phases, folder: Path, progress: Progress = silent) -> Path:
    """Write ``folder/report.html`` and ``folder/figures/`` of a sweep; return the path of the page."""
    (folder / "figures").mkdir(parents=True, exist_ok=True)
    measures, diagrams = shown_of(phases), []
    for k, shown in enumerate(measures):
        progress(0.5 * k / len(measures), shown.label)
        if measured(phases, shown):
            diagrams += _write_diagrams(phases, shown, folder / "figures")
    progress(0.5, "surfaces")
    pictures = _write_thumbnails(phases, folder / "figures")
    failed = [run for run in phases.runs if run.reason]
    unhealthy = [run for run in phases.runs if run.warnings]
    path = write_page(
        folder / "report.html",
        "phases.html",
        title=f"Sweep of {phases.grid.name}",
        axes=phases.grid.axes,
        seeds=_seeds_text(phases),
        seeds_n=len(phases.grid.seeds),
        places=phases.grid.places,
        runs=phases.runs,
        done=len(phases.runs) - len(failed),
        diagrams=diagrams,
        pictures=pictures,
        surfaces=_thumbnails_title(phases),
        shown=measures,
        rows=[_table_row(phases, at) for at in phases.grid.places[:MOST_ROWS]],
        more=max(0, len(phases.grid.places) - MOST_ROWS),
        titles=[axis_title(phases, axis) for axis in phases.grid.axes],
        missing=missing(phases),
        theory=theory_words(phases),
        verdict=verdict(phases),
        failed=failed,
        unhealthy=unhealthy,
        most=MOST_ROWS,
        levels=_accuracy_levels(phases),
        shape=_geometry_shape(phases),
        known=_theory_is_known(phases),
        final=all(axis.key != "growth.final" for axis in phases.grid.axes),
    )
    progress(1.0, "done")
    return path


def _seeds_text(phases: Phases) -> str:
    known = [str(seed) for seed in phases.grid.seeds if seed is not None]
    return f"seed{'s' if len(known) > 1 else ''} {', '.join(known)}" if known else "no imperfection, so no seeds"


# diagrams ----------------------------------------------------------------------------------------------------


def _write_diagrams(phases: Phases, shown: Shown, folder: Path) -> list[dict[str, Any]]:
    """Write the diagrams of a measure; return an entry for each. Empty if only the seed is varied."""
    axes, found = phases.grid.axes, []
    if len(axes) == 1:
        found.append((f"{shown.key}.png", curve(phases, shown), f"{shown.label} over {axes[0].label}"))
    elif axes:
        for k, others in enumerate(slices(phases), start=1):
            at = fixed_parameters_text(phases, others)
            words = f"{shown.label} over {axes[0].label} and {axes[1].label}{f' at {at}' if at else ''}"
            name = f"{shown.key}.png" if not others else f"{shown.key}-{k}.png"
            found.append((name, diagram(phases, shown, others), words))
    parts = []
    for name, figure, words in found:
        save(figure, folder / name)
        parts.append(_picture_entry(folder / name, words))
    return parts


def _picture_entry(path: Path, words: str) -> dict[str, Any]:
    data = base64.b64encode(path.read_bytes()).decode()
    return {"data": data, "words": words, "file": f"{path.parent.name}/{path.name}"}


# surfaces ----------------------------------------------------------------------------------------------------


def _geometry_shape(phases: Phases) -> str:
    return phases.grid.points[0].scene.geometry.shape


def _thumbnails_title(phases: Phases) -> str:
    """Title of the thumbnails."""
    return SECTIONS_TITLE if _geometry_shape(phases) == "strip" else SURFACES_TITLE


def _write_thumbnails(phases: Phases, folder: Path) -> list[dict[str, Any]]:
    """Write thumbnails of the first seed, pial surfaces or sections of strips: one grid per diagram, all at one
    scale."""
    first = {at: phases.at[at][0] for at in phases.grid.places}
    view = "top" if _geometry_shape(phases) in ("patch", "strip") else "lateral"
    largest = max((_surface_extent(run, view) for run in first.values()), default=0.0)
    if not largest:
        return []
    parts = []
    for k, others in enumerate(slices(phases), start=1):
        at = fixed_parameters_text(phases, others)
        path = folder / ("surfaces.png" if not others else f"surfaces-{k}.png")
        path.write_bytes(png_bytes(_thumbnail_mosaic(phases, first, others, view, largest)))
        parts.append(_picture_entry(path, f"{_thumbnails_title(phases)}{f' at {at}' if at else ''}"))
    return parts


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
    one, other = (verts[faces[:, k]] - verts[faces[:, 0]] for k in (1, 2))
    below = one[:, 0] * other[:, 1] < one[:, 1] * other[:, 0]
    faces[below] = faces[below][:, [0, 2, 1]]  # so that all faces point up
    return Surface(*geometry.in_use(verts, faces)[1:])


def _thumbnail_mosaic(
    phases: Phases, first: dict[tuple[int, ...], RunResult], others: tuple[int, ...], view: str, largest: float
) -> Picture:
    """Thumbnails, with the same columns and rows as the diagram."""
    axes = phases.grid.axes[:2]
    cells: dict[tuple[int, int], Surface | str] = {}
    for at, run in first.items():
        if at[2:] == others:
            surface = _drawn_surface(run)
            text = "failed" if run.reason else "no surface"
            cells[at[0] if at else 0, at[1] if len(at) > 1 else 0] = text if surface is None else surface
    across, up = [*((axis_title(phases, axis), axis.words) for axis in axes), ("", ()), ("", ())][:2]
    return thumbnails(cells, across, up, view, largest, MOSAIC_WIDTH_PX)


# words and numbers -------------------------------------------------------------------------------------------


def _table_row(phases: Phases, at: tuple[int, ...]) -> dict[str, Any]:
    """One row of the table of numbers."""
    theory, final = phases.theory[at], phases.grid.scenes[at].growth.final
    cells = [cell(phases, at, shown.key) for shown in shown_of(phases)]
    return {
        "values": [axis.words[i] for axis, i in zip(phases.grid.axes, at)] or ["the scene"],
        "cells": [" ".join(one.words) for one in cells],
        "final": number(final),
        "g_crit": number(theory.g_crit),
        "wavelength": number(theory.wavelength),
        "state": _folded_or_smooth(beyond(phases, at)),
        "runs": f"{cells[0].runs - cells[0].failed} of {cells[0].runs}",
    }


def _folded_or_smooth(above: float) -> str:
    return "–" if math.isnan(above) else "folded" if above > 0 else "smooth"


def _theory_is_known(phases: Phases) -> bool:
    """Whether theory has a result for any point."""
    return any(math.isfinite(one.g_crit) for one in phases.theory.values())


def theory_words(phases: Phases) -> list[str]:
    """Sentences: what the theory assumes, and where it has no result."""
    found = list(phases.theory.values())
    sentences = []
    if _theory_is_known(phases):
        sentences.append(
            "Theory is linear stability of the smooth growing sphere: a cortex of even thickness on a core around a "
            "hole with a fixed wall, both with the energy of the simulation, the core not growing. Critical growth is "
            "the least growth at which any wave grows. The wavelength is that of this wave on the grown sphere."
        )
        sentences.append(
            "Theory gives the growth at which a smooth sphere can no longer stay smooth. It does not describe the "
            "folds that follow. The measured wavelength is that of the folds at final growth, along the surface, down "
            "into the sulcus and up again: it is longer for deep folds than for the first wrinkles. An imperfect "
            "cortex folds gradually, and its folds may become visible only beyond the critical growth."
        )
    shapes = {point.scene.geometry.shape for point in phases.grid.points}
    if "radial" in shapes:
        sentences.append(
            "A radial scene has one dimension and stays a sphere: it does not fold where theory predicts folds."
        )
    nothing: dict[str, int] = {}
    for one in found:
        if math.isnan(one.g_crit):
            nothing[one.reason] = nothing.get(one.reason, 0) + 1
    for reason, count in sorted(nothing.items()):
        where = "" if count == len(found) else f" at {count} of {len(found)} points"
        sentences.append(f"Theory says nothing here{where}: {reason or 'no wave was found to grow'}.")
    return sentences


def verdict(phases: Phases) -> str:
    """A sentence that compares measured wavelengths with those of theory; empty without both."""
    ratios = []
    for at in phases.grid.places:
        measured, theory = cell(phases, at, WAVELENGTH_KEY).mean, phases.theory[at].wavelength
        if math.isfinite(measured) and math.isfinite(theory):
            ratios.append(measured / theory)
    if not ratios:
        return ""
    span = " to ".join(dict.fromkeys(number(ratio) for ratio in (min(ratios), max(ratios))))
    points = f"{len(ratios)} point{'s' if len(ratios) > 1 else ''}"
    return f"Where both are known ({points}), the measured wavelength is {span} times that of theory's first wrinkles."


def missing(phases: Phases) -> list[str]:
    """Sentences: how many runs lack each of the measures shown, with the reason of one run."""
    sentences = []
    done = [run for run in phases.runs if not run.reason]
    for shown in shown_of(phases):
        without = [run for run in done if shown.key not in run.measures]
        if without:
            why = without[0].notes.get(shown.key, "")
            example = f" Reason for {without[0].point.name}: {why.rstrip('.')}." if why else ""
            sentences.append(f"{shown.label}: {len(without)} of {len(done)} runs have none.{example}")
    return sentences


def _accuracy_levels(phases: Phases) -> str:
    """Accuracies of the scenes of a sweep, in words."""
    levels = {scene.accuracy.level for scene in phases.grid.scenes.values() if scene.geometry.shape != "mesh"}
    return ", ".join(level for level in LEVELS if level in levels)
