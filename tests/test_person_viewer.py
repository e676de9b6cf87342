"""Linked views of a person, the smooth body and a grown cortex in a real browser."""

import numpy as np
import pytest
from browser import assert_quiet, needs_browser, opened
from made_people import made_person, random_folds, source

from morphofold.comparison import compare

pytestmark = needs_browser


@pytest.mark.slow
def test_a_click_on_the_person_marks_the_same_point_on_smooth_body_and_grown_cortex(tmp_path):
    rng = np.random.default_rng(4)
    person, grown = made_person(random_folds(rng)), made_person(random_folds(rng), name="grown", grown_from=source())
    other = made_person(random_folds(rng), name="other")
    page = compare({"P": person, "G": grown, "O": other}, spins=9).report(tmp_path / "out")
    with opened(page, tmp_path / "profile", "viewer") as tab:
        names = tab.js("[...document.querySelectorAll('.panel .name')].map(p => p.textContent)")
        assert (names[0], names[2], names[3]) == ("P", "G", "O")
        assert tab.frame()["map"] == "relief_height"
        x, y = tab.middle_of("panel-0")
        for kind in ("mousePressed", "mouseReleased"):
            tab.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)
        tab.frame()
        of = lambda k: f"document.querySelectorAll('.values')[{k}].querySelector('dd')?.textContent ?? ''"
        vertices = [tab.js(of(k)) for k in range(4)]
        assert vertices[0].isdigit()
        assert vertices == [vertices[0]] * 3 + [""]  # all have the same mesh; the last is nobody's
        assert_quiet(tab)
