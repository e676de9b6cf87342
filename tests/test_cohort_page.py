"""The page of a group: what it says of whom, that it stays small, and that names can do no harm."""

import base64
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from browser import assert_quiet, needs_browser, opened
from made_groups import failed_group, made_group
from made_measures import made_measures
from matplotlib.image import imread
from page_text import assert_closed, text_read

from morphofold.analysis.measures_result import verdict_columns
from morphofold.group.group_tables import SETTING_NAMES, pooling, write_group
from morphofold.group.task_records import write_record
from morphofold.group_pages import cohort_page
from morphofold.group_pages.cohort_page import group_report
from morphofold.results import write_analysis, write_dataset

NASTY = '<script>alert("x")</script>&"\''
THICKNESS = "mean_cortical_thickness_mm"


def text_of(group, folder):
    folder.mkdir(exist_ok=True)
    return group_report(group, folder).read_text(encoding="utf-8")


def with_outlier(n, k, value, side=0, **more):
    """A group whose subject ``k`` has a cortical thickness of ``value`` on one side."""
    thickness = made_group(n).scalars[THICKNESS].copy()
    thickness[k, side] = value
    return made_group(n, **{THICKNESS: thickness}, **more)


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    """Results of two subjects, one in each layout."""
    folder = tmp_path_factory.mktemp("measured")
    write_dataset([made_measures(name="b")], folder / "bids", "b", report=False)
    return write_analysis([made_measures(name="a")], folder / "a", report=False), folder / "bids/sub-b"


# --- what it says


def test_the_planted_outlier_is_named_with_its_picture_coloured_by_its_measure(tmp_path, measured, monkeypatch):
    """The thickness that was made, 3 + z / 40, above that of another subject."""
    rows, figure = [], cohort_page.figure
    monkeypatch.setattr(
        cohort_page, "figure", lambda rows_drawn, *a: (rows.extend(rows_drawn), figure(rows_drawn, *a))[1]
    )
    results = {f"sub-{k:05d}": measured[k == 4] for k in range(20)}
    text = text_of(with_outlier(20, 4, 7.77, results=results), tmp_path)
    caption = next(text_read(f) for f in re.findall(r"<figcaption><strong>.*?</figcaption>", text, re.DOTALL))
    assert re.match(r"sub-00004 , left: Cortical thickness, mean 7.77 mm , median 2\.\d+, robust z \d+\.\d? ", caption)
    assert imread(tmp_path / "figures" / "outlier-01.png").std() > 0.02
    (data,) = re.findall(r'<img src="data:image/png;base64,([^"]+)"', text)
    assert base64.b64decode(data).startswith(b"\x89PNG")
    outlier, typical = rows
    measured_at = np.isfinite(outlier.values)
    np.testing.assert_allclose(outlier.values[measured_at], 3 + outlier.surface.verts[measured_at, 2] / 40, rtol=1e-5)
    assert outlier.name == "sub-00004"
    assert typical.name.endswith(", at the median")


def test_hemispheres_measured_unlike_are_said_and_not_tested(tmp_path):
    """Hinges by a width of their own in every hemisphere: on the page with their number, in no statistic."""
    group = made_group(9, n_hinges=np.arange(40.0, 58.0).reshape(9, 2))
    assert 'id="unlike"' not in text_of(group, tmp_path)
    assert "n_hinges" in (tmp_path / "asymmetry.tsv").read_text(encoding="utf-8")
    settings = [("1.0", 3.0, "white", 7 + k / 10, 5.0, "<label>", "standard", None) for k in range(18)]
    unlike = pooling(pd.DataFrame(settings, columns=SETTING_NAMES), group.scalars)
    text = text_of(replace(group, pooling=unlike), tmp_path)
    assert 'id="unlike"' in text
    assert 'href="#unlike"' in text
    assert "Hinges 18 18" in text_read(text)
    for name in ("asymmetry", "distributions", "outliers"):
        assert "n_hinges" not in (tmp_path / f"{name}.tsv").read_text(encoding="utf-8")


def test_medians_of_left_and_right_are_of_the_subjects_that_have_both():
    """Five lefts of 2.1 to 2.5 and four rights: the fifth, whose right side failed, is left out of both."""
    gi = np.column_stack([np.array([2.1, 2.2, 2.3, 2.4, 9.9]), np.array([2.1, 2.2, 2.3, 2.4, np.nan])])
    gi += 0.1 * np.array([[0], [0], [1], [1], [1]])
    sides = cohort_page.BOTH_SIDES[:2]
    ((left, right),) = cohort_page.headlines({"gyrification_index": gi}, sides).values()
    assert (left.n, right.n) == (4, 4)
    assert left.median == right.median == pytest.approx(2.3)
    one_sided = np.where([[True, False], [True, False], [False, True]], 2.0, np.nan)
    (row,) = cohort_page.headlines({"gyrification_index": one_sided}, sides).values()
    assert [cell.n for cell in row] == [2, 1]  # nobody has both: n says so


def test_the_greater_side_is_named(tmp_path):
    area = 100 * np.random.default_rng(6).uniform(1, 2, (40, 1)) * [1.05, 0.95]
    area *= 1 + 0.01 * np.random.default_rng(7).standard_normal(area.shape)
    text = text_read(text_of(made_group(40, area_pial_mm2=area), tmp_path))
    assert re.search(r"The sides differ in Pial area \(left greater\).*, by t-tests corrected for 7 measures", text)
    assert re.search(r"Pial area \+(9\.\d|10) ", text)


def test_simulated_bodies_are_counted_where_results_are_read(tmp_path):
    results = {name: tmp_path / "subjects" / name for name in ("brain", "model")}
    (tmp_path / "subjects").mkdir()
    for name, origin in (("brain", "FreeSurfer"), ("model", "simulation")):
        write_analysis([made_measures(name=name, origin=origin)], results[name], report=False)
        write_record(tmp_path / "records" / f"{name}.json", "key", {}, results=True, files={"report.html": "0"})
    assert write_group(tmp_path, results).n_simulated == 1


# --- groups of all kinds


def left_only(n):
    values = made_group(n).scalars
    return made_group(n, **{name: np.column_stack([v[:, 0], np.full(n, np.nan)]) for name, v in values.items()})


@pytest.mark.parametrize(
    ("group", "absent", "methods", "not_in_methods"),
    [
        (made_group(1), [], [], []),
        (made_group(2), [], ["least squares through the means of regions, each"], []),  # no line of two points
        (made_group(3), [], [], ["Iglewicz"]),
        (made_group(12), [], ["Holm", "through subjects and through the means of regions"], []),
        (left_only(1), ["Left against right"], [], []),
        (left_only(12), ["Left against right"], [], ["Holm"]),
        (failed_group(12), ["Distributions", "Left against right", "Outliers"], [], ["least squares"]),
    ],
    ids=["one", "two", "three", "twelve", "one side of one", "left alone", "all failed"],
)
def test_every_group_has_a_page_and_methods_without_what_it_lacks(group, absent, methods, not_in_methods, tmp_path):
    text = text_of(group, tmp_path)
    assert not re.search(r"\b(nan|inf|none measured|none,)\b", text_read(text).lower())
    for svg in re.findall(r"<svg.*?</svg>", text, re.DOTALL):
        assert "nan" not in re.sub(r"<title>.*?</title>", "", svg)
    for name in ("distributions", "asymmetry", "outliers", "remarks"):
        assert (tmp_path / f"{name}.tsv").is_file()
    assert [heading for heading in absent if f"<h2>{heading}" in text] == []
    paragraph = re.search(r'<textarea id="methods".*?</textarea>', text, re.DOTALL).group(0)
    assert [phrase for phrase in methods if phrase not in paragraph] == []
    assert [phrase for phrase in not_in_methods if phrase in paragraph] == []


def test_a_group_of_failures_has_the_first_of_them(tmp_path):
    text = text_read(text_of(failed_group(150), tmp_path))
    assert "0 of 150 subjects have measures" in text
    assert text.count("lh.white: no such file.") == 200
    assert "And 100 more in failures.tsv" in text


def test_measures_that_are_the_same_of_all_are_not_drawn_and_the_number_of_vertices_has_no_sides(tmp_path):
    equal = np.full((12, 2), 1.75) * (1 + 1e-8 * np.arange(24).reshape(12, 2))  # but for round-off
    vertices = np.array([[100.0, 200.0]] * 12)
    group = made_group(12, n_hinges=np.zeros((12, 2)), gyrification_index=equal, n_vertices=vertices)
    charts = set(re.findall(r'aria-label="Distribution of ([^"]+)"', text_of(group, tmp_path)))
    assert {"Pial area", "Vertices"} < charts
    assert not {"Hinges", "Gyrification index", "Euler characteristic"} & charts
    assert "n_vertices" not in (tmp_path / "asymmetry.tsv").read_text(encoding="utf-8")


def test_hemispheres_to_leave_out_come_before_those_to_check_and_those_to_use_are_not_listed(tmp_path):
    codes = {"a": "", "b": "holes", "c": "pair mesh", "d": "mesh"}
    noted = {who: verdict_columns(dict.fromkeys(names.split(), "")) for who, names in codes.items()}
    rows = [{"subject": who, "hemi": "lh", **columns} for who, columns in noted.items()]
    text = text_of(replace(made_group(4, names="abcd"), hemisphere_rows=rows), tmp_path)
    assert "3 hemispheres to check or to leave out" in text_read(text)
    (table,) = re.findall(r'data-name="verdicts">.*?</table>', text, re.S)
    listed = re.findall(r'<th scope="row">(\w)</th>.*?<td class="words">([\w ]+)</td>(.*?)</tr>', table)
    assert [(who, words, cell.count("<div>")) for who, words, cell in listed] == [
        ("c", "leave out", 2),
        ("b", "check", 1),
        ("d", "check", 1),
    ]


# --- names and scripts


def test_names_are_escaped_and_the_page_runs_its_one_script_and_asks_for_nothing_outside_itself(tmp_path, measured):
    names = [f"{NASTY}{k}" for k in range(12)]
    failures = [{"subject": names[2], "hemi": None, "reason": NASTY, "log": NASTY}]
    results = {name: measured[0] for name in names}
    notes = {"remarks": {names[0]: [NASTY]}, "same": [names[:2]], "failures": failures}
    group = with_outlier(12, 4, 9.9, names=names, results=results, **notes)
    group.regions[NASTY] = group.regions["insula"]
    text = text_of(group, tmp_path)
    assert text.count("&lt;script&gt;alert") > 8
    assert_closed(text)


# --- sizes


@pytest.mark.slow
def test_the_same_group_gives_the_same_bytes(tmp_path, measured):
    results = {f"sub-{k:05d}": measured[k == 4] for k in range(20)}
    files = []
    for name in ("first", "second"):
        text_of(with_outlier(20, 4, 7.77, results=results), tmp_path / name)
        paths = sorted(p for p in (tmp_path / name).rglob("*") if p.is_file())
        files.append({str(p.relative_to(tmp_path / name)): p.read_bytes() for p in paths})
    assert "figures/outlier-01.png" in files[0]
    assert files[0] == files[1]


@pytest.mark.slow
def test_a_page_holds_a_bounded_number_of_pictures(tmp_path, measured, monkeypatch):
    """What does not fit lies beside it, and the page says where."""
    monkeypatch.setattr(cohort_page, "MOST_EMBEDDED_CHARACTERS", 300_000)
    results = {f"sub-{k:05d}": measured[0] for k in range(40)}
    thickness = made_group(40).scalars[THICKNESS].copy()
    thickness[:9, 0] = 9 + np.arange(9)
    text = text_of(made_group(40, results=results, **{THICKNESS: thickness}), tmp_path)
    data = re.findall(r'<img src="data:image/png;base64,([^"]+)"', text)
    assert 0 < sum(map(len, data)) <= 300_000
    assert len(list((tmp_path / "figures").iterdir())) == 9
    assert text.count("The picture is <code>figures/outlier-") == 9 - len(data)


MANY = """
import resource, sys
sys.path.insert(0, sys.argv[2])
from pathlib import Path
from made_groups import made_group
from morphofold.analysis.measures_result import SCALARS
from morphofold.group_pages.cohort_page import group_report
import numpy as np

def peak():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024

def group(n):
    noise = np.random.default_rng(1)
    values = {name: 5 + noise.standard_normal((n, 2)) for name in SCALARS}
    names = [f"sub-{k:05d}" for k in range(n)]
    failures = [{"subject": s, "hemi": "lh", "reason": "no " * 60, "log": f"logs/{s}.log"} for s in names[::3]]
    same = [[a, b] for a, b in zip(names[::2], names[1::2])]
    return made_group(n, failures=failures, same=same, remarks={s: ["lh: " + "x " * 150] for s in names}, **values)

out = Path(sys.argv[1])
for n in (100, 10_000):
    (out / str(n)).mkdir()
    group_report(group(n), out / str(n))
    print(peak())
"""


@pytest.mark.slow
def test_the_page_of_ten_thousand_subjects_is_small_and_so_is_the_memory_it_takes(tmp_path):
    """Under 2 MB; a hundred times the subjects take less than 20 kB more for each of them, points and sentences too."""
    cwd = str(Path(__file__).parent)
    done = subprocess.run([sys.executable, "-c", MANY, str(tmp_path), cwd], capture_output=True, text=True, check=True)
    few, many = map(float, done.stdout.split())
    assert (many - few) * 1024 < 20 * 9900
    text = (tmp_path / "10000" / "report.html").read_text(encoding="utf-8")
    assert len(text.encode()) < 2_000_000
    for phrase in ("more in failures.tsv", "9 950 more subjects in remarks.tsv", "4 950 more such groups"):
        assert phrase in text_read(text)
    assert len((tmp_path / "10000" / "remarks.tsv").read_text(encoding="utf-8").splitlines()) == 10_001


# --- charts


def test_bins_of_counts_hold_as_many_whole_numbers_each(rng):
    """Counts from 100 to 299, each once: bins of a side are level but for the last."""
    edges = cohort_page._bin_edges(np.arange(100.0, 300.0), 10_000)
    counts = np.histogram(np.arange(100.0, 300.0), edges)[0]
    assert set(np.diff(edges)) == {5}
    assert set(counts[1:-1]) == {5}
    assert len(edges) <= 49
    values = rng.standard_normal(50)
    edges = cohort_page._bin_edges(values, 50)
    np.testing.assert_allclose(edges, np.linspace(values.min(), values.max(), 15))


def test_a_histogram_of_a_group_counts_every_subject(rng):
    """Heights of the steps of a side, read off its picture, add up to the subjects."""
    values = np.column_stack([rng.uniform(2, 3, 200), np.full(200, np.nan)])
    chart = str(cohort_page._histogram_chart(THICKNESS, values, cohort_page.BOTH_SIDES[:1]))
    path = re.search(r'<g class="curve">.*?<path d="([^"]+)"', chart, re.DOTALL).group(1)
    heights = np.array([line.split()[1:] for line in path.splitlines() if line.split()[1:]], dtype=float)[1:-1:2, 1]
    ticks = re.findall(r'<g class="ytick.*?<use[^>]* y="([\d.]+)".*?<text[^>]*>(\d+)</text>', chart, re.DOTALL)
    (y0, low), (y1, high) = [(float(y), int(label)) for y, label in (ticks[0], ticks[-1])]
    counts = low + (heights - y0) / (y1 - y0) * (high - low)
    np.testing.assert_allclose(counts, np.round(counts), atol=0.05)
    assert round(counts.sum(), 1) == 200  # the least and the greatest, too
    far = with_outlier(30, 4, 1e4).scalars[THICKNESS]  # a value far beyond does not squeeze the others into one bin
    chart = str(cohort_page._histogram_chart(THICKNESS, far, cohort_page.BOTH_SIDES))
    assert max(map(float, re.findall(r"text-anchor: middle[^>]*>([\d.]+)</text>", chart))) < 3


@needs_browser
def test_a_browser_has_nothing_to_complain_of_and_a_phone_need_not_scroll_aside(tmp_path, measured):
    results = {f"sub-{k:05d}": measured[k == 4] for k in range(20)}
    failures = [{"subject": "x" * 60, "hemi": None, "reason": "a/" * 80, "log": "logs/x.log"}]
    group_report(with_outlier(20, 4, 7.77, results=results, failures=failures), tmp_path)
    with opened(tmp_path / "report.html", tmp_path / "profile", "tables") as tab:
        assert_quiet(tab)
        tab.call("Emulation.setDeviceMetricsOverride", width=400, height=900, deviceScaleFactor=1, mobile=True)
        assert tab.js("document.documentElement.scrollWidth") == 400
