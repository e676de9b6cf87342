"""How hinges depend on the lengths they are found by."""

import pytest

from morphofold.analysis.graph.crest_net import NET_LENGTHS, POTENTIAL_LENGTHS, hinge_sensitivity
from morphofold.errors import OutOfRange, UnknownName
from morphofold.shapes.ridges import ridged_net
from morphofold.studies.shapes import regular_net, sphere
from morphofold.surface import Surface


def test_hinges_of_a_clean_net_do_not_depend_on_small_changes_and_vanish_by_large_ones():
    surface = ridged_net(regular_net("cube"), 5, 8.0, rng=1)
    rows = hinge_sensitivity(surface, factors=(0.75, 1.5))
    assert [row["length"] for row in rows] == [
        "",
        *(name for name in NET_LENGTHS + POTENTIAL_LENGTHS for _ in range(2)),
    ]
    for row in rows:
        assert (row["n_hinges"], row["n_hinges_3"], row["n_ends"], row["kept"], row["old"]) == (8, 8, 0, 1.0, 1.0)
    base = rows[0]["crest_length_mm"]
    (merged,) = hinge_sensitivity(surface, lengths=("merge",), factors=(20.0,))[1:]
    assert merged["n_hinges"] < 8
    assert merged["crest_length_mm"] < base
    assert merged["kept"] < 1


def test_what_can_not_be_varied_is_refused_and_a_smooth_surface_has_no_rows():
    ball = sphere(3)
    surface = Surface(ball.verts, ball.faces)
    assert hinge_sensitivity(surface) == []
    with pytest.raises(UnknownName, match=r"persistence, merge.* 'width'"):
        hinge_sensitivity(surface, lengths=("width",))
    with pytest.raises(OutOfRange, match=r"\bfactor\b.* 0\."):
        hinge_sensitivity(surface, factors=(0,))
