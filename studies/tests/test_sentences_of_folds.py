"""Sentences of docs/folds.md have the numbers of the tables there, which runs write."""

import re

import numpy as np

from morphofold.forecasts.richardson import HOLD_TICKS
from morphofold.sim.scene import LEVELS, elements_through
from morphofold.sim.stage_checks import LARGEST_REST_DISTANCE_OVER_T
from morphofold.studies.folds.carried_states import EDGES_OF_LIMIT, limit_of_line
from morphofold.studies.page_sentences import Page, spread

PAGE = Page("folds")
CARRIED = PAGE.tsv_rows("carried")


def per_cent(level, column):
    """Errors of the runs of a level [%], from cells such as ``1.449 (-6.0 %)``."""
    return [float(row[column].split("(")[1].split(" %")[0]) for row in CARRIED if row["run"] == level]


def by_edge(cell):
    """Indices by edge over T, from a cell such as ``0.46 T: 1.434, 0.37 T: 1.458``."""
    return {float(edge): float(index) for edge, index in re.findall(r"([\d.]+) T: ([\d.]+)", cell)}


def test_bias_and_pattern_of_folds():
    standard, fine = (per_cent(level, "its index") for level in ("standard", "fine"))
    low, high = spread([-error for error in standard])
    PAGE.assert_sentence("`standard` is # to # % too low, # on average", low, high, -np.mean(standard), tolerance=0.051)
    PAGE.assert_sentence("`fine` is # to # % too low, corrected", *spread([-error for error in fine]))
    PAGE.assert_sentence("corrected it is within # % of the limit", max(map(abs, per_cent("standard", "corrected"))))
    PAGE.assert_sentence("too low, corrected within # %.", max(map(abs, per_cent("fine", "corrected"))))
    pattern = {
        level: [100 * (row["limit"] / row["limit of finest run"] - 1) for row in CARRIED if row["run"] == level]
        for level in ("standard", "fine")
    }
    below, extremes = [-np.mean(pattern["standard"])], [-value for value in spread(pattern["standard"])][::-1]
    PAGE.assert_sentence(
        "are # % below those of the finest run's on average (# to # %)", *below, *extremes, tolerance=0.06
    )
    extremes = [-value for value in spread(pattern["fine"])][::-1]
    PAGE.assert_sentence("those of `fine` # % (# to # %)", -np.mean(pattern["fine"]), *extremes, tolerance=0.06)


def test_the_answer_at_the_top():
    for level, sentence in (("standard", "`standard` by # to # %, `fine`"), ("fine", "`fine` by # to # %, roughly")):
        PAGE.assert_sentence(sentence, *spread([-error for error in per_cent(level, "its index")]), tolerance=0.5)
    (corrected,) = PAGE.numbers("`--estimate` corrects that to within # %")
    assert max(abs(error) for level in ("standard", "fine") for error in per_cent(level, "corrected")) <= corrected
    indices = [row["GI"].split(" ± ") for row in PAGE.tsv_rows("spread") if row["g"] == 2]
    deviations = spread(100 * float(sd) / float(mean) for mean, sd in indices)
    PAGE.assert_sentence("by # to # % of GI (standard deviation of three seeds at g = 2)", *deviations, tolerance=0.06)
    changes = [row["change 2"] for row in PAGE.tsv_rows("convergence") if row["meshes"] == "standard → fine"]
    largest = max(abs(float(change.removesuffix(" %"))) for change in changes if change != "–")
    (agreement,) = PAGE.numbers("`standard` and `fine` of one seed agree to # %")
    assert agreement - 1.5 < largest < agreement


def test_the_error_of_the_mesh_is_of_first_order():
    """Between each two of the five meshes, and at both growths, the index rises alike over the edge."""
    least, most = PAGE.numbers("gains # to # in GI for each T")
    for row in PAGE.tsv_rows("edges"):
        edges, indices = (np.array(values) for values in zip(*by_edge(row["carried, by edge"]).items()))
        slopes = -np.diff(indices) / np.diff(edges)
        assert least <= slopes.min() < slopes.max() <= most
        coarse, fine = (limit_of_line(dict(zip(edges[part], indices[part]))) for part in (slice(2), slice(-2, None)))
        (apart,) = PAGE.numbers("lead differ by less than # %")
        assert abs(fine / coarse - 1) < apart / 100


def test_what_rest_gives_the_stage_with_the_largest_error():
    worst = min(CARRIED, key=lambda row: float(row["its index"].split("(")[1].split(" %")[0]))
    held = next(iter(by_edge(worst["its folds by edge"]).values()))  # on a mesh like its own
    risen = 100 * (held / float(worst["its index"].split()[0]) - 1)
    assert worst["run"] == "standard"
    PAGE.assert_sentence("held, its index rises by # %", risen, tolerance=0.1)
    warnings = [row["warnings"] for row in PAGE.tsv_rows("runs")]
    assert all(warning.startswith("not at rest") and ";" not in warning for warning in warnings)
    PAGE.assert_sentence("would move on by more than # T", LARGEST_REST_DISTANCE_OVER_T)


def test_the_meshes_of_the_page():
    levels = [LEVELS[level] for level in ("draft", "standard")]
    PAGE.assert_sentence(
        "`draft` and `standard` have edges of # and # T, with # and # elements through the cortex; `fine` has nested "
        "meshes of # and # T",
        *levels,
        *map(elements_through, levels),
        LEVELS["standard"],
        LEVELS["fine"],
    )
    PAGE.assert_sentence("carried to edges of #, # and # T", *EDGES_OF_LIMIT)
    PAGE.assert_sentence("held there for # crossings", HOLD_TICKS)
