"""Sentences of docs/hemisphere.md have the numbers of the tables there, which runs write."""

from morphofold.studies.page_sentences import Page, spread

PAGE = Page("hemisphere")


def test_growth_that_would_fold_like_a_person():
    ((*rows,),) = PAGE.tables("inferences")
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
    PAGE.assert_sentence("had before growth (# to #).", *folds["none: unfolded"])
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
    PAGE.assert_sentence("different seeds correlate by # to #, even ones by # to #.", *between)
    pairs = lambda column: [numbers({column: row[column].removesuffix(" %")}, column) for row in by_growth["30 %"]]
    (valleys, chance), (crests, chance_of_crests) = (
        zip(*pairs(column)) for column in ("valleys, by chance", "crests, by chance")
    )
    PAGE.assert_sentence(
        "within 3 mm (# to # % and # to # % at 30 %; by chance # to # % and # to # %).",
        *(number for shares in (valleys, crests, chance, chance_of_crests) for number in spread(shares)),
    )
