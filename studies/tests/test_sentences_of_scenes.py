"""Sentences of docs/scenes.md have the numbers of the code."""

from morphofold.sim import rigid_shells, scene
from morphofold.sim.effects import stress_growth
from morphofold.sim.mesh import checked_tets
from morphofold.sim.scene import table_bases
from morphofold.sim.scene.effect_registry import DEFAULT_MATERIAL
from morphofold.studies.page_sentences import Page

PAGE = Page("scenes")


def test_limits_of_lengths_bricks_and_cuts():
    bounds = table_bases.SHORTEST_LENGTH_MM, table_bases.LONGEST_LENGTH_MM
    PAGE.assert_sentence("A *length* is in mm, from # to #.", *bounds, tolerance=0)
    PAGE.assert_sentence("More than # million bricks are refused.", scene.MOST_BRICKS / 1e6)
    assert f"must be flat within {checked_tets.PLANE_TOLERANCE:.0e}".replace("e-0", "e-") in PAGE.prose
    shape = scene.SHAPES["sphere"].model_fields["shape"].default
    assert f'(default `"{shape}"`), `model` of `[material]` the material (default `"{DEFAULT_MATERIAL}"`)' in PAGE.prose


def test_a_core_that_follows_and_a_skull():
    PAGE.assert_sentence("a rate above # μ/κ is refused", stress_growth.FASTEST_RELAXATION / 3, tolerance=5)
    assert stress_growth.LEAST_TICKS_PER_UNIT == 2 * scene.CROSSINGS_PER_UNIT_GROWTH  # "twice as long or more"
    assert "growth takes twice as long or more" in PAGE.prose
    PAGE.assert_sentence("a spacing h of 1/# of the radius", 1 / rigid_shells.SPACING_SHARE)
