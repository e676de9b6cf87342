"""Pictures of surfaces: the side they say, with a ruler that is true."""

import io
import re
from importlib import resources

import numpy as np
import pytest
from PIL import Image

from morphofold.errors import OutOfRange, UnknownName
from morphofold.quantities import Quantity
from morphofold.report.pictures import sheet, surfaces
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


def test_a_figure_has_room_for_every_row_and_an_unknown_view_is_refused():
    rows = [marked("lh"), marked("rh")]
    one = surfaces.figure(rows[:1], GREY, (0, 1), width=400)
    two = surfaces.figure(rows, GREY, (0, 1), width=400)
    assert one.shape[1] == two.shape[1] == 400
    assert two.shape[0] > one.shape[0] + 40
    with pytest.raises(UnknownName, match=r"\blateral\b.*'sideways'"):
        surfaces.camera("sideways", "lh")


def test_the_ruler_is_as_long_as_it_says(monkeypatch):
    texts = []
    write = sheet.Sheet.text
    monkeypatch.setattr(sheet.Sheet, "text", lambda *args, **style: (texts.append(args[3]), write(*args, **style)))
    verts, faces = icosphere(4, radius=20.0)
    image = surfaces.figure([surfaces.Row("", Surface(verts, faces))], GREY, (0, 1), ("top",), width=900)
    mm = next(float(text.split()[0]) for text in texts if re.fullmatch(r"\d+ mm", text))
    ball = image[72 + 30 : -112].min(axis=2) < 240  # between head and foot of the figure
    columns = np.flatnonzero(ball.any(axis=0))
    per_mm = (columns[-1] - columns[0] + 1) / 40
    ruler = max((image[-112:, :250] == 60).all(axis=2).sum(axis=1))
    assert ruler / per_mm == pytest.approx(mm, rel=0.03)


@pytest.mark.parametrize("stretch", [(1, 1, 1), (1, 8, 1), (1, 1, 8), (1, 1e-9, 1e-9)])
@pytest.mark.parametrize("radius", [1e-3, 1.0, 1e5])
def test_a_surface_of_any_shape_and_size_fits(radius, stretch):
    verts, faces = icosphere(3, radius)
    image = surfaces.figure([surfaces.Row("", Surface(verts * stretch, faces))], GREY, None, ("lateral",), 600)
    drawn = (image[102:-112] < 250).any(axis=2)
    assert drawn.any()
    assert not drawn[:, [0, -1]].any()
    assert not drawn[[0, -1]].any()


def test_a_point_is_refused():
    verts, faces = icosphere(1, 0.0)
    with pytest.raises(OutOfRange, match=r"\b0 mm"):
        surfaces.figure([surfaces.Row("", Surface(verts, faces))], GREY, None)


def test_columns_of_surfaces_have_one_scale():
    rows = [surfaces.Row(str(radius), Surface(*icosphere(3, radius))) for radius in (40.0, 20.0)]
    image = surfaces.figure(rows, GREY, None, ("lateral",), 600, transposed=True)
    columns = np.flatnonzero((image[110:-112] < 250).any(axis=2).any(axis=0))
    first, second = np.split(columns, np.flatnonzero(np.diff(columns) > 5) + 1)
    assert len(first) == pytest.approx(2 * len(second), abs=3)


def test_a_png_holds_the_picture_exactly(rng):
    picture = rng.integers(0, 256, (7, 11, 3), dtype=np.uint8)
    decoded = Image.open(io.BytesIO(sheet.png_bytes(picture)))
    assert (decoded.format, decoded.mode) == ("PNG", "RGB")
    np.testing.assert_array_equal(np.asarray(decoded), picture)


def written(text, room=np.inf):
    """Columns with ink of a line."""
    with sheet.new_sheet(900, 40) as page:
        page.text(10, 30, text, 20, room)
        return np.flatnonzero((page.pixels() < 200).any(axis=2).any(axis=0))


@pytest.mark.filterwarnings("error")
def test_no_character_of_a_name_vanishes_and_none_is_a_formula():
    """A box stands for what the font lacks."""
    for text in ("Ж", "α", "₁", "脑", "$", "\n"):
        assert np.ptp(written(f"a{text}b")) > np.ptp(written("ab")) + 3
    assert np.ptp(written("$x$")) > np.ptp(written("x")) + 8


def test_a_long_line_is_cut_in_its_middle():
    assert 250 < written("W" * 60, 300)[-1] < 311
    np.testing.assert_array_equal(written("short", 300), written("short"))
