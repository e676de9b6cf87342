"""Sentences of docs/tutorial-group.md have the numbers of the population that is made."""

from morphofold.shapes.population import Population
from morphofold.studies.page_sentences import Page

PAGE = Page("tutorial-group")


def test_the_planted_effect_and_the_error_of_registration_are_those_of_the_population():
    PAGE.assert_sentence("The left loses up to # mm a year", Population.thinning, tolerance=0)
    PAGE.assert_sentence("smaller than the # mm a year that were planted", Population.thinning, tolerance=0)
    PAGE.assert_sentence("of these subjects by # degrees everywhere", Population.registration, tolerance=0)
