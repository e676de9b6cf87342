"""False positives and power of ``morphofold stats``, measured on made studies, and the table of them on a page.

``python -m morphofold.studies.group_statistics docs/group-statistics.md`` writes the tables between the marks
``rates``, ``variances`` and ``power``: of the last two a few rows, and all rows in TSV files beside the page. It takes
three quarters of an hour on two cores.
"""

import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import cyclopts
import numpy as np
from numpy.typing import NDArray
from scipy import stats

from morphofold.analysis.smoothing import smooth
from morphofold.frozen_arrays import Array, Ints
from morphofold.geometry import vertex_areas
from morphofold.group.clusters import Mesh
from morphofold.group.map_statistics import VARIANCE_P, VARIANCE_RATIO
from morphofold.group.permuted_model import Inference, infer
from morphofold.io import read_label, read_surface, sample_path
from morphofold.shapes import icosphere
from morphofold.studies.markdown import table, table_with_tsv, update_page
from morphofold.surface import Surface

N_PERMUTATIONS = 199
N_SUBJECTS = 20
ALPHA = 0.05
FWHMS_MM = (10.0, 20.0)  # full width at half maximum of the maps
CORRELATIONS = (0.3, 0.5, 0.7)  # of the map with age, at a vertex of the planted patch
GROUP_SIZES = (20, 40, 80)
PATCH_RADIUS_MM = 20.0  # radius of the patch, through the white surface
PATCH_REGION_POINT = (-40.0, -20.0, 60.0)  # [mm] beside which it lies: the precentral gyrus
TEST_KINDS = ("height", "clusters", "TFCE")
#: rows of the tables that stand in the page
SHOWN_VARIANCES = ("10 with sd 1, 10 with sd 3", "6 with sd 3, 24 with sd 1")
SHOWN_POWERS = (("20", "0.3"), ("20", "0.5"), ("40", "0.3"), ("80", "0.3"))  # subjects, correlation


class Bench:
    """The left hemisphere of fsaverage5, with smooth noise on its cortex."""

    def __init__(self) -> None:
        folder = sample_path("fsaverage5")
        self.white = read_surface(folder / "surf" / "lh.white")
        self.is_cortex = read_label(folder / "label" / "lh.cortex.label", len(self.white.verts))
        self.mesh = Mesh(self.white.faces, vertex_areas(self.white.verts, self.white.faces))
        distances = np.linalg.norm(self.white.verts - PATCH_REGION_POINT, axis=1)
        patch_centre = self.white.verts[np.argmin(np.where(self.is_cortex, distances, np.inf))]
        self.is_patch = self.is_cortex & (np.linalg.norm(self.white.verts - patch_centre, axis=1) <= PATCH_RADIUS_MM)

    def noise(self, n_subjects: int, fwhm: float, rng: np.random.Generator) -> Array:
        """Maps (S, N) of variance 1 with a kernel of full width ``fwhm`` [mm]; NaN outside the cortex."""
        white_noise = rng.standard_normal((len(self.white.verts), n_subjects)) / np.sqrt(self.mesh.areas)[:, None]
        smoothed = smooth(self.white.verts, self.white.faces, white_noise, fwhm, self.is_cortex).T
        return smoothed / np.nanstd(smoothed)

    def test(self, maps: Array, design: Array, contrast: Array, seed: int, groups: Ints | None = None) -> Inference:
        """The contrast tested."""
        return infer(maps, design, contrast, self.mesh, permutations=N_PERMUTATIONS, seed=seed, groups=groups)


class Ball(Bench):
    """A ball of 642 vertices, all of them cortex: its studies take a twentieth of the time."""

    def __init__(self) -> None:
        self.white = Surface(*icosphere(3, radius=50.0))
        self.is_cortex = np.ones(len(self.white.verts), dtype=bool)
        self.mesh = Mesh(self.white.faces, vertex_areas(self.white.verts, self.white.faces))


def significant(inference: Inference) -> NDArray[np.bool_]:
    """Whether anything is significant by height, clusters and TFCE (3,)."""
    smallest_cluster_p = min((cluster["p"] for cluster in inference.clusters), default=1.0)
    return np.array([np.nanmin(inference.p_height), smallest_cluster_p, np.nanmin(inference.p_tfce)]) <= ALPHA


def people(n_subjects: int, rng: np.random.Generator) -> Array:
    """Design (S, 3) of intercept, age and sex; age is standardised."""
    ages, sexes = rng.uniform(20, 80, n_subjects), rng.integers(0, 2, n_subjects)
    sexes[:2] = 0, 1
    return np.column_stack([np.ones(n_subjects), (ages - ages.mean()) / ages.std(), sexes])


def false_positives(bench: Bench, n_studies: int) -> Iterator[list[str]]:
    """A row for each model and smoothness: share of null studies with a significant vertex, and its 95 % interval."""
    for is_mean_test, model_label in ((False, "age, with sex"), (True, "mean")):
        for fwhm in FWHMS_MM:
            n_significant = np.zeros(3, dtype=int)
            for k in range(n_studies):
                rng = np.random.default_rng([int(is_mean_test), int(fwhm), k])
                maps, design = bench.noise(N_SUBJECTS, fwhm, rng), people(N_SUBJECTS, rng)
                maps += 0.0 if is_mean_test else 0.5 * design[:, 2:]  # sex has an effect, age has none
                design, contrast = (design[:, :1], np.ones(1)) if is_mean_test else (design, np.array([0.0, 1, 0]))
                n_significant += significant(bench.test(maps, design, contrast, k))
                print(f"\r{model_label}, {fwhm:g} mm: {k + 1} of {n_studies}", end="", file=sys.stderr)
            yield [model_label, f"{fwhm:g}", *(share_with_interval(int(count), n_studies) for count in n_significant)]


def two_groups(
    n_first: int, n_second: int, first_sd: float, second_sd: float
) -> Callable[[np.random.Generator], tuple[Array, ...]]:
    """A function for the design, standard deviations and variance groups of subjects in two groups."""
    group = np.repeat([0, 1], [n_first, n_second])
    return lambda rng: (np.column_stack([np.ones(len(group)), group]), np.where(group == 0, first_sd, second_sd), group)


def rising_with_age(rng: np.random.Generator) -> tuple[Array, ...]:
    """The same of 30 people whose standard deviation is 0.3 at the least age and 2.3 at the greatest; thirds by age."""
    age = np.sort(rng.uniform(0, 1, 30))
    return np.column_stack([np.ones(30), age]), 0.3 + 2 * age, np.repeat([0, 1, 2], 10)


UNEQUAL_DESIGNS = {
    "10 with sd 1, 10 with sd 3": two_groups(10, 10, 1.0, 3.0),
    "20 with sd 1, 20 with sd 3": two_groups(20, 20, 1.0, 3.0),
    "6 with sd 3, 24 with sd 1": two_groups(6, 24, 3.0, 1.0),
    "6 with sd 1, 24 with sd 3": two_groups(6, 24, 1.0, 3.0),
    "10 and 10 with sd 1": two_groups(10, 10, 1.0, 1.0),
    "30, sd rises with age": rising_with_age,
}


def unequal_variances(bench: Bench, n_studies: int) -> Iterator[list[str]]:
    """A row for each kind of unequal variances, without and with variance groups: the share of null studies with a
    significant vertex, its 95 % interval, and the share of the studies in which a remark says that variances differ."""
    for label, make_design in UNEQUAL_DESIGNS.items():
        n_significant, n_remarks = np.zeros((2, 3), dtype=int), 0
        for k in range(n_studies):
            rng = np.random.default_rng([len(label), k])
            design, subject_sd, group_index = make_design(rng)
            maps = bench.noise(len(design), FWHMS_MM[1], rng) * subject_sd[:, None]
            plain_inference, grouped_inference = (
                bench.test(maps, design, np.array([0.0, 1]), k, g) for g in (None, group_index.astype(np.int64))
            )
            n_significant += [significant(plain_inference), significant(grouped_inference)]
            n_remarks += plain_inference.variance_p < VARIANCE_P and plain_inference.variance_ratio > VARIANCE_RATIO
            print(f"\r{label}: {k + 1} of {n_studies}", end="", file=sys.stderr)
        for groups_text, hit_counts in zip(("no", "yes"), n_significant):
            shares = [share_with_interval(int(count), n_studies) for count in hit_counts]
            yield [label, groups_text, *shares, f"{100 * n_remarks / n_studies:.0f} %" if groups_text == "no" else ""]


def power(bench: Bench, n_studies: int) -> Iterator[list[str]]:
    """A row for each number of subjects and correlation: share of studies that find the patch, and how well."""
    for n_subjects in GROUP_SIZES:
        for correlation in CORRELATIONS:
            n_significant, patch_share = np.zeros(3, dtype=int), 0.0
            for k in range(n_studies):
                rng = np.random.default_rng([n_subjects, int(100 * correlation), k])
                maps, design = bench.noise(n_subjects, FWHMS_MM[0], rng), people(n_subjects, rng)
                age_slope = correlation / np.sqrt(1 - correlation**2)
                maps += age_slope * np.outer(design[:, 1], bench.is_patch)
                inference = bench.test(maps, design, np.array([0.0, 1, 0]), k)
                n_significant += significant(inference)
                patch_share += (inference.p_tfce <= ALPHA)[bench.is_patch].mean() / n_studies
                print(f"\r{n_subjects}, r {correlation}: {k + 1} of {n_studies}", end="", file=sys.stderr)
            share_texts = [f"{100 * count / n_studies:.0f} %" for count in n_significant]
            yield [str(n_subjects), f"{correlation:g}", *share_texts, f"{100 * patch_share:.0f} %"]


def share_with_interval(n_hits: int, n_studies: int) -> str:
    """Share in per cent with its exact 95 % interval (Clopper, Pearson 1934)."""
    low = stats.beta.ppf(0.025, n_hits, n_studies - n_hits + 1) if n_hits else 0.0
    high = stats.beta.ppf(0.975, n_hits + 1, n_studies - n_hits) if n_hits < n_studies else 1.0
    return f"{100 * n_hits / n_studies:.1f} % ({100 * low:.1f} to {100 * high:.1f})"


def tables_with_tsv(page: Path, unequal_rows: Sequence[list[str]], power_rows: Sequence[list[str]]) -> tuple[str, str]:
    """The tables of unequal variances and of power for the page: the rows shown, and all in TSV files beside it."""
    unequal_heads = ["subjects", "variance groups", *TEST_KINDS, "remark"]
    power_heads = ["subjects", "correlation", *TEST_KINDS, "of the patch"]
    return (
        table_with_tsv(page, "variances", unequal_heads, unequal_rows, lambda cells: cells[0] in SHOWN_VARIANCES),
        table_with_tsv(page, "power", power_heads, power_rows, lambda cells: (cells[0], cells[1]) in SHOWN_POWERS),
    )


def main(page: Path, *, studies: int = 400, variance_studies: int = 400, power_studies: int = 60) -> None:
    """Write the tables of the page from so many studies of each kind."""
    bench = Bench()
    rate_table = table(["tested", "smoothness [mm]", *TEST_KINDS], list(false_positives(bench, studies)))
    unequal_rows, power_rows = list(unequal_variances(Ball(), variance_studies)), list(power(bench, power_studies))
    unequal_table, power_table = tables_with_tsv(page, unequal_rows, power_rows)
    update_page(page, {"rates": [rate_table], "variances": [unequal_table], "power": [power_table]})


if __name__ == "__main__":
    cyclopts.run(main)
