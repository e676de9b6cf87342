"""Pictures of surfaces: the side they say, with a ruler that is true; what the renderer covers, hides, lights."""

import re
from importlib import resources

import numpy as np
import pytest

from morphofold.errors import OutOfRange, UnknownName
from morphofold.quantities import Quantity
from morphofold.report.pictures import pixel_canvas as canvas, raster, surfaces
from morphofold.shapes import icosphere
from morphofold.surface import Surface

GREY = Quantity("t", "Test", "mm")


@pytest.mark.parametrize(
    ("hemi", "view", "axis", "sign"),
    [
        ("lh", "lateral", 0, -1),
        ("rh", "lateral", 0, 1),
        ("lh", "medial", 0, 1),
        ("rh", "medial", 0, -1),
        ("lh", "top", 2, 1),
        ("rh", "bottom", 2, -1),
        ("lh", "front", 1, 1),
    ],
)
def test_a_view_looks_from_the_side_it_is_named_for(hemi, view, axis, sign):
    R = surfaces.camera(view, hemi)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-15)
    assert np.linalg.det(R) == pytest.approx(1.0)  # no mirror image
    assert R[2, axis] == sign
    assert R[1, 1 if view in ("top", "bottom") else 2] == 1  # anterior or superior is up


def test_the_camera_of_the_viewer_is_that_of_the_pictures():
    text = resources.files("morphofold.report").joinpath("templates/viewer.js").read_text(encoding="utf-8")
    rh, lh = re.search(r'lateral: \(h\) => h === "rh" \? \[([^\]]+)\] : \[([^\]]+)\]', text).groups()
    for hemi, row in (("rh", rh), ("lh", lh)):
        np.testing.assert_array_equal([float(v) for v in row.split(",")], surfaces.camera("lateral", hemi).ravel())
    for view in ("top", "bottom", "front"):
        row = re.search(rf"{view}: \(\) => \[([^\]]+)\]", text).group(1)
        np.testing.assert_array_equal([float(v) for v in row.split(",")], surfaces.camera(view, "lh").ravel())


def marked(hemi):
    """A sphere whose lateral half has value 1, the medial half 0."""
    verts, faces = icosphere(3, radius=20.0)
    outer = verts[:, 0] < 0 if hemi == "lh" else verts[:, 0] > 0
    return surfaces.Row("s", Surface(verts, faces), outer.astype(float), hemi)


@pytest.mark.parametrize("hemi", ["lh", "rh"])
def test_a_picture_shows_the_side_it_says(hemi):
    out, inner, again = (
        surfaces.draw(marked(hemi), view, (60, 60), 60 / 44, (-1, 1), True) for view in ("lateral", "medial", "lateral")
    )
    middle = lambda p: p[25:35, 25:35].reshape(-1, 3).mean(axis=0)
    assert middle(out)[0] > middle(out)[2] + 60  # orange: +1
    assert np.ptp(middle(inner)) < 12  # grey: 0
    np.testing.assert_array_equal(out, again)


def test_a_figure_has_room_for_every_row_and_an_unknown_view_or_a_point_is_refused():
    rows = [marked("lh"), marked("rh")]
    low, high = (surfaces.figure(some, GREY, (0, 1), width=400) for some in (rows[:1], rows))
    assert low.shape[1] == high.shape[1] == 400
    assert high.shape[0] > low.shape[0] + 40
    with pytest.raises(UnknownName, match=r"\blateral\b.*'sideways'"):
        surfaces.camera("sideways", "lh")
    with pytest.raises(OutOfRange, match=r"\b0 mm"):  # a point
        surfaces.figure([surfaces.Row("", Surface(*icosphere(1, 0.0)))], GREY, None)


def test_the_ruler_is_as_long_as_it_says(monkeypatch):
    texts = []
    write = canvas.Sheet.text
    monkeypatch.setattr(canvas.Sheet, "text", lambda *args, **style: (texts.append(args[3]), write(*args, **style)))
    verts, faces = icosphere(4, radius=20.0)
    image = surfaces.figure([surfaces.Row("", Surface(verts, faces))], GREY, (0, 1), ("top",), width=900)
    mm = next(float(text.split()[0]) for text in texts if re.fullmatch(r"\d+ mm", text))
    ball = image[72 + 30 : -112].min(axis=2) < 240  # between head and foot of the figure
    columns = np.flatnonzero(ball.any(axis=0))
    per_mm = (columns[-1] - columns[0] + 1) / 40
    ruler = max((image[-112:, :250] == 60).all(axis=2).sum(axis=1))
    assert ruler / per_mm == pytest.approx(mm, rel=0.03)


@pytest.mark.parametrize(
    ("radius", "stretch"),
    [(1e-3, (1, 1, 1)), (1.0, (1, 8, 1)), pytest.param(1e5, (1, 1, 8), marks=pytest.mark.slow), (1.0, (1, 1e-9, 1e-9))],
)
def test_a_surface_of_any_shape_and_size_fits(radius, stretch):
    verts, faces = icosphere(3, radius)
    image = surfaces.figure([surfaces.Row("", Surface(verts * stretch, faces))], GREY, None, ("lateral",), 600)
    covered = (image[102:-112] < 250).any(axis=2)
    assert covered.any()
    assert not covered[:, [0, -1]].any()
    assert not covered[[0, -1]].any()


def test_columns_of_surfaces_have_one_scale():
    rows = [surfaces.Row(str(radius), Surface(*icosphere(3, radius))) for radius in (40.0, 20.0)]
    image = surfaces.figure(rows, GREY, None, ("lateral",), 600, transposed=True)
    columns = np.flatnonzero((image[110:-112] < 250).any(axis=2).any(axis=0))
    first, second = np.split(columns, np.flatnonzero(np.diff(columns) > 5) + 1)
    assert len(first) == pytest.approx(2 * len(second), abs=3)


def columns_of(text, room=np.inf):
    """Columns with ink of a line."""
    with canvas.new_sheet(900, 40) as page:
        page.text(10, 30, text, 20, room)
        return np.flatnonzero((page.pixels() < 200).any(axis=2).any(axis=0))


@pytest.mark.filterwarnings("error")
def test_no_character_of_a_name_vanishes_and_none_is_a_formula():
    """A box stands for what the font lacks."""
    for text in ("Ж", "α", "₁", "脑", "$", "\n"):
        assert np.ptp(columns_of(f"a{text}b")) > np.ptp(columns_of("ab")) + 3
    assert np.ptp(columns_of("$x$")) > np.ptp(columns_of("x")) + 8


def test_a_long_line_is_cut_in_its_middle():
    assert 250 < columns_of("W" * 60, 300)[-1] < 311
    np.testing.assert_array_equal(columns_of("short", 300), columns_of("short"))


# --- the renderer


def test_the_renderer_finds_the_exact_silhouette_of_a_sphere():
    verts, faces = icosphere(4, radius=10.0)
    xyz = np.stack([100 + 8 * verts[:, 0], 100 - 8 * verts[:, 1], verts[:, 2]], axis=1)
    face, b0, b1 = raster.rasterise(xyz, faces, 200, 200, False)
    assert (face >= 0).sum() == pytest.approx(np.pi * 80**2, rel=5e-3)
    front = verts[faces[face[face >= 0]]].mean(axis=1)
    assert front[:, 2].min() > -1  # the far side is hidden
    weights = np.stack([b0, b1, 1 - b0 - b1])[:, face >= 0]
    assert weights.min() > -1e-6


def test_paint_matches_its_formula(rng):
    """The kernel against the same lights written with arrays."""
    verts, faces = icosphere(2, radius=10.0)
    xyz = np.stack([20 + 1.5 * verts[:, 0], 20 - 1.5 * verts[:, 1], verts[:, 2]], axis=1)
    face, *weights = raster.rasterise(xyz, faces, 40, 40, True)
    b0, b1 = (weight.astype(np.float64) for weight in weights)
    rgb = rng.integers(0, 256, verts.shape, dtype=np.uint8)
    image = raster.coloured((face, b0, b1), faces, verts / 10, rgb, 1)
    inside = face >= 0
    weight = np.stack([b0, b1, 1 - b0 - b1], axis=-1)[inside][:, :, None]
    n = (verts[faces[face[inside]]] * weight).sum(axis=1)
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    n *= np.sign(n[:, 2:])
    base = (rgb[faces[face[inside]]] / 255 * weight).sum(axis=1)
    light = 0.26 + 0.44 * np.clip(n @ raster.KEY_LIGHT, 0, None) + 0.36 * n[:, 2]
    lit = base * light[:, None] + 0.06 * np.clip(n @ raster.HIGHLIGHT, 0, None)[:, None] ** 24
    expected = np.ones((40, 40, 3))
    expected[inside] = np.minimum(lit, 1)
    np.testing.assert_array_equal(image, np.round(255 * expected))
    halved = raster.coloured((face, b0, b1), faces, verts / 10, rgb, 2)
    np.testing.assert_array_equal(halved, np.round(255 * expected.reshape(20, 2, 20, 2, 3).mean(axis=(1, 3))))


def test_of_two_triangles_the_nearer_is_seen_in_either_order():
    near = np.array([[2.0, 2, 1], [18, 2, 1], [10, 18, 1]])
    both = np.concatenate([near, near - [0, 0, 5]])
    for faces, nearer in (([[0, 1, 2], [3, 4, 5]], 0), ([[3, 4, 5], [0, 1, 2]], 1)):
        face, _, _ = raster.rasterise(both, np.array(faces), 20, 20, False)
        assert set(np.unique(face)) == {-1, nearer}


def test_faces_that_are_turned_away_change_nothing_on_a_closed_surface():
    verts, faces = icosphere(4, radius=10.0)
    verts = verts * (1 + 0.3 * np.sin(verts[:, :1]))
    xyz = np.stack([40 + 2.5 * verts[:, 0], 40 - 2.5 * verts[:, 1], verts[:, 2]], axis=1)
    for part, whole in zip(*(raster.rasterise(xyz, faces, 80, 80, closed) for closed in (True, False)), strict=True):
        np.testing.assert_array_equal(part, whole)
