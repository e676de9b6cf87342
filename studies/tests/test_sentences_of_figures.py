"""Sentences of docs/figures.md have the numbers of the tables there, which runs write."""

import numpy as np

from morphofold.studies.page_sentences import Page, spread

PAGE = Page("figures")


def first(rows, growth=None):
    """Rows of each body at its first growth, or at one."""
    by_body = {}
    for row in rows:
        if growth in (None, row["g"]):
            by_body.setdefault(next(iter(row.values())), row)
    return [*by_body.values()]


def test_the_film_formula_and_the_waves_that_form():
    waves, sizes = [], []
    for figure in ("fig6", "fig7"):
        stages, _, theory, *_ = PAGE.tables(figure)
        waves += theory
        sizes += first(stages)
    excess = [
        100 * (w["by the film formula"] * s["cortex, mm"] / s["wavelength, mm"] - 1) for w, s in zip(waves, sizes)
    ]
    PAGE.assert_sentence("picture it gives waves # to # % too long", *spread(excess), tolerance=0.6)
    of_fig6 = PAGE.tables("fig6")[2]
    PAGE.assert_sentence("gives # to # T, and waves", *spread([row["by theory 2"] for row in of_fig6]), tolerance=0.06)
    PAGE.assert_sentence(
        "and waves of # to # T form", *spread([row["wavelength / T"] for row in of_fig6]), tolerance=0.06
    )


def test_the_first_pictures_of_soft_and_stiff_cortices():
    stages, seeds, theory = PAGE.tables("fig7")
    rows = first(stages)
    PAGE.assert_sentence(
        "the height has an rms of # to # mm at every ratio", *spread([row["rms, mm"] for row in rows]), tolerance=0.06
    )
    ends = [[float(x) for x in row["skewness"].split(" to ")] for row in first(seeds)]
    assert [round(np.mean(pair), 1) for pair in ends[:2]] == [-1.9, -1.2]
    PAGE.assert_sentence("skewness is -1.9, -1.2 and # to #, in", *ends[2][::-1], tolerance=0.06)
    waits = [row["walls touch, g"] - row["wrinkles by theory, g"] for row in theory]
    assert waits[0] < 0.01
    PAGE.assert_sentence("at ratio 2 after # of growth, at ratio 4 after #.", *waits[1:], tolerance=0.006)


def test_gyral_thickness_of_models():
    rows = PAGE.tables("fig8")[0]
    bodies = [row for row in rows if row["surface"].startswith("T = ")]
    (models,) = [row for row in rows if row["surface"] == "models"]
    PAGE.assert_sentence(
        "the gyri of models are # to # times", *spread([row["at crests"] for row in bodies]), tolerance=0.06
    )
    PAGE.assert_sentence("from body to body: W = # t.", models["robust slope"], tolerance=0.006)
    PAGE.assert_sentence(
        "the ratio is # to # in the three models", *spread([row["at crests"] for row in bodies]), tolerance=0.06
    )
    averages = [row["at crests"] for row in rows if row["surface"].startswith("fsaverage5")]
    PAGE.assert_sentence("The average brain has # to #, because", *spread(averages), tolerance=0.06)
    assert all(row["robust slope"] < 0 for row in bodies)
    assert sum(row["to"] <= 0 for row in bodies) == 2


def test_hinges_of_models_and_of_the_person():
    thin, normal, thick, person = PAGE.tables("fig9")[0]
    densities = [row["per width²"] for row in (normal, thick, person, thin)]
    PAGE.assert_sentence(
        "of hinges (# and # per square of the crown width, the person #; the thin one has #)",
        *densities,
        tolerance=0.006,
    )
    angles = [row["median largest angle, degrees"] for row in (normal, person)]
    PAGE.assert_sentence("The largest angle is about #° in the bodies and #° in", *angles, tolerance=7)
    assert round(10 * thin["hinges"] / sum(row["hinges"] for row in (thin, normal, thick))) == 7
    PAGE.assert_sentence("With # hinges to choose from", person["with three arms"], tolerance=0.1)
