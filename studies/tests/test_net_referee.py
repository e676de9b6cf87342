"""The referee of gyral nets: scores with known answers, cases that are one surface, and answers from files."""

from functools import partial

import numpy as np
import pytest

from morphofold.geometry import face_areas
from morphofold.shapes import icosphere
from morphofold.studies import net_referee
from morphofold.studies.known_shapes import regular_net
from morphofold.studies.net_referee import Case, read_answer, score, scores, subdivided, summary, write_answer
from morphofold.surface import Surface

CUBE = regular_net("cube")
TRUTH = (10 * CUBE.nodes, CUBE.arcs)  # 8 nodes, 12 arcs, 11.5 mm apart
SPHERE = Surface(*icosphere(2, 10.0))


def test_a_net_is_wholly_right_beside_itself_in_any_order_and_off_by_its_shift():
    order = np.random.default_rng(0).permutation(8)
    shuffled = (TRUTH[0][order] + [0.3, 0, 0.4], np.argsort(order)[TRUTH[1]][::-1, ::-1])
    assert score(shuffled, TRUTH) == pytest.approx((1, 1, 0.5))


def test_a_hinge_that_is_missing_takes_its_crests_along():
    is_left = (TRUTH[1] != 7).all(axis=1)
    nodes, arcs, _ = score((TRUTH[0][:7], TRUTH[1][is_left]), TRUTH)
    assert (nodes, arcs) == pytest.approx((2 * 7 / 15, 2 * 9 / 21))


def test_a_hinge_beyond_the_tolerance_is_one_too_many_and_one_too_few():
    far = TRUTH[0].copy()
    far[0] *= 1 + 1.01 * net_referee.TOLERANCE / 10
    assert score((far, TRUTH[1]), TRUTH)[:2] == pytest.approx((14 / 16, 2 * 9 / 24))


def test_two_hinges_at_one_true_hinge_count_once_and_a_doubled_crest_once():
    doubled = (np.vstack([TRUTH[0], TRUTH[0][:1]]), np.vstack([TRUTH[1], TRUTH[1][:1]]))
    assert score(doubled, TRUTH)[:2] == pytest.approx((16 / 17, 24 / 25))


def test_nothing_found_is_nothing_right():
    empty = (np.empty((0, 3)), np.empty((0, 2), dtype=int))
    assert score(empty, TRUTH)[:2] == score(TRUTH, empty)[:2] == (0, 0)


def test_what_is_found_again_but_is_not_there_is_worth_nothing():
    turn = net_referee._random_rotation(1)
    turned = Surface(SPHERE.verts @ turn.T, SPHERE.faces)
    cases = {"known": Case(SPHERE, TRUTH), "person, turned": Case(turned, base=SPHERE, turn=turn)}
    wrong = 10 * regular_net("octahedron").nodes, np.array([[0, 1]])  # 9.2 mm from the corners of the cube
    rows = scores(lambda name, _: (wrong[0] @ turn.T, wrong[1]) if name.endswith("turned") else wrong, cases)
    assert rows["person, turned"] == pytest.approx((1, 1, 0), abs=1e-12)
    assert summary(rows)[:5] == pytest.approx([0, 0, 0, 100, 100])
    right = scores(lambda name, _: (TRUTH[0] @ turn.T, TRUTH[1]) if name.endswith("turned") else TRUTH, cases)
    assert summary(right) == pytest.approx([100, 100, 100, 100, 100, 0], abs=1e-9)


def test_a_subdivided_surface_is_the_same_surface_with_four_times_the_triangles():
    fine = subdivided(SPHERE)
    assert len(fine.faces) == 4 * len(SPHERE.faces)
    assert len(np.unique(fine.faces)) == len(fine.verts) == len(SPHERE.verts) + 3 * len(SPHERE.faces) // 2
    areas = face_areas(fine.verts, fine.faces).reshape(4, -1)
    assert areas == pytest.approx(np.tile(face_areas(SPHERE.verts, SPHERE.faces) / 4, (4, 1)))


def test_answers_of_other_programs_are_read_as_they_are_written(tmp_path):
    write_answer(tmp_path, "cube, noise of 0.1 edges", TRUTH)
    nodes, arcs = partial(read_answer, tmp_path)("cube, noise of 0.1 edges", SPHERE)
    assert np.array_equal(arcs, TRUTH[1])
    assert nodes == pytest.approx(TRUTH[0], abs=1e-4)


def test_morphofold_finds_a_known_net_and_the_plain_watershed_does_not():
    surface = net_referee.ridged_net(CUBE, 5, 6.0, rng=0)
    truth = (54.0 * CUBE.nodes, CUBE.arcs)
    assert score(net_referee.morphofold_net(surface), truth)[:2] == (1, 1)
    assert score(net_referee.plain_watershed(surface), truth)[0] < 0.2
    assert score(net_referee.scattered(surface), truth)[0] < 0.2


def test_the_page_has_some_cases_and_the_table_beside_it_all(tmp_path, monkeypatch):
    few_cases = {"known": Case(SPHERE, TRUTH), "person, noise": Case(SPHERE, base=SPHERE)}
    monkeypatch.setattr(net_referee, "cases", lambda: few_cases)
    monkeypatch.setattr(net_referee, "METHODS", {"truth": lambda surface: TRUTH})
    monkeypatch.setattr(net_referee, "SHOWN_CASES", ("known",))
    page = tmp_path / "nets.md"
    page.write_text("".join(f"<!-- {name} -->\n<!-- /{name} -->\n" for name in ("scores", "cases")))
    net_referee.write_page(tmp_path, page)
    text = page.read_text("utf-8")
    assert "| truth | **100** | 100 | 100 | 100 | 100 | 0.00 |" in text
    assert "| known | 100, 100 |" in text
    assert "| person, noise |" not in text
    lines = (tmp_path / "nets-cases.tsv").read_text("utf-8").splitlines()
    assert lines == ["case\ttruth", "known\t100, 100", "person, noise\t100, 100"]
