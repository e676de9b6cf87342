"""How far apart are deep folds? The wavelength of least energy of a strip, far beyond the onset, with contact.

``python -m morphofold.studies.spacing docs/theory.md`` writes ``docs/theory-spacing.tsv``, a part of it between the
marks ``spacing`` of the page, and ``docs/theory-spacing.png``. It takes fifteen minutes on one core.

The body is half a wave of a strip in plane strain, between symmetry planes that its walls touch. Each half wave grows
by itself from a small cosine in its reference shape and comes to rest at each growth, until it splits into shorter
waves. Of all half waves, the best one has the least energy for each length of the strip before growth. It is the
spacing that a long strip would have if its folds could move freely.
"""

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.signal import find_peaks

from morphofold.frozen_arrays import Array
from morphofold.report.plots.figure_style import GREY, legend_of_figure, line_style, new_figure, save
from morphofold.sim.body import surface_area
from morphofold.sim.dynamics import UnstableError
from morphofold.studies.markdown import number, table_with_tsv, update_page
from morphofold.studies.post_onset import growing, strip
from morphofold.threads import set_threads

LAWS = ("isotropic", "tangential")
MU_RATIOS = (0.7, 1.0, 2.0, 4.0)
GROWTHS = (1.3, 1.4, 1.6, 1.8, 2.0, 2.2, 2.5)
HALF_WAVES = np.arange(1.5, 7.1, 0.5)  # over T before growth
N_LAYERS, DEPTH = 8, 20.0  # elements through the cortex; depth over T
SPLIT_HEIGHT = 0.2  # height over T from which a further crest or trough counts
STEPS_PER_UNIT = 60.0  # of growth, over the time in which a wave crosses the cortex
COSINE_HEIGHT = 0.02  # height of the cosine in the reference shape, over T
COLUMN_HEADS = (
    "law | ratio | g | best wavelength / T | nearly as good | over the thickness now | fold height / T | "
    "crown / fundus | wall / fundus"
)
ENERGY_MARGIN = 0.01  # energy over the least that counts as nearly as good


@dataclass(frozen=True)
class State:
    """A half wave at rest: energy for each area before growth, height of its fold, thickness of its cortex now (area
    of its section over mean length), and the lengths of the columns on its crown and in its fundus, and of the longest
    between."""

    energy: float
    fold_height: float
    thickness: float
    crown_T: float
    fundus_T: float
    wall_T: float


def grow(law: str, mu_ratio: float, half_wave: float) -> dict[float, State]:
    """The states of one half wave (over T, which is 1) at each of ``GROWTHS``, until it splits into shorter waves or
    bursts."""
    body = strip(law, mu_ratio, half_wave, N_LAYERS, depth=DEPTH, cosine=COSINE_HEIGHT)
    run, X = growing(body, STEPS_PER_UNIT), body.X
    width = float(X[:, 1].max())
    states: dict[float, State] = {}
    for g in GROWTHS:
        try:
            run.grow_to(g)
            run.settle()
        except UnstableError as error:
            print(f"{law} {mu_ratio:g}, half wave {half_wave:g}: {error}", file=sys.stderr)
            break
        x, step_record = run.state.x, run.state.record
        surface_heights = x[: body.n_surface, 2][np.lexsort((X[: body.n_surface, 0], X[: body.n_surface, 1]))][
            : body.n_surface // 2
        ]
        if any(len(find_peaks(sign * surface_heights, prominence=SPLIT_HEIGHT)[0]) for sign in (1, -1)):
            break  # it has split into shorter waves
        cortex_volume = body.grown_volumes(g).sum()  # nearly: the material is nearly incompressible
        pial_area, white_area = (surface_area(x[node:], body.bilayer.faces) for node in (0, N_LAYERS * body.n_surface))
        energy = step_record["strain_energy"] + sum(effect["energy"] for effect in step_record["effects"].values())
        height = float(np.ptp(x[: body.n_surface, 2]))
        column_lengths = np.linalg.norm(x[: body.n_surface] - x[N_LAYERS * body.n_surface :][: body.n_surface], axis=1)
        crown, fundus = (float(column_lengths[X[: body.n_surface, 0] == fold_x].mean()) for fold_x in (0.0, half_wave))
        thickness = 2 * float(cortex_volume) / (pial_area + white_area)
        states[g] = State(energy / (half_wave * width), height, thickness, crown, fundus, float(column_lengths.max()))
    return states


def best_wave(energies: Array) -> tuple[int, float]:
    """The half wave of least energy: its number, and its value from a parabola through it and its neighbours."""
    best_index = int(np.nanargmin(energies))
    neighbours = slice(best_index - 1, best_index + 2)
    if best_index in (0, len(energies) - 1) or np.isnan(energies[neighbours]).any():
        return best_index, float("nan")
    a, b, _ = np.polyfit(HALF_WAVES[neighbours], energies[neighbours], 2)
    return best_index, float(-b / (2 * a))


def is_shown(row: Sequence[str]) -> bool:
    """Whether a row of the table is on the page: an equal and a stiff cortex, grown twice as long."""
    return float(row[1]) in (1.0, MU_RATIOS[-1]) and float(row[2]) == 2


def main(page: Path) -> None:
    set_threads(1)  # the bodies are small
    table_rows, spacings = [], dict[tuple[str, float], dict[float, tuple[float, float]]]()
    for law in LAWS:
        for mu_ratio in MU_RATIOS:
            states = [grow(law, mu_ratio, float(half_wave)) for half_wave in HALF_WAVES]
            spacings[law, mu_ratio] = best_of_growth = {}
            for g in GROWTHS:
                energies = np.array([state[g].energy if g in state else np.nan for state in states])
                fold_heights = [state[g].fold_height for state in states if g in state]
                if np.isnan(energies).all() or max(fold_heights) < 1:
                    continue  # not folded yet
                best_index, half_wave = best_wave(energies)
                if np.isnan(half_wave):
                    continue  # other waves burst, or are not among those of the study
                good_waves = 2 * HALF_WAVES[energies <= (1 + ENERGY_MARGIN) * np.nanmin(energies)]
                state = states[best_index][g]
                best_of_growth[g] = 2 * half_wave, 2 * half_wave / state.thickness
                number_cells = [number(value, "{:.1f}") for value in (best_of_growth[g][1], state.fold_height)]
                number_cells += [number(value / state.fundus_T, "{:.2f}") for value in (state.crown_T, state.wall_T)]
                wave_cells = [number(best_of_growth[g][0], "{:.1f}"), f"{good_waves.min():g} to {good_waves.max():g}"]
                table_rows.append([law, f"{mu_ratio:g}", f"{g:g}", *wave_cells, *number_cells])
                print(*table_rows[-1], sep="\t", file=sys.stderr, flush=True)
    draw(page.parent / "theory-spacing.png", spacings)
    update_page(page, {"spacing": [table_with_tsv(page, "spacing", COLUMN_HEADS, table_rows, is_shown)]})


def draw(path: Path, spacings: Mapping[tuple[str, float], Mapping[float, tuple[float, float]]]) -> None:
    """Best wavelength against growth, over the thickness before growth and now; lines for ratios and laws."""
    with new_figure(9.0, 4.2, 1, 2) as (figure, ((*panels,),)):
        for ax, thickness_text, y_limit in zip(panels, ("before growth", "now"), (14.0, 7.0)):
            ax.set(xlim=(GROWTHS[0], GROWTHS[-1]), ylim=(0.0, y_limit), title=f"over the thickness {thickness_text}")
            ax.set(xlabel="growth g")
        panels[1].axhline(4.0, color=GREY, linewidth=0.8)
        panels[0].set(ylabel="wavelength of least energy")
        legend = {}
        for i_law, law in enumerate(LAWS):
            for k, mu_ratio in enumerate(MU_RATIOS):
                style = {**line_style(k), "marker": "os"[i_law], "markersize": 5, "fillstyle": ("full", "none")[i_law]}
                legend[f"{law}, {mu_ratio:g}"] = style
                for panel_index, ax in enumerate(panels):
                    best_of_growth = spacings[law, mu_ratio]
                    ax.plot(list(best_of_growth), [waves[panel_index] for waves in best_of_growth.values()], **style)
        legend_of_figure(figure, legend, panels[0], 4)
        save(figure, path)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
