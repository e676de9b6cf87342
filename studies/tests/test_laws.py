"""Models and brains on the folding law, where a growing cortex is thick, and folds over bundles of fibres."""

import dataclasses

import numpy as np
import pytest
from made_simulations import made_simulation
from scipy import stats

from morphofold.analysis import AtScale, measure
from morphofold.analysis.graph.gyral_tables import amounts
from morphofold.analysis.gyrification.folding_indices import shape_terms
from morphofold.analysis.gyrification.hull_measures import hull
from morphofold.shapes import icosphere
from morphofold.sim.scene.scene_files import load_scene
from morphofold.studies import crowns, fibre_study, folding_laws
from morphofold.studies.fibre_study import FIBRE_KINDS
from morphofold.studies.folded_ball import folded_ball
from morphofold.studies.known_shapes import regular_net
from morphofold.surface import Cortex, Surface

# the folding law ----------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def mammals():
    return folding_laws.species()


def body_of(k):
    """A body whose K goes from the first to the second number of ``k`` in eleven steps, its exposed area by 10 %."""
    exposed = np.geomspace(1e4, 1.1e4, len(folding_laws.GROWTHS))
    terms = [shape_terms(10**K * e**1.25, e, 1.0) for K, e in zip(np.linspace(*k, len(folding_laws.GROWTHS)), exposed)]
    return folding_laws.Body(folding_laws.GROWTHS, terms, [1e5] * len(terms), {})


def test_the_published_mammals_have_the_published_slope(mammals):
    line = stats.linregress(np.log10(mammals.exposed_area), np.log10(mammals.scaled_area))
    assert (len(mammals.exposed_area), len(mammals.primate_area)) == (57, 65)
    assert (line.slope, line.stderr) == (pytest.approx(1.325, abs=1e-3), pytest.approx(0.009, abs=1e-3))
    assert (mammals.mean_k, mammals.sd_k) == (pytest.approx(-0.552, abs=1e-3), pytest.approx(0.086, abs=1e-3))


def test_the_growths_at_which_a_body_is_among_mammals_of_its_size(mammals):
    """K at the exposed areas of ``body_of`` on the free line, less and plus two standard deviations."""
    centre = [mammals.intercept + (mammals.slope - 1.25) * np.log10(e) for e in (1e4, 1.1e4)]
    low, high = ([K + sign * 2 * mammals.sd for K in centre] for sign in (-1, 1))
    enters = f"{1 + 0.3 / (0.3 + high[1] - 0.01 - low[1]):.2f}"
    leaves = f"{1 + (high[0] - low[0]) / (high[0] - low[0] + 0.1):.2f}"
    assert folding_laws.growth_row("a", body_of((low[0] - 0.3, high[1] - 0.01)), mammals)[-3:-1] == [enters, "the end"]
    assert folding_laws.growth_row("a", body_of((low[0], high[1] + 0.1)), mammals)[-2] == leaves
    assert folding_laws.growth_row("a", body_of((-2.0, -1.5)), mammals)[-3:-1] == ["–", "–"]
    assert folding_laws.growth_row("a", body_of((-0.5, -0.5)), mammals)[-1] == "1.2"  # along the law: 5/4
    rise = 1.25 + 0.1 * np.log(10) / np.log(1.1)
    assert folding_laws.growth_row("a", body_of((-0.6, -0.5)), mammals)[-1] == f"{rise:.1f}"
    assert mammals.sd < mammals.sd_k


def test_a_row_across_scales_has_the_slope_and_the_exponent_of_its_law():
    """Bodies with A_total T^(1/2) proportional to A_exposed^(5/4) at every scale, and one without folds."""
    rows = [AtScale(s, shape_terms(1e4**1.25 / (1 + s) ** 0.5, 1e3, 1 + s)) for s in (0.0, 1.0, 2.0, 4.0, 8.0)]
    assert folding_laws.scales_row("a", "2", rows)[:7] == ["a", "2", "4", "1.00", "8.00", "1.25", "−0.50"]
    rows = [AtScale(s, shape_terms(1e4, 1e4, 1 + s)) for s in (0.0, 1.0, 2.0, 4.0, 8.0)]
    assert folding_laws.scales_row("a", "", rows)[6] == "0.00"


def test_the_page_shows_brains_a_shell_and_one_body():
    bodies = [[body, g] for body in folding_laws.SCENE_OF_BODY for g in ("1.4", "1.6", "1.8", "2")]
    surfaces = [[name, ""] for name in (*folding_laws.PEOPLE, "shell of 2.5 mm")]
    shown = [cells for cells in (*surfaces, *bodies) if folding_laws.is_shown_scale(cells)]
    assert shown == [*surfaces, ["T = 2 mm, isotropic", "1.4"], ["T = 2 mm, isotropic", "2"]]
    shown = [cells for cells in (*bodies, *surfaces[:2]) if folding_laws.is_shown_spacing(cells)]
    assert shown == [["T = 2 mm, isotropic", "2"], ["T = 2 mm, tangential", "2"], *surfaces[:2]]


@pytest.mark.slow
def test_pictures_are_drawn_from_simulations(tmp_path, monkeypatch, mammals):
    monkeypatch.setattr(folding_laws, "GROWTHS", (1.2, 1.4, 2.0))
    monkeypatch.setattr("morphofold.analysis.gyrification.across_scales.FIRST_SCALES_MM", (2.0, 2.5, 3.0, 3.5))  # quick
    body = folding_laws.measured_body(made_simulation(tmp_path / "run", "fig5", ["output.stages=[1.2, 1.4]"]))
    assert [terms.total for terms in body.terms] == sorted(terms.total for terms in body.terms)
    folding_laws.draw_species(tmp_path / "a.png", mammals, {"body": body}, {})
    folding_laws.draw_growth(tmp_path / "b.png", mammals, {"body": body}, {"again": body.scales[2.0]})
    assert all((tmp_path / name).stat().st_size > 10_000 for name in ("a.png", "b.png"))


def test_the_spacing_of_a_net_of_known_length():
    """Ridges along the edges of a dodecahedron: twice the exposed area over the length of their crests."""
    net = regular_net("dodecahedron")
    cortex = folded_ball(20_000, net)
    crest = np.linalg.norm(cortex.pial.verts, axis=1).max()
    exact = 2 * hull(cortex.pial.verts, cortex.faces).area / (crest * net.lengths.sum())
    assert folding_laws.spacing(cortex) == pytest.approx(exact, rel=0.05)
    (row,) = folding_laws.spacing_rows("ball", {"": cortex}, 10.0)
    assert float(row[3]) == pytest.approx(exact / 10, rel=0.06)


# where the cortex is thick ------------------------------------------------------------------------------------


def test_thickness_of_each_part_by_points_and_columns():
    parts = crowns.thickness(folded_ball(4000))
    assert set(parts) == set(crowns.FOLD_PARTS)
    assert np.isfinite([value for pair in parts.values() for value in pair]).all()
    assert crowns.over(parts, 0) == pytest.approx(parts["crown"][0] / parts["fundus"][0])


def test_thickness_over_curvature_of_a_shell_is_in_one_bin():
    """A shell of even thickness t has the mean curvature 1 / R midway, and everywhere its mean thickness."""
    verts, faces = icosphere(5)
    thickness = crowns.over_curvature(Cortex(Surface(16.0 * verts, faces), Surface(24.0 * verts, faces)))
    (k,) = np.flatnonzero(np.isfinite(thickness))
    assert crowns.CURV_BINS[k] < 8.0 / 20.0 < crowns.CURV_BINS[k + 1]
    assert thickness[k] == pytest.approx(1.0, abs=1e-3)


# bundles of fibres --------------------------------------------------------------------------------------------


def runs_with_shift(rng, shift, seeds=10, turns=200):
    """Runs whose shares of hinges are ``shift`` standard deviations above chance."""
    runs = []
    for _ in range(seeds):
        values = rng.normal(0.05, 0.02, 1 + turns)
        values[0] += 0.02 * shift
        runs.append(fibre_study.OverBundles(values, values, values, 80))
    return runs


def test_a_shift_is_significant_and_none_is_not(rng):
    none, some = (fibre_study.summary(runs_with_shift(rng, shift), "hinges") for shift in (0.0, 2.0))
    assert none["low"] < 0 < none["high"]
    assert none["p"] > 0.05
    assert 0 < some["low"] < 0.04 < some["high"]
    assert some["p"] < 0.01
    assert some["mean"] - some["chance"] == pytest.approx(0.04, abs=0.02)


def test_bundles_at_hinges_have_more_hinges_than_turned_ones():
    ball = folded_ball(4000)
    directions = ball.white.verts / np.linalg.norm(ball.white.verts, axis=1, keepdims=True)
    cortex = dataclasses.replace(ball, sphere=Surface(100 * directions, ball.faces, name="lh.sphere"))
    hinges = np.flatnonzero(amounts(measure(cortex, only=["hinges"]).graph, len(directions))["hinges"])
    over = fibre_study.over_bundles(cortex, directions[hinges[:6]], seed=0)
    assert over.n_hinges == len(hinges)
    assert over.hinges[0] >= 6 / len(hinges)
    assert over.hinges[0] > 2 * over.hinges[1:].mean()
    assert over.crests[0] > over.crests[1:].mean()
    assert over.depth[0] < over.depth[1:].mean()  # hinges are on gyri


def test_the_scene_of_each_kind_loads_with_bundles_spread_over_the_sphere(monkeypatch, tmp_path):
    scenes = {}

    class Grown:
        def cortex(self):
            return None

    monkeypatch.setattr(
        fibre_study, "simulate", lambda scene, out, **options: scenes.update({out.name: scene}) or Grown()
    )
    for kind in FIBRE_KINDS:
        fibre_study.grow_sphere(tmp_path, kind, 3)
    assert "fibres" not in scenes.pop("none-3").effects
    fibres = [scene.effects["fibres"] for scene in scenes.values()]
    assert len({options.model_dump_json() for options in fibres}) == len(FIBRE_KINDS) - 1
    centres = np.array([bundle.centre for bundle in fibres[0].bundles])
    np.testing.assert_allclose(np.linalg.norm(centres, axis=1), 50.0)
    distance = np.linalg.norm(centres[:, None] - centres, axis=2) + 1e3 * np.eye(len(centres))
    assert distance.min() > 2 * fibre_study.BUNDLE_RADIUS_MM  # they do not overlap
    assert load_scene("demo").geometry.radius == fibre_study.BODY_RADIUS_MM
    assert {*fibre_study.SHOWN_KINDS} < {kind.name for kind in FIBRE_KINDS}
