"""What follows the onset of folding on a flat strip: do folds grow from nothing, or jump?

``python -m morphofold.studies.post_onset docs/theory.md`` writes ``docs/theory-post-onset.tsv``, a part of it between
the marks ``post-onset`` of the page, and ``docs/theory-post-onset.png`` and ``docs/theory-hysteresis.png``. It takes
twenty minutes on two cores.

The body is half a wave of a strip in plane strain, between symmetry planes. The height of its crest above the smooth
state is imposed, and the growth is sought at which no force is needed to hold it there. So states are found whether
they are stable or not, and without noise. Near the onset this growth is g_crit + c (a / T)^2 for the height a. With
c > 0 folds grow gradually from the onset and vanish there again (supercritical). With c < 0 folded states exist below
it: folds jump at the onset, and stay when growth goes back a little (subcritical, with hysteresis).

Deep folds, whose walls touch, are found as at home: the strip grows and shrinks again in small steps, by the explicit
solver with contact, from a cosine of a thousandth of T.
"""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.optimize import minimize_scalar

from morphofold.frozen_arrays import Array, Ints
from morphofold.report.plots.figure_style import GREY, legend_of_figure, line_style, new_figure, save
from morphofold.sim.body import Body
from morphofold.sim.dynamics import Dynamics, UnstableError
from morphofold.sim.effects.contact import Contact
from morphofold.sim.effects.plane_strain import PlaneStrain
from morphofold.sim.effects.symmetry import Symmetry
from morphofold.sim.equilibrium.statics import Equilibrium, bifurcation_of_body, even_levels
from morphofold.sim.mesh.brick_mesh import bilayer_patch
from morphofold.studies.markdown import number, table_with_tsv, update_page
from morphofold.threads import set_threads

LAWS = ("isotropic", "tangential")
MU_RATIOS = (0.5, 0.7, 1.0, 2.0, 4.0)
N_LAYERS, LAYERS_OF_SEARCH = 10, 4  # of elements through the cortex
CREST_HEIGHTS = (0.02, 0.04, 0.06, 0.08, 0.12, 0.16, 0.2, 0.3, 0.4)  # of the crest, over T
DEPTH, KAPPA_RATIO = 10.0, 50.0  # of the strip, over T; and of both layers
HALF_WAVE_STEP = 0.4
HALF_WAVES = np.arange(1.8, 5.8, HALF_WAVE_STEP)  # over T: the first that is better than the next is near the critical
MOST_SECANTS, GROWTH_PRECISION = 12, 1e-8
#: of the loop: growth beyond the onset, up and back
PAST_ONSET = np.round(np.arange(-0.12, 0.0501, 0.005), 3)
COSINE_HEIGHT = 1e-3  # height over T of the cosine in the reference shape of the loop
STEPS_PER_UNIT = 120.0  # of growth, over the time in which a wave crosses the cortex
TICKS_BETWEEN, STILL_HEIGHT, MOST_WAITS = 20.0, 1e-3, 60  # at rest: the height changes by less, over T, in so many
FOLD_HEIGHT = 0.5  # height of crest over trough from which it counts as a fold, over T
N_FITTED = 3  # heights to which the coefficient is fitted
COLUMN_HEADS = (
    "law | ratio | wavelength / T | g_crit | c | kind | highest crest found / T | its g − g_crit | "
    "folds from g − g_crit | back, until"
)


@dataclass(frozen=True, eq=False)
class Branch:
    """Folded states beside the smooth one.

    Attributes
    ----------
    g_crit : float
        Growth at which the smooth state of this mesh becomes unstable.
    heights, growth : (M,) float64
        Imposed height of the crest over T, and the growth at which it needs no force; fewer than asked for if the
        next state was not found.
    last_x : (N, 3) float64
        The last state.
    """

    g_crit: float
    heights: Array
    growth: Array
    last_x: Array

    @property
    def coefficient(self) -> float:
        """c of g_crit + c (a / T)^2, extrapolated to a = 0 from the lowest heights."""
        height_squares = self.heights[:N_FITTED] ** 2
        slopes = (self.growth[:N_FITTED] - self.g_crit) / height_squares
        return float(np.polyfit(height_squares, slopes, 1)[1] if len(slopes) > 1 else slopes[0])


def strip(law: str, ratio: float, half_wave: float, layers: int, *, depth: float = DEPTH, cosine: float = 0.0) -> Body:
    """Half a wave of a strip with T = 1; its reference shape has a crest at x = 0 of height ``cosine``."""
    bilayer = bilayer_patch((half_wave, 0.0), depth, 1.0, 1.0 / layers, layers)
    X, wave_number = np.ascontiguousarray(bilayer.mesh.p.T), np.pi / half_wave
    X[:, 2] += cosine * np.cos(wave_number * X[:, 0]) * np.exp(wave_number * X[:, 2]) * (X[:, 2] > -depth)
    return Body(bilayer, mu_cortex=ratio, mu_core=1.0, kappa_ratio=KAPPA_RATIO, law=law, X=X)


def growing(body: Body, steps_per_unit: float) -> Dynamics:
    """The strip in the explicit solver, with contact; ``steps_per_unit`` in steps per crossing of the cortex."""
    return Dynamics(body, [Contact(), Symmetry(), PlaneStrain()], steps_per_unit=steps_per_unit * body.crossing)


def critical_half_wave(law: str, mu_ratio: float) -> float:
    """The half wave, over T, that becomes unstable first; a strip twice as long would have two of them."""

    def onset(half_wave: float) -> float:
        return bifurcation_of_body(strip(law, mu_ratio, half_wave, LAYERS_OF_SEARCH), 3.0, 0.1).g_crit

    g_onset, longest = onset(HALF_WAVES[0]), HALF_WAVES[-1]
    for half_wave in HALF_WAVES[1:]:
        previous_onset, g_onset = g_onset, onset(half_wave)
        if g_onset > previous_onset:
            longest = half_wave
            break
    wave_bounds = (longest - 2 * HALF_WAVE_STEP, longest)
    return float(minimize_scalar(onset, bounds=wave_bounds, method="bounded", options={"xatol": 0.02}).x)


def branch(body: Body, crest_heights: Sequence[float] = CREST_HEIGHTS) -> Branch:
    """Folded states with these heights of the crest, until one is not found."""
    bifurcation = bifurcation_of_body(body, 3.0, 0.05)
    height_mode = bifurcation.mode[: body.n_surface, 2]
    crest_nodes = np.flatnonzero(np.isclose(body.X[: body.n_surface, 0], body.X[np.abs(height_mode).argmax(), 0]))
    unit_shape = bifurcation.mode * np.sign(height_mode[np.abs(height_mode).argmax()])  # displacement for each height
    was_free, g, growth, x = body.free.copy(), bifurcation.g_crit, list[float](), bifurcation.x
    for height in crest_heights:
        try:
            g, x, unit_shape = _free_growth(body, crest_nodes, height, unit_shape, g)
        except FloatingPointError:
            break
        finally:
            body.free[:] = was_free
        growth.append(g)
    return Branch(bifurcation.g_crit, np.array(crest_heights[: len(growth)]), np.array(growth), x)


def _free_growth(body: Body, crest_nodes: Ints, height: float, mode: Array, g: float) -> tuple[float, Array, Array]:
    """The growth at which the crest stays at ``height`` by itself, by the secant method; its state, and the change of
    positions for each height."""
    last_trial: tuple[float, float] | None = None
    for _ in range(MOST_SECANTS):
        body.free[crest_nodes, 2] = True
        body.grow(1.0)
        smooth_positions = Equilibrium(body, body.X, even_levels(body)).grown(g).x
        body.free[crest_nodes, 2] = False
        start_positions = smooth_positions + height * mode
        start_positions[crest_nodes, 2] = smooth_positions[crest_nodes, 2] + height
        equilibrium = Equilibrium(body, start_positions)
        x = equilibrium.relaxed()
        crest_force = float(body.all_forces(x)[crest_nodes, 2].sum())
        if last_trial is not None and abs(g - last_trial[0]) < GROWTH_PRECISION:
            return g, x, (x - smooth_positions) / height
        growth_step = 1e-4 if last_trial is None else -crest_force * (g - last_trial[0]) / (crest_force - last_trial[1])
        last_trial, g = (g, crest_force), g + growth_step
    raise FloatingPointError("the secant method has not converged")


@dataclass(frozen=True, eq=False)
class Loop:
    """Height of crest over trough, over T, at g_crit + ``PAST_ONSET``: growing (up), then shrinking (down). NaN where
    the run burst."""

    heights_up: Array
    heights_down: Array

    @property
    def folds_at(self) -> float:
        """The first growth beyond the onset at which there is a fold on the way up; NaN if there is none."""
        folded_steps = np.flatnonzero(self.heights_up > FOLD_HEIGHT)
        return float(PAST_ONSET[folded_steps[0]]) if len(folded_steps) else float("nan")

    @property
    def flat_at(self) -> float:
        """The last growth at which there is one on the way down; NaN if it is there to the end, or the run burst."""
        folded_steps = np.flatnonzero(self.heights_down > FOLD_HEIGHT)
        was_flat = len(folded_steps) and folded_steps[0] > 0 and np.isfinite(self.heights_down[folded_steps[0] - 1])
        return float(PAST_ONSET[folded_steps[0]]) if was_flat else float("nan")


def loop(law: str, mu_ratio: float, half_wave: float, g_crit: float, n_layers: int = N_LAYERS) -> Loop:
    """Grow half a wave of a strip beyond the onset and back, with contact."""
    run = growing(strip(law, mu_ratio, half_wave, n_layers, cosine=COSINE_HEIGHT), STEPS_PER_UNIT)
    step_heights = np.full((2, len(PAST_ONSET)), np.nan)
    steps_up_and_down = [(0, k) for k in range(len(PAST_ONSET))] + [(1, k) for k in reversed(range(len(PAST_ONSET)))]
    try:
        for direction, k in steps_up_and_down:
            run.grow_to(g_crit + PAST_ONSET[k])
            step_heights[direction, k] = _height_at_rest(run)
    except UnstableError as error:
        print(f"{law} {mu_ratio:g}: {error}", file=sys.stderr)
    return Loop(*step_heights)


def _height_at_rest(run: Dynamics) -> float:
    """Height of crest over trough when it no longer changes."""
    height = np.inf
    for _ in range(MOST_WAITS):
        run.relax(run.state.relaxed + round(TICKS_BETWEEN * run.body.crossing))
        previous_height, height = height, float(np.ptp(run.state.x[: run.body.n_surface, 2]))
        if abs(height - previous_height) < STILL_HEIGHT:
            break
    return height


def draw_loops(path: Path, loops: dict[tuple[str, float], Loop]) -> None:
    """Height of crest over trough against growth less the critical one, up and down."""
    with new_figure(9.0, 4.2, 1, len(LAWS), sharey=True) as (figure, ((*panels,),)):
        for ax, law in zip(panels, LAWS):
            ax.set(xlim=(PAST_ONSET[0], PAST_ONSET[-1]), ylim=(0.0, 3.2), title=f"{law} growth")
            ax.set_xticks([-0.1, -0.05, 0.0, 0.05])
            ax.axvline(0.0, color=GREY, linewidth=0.8)
            ax.set(xlabel="growth beyond the onset, g − g_crit")
            for k, mu_ratio in enumerate(MU_RATIOS):
                colour = line_style(k)["color"]
                ax.plot(PAST_ONSET, loops[law, mu_ratio].heights_up, color=colour)
                ax.plot(PAST_ONSET, loops[law, mu_ratio].heights_down, color=colour, linestyle=(0, (2, 1.5)))
        panels[0].set(ylabel="crest over trough / T")
        legend = {f"ratio {mu_ratio:g}": {"color": line_style(k)["color"]} for k, mu_ratio in enumerate(MU_RATIOS)}
        legend_of_figure(figure, {**legend, "back": {"color": GREY, "linestyle": (0, (2, 1.5))}}, panels[0], 6)
        save(figure, path)


def draw(path: Path, branches: dict[tuple[str, float], Branch]) -> None:
    """Height of the crest against growth less the critical one; a panel for each law, a line for each ratio."""
    with new_figure(9.0, 4.2, 1, len(LAWS), sharey=True) as (figure, ((*panels,),)):
        for ax, law in zip(panels, LAWS):
            ax.set(xlim=(-0.004, 0.008), ylim=(0.0, 0.42), title=f"{law} growth")
            ax.axvline(0.0, color=GREY, linewidth=0.8)
            ax.set(xlabel="growth beyond the onset, g − g_crit")
            for k, ratio in enumerate(MU_RATIOS):
                fold_branch = branches[law, ratio]
                growth = np.append(0.0, fold_branch.growth - fold_branch.g_crit)
                ax.plot(growth, np.append(0.0, fold_branch.heights), marker="o", markersize=4, **line_style(k))
        panels[0].set(ylabel="height of the crest / T")
        legend_of_figure(figure, {f"ratio {ratio:g}": line_style(k) for k, ratio in enumerate(MU_RATIOS)}, panels[0], 5)
        save(figure, path)


def is_shown(row: Sequence[str]) -> bool:
    """Whether a row of the table is on the page: a soft, an equal and a stiff cortex under one law."""
    return row[0] == LAWS[0] and float(row[1]) in (MU_RATIOS[0], 1.0, MU_RATIOS[-1])


def main(page: Path) -> None:
    set_threads(1)  # the bodies are small
    branches, loops, rows = {}, {}, []
    for law in LAWS:
        for mu_ratio in MU_RATIOS:
            half_wave = critical_half_wave(law, mu_ratio)
            branches[law, mu_ratio] = states = branch(strip(law, mu_ratio, half_wave, N_LAYERS))
            coefficient, last = states.coefficient, (states.heights[-1], states.growth[-1] - states.g_crit)
            kind = "supercritical" if coefficient > 0 else "subcritical"
            loops[law, mu_ratio] = fold_loop = loop(law, mu_ratio, half_wave, states.g_crit)
            ends = [number(value, "{:.3f}") for value in (fold_loop.folds_at, fold_loop.flat_at)]
            texts = [number(2 * half_wave, "{:.1f}"), number(states.g_crit, "{:.4f}"), number(coefficient, "{:.3f}")]
            rows.append([law, f"{mu_ratio:g}", *texts, kind, number(last[0], "{:g}"), number(last[1], "{:.4f}"), *ends])
            print(*rows[-1], file=sys.stderr)
    draw(page.parent / "theory-post-onset.png", branches)
    draw_loops(page.parent / "theory-hysteresis.png", loops)
    update_page(page, {"post-onset": [table_with_tsv(page, "post-onset", COLUMN_HEADS, rows, is_shown)]})


if __name__ == "__main__":
    main(Path(sys.argv[1]))
