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
    cortex = made_cortex("rh", name="bump")
    shown = cortex._repr_html_()
    found = table(shown)
    area = cortex.to_trimesh().area
    assert found["Hemisphere"] == ["right"]
    assert found["Vertices"] == ["642"]
    assert float(found["Pial area [mm²]"][0].replace("\u202f", "")) == pytest.approx(area, rel=1e-3)
    assert found["With"] == ["thickness, inflated"]
    assert "src=" not in PNG.sub("", shown)  # nothing is fetched
    assert (picture(shown) == 255).all(axis=2).mean() < 0.8


def test_measures_show_numbers_with_units_and_the_colours_of_a_map():
    m = made_measures()
    shown = m._repr_html_()
    assert table(shown)["Cortical thickness, mean [mm]"] == ["2.50"]
    assert table(shown)["Gyrification index"] == ["1.25"]
    drawn = picture(shown).reshape(-1, 3).astype(int)
    bare = picture(m.cortex._repr_html_()).reshape(-1, 3).astype(int)
    tinted = lambda pixels: np.mean(np.ptp(pixels, axis=1) > 60)  # curvature is blue and orange, the bare surface gray
    assert tinted(drawn) > 0.05
    assert tinted(bare) == 0


def test_measures_in_part_show_what_is_there():
    shown = measure(made_cortex(level=4), only=["sulcal_depth"])._repr_html_()
    assert table(shown) == {}
    assert "Maps: sulcal_depth." in shown
    assert picture(shown).shape[2] == 3
    none = measure(made_cortex(level=4), only=["n_vertices"])._repr_html_()
    assert table(none) == {"Vertices": ["2\u202f562"]}
    assert picture(none).shape[2] == 3


def test_a_comparison_shows_every_name_and_draws_the_first_four():
    ms = {f"s{k}": made_measures() for k in range(6)}
    shown = compare(ms)._repr_html_()
    assert table(shown)["Gyrification index"] == ["1.25"] * 6
    assert all(f">s{k}<" in shown for k in range(6))
    four = compare({name: ms[name] for name in ("s0", "s1", "s2", "s3")})._repr_html_()
    assert np.array_equal(picture(shown), picture(four))
    assert "first 4" in shown
    assert "first 4" not in four


def test_a_simulation_shows_its_scene_and_its_last_stage(tmp_path):
    sim = made_simulation(tmp_path / "run", "fig5", ["growth.final=1.3", "output.stages=[1.2]"])
    shown = sim._repr_html_()
    assert table(shown)["Stages"] == ["1.2, 1.3"]
    assert table(shown)["Vertices"] == ["2\u202f562"]
    assert table(shown)["Health"] == ["healthy"]
    assert picture(shown).shape[2] == 3
    assert repr(sim) == f"Simulation({str(tmp_path / 'run')!r}, scene 'fig5', sphere, growth to 1.3)"


def test_a_simulation_without_stages_or_with_a_damaged_one_shows_the_reason(tmp_path):
    sim = made_simulation(tmp_path / "run", "fig5", ["growth.final=1.2", "output.stages=[]"])
    (tmp_path / "run" / "stages" / "g1.20" / "surf" / "lh.pial").write_bytes(b"half")
    assert "lh.pial" in sim._repr_html_()
    assert not PNG.search(sim._repr_html_())
    (tmp_path / "run").rename(tmp_path / "moved")
    assert "No stage is written" in sim._repr_html_()


def test_a_surface_without_extent_shows_the_reason():
    point = Surface(np.ones((4, 3)), np.array([[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]]))
    shown = Cortex(point, point)._repr_html_()
    assert "No picture: " in shown
    assert not PNG.search(shown)


def test_names_from_files_are_text_in_html():
    name = "<script>alert(1)</script>"
    m = replace(made_measures(), cortex=replace(made_cortex(), name=name))
    m = replace(m, maps={**m.maps, name: m.maps["H"]})
    for shown in (m, m.cortex, compare({name: m})):
        assert "<script" not in shown._repr_html_()
        assert "&lt;script&gt;" in shown._repr_html_()


def test_the_picture_of_a_person_is_small_and_the_same_every_time():
    person = read_cortex(sample_path("S1"), hemi="lh")
    shown = person._repr_html_()
    assert len(base64.b64decode(PNG.findall(shown)[0])) < 150_000
    assert shown == person._repr_html_()


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
    one, two = m.plot("H", views="top"), m.plot("H", views=["top", "bottom"])
    assert one.width < two.width
    white, pial = (np.asarray(m.plot("H", surface=name)) for name in ("white", "pial"))
    assert not np.array_equal(white, pial)
    assert np.array_equal(np.asarray(m.plot("mean_curvature")), pial)  # another name of the same map


def test_a_plot_that_can_not_be_drawn_is_refused():
    m = made_measures()
    with pytest.raises(UnknownName, match="H, cortical_thickness, gyral_thickness, sulcal_depth"):
        m.plot("gyral_width")
    with pytest.raises(UnknownName, match="inflated"):
        m.plot("H", surface="middle")
    with pytest.raises(MissingPart, match="sphere"):
        m.plot("H", surface="sphere")
    with pytest.raises(UnknownName, match="lateral"):
        m.plot("H", views="left")
    with pytest.raises(NothingToDo):
        m.plot("H", views=())
    for limits in ((1, 1), (2, 1), (0, np.inf), (0, 1, 2)):
        with pytest.raises(OutOfRange):
            m.plot("H", limits=limits)


def test_a_class_of_the_users_own_shows_what_its_parent_does():
    class Mine(Cortex):
        pass

    parent = made_cortex("lh", name="bump")
    mine = Mine(parent.white, parent.pial, name="bump")
    assert table(mine._repr_html_())["Vertices"] == ["642"]
