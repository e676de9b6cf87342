"""Sentences of docs/thickness.md have the numbers of the tables beside it, which runs write."""

from scipy import stats

from morphofold.studies.page_sentences import Page, spread

PAGE = Page("thickness")
THICKNESS = {"fig6-thin": 1.0, "fig5": 2.0, "fig6-thick": 3.0}  # of the cortex before growth [mm]


def test_waves_and_gyri_over_the_thickness():
    rows = PAGE.tsv_rows("folds")
    waves = lambda g: spread([row["over T"] for row in rows if row["g"] == g])
    PAGE.assert_sentence("waves are # to # T long at first and # to # T", *waves(1.3), *waves(2.0), tolerance=0.051)
    widths = [row["gyral thickness, mm"] / THICKNESS[row["scene"]] for row in rows if row["g"] >= 1.5]
    PAGE.assert_sentence("gyri are # to # T wide from g = 1.5 on", *spread(widths), tolerance=0.051)
    shorter = [100 * (1 - row["over T"] / row["theory, over T"]) for row in rows if row["g"] == 1.3]
    PAGE.assert_sentence("The first waves are # to # % shorter than", *spread(shorter), tolerance=0.5)
    assert all(after > before for before, after in zip(waves(1.3), waves(2.0)))


def test_slopes_and_their_error():
    rows = [row for row in PAGE.tsv_rows("slope") if row["of"] == "wavelength"]
    differences = [100 * abs(row["slope, mm/mm"] / row["theory"] - 1) for row in rows]
    PAGE.assert_sentence("The slopes lie within # % of that of linear stability", max(differences), tolerance=0.1)
    (n_points,) = {row["points"] for row in rows}
    PAGE.assert_sentence("(95 % is # standard errors)", stats.t.ppf(0.975, n_points - 2), tolerance=0.05)
