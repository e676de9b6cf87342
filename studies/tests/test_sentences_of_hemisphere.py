"""Sentences of docs/hemisphere.md have the numbers of the tables there, which runs write, and of the code."""

from morphofold.analysis.multiple_tests import SIGNIFICANCE
from morphofold.comparison.person.common_sphere import DEEPENED_FROM, RELIEF_SCALE_MM
from morphofold.comparison.person.fold_heights import FOLD_DEGREES, VALLEY_DISTANCE_MM
from morphofold.comparison.person.person_agreement import SPINS
from morphofold.sim.hemisphere.hemisphere_body import FADE_OVER_RADIUS
from morphofold.sim.hemisphere.subject_maps import THICKEST, THINNEST
from morphofold.sim.scene.geometries import UnfoldedCortex
from morphofold.sim.scene.table_bases import SphereMap
from morphofold.studies.page_sentences import Page, spread
from morphofold.studies.person import ferret
from morphofold.studies.person.equal_area_parcels import N_PARCELS
from morphofold.studies.person.hemisphere_study import GROWTH
from morphofold.unfolding.unfold import LEAST_RADIUS_OVER_T

PAGE = Page("hemisphere")


def test_growth_that_would_fold_like_a_person():
    rows = PAGE.tsv_rows("inferences")
    numbers = lambda row, column: [float(text) for text in str(row[column]).split(", ")]
    by_growth = {}
    for row in rows:
        by_growth.setdefault(row["growth"], []).append(row)
    folds = {
        growth: spread([number for row in members for number in numbers(row, "folds, of each seed")])
        for growth, members in by_growth.items()
    }
    at_spreads = [number for growth in ("30 %", "20 %", "10 %") for number in folds[growth]]
    PAGE.assert_sentence("correlation is # to # at 30 %, # to # at 20 % and # to # at 10 %.", *at_spreads)
    PAGE.assert_sentence(
        "Even growth has # to # and turned maps # to #, less", *folds["even"], *folds["30 %, map turned"]
    )
    PAGE.assert_sentence("correlate with the person's by # to #, less than", *folds["even"])
    PAGE.assert_sentence("(# to # if growth differs by 30 %)", *folds["30 %"])
    PAGE.assert_sentence("had before growth (# to #).", *folds["none: unfolded"])
    assert folds["even"][1] < folds["none: unfolded"][0]
    PAGE.assert_sentence("without growth, have # to #, which", *folds["none: sulci deepened"])
    p_of = lambda growth, who: spread(
        [
            p
            for row in by_growth[growth]
            if row["hemisphere"].startswith(who)
            for p in numbers(row, "p, more than deepened")
        ]
    )
    PAGE.assert_sentence("from every seed with p of # to #, at", *p_of("30 %", "S1"), tolerance=0.006)
    PAGE.assert_sentence("only some runs (# to #).", *p_of("20 %", "S1"), tolerance=0.006)
    PAGE.assert_sentence("but with p of # to #: no result", *p_of("30 %", "fsaverage"), tolerance=0.006)
    assert p_of("30 %", "S1")[1] < 0.05 < p_of("20 %", "S1")[1]
    between = [
        number for growth in ("30 %", "even") for number in spread([row["between seeds"] for row in by_growth[growth]])
    ]
    PAGE.assert_sentence("different seeds correlate by # to # at 30 %, even ones by # to #.", *between)
    pairs = lambda column: [numbers({column: row[column].removesuffix(" %")}, column) for row in by_growth["30 %"]]
    (valleys, chance), (crests, chance_of_crests) = (
        zip(*pairs(column)) for column in ("valleys, by chance", "crests, by chance")
    )
    PAGE.assert_sentence(
        "within 3 mm (# to # % and # to # % at 30 %; by chance # to # % and # to # %).",
        *(number for shares in (valleys, crests, chance, chance_of_crests) for number in spread(shares)),
    )


def test_the_rows_of_the_page_are_those_of_the_table_beside_it():
    for name in ("inferences", "meshes"):
        ((*shown,),) = PAGE.tables(name)
        all_rows = PAGE.tsv_rows(name)
        assert shown
        assert all(row in all_rows for row in shown)


def test_walls_of_a_head():
    runs = {(row["law"], row["walls"]): row for row in PAGE.tsv_rows("walls")}
    at_2 = lambda walls: [
        float(runs["tangential", walls][f"{measure} at g = 1.5, 1.75, 2"].split(", ")[2]) for measure in ("flare", "GI")
    ]
    (flare, gi), (flare_in_skull, gi_in_skull) = at_2("none"), at_2("skull")
    PAGE.assert_sentence(
        "the skull lowers the flare from # to # and raises the gyrification index (GI) from # to #; the midline alone "
        "changes neither",
        *(flare, flare_in_skull, gi, gi_in_skull),
    )
    assert all(abs(beside - alone) < 0.02 for beside, alone in zip(at_2("midline"), (flare, gi)))
    assert all(int(row["crossings at g = 2"]) > 0 for (_, walls), row in runs.items() if walls in ("skull", "both"))


def test_thicker_cortex_wider_gyri():
    ((*rows,),) = PAGE.tables("fig8-grown")
    *of_hemispheres, pair, _ = rows
    PAGE.assert_sentence("with the thickness to the [power #]", pair["slope"])
    PAGE.assert_sentence(
        "to the power # (# to # by hemisphere; the interval takes all # pairs as independent)",
        *(pair["slope"], *spread([row["slope"] for row in of_hemispheres]), pair["parcels or pairs"]),
    )
    PAGE.assert_sentence("In # parcels the ratio", N_PARCELS)


def test_a_ferret():
    ((*rows,),) = PAGE.tables("ferret")
    published, ours = ([row[column] for row in rows] for column in ("published", "ours, mean"))
    rises = (values[-1] - values[0] for values in (published, ours))
    PAGE.assert_sentence("rises by # over their stages, ours by #.", *rises, tolerance=0.006)
    PAGE.assert_sentence(
        "Ours is lower by # to #, perhaps", *spread([p - o for p, o in zip(published, ours)]), tolerance=0.006
    )
    (level,) = [setting.partition("=")[2] for setting in ferret.SETTINGS if setting.startswith("geometry.unfold=")]
    PAGE.assert_sentence("We grow the same one, unfolded at #.", float(level))


def test_what_the_mesh_changes():
    rows = PAGE.tsv_rows("meshes")
    PAGE.assert_sentence("`hemisphere-soft` at g = #;", GROWTH)
    assert all(row["healthy"] == 1 for row in rows)
    per_cent = lambda column, finer: [
        100 * (rows[k + finer][column] / rows[k + finer - 1][column] - 1) for k in range(0, len(rows), 3)
    ]
    gi = [number for finer in (1, 2) for number in spread(per_cent("GI", finer))]
    widths = [max(map(abs, per_cent("gyral thickness, mm", finer))) for finer in (1, 2)]
    PAGE.assert_sentence(
        "it rises by # to # % from draft to standard and by # to # % from standard to fine, gyral thickness changes "
        "by at most # % and # %.",
        *gi,
        *widths,
        tolerance=0.5,
    )


def test_numbers_of_the_body_and_of_the_comparison_are_those_of_the_code():
    default = lambda name: UnfoldedCortex.model_fields[name].default
    PAGE.assert_sentence("`radius` (# mm; only ratios matter)", default("radius"))
    PAGE.assert_sentence("a hole of # of the size", default("hole_share"))
    PAGE.assert_sentence("Growth is full from # radii off its rim", FADE_OVER_RADIUS)
    PAGE.assert_sentence("with a radius below # thicknesses", LEAST_RADIUS_OVER_T)
    PAGE.assert_sentence("over its mean, within # and #", THINNEST, THICKEST)
    PAGE.assert_sentence("up to `degree` (# by default", SphereMap.model_fields["degree"].default)
    PAGE.assert_sentence("smoothed over # mm, in harmonic degrees # to #.", RELIEF_SCALE_MM, *FOLD_DEGREES)
    PAGE.assert_sentence("the person's within # mm of a grown one", VALLEY_DISTANCE_MM)
    PAGE.assert_sentence("times 1 + (l (l + 1) / #)²", DEEPENED_FROM)
    PAGE.assert_sentence("the smooth body with p < #, *deepened*", SIGNIFICANCE)
    PAGE.assert_sentence("from # random rotations", SPINS)
