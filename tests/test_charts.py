"""Charts: ticks and numbers that read well, curves and lines where the numbers are."""

import html
import re
from dataclasses import dataclass, replace
from xml.etree import ElementTree

import matplotlib
import numpy as np
import pytest

from morphofold.analysis.gyrification.folding_indices import shape_terms
from morphofold.comparison import Cloud, ThicknessPoint, fit_line
from morphofold.number_texts import number
from morphofold.report.plots import charts
from morphofold.report.plots.figure_style import ticks


def test_ticks_are_round_and_inside():
    assert ticks(0.3, 9.7) == [2, 4, 6, 8]
    assert ticks(-0.5, 0.5, n_ticks=5) == [-0.4, -0.2, 0.0, 0.2, 0.4]
    assert ticks(3, 3) == [3]


def test_numbers_read_well():
    missing = {None: "–", float("nan"): "–"}
    texts = {2.456: "2.46", -0.01234: "−0.0123", 152893: "152\u202f893", 0.0: "0", 3e-13: "3.00e−13", 7: "7"}
    for x, text in (*missing.items(), *texts.items(), (12345.6, "12\u202f346")):
        assert number(x) == text


@dataclass(frozen=True)
class Pen:
    """How a surface is called and drawn."""

    name: str = "a"
    colour: str = "#000000"
    marker: str = "circle"
    dash: str = ""


def drawn_path(svg, kind):
    """Corners (P, 2) in pixels of the one drawn line of a class."""
    (path,) = re.findall(rf'<g class="{kind}">.*?<path d="([^"]+)"', svg, re.DOTALL)
    return np.array([line.split()[1:] for line in path.splitlines() if line.split()[1:]], dtype=float)


def drawn_points(svg):
    """Places (P, 2) in pixels of all points."""
    uses = re.findall(r'</title>\s*<use [^>]*x="([\d.]+)" y="([\d.]+)"', svg)
    return np.array(uses, dtype=float)


def test_a_histogram_holds_all_of_the_area():
    """The area under the drawn curve is 1, less what lies beyond the 0.5th and 99.5th percentile."""
    rng = np.random.default_rng(0)
    values, weights = rng.normal(2, 0.5, 20_000), rng.uniform(0, 1, 20_000)
    path = drawn_path(str(charts.histograms([(Pen(), values, weights)], "Thickness", "mm")), "curve")
    low, high = np.percentile(values, [0.5, 99.5])
    ends = low - 0.02 * (high - low), high + 0.02 * (high - low)
    heights = path[:, 1].max() - path[:, 1]
    fraction = np.trapezoid(heights, path[:, 0]) / np.ptp(path[:, 0]) / heights.max()  # of a box around it
    peak = np.histogram(values, np.linspace(*ends, 49), weights=weights)[0].max() / weights.sum()
    assert fraction * 48 * peak == pytest.approx(0.995, abs=0.01)
    assert charts.histograms([(Pen(), np.full(3, np.nan), np.ones(3))], "x", "") is None


def test_a_histogram_weighs_its_values():
    """Nine tenths of the weight at 1, the rest at 3, as many values each: bars nine to one."""
    values, weights = np.repeat([1.0, 3.0], 500), np.repeat([9.0, 1.0], 500)
    x, y = drawn_path(str(charts.histograms([(Pen(), values, weights)], "Thickness", "mm")), "curve").T
    height = y.max() - y
    middle = (x.min() + x.max()) / 2
    assert height[x < middle].max() / height[x > middle].max() == pytest.approx(9, rel=0.02)


def height_at(ends, x):
    """Height of a line at ``x``, beyond its ends too."""
    (x0, y0), (x1, y1) = ends
    return y0 + (y1 - y0) / (x1 - x0) * (x - x0)


def cloud_of(*pairs):
    points = tuple(ThicknessPoint(x, y, "p") for x, y in pairs)
    return Cloud("region", points, fit=fit_line(points))


def test_theory_and_fit_run_through_the_points_that_lie_on_them():
    cloud = cloud_of(*((t, 4.5 * t) for t in (1.0, 2.0, 3.0)))
    svg = str(charts.thickness_plot([(Pen(dash="7 3"), cloud)], [(4.5, "theory")]))
    points = drawn_points(svg)
    assert len(points) == 3
    for kind in ("theory", "fit"):
        np.testing.assert_allclose(height_at(drawn_path(svg, kind), points[:, 0]), points[:, 1], atol=1e-3)
    assert "stroke-dasharray: 7,3" in svg


def test_a_fit_with_no_slope_to_speak_of_is_faint():
    svg = str(charts.thickness_plot([(Pen(), cloud_of((1, 5), (2, 9), (3, 4), (4, 8)))], []))
    assert '<g class="fit faint">' in svg
    assert "stroke-opacity: 0.45" in svg


def test_surfaces_lie_on_the_line_of_their_k_and_bodies_move_towards_larger_ones():
    terms = shape_terms(0.3 * 40_000**1.25 / 2**0.5, 40_000, 2.0)
    assert terms.k == pytest.approx(0.3)
    path = [shape_terms(a, 30_000, 2.0) for a in (40_000, 80_000)]
    svg = str(charts.folding_plot([(Pen(), terms)], [("body", path)]))
    level = re.search(r'<g class="level">\s*<g><title>k = 0.3</title>.*?</g>', svg, re.DOTALL)[0]
    ((x, y),) = drawn_points(svg)
    assert height_at(drawn_path(level, "level"), x) == pytest.approx(y, abs=1e-3)
    (x0, y0), (x1, y1) = drawn_path(svg, "theory")
    assert x0 == x1 < x
    assert y1 < y0  # up
    assert charts.folding_plot([], []) is None


def test_every_mark_reads_its_own_words_and_no_name_is_markup_or_a_formula():
    nasty = '<b>&"$x_1$'
    cloud = replace(cloud_of((1, 2), (2, 3.5), (3, 5)), bins=(ThicknessPoint(2, 3, nasty, 1, 4),))
    svg = charts.thickness_plot([(Pen(nasty), cloud)], [(1.0, nasty)])
    histogram = charts.histograms([(Pen(nasty), np.arange(9.0), np.ones(9))], nasty, "$m$")
    for text in map(str, (svg, histogram)):
        tree = ElementTree.fromstring(text.replace("<svg ", '<svg xmlns:xlink="http://www.w3.org/1999/xlink" ', 1))
        assert not [part for part in tree.iter() if part.tag.endswith(("}b", "}a", "}style"))]
    titles = [html.unescape(title) for title in re.findall("<title>(.*?)</title>", str(svg))]
    places = [f"{nasty}, p: {y} mm at {x} mm" for x, y in ((1, 2), (2, "3.50"), (3, 5))]
    assert titles[1:] == [nasty, *2 * [f"{nasty}, {nasty}"], *places]
    assert f"{nasty} [$m$]" in html.unescape(str(histogram))


def test_a_chart_has_the_same_bytes_each_time_whatever_the_users_settings():
    chart = lambda: str(charts.growth_chart("k", [("body", np.array([1.0, 1.5, 2.0]), np.arange(3.0))], [(Pen(), 1.0)]))
    with matplotlib.rc_context({"font.size": 30, "svg.fonttype": "path", "axes.grid": False}):
        other = chart()
    assert chart() == other
    assert "DejaVu" in other
    assert "dc:date" not in other


def test_a_dot_of_a_region_reads_its_number_and_regions_go_up_by_the_mean_of_both_sides():
    numbers = {
        ("a", "lh"): 3.0,
        ("a", "rh"): 1.0,
        ("b", "lh"): 1.0,
        ("b", "rh"): 2.0,
        ("c", "lh"): None,
        ("c", "rh"): 9.0,
    }
    rows = [{"region": region, "hemi": hemi, "t": value} for (region, hemi), value in numbers.items()]
    svg = charts.region_dots(rows, "t", "Thickness", "mm")
    read = {name: float(text) for name, text in re.findall(r"<title>(\w+ \w): ([\d.]+) mm</title>", svg)}
    assert read == {"lh a": 3, "rh a": 1, "lh b": 1, "rh b": 2, "rh c": 9}
    labels = re.findall(r">([abc])</text>", svg)
    assert labels == ["b", "a", "c"]
    assert charts.region_dots(rows[:2], "t", "Thickness", "mm") is None
