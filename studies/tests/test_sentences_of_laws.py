"""Sentences of docs/laws.md have the numbers of the tables there, which runs write."""

from morphofold.studies.page_sentences import Page, spread

PAGE = Page("laws")


def test_laws_through_growth_and_across_scales():
    (growth,), (scales,), (spacing,) = (PAGE.tables(mark) for mark in ("growth", "scales", "spacing"))
    isotropic, tangential = ([row for row in growth if law in row["body"]] for law in ("isotropic", "tangential"))
    entries = [row["in the range of mammals from"] for row in (*isotropic[::-1], tangential[-1])]
    PAGE.assert_sentence(
        "of their size at g = #, # and #, thick ones first; with tangential growth only the thickest does, at #.",
        *entries,
    )
    assert [row["in the range of mammals from"] for row in tangential[:-1]] == ["–", "–"]
    before, after = ([row[g] for row in growth] for g in ("1", "2"))
    differences = [max(before) - min(before), *(max(after[k : k + 3]) - min(after[k : k + 3]) for k in (0, 3))]
    PAGE.assert_sentence(
        "K differs by # before growth and, at g = 2, by # (isotropic) or # (tangential)", *differences, tolerance=0.011
    )
    exponents = {g: spread([row["exponent"] for row in scales if row["g"] == g]) for g in (1.4, 1.8, 2.0)}
    numbers = [number for low, high in exponents.values() for number in (high, low)]
    PAGE.assert_sentence(
        "from between # and # at g = 1.4 to between # and # at g = 1.8 and between # and # at g = 2, for", *numbers
    )
    person, average, shell = scales[:3]
    PAGE.assert_sentence("S1 has # on the left", person["exponent"])
    PAGE.assert_sentence("averaged away, #.", average["exponent"])
    PAGE.assert_sentence("a body without folds has #", shell["exponent"])
    PAGE.assert_sentence(
        "spheres have # to #: fewer", *spread([row["over the thickness now"] for row in spacing[:-2]]), tolerance=0.06
    )
    PAGE.assert_sentence(
        "Folds of S1 are wider, # thicknesses; those", spacing[-2]["over the thickness now"], tolerance=0.06
    )
