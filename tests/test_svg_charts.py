"""Charts: ticks and numbers that read well, curves and lines where the numbers are."""

import re

import numpy as np
import pytest

from morphofold.analysis.gyrification.scaling import shape_terms
from morphofold.comparison import Point, fit_line
from morphofold.report.plots import svg as plots


def test_ticks_are_round_and_inside():
    assert plots.ticks(0.3, 9.7) == [2, 4, 6, 8]
    assert plots.ticks(-0.5, 0.5, about=5) == [-0.4, -0.2, 0.0, 0.2, 0.4]
    assert plots.ticks(3, 3) == [3]


@pytest.mark.parametrize(
    ("x", "text"),
    [(None, "–"), (float("nan"), "–"), (2.456, "2.46"), (-0.01234, "−0.0123"), (152893, "152\u202f893"), (0.0, "0"),
     (3e-13, "3.00e−13"), (12345.6, "12\u202f346"), (7, "7")],
)  # fmt: skip
def test_numbers_read_well(x, text):
    assert plots.number(x) == text


def test_a_histogram_holds_all_of_the_area():
    """The area under the drawn curve is 1, less what lies beyond the 0.5th and 99.5th percentile."""
    rng = np.random.default_rng(0)
    values, weights = rng.normal(2, 0.5, 20_000), rng.uniform(0, 1, 20_000)
    svg = str(plots.histograms([("a", values, weights, "#000000", "")], "Thickness", "mm"))
    path = re.search(r'class="curve" d="M([^"]+)"', svg).group(1)
    points = np.array([[float(v) for v in p.split(",")] for p in path.split("L")])
    low, high = np.percentile(values, [0.5, 99.5])
    axes = plots.Axes((low - 0.02 * (high - low), high + 0.02 * (high - low)), (0, 1))
    left, right = axes.px(axes.x[0]), axes.px(axes.x[1])
    step = (axes.x[1] - axes.x[0]) / (right - left)
    top = float(points[:, 1].min())
    bottom = float(points[:, 1].max())
    share = np.trapezoid(bottom - points[:, 1], points[:, 0] * step) / (bottom - top)
    peak = np.histogram(values, np.linspace(*axes.x, 49), weights=weights)[0].max() / weights.sum()
    peak /= (axes.x[1] - axes.x[0]) / 48
    assert share * peak == pytest.approx(0.995, abs=0.01)
    assert plots.histograms([("a", np.full(3, np.nan), np.ones(3), "#000000", "")], "x", "") is None


def test_a_histogram_weighs_its_values():
    """Nine tenths of the weight at 1, the rest at 3, as many values each: bars nine to one."""
    values, weights = np.repeat([1.0, 3.0], 500), np.repeat([9.0, 1.0], 500)
    svg = str(plots.histograms([("a", values, weights, "#000000", "")], "Thickness", "mm"))
    path = re.search(r'class="curve" d="M([^"]+)"', svg).group(1)
    x, y = np.array([[float(v) for v in p.split(",")] for p in path.split("L")]).T
    height = y.max() - y
    middle = (x.min() + x.max()) / 2
    assert height[x < middle].max() / height[x > middle].max() == pytest.approx(9, rel=0.02)


def drawn_line(svg, kind):
    """The ends of the one line of a class, (2, 2) in pixels."""
    (path,) = re.findall(rf'class="{kind}" d="M([^"]+)"', svg)
    return np.array([[float(v) for v in p.split(",")] for p in path.split("L")])


def beside(ends, x):
    """Height of a line at ``x``, beyond its ends too."""
    (x0, y0), (x1, y1) = ends
    return y0 + (y1 - y0) / (x1 - x0) * (x - x0)


def test_theory_and_fit_run_through_the_points_that_lie_on_them():
    points = [Point(t, 4.5 * t, "p") for t in (1.0, 2.0, 3.0)]
    cloud = {
        "name": "a", "colour": "#000000", "marker": "circle", "dash": "7 3", "points": points, "bins": (),
        "fit": fit_line(points),
    }  # fmt: skip
    svg = str(plots.thickness_plot([cloud], [(4.5, "theory")]))
    drawn = np.array([[float(v) for v in p] for p in re.findall(r'<circle cx="([\d.]+)" cy="([\d.]+)"', svg)])
    assert len(drawn) == 3
    for kind in ("theory", "fit"):
        np.testing.assert_allclose(beside(drawn_line(svg, kind), drawn[:, 0]), drawn[:, 1], atol=0.3)
    assert 'stroke-dasharray="7 3"' in svg


def test_a_fit_with_no_slope_to_speak_of_is_faint():
    points = [Point(x, y, "p") for x, y in ((1, 5), (2, 9), (3, 4), (4, 8))]
    cloud = {"name": "a", "colour": "#000000", "marker": "circle", "dash": "", "points": points, "bins": ()}
    assert 'class="fit faint"' in str(plots.thickness_plot([{**cloud, "fit": fit_line(points)}], []))


def test_surfaces_lie_on_the_line_of_their_k_and_bodies_move_towards_larger_ones():
    one = shape_terms(0.3 * 40_000**1.25 / 2**0.5, 40_000, 2.0)
    assert one.k == pytest.approx(0.3)
    path = [shape_terms(a, 30_000, 2.0) for a in (40_000, 80_000)]
    svg = str(plots.folding_plot([("one", one, "#000000", "circle")], [("body", path)]))
    level = re.search(r'class="level" d="M([^"]+)"><title>k = 0.3</title>', svg)[1]
    ends = np.array([[float(v) for v in p.split(",")] for p in level.split("L")])
    x, y = (float(v) for v in re.search(r'<circle cx="([\d.]+)" cy="([\d.]+)"', svg).groups())
    assert beside(ends, x) == pytest.approx(y, abs=0.2)
    (x0, y0), (x1, y1) = drawn_line(svg, "theory")
    assert x0 == x1 < x
    assert y1 < y0                                                      # up
    assert plots.folding_plot([], []) is None


def test_the_weighted_median_is_the_middle_of_the_weight():
    assert plots.weighted_median(np.array([5.0, 1.0, 3.0]), np.array([1.0, 1.0, 1.0])) == 3
    assert plots.weighted_median(np.array([5.0, 1.0, 3.0]), np.array([9.0, 1.0, 1.0])) == 5
