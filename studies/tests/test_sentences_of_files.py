"""Sentences of docs/files.md have the numbers of the code."""

import math

from morphofold.comparison.person.common_sphere import RELIEF_SCALE_MM
from morphofold.io.cortices import OPPOSITE_R
from morphofold.io.json_files import LARGEST_NUMBER
from morphofold.results.layouts import NEW_DESCRIPTION
from morphofold.results.unfolding import SPHERE_RADIUS_MM
from morphofold.studies.page_sentences import Page
from morphofold.tables import cell

PAGE = Page("files")


def test_limits_are_those_of_the_code():
    PAGE.assert_sentence("is less than #, and a mostly negative `thickness`", OPPOSITE_R, tolerance=0)
    PAGE.assert_sentence("(radius # mm)", SPHERE_RADIUS_MM)
    PAGE.assert_sentence("above the surface smoothed over # mm", RELIEF_SCALE_MM)
    assert "beyond 10¹² or negative" in PAGE.prose
    assert LARGEST_NUMBER == 10**12
    assert "seven digits" in PAGE.prose
    assert cell(math.pi) == "3.141593"
    assert "BIDS 1.11 has no names yet" in PAGE.prose
    assert NEW_DESCRIPTION["BIDSVersion"].startswith("1.11.")
