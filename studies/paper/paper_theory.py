"""Figs. 3 and 4 of Razavi et al. (2015): lines of the theory, points of simulations, and the tables of both.

The text of the paper does not give the limits of its axes. The limits here are ours and follow the ranges in the text.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from morphofold import analysis
from morphofold.errors import DoesNotApply
from morphofold.report.plots.figure_style import BLACK, legend_below, line_style, new_figure, save
from morphofold.report.plots.theory_plots import GROWTH_LAWS, draw_critical, draw_radius, draw_stress
from morphofold.results.theory_tables import Row, critical_rows, radius_rows, stress_rows
from morphofold.sim import theory
from morphofold.sim.run import Simulation
from morphofold.sim.scene import Radial, Sphere
from morphofold.sim.sphere_theory.smooth_sphere import RADIUS, SmoothSphere, smooth_state
from morphofold.studies.folds.fold_measures import FOLDED_RMS
from morphofold.studies.markdown import read_rows
from morphofold.studies.runs import Runs, run_record
from morphofold.surface import Surface
from morphofold.tables import write_table

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

THEORY, ONE_D, THREE_D = "theory", "smooth sphere, 1-D", "finite elements, 3-D"
#: the radial scenes of panels (a) and (b), T = 2, 1 and 3 mm, and the growths of their stages
RADIAL_STAGES = {"fig3": tuple(round(1 + k / 10, 1) for k in range(1, 11)), "fig3-thin": (2.0,), "fig3-thick": (2.0,)}
#: growths in three dimensions: 1 is the reference; the last ones are beyond the onset of folding
SOLID_GROWTHS = (1.0, 1.05, 1.1, 1.15, 1.2, 1.25, 1.3, 1.4, 1.5, 1.6)
DRAWN_STEP = 5  # every fifth point of a written profile is drawn
POINT_STYLE: dict[str, Any] = {"linestyle": "none", "marker": "o", "markersize": 5, "color": BLACK}
POINT_STYLE |= {"markerfacecolor": "white", "clip_on": False, "zorder": 3}


def fig3(element_rows: tuple[Sequence[Row], Sequence[Row]] = ((), ())) -> Figure:
    """Fig. 3: (a) outer radius against isotropic growth, (b) tangential stress through the cortex at g = 2.

    C = 50 mm; T = 2 mm in (a), 1, 2 and 3 mm in (b). Limits: g from 1 to 2, as in the text, and c/B from 1 to 1.3;
    position from the interface (0) to the outer surface (1), stress over the modulus of the cortex from -14 to 0.
    ``element_rows`` holds rows of simulations for (a) and (b), which are drawn as points.
    """
    radii, stresses = fig3_rows()
    with new_figure(9.2, 5.0, 1, 2) as (figure, ((radius_axes, stress_axes),)):
        draw_radius(radius_axes, radii)
        _draw_radii(radius_axes, element_rows[0])
        radius_axes.set(xlim=(1, 2), ylim=(1, 1.3), title="(a)  $T$ = 2 mm, $C$ = 50 mm, isotropic growth")
        draw_stress(stress_axes, stresses)
        _draw_stresses(stress_axes, element_rows[1])
        stress_axes.set(xlim=(0, 1), ylim=(-14, 0), title="(b)  $g$ = 2, $C$ = 50 mm, isotropic growth")
        legend_below(radius_axes)
        legend_below(stress_axes)
    return figure


def _draw_radii(ax: Axes, rows: Sequence[Row]) -> None:
    for source, is_folded, label, style in (
        (ONE_D, False, ONE_D, POINT_STYLE),
        (THREE_D, False, THREE_D, {**POINT_STYLE, "marker": "s", "markersize": 8, "markerfacecolor": "none"}),
        (THREE_D, True, "3-D, folded: mean", {**POINT_STYLE, "marker": "x", "color": line_style(1)["color"]}),
    ):
        points = [row for row in rows if row["source"] == source and row["folded"] == is_folded]
        if points:
            ax.plot([row["growth"] for row in points], [row["c_over_B"] for row in points], label=label, **style)


def _draw_stresses(ax: Axes, rows: Sequence[Row]) -> None:
    for i, T in enumerate(dict.fromkeys(row["thickness_mm"] for row in rows)):
        body_rows = [row for row in rows if row["thickness_mm"] == T][::DRAWN_STEP]
        x, y = [row["position"] for row in body_rows], [row["sigma_theta_over_mu_cortex"] for row in body_rows]
        ax.plot(x, y, label=ONE_D if i == 0 else None, **POINT_STYLE)


def fig3_rows() -> tuple[list[Row], list[Row]]:
    """The points of theory of :func:`fig3`, panels (a) and (b)."""
    radii, stresses = radius_rows(np.linspace(1, 2, 101)), stress_rows(points=101, layers=("cortex",))
    return [{"source": THEORY, **row} for row in radii], [{"source": THEORY, **row} for row in stresses]


def fig3_elements(radial_runs: Sequence[Simulation], solid_run: Simulation) -> tuple[list[Row], list[Row]]:
    """The points of simulations of :func:`fig3`, panels (a) and (b).

    Parameters
    ----------
    radial_runs : sequence of Simulation
        Simulations of the scenes :data:`RADIAL_STAGES`, in that order.
    solid_run : Simulation
        Simulation of the sphere of panel (a) in three dimensions, with a stage at g = 1.

    Returns
    -------
    radii, stresses : lists of rows
        As those of :func:`fig3_rows`, with the relative difference ``over_theory`` and the ``kappa_ratio``. Radii
        also have the difference from the smooth sphere of the same kappa_ratio, and whether the sphere is folded:
        then they are means, and theory does not apply.
    """
    radii = []
    for g in radial_runs[0].stages:
        profile = _profile(radial_runs[0], g)
        radii.append(_radius_row(ONE_D, radial_runs[0], g, profile["r_mm"][-1] / profile["R_mm"][-1]))
    reference_pial = solid_run.cortex(1.0).pial
    for g in solid_run.stages[1:]:
        stretch, height_rms = mean_stretch(reference_pial, solid_run.cortex(g).pial)
        is_folded = height_rms >= FOLDED_RMS * solid_run.scene.geometry.cortex_thickness
        radii.append(_radius_row(THREE_D, solid_run, g, stretch, is_folded))
    return radii, [row for simulation in radial_runs for row in _stress_rows(simulation)]


def mean_stretch(reference: Surface, deformed: Surface) -> tuple[float, float]:
    """Mean of deformed over reference distance from the centre, by reference area; rms of the deformed one [mm]."""
    R, r = (np.linalg.norm(surface.verts, axis=1) for surface in (reference, deformed))
    vertex_area = analysis.vertex_areas(reference.verts, reference.faces)
    height_rms = np.sqrt(np.average((r - np.average(r, weights=vertex_area)) ** 2, weights=vertex_area))
    return float(np.average(r / R, weights=vertex_area)), float(height_rms)


def _radius_row(source: str, simulation: Simulation, g: float, c_over_C: float, is_folded: bool = False) -> Row:
    geometry, material = _sphere(simulation), simulation.scene.material
    T, C = geometry.cortex_thickness, geometry.radius
    (theory_row,) = radius_rows([g], T, C)
    law, hole_ratio = simulation.scene.growth.law, geometry.hole_radius / C
    smooth_sphere = smooth_state(SmoothSphere(T / C, material.mu_ratio, law, material.kappa_ratio, hole_ratio), g)
    return {
        "source": source,
        **theory_row,
        "c_over_B": c_over_C * C / (C - T),
        "c_over_C": c_over_C,
        "kappa_ratio": material.kappa_ratio,
        "over_theory": c_over_C / theory_row["c_over_C"] - 1,
        "over_1d": None if source == ONE_D else c_over_C / float(smooth_sphere.fields[1, RADIUS, -1]) - 1,
        "folded": is_folded,
    }


def _stress_rows(simulation: Simulation) -> list[Row]:
    """Stress through the cortex of a radial simulation at its last stage."""
    geometry, material, g = _sphere(simulation), simulation.scene.material, simulation.stages[-1]
    profile = _profile(simulation, g)
    R, r, T, C = profile["R_mm"], profile["r_mm"], geometry.cortex_thickness, geometry.radius
    theory_stresses = theory.stresses(g, C - T, C, simulation.scene.growth.law, mu_cortex=material.mu_ratio, n=len(R))
    return [
        {
            "source": ONE_D,
            "law": simulation.scene.growth.law,
            "thickness_mm": T,
            "outer_radius_mm": C,
            "growth": g,
            "mu_ratio": material.mu_ratio,
            "layer": "cortex",
            "R_mm": R[i],
            "r_mm": r[i],
            "position": (r[i] - r[0]) / (r[-1] - r[0]),
            "sigma_r_over_mu_core": profile["sigma_r"][i],
            "sigma_theta_over_mu_core": profile["sigma_theta"][i],
            "sigma_theta_over_mu_cortex": profile["sigma_theta"][i] / material.mu_ratio,
            "kappa_ratio": material.kappa_ratio,
            "over_theory": profile["sigma_theta"][i] / theory_stresses.sigma_theta[i] - 1,
        }
        for i in range(len(R))
    ]


def _sphere(simulation: Simulation) -> Sphere | Radial:
    geometry = simulation.scene.geometry
    if not isinstance(geometry, Sphere | Radial):
        raise DoesNotApply(f"{simulation.path}: is a {geometry.shape}; Fig. 3 needs a sphere.")
    return geometry


def _profile(simulation: Simulation, g: float) -> dict[str, list[float]]:
    """Columns of the profile of a radial simulation at growth g, in the cortex, from the interface outwards."""
    profile_rows = read_rows(simulation.path / "stages" / f"g{g:.2f}" / "profile.tsv", ("layer",))
    cortex_rows = [row for row in profile_rows if row.pop("layer") == "cortex"]
    return {column: [row[column] for row in cortex_rows] for column in cortex_rows[0]}


def fig4() -> Figure:
    """Fig. 4: growth at which creases can form against C/B, Eqs. (12) and (13), with the ranges in the text as limits.

    Limits: C/B from 1 to 1.3; from 1.2 on, isotropic growth gives no crease. g from 1 to 3.
    """
    with new_figure(7.6, 4.6, 1, 1) as (figure, ((ax,),)):
        draw_critical(ax, fig4_rows())
        ax.set(xlim=(1, 1.3), ylim=(1, 3))
        legend_below(ax)
    return figure


def fig4_rows() -> list[Row]:
    """The points of :func:`fig4`."""
    rows = critical_rows(np.linspace(1, 1.3, 601)[1:])
    return [{"source": "theory", **row} for row in rows]


def reproduce_fig3(folder: Path, runs: Runs) -> dict[str, Any]:
    """Write fig3.png, fig3a.tsv and fig3b.tsv into ``folder``; returns their entry for an index."""
    radial_runs = [runs.grow(name, name, [f"output.stages={list(growths)}"]) for name, growths in RADIAL_STAGES.items()]
    settings = ["geometry.portion=octant", f"growth.final={SOLID_GROWTHS[-1]}", f"output.stages={list(SOLID_GROWTHS)}"]
    settings.append("output.volume=false")
    solid_run = runs.grow("fig3-solid", "fig7-ratio1", settings)
    element_rows = fig3_elements(radial_runs, solid_run)
    save(fig3(element_rows), folder / "fig3.png")
    for panel_letter, theory_rows, panel_rows in zip("ab", fig3_rows(), element_rows):
        write_table(folder / f"fig3{panel_letter}.tsv", list(theory_rows[0]), [*theory_rows, *panel_rows])
    return {
        "files": ["fig3.png", "fig3a.tsv", "fig3b.tsv"],
        "shows": "(a) outer radius against growth, (b) tangential stress through the cortex",
        "equations": "(a) Eq. (11); (b) Eqs. (4) to (6) integrated in closed form, with zero radial stress outside",
        "parameters": {
            "law": "isotropic",
            "outer_radius_mm": 50,
            "mu_ratio": 1,
            "a": {"thickness_mm": 2, "growth": [1, 2]},
            "b": {"thickness_mm": [1, 2, 3], "growth": 2},
        },
        "limits": "ours, from the ranges in the text: g 1 to 2, c/B 1 to 1.3; position 0 to 1, stress/mu -14 to 0",
        "columns": {
            "source": "theory (incompressible), or simulation in one or three dimensions at the given kappa_ratio",
            "over_theory": "relative difference from theory",
            "over_1d": "relative difference from the smooth sphere of the same kappa_ratio",
            "folded": "1: the sphere is folded, and c is the mean over its surface before growth",
        },
        "simulations": [run_record(simulation) for simulation in (*radial_runs, solid_run)],
    }


def reproduce_fig4(folder: Path, runs: Runs) -> dict[str, Any]:
    """Write fig4.png and fig4.tsv into ``folder``; returns their entry for an index. Nothing is grown."""
    save(fig4(), folder / "fig4.png")
    write_table(folder / "fig4.tsv", ("source", "law", "C_over_B", "T_over_C", "g_crease"), fig4_rows())
    return {
        "files": ["fig4.png", "fig4.tsv"],
        "shows": "growth at which creases can form, against the outer radius",
        "equations": "Eq. (12), isotropic; Eq. (13), tangential; criterion lambda_r/lambda_theta = 2.4, Eq. (7)",
        "parameters": {"law": list(GROWTH_LAWS), "C_over_B": [1, 1.3], "g_core": 1},
        "limits": "ours, from the ranges in the text: C/B 1 to 1.3, g 1 to 3",
    }
