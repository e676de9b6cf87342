"""Tables of regions against files and a table that FreeSurfer wrote, and the line through the regions of a brain."""

import csv
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import theilslopes

from morphofold.analysis import gray_volumes, region_table, vertex_areas, wide_table
from morphofold.analysis.region_tables import REGION_COLUMNS
from morphofold.analysis.thickness.robust_slope import robust_line, through_regions
from morphofold.errors import NoSolution, WrongShape
from morphofold.io import sample_path
from morphofold.studies import known_shapes
from morphofold.surface import Cortex, Regions, Surface


@pytest.fixture(scope="module")
def excerpt():
    with np.load(sample_path("subject1_excerpt") / "excerpt.npz", allow_pickle=False) as file:
        return dict(file)


@pytest.fixture(scope="module")
def published():
    with open(sample_path("subject1_excerpt") / "lh.aparc.stats.tsv", encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file, delimiter="\t"))


def table_of(excerpt, hemi="lh"):
    maps = {k: excerpt[v].astype(float) for k, v in (("area", "area"), ("cortical_thickness", "thickness"))}
    return region_table(labelled(excerpt["labels"], [str(n) for n in excerpt["region_names"]], hemi), maps)


def labelled(labels, names, hemi="lh"):
    """A cortex of as many vertices as labels; its surface does not matter."""
    n = len(labels)
    verts, faces = np.zeros((n, 3)), np.array([[0, 1, 2]])
    verts[:3] = np.eye(3)
    surface = Surface(verts, faces)
    regions = Regions(np.asarray(labels, dtype=np.int64), tuple(names), np.zeros((len(names), 3), dtype=np.uint8))
    return Cortex(surface, surface, hemi, regions=regions)


def test_region_table_equals_the_one_freesurfer_wrote(excerpt, published):
    table = table_of(excerpt)
    assert {tuple(row) for row in table} == {REGION_COLUMNS}
    assert [row["region"] for row in table] == [row["StructName"] for row in published]
    for row, expected in zip(table, published, strict=True):
        assert row["n_vertices"] == int(expected["NumVert"])
        assert row["area_mm2"] == pytest.approx(float(expected["SurfArea"]), abs=0.5)
        assert row["cortical_thickness_mm"] == pytest.approx(float(expected["ThickAvg"]), abs=0.0005)
        assert row["cortical_thickness_sd_mm"] == pytest.approx(float(expected["ThickStd"]), abs=0.0005)


def test_vertex_areas_of_an_individual_equal_freesurfers_area_file(excerpt):
    area = vertex_areas(excerpt["patch_verts"].astype(float), excerpt["patch_faces"].astype(np.int64))
    whole = excerpt["patch_complete"]
    assert np.count_nonzero(whole) == 4623
    assert np.abs(area - excerpt["patch_area"])[whole].max() < 1.5e-6


def test_means_leave_out_nan_and_labels_without_a_region_make_no_row():
    cortex = labelled([0, 0, 0, 1, 1, -1, 2], ["a", "b", "unknown", "empty"])
    maps = {
        "area": np.arange(7.0),
        "cortical_thickness": np.array([1, 3, np.nan, np.nan, np.nan, 9, 9.0]),
        "gyral_thickness": np.array([5, 6, 100, np.nan, 7, 9, 9.0]),
        "thickness_file": np.array([1, np.nan, 2, 4, 4, 9, 9.0]),
    }
    a, b = region_table(cortex, maps)
    assert (a["n_vertices"], a["area_mm2"], a["cortical_thickness_mm"], a["cortical_thickness_sd_mm"]) == (3, 3, 2, 1)
    assert (a["gyral_thickness_mm"], a["thickness_file_mm"], b["thickness_file_mm"]) == (6, 1.5, 4)
    assert (b["n_vertices"], b["cortical_thickness_mm"], b["gyral_thickness_mm"]) == (2, None, 7)


def test_a_map_of_another_surface_is_refused():
    with pytest.raises(WrongShape, match=r"\barea\b.*\(2,\).*\b3 vertices"):
        region_table(labelled([0, 0, 0], ["a"]), {"area": np.ones(2)})
    assert region_table(replace(labelled([0, 0, 0], ["a"]), regions=None), {}) == []


def test_a_region_with_little_contour_has_no_gyral_thickness():
    """The width of a single fold is no region's: less than two widths of contour, and the column is empty."""

    def widths(length):
        return SimpleNamespace(median=10.0, contour_where=lambda *_: length, median_where=lambda *_: 9.0)

    cortex = labelled([0, 0, 0, 0], ["one"])
    short, long = (region_table(cortex, {}, widths(length))[0] for length in (19.0, 21.0))
    assert (short["gyral_thickness_mm"], short["gyral_contour_mm"]) == (None, 19.0)
    assert long["gyral_thickness_mm"] == 9.0


def test_the_gyrification_of_a_region_is_the_mean_of_the_local_index_over_pial_area():
    verts, faces = known_shapes.icosphere(3)
    stretched = verts * [1.0, 1.0, 3.0]  # so that vertices differ in area
    labels = (verts[:, 2] > 0).astype(np.int64)
    cortex = replace(shell(labels), pial=Surface(60 * stretched, faces))
    index = np.where(verts[:, 0] > 0, 2.0, 1.0)
    index[labels == 1] = np.where(verts[labels == 1, 1] > 0.5, np.nan, 3.0)
    areas = vertex_areas(cortex.pial.verts, faces)
    low, high = region_table(cortex, {"local_gyrification_index": index})
    below = labels == 0
    assert low["gyrification_index"] == pytest.approx((index * areas)[below].sum() / areas[below].sum())
    assert high["gyrification_index"] == pytest.approx(3.0, rel=1e-12)
    assert region_table(cortex, {})[0]["gyrification_index"] is None


def shell(labels, outer=50.0, **more):
    """Concentric spheres, the inner of 47 mm, with regions."""
    verts, faces = known_shapes.icosphere(3)
    names = tuple("abcd"[: labels.max() + 1])
    regions = Regions(labels, names, np.arange(3 * len(names), dtype=np.uint8).reshape(-1, 3))
    return Cortex(Surface(47 * verts, faces), Surface(outer * verts, faces), regions=regions, **more)


def enclosed(surface):
    """Volume inside a closed surface, by the divergence theorem."""
    return np.linalg.det(surface.verts[surface.faces]).sum() / 6


def test_gray_volume_between_concentric_spheres_is_exact_and_shared_by_regions():
    verts, _ = known_shapes.icosphere(3)
    labels = (verts[:, 2] > 0).astype(np.int64)
    cortex = shell(labels)
    between = enclosed(cortex.pial) - enclosed(cortex.white)
    assert between == pytest.approx(4 / 3 * np.pi * (50**3 - 47**3), rel=0.02)
    rows = region_table(cortex, {})
    assert sum(row["gray_volume_mm3"] for row in rows) == pytest.approx(between, rel=1e-12)
    areas = vertex_areas(cortex.white.verts, cortex.faces)  # radial: a wedge is as large as its triangle
    for row, inside in zip(rows, (labels == 0, labels == 1)):
        assert row["gray_volume_mm3"] == pytest.approx(between * areas[inside].sum() / areas.sum(), rel=1e-6)


def test_gray_volume_between_twisted_surfaces_is_pial_less_white_whichever_corner_comes_first(rng):
    """The sides of these wedges are far from flat. Three tetrahedra for each miss by 0.03 %."""
    verts, faces = known_shapes.icosphere(3)
    outer = 50 * verts + rng.uniform(-1, 1, verts.shape)
    expected = enclosed(Surface(outer, faces)) - enclosed(Surface(47 * verts, faces))
    for order in ([0, 1, 2], [1, 2, 0], [2, 0, 1]):
        volumes = gray_volumes(Cortex(Surface(47 * verts, faces[:, order]), Surface(outer, faces[:, order])))
        assert volumes.sum() == pytest.approx(expected, rel=1e-12)


def test_what_is_off_the_cortex_has_no_gray_volume():
    verts, _ = known_shapes.icosphere(3)
    inside = verts[:, 2] > 0
    whole, part = (region_table(shell(0 * inside, cortex=mask), {})[0] for mask in (None, inside))
    assert 0.4 < part["gray_volume_mm3"] / whole["gray_volume_mm3"] < 0.55
    assert part["area_mm2"] == whole["area_mm2"]


def test_the_mean_curvature_of_a_region_is_weighted_by_its_pial_area():
    cortex = shell(np.zeros(642, dtype=np.int64))
    (row,) = region_table(cortex, {"H": np.full(642, 1 / 50)})
    assert row["mean_H_per_mm"] == pytest.approx(1 / 50)
    bent = np.where(np.arange(642) < 12, 1.0, -0.5)
    bent[100:] = np.nan
    area = vertex_areas(cortex.pial.verts, cortex.faces)
    expected = (area[:12].sum() - 0.5 * area[12:100].sum()) / area[:100].sum()
    assert abs(expected - bent[:100].mean()) > 1e-3  # the first twelve are five-valent, so smaller
    assert region_table(cortex, {"H": bent})[0]["mean_H_per_mm"] == pytest.approx(expected, rel=1e-12)
    assert region_table(cortex, {})[0]["mean_H_per_mm"] is None


def test_the_wide_table_has_the_columns_and_numbers_of_aparcstats2table(excerpt, published):
    left, right = (table_of(excerpt, hemi) for hemi in ("lh", "rh"))
    bert, ernie = wide_table({"bert": left + right, "ernie": left[1:]})
    assert list(bert) == list(ernie)
    assert next(iter(bert)) == "subject"
    assert len(bert) == 1 + 2 * len(published) * (len(REGION_COLUMNS) - 2)
    for row in published:
        region = row["StructName"]
        assert bert[f"lh_{region}_area"] == pytest.approx(float(row["SurfArea"]), abs=0.5)
        assert bert[f"rh_{region}_thickness"] == pytest.approx(float(row["ThickAvg"]), abs=0.0005)
        assert bert[f"lh_{region}_thicknessstd"] == pytest.approx(float(row["ThickStd"]), abs=0.0005)
        assert bert[f"lh_{region}_n_vertices"] == int(row["NumVert"])
    assert ernie[f"lh_{published[0]['StructName']}_area"] is None
    assert ernie[f"lh_{published[1]['StructName']}_area"] == bert[f"lh_{published[1]['StructName']}_area"]
    assert {k.rsplit("_", 1)[1] for k in bert if k.startswith("lh_bankssts_")} >= {"volume", "area", "thickness"}


def rows(x, y):
    return [{"cortical_thickness_mm": float(a), "gyral_thickness_mm": float(b)} for a, b in zip(x, y, strict=True)]


def test_slope_and_correlation_are_those_of_least_squares(rng):
    x, y = rng.uniform(1, 4, 20), rng.uniform(5, 15, 20)
    line, note = through_regions([*rows(x, y), {"cortical_thickness_mm": 3.0, "gyral_thickness_mm": None}])
    assert [line.slope, line.intercept] == pytest.approx(np.polyfit(x, y, 1))
    assert line.r == pytest.approx(np.corrcoef(x, y)[0, 1])
    assert line.robust == pytest.approx(theilslopes(y, x)[0])
    assert line.low < line.robust < line.high
    assert "20 regions" in note


def test_three_odd_regions_do_not_turn_the_robust_slope(rng):
    x = np.linspace(2, 3.5, 34)
    y = 4 + 2 * x + 0.1 * rng.standard_normal(34)
    y[[30, 31, 33]] += 20
    line = robust_line(x, y)
    assert line.slope > 5
    assert line.robust == pytest.approx(2, abs=0.3)
    assert line.low < 2 < line.high


@pytest.mark.slow
def test_the_bounds_hold_the_true_slope_as_often_as_they_say():
    """95 % of 200 sets of 34 points: 190, and at least 178 but once in a thousand times."""
    inside = 0
    for seed in range(200):
        rng = np.random.default_rng(seed)
        x = rng.uniform(1.5, 3.5, 34)
        line = robust_line(x, 5 + 1.5 * x + rng.standard_normal(34), seed)
        inside += line.low < 1.5 < line.high
    assert 178 <= inside < 200


def test_too_few_or_equal_points_have_no_line():
    for x, y in (([1.0, 2.0], [1.0, 2.0]), ([2.0, 2.0, 2.0], [1.0, 2.0, 3.0]), ([1.0, 2.0, 3.0], [4.0, 4.0, 4.0])):
        line, note = through_regions(rows(x, y))
        assert line is None
        assert f"there are {len(x)}" in note
        with pytest.raises(NoSolution, match=rf"\b3\b.* {len(x)}\.$"):
            robust_line(np.array(x), np.array(y))


@pytest.mark.parametrize("n", [3, 4, 5])
def test_few_points_have_no_bounds(n, rng):
    line = robust_line(np.arange(float(n)), np.arange(n) + 0.1 * rng.standard_normal(n))
    assert line.robust == pytest.approx(1, abs=0.4)
    assert np.isnan([line.low, line.high]).all() == (n < 5)
