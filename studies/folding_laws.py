"""Models and brains on the folding law: across species, through growth, and across scales.

``python -m morphofold.studies.folding_laws FOLDER docs/laws.md`` grows what is missing in the folder, and writes the
tables of the page between its marks ``growth``, ``scales`` and ``spacing``, and ``docs/laws-species.png``,
``docs/laws-growth.png``. The page shows some rows; all are in ``docs/laws-growth.tsv``,
``docs/laws-scales.tsv`` and ``docs/laws-spacing.tsv``. It takes half an hour on two cores.
"""

import csv
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy import stats

from morphofold.analysis import AtScale, across_scales, law_across_scales, measure
from morphofold.analysis.gyrification.folding_indices import ShapeTerms, shape_terms
from morphofold.analysis.gyrification.hull_measures import hull
from morphofold.frozen_arrays import Array
from morphofold.geometry import face_areas
from morphofold.io import read_cortex, sample_path
from morphofold.mesh_quality.cortex_checks import volume
from morphofold.report.plots.figure_style import BLACK, GREY, legend_of_figure, line_style, new_figure, save
from morphofold.shapes import icosphere
from morphofold.sim.output.simulation_folder import Simulation
from morphofold.sim.scene.scene_files import load_scene
from morphofold.simulation import simulate
from morphofold.studies.markdown import number, table_with_tsv, update_page
from morphofold.surface import Cortex, Surface

SCENE_OF_BODY = {
    f"T = {length}, {law}": f"fig6-{name}{ending}"
    for law, ending in (("isotropic", ""), ("tangential", "-tangential"))
    for name, length in (("thin", "1 mm"), ("normal", "2 mm"), ("thick", "3 mm"))
}
GROWTHS = tuple(round(1 + k / 10, 1) for k in range(11))
SCALES_GROWTHS = (1.4, 1.6, 1.8, 2.0)  # growths at which bodies are measured across scales
SPACING_GROWTHS = (1.6, 2.0)  # growths at which the spacing of gyri is measured
PEOPLE = {"S1, a person": ("S1", "lh"), "fsaverage5, an average": ("fsaverage5", "lh")}
SHELL_RADII = (48.0, 50.5)  # radii [mm]
GROWTH_HEADS = ("body", *(f"{g:g}" for g in GROWTHS[::2]), "in the range of mammals from", "to", "slope at the end")
SCALES_HEADS = ("surface", "g", "scales", "from, mm", "to", "slope", "exponent", "of its line")
SPACING_HEADS = ("surface", "g", "spacing, mm", "over the thickness before growth", "over the thickness now")
SHOWN_BODY = "T = 2 mm"  # of this thickness are the bodies whose rows stand in the page


@dataclass(frozen=True)
class Species:
    """Published mammals: exposed area [mm^2] and ``total area T^(1/2)`` [mm^2.5]; areas [mm^2] and volumes [mm^3] of
    primates; the mean of K over the mammals and its standard deviation; the slope and intercept of a free line through
    their decimal logarithms, and the standard deviation of points from it."""

    exposed_area: Array
    scaled_area: Array
    primate_area: Array
    primate_volume: Array
    mean_k: float
    sd_k: float
    slope: float
    intercept: float
    sd: float

    def deviation(self, terms: ShapeTerms) -> float:
        """Distance of a cortex from the free line, in standard deviations of the mammals."""
        scaled_area = terms.total * terms.thickness**0.5
        return (np.log10(scaled_area) - self.intercept - self.slope * np.log10(terms.exposed)) / self.sd


@dataclass(frozen=True)
class Body:
    """A body through growth: its terms at each growth, volumes within its pial surface [mm^3], and its rows across
    scales at some growths."""

    growths: Sequence[float]
    terms: Sequence[ShapeTerms]
    pial_volumes: Sequence[float]
    scales: Mapping[float, Sequence[AtScale]]


def species() -> Species:
    """The numbers of ``data_samples/species``."""

    def columns(file_name: str, *column_names: str) -> list[Array]:
        with (sample_path("species") / file_name).open(encoding="utf-8", newline="") as tsv_stream:
            tsv_rows = list(csv.DictReader(tsv_stream, delimiter="\t"))
        return [np.array([float(row[column]) for row in tsv_rows]) for column in column_names]

    total_area, folding_index, thickness = columns("mammals.tsv", "area_mm2", "folding_index", "thickness_mm")
    primate_area, primate_volume = columns("primates.tsv", "area_mm2", "volume_mm3")
    scaled_area, exposed_A = total_area * np.sqrt(thickness), total_area / folding_index
    x, y = np.log10(exposed_A), np.log10(scaled_area)
    log_k, line = y - 1.25 * x, stats.linregress(x, y)
    sd = float(np.std(y - line.intercept - line.slope * x, ddof=2))
    mean_and_sd = float(log_k.mean()), float(log_k.std(ddof=1))
    lines = float(line.slope), float(line.intercept), sd
    return Species(exposed_A, scaled_area, primate_area, primate_volume, *mean_and_sd, *lines)


def terms_of(cortex: Cortex) -> ShapeTerms:
    """The shape terms of a cortex as those of mammals: thickness is the volume between both surfaces over their mean
    area."""
    pial_area, white_area = (float(face_areas(each.verts, cortex.faces).sum()) for each in (cortex.pial, cortex.white))
    thickness = 2 * (volume(cortex.pial) - volume(cortex.white)) / (pial_area + white_area)
    return shape_terms(pial_area, float(hull(cortex.pial.verts, cortex.faces).area), thickness)


def grow_octant(folder: Path, scene_name: str) -> Simulation:
    """An octant of a built-in scene, at every growth of ``GROWTHS``."""
    stages_setting = f"output.stages=[{', '.join(map(str, GROWTHS))}]"
    scene = load_scene(scene_name, ["geometry.portion=octant", "output.volume=false", stages_setting])
    return simulate(scene, folder / scene_name, resume=True)


def measured_body(simulation: Simulation) -> Body:
    cortices = {g: simulation.cortex(g) for g in GROWTHS}
    at_scales = {g: across_scales(cortices[g]) for g in SCALES_GROWTHS if g in cortices}
    terms, volumes = zip(*((terms_of(cortex), volume(cortex.pial)) for cortex in cortices.values()))
    return Body(GROWTHS, terms, volumes, at_scales)


def shell() -> Cortex:
    verts, faces = icosphere(6)
    return Cortex(Surface(SHELL_RADII[0] * verts, faces), Surface(SHELL_RADII[1] * verts, faces))


def spacing(cortex: Cortex) -> float:
    """Straight distance between neighbouring gyri [mm]: twice the exposed area over the length of all crests.

    It is the distance of opposite sides in a net of equal hexagons.
    """
    measure_names = ("area_pial_mm2", "gyrification_index", "crest_length_mm")
    scalars = measure(cortex, only=measure_names).scalars
    pial_area, gyrification_index, crest_length = (float(scalars[key] or np.nan) for key in measure_names)
    return 2 * pial_area / gyrification_index / crest_length


def spacing_rows(body_name: str, cortex_of_growth: Mapping[str, Cortex], T_before: float | None) -> list[list[str]]:
    """The spacing at each growth, over the thickness ``T_before`` growth [mm], if that is known, and now."""
    rows = []
    for g, cortex in cortex_of_growth.items():
        distance, T_now = spacing(cortex), terms_of(cortex).thickness
        over_T_before = None if T_before is None else distance / T_before
        rows.append([body_name, g, *(number(value, "{:.1f}") for value in (distance, over_T_before, distance / T_now))])
    return rows


def growth_row(label: str, body: Body, mammals: Species) -> list[str]:
    """K at some growths, where the body is within two standard deviations of mammals of its exposed area, and how fast
    log (A_total T^(1/2)) rises with log A_exposed at the end."""
    log_k = np.array([terms.log_k for terms in body.terms])
    grid = np.linspace(body.growths[0], body.growths[-1], 1001)
    deviations = [mammals.deviation(terms) for terms in body.terms]
    inside_growths = grid[np.abs(np.interp(grid, body.growths, deviations)) <= 2]
    range_texts = (
        ("–", "–")
        if not inside_growths.size
        else (f"{inside_growths[0]:.2f}", "the end" if inside_growths[-1] == grid[-1] else f"{inside_growths[-1]:.2f}")
    )
    old, end = body.terms[-3], body.terms[-1]
    slope = np.log(end.total / old.total * (end.thickness / old.thickness) ** 0.5) / np.log(end.exposed / old.exposed)
    return [label, *(number(value, "{:.2f}") for value in log_k[::2]), *range_texts, number(float(slope), "{:.1f}")]


def scales_row(label: str, growth_text: str, at_scales: Sequence[AtScale]) -> list[str]:
    """The law across scales; the interval of the exponent tells only how straight its line is."""
    law = law_across_scales(at_scales)
    numbers = [number(value, "{:.2f}") for value in (law.finest, law.coarsest, law.slope, law.exponent)]
    line = " to ".join(number(value, "{:.2f}") for value in (law.exponent_low, law.exponent_high))
    return [label, growth_text, str(law.n_scales), *numbers, line]


def draw_species(path: Path, mammals: Species, bodies: Mapping[str, Body], cortex_of: Mapping[str, Cortex]) -> None:
    """Left: the law of 57 mammals; right: area against volume of 65 primates; each with bodies through growth."""
    with new_figure(11.0, 5.2, 1, 2) as (figure, ((mammal_axes, primate_axes),)):
        mammal_axes.set(xlim=(30, 3e5), ylim=(10, 3e6), title="57 mammals")
        primate_axes.set(xlim=(500, 2e6), ylim=(400, 4e5), title="65 primates")
        mammal_axes.set(xscale="log", yscale="log", xlabel="exposed area [mm²]", ylabel="total area × T^½ [mm^2.5]")
        primate_axes.set(xscale="log", yscale="log", xlabel="volume [mm³]", ylabel="total area [mm²]")
        mammal_axes.scatter(mammals.exposed_area, mammals.scaled_area, s=14, color=GREY)
        primate_axes.scatter(mammals.primate_volume, mammals.primate_area, s=14, color=GREY)
        end_areas = np.array([30.0, 3e5])
        mammal_axes.plot(end_areas, 10**mammals.intercept * end_areas**mammals.slope, color=GREY, linewidth=0.8)
        mammal_axes.plot(end_areas, 10**mammals.mean_k * end_areas**1.25, color=BLACK, linewidth=0.8)
        legend: dict[str, dict] = {
            "published": {"color": GREY, "marker": "o", "linestyle": "none", "markersize": 4},
            "law, slope 5/4": {"color": BLACK, "linewidth": 0.8},
        }
        for k, (label, body) in enumerate(bodies.items()):
            legend[label] = line_style(k)
            mammal_axes.plot(
                [terms.exposed for terms in body.terms],
                [terms.total * terms.thickness**0.5 for terms in body.terms],
                **line_style(k),
            )
            primate_axes.plot(body.pial_volumes, [terms.total for terms in body.terms], **line_style(k))
        for marker, (label, cortex) in zip("*P", cortex_of.items()):
            style = {"color": BLACK, "marker": marker, "linestyle": "none", "markersize": 9}
            terms = terms_of(cortex)
            mammal_axes.plot(terms.exposed, terms.total * terms.thickness**0.5, **style)
            primate_axes.plot(volume(cortex.pial), terms.total, **style)
            legend[label] = style
        legend_of_figure(figure, legend, mammal_axes, 4)
        save(figure, path)


def draw_growth(
    path: Path, mammals: Species, bodies: Mapping[str, Body], other_scales: Mapping[str, Sequence[AtScale]]
) -> None:
    """K against growth (left), with the band of all mammals, and against scale / T at the last growth (right)."""
    with new_figure(11.0, 5.2, 1, 2, sharey=True) as (figure, ((growth_axes, scale_axes),)):
        growth_axes.set(xlim=(GROWTHS[0], GROWTHS[-1]), ylim=(-1.2, -0.35), title="through growth")
        scale_axes.set(xlim=(0.0, 3.3), ylim=(-1.2, -0.35), title=f"across scales, bodies at g = {GROWTHS[-1]:g}")
        growth_axes.set(xlabel="growth g", ylabel="K")
        scale_axes.set(xlabel="scale / cortical thickness")
        for ax in (growth_axes, scale_axes):
            ax.axhspan(mammals.mean_k - 2 * mammals.sd_k, mammals.mean_k + 2 * mammals.sd_k, color="#e9e9e4", zorder=0)
            ax.axhline(mammals.mean_k, color=GREY, linewidth=0.8)
        legend: dict[str, dict] = {}
        scales_and_styles: dict[str, tuple[Sequence[AtScale], dict]] = {
            label: (body.scales[GROWTHS[-1]], line_style(k)) for k, (label, body) in enumerate(bodies.items())
        }
        marker_styles = [{"color": BLACK, "marker": marker, "markersize": 6} for marker in "*Po"]
        scales_and_styles |= {label: (rows, style) for (label, rows), style in zip(other_scales.items(), marker_styles)}
        for label, (rows, style) in scales_and_styles.items():
            legend[label] = style
            thickness = rows[0].terms.thickness
            scale_axes.plot([row.scale / thickness for row in rows], [row.terms.log_k for row in rows], **style)
            if label in bodies:
                growth_axes.plot(bodies[label].growths, [terms.log_k for terms in bodies[label].terms], **style)
        legend_of_figure(figure, legend, growth_axes, 3)
        save(figure, path)


def is_shown_scale(cells: Sequence[str]) -> bool:
    """The shell and the brains, and the first and the last growth of a body with isotropic growth."""
    return not cells[1] or (cells[0] == f"{SHOWN_BODY}, isotropic" and cells[1] in ("1.4", "2"))


def is_shown_spacing(cells: Sequence[str]) -> bool:
    """The brains, and the last growth of a body with either law of growth."""
    return not cells[1] or (cells[0].startswith(SHOWN_BODY) and cells[1] == "2")


def main(folder: Path, page: Path) -> None:
    mammals = species()
    cortex_of_person = {label: read_cortex(sample_path(sample), hemi=hemi) for label, (sample, hemi) in PEOPLE.items()}
    reference_cortices = {**cortex_of_person, f"shell of {SHELL_RADII[1] - SHELL_RADII[0]:g} mm": shell()}
    bodies, spacing_table = {}, list[list[str]]()
    for label, scene_name in SCENE_OF_BODY.items():
        simulation = grow_octant(folder, scene_name)
        bodies[label] = measured_body(simulation)
        folded_cortices = {f"{g:g}": simulation.cortex(g) for g in SPACING_GROWTHS}
        spacing_table += spacing_rows(label, folded_cortices, simulation.scene.geometry.cortex_thickness)
        print(label, file=sys.stderr, flush=True)
    scales_of_cortex = {label: across_scales(cortex) for label, cortex in reference_cortices.items()}
    draw_species(page.parent / "laws-species.png", mammals, bodies, cortex_of_person)
    draw_growth(page.parent / "laws-growth.png", mammals, bodies, scales_of_cortex)
    growth_table = [growth_row(label, body, mammals) for label, body in bodies.items()]
    scales_table = [scales_row(label, "", at_scales) for label, at_scales in scales_of_cortex.items()]
    for label, body in bodies.items():
        scales_table += [scales_row(label, f"{g:g}", at_scales) for g, at_scales in body.scales.items()]
    for label, cortex in cortex_of_person.items():
        spacing_table += spacing_rows(label, {"": cortex}, None)
    parts = {
        "growth": table_with_tsv(page, "growth", GROWTH_HEADS, growth_table, lambda cells: "isotropic" in cells[0]),
        "scales": table_with_tsv(page, "scales", SCALES_HEADS, scales_table, is_shown_scale),
        "spacing": table_with_tsv(page, "spacing", SPACING_HEADS, spacing_table, is_shown_spacing),
    }
    update_page(page, {mark: [text] for mark, text in parts.items()})


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
