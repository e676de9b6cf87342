"""Do gyri and hinges follow dense bundles of fibres? Growing, stiff and contracting bundles in spheres, many seeds.

``python -m morphofold.studies.fibre_study FOLDER docs/laws.md`` grows and measures what is missing in the folder,
writes some rows of the table between the marks ``fibres`` of the page, all of them to ``docs/laws-fibres.tsv``, and
``docs/laws-fibres.png``. A run takes a quarter of a minute on one core; there are ten of each kind.

Each seed has its own imperfection and its own places of the bundles: evenly spread, then turned at random. What lies
over bundles is compared with what lies over the same bundles turned at random, 999 times.
"""

import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy import stats
from scipy.spatial import cKDTree

from morphofold.analysis import measure
from morphofold.analysis.graph.gyral_tables import amounts
from morphofold.frozen_arrays import Array
from morphofold.group.permuted_model import share_above
from morphofold.io import atomic_file
from morphofold.report.plots.figure_style import GREY, new_figure, save
from morphofold.shapes import even_directions
from morphofold.sim.scene.scene_files import load_scene
from morphofold.simulation import simulate
from morphofold.spheres.spins import rotations
from morphofold.studies.markdown import number, table_with_tsv, update_page
from morphofold.surface import Cortex

SEEDS = range(10)
N_BUNDLES, BUNDLE_RADIUS_MM, BODY_RADIUS_MM = 20, 10.0, 50.0  # and radius of the body
NEAR_COSINE = np.cos(0.5 * BUNDLE_RADIUS_MM / BODY_RADIUS_MM)  # over a bundle: with at least half of its density
N_PLACES, N_ROTATIONS = 4000, 999
BODY_SETTINGS = ("geometry.portion=full", "growth.final=1.6", "output.stages=[]", "output.volume=false")
#: of a run: factor to the unit of the table, and format
QUANTITIES = {"hinges": (100.0, "{:.1f}"), "crests": (100.0, "{:.1f}"), "depth": (1.0, "{:.2f}")}
TITLES = ("hinges, %", "crest length, %", "sulcal depth, mm")


class Kind(NamedTuple):
    """Fibres of one kind: its folder, its words, and the options of its table; without them: no fibres."""

    name: str
    label: str
    options: Mapping[str, float | bool] | None


FIBRE_KINDS = (
    Kind("none", "no fibres", None),
    Kind("growing-10", "grow by 1.3, modulus 10", {"stiffness": 10.0, "growth": 1.3}),
    Kind("growing-2", "grow by 1.3, modulus 2", {"stiffness": 2.0, "growth": 1.3}),
    Kind("growing-half", "grow by 1.3, modulus 0.5", {"stiffness": 0.5, "growth": 1.3}),
    Kind("slow-10", "grow by 1.1, modulus 10", {"stiffness": 10.0, "growth": 1.1}),
    Kind("slow-2", "grow by 1.1, modulus 2", {"stiffness": 2.0, "growth": 1.1}),
    Kind("still-10", "do not grow, modulus 10", {"stiffness": 10.0}),
    Kind("still-50", "do not grow, modulus 50", {"stiffness": 50.0}),
    Kind("pulling-10", "do not grow, only pull, modulus 10", {"stiffness": 10.0, "buckle": True}),
    Kind("shrinking-10", "shorten to 0.9, modulus 10", {"stiffness": 10.0, "growth": 0.9}),
)
SHOWN_KINDS = ("none", "growing-10", "slow-10", "still-10", "shrinking-10")  # whose rows stand in the page


class OverBundles(NamedTuple):
    """One run: share of hinges and of crest length over bundles and mean sulcal depth there [mm], as they are and then
    with the bundles turned (1 + N_ROTATIONS,); and its number of hinges."""

    hinges: Array
    crests: Array
    depth: Array
    n_hinges: int


def bundles(seed: int) -> Array:
    """Unit directions (N_BUNDLES, 3) of the bundles of a seed."""
    return even_directions(N_BUNDLES) @ rotations(1, seed)[0].T


def grow_sphere(folder: Path, kind: Kind, seed: int) -> Cortex:
    """The sphere of a seed with fibres of this kind, at its final growth."""
    settings = [*BODY_SETTINGS, f"effects.perturbation.seed={seed}"]
    if kind.options is not None:
        bundle_items = [
            {"centre": (BODY_RADIUS_MM * axis).round(6).tolist(), "radius": BUNDLE_RADIUS_MM} for axis in bundles(seed)
        ]
        fibre_options = {"density": 0.0, **kind.options, "bundles": bundle_items}
        settings.append(f"effects.fibres={_toml(fibre_options)}")
    return simulate(load_scene("demo", settings), folder / f"{kind.name}-{seed}", resume=True, threads=1).cortex()


def _toml(value: object) -> str:
    """A value as inline TOML."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{key} = {_toml(item)}" for key, item in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(_toml, value)) + "]"
    return json.dumps(value)


def measured_run(folder: Path, kind: Kind, seed: int) -> OverBundles:
    """What lies over the bundles of a run; kept in the folder."""
    arrays_file = folder / f"{kind.name}-{seed}.npz"
    if not arrays_file.exists():
        bundle_shares = over_bundles(grow_sphere(folder, kind, seed), bundles(seed), seed)
        with atomic_file(arrays_file) as temp_path, temp_path.open("wb") as npz_stream:
            np.savez(npz_stream, **bundle_shares._asdict())
    with np.load(arrays_file) as npz_arrays:
        return OverBundles(npz_arrays["hinges"], npz_arrays["crests"], npz_arrays["depth"], int(npz_arrays["n_hinges"]))


def over_bundles(cortex: Cortex, directions: Array, seed: int) -> OverBundles:
    """What lies over bundles at unit ``directions`` (B, 3), and over the same turned at random.

    By the places of the vertices before growth, so that bundles have the same share of the body before and after.
    """
    assert cortex.sphere is not None
    measures = measure(cortex, only=["hinges", "crests", "sulcal_depth"])
    assert measures.graph is not None
    unit_verts = cortex.sphere.verts / np.linalg.norm(cortex.sphere.verts, axis=1, keepdims=True)
    landmark_amounts = amounts(measures.graph, len(unit_verts))
    place_depth = measures.maps["sulcal_depth"][cKDTree(unit_verts).query(even_directions(N_PLACES))[1]]
    turn_matrices = rotations(1 + N_ROTATIONS, seed)[1:]  # the first placed the bundles
    rotated_bundles = [directions, *(directions @ matrix.T for matrix in turn_matrices)]
    is_near_of = lambda points: np.stack([(points @ bundle.T).max(axis=1) >= NEAR_COSINE for bundle in rotated_bundles])
    is_over_bundle = is_near_of(even_directions(N_PLACES))

    def share_over(vertex_amount: Array) -> Array:
        vertex_index = np.flatnonzero(vertex_amount)
        return is_near_of(unit_verts[vertex_index]) @ vertex_amount[vertex_index] / vertex_amount.sum()

    return OverBundles(
        share_over(landmark_amounts["hinges"]),
        share_over(landmark_amounts["crest_length"]),
        is_over_bundle @ place_depth / is_over_bundle.sum(axis=1),
        int(landmark_amounts["hinges"].sum()),
    )


def summary(runs: Sequence[OverBundles], quantity: str) -> dict[str, float]:
    """A quantity over bundles, in the mean of the seeds, and by chance; ``low`` to ``high``: 95 % interval of their
    difference, from the spread between seeds (Student's t); ``p``: share of rotations that are as far from chance."""
    run_values = np.stack([getattr(run, quantity) for run in runs])  # (seeds, 1 + rotations)
    chance = run_values[:, 1:].mean(axis=1, keepdims=True)
    excess = run_values - chance
    mean, standard_error = excess[:, 0].mean(), excess[:, 0].std(ddof=1) / np.sqrt(len(excess))
    half = stats.t.ppf(0.975, len(excess) - 1) * standard_error
    p = float(share_above(np.abs(excess[:, 0].mean(keepdims=True)), np.abs(excess[:, 1:].mean(axis=0)))[0])
    return {"mean": run_values[:, 0].mean(), "chance": chance.mean(), "low": mean - half, "high": mean + half, "p": p}


def row_of(kind: Kind, runs: Sequence[OverBundles]) -> list[str]:
    """A row of the table."""
    cells = [kind.label, f"{len(runs)}", f"{sum(run.n_hinges for run in runs)}"]
    for name, (unit_factor, number_format) in QUANTITIES.items():
        value_of_key = {key: unit_factor * value if key != "p" else value for key, value in summary(runs, name).items()}
        interval_text = f"{number(value_of_key['low'], number_format)} to {number(value_of_key['high'], number_format)}"
        cells += [number(value_of_key["mean"], number_format), interval_text, number(value_of_key["p"], "{:.3f}")]
    return cells


def draw(path: Path, runs_of_kind: Mapping[str, Sequence[OverBundles]]) -> None:
    """What lies over bundles less chance: a panel for each quantity, a row for each kind, a small point for a seed."""
    with new_figure(9.5, 4.2, 1, len(QUANTITIES), sharey=True) as (figure, ((*panels,),)):
        for ax, quantity, title, x_limit in zip(panels, QUANTITIES, TITLES, (16.0, 6.0, 5.0)):
            scale = QUANTITIES[quantity][0]
            for k, kind in enumerate(FIBRE_KINDS):
                values = scale * np.stack([getattr(run, quantity) for run in runs_of_kind[kind.name]])
                excess, interval = values[:, 0] - values[:, 1:].mean(axis=1), summary(runs_of_kind[kind.name], quantity)
                ax.plot(excess, np.full(len(excess), -k), ".", color=GREY, markersize=4)
                ax.plot([scale * interval["low"], scale * interval["high"]], [-k, -k], linewidth=2, color="C0")
                ax.plot(excess.mean(), -k, "o", color="C0", markersize=5)
            ax.set(xlim=(-x_limit, x_limit), ylim=(0.5 - len(FIBRE_KINDS), 0.5), title=title)
            ax.axvline(0.0, color=GREY, linewidth=0.8)
            ax.set(xlabel="over bundles, less chance")
        panels[0].set_yticks([-k for k in range(len(FIBRE_KINDS))], [kind.label for kind in FIBRE_KINDS])
        save(figure, path)


def main(folder: Path, page: Path) -> None:
    runs_of_kind: dict[str, list[OverBundles]] = {kind.name: [] for kind in FIBRE_KINDS}
    for seed in SEEDS:
        for kind in FIBRE_KINDS:
            runs_of_kind[kind.name].append(measured_run(folder, kind, seed))
            print(kind.name, seed, runs_of_kind[kind.name][-1].n_hinges, file=sys.stderr)
    draw(page.parent / "laws-fibres.png", runs_of_kind)
    all_heads = ["fibres", "runs", "hinges"]
    for title in TITLES:
        all_heads += [f"over bundles: {title}", "less chance, 95 %", "p"]
    rows = [row_of(kind, runs_of_kind[kind.name]) for kind in FIBRE_KINDS]
    shown_labels = [kind.label for kind in FIBRE_KINDS if kind.name in SHOWN_KINDS]
    text = table_with_tsv(page, "fibres", all_heads, rows, lambda cells: cells[0] in shown_labels)
    update_page(page, {"fibres": [text]})


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
