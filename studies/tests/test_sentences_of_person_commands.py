"""Sentences of docs/commands/infer.md and unfold.md have the numbers of the code."""

from dataclasses import fields

from morphofold.cli.command_options import Infer
from morphofold.studies.page_sentences import Page
from morphofold.unfolding.harmonics import DEGREE
from morphofold.unfolding.unfold import LEAST_RADIUS_OVER_T


def test_an_inference_grows_as_many_bodies_as_its_page_says():
    default = {field.name: field.default for field in fields(Infer)}
    n_bodies = (1 + len(default["heterogeneity"])) * default["seeds"] + default["rotations"]
    Page("commands/infer").assert_sentence("By default # bodies grow", n_bodies)


def test_an_unfolding_has_the_degree_and_the_room_for_a_cortex_that_its_page_names():
    page = Page("commands/unfold")
    page.assert_sentence("spherical harmonics up to degree #, ", DEGREE)
    page.assert_sentence("than the least convex radius over # (`thickest_cortex_mm`)", LEAST_RADIUS_OVER_T)
