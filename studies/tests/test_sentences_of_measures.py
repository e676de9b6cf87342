"""Sentences of docs/measures have the numbers of their tables, which runs write, and those of the code."""

import math
from itertools import pairwise

import pytest

from morphofold.analysis import curvatures, measuring, notes, region_tables
from morphofold.analysis.graph import depth_potential, hinges
from morphofold.analysis.graph.net_builder import GyralScales
from morphofold.analysis.graph.net_refinement import ARM_START_IN_WIDTHS, ARM_STOP_IN_WIDTHS
from morphofold.analysis.gyrification.local_gyrification import CLOSING_RADIUS_MM, REGION_RADIUS_MM
from morphofold.mesh_quality import cortex_checks, defects, repair
from morphofold.studies.crowns import COLUMN_HEADS, is_shown
from morphofold.studies.page_sentences import Page

THICKNESS, NET, INDEX = (Page(f"measures/{name}") for name in ("cortical-thickness", "gyral-net", "index"))


# cortical thickness


def test_crowns_are_thicker_than_fundi_but_where_the_page_says():
    rows = THICKNESS.tsv_rows("crowns")
    assert tuple(rows[0]) == COLUMN_HEADS
    person, models = rows[0], [row for row in rows if row["g"]]
    assert min(row["by columns"] for row in rows) > 1
    thinner = [row for row in models if row["crown / fundus"] < 1]
    THICKNESS.assert_sentence("by closest points in all but #, which are stiff and late", len(thinner), tolerance=0)
    ratio_of = lambda row: float(row["surface"].split(", ")[1])
    assert all(ratio_of(row) >= 4 and row["g"] == 2 for row in thinner)
    THICKNESS.assert_sentence("At the ratios 1 and 2 it passes that of the person, #.", person["crown / fundus"])
    for law in ("isotropic", "tangential"):
        at = {(ratio_of(row), row["g"]): row["crown / fundus"] for row in models if row["surface"].startswith(law)}
        ratios = sorted({ratio for ratio, _ in at})
        for g in (1.5, 2):  # "falls with growth and with stiffness"
            falling = [at[ratio, g] for ratio in ratios if (ratio, g) in at]
            assert all(later <= earlier + 0.01 for earlier, later in pairwise(falling))
        assert all(at[ratio, 2] < at[ratio, 1.5] for ratio in ratios if (ratio, 2) in at)
        assert all(at[ratio, 2] < person["crown / fundus"] < at[ratio, 1.5] for ratio in (1.0, 2.0))
    late = [row for row in models if ratio_of(row) >= 2 and row["g"] == 2]
    assert all(max(row["wall"], row["saddle"]) >= max(row["crown"], row["convex"]) for row in late)


def test_the_page_shows_the_rows_of_the_table_beside_that_matter():
    (shown,) = THICKNESS.tables("crowns")
    assert shown == [row for row in THICKNESS.tsv_rows("crowns") if is_shown([str(row["surface"])])]


def test_parts_and_cap_of_cortical_thickness():
    shares = (100 * (high - low) for low, high in region_tables.DEPTHS.values())
    THICKNESS.assert_sentence("the shallowest # % of the cortex by area, the middle # % and the deepest # %", *shares)
    THICKNESS.assert_sentence("warns if more than # % of the cortex is at the cap", 100 * defects.LARGEST_CAPPED_SHARE)


# curvature and gyrification


def test_scales_of_curvature_and_of_the_local_index():
    scale, least = curvatures.CURVATURE_SCALE_MM, curvatures.LEAST_FOLDING_SCALE_IN_EDGES
    Page("measures/curvature").assert_sentence("with a kernel of # mm (# mean edges where that is more)", scale, least)
    Page("tutorial-neuroimager").assert_sentence("by default it is # at a subject's own resolution", scale)
    Page("tutorial-neuroimager").assert_sentence("pial area within # mm of a vertex", REGION_RADIUS_MM)
    Page("measures/gyrification").assert_sentence(
        "the area within # mm over the area, there, of the closing by a ball of # mm",
        REGION_RADIUS_MM,
        CLOSING_RADIUS_MM,
    )


# the gyral net


def test_lengths_and_angles_of_the_net():
    NET.assert_sentence("less than # crown widths deep", GyralScales.of_width(1.0).persistence)
    NET.assert_sentence(
        "Y if all angles are within #° of 120°, T if one is #° or more and none less than #°",
        hinges.LARGEST_Y_DEVIATION_DEG,
        hinges.LEAST_STRAIGHT_ANGLE_DEG,
        hinges.LEAST_ARM_SEPARATION_DEG,
    )
    NET.assert_sentence("its crest between # and # widths", ARM_START_IN_WIDTHS, ARM_STOP_IN_WIDTHS)
    NET.assert_sentence("about # of it in people", notes.USUAL_WIDTH_RATIO)
    bounds = (notes.USUAL_WIDTH_RATIO * notes.LARGEST_RATIO_FACTOR**power for power in (-1, 1))
    NET.assert_sentence("is below # or above # of the gyral thickness.", *bounds)
    NET.assert_sentence("If more than # % of white's triangles cross others", 100 * measuring.LARGEST_CROSSED_SHARE)
    assert "crown width less than four edges" in NET.prose
    assert notes.LEAST_WIDTH_IN_EDGES == 4
    # a vertex of equilateral triangles whose edge is the scale has this share of the area
    least_vertices = 1 / (math.sqrt(0.75) * depth_potential.FIRST_SCALE_PER_ROOT_AREA**2)
    assert least_vertices == pytest.approx(24_000, rel=0.03)
    assert "less than some 24,000 vertices" in NET.prose


def test_bounds_of_confidence():
    NET.assert_sentence("A hinge below # is *doubtful*", hinges.LEAST_CONFIDENCE)
    NET.assert_sentence("`n_hinges_low` counts those of # or more", hinges.LEAST_STRICT_CONFIDENCE)


def test_persistence_matters_most():
    rows = [row for row in NET.tsv_rows("sensitivity") if row["surface"] == "S1"]
    counts = lambda length: [row["hinges"] for row in rows if row["length"] == length]
    spread_of = {length: max(counts(length)) - min(counts(length)) for length in {row["length"] for row in rows}}
    assert max(spread_of, key=spread_of.get) == "persistence"
    assert "Persistence matters most:" in NET.prose


# what is cortex, what is repaired and what warns


def test_bounds_of_the_cortex_and_of_notes():
    assert cortex_checks.LEAST_PARCELLATED_SHARE == 0.75  # "three quarters of the vertices"
    assert cortex_checks.WALL_DISTANCE_OVER_MEDIAN == 0.2  # "a fifth of their median distance"
    assert cortex_checks.LARGEST_SHARE_OF_WALL == 0.5
    shares = (100 * cortex_checks.LEAST_PATCH_SHARE, 100 * cortex_checks.LARGEST_WALL_SHARE)
    INDEX.assert_sentence("at least # % of the white area count, and none if together they are more than # %", *shares)
    INDEX.assert_sentence("a speck with less than # % of the pial area", 100 * repair.LARGEST_DEBRIS_SHARE)
    INDEX.assert_sentence("a cortex label of less than # % of the vertices", 100 * cortex_checks.LEAST_LABELLED_SHARE)
    INDEX.assert_sentence("rounded to more than # % of an edge", 100 * defects.LARGEST_ROUNDING_IN_EDGES)
    INDEX.assert_sentence(
        "outside pial at more than # % of the cortex, or pial is shifted by more than # of their distance",
        100 * defects.LARGEST_OUTSIDE_SHARE,
        defects.LARGEST_SHIFT_OVER_DISTANCE,
    )
    assert defects.LARGEST_WHITE_AREA_MM2 == 1_500 * 100
    assert "white is larger than 1,500 cm²" in INDEX.prose
    INDEX.assert_sentence("by more than # radii", defects.LEAST_SIDE_OFFSET_IN_RADII)
    assert (defects.LEAST_LABELLED_SHARE, defects.LARGEST_THICKNESS_RATIO) == (0.5, 2.0)
    INDEX.assert_sentence("or correlates at less than #", defects.LEAST_THICKNESS_CORRELATION)
    INDEX.assert_sentence("more than # % of the cortex is at the requested cap", 100 * defects.LARGEST_CAPPED_SHARE)
