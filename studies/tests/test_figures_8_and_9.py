"""Figs. 8 and 9: lines through points on a line, waves that keep the cortex's volume, patches in their own frame."""

from dataclasses import replace

import numpy as np
import pytest
from made_measures import made_measures
from made_simulations import MadeRuns, made_simulation

from morphofold.analysis import hinges, measure
from morphofold.comparison.hinge_comparison import compare_hinges
from morphofold.report.pictures import gyral_net
from morphofold.report.pictures.gyral_net import PATCH_RADIUS_IN_WIDTHS, TILT_DEG, clear_examples, hinge_patch, in_sight
from morphofold.sim.scene.scene_files import load_scene
from morphofold.studies.folded_ball import folded_ball
from morphofold.studies.markdown import read_rows
from morphofold.studies.paper import figures_8_and_9, paper_folds, thickness_plots
from morphofold.studies.paper.figure_parts import TEXT_COLUMNS
from morphofold.surface import Regions


@pytest.fixture(scope="module")
def ball():
    """A folded ball, its front half precentral, its back half postcentral."""
    cortex = folded_ball(4000)
    labels = (cortex.pial.verts[:, 1] < 0).astype(np.int64)
    colours = np.full((2, 3), 90, dtype=np.uint8)
    return measure(replace(cortex, regions=Regions(labels, ("precentral", "postcentral"), colours)))


def test_lines_are_those_of_points_on_lines():
    brain = made_measures(regions=True)  # gyral = 1 + 3 cortical thickness
    for row, t in zip(brain.regions, (2.0, 2.5, 3.5)):
        row["thickness_file_mm"] = 2 * t
    crests = [{"cortical_thickness_mm": t, "gyral_thickness_mm": 5 - t} for t in (1.0, 2.0, 2.5)]
    person = replace(made_measures(), crests=[*crests, {"cortical_thickness_mm": None, "gyral_thickness_mm": 1.0}])
    models = {}
    for t in (2.0, 4.0, 6.0):
        models[f"T = {t:g}"] = made_measures()
        models[f"T = {t:g}"].scalars.update(mean_cortical_thickness_mm=t, median_gyral_thickness_mm=2.5 * t)
    rows = {(r["surface"], r["points"]): r for r in figures_8_and_9.fit_rows(models, {"avg": brain}, {"S": person})}
    own, file = (rows["avg", f"regions, thickness of its {of}"] for of in ("surfaces", "file"))
    assert (own["slope"], own["intercept_mm"], own["r"], own["n"]) == pytest.approx((3, 1, 1, 3))
    assert (file["slope"], file["intercept_mm"]) == pytest.approx((1.5, 1))
    assert (own["slope_low"], own["slope_high"]) == pytest.approx((3, 3), abs=1e-6)
    assert own["gyral_over_cortical"] == 10.0 / 2.5
    assert (rows["S", "crests"]["slope"], rows["S", "crests"]["n"]) == pytest.approx((-1, 3))
    bodies = rows["models", "bodies"]
    assert (bodies["slope"], bodies["intercept_mm"], bodies["gyral_over_cortical"]) == pytest.approx((2.5, 0, 2.5))
    assert rows["T = 2", "crests"]["slope"] is None  # it has no crests


@pytest.mark.slow
def test_the_first_wrinkles_are_those_of_a_cortex_of_the_volume_that_grew():
    scenes = [load_scene(name) for name in ("fig6-thin", "fig6-thick")]
    for scene, (t, wave) in zip(scenes, thickness_plots.onset_line(scenes), strict=True):
        C, T = 50.0, scene.geometry.cortex_thickness
        exact, c = thickness_plots.expected(scene), C - T + t
        assert c**3 - (C - T) ** 3 == pytest.approx(exact["theory_g"] ** 3 * (C**3 - (C - T) ** 3), rel=1e-9)
        degree = exact["theory_degree"]
        assert wave == pytest.approx(2 * np.pi * c / np.sqrt(degree * (degree + 1)), rel=1e-9)


def test_a_patch_lies_in_the_frame_of_its_hinge(ball):
    (hinge, *_) = (h for h in hinges(ball.graph) if h.degree == 3)
    width, back = ball.graph.graph["scales"].width, np.radians(TILT_DEG)
    for pose in range(6):
        verts = hinge_patch(ball, hinge.node, pose).surface.verts[:-2]  # the last two belong to no face
        assert np.linalg.norm(verts, axis=1).min() < 0.2  # the hinge is the origin
        assert np.linalg.norm(verts, axis=1).max() < 1.15 * PATCH_RADIUS_IN_WIDTHS
        flat = verts @ np.array([[1, 0, 0], [0, np.cos(back), np.sin(back)], [0, -np.sin(back), np.cos(back)]])
        arm = np.array(hinge.arms[pose % 3].direction) * width  # a width along the arm, in the patch: (1, 0, 0)
        pial = ball.cortex.pial.verts - ball.cortex.pial.verts[hinge.vertex]
        tip = pial[np.argmin(np.linalg.norm(pial - arm, axis=1))]
        lengths = np.linalg.norm(flat, axis=1), np.linalg.norm(flat - [1, 0, 0], axis=1)
        same = np.hypot(lengths[0] - np.linalg.norm(tip) / width, lengths[1] - np.linalg.norm(tip - arm) / width)
        assert same.min() < 1e-6  # as far from the hinge, and from the end of its arm
    patch, mirrored = (hinge_patch(ball, hinge.node, pose).surface for pose in (0, 3))
    assert np.abs(patch.verts[:-2, 0] - mirrored.verts[:-2, 0]).max() < 1e-9  # across the first arm
    np.testing.assert_array_equal(patch.faces, mirrored.faces[:, ::-1])


@pytest.mark.slow
def test_crests_behind_something_are_out_of_sight(ball, monkeypatch):
    (hinge, *_) = (h for h in hinges(ball.graph) if h.degree == 3)
    patch = hinge_patch(ball, hinge.node)
    assert in_sight(patch) > 0.9  # on a ridge
    n, surface = len(patch.surface.verts), patch.surface
    verts = np.concatenate([surface.verts, [[-3, -3, 5], [3, -3, 5], [0, 6, 5]]])  # a lid
    behind = replace(surface, verts=verts, faces=np.concatenate([surface.faces, [[n, n + 1, n + 2]]]))
    rgb = np.concatenate([patch.rgb, np.full((3, 3), 9, dtype=np.uint8)])
    assert in_sight(replace(patch, surface=behind, rgb=rgb)) < 0.3
    shapes = figures_8_and_9.hinge_shapes(ball)
    (comparison,) = compare_hinges({"a": shapes, "b": shapes}, {"model": ["a"], "MRI": ["b"]})
    matches = comparison.matches
    assert len(clear_examples(matches, {"a": ball, "b": ball})) == 6
    assert clear_examples(matches, {"a": ball, "b": replace(ball, graph=None)}) == {}
    monkeypatch.setattr(gyral_net, "in_sight", lambda patch: 0.6)
    assert clear_examples(matches, {"a": ball, "b": ball}) == {}


@pytest.mark.slow
def test_figures_are_written_with_their_tables(ball, tmp_path, monkeypatch):
    monkeypatch.setattr(paper_folds, "STAGE_GROWTHS", (1.0, 2.0))
    simulations, measured = {}, []

    def grow(name, scene, settings):
        return simulations.get(name) or simulations.setdefault(name, made_simulation(tmp_path / name, scene, settings))

    runs = MadeRuns(grow)
    runs.measure = lambda name, cortex: measured.append(name) or ball
    for entry in (figures_8_and_9.reproduce_fig8(tmp_path, runs), figures_8_and_9.reproduce_fig9(tmp_path, runs)):
        assert all((tmp_path / file).stat().st_size > 50 for file in entry["files"])
        assert len(entry["simulations"]) == 3
    assert set(measured) == {"T = 1 mm", "T = 2 mm", "T = 3 mm", "S1 lh", "fsaverage5 lh", "fsaverage5 rh"}
    matches, surfaces, numbers, nearest = (
        read_rows(tmp_path / f"fig9{part}.tsv", (*TEXT_COLUMNS, "hinge", "other"))
        for part in ("", "-surfaces", "-numbers", "-nearest")
    )
    assert len(matches) == 3 * len(figures_8_and_9.hinge_shapes(ball))
    assert all(row["distance"] < 1e-6 and row["hinge"] == row["other"] for row in matches)
    assert {row["per_width_squared"] for row in surfaces} == {surfaces[0]["per_width_squared"]}
    for row in surfaces:
        assert row["per_cm_squared"] * row["width_mm"] ** 2 == pytest.approx(100 * row["per_width_squared"], rel=1e-6)
    assert [row["p"] for row in numbers] == [1] + [None] * 5
    assert [row["source"] for row in nearest] == ["model", "MRI itself", "random net"]
