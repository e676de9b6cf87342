"""Pictures of surfaces: the side they say, with a ruler that is true."""

import re
from importlib import resources

import numpy as np
import pytest

from morphofold.errors import UnknownName
from morphofold.quantities import Quantity
from morphofold.report.pictures import surfaces
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
    what, views = Quantity("t", "Test", signed=True), ("lateral", "medial")
    out, inner = surfaces.draw(marked(hemi), views, what, (-1, 1), (60, 60), 22.0)
    middle = lambda p: p[25:35, 25:35].reshape(-1, 3).mean(axis=0)
    assert middle(out)[0] > middle(out)[2] + 60  # orange: +1
    assert np.ptp(middle(inner)) < 12  # grey: 0
    again = surfaces.draw(marked(hemi), views, what, (-1, 1), (60, 60), 22.0)
    np.testing.assert_array_equal(out, again[0])


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
    write = surfaces.write
    monkeypatch.setattr(surfaces, "write", lambda c, text, *a, **k: (texts.append(text), write(c, text, *a, **k)))
    verts, faces = icosphere(4, radius=20.0)
    row = surfaces.Row("", Surface(verts, faces), np.full(len(verts), np.nan), "lh")
    image = surfaces.figure([row], GREY, (0, 1), ("top",), width=900)
    mm = next(float(text.split()[0]) for text in texts if re.fullmatch(r"\d+ mm", text))
    ball = image[72 + 30 : -112].min(axis=2) < 240  # between head and foot of the figure
    columns = np.flatnonzero(ball.any(axis=0))
    per_mm = (columns[-1] - columns[0] + 1) / 40
    ruler = max((image[-112:, :250] == 60).all(axis=2).sum(axis=1))
    assert ruler / per_mm == pytest.approx(mm, rel=0.03)
