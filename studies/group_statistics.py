"""False positives and power of ``morphofold stats``, measured on made studies, and the table of them on a page.

``python -m morphofold.studies.group_statistics docs/group-statistics.md`` writes the tables between the marks ``rates``
and ``power``. It takes half an hour on two cores.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from morphofold.analysis.smoothing import smooth
from morphofold.arrays import Array
from morphofold.geometry import vertex_areas
from morphofold.inference.clusters import Mesh
from morphofold.inference.permutations import infer
from morphofold.io import atomic_file, read_label, read_surface, sample_path
from morphofold.studies.markdown import between_marks, table

PERMUTATIONS = 199
SUBJECTS = 20
LEVEL = 0.05
WIDTHS_MM = (10.0, 20.0)  # full width at half maximum of the maps
CORRELATIONS = (0.3, 0.5, 0.7)  # of the map with age, at a vertex of the planted patch
GROUPS = (20, 40, 80)
PATCH_MM = 20.0  # radius of the patch, through the white surface
PATCH_REGION_POINT = (-40.0, -20.0, 60.0)  # [mm] beside which it lies: the precentral gyrus
KINDS = ("height", "clusters", "TFCE")


class Bench:
    """The left hemisphere of fsaverage5, with smooth noise on its cortex."""

    def __init__(self) -> None:
        folder = sample_path("fsaverage5")
        self.white = read_surface(folder / "surf" / "lh.white")
        self.cortex = read_label(folder / "label" / "lh.cortex.label", len(self.white.verts))
        self.mesh = Mesh(self.white.faces, vertex_areas(self.white.verts, self.white.faces))
        away = np.linalg.norm(self.white.verts - PATCH_REGION_POINT, axis=1)
        centre = self.white.verts[np.argmin(np.where(self.cortex, away, np.inf))]
        self.patch = self.cortex & (np.linalg.norm(self.white.verts - centre, axis=1) <= PATCH_MM)

    def noise(self, subjects: int, width: float, random: np.random.Generator) -> Array:
        """Maps (S, N) of variance 1 with a kernel of full width ``width`` [mm]; NaN outside the cortex."""
        maps = random.standard_normal((len(self.white.verts), subjects)) / np.sqrt(self.mesh.areas)[:, None]
        found = smooth(self.white.verts, self.white.faces, maps, width, self.cortex).T
        return found / np.nanstd(found)

    def smallest(self, maps: Array, design: Array, contrast: Array, seed: int) -> tuple[Array, NDArray[np.bool_]]:
        """Smallest corrected p by height, clusters and TFCE (3,), and where p of TFCE is at the level (N,)."""
        found = infer(maps, design, contrast, self.mesh, permutations=PERMUTATIONS, seed=seed)
        cluster = min((row["p"] for row in found.clusters), default=1.0)
        smallest = np.array([np.nanmin(found.p_height), cluster, np.nanmin(found.p_tfce)])
        return smallest, found.p_tfce <= LEVEL


def people(subjects: int, random: np.random.Generator) -> Array:
    """Design (S, 3) of intercept, age and sex; age is standardised."""
    age, sex = random.uniform(20, 80, subjects), random.integers(0, 2, subjects)
    sex[:2] = 0, 1
    return np.column_stack([np.ones(subjects), (age - age.mean()) / age.std(), sex])


def false_positives(bench: Bench, studies: int) -> Iterator[list[str]]:
    """A row for each model and smoothness: share of null studies with a significant vertex, and its 95 % interval."""
    for flip, words in ((False, "age, with sex"), (True, "mean")):
        for width in WIDTHS_MM:
            hits = np.zeros(3, dtype=int)
            for k in range(studies):
                random = np.random.default_rng([int(flip), int(width), k])
                maps, design = bench.noise(SUBJECTS, width, random), people(SUBJECTS, random)
                maps += 0.0 if flip else 0.5 * design[:, 2:]  # sex has an effect, age has none
                design, contrast = (design[:, :1], np.ones(1)) if flip else (design, np.array([0.0, 1, 0]))
                hits += bench.smallest(maps, design, contrast, k)[0] <= LEVEL
                print(f"\r{words}, {width:g} mm: {k + 1} of {studies}", end="", file=sys.stderr)
            yield [words, f"{width:g}", *(share_with_interval(int(n), studies) for n in hits)]


def power(bench: Bench, studies: int) -> Iterator[list[str]]:
    """A row for each number of subjects and correlation: share of studies that find the patch, and how well."""
    for subjects in GROUPS:
        for correlation in CORRELATIONS:
            hits, inside = np.zeros(3, dtype=int), 0.0
            for k in range(studies):
                random = np.random.default_rng([subjects, int(100 * correlation), k])
                maps, design = bench.noise(subjects, WIDTHS_MM[0], random), people(subjects, random)
                slope = correlation / np.sqrt(1 - correlation**2)
                maps += slope * np.outer(design[:, 1], bench.patch)
                smallest, found = bench.smallest(maps, design, np.array([0.0, 1, 0]), k)
                hits += smallest <= LEVEL
                inside += found[bench.patch].mean() / studies
                print(f"\r{subjects}, r {correlation}: {k + 1} of {studies}", end="", file=sys.stderr)
            shares = [f"{100 * n / studies:.0f} %" for n in hits]
            yield [str(subjects), f"{correlation:g}", *shares, f"{100 * inside:.0f} %"]


def share_with_interval(hits: int, n: int) -> str:
    """Share in per cent with its exact 95 % interval (Clopper, Pearson 1934)."""
    low = stats.beta.ppf(0.025, hits, n - hits + 1) if hits else 0.0
    high = stats.beta.ppf(0.975, hits + 1, n - hits) if hits < n else 1.0
    return f"{100 * hits / n:.1f} % ({100 * low:.1f} to {100 * high:.1f})"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("page", type=Path)
    parser.add_argument("--studies", type=int, default=400)
    parser.add_argument("--power-studies", type=int, default=60)
    args = parser.parse_args()
    bench = Bench()
    rates = table(["tested", "smoothness [mm]", *KINDS], list(false_positives(bench, args.studies)))
    powers = table(["subjects", "correlation", *KINDS, "of the patch"], list(power(bench, args.power_studies)))
    text = args.page.read_text("utf-8")
    text = between_marks(text, "rates", [rates], args.page)
    text = between_marks(text, "power", [powers], args.page)
    with atomic_file(args.page) as temporary:
        temporary.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
