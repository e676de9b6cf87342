"""Sentences of docs/laws.md have the numbers of the tables beside it, which runs write, and of the code."""

import numpy as np
from scipy import stats

from morphofold.analysis.gyrification.across_scales import FIRST_SCALES_MM, LARGEST_SCALE_MM
from morphofold.sim.scene.scene_files import load_scene
from morphofold.studies import fibre_study, folding_laws
from morphofold.studies.page_sentences import Page, spread

PAGE = Page("laws")


def test_laws_of_mammals_and_primates():
    mammals = folding_laws.species()
    extremes = [10 ** (mammals.mean_k + sign * mammals.sd_k) for sign in (-2, 2)]
    PAGE.assert_sentence("k between # and # (mean #, two", *extremes, 10**mammals.mean_k, tolerance=0.006)
    line = stats.linregress(np.log10(mammals.exposed_area), np.log10(mammals.scaled_area))
    PAGE.assert_sentence("Their # mammals", len(mammals.exposed_area))
    PAGE.assert_sentence("free slope has # (standard error #)", line.slope, line.stderr)
    areas = stats.linregress(np.log10(mammals.primate_volume), np.log10(mammals.primate_area))
    PAGE.assert_sentence("areas of # cerebra of primates", len(mammals.primate_area))
    PAGE.assert_sentence("rise with the volume to the power of #.", areas.slope, tolerance=0.006)


def test_the_folding_law_through_growth():
    growth = PAGE.tsv_rows("growth")
    isotropic, tangential = ([row for row in growth if law in row["body"]] for law in ("isotropic", "tangential"))
    entries = [row["in the range of mammals from"] for row in (*isotropic[::-1], tangential[-1])]
    PAGE.assert_sentence(
        "of their size at g = #, # and #, thick ones first; with tangential growth only the thickest does, at #.",
        *entries,
    )
    PAGE.assert_sentence("enter the range of mammals at g = # to # |", *spread(entries[:3]), tolerance=0.051)
    assert [row["in the range of mammals from"] for row in tangential[:-1]] == ["–", "–"]
    before, after = ([row[g] for row in growth] for g in ("1", "2"))
    differences = [max(before) - min(before), *(max(after[k : k + 3]) - min(after[k : k + 3]) for k in (0, 3))]
    PAGE.assert_sentence(
        "K differs by # before growth and, at g = 2, by # (isotropic) or # (tangential)", *differences, tolerance=0.011
    )
    slopes = spread([row["slope at the end"] for row in growth])
    PAGE.assert_sentence("rises # to # times as fast as that of the exposed area", *slopes)


def test_the_folding_law_across_scales():
    scales = PAGE.tsv_rows("scales")
    person, average, shell = scales[:3]
    PAGE.assert_sentence("their # scales from # to # mm", person["scales"], FIRST_SCALES_MM[0], LARGEST_SCALE_MM)
    exponents = {g: spread([row["exponent"] for row in scales if row["g"] == g]) for g in (1.4, 1.6, 1.8, 2.0)}
    numbers = [number for g in (1.4, 1.8, 2.0) for number in exponents[g][::-1]]
    PAGE.assert_sentence(
        "from between # and # at g = 1.4 to between # and # at g = 1.8 and between # and # at g = 2.", *numbers
    )
    assert exponents[1.6][0] > -0.5 > exponents[2.0][1]
    PAGE.assert_sentence("It passes -1/2 between g = # and #,", 1.6, 2.0)
    PAGE.assert_sentence("S1 has #; its right hemisphere", person["exponent"])
    PAGE.assert_sentence("averaged away, has #.", average["exponent"])
    PAGE.assert_sentence(
        "nearly: # to # at g = 2; a body without folds has # | a person: # |",
        *exponents[2.0][::-1],
        shell["exponent"],
        person["exponent"],
    )


def test_how_far_apart_folds_are():
    spacing = PAGE.tsv_rows("spacing")
    bodies, person = spacing[:-2], spacing[-2]
    now = spread([row["over the thickness now"] for row in bodies])
    PAGE.assert_sentence("folds of spheres are # to # apart", *now)
    wide = person["over the thickness now"]
    PAGE.assert_sentence("# to # of the thickness now, on spheres | a person: # |", *now, wide)
    before = [row["over the thickness before growth"] for row in bodies]
    ratios = [isotropic / tangential for isotropic, tangential in zip(before[:6], before[6:], strict=True)]
    PAGE.assert_sentence("they are # to # times as far apart", *spread(ratios), tolerance=0.06)
    PAGE.assert_sentence("Folds of S1 are wider, # thicknesses; those", wide)


def test_the_bodies_with_fibres_are_those_of_the_study():
    (growth,) = [setting.removeprefix("growth.final=") for setting in fibre_study.BODY_SETTINGS if "final" in setting]
    thickness = load_scene("demo").geometry.cortex_thickness
    PAGE.assert_sentence("Spheres of radius # mm, cortex # mm, both", fibre_study.BODY_RADIUS_MM, thickness)
    PAGE.assert_sentence("isotropic growth to #. Below # evenly", float(growth), fibre_study.N_BUNDLES)
    PAGE.assert_sentence("Within # mm of its axis it is at least half", fibre_study.BUNDLE_RADIUS_MM / 2)
    share = fibre_study.N_BUNDLES * (1 - fibre_study.NEAR_COSINE) / 2  # of caps on the sphere
    PAGE.assert_sentence("turned at random, # times: # % of all", fibre_study.N_ROTATIONS, 100 * share, tolerance=0.01)


def test_what_lies_over_bundles():
    rows = {row["fibres"]: row for row in PAGE.tsv_rows("fibres")}
    strong, weak = (rows[f"grow by 1.3, modulus {modulus}"] for modulus in (10, 2))
    hinges, crests, depth = (f"over bundles: {title}" for title in fibre_study.TITLES)
    interval_of_depth = [[float(x) for x in row["less chance, 95 % 2"].split(" to ")] for row in rows.values()]
    chance_depth = [row[depth] - np.mean(interval) for row, interval in zip(rows.values(), interval_of_depth)]
    PAGE.assert_sentence("mean sulcal depth of # mm", np.mean(chance_depth), tolerance=0.06)
    often = [row[column] / 5 for column in (hinges, crests) for row in (strong, weak)]
    PAGE.assert_sentence("to 1.3: # times as often as by chance at modulus 10, # times", *often[:2], tolerance=0.06)
    PAGE.assert_sentence("follow nearly as often (# and # times)", *often[2:], tolerance=0.06)
    PAGE.assert_sentence("alone (# % of hinges against # % of crests)", strong[hinges], strong[crests])
    stiff = rows["do not grow, modulus 50"]
    PAGE.assert_sentence("(modulus 50: # % of crests)", stiff[crests])
    growing, still = ([row for name, row in rows.items() if name.startswith(kind)] for kind in ("grow", "do not grow,"))
    still = [row for row in still if "pull" not in row["fibres"]]
    assert all(row[depth] < 4.0 and row["p 2"] == 0.001 for row in growing)  # all end in gyri
    assert all(row[hinges] < 2 and abs(row[depth] - 4.5) < 0.5 for row in still)
    assert all(row[hinges] < 5.1 for row in growing if row not in (strong, weak))  # hinges follow only the strongest
    slow, none = rows["grow by 1.1, modulus 10"], rows["no fibres"]
    assert slow["p"] > 0.05
    assert float(slow[crests]) > 6
    assert min(none["p"], none["p 2"]) > 0.05


def test_the_rows_of_the_page_are_rows_of_the_tables_beside_it():
    for mark in ("growth", "scales", "spacing", "fibres"):
        (shown,), rows = PAGE.tables(mark), PAGE.tsv_rows(mark)
        assert 3 <= len(shown) <= 5
        assert all(row in rows for row in shown)
