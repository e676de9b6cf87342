"""Packing, colours, charts, pictures and pages; what a browser does with them is in test_viewer.py."""

import base64
import hashlib
import json
import re
import struct
import subprocess
import sys
import zlib
from dataclasses import replace
from html.parser import HTMLParser
from importlib import resources

import numpy as np
import pytest
from made_measures import made_cortex, made_measures

from morphofold.analysis.scaling import shape_terms
from morphofold.comparison import Point, compare, fit_line
from morphofold.report import colours, figures, pack, page, plots, raster
from morphofold.report.page import analysis_report
from morphofold.report.png import lettering, png_bytes
from morphofold.report.quantities import Quantity, common_limits, quantity
from morphofold.shapes import icosphere
from morphofold.surface import Surface

GREY = Quantity("t", "Test", "mm")


# packing -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("dtype", [np.uint16, np.uint32])
@pytest.mark.parametrize("stride", [1, 3])
def test_encoding_is_undone_by_decoding_for_any_numbers(rng, dtype, stride):
    a = rng.integers(0, np.iinfo(dtype).max, 1000, dtype=dtype, endpoint=True)
    data = pack.encode(a, stride)
    np.testing.assert_array_equal(pack.decode(data, a.size, a.itemsize, stride), a)
    assert len(data) == a.nbytes
    with pytest.raises(TypeError, match="got float64"):
        pack.encode(a.astype(float))


def unpack(packed):
    raw = zlib.decompress(base64.b64decode(packed.data))
    arrays = packed.meta["arrays"]
    return {
        name: pack.decode(raw[a["at"] : a["at"] + a["n"] * a["bytes"]], a["n"], a["bytes"], a["stride"])
        for name, a in arrays.items()
    }


def test_a_packed_surface_and_its_maps_come_back_within_their_step():
    m = made_measures()
    packed = pack.pack(m.cortex, m.maps, {"sulcal_depth": 0.01})
    arrays, ids = unpack(packed), unpack(packed)["ids"].astype(int)
    box = packed.meta["surfaces"]["white"]
    verts = np.array(box["low"]) + arrays["white"].reshape(-1, 3) * box["edge"] / 65535
    assert np.abs(verts - m.cortex.white.verts[ids]).max() < box["edge"] / 65535
    for key, step in (("H", 0.4 / 65534), ("sulcal_depth", 0.01)):
        span = packed.meta["maps"][key]
        codes = arrays[f"map:{key}"]
        values = np.where(codes == pack.NAN16, np.nan, span["low"] + codes / 65534 * (span["high"] - span["low"]))
        np.testing.assert_allclose(values, m.maps[key][ids], atol=0.51 * step)
    np.testing.assert_array_equal(arrays["regions"] - 1.0, m.cortex.regions.labels[ids])
    assert packed.meta["regions"] == ["no region", "front", "middle", "back"]


def test_packing_keeps_every_triangle_and_its_sense():
    m = made_measures()
    packed = pack.pack(m.cortex, {})
    arrays = unpack(packed)
    faces = arrays["ids"][arrays["faces"].reshape(-1, 3)].astype(int)
    turned = lambda f: sorted(tuple(np.roll(row, -row.argmin())) for row in f)
    assert turned(faces) == turned(m.cortex.faces)


def test_a_large_surface_is_thinned_to_a_closed_one_of_the_same_area():
    cortex = made_cortex(level=5)
    shown = pack.thin(cortex, 2500)
    assert shown.thinned
    assert 2300 < len(shown.ids) < 2600
    assert len(np.unique(shown.ids)) == len(shown.ids)
    for surface in (cortex.pial, cortex.white):
        a, b, c = np.moveaxis(surface.verts[shown.ids][shown.faces], 1, 0)
        area = np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2
        a, b, c = np.moveaxis(surface.verts[surface.faces], 1, 0)
        assert area == pytest.approx(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2, rel=0.01)
    edges = np.sort(np.concatenate([shown.faces[:, [0, 1]], shown.faces[:, [1, 2]], shown.faces[:, [2, 0]]]), axis=1)
    assert (np.unique(edges, axis=0, return_counts=True)[1] == 2).all()
    assert not pack.thin(cortex, 10_242).thinned


def test_no_vertex_is_chosen_twice_while_another_is_free():
    near = np.array([[0, 1, 2], [0, 2, 1], [0, 1, 3]])
    np.testing.assert_array_equal(pack.distinct(near), [0, 2, 1])
    np.testing.assert_array_equal(pack.distinct(np.array([[5], [5]])), [5, 5])


# colours and limits ------------------------------------------------------------------------------------------


def lightness(rgb):
    """CIE L* of sRGB bytes (n, 3)."""
    c = rgb / 255
    linear = np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)
    y = linear @ [0.2126, 0.7152, 0.0722]
    return 116 * np.where(y > 216 / 24389, np.cbrt(y), y * 841 / 108 + 4 / 29) - 16


def test_the_sequential_table_climbs_evenly_in_lightness():
    L = lightness(colours.sequential())
    assert (np.diff(L[::8]) > 0).all()
    assert L[0] < 25
    assert L[-1] > 85
    quarters = np.diff(L[[0, 64, 128, 192, 255]])
    assert quarters.max() / quarters.min() < 1.6


def test_the_diverging_table_is_lightest_at_zero_and_as_dark_on_both_sides():
    L = lightness(colours.diverging())
    assert abs(L.argmax() - 127.5) < 2
    assert np.abs(L - L[::-1]).max() < 6
    assert (np.abs(colours.diverging()[127].astype(int) - 240) < 12).all()


def test_values_beyond_the_limits_take_the_end_colours_and_nan_takes_grey():
    got = colours.apply(np.array([-9, 0, 1, 9, np.nan]), (0, 1), signed=False)
    np.testing.assert_array_equal(got[0], got[1])
    np.testing.assert_array_equal(got[2], got[3])
    np.testing.assert_array_equal(got[4], colours.NOT_MEASURED)


def test_limits_are_the_quantity_own_when_they_suit_and_rounded_percentiles_when_not(rng):
    thickness = quantity("cortical_thickness")
    assert common_limits(thickness, [rng.uniform(1.2, 4.6, 999)]) == (1, 5)
    low, high = common_limits(thickness, [rng.uniform(10, 30, 999), np.array([np.nan])])
    assert low == pytest.approx(10, abs=1)
    assert high == pytest.approx(30, abs=1)
    bound = common_limits(quantity("H"), [rng.normal(0.5, 1, 999)])
    assert bound[0] == -bound[1]
    few, many = rng.uniform(6, 8, 99), rng.uniform(1.2, 4.6, 9999)
    low, high = common_limits(thickness, [few, many])                    # a small surface is not drowned by a large one
    assert low <= 1.3
    assert high >= 7.9
    low, high = common_limits(thickness, [np.linspace(1, 9, 999)])       # half of it lies beyond 5
    assert low < 1.5
    assert high > 8.5
    assert common_limits(thickness, [np.linspace(1, 5.9, 999)]) == (1, 5)   # a fifth may
    assert common_limits(thickness, []) == (1, 5)
    flat = common_limits(quantity("odd_mm"), [np.full(9, 7.0)])
    assert flat[0] < 7 < flat[1]


def test_an_unknown_map_is_described_by_its_name():
    got = quantity("bending_per_mm2", [np.linspace(-1, 2, 99)])
    assert (got.label, got.unit, got.signed) == ("Bending", "1/mm²", True)


# charts ------------------------------------------------------------------------------------------------------


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


# pictures ----------------------------------------------------------------------------------------------------


def decode_png(data):
    """A reader of the PNG subset we write, from the specification: 8-bit RGB, filters 0 and 2."""
    assert data[:8] == b"\x89PNG\r\n\x1a\n"
    at, body = 8, b""
    while at < len(data):
        n, kind = struct.unpack(">I4s", data[at : at + 8])
        content = data[at + 8 : at + 8 + n]
        assert struct.unpack(">I", data[at + 8 + n : at + 12 + n])[0] == zlib.crc32(kind + content)
        if kind == b"IHDR":
            width, height = struct.unpack(">II", content[:8])
        body += content if kind == b"IDAT" else b""
        at += 12 + n
    rows = np.frombuffer(zlib.decompress(body), np.uint8).reshape(height, 1 + 3 * width)
    image = rows[:, 1:].copy()
    for y in range(1, height):
        if rows[y, 0] == 2:
            image[y] += image[y - 1]
    return image.reshape(height, width, 3)


def test_a_png_holds_the_picture_exactly(rng):
    picture = rng.integers(0, 256, (7, 11, 3), dtype=np.uint8)
    np.testing.assert_array_equal(decode_png(png_bytes(picture)), picture)
    with pytest.raises(ValueError, match="float64"):
        png_bytes(np.zeros((2, 2, 3)))


def test_lettering_shares_a_baseline_and_reads_no_tex():
    low, tall = lettering("axe", 20), lettering("AXE", 20)
    foot = lambda ink: ink.shape[0] - np.flatnonzero(ink.any(axis=1))[-1]
    assert abs(foot(low) - foot(tall)) <= 1
    assert lettering("$x$", 20).shape[1] > lettering("x", 20).shape[1] + 8


def test_the_renderer_finds_the_exact_silhouette_of_a_sphere():
    verts, faces = icosphere(4, radius=10.0)
    xyz = np.stack([100 + 8 * verts[:, 0], 100 - 8 * verts[:, 1], verts[:, 2]], axis=1)
    face, b0, b1 = raster.rasterise(xyz, faces, 200, 200)
    assert (face >= 0).sum() == pytest.approx(np.pi * 80**2, rel=5e-3)
    front = verts[faces[face[face >= 0]]].mean(axis=1)
    assert front[:, 2].min() > -1  # the far side is hidden
    weights = np.stack([b0, b1, 1 - b0 - b1])[:, face >= 0]
    assert weights.min() > -1e-6


def test_paint_matches_its_formula(rng):
    """The kernel against the same lights written with arrays."""
    verts, faces = icosphere(2, radius=10.0)
    xyz = np.stack([20 + 1.5 * verts[:, 0], 20 - 1.5 * verts[:, 1], verts[:, 2]], axis=1)
    face, b0, b1 = (a.astype(np.float64) if a.dtype.kind == "f" else a for a in raster.rasterise(xyz, faces, 40, 40))
    rgb = rng.integers(0, 256, verts.shape, dtype=np.uint8)
    got = raster.paint(face, b0, b1, faces, verts / 10, rgb, 1)
    seen = face >= 0
    weight = np.stack([b0, b1, 1 - b0 - b1], axis=-1)[seen][:, :, None]
    n = (verts[faces[face[seen]]] * weight).sum(axis=1)
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    n *= np.sign(n[:, 2:])
    base = (rgb[faces[face[seen]]] / 255 * weight).sum(axis=1)
    light = 0.26 + 0.44 * np.clip(n @ raster.KEY, 0, None) + 0.36 * n[:, 2]
    want = base * light[:, None] + 0.06 * np.clip(n @ raster.GLEAM, 0, None)[:, None] ** 24
    image = np.ones((40, 40, 3))
    image[seen] = np.minimum(want, 1)
    np.testing.assert_array_equal(got, np.round(255 * image))
    halved = raster.paint(face, b0, b1, faces, verts / 10, rgb, 2)
    np.testing.assert_array_equal(halved, np.round(255 * image.reshape(20, 2, 20, 2, 3).mean(axis=(1, 3))))


def test_of_two_triangles_the_nearer_is_seen_in_either_order():
    near = np.array([[2.0, 2, 1], [18, 2, 1], [10, 18, 1]])
    both = np.concatenate([near, near - [0, 0, 5]])
    for faces, nearer in (([[0, 1, 2], [3, 4, 5]], 0), ([[3, 4, 5], [0, 1, 2]], 1)):
        face, _, _ = raster.rasterise(both, np.array(faces), 20, 20)
        assert set(np.unique(face)) == {-1, nearer}


@pytest.mark.parametrize(
    ("hemi", "view", "axis", "sign"),
    [("lh", "lateral", 0, -1), ("rh", "lateral", 0, 1), ("lh", "medial", 0, 1), ("rh", "medial", 0, -1),
     ("lh", "top", 2, 1), ("rh", "bottom", 2, -1), ("lh", "front", 1, 1)],
)  # fmt: skip
def test_a_view_looks_from_the_side_it_is_named_for(hemi, view, axis, sign):
    R = figures.camera(view, hemi)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-15)
    assert np.linalg.det(R) == pytest.approx(1.0)  # no mirror image
    assert R[2, axis] == sign
    assert R[1, 1 if view in ("top", "bottom") else 2] == 1  # anterior or superior is up


def test_the_camera_of_the_viewer_is_that_of_the_pictures():
    text = resources.files("morphofold.report").joinpath("templates/viewer.js").read_text(encoding="utf-8")
    rh, lh = re.search(r'lateral: \(h\) => h === "rh" \? \[([^\]]+)\] : \[([^\]]+)\]', text).groups()
    for hemi, row in (("rh", rh), ("lh", lh)):
        np.testing.assert_array_equal([float(v) for v in row.split(",")], figures.camera("lateral", hemi).ravel())
    for view in ("top", "bottom", "front"):
        row = re.search(rf"{view}: \(\) => \[([^\]]+)\]", text).group(1)
        np.testing.assert_array_equal([float(v) for v in row.split(",")], figures.camera(view, "lh").ravel())


def marked(hemi):
    """A sphere whose lateral half has value 1, the medial half 0."""
    verts, faces = icosphere(3, radius=20.0)
    outer = verts[:, 0] < 0 if hemi == "lh" else verts[:, 0] > 0
    return figures.Row("s", Surface(verts, faces), outer.astype(float), hemi)


@pytest.mark.parametrize("hemi", ["lh", "rh"])
def test_a_picture_shows_the_side_it_says(hemi):
    what, views = Quantity("t", "Test", signed=True), ("lateral", "medial")
    out, inner = figures.draw(marked(hemi), views, what, (-1, 1), (60, 60), 22.0, "raster")
    middle = lambda p: p[25:35, 25:35].reshape(-1, 3).mean(axis=0)
    assert middle(out)[0] > middle(out)[2] + 60  # orange: +1
    assert np.ptp(middle(inner)) < 12  # grey: 0
    again = figures.draw(marked(hemi), views, what, (-1, 1), (60, 60), 22.0, "raster")
    np.testing.assert_array_equal(out, again[0])


def test_both_renderers_draw_the_same_picture():
    if not figures.graphics():
        pytest.skip("no GL library here, so pyvista cannot draw")
    m = made_measures("rh", level=4)
    row = figures.Row("a", m.cortex.pial, m.maps["cortical_thickness"], "rh")
    pair = [figures.draw(row, figures.VIEWS, GREY, (2, 4), (120, 120), 45.0, b) for b in ("pyvista", "raster")]
    for a, b in zip(*pair):
        assert np.abs(a.astype(float) - b).mean() < 2  # of 255: edges differ by a sample
    assert np.abs(pair[0][0].astype(float) - pair[0][2]).mean() > 3  # and the views are not all one


@pytest.fixture
def answering(monkeypatch):
    """Make the trial of GL end as it is told; the commands that were run."""
    monkeypatch.delenv("MORPHOFOLD_RENDERER", raising=False)
    commands = []

    def answer(code, text):
        run = lambda args, **kw: commands.append(args) or subprocess.CompletedProcess(args, code, text)
        monkeypatch.setattr(figures.subprocess, "run", run)
        figures.renderer.cache_clear(), figures.graphics.cache_clear()
        return commands

    yield answer
    figures.renderer.cache_clear(), figures.graphics.cache_clear()


@pytest.mark.parametrize(
    ("code", "text", "drawn_by"),
    [
        (-11, "", "raster"),                                            # no GL library: VTK kills the process
        (0, "OpenGL renderer string:  llvmpipe (LLVM 19.1.7, 256 bits)\n", "raster"),
        (0, "OpenGL vendor string:  A\nOpenGL renderer string:  A Card 9000\nmore", "pyvista"),
        (0, "no such line", "raster"),
    ],
)
def test_a_graphics_card_is_used_where_a_child_process_finds_one(answering, code, text, drawn_by):
    commands = answering(code, text)
    assert figures.renderer() == drawn_by
    assert figures.renderer() == drawn_by
    assert len(commands) == 1
    assert commands[0][0] == sys.executable


def test_a_figure_has_room_for_every_row_and_an_unknown_view_is_refused():
    rows = [marked("lh"), marked("rh")]
    one = figures.figure(rows[:1], GREY, (0, 1), width=400, backend="raster")
    two = figures.figure(rows, GREY, (0, 1), width=400, backend="raster")
    assert one.shape[1] == two.shape[1] == 400
    assert two.shape[0] > one.shape[0] + 40
    with pytest.raises(ValueError, match="view must be one of lateral"):
        figures.camera("sideways", "lh")


def test_the_ruler_is_as_long_as_it_says(monkeypatch):
    said = []
    write = figures.write
    monkeypatch.setattr(figures, "write", lambda c, text, *a, **k: (said.append(text), write(c, text, *a, **k)))
    verts, faces = icosphere(4, radius=20.0)
    row = figures.Row("", Surface(verts, faces), np.full(len(verts), np.nan), "lh")
    image = figures.figure([row], GREY, (0, 1), ("top",), width=900, backend="raster")
    mm = next(float(text.split()[0]) for text in said if re.fullmatch(r"\d+ mm", text))
    ball = image[72 + 30 : -112].min(axis=2) < 240                    # between head and foot of the figure
    columns = np.flatnonzero(ball.any(axis=0))
    per_mm = (columns[-1] - columns[0] + 1) / 40
    ruler = max((image[-112:, :250] == 60).all(axis=2).sum(axis=1))
    assert ruler / per_mm == pytest.approx(mm, rel=0.03)


# pages -------------------------------------------------------------------------------------------------------

NASTY = '<script>alert("x")</script>&"\''


class Page(HTMLParser):
    """What a browser would make of the page: its tags, its scripts, and whatever points elsewhere."""

    def __init__(self, text):
        super().__init__()
        self.scripts, self.links, self.open = [], [], None
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.links += [v for k, v in attrs if k in ("src", "href", "srcset", "action") and v]
        assert not any(k.startswith("on") for k, _ in attrs)
        self.open = dict(attrs) if tag == "script" else None

    def handle_data(self, data):
        if self.open is not None:
            self.scripts.append((self.open, data))
            self.open = None


@pytest.fixture(scope="module")
def nasty_page(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MORPHOFOLD_RENDERER", "raster")
        figures.renderer.cache_clear()
        m = made_measures(name=NASTY, info={NASTY: NASTY})
        m.maps[NASTY] = m.maps["H"]
        m.regions[0]["region"] = NASTY
        m.notes["n_crests"] = NASTY
        folder = tmp_path_factory.mktemp("page")
        result = compare({NASTY: m, "other": made_measures("rh", regions=False)})
        analysis_report([m], folder / "a.html", inputs=[{"path": NASTY, "sha256": "0"}])
        page = result.report(folder / "c")
    figures.renderer.cache_clear()
    return page, (folder / "a.html").read_text(encoding="utf-8")


def test_only_earlier_stages_of_the_same_body_are_shown_growing():
    m = made_measures(info={"g": 1.5, "name": "body"})
    at = lambda **info: made_measures(info={"name": "body", **info})
    assert page._other_stage(at(g=1.2), m)
    for other in (at(g=1.5), at(g=2.0), at(), at(g=1.2, name="another"), made_measures(level=2, info={"g": 1.2})):
        assert not page._other_stage(other, m)


def test_names_from_files_are_escaped_everywhere(nasty_page):
    for text in (nasty_page[0].read_text(encoding="utf-8"), nasty_page[1]):
        assert "<script>alert" not in text
        assert "&lt;script&gt;alert" in text
        scripts = [s for a, s in Page(text).scripts if "type" not in a]
        assert len(scripts) == 1
        assert scripts[0].startswith("// Tables that sort")


def test_the_page_names_the_one_script_it_may_run(nasty_page):
    text = nasty_page[1]
    script = next(s for a, s in Page(text).scripts if "type" not in a)
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    policy = re.search(r'Content-Security-Policy" content="([^"]+)"', text).group(1)
    assert f"sha256-{digest}" in policy.replace("&#43;", "+")
    assert policy.startswith("default-src 'none'")


def test_the_page_points_at_nothing_outside_itself(nasty_page):
    for text in (nasty_page[0].read_text(encoding="utf-8"), nasty_page[1]):
        assert Page(text).links
        assert all(link.startswith("data:") for link in Page(text).links)
        style = re.search(r"<style>(.*?)</style>", text, re.S).group(1)
        assert "url(" not in style
        assert "@import" not in style


def test_a_comparison_writes_its_pictures_and_tables(nasty_page):
    folder = nasty_page[0].parent
    names = {p.name for p in (folder / "figures").iterdir()}
    assert names == {"H.png", "cortical_thickness.png", "gyral_thickness.png", "sulcal_depth.png"}
    assert decode_png((folder / "figures" / "H.png").read_bytes()).std() > 5
    assert (folder / "comparison.json").is_file()
    header = (folder / "comparison.tsv").read_text(encoding="utf-8").splitlines()[0]
    assert header.startswith("measure\t")


def test_the_page_says_what_was_left_out_and_what_was_used(nasty_page):
    text = nasty_page[1]
    assert "What was left out" in text
    assert "Hinges were not counted." in text
    assert "curvature_scale_mm" in text
    assert "No reason was recorded" in text
    assert "medial wall" in text
    assert re.search(r"numpy \d+\.\d+", text)


def config(text):
    """What the page tells its viewer."""
    return json.loads(next(s for a, s in Page(text).scripts if a.get("id") == "viewer-config"))


@pytest.fixture
def drawn(monkeypatch, tmp_path):
    """Write a comparison or analysis page; its text, the rows of its pictures and the series of its charts."""
    rows, series = [], []
    histograms, blank = plots.histograms, np.full((4, 4, 3), 255, np.uint8)
    monkeypatch.setenv("MORPHOFOLD_RENDERER", "raster")
    monkeypatch.setattr(page, "figure", lambda r, *a, **k: (rows.extend(r), blank)[1])
    monkeypatch.setattr(plots, "histograms", lambda s, *a: (series.append(s), histograms(s, *a))[1])
    figures.renderer.cache_clear()

    def draw(what):
        path = tmp_path / "report.html"
        page.comparison_report(compare(what), tmp_path) if isinstance(what, dict) else analysis_report(what, path)
        return path.read_text(encoding="utf-8"), rows, series

    yield draw
    figures.renderer.cache_clear()


def area(surface):
    a, b, c = np.moveaxis(surface.verts[surface.faces], 1, 0)
    return np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2


def test_each_hemisphere_is_drawn_as_the_side_it_is_and_weighed_by_its_pial_area(drawn):
    pair = {"right": made_measures("rh"), "left": made_measures("lh")}
    text, rows, series = drawn(pair)
    assert [s["hemi"] for s in config(text)["surfaces"]] == ["rh", "lh"]
    assert [(r.name, r.hemi) for r in rows] == [("right", "rh"), ("left", "lh")] * 4
    pial = area(pair["left"].cortex.pial)
    assert abs(area(pair["left"].cortex.white) / pial - 1) > 0.1
    for name, _, weights, _, _ in series[0]:
        assert weights.sum() == pytest.approx(pial, rel=1e-9), name


def test_a_surface_keeps_its_dash_where_another_lacks_the_map(drawn):
    several = {name: made_measures(name=name) for name in ("a", "b", "c")}
    del several["b"].maps["sulcal_depth"]
    text, _, series = drawn(several)
    assert [[(s[0], s[4]) for s in chart] for chart in series] == [
        *[[("a", plots.DASHES[0]), ("b", plots.DASHES[1]), ("c", plots.DASHES[2])]] * 3,
        [("a", plots.DASHES[0]), ("c", plots.DASHES[2])],
        [("a", plots.DASHES[0]), ("b", plots.DASHES[1]), ("c", plots.DASHES[2])],        # gyral over cortical thickness
    ]
    keys = re.findall(r'class="key-line".*?stroke-dasharray="([^"]*)"', text)
    assert keys == [*plots.DASHES[:3]] * 2                                 # in the legends of fits and of curves


def test_the_page_of_one_surface_speaks_of_one_surface(drawn):
    m = made_measures(origin="simulation", portion=0.5)
    text, _, _ = drawn([m])
    assert "All surfaces share" not in text
    assert 'id="fit"' not in text
    assert "A simulated cortex, measured from" in text
    assert "hemisphere" not in re.sub(r"<script.*?</script>", "", text, flags=re.S)
    assert "Half of the closed surface of bump was simulated" in text
    assert "crossed bars" not in text                                      # regions, so no bins
    assert "crossed bars" in drawn([made_measures("rh", regions=False)])[0]
    assert "The right hemisphere, measured" in drawn([made_measures("rh")])[0]


@pytest.mark.parametrize(("portion", "words"), [(0.125, "One eighth"), (0.25, "A quarter"), (0.3, "0.3")])
def test_the_share_that_was_simulated_is_a_word_where_there_is_one(drawn, portion, words):
    assert f"{words} of the closed surface" in drawn([made_measures(portion=portion)])[0]


def test_warnings_cautions_and_remarks_stand_where_they_are_seen(drawn):
    model, other = made_measures(origin="simulation"), made_measures("rh", regions=False)
    model.notes.update(simulation="the energy grew.", curvature_scale="mesh is coarse.", n_crests="none here.")
    other.notes.update(cortex_mask="no cortex label.", average="of no person.")
    text, _, _ = drawn({"model": model, "MRI": replace(other, parameters={"curvature_scale_mm": 9.5})})
    top, rest = text.split('<section id="viewer"')
    remarks, below = rest.split("Gyral thickness against cortical thickness</h2>")
    assert re.search(r'class="warning".*model: the energy grew\.', top)
    assert re.search(r'class="caution".*within 3.0 mm on model and 9.5 mm on MRI', top)
    assert "model: mesh is coarse. " in remarks
    assert re.search(r'class="caution".*MRI: of no person\.</li><li>MRI: no cortex label\.', top)
    assert "MRI: no regions, so one point" in below
    for once in ("the energy grew", "mesh is coarse", "no cortex label", "of no person", "no regions, so", "none here"):
        assert text.count(once) == 1


def test_a_fit_not_different_from_none_is_called_so(drawn):
    m = made_measures()
    assert "not different from none" not in drawn([m])[0]
    for row, gyral in zip(m.regions, (8.0, 13.0, 9.0)):
        row["gyral_thickness_mm"] = gyral
    text, _, _ = drawn([m])
    assert text.count("not different from none") == 2                      # in the caption and in the table
    assert 'class="fit faint"' in text
