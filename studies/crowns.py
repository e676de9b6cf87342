"""Where a growing cortex is thick: crowns against fundi over growth, for both growth laws and several stiffness ratios.

``python -m morphofold.studies.crowns FOLDER docs/measures/cortical-thickness.md`` grows what is missing in the folder,
writes the table of the page between its marks ``crowns``, all its rows in a TSV beside, and ``docs/crowns.png`` and
``docs/crowns-curvature.png``. It takes ten minutes on two cores.
"""

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from morphofold.analysis import curvature, measure
from morphofold.analysis.curvatures import scale_of_curvature
from morphofold.frozen_arrays import Array
from morphofold.io import read_cortex, sample_path
from morphofold.report.plots.figure_style import GREY, legend_of_figure, line_style, new_figure, save
from morphofold.sim.dynamics import UnstableError
from morphofold.sim.output.simulation_folder import Simulation
from morphofold.sim.scene.scene_files import load_scene
from morphofold.simulation import simulate
from morphofold.studies.markdown import number, table_with_tsv, update_page
from morphofold.surface import Cortex

LAWS = ("isotropic", "tangential")
MU_RATIOS = (0.5, 1.0, 2.0, 4.0, 10.0)
GROWTHS = (1.4, 1.5, 1.6, 1.8, 2.0)
SHOWN_GROWTHS = (1.5, 2.0)  # in the table
PEOPLE = {"S1, a person": "S1", "fsaverage5, an average": "fsaverage5"}
CURVE_GROWTH = 1.5  # growth at which thickness is drawn over curvature
CURV_BINS = np.linspace(-0.8, 0.8, 17)  # edges of the bins of mean curvature times mean thickness
MIN_BIN_COUNT = 50  # vertices in a bin that is drawn
FOLD_PARTS = ("crown", "wall", "fundus", "convex", "saddle", "concave")
COLUMN_HEADS = ("surface", "g", *FOLD_PARTS, "crown / fundus", "by columns")

Thickness = Mapping[str, tuple[float, float]]  # part -> by closest points and by columns [mm]


def grow_sphere(folder: Path, law: str, mu_ratio: float) -> Simulation:
    """An octant of Fig. 5 with this law and ratio; what was written of it, if it can't be grown to the end."""
    options = [f"growth.law={law}", f"material.mu_ratio={mu_ratio:g}", "geometry.portion=octant", "output.volume=false"]
    scene = load_scene("fig5", [*options, f"output.stages=[{', '.join(map(str, GROWTHS))}]"])
    run_folder = folder / f"{law}-{mu_ratio:g}"
    try:
        return simulate(scene, run_folder, resume=True)
    except UnstableError as error:  # crushed in its furrows
        print(f"{run_folder.name}: {error}", file=sys.stderr)
        return Simulation(run_folder, scene)


def thickness(cortex: Cortex) -> Thickness:
    """Mean thickness of each part."""
    part_rows = measure(cortex, only=["shapes"]).shapes
    row_of = {row["part"]: row for row in part_rows}
    return {part: (_or_nan(row_of[part]["thickness_mm"]), _or_nan(row_of[part]["column_mm"])) for part in FOLD_PARTS}


def _or_nan(value: float | None) -> float:
    return np.nan if value is None else value


def over(thicknesses: Thickness, method_index: int) -> float:
    """Crown over fundus, by closest points (0) or columns (1)."""
    return thicknesses["crown"][method_index] / thicknesses["fundus"][method_index]


def over_curvature(cortex: Cortex) -> Array:
    """Mean thickness over that of the cortex, in each bin of the mean curvature of the surface midway between white and
    pial, ``CURV_BINS``; NaN where there are few vertices."""
    measures = measure(cortex, only=["cortical_thickness"])
    thickness = measures.maps["cortical_thickness"]
    middle_verts = 0.5 * (cortex.white.verts + cortex.pial.verts)
    curv_scale, _ = scale_of_curvature(cortex, None)
    has_thickness, mean_thickness = np.isfinite(thickness), float(np.nanmean(thickness))
    scaled_curvature = curvature(middle_verts, cortex.faces, curv_scale).H[has_thickness] * mean_thickness
    bin_counts, _ = np.histogram(scaled_curvature, CURV_BINS)
    thickness_sums, _ = np.histogram(scaled_curvature, CURV_BINS, weights=thickness[has_thickness])
    return np.where(bin_counts >= MIN_BIN_COUNT, thickness_sums / np.maximum(bin_counts, 1) / mean_thickness, np.nan)


def line_of(label: str, growth_text: str, thicknesses: Thickness) -> list[str]:
    """A row of the table."""
    thickness_texts = [number(thicknesses[part][0], "{:.2f}") for part in FOLD_PARTS]
    return [label, growth_text, *thickness_texts, *(number(over(thicknesses, method), "{:.2f}") for method in (0, 1))]


def is_shown(row: Sequence[str]) -> bool:
    """Whether the page shows a row of the table: people, and cortices as stiff as their core."""
    return row[0] in PEOPLE or row[0].endswith(", 1")


def draw(path: Path, thicknesses: Mapping[tuple[str, float], Mapping[float, Thickness]], human: Thickness) -> None:
    """Crown over fundus against growth; a panel for each law, a line for each ratio, and a person's."""
    with new_figure(9.0, 4.2, 1, len(LAWS), sharey=True) as (figure, ((*panels,),)):
        for ax, law in zip(panels, LAWS):
            ax.set(xlim=(GROWTHS[0], GROWTHS[-1]), ylim=(0.9, 2.0), title=f"{law} growth")
            ax.axhline(1.0, color=GREY, linewidth=0.8)
            ax.axhline(over(human, 0), color=GREY, linestyle=(0, (2, 2)))
            ax.set(xlabel="growth g")
            for k, mu_ratio in enumerate(MU_RATIOS):
                at_growth = thicknesses[law, mu_ratio]
                ax.plot(list(at_growth), [over(parts, 0) for parts in at_growth.values()], marker="o", **line_style(k))
        panels[0].set(ylabel="thickness, crown / fundus")
        legend = {f"ratio {mu_ratio:g}": line_style(k) for k, mu_ratio in enumerate(MU_RATIOS)}
        legend_of_figure(figure, {**legend, "a person (S1)": {"color": GREY, "linestyle": (0, (2, 2))}}, panels[0], 6)
        save(figure, path)


def draw_curvature(path: Path, curves: Mapping[tuple[str, float], Array], human_curve: Array) -> None:
    """Thickness over its mean against mean curvature; a panel for each law, a line for each ratio, and a person's."""
    bin_middles = 0.5 * (CURV_BINS[1:] + CURV_BINS[:-1])
    with new_figure(9.0, 4.2, 1, len(LAWS), sharey=True) as (figure, ((*panels,),)):
        for ax, law in zip(panels, LAWS):
            ax.set(xlim=(CURV_BINS[0], CURV_BINS[-1]), ylim=(0.5, 1.4), title=f"{law} growth, g = {CURVE_GROWTH:g}")
            ax.plot(bin_middles, human_curve, color=GREY, linestyle=(0, (2, 2)))
            ax.set(xlabel="mean curvature × mean thickness")
            for k, mu_ratio in enumerate(MU_RATIOS):
                if (law, mu_ratio) in curves:
                    ax.plot(bin_middles, curves[law, mu_ratio], **line_style(k))
        panels[0].set(ylabel="thickness / its mean")
        legend = {f"ratio {mu_ratio:g}": line_style(k) for k, mu_ratio in enumerate(MU_RATIOS)}
        legend_of_figure(figure, {**legend, "a person (S1)": {"color": GREY, "linestyle": (0, (2, 2))}}, panels[0], 6)
        save(figure, path)


def main(folder: Path, page: Path) -> None:
    human_parts = {label: thickness(read_cortex(sample_path(sample), hemi="lh")) for label, sample in PEOPLE.items()}
    rows = [line_of(label, "", thicknesses) for label, thicknesses in human_parts.items()]
    thickness_of: dict[tuple[str, float], dict[float, Thickness]] = {}
    curve_of: dict[tuple[str, float], Array] = {}
    for law in LAWS:
        for mu_ratio in MU_RATIOS:
            simulation = grow_sphere(folder, law, mu_ratio)
            grown_stages = [g for g in GROWTHS if any(abs(g - stage) < 1e-9 for stage in simulation.stages)]
            thickness_of[law, mu_ratio] = {g: thickness(simulation.cortex(g)) for g in grown_stages}
            if CURVE_GROWTH in grown_stages:
                curve_of[law, mu_ratio] = over_curvature(simulation.cortex(CURVE_GROWTH))
            table_growths: Sequence[float] = [g for g in SHOWN_GROWTHS if g in grown_stages]
            rows += [line_of(f"{law}, {mu_ratio:g}", f"{g:g}", thickness_of[law, mu_ratio][g]) for g in table_growths]
    draw(page.parent.parent / "crowns.png", thickness_of, human_parts["S1, a person"])
    human_curve = over_curvature(read_cortex(sample_path("S1"), hemi="lh"))
    draw_curvature(page.parent.parent / "crowns-curvature.png", curve_of, human_curve)
    update_page(page, {"crowns": [table_with_tsv(page, "crowns", COLUMN_HEADS, rows, is_shown)]})


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
