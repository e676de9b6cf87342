"""Sentences of docs/figures.md have the numbers of the tables beside it, which runs write, and of the code."""

import numpy as np

from morphofold.sim.stage_checks import LARGEST_REST_DISTANCE_OVER_T
from morphofold.studies.folds.fold_measures import FOLDED_RMS, PROMINENCE
from morphofold.studies.page_sentences import Page, spread

PAGE = Page("figures")


def first(rows, growth=None):
    """Rows of each body at its first growth, or at one."""
    by_body = {}
    for row in rows:
        if growth in (None, row["g"]):
            by_body.setdefault(next(iter(row.values())), row)
    return [*by_body.values()]


def ends(cell):
    """The least and the greatest number of a cell such as ``1.04 to 1.05``."""
    return [float(number) for number in cell.split(" to ")]


def test_the_first_waves_of_a_sphere_and_how_they_coarsen():
    (normal,) = [row for row in PAGE.tsv_rows("fig6-waves") if row["body"].startswith("normal")]
    PAGE.assert_sentence(
        "The first picture is # in g beyond", normal["first picture, g"] - normal["wrinkles by theory, g"]
    )
    start, *_, end = PAGE.tsv_rows("fig5")
    longer, fewer = end["wavelength, mm"] / start["wavelength, mm"] - 1, 1 - end["sulci"] / start["sulci"]
    PAGE.assert_sentence("waves lengthen by # % and # % of the sulci go", 100 * longer, 100 * fewer, tolerance=0.5)
    assert min(ends(PAGE.tsv_rows("fig5-seeds")[-1]["sulci"])) == end["sulci"]
    others = [row["g = 1.25"] for row in PAGE.tsv_rows("imperfections")]
    PAGE.assert_sentence("degrees of # to #, where theory has #", *spread(others), normal["by theory"])


def test_the_film_formula_and_the_waves_that_form():
    waves, sizes = [], []
    for figure in ("fig6", "fig7"):
        waves += PAGE.tsv_rows(f"{figure}-waves")
        sizes += first(PAGE.tsv_rows(figure))
    over_wave = [w["by the film formula"] / s["wavelength, mm"] for w, s in zip(waves, sizes)]
    excess = [100 * (ratio * s["cortex, mm"] - 1) for ratio, s in zip(over_wave, sizes)]
    PAGE.assert_sentence("picture it gives waves # to # % too long", *spread(excess), tolerance=0.6)
    shares = [w["by the film formula"] / w["wavelength / T"] for w in waves]
    PAGE.assert_sentence("growth it gives # to # of the length of the first waves", *spread(shares), tolerance=0.006)
    of_fig6 = PAGE.tsv_rows("fig6-waves")
    PAGE.assert_sentence("gives # to # T, and waves", *spread([row["by theory 2"] for row in of_fig6]), tolerance=0.06)
    PAGE.assert_sentence(
        "and waves of # to # T form", *spread([row["wavelength / T"] for row in of_fig6]), tolerance=0.06
    )
    assert all(row["r"] > 0.999 for row in PAGE.tsv_rows("fig6-slopes"))  # nearly linear in T


def test_thick_cortices_have_fewer_and_larger_folds():
    rows = first(PAGE.tsv_rows("fig6"), 2.0)
    for column, sign in {"sulci": -1, "wavelength, mm": 1, "gyral thickness, mm": 1, "rms, mm": 1}.items():
        assert all(np.diff([sign * row[column] for row in rows]) > 0)


def test_the_first_pictures_of_soft_and_stiff_cortices():
    stages, seeds, theory = (PAGE.tsv_rows(name) for name in ("fig7", "fig7-seeds", "fig7-waves"))
    rows = first(stages)
    PAGE.assert_sentence(
        "the height has an rms of # to # mm at every ratio", *spread([row["rms, mm"] for row in rows]), tolerance=0.06
    )
    first_of_seeds = first(seeds)
    skewness = [ends(row["skewness"]) for row in first_of_seeds]
    assert [round(np.mean(pair), 1) for pair in skewness[:2]] == [-1.9, -1.2]
    PAGE.assert_sentence("skewness is -1.9, -1.2 and # to #, in", *skewness[2][::-1], tolerance=0.06)
    waits = [row["walls touch, g"] - row["wrinkles by theory, g"] for row in theory]
    assert waits[0] < 0.01
    PAGE.assert_sentence("at ratio 2 after # of growth, at ratio 4 after #.", *waits[1:], tolerance=0.006)
    off = [
        max(abs(degree - row["by theory"]) for degree in ends(of_seeds["degree"]))
        for row, of_seeds in zip(theory, first_of_seeds)
    ]
    PAGE.assert_sentence("stability and within #, # and # of its degree", *off)
    late = [row["GI"] for row in first(stages, 2.0)]
    assert max(late) < 1.03 * min(late)  # hardly depends on the ratio


def test_gyral_thickness_of_models():
    rows = PAGE.tsv_rows("fig8")
    bodies = [row for row in rows if row["surface"].startswith("T = ")]
    (models,) = [row for row in rows if row["surface"] == "models"]
    (person,) = [row for row in rows if row["surface"] == "S1 lh"]
    PAGE.assert_sentence(
        "the gyri of models are # to # times as wide as the cortex is thick there, those of S1 # times",
        *spread([row["at crests"] for row in bodies]),
        person["at crests"],
        tolerance=0.06,
    )
    PAGE.assert_sentence("from body to body: W = # t.", models["robust slope"], tolerance=0.006)
    averages = [row for row in rows if row["surface"].startswith("fsaverage5")]
    PAGE.assert_sentence(
        "The average brain has # to #, because", *spread([row["at crests"] for row in averages]), tolerance=0.06
    )
    assert all(row[low] < 0 < row[high] for row in averages for low, high in (("from", "to"), ("from 2", "to 2")))
    assert all(row["robust slope"] < 0 for row in bodies)
    assert sum(row["to"] <= 0 for row in bodies) == 2
    assert person["from"] > 0


def test_hinges_of_models_and_of_the_person():
    thin, normal, thick, person = PAGE.tsv_rows("fig9-surfaces")
    densities = [row["per width²"] for row in (normal, thick, person, thin)]
    PAGE.assert_sentence(
        "of hinges (# and # per square of the crown width, the person #; the thin one has #)",
        *densities,
        tolerance=0.006,
    )
    angles = [row["median largest angle, degrees"] for row in (normal, person)]
    PAGE.assert_sentence("The largest angle is about #° in the bodies and #° in", *angles, tolerance=7)
    PAGE.assert_sentence("With # hinges to choose from", person["with three arms"], tolerance=0.1)
    model, _, net = PAGE.tsv_rows("fig9-nearest")
    there, back = "distance to the nearest on MRI, median", "from MRI to the nearest"
    PAGE.assert_sentence("the nearest is at # (median), from a random net", model[there])
    PAGE.assert_sentence("random points on a sphere) at #; from", net[there])
    PAGE.assert_sentence("from the person to models at #, to the net at #.", model[back], net[back])


def test_growing_models_do_not_obey_the_folding_law():
    rows = PAGE.tsv_rows("folding-law")
    for body in ("T = 1 mm", "T = 2 mm", "T = 3 mm"):
        assert all(np.diff([row[body] for row in rows]) > 0)  # k rises to the end


def test_bounds_are_those_of_the_code():
    PAGE.assert_sentence("once the rms of the height is # T", FOLDED_RMS)
    PAGE.assert_sentence("higher peak by # rms or more", PROMINENCE)
    PAGE.assert_sentence("would move by more than # T if growth stopped", LARGEST_REST_DISTANCE_OVER_T)
