"""Growth maps made from the folds of a person: their spread, their controls, what is said of them, and the twin."""

import json
import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from commands import refused
from made_people import LEVEL, made_person, random_folds, source
from page_text import text_read

from morphofold.comparison.person.compare_person import compare_with_person
from morphofold.comparison.person.fold_heights import band, fold_heights
from morphofold.errors import OutOfRange
from morphofold.group_pages.inference_page import inference_report
from morphofold.inference.growth_target import Target, weighted_mean_and_sd
from morphofold.inference.inference import Grown, Inference, write_result
from morphofold.inference.inference_runs import InferenceRun, Plan, check_plan_file, scene_of
from morphofold.io import read_morph
from morphofold.shapes import icosphere
from morphofold.sim.effects import growth_map
from morphofold.sim.effects.growth_map import Options
from morphofold.sim.hemisphere.subject_maps import smooth_map
from morphofold.unfolding.harmonics import Expansion, degrees

POINTS = icosphere(4)[0]
WEIGHTS = np.where(POINTS[:, 0] < 0.9, 1.0, 0.0)  # a medial wall


def made_target(seed=0, low=7, high=16):
    heights = 3 * Expansion(random_folds(np.random.default_rng(seed), low, high)[:, None])(POINTS)[:, 0]
    return Target(POINTS, WEIGHTS, fold_heights(POINTS, heights, WEIGHTS)), heights


def correlation(x, y):
    return float(np.corrcoef(x[WEIGHTS > 0], y[WEIGHTS > 0])[0, 1])


# maps -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("spread", [0.05, 0.2, 0.4])
def test_a_map_has_the_spread_that_is_asked_for_after_the_smoothing_of_the_solver(spread):
    target, heights = made_target()
    values, as_applied = target.map_values(spread)
    mean, deviation = weighted_mean_and_sd(as_applied, WEIGHTS)
    assert deviation == pytest.approx(spread, rel=0.02)
    assert mean == pytest.approx(1, abs=0.005)
    solver_map = smooth_map(values, (POINTS, WEIGHTS), target.map_degree, "map")(POINTS)
    assert as_applied[WEIGHTS > 0] == pytest.approx(solver_map[WEIGHTS > 0])
    assert correlation(as_applied, heights) > 0.9  # more growth where a gyrus is
    assert np.all(values[WEIGHTS == 0] == 1)


def test_a_negative_spread_is_less_where_a_gyrus_is_and_a_turned_map_is_elsewhere():
    target, heights = made_target()
    assert correlation(target.map_values(-0.1)[0], heights) < -0.9
    turned = [target.map_values(0.1, InferenceRun(0.1, 1, number).rotation)[0] for number in (1, 2)]
    assert max(abs(correlation(values, heights)) for values in turned) < 0.3
    assert abs(correlation(*turned)) < 0.3


def test_a_spread_that_factors_do_not_allow_is_refused():
    target, _ = made_target()
    with pytest.raises(OutOfRange, match="at most"):
        target.map_values(0.95)


@pytest.mark.parametrize("degree", [9, 14])
def test_folds_of_one_degree_have_it_and_ask_for_a_cortex_with_waves_as_long(degree):
    l = degrees(30)
    coefficients = np.where(l == degree, np.random.default_rng(1).standard_normal(len(l)), 0.0)[:, None]
    target = Target(POINTS, WEIGHTS, Expansion(coefficients))
    assert target.fold_degree == pytest.approx(degree)
    assert target.map_degree == round(1.4 * degree)
    assert 5.7 * target.thickness(50.0) == pytest.approx(2 * math.pi * 50 / degree)


def test_the_shape_of_the_body_has_no_part_in_a_map():
    target, _ = made_target()
    shape = 9 * Expansion(random_folds(np.random.default_rng(5), 1, 6)[:, None])(POINTS)[:, 0]
    with_shape = Target(POINTS, WEIGHTS, Expansion(target.heights.coefficients + _fitted(shape)))
    assert with_shape.map_values(0.1)[0] == pytest.approx(target.map_values(0.1)[0], abs=0.02)


def _fitted(values):
    fitted = fold_heights(POINTS, values, np.ones(len(POINTS)))
    return fitted.coefficients - band(fitted).coefficients


@pytest.mark.parametrize("local", [1.3, 1.6, 2.0])
def test_the_first_wrinkles_come_where_the_place_that_grows_most_has_the_length(local, monkeypatch):
    options = Options(file="map", held_from=1.4)
    made = SimpleNamespace(on_sphere=lambda points: np.array([0.5, 2.0]))
    monkeypatch.setattr(growth_map, "MapAtNodes", lambda *_: made)
    g = options.first_wrinkles(local, SimpleNamespace(geometry=None, growth=SimpleNamespace(final=2.0)))
    assert 1 + (g - 1) * (1 + options.weight(g) * (2.0 - 1)) == pytest.approx(local)


def test_differences_of_lengths_stay_from_where_they_are_held():
    weight = Options(file="map", held_from=1.4).weight
    assert [weight(g) for g in (1.0, 1.2, 1.4)] == [1, 1, 1]
    assert [weight(g) * (g - 1) for g in (1.4, 1.6, 2.0)] == pytest.approx([0.4, 0.4, 0.4])


# what is said -----------------------------------------------------------------------------------------------------


def body(spread, seed, agreement, p=0.01, turn=0):
    tested = SimpleNamespace(value=agreement, control=0.3)
    verdict = "above control" if p < 0.05 else "deepened"
    folds = SimpleNamespace(tested=tested, deepened=SimpleNamespace(control=0.4), verdict=verdict)
    return Grown(InferenceRun(spread, seed, turn), spread, SimpleNamespace(agreements=(folds,)), True, ())


def inference_of(*bodies):
    person = SimpleNamespace(cortex=SimpleNamespace(name="bert", hemi="lh"))
    return Inference(SimpleNamespace(runs=[each.run for each in bodies], thin_crowns=0.0), person, bodies)


EVEN, TURNED = (body(0, 1, 0.1), body(0, 2, 0.2)), (body(0.3, 1, 0.05, turn=1), body(0.3, 1, 0.45, turn=2))


@pytest.mark.parametrize(
    ("mapped", "least"),
    [
        ([body(0.1, 1, 0.5), body(0.1, 2, 0.6), body(0.3, 1, 0.7), body(0.3, 2, 0.7)], 0.1),
        (
            [body(0.1, 1, 0.5), body(0.1, 2, 0.44), body(0.3, 1, 0.7), body(0.3, 2, 0.7)],
            0.3,
        ),  # one seed below a control
        ([body(0.1, 1, 0.5), body(0.1, 2, 0.6, p=0.06), body(0.3, 1, 0.7), body(0.3, 2, 0.7)], 0.3),  # not by its p
        ([body(0.1, 1, 0.4), body(0.1, 2, 0.4), body(0.3, 1, 0.44), body(0.3, 2, 0.9)], None),
    ],
)
def test_the_least_spread_is_where_every_seed_is_above_every_control(mapped, least):
    result = inference_of(*EVEN, *mapped, *TURNED)
    assert result.least_spread == least
    assert result.controls == {
        "before growth": 0.3,
        "sulci deepened": 0.4,
        "grown evenly": 0.2,
        "map turned away": 0.45,
    }
    words = "No map" if least is None else f"{100 * least:.0f} %"
    assert words in result.sentence


def test_a_control_or_a_seed_that_could_not_be_grown_or_is_not_valid_leaves_no_result():
    mapped = body(0.3, 1, 0.7), body(0.3, 2, 0.7)
    assert inference_of(*EVEN, *mapped, *TURNED).least_spread == 0.3
    assert inference_of(*EVEN, *mapped).least_spread is None
    assert inference_of(*mapped, *TURNED).least_spread is None
    whole = inference_of(*EVEN, *mapped, *TURNED)
    assert replace(whole, grown=(*EVEN, mapped[0], *TURNED)).least_spread is None
    assert inference_of(*EVEN, mapped[0], replace(mapped[1], is_healthy=False), *TURNED).least_spread is None


def test_a_folder_is_of_one_person_and_side(tmp_path):
    plan = SimpleNamespace(cortex=SimpleNamespace(called="bert", hemi="lh"), thin_crowns=0.0)
    check_plan_file(plan, tmp_path)
    check_plan_file(plan, tmp_path)
    plan.cortex.hemi = "rh"
    with pytest.raises(FileExistsError, match="another subject"):
        check_plan_file(plan, tmp_path)


def test_runs_have_names_of_their_own_and_a_map_for_each_spread_and_turn():
    runs = [InferenceRun(a, seed) for a in (0.0, 0.1, 0.125) for seed in (1, 2)] + [InferenceRun(0.125, 1, 2)]
    assert len({run.name for run in runs}) == len(runs)
    assert [run.name for run in runs[2:]] == [
        "spread10-seed1",
        "spread10-seed2",
        "spread12.5-seed1",
        "spread12.5-seed2",
        "turned2-spread12.5-seed1",
    ]


# refusals ---------------------------------------------------------------------------------------------------------


def test_a_subject_without_a_sphere_and_numbers_that_are_none_are_refused(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for arguments, code in (
        (["nobody"], "no-such-file"),
        (["x", "--heterogeneity", "0.1,much"], "bad-usage"),
        (["x", "--heterogeneity", "0.1,0.9"], "out-of-range"),
        (["x", "--seeds", "1"], "out-of-range"),
        (["x", "--hemi", "both"], "bad-usage"),
    ):
        refused(capsys, ["infer", *arguments], f"[{code}]")
    assert not list(tmp_path.iterdir())


# the twin ---------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_twin_folds_where_the_first_one_does_and_not_by_a_turned_map(tmp_path):
    """The target is a body that grew without a map: another seed folds elsewhere, with the map of 10 % there."""
    from morphofold.inference.inference_runs import make_plan
    from morphofold.io import sample_path
    from morphofold.simulation import simulate

    plan = make_plan(sample_path("fsaverage5"), "lh", [0.1])

    def folds(name, run, of=plan):
        scene, applied = scene_of(of, run, tmp_path / "maps" / name)
        assert not run.spread or applied == pytest.approx(run.spread, rel=0.02)
        cortex = simulate(scene, tmp_path / name).cortex()
        points = cortex.sphere.verts / np.linalg.norm(cortex.sphere.verts, axis=1)[:, None]
        from morphofold.analysis.relief import height_and_vertical
        from morphofold.geometry import vertex_areas

        heights = height_and_vertical(cortex.pial.verts, cortex.faces, 7.5)[0]
        weights = vertex_areas(plan.subject.unfolding.surface(points), cortex.faces) * cortex.cortex
        return fold_heights(points, heights, weights)

    def agreement(a, b):
        return float(np.corrcoef(band(a).coefficients[:, 0], band(b).coefficients[:, 0])[0, 1])

    first = folds("first", InferenceRun(0.0, 1))
    points, weights = plan.subject.vertices()
    twin = replace(plan, target=Target(points, weights, first))
    assert agreement(folds("none", InferenceRun(0.0, 2)), first) < 0.6
    assert agreement(folds("second", InferenceRun(0.1, 2), twin), first) > 0.85
    assert agreement(folds("third", InferenceRun(0.1, 3), twin), first) > 0.85
    assert agreement(folds("turned", InferenceRun(0.1, 2, 1), twin), first) < 0.55


# the page ---------------------------------------------------------------------------------------------------------


def test_the_page_has_every_run_and_control_and_what_the_map_is_not(tmp_path):
    rng = np.random.default_rng(2)
    own, other = random_folds(rng), random_folds(rng)
    person = made_person(own, name="bert")
    of_name = {
        InferenceRun(0.0, 1): other,
        InferenceRun(0.0, 2): -other,
        InferenceRun(0.3, 1): own + 0.3 * other,
        InferenceRun(0.3, 2): own - 0.3 * other,
        InferenceRun(0.3, 1, 1): other,
    }
    grown = []
    for run, folds in of_name.items():
        names = {"names": ("bert", run.name), "spins": 20}
        measures = made_person(folds, name=run.name, grown_from=source("bert"))
        grown.append(Grown(run, run.spread, compare_with_person(person, measures, LEVEL, **names), True, ()))
    target = Target(POINTS, WEIGHTS, fold_heights(POINTS, Expansion(own[:, None])(POINTS)[:, 0], WEIGHTS))
    smooth = SimpleNamespace(smooth=lambda: person.cortex.pial)
    subject = SimpleNamespace(mended=SimpleNamespace(original=person.cortex, source=np.arange(2562)), unfolding=smooth)
    runs = (*of_name, InferenceRun(0.3, 1, 2))
    result = Inference(Plan(subject, person.cortex, target, 3.7, 1.87, runs, ()), person, tuple(grown))
    page = write_result(result, tmp_path, report=inference_report)
    text = text_read(page.read_text("utf-8"))
    assert "turned2-spread30-seed1" in text  # the run that could not be grown
    for words in ("It is not how bert grew", "Do not test the map against anatomy", "even growth, seed 2"):
        assert words in text
    numbers = json.loads((page.parent / "inference.json").read_text())
    assert numbers["least_heterogeneity"] == 0.3
    assert numbers["controls"]["grown evenly"] < 0.4 < min(row["folds"] for row in numbers["runs"][2:4])
    values = read_morph(page.parent / "lh.growth_map")
    assert weighted_mean_and_sd(values, WEIGHTS) == pytest.approx((1, 0.3), rel=0.02)
    assert (page.parent / "comparison" / "report.html").is_file()
