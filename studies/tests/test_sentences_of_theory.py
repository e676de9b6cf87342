"""Sentences of docs/theory.md have the numbers of the tables there, which runs write."""

import numpy as np

from morphofold.studies.page_sentences import Page, spread

PAGE = Page("theory")


def test_spacing_of_folds_in_theory():
    ((*rows,),) = PAGE.tables("spacing")
    by = lambda column, law, ratio, least_g=0.0: [
        row[column] for row in rows if row["law"] == law and row["ratio"] == ratio and row["g"] >= least_g
    ]
    firsts = {
        ratio: max(by("over the thickness now", law, ratio)[0] for law in ("isotropic", "tangential")) for ratio in (4,)
    }
    soft = min(by("over the thickness now", law, 0.7)[0] for law in ("isotropic", "tangential"))
    PAGE.assert_sentence("from # (ratio 0.7) to # (ratio 4) at the first folds", soft, firsts[4])
    late = [row["over the thickness now"] for row in rows if row["g"] == 2.2]
    PAGE.assert_sentence("down to # to # at g = 2.2.", *spread(late), tolerance=0.11)
    before = lambda *ratios: spread(
        [value for ratio in ratios for value in by("best wavelength / T", "tangential", ratio, 1.6)]
    )
    PAGE.assert_sentence(
        "from g = 1.6 on: # to # at the ratios 0.7 and 1, # to # at 2, # to # at 4.",
        *before(0.7, 1),
        *before(2),
        *before(4),
        tolerance=0.11,
    )
    grown = spread([row["best wavelength / T"] for row in rows if row["law"] == "isotropic"])
    PAGE.assert_sentence("the spacing grows with it, from # to #.", *grown, tolerance=0.5)


def test_waves_of_a_core_that_grows_by_its_stress():
    ((*rows,),) = PAGE.tables("stress-growth")
    ends = [row["wavelength / T: simulated"] for row in rows if row["rate"] in (0, 300)]
    PAGE.assert_sentence("rises from # to # T at equal stiffness, from # to # T at ratio 4:", *ends, tolerance=0.06)
    at = {(row["ratio"], row["rate"]): row["wavelength / T: simulated"] for row in rows}
    powers = [np.log(at[ratio, 300] / at[ratio, 100]) / np.log(3) for ratio in (1, 4)]
    PAGE.assert_sentence("from 100 to 300 with the power # and #.", *powers, tolerance=0.006)
