"""What a notebook shows: tables with the numbers, small pictures, or the reason why there is none."""

import base64
import io
import re
from dataclasses import replace
from html import unescape

import numpy as np
import pytest
from made_measures import made_cortex, made_measures
from made_simulations import made_simulation
from PIL import Image

from morphofold.analysis import measure
from morphofold.comparison import compare
from morphofold.errors import MissingPart, NothingToDo, OutOfRange, UnknownName
from morphofold.io import read_cortex, sample_path
from morphofold.report import colours
from morphofold.surface import Cortex, Surface

PNG = re.compile(r'src="data:image/png;base64,([^"]+)"')


def table(html):
    """Label with unit -> values, of the table in HTML."""
    rows = re.findall(r"<tr><th[^>]*>(.*?)</th>(.*?)</tr>", html)
    text = lambda part: unescape(re.sub("<[^>]*>", "", part))
    return {text(label): [text(cell) for cell in re.findall(r"<td[^>]*>(.*?)</td>", cells)] for label, cells in rows}


def picture(html):
    """The one picture in HTML, (height, width, 3)."""
    (data,) = PNG.findall(html)
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(data))))


def test_a_cortex_shows_its_size_and_what_came_with_it():
    class Own(Cortex):  # a class of the user's own shows what its parent does
        pass

    parent = made_cortex("rh", name="bump")
    for cortex in (parent, Own(parent.white, parent.pial, name="bump", hemi="rh")):
        html = cortex._repr_html_()
        rows = table(html)
        assert (rows["Hemisphere"], rows["Vertices"]) == (["right"], ["642"])
        area = float(rows["Pial area [mm²]"][0].replace("\u202f", ""))
        assert area == pytest.approx(cortex.to_trimesh().area, rel=1e-3)
        assert "src=" not in PNG.sub("", html)  # nothing is fetched
        assert (picture(html) == 255).all(axis=2).mean() < 0.8
    assert table(parent._repr_html_())["With"] == ["thickness, inflated"]


def test_measures_show_numbers_with_units_and_the_colours_of_a_map():
    m = made_measures()
    html = m._repr_html_()
    assert table(html)["Cortical thickness, mean [mm]"] == ["2.50"]
    assert table(html)["Gyrification index"] == ["1.25"]
    tinted = lambda html: np.mean(np.ptp(picture(html).astype(int), axis=2) > 60)
    assert tinted(html) > 0.05  # curvature is blue and orange
    assert tinted(m.cortex._repr_html_()) == 0  # the bare surface is gray


@pytest.mark.parametrize(("only", "rows"), [("sulcal_depth", {}), ("n_vertices", {"Vertices": ["2\u202f562"]})])
def test_measures_in_part_show_what_there_is(only, rows):
    html = measure(made_cortex(level=4), only=[only])._repr_html_()
    assert table(html) == rows
    assert ("Maps: sulcal_depth." in html) == (only == "sulcal_depth")
    assert picture(html).shape[2] == 3


def test_a_comparison_shows_every_name_and_draws_the_first_four():
    ms = {f"s{k}": made_measures() for k in range(6)}
    six = compare(ms)._repr_html_()
    assert table(six)["Gyrification index"] == ["1.25"] * 6
    assert all(f">s{k}<" in six for k in range(6))
    four = compare({name: ms[name] for name in ("s0", "s1", "s2", "s3")})._repr_html_()
    assert np.array_equal(picture(six), picture(four))
    assert ("first 4" in six, "first 4" in four) == (True, False)


def test_a_simulation_shows_its_scene_and_its_last_stage_or_why_it_cannot(tmp_path):
    sim = made_simulation(tmp_path / "run", "fig5", ["growth.final=1.3", "output.stages=[1.2]"])
    rows = table(sim._repr_html_())
    assert (rows["Stages"], rows["Vertices"], rows["Health"]) == (["1.2, 1.3"], ["2\u202f562"], ["healthy"])
    assert picture(sim._repr_html_()).shape[2] == 3
    assert repr(sim) == f"Simulation({str(tmp_path / 'run')!r}, scene 'fig5', sphere, growth to 1.3)"
    (tmp_path / "run" / "stages" / "g1.30" / "surf" / "lh.pial").write_bytes(b"half")
    assert "lh.pial" in sim._repr_html_()
    assert not PNG.search(sim._repr_html_())
    (tmp_path / "run").rename(tmp_path / "moved")
    assert "No stage is written" in sim._repr_html_()


def test_a_surface_without_extent_shows_the_reason():
    point = Surface(np.ones((4, 3)), np.array([[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]]))
    html = Cortex(point, point)._repr_html_()
    assert "No picture: " in html
    assert not PNG.search(html)


def test_names_from_files_are_text_in_html():
    name = "<script>alert(1)</script>"
    m = replace(made_measures(), cortex=replace(made_cortex(), name=name))
    m = replace(m, maps={**m.maps, name: m.maps["H"]})
    for result in (m, m.cortex, compare({name: m})):
        assert "<script" not in result._repr_html_()
        assert "&lt;script&gt;" in result._repr_html_()


def test_the_picture_of_a_person_is_small_and_the_same_every_time():
    person = read_cortex(sample_path("S1"), hemi="lh")
    html = person._repr_html_()
    assert len(base64.b64decode(PNG.findall(html)[0])) < 150_000
    assert html == person._repr_html_()


# --- plots


def test_a_plot_has_the_colours_of_the_values_and_gray_where_there_is_none():
    """A map that is 2 on one half, and missing on the other: the view of a half has one colour and its shades."""
    cortex = made_cortex(mask=False)
    east = cortex.pial.verts[:, 0] > 0
    m = replace(made_measures(mask=False), maps={"cortical_thickness": np.where(east, 2.0, np.nan)})
    low, high = (np.asarray(m.plot("cortical_thickness", views="medial", limits=l)) for l in ((2, 4), (0, 2)))
    gray = np.asarray(m.plot("cortical_thickness", views="lateral", limits=(2, 4)))
    middle = (low.shape[0] // 2, low.shape[1] // 2)
    for image, colour in ((low, colours.sequential()[0]), (high, colours.sequential()[-1])):
        ratio = image[middle] / colour  # shading is the same for all channels, but for the highlight
        assert np.ptp(ratio) < 0.35
    assert np.ptp(gray[middle].astype(int)) <= 6
    assert not np.array_equal(low[middle], high[middle])


def test_a_plot_has_a_column_for_each_view_and_any_surface():
    m = made_measures()
    assert isinstance(m.plot("H"), Image.Image)
    narrow, wide = m.plot("H", views="top"), m.plot("H", views=["top", "bottom"])
    assert narrow.width < wide.width
    white, pial = (np.asarray(m.plot("H", surface=name)) for name in ("white", "pial"))
    assert not np.array_equal(white, pial)
    assert np.array_equal(np.asarray(m.plot("mean_curvature")), pial)  # another name of the same map


@pytest.mark.parametrize(
    ("name", "options", "error", "message"),
    [
        ("gyral_width", {}, UnknownName, "H, cortical_thickness, gyral_thickness, sulcal_depth"),
        ("H", {"surface": "middle"}, UnknownName, "inflated"),
        ("H", {"surface": "sphere"}, MissingPart, "sphere"),
        ("H", {"views": "left"}, UnknownName, "lateral"),
        ("H", {"views": ()}, NothingToDo, None),
        *(("H", {"limits": limits}, OutOfRange, None) for limits in ((1, 1), (2, 1), (0, np.inf), (0, 1, 2))),
    ],
)
def test_a_plot_that_can_not_be_drawn_is_refused(name, options, error, message):
    with pytest.raises(error, match=message):
        made_measures().plot(name, **options)
