"""Sentences of docs/accuracy.md have the numbers of the tables there, which runs write."""

import re

from morphofold.studies.page_sentences import Page

PAGE = Page("accuracy")


def test_errors_of_the_presets():
    rows = {(row["subject"], row["quantity"], row["against"]): row for row in PAGE.tsv_rows("presets")}
    error = lambda quantity, against, level: float(
        re.search(r"(-?[\d.e+]+) %", rows["fig6-thick, octant", quantity, against][level])[1]
    )
    levels = ("draft", "standard", "fine", "finest")
    index, wave = (
        [[error(f"{name}, g = {g}", "finest mesh", level) for level in levels] for g in ("2", "1.5")]
        for name in ("gyrification index", "wavelength")
    )
    own = [
        [error(f"gyrification index, g = {g}", "limit of its folds", level) for level in levels] for g in ("2", "1.5")
    ]
    PAGE.assert_sentence(
        "of the four differs by #, #, # and # % (#, #, # and # % at g = 1.5)", *index[0], *index[1], tolerance=0.51
    )
    PAGE.assert_sentence("wavelength by #, #, # and # % (#, #, # and # %)", *wave[0], *wave[1], tolerance=0.51)
    PAGE.assert_sentence("alone the index is #, #, # and # % low (#, #, # and # %)", *own[0], *own[1], tolerance=0.11)
