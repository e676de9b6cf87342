"""The wavelength of folds on a core that grows by its stress, on a flat strip, against linear theory.

``python -m morphofold.studies.stress_growth_study docs/theory.md`` writes ``docs/theory-stress-growth.tsv``, a
part of it between the marks ``stress-growth`` of the page, and ``docs/theory-stress-growth.png``. It takes half an hour
on two cores.

The cortex grows tangentially by g; the core keeps its volume and grows in shape by ``rate`` times its stress
(``effects.stress_growth`` with ``volume = false``). The pial surface is uneven from the start by waves, which growth
amplifies: first folds are the wave that is the first to be ``AMPLIFICATION`` times as high as before growth. It is
found from half a wave at a time, between symmetry planes, and in long strips with noise of all wavelengths.

Theory (:func:`heights`) is linear in the height and exact otherwise: a layer of finite strain, incompressible and
neo-Hookean, on a half-space that is a Maxwell solid. It has no free number.
"""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.fft import dct
from scipy.stats import t as student

from morphofold.frozen_arrays import Array
from morphofold.report.plots.figure_style import legend_of_figure, line_style, new_figure, save
from morphofold.sim.body import Body
from morphofold.sim.equilibrium.statics import Equilibrium
from morphofold.sim.mesh.brick_mesh import bilayer_patch
from morphofold.studies.markdown import number, table_with_tsv, update_page

MU_RATIOS = (1.0, 4.0)
CORE_RATES = (0.0, 1.0, 10.0, 30.0, 100.0, 300.0)
AMPLIFICATION = 25.0
DEPTH, KAPPA_RATIO = 15.0, 50.0  # of the strip, over T; of both layers
N_LAYERS, N_CELLS = 4, 16  # bricks through the cortex, and along half a wave
START_HEIGHT = 1e-4  # of half a wave before growth, over T
WAVE_RATIO = 1.12  # from one half wave to the next
LARGEST_STEP, RATE_OF_LARGEST_STEP = 0.004, 20.0  # of growth in simulations; smaller for larger rates
STEP_OF_THEORY, LARGEST_GROWTH = 2e-4, 1.6
WAVELENGTH_RANGE = (3.0, 40.0)  # over T, in which first folds are sought
#: long strips: length, height of noise, and bricks through the cortex; their rates (at ratio 1) and seeds
LONG_LENGTH, NOISE_RMS, LAYERS_OF_LONG, WAVELENGTHS_OF_NOISE = 64.0, 0.002, 3, (2.5, 40.0)
RATES_OF_LONG, SEEDS = (0.0, 10.0, 100.0), (1, 2, 3)
NOISE_END = 1.3149  # growth at which theory of noise ends: an elastic core loses its stability at 1.3150
FOLDS_OF_COLUMNS = ("theory", "simulated", "noise, simulated", "same noise, theory")
COLUMN_HEADS = (
    "ratio",
    "rate",
    *(f"{size}: {folds}" for size in ("wavelength / T", "g") for folds in FOLDS_OF_COLUMNS),
)


@dataclass(frozen=True)
class Folds:
    """First folds: growth, and wavelength over T."""

    growth: float
    wavelength: float


def reached(growth: Array, height: Array, goal_height: float) -> float:
    """Growth at which a rising height first reaches the goal; NaN if it does not."""
    first_step = int(np.argmax(height >= goal_height))
    if not height[first_step] >= goal_height:
        return np.nan
    steps_around = slice(first_step - 1, first_step + 1)
    return float(np.interp(np.log(goal_height), np.log(height[steps_around]), growth[steps_around]))


# --- theory


def layer(g: float, k: Array) -> tuple[Array, Array, Array, Array]:
    """A grown layer of T = 1 and mu = 1, held at its sides: its response to waves of number k (K,).

    Returns
    -------
    force, noise_force : (K, 2, 2), (K, 2) float64
        Force on the layer's lower face, along and up, that holds it there at a displacement of 1, and at 0 but with
        noise of height 1 before growth on its upper face.
    lift, noise_lift : (K, 2), (K,) float64
        Height of the upper face in these states.

    Notes
    -----
    The stretches are 1/g, 1/g, g^2 (incompressible), the thickness is g^2. With the height W(z) cos kx and the motion
    along x U sin kx, U = -W'/k, Biot's equation (d^2/dz^2 - k^2)(b3 d^2/dz^2 - b1 k^2) W = 0, b_i the squares of the
    stretches, has solutions exp(k z), exp(k z / g^3) and their mirror images. Tractions, with no stress along z before:
    b3 (U' - k W) and 2 b3 W' - p, with k p = b1 k^2 U - b3 U''. On the upper face, the compression b1 - b3 acts on the
    slope of the noise, which is stretched to g^2.
    """
    b1, b3, thickness = g**-2.0, g**4.0, g**2.0
    q = k[:, None] * np.array([1.0, -1.0, g**-3.0, -(g**-3.0)])

    def rows(z: float) -> tuple[Array, Array]:
        """Displacements and tractions (K, 2, 4) at z of each solution, scaled to 1 where it is largest."""
        e, n = np.exp(q * z - np.maximum(q * thickness, 0)), k[:, None]
        U = -q / n * e
        traction_along, traction_up = b3 * (q * U - n * e), 2 * b3 * q * e - (b1 * n * U - b3 * q**2 * U / n)
        return np.stack([U, e], axis=1), np.stack([traction_along, traction_up], axis=1)

    (lower_motion, lower_traction), (upper_motion, upper_traction) = rows(0.0), rows(thickness)
    matrix = np.concatenate([upper_traction, lower_motion], axis=1)
    right_sides = np.zeros((len(k), 4, 3))
    right_sides[:, 2, 0] = right_sides[:, 3, 1] = 1.0
    right_sides[:, 0, 2] = -k * (b1 - b3) * thickness
    solution = np.linalg.solve(matrix, right_sides)
    force, lift = -lower_traction @ solution, (upper_motion @ solution)[:, 1]
    return force[..., :2], force[..., 2], lift[:, :2], lift[:, 2] + thickness


def heights(mu_ratio: float, rate: float, k: Array, growth: Array) -> Array:
    """Height (states, K) of the pial surface for noise of height 1, at growths that rise from 1 in equal steps.

    The core resists with q, 2 mu k of its displacement u if it is elastic (incompressible half-space, bonded). With
    growth of its shape dq/dg + 2 rate q = 2 mu k du/dg, by the trapezoidal rule; q is minus the force on the layer.
    """
    surface_heights = np.empty((len(growth), len(k)))
    u, core_force, half_relaxation = np.zeros((len(k), 2)), np.zeros((len(k), 2)), rate * (growth[1] - growth[0])
    core_stiffness = 2 * k[:, None] / mu_ratio
    for i, g in enumerate(growth):
        force, noise_force, lift, noise_lift = layer(g, k)
        matrix = (1 + half_relaxation) * force + core_stiffness[..., None] * np.eye(2)
        with np.errstate(over="ignore", invalid="ignore"):  # long after first folds
            right_side = core_stiffness * u - (1 - half_relaxation) * core_force - (1 + half_relaxation) * noise_force
            u = np.linalg.solve(matrix, right_side[..., None])[..., 0]
            core_force = -np.einsum("kij,kj->ki", force, u) - noise_force
            surface_heights[i] = np.einsum("ki,ki->k", lift, u) + noise_lift
    return surface_heights


def in_theory(mu_ratio: float, rate: float) -> Folds:
    """First folds of theory."""
    wavelengths = np.geomspace(*WAVELENGTH_RANGE, 400)
    growth = np.arange(1 + 5 * STEP_OF_THEORY, LARGEST_GROWTH, STEP_OF_THEORY)
    spectrum = heights(mu_ratio, rate, 2 * np.pi / wavelengths, growth)
    fold_growths = np.array([reached(growth, np.abs(height), AMPLIFICATION) for height in spectrum.T])
    wave_index = int(np.nanargmin(fold_growths))
    return Folds(float(fold_growths[wave_index]), float(wavelengths[wave_index]))


# --- simulation


def spectra(
    mu_ratio: float, rate: float, length: float, wave_heights: Array, n_layers: int, edge: float, goal_rms: float
) -> tuple[Array, Array]:
    """Growth (states,) and heights (states, M) of cos(m pi x / length), m = 1 to M, until their rms reaches the goal.

    ``wave_heights`` (M,): of the waves of the pial surface before growth. Equilibria follow each other, the core grows
    in between.
    """
    bilayer = bilayer_patch((length, 0.0), DEPTH, 1.0, edge, n_layers)
    X = np.ascontiguousarray(bilayer.mesh.p.T)
    wave_numbers = np.pi / length * np.arange(1, 1 + len(wave_heights))
    X[:, 2] += bilayer.share * (np.cos(X[:, :1] * wave_numbers) @ wave_heights)
    body = Body(bilayer, mu_cortex=mu_ratio, mu_core=1.0, kappa_ratio=KAPPA_RATIO, law="tangential", X=X)
    G = np.tile(np.eye(3), (len(body.elements.core_volumes), 1, 1))
    front_nodes = np.flatnonzero(bilayer.mesh.p[1, : body.n_surface] == 0)
    front_nodes = front_nodes[np.argsort(bilayer.mesh.p[0, front_nodes])]
    growth_step = LARGEST_STEP / max(1.0, rate / RATE_OF_LARGEST_STEP)
    equilibrium, growth, spectrum = Equilibrium(body, X), [1.0], [wave_heights]
    while (spectrum[-1] ** 2).sum() < goal_rms**2 and growth[-1] < LARGEST_GROWTH:
        equilibrium = equilibrium.grown(growth[-1] + growth_step)
        log_growth = -0.5 * np.log1p(-2 * rate * growth_step)  # the next equilibrium restores the stress that relaxes
        body.elements.grow_by_stress(equilibrium.x, X, G, log_growth, grows_volume=False)
        surface_z = equilibrium.x[front_nodes, 2]
        growth.append(equilibrium.growth)
        spectrum.append((dct(surface_z - surface_z.mean(), type=1) / (len(surface_z) - 1))[1 : 1 + len(wave_heights)])
    return np.array(growth), np.array(spectrum)


def in_half_waves(ratio: float, rate: float, near_wave: float, n_layers: int = N_LAYERS, cells: int = N_CELLS) -> Folds:
    """First folds from half a wave of three lengths around ``near_wave``: the vertex of the parabola through them."""
    wavelengths, fold_growths = near_wave * np.array([1 / WAVE_RATIO, 1.0, WAVE_RATIO]), []
    for half_wave in wavelengths / 2:
        goal = AMPLIFICATION * START_HEIGHT
        growth, spectrum = spectra(ratio, rate, half_wave, np.array([START_HEIGHT]), n_layers, half_wave / cells, goal)
        fold_growths.append(reached(growth, np.abs(spectrum[:, 0]), goal))
    a, b, c = np.polyfit([-1.0, 0.0, 1.0], fold_growths, 2)
    return Folds(float(c - b**2 / (4 * a)), float(near_wave * WAVE_RATIO ** (-b / (2 * a))))


def noise_of_strip(seed: int) -> tuple[Array, Array]:
    """Wave numbers (M,) times T that fit into a long strip, and the heights of the noise (M,), over T."""
    m = np.arange(1, 1 + int(2 * LONG_LENGTH / WAVELENGTHS_OF_NOISE[0]))
    is_noisy = 2 * LONG_LENGTH / m <= WAVELENGTHS_OF_NOISE[1]
    height: Array = np.random.default_rng(seed).standard_normal(len(m)) * is_noisy * (NOISE_RMS / is_noisy.sum() ** 0.5)
    return np.pi / LONG_LENGTH * m.astype(np.float64), height


def folds_of_noise(growth: Array, wave_power: Array, wave_numbers: Array) -> Folds:
    """First folds from the power (states, M) of all waves (M,) of a strip, by its mean wave number."""
    total_power = wave_power.sum(axis=1)
    g_fold = reached(growth, total_power**0.5, AMPLIFICATION * NOISE_RMS)
    return Folds(g_fold, float(2 * np.pi / np.interp(g_fold, growth, wave_power @ wave_numbers / total_power)))


def noise_in_theory(rate: float, seed: int) -> Folds:
    """First folds of a long strip with noise in theory."""
    wave_numbers, noise_height = noise_of_strip(seed)
    growth = np.arange(1 + 5 * STEP_OF_THEORY, NOISE_END, STEP_OF_THEORY)
    return folds_of_noise(growth, (heights(1.0, rate, wave_numbers, growth) * noise_height) ** 2, wave_numbers)


def in_long_strip(rate: float, seed: int) -> Folds:
    """First folds of a long strip with noise."""
    wave_numbers, noise_height = noise_of_strip(seed)
    edge, goal_rms = 1 / LAYERS_OF_LONG, AMPLIFICATION * NOISE_RMS
    growth, spectrum = spectra(1.0, rate, LONG_LENGTH, noise_height, LAYERS_OF_LONG, edge, goal_rms)
    return folds_of_noise(growth, spectrum**2, wave_numbers)


def draw(path: Path, folds: dict[tuple[float, float], tuple[Folds, Folds]], noisy: dict[float, list[Folds]]) -> None:
    """Wavelength and growth of first folds against the rate: lines of theory, points of simulations."""
    rates = np.geomspace(0.3, 1000, 15)
    with new_figure(9.0, 4.2, 1, 2) as (figure, ((*panels,),)):
        for k, ratio in enumerate(MU_RATIOS):
            theory_folds = [in_theory(ratio, rate) for rate in rates]
            for ax, field in zip(panels, ("wavelength", "growth")):
                ax.plot(rates, [getattr(fold, field) for fold in theory_folds], **line_style(k))
                for rate in CORE_RATES[1:]:
                    marker_style = {"marker": "o", "markersize": 4, "color": line_style(k)["color"]}
                    ax.plot(rate, getattr(folds[ratio, rate][1], field), **marker_style)
        for rate, runs in noisy.items():
            for ax, field in zip(panels, ("wavelength", "growth")):
                if rate:
                    ax.plot(
                        [rate] * len(runs), [getattr(fold, field) for fold in runs], "x", color=line_style(0)["color"]
                    )
        for ax, axis_text in zip(panels, ("wavelength / T", "growth g")):
            ax.set(xscale="log", xlabel="rate of growth of the core", ylabel=f"{axis_text} of first folds")
        panels[0].set(
            yscale="log", ylim=(5, 20), yticks=[5, 6, 8, 10, 15, 20], yticklabels=["5", "6", "8", "10", "15", "20"]
        )
        panels[0].minorticks_off()
        legend_of_figure(figure, {f"ratio {ratio:g}": line_style(k) for k, ratio in enumerate(MU_RATIOS)}, panels[0], 2)
        save(figure, path)


def with_interval(values: Sequence[float], fmt: str) -> str:
    """Mean and half its 95 % interval, as text; without it if the steps of growth are too coarse to show a spread."""
    half_interval = float(student.ppf(0.975, len(values) - 1) * np.std(values, ddof=1) / len(values) ** 0.5)
    mean_text = fmt.format(np.mean(values))
    return mean_text if float(fmt.format(half_interval)) == 0 else f"{mean_text} ± {fmt.format(half_interval)}"


def is_shown(row: Sequence[str]) -> bool:
    """Whether a row of the table is on the page: the least and the largest rate."""
    return float(row[1]) in (CORE_RATES[0], CORE_RATES[-1])


def main(page: Path) -> None:
    folds, table_rows = {}, []
    noisy = {rate: [in_long_strip(rate, seed) for seed in SEEDS] for rate in RATES_OF_LONG}
    for mu_ratio in MU_RATIOS:
        for rate in CORE_RATES:
            theory_folds = in_theory(mu_ratio, rate)
            folds[mu_ratio, rate] = theory_folds, in_half_waves(mu_ratio, rate, theory_folds.wavelength)
            row = [f"{mu_ratio:g}", f"{rate:g}"]
            for key, fmt in (("wavelength", "{:.2f}"), ("growth", "{:.4f}")):
                row += [number(getattr(fold, key), fmt) for fold in folds[mu_ratio, rate]]
                if mu_ratio == 1 and rate in noisy:
                    theory = [noise_in_theory(rate, seed) for seed in SEEDS]
                    row += [with_interval([getattr(fold, key) for fold in runs], fmt) for runs in (noisy[rate], theory)]
                else:
                    row += ["–", "–"]
            table_rows.append(row)
            print(*row, sep="  ", file=sys.stderr, flush=True)
    draw(page.parent / "theory-stress-growth.png", folds, noisy)
    update_page(page, {"stress-growth": [table_with_tsv(page, "stress-growth", COLUMN_HEADS, table_rows, is_shown)]})


if __name__ == "__main__":
    main(Path(sys.argv[1]))
