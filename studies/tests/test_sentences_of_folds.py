"""Sentences of docs/folds.md have the numbers of the tables there, which runs write."""

import numpy as np

from morphofold.studies.page_sentences import Page, spread

PAGE = Page("folds")


def test_bias_and_pattern_of_folds():
    (rows,) = PAGE.tables("carried")
    per_cent = lambda level, column: [
        float(row[column].split("(")[1].split(" %")[0]) for row in rows if row["run"] == level
    ]
    standard, fine = (per_cent(level, "its index") for level in ("standard", "fine"))
    low, high = spread([-error for error in standard])
    PAGE.assert_sentence(
        "So `standard` is # to # % too low, # on average", low, high, -np.mean(standard), tolerance=0.051
    )
    PAGE.assert_sentence("`fine` is # to # % too low, corrected", *spread([-error for error in fine]))
    PAGE.assert_sentence("corrected it is within # % of the limit", max(map(abs, per_cent("standard", "corrected"))))
    PAGE.assert_sentence("corrected within # %: the limit", max(map(abs, per_cent("fine", "corrected"))))
    pattern = {
        level: [100 * (row["limit"] / row["limit of finest run"] - 1) for row in rows if row["run"] == level]
        for level in ("standard", "fine")
    }
    below, extremes = [-np.mean(pattern["standard"])], [-value for value in spread(pattern["standard"])][::-1]
    PAGE.assert_sentence(
        "are # % below those of the finest run's on average (# to # %)", *below, *extremes, tolerance=0.06
    )
    extremes = [-value for value in spread(pattern["fine"])][::-1]
    PAGE.assert_sentence("those of `fine` # % (# to # %)", -np.mean(pattern["fine"]), *extremes, tolerance=0.06)
