"""Models and brains on the folding law."""

import numpy as np
import pytest
from made_simulations import made_simulation
from scipy import stats

from morphofold.analysis import AtScale
from morphofold.analysis.gyrification.convex_hull import hull
from morphofold.analysis.gyrification.folding import shape_terms
from morphofold.shapes.folded_ball import folded_ball
from morphofold.studies import laws
from morphofold.studies.shapes import regular_net

pytestmark = pytest.mark.slow  # studies are not shipped: run them when they change


def body_of(k):
    """A body whose K goes from the first to the second number of ``k`` in eleven steps, its exposed area by 10 %."""
    exposed = np.geomspace(1e4, 1.1e4, len(laws.GROWTHS))
    terms = [shape_terms(10**K * e**1.25, e, 1.0) for K, e in zip(np.linspace(*k, len(laws.GROWTHS)), exposed)]
    return laws.Body(laws.GROWTHS, terms, [1e5] * len(terms), [])


def test_the_published_mammals_have_the_published_slope():
    known = laws.species()
    line = stats.linregress(np.log10(known.exposed), np.log10(known.folded))
    assert len(known.exposed) == 57
    assert len(known.primate_area) == 65
    assert line.slope == pytest.approx(1.325, abs=1e-3)
    assert line.stderr == pytest.approx(0.009, abs=1e-3)
    assert (known.mean_k, known.sd_k) == (pytest.approx(-0.552, abs=1e-3), pytest.approx(0.086, abs=1e-3))


def test_the_growths_at_which_a_body_is_among_the_mammals():
    known = laws.species()
    low, high = known.mean_k - 2 * known.sd_k, known.mean_k + 2 * known.sd_k
    assert laws.growth_row("a", body_of((low - 0.3, high - 0.01)), known)[-3:-1] == [
        f"{1 + 0.3 / (high - low + 0.29):.2f}",
        "the end",
    ]
    assert laws.growth_row("a", body_of((low, high + 0.1)), known)[-2] == f"{1 + (high - low) / (high - low + 0.1):.2f}"
    assert laws.growth_row("a", body_of((-2.0, -1.5)), known)[-3:-1] == ["–", "–"]


def test_along_the_law_the_slope_is_its_own():
    assert laws.growth_row("a", body_of((-0.5, -0.5)), laws.species())[-1] == "1.2"  # 5/4
    rise = 1.25 + 0.1 * np.log(10) / np.log(1.1)
    assert laws.growth_row("a", body_of((-0.6, -0.5)), laws.species())[-1] == f"{rise:.1f}"


def test_a_row_across_scales_has_the_slope_and_the_exponent_of_its_law():
    """Bodies with A_total T^(1/2) proportional to A_exposed^(5/4) at every scale."""
    rows = [AtScale(s, shape_terms(1e4**1.25 / (1 + s) ** 0.5, 1e3, 1 + s)) for s in (1.0, 2.0, 4.0, 8.0)]
    row = laws.scales_row("a", rows)
    assert row[7] == "1.25"
    assert row[9] == "−0.50"


def test_a_body_without_folds_has_no_law_across_scales():
    rows = [AtScale(s, shape_terms(1e4, 1e4, 1 + s)) for s in (0.0, 1.0, 2.0, 4.0, 8.0)]
    assert laws.scales_row("a", rows)[6:] == 5 * ["–"]


def test_the_shell_has_its_thickness():
    cortex = laws.shell()
    assert np.linalg.norm(cortex.pial.verts - cortex.white.verts, axis=1) == pytest.approx(2.5)


def test_pictures_are_drawn_from_simulations(tmp_path, monkeypatch):
    monkeypatch.setattr(laws, "GROWTHS", (1.2, 1.4, 2.0))
    monkeypatch.setattr("morphofold.analysis.gyrification.across_scales.FINEST_OVER_T", 1.0)  # quick
    run = made_simulation(tmp_path / "run", "fig5", ["output.stages=[1.2, 1.4]"])
    body = laws.measured(run)
    assert [terms.total for terms in body.terms] == sorted(terms.total for terms in body.terms)
    laws.draw_species(tmp_path / "a.png", laws.species(), {"body": body}, {})
    laws.draw_growth(tmp_path / "b.png", laws.species(), {"body": body}, {"again": body.scales})
    assert all((tmp_path / name).stat().st_size > 10_000 for name in ("a.png", "b.png"))


def test_the_spacing_of_a_net_of_known_length():
    """Ridges along the edges of a dodecahedron: twice the exposed area over the length of their crests."""
    net = regular_net("dodecahedron")
    cortex = folded_ball(20_000, net)
    crest = np.linalg.norm(cortex.pial.verts, axis=1).max()
    exact = 2 * hull(cortex.pial.verts, cortex.faces).area / (crest * net.lengths.sum())
    assert laws.spacing(cortex) == pytest.approx(exact, rel=0.05)
    (row,) = laws.spacing_rows("ball", {"": cortex}, 10.0)
    assert float(row[3]) == pytest.approx(exact / 10, rel=0.06)
