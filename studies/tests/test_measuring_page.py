"""The pages of the measures: pictures, and numbers that go where they belong, whoever made them."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from morphofold.analysis import gyral_thickness, measure
from morphofold.errors import MissingPart, NoSolution
from morphofold.geometry import is_closed
from morphofold.shapes.folded_ball import CORTICAL_THICKNESS_MM, folded_ball
from morphofold.studies.pages import measuring_pictures, section_plot
from morphofold.studies.pages.measuring_pictures import LINE_COLOURS, crest_figure, crest_row


@pytest.fixture(scope="module")
def ball():
    return measure(folded_ball(4000))


def made_hinges():
    base = {
        "length": "",
        "factor": 1.0,
        "mm": np.nan,
        "n_hinges": 20,
        "n_hinges_3": 19,
        "n_hinges_4": 1,
        "n_ends": 0,
        "crest_length_mm": 812.4,
        "kept": 1.0,
        "old": 1.0,
    }
    return [base] + [
        {**base, "length": length, "factor": factor, "mm": 2 * factor, "n_hinges": round(20 / factor), "kept": 0.75}
        for length in ("persistence", "merge")
        for factor in (0.5, 2.0)
    ]


@pytest.mark.slow
def test_the_folded_ball_is_a_closed_cortex_of_one_thickness(ball):
    cortex = ball.cortex
    assert cortex.n_vertices == 4000
    assert is_closed(cortex.faces)
    assert ball.scalars["euler_characteristic"] == 2
    assert ball.scalars["gyrification_index"] > 1.05  # folded at all
    assert ball.scalars["mean_cortical_thickness_mm"] == pytest.approx(CORTICAL_THICKNESS_MM, rel=0.05)
    with pytest.raises(ValueError, match=r"\b1,000\b.*\b999\b"):
        folded_ball(999)


@pytest.mark.slow
def test_crest_lines_have_the_colours_of_their_kind(ball):
    row = crest_row(ball, "ball")
    for colour in LINE_COLOURS.values():
        share = (row.rgb == [int(colour[k : k + 2], 16) for k in (1, 3, 5)]).all(axis=1).mean()
        assert 0.01 < share < 0.3
    gyral = (row.rgb == [0xD5, 0x5E, 0x00]).all(axis=1)
    height = np.linalg.norm(ball.cortex.pial.verts, axis=1)
    assert height[gyral].mean() > height.mean() + 2  # on the crowns
    picture = crest_figure([row])
    assert picture.ndim == 3


def made_pages(folder, **texts):
    """A folder of pages with marks."""
    folder.mkdir()
    for name, text in {"gyral_net": "# By hand\n<!-- sensitivity -->\nold\n<!-- /sensitivity -->\n", **texts}.items():
        (folder / f"{name.replace('_', '-')}.md").write_text(text)
    return folder


@pytest.mark.slow
def test_the_pages_get_their_tables_and_every_picture(ball, tmp_path, monkeypatch):
    monkeypatch.setattr(measuring_pictures, "hinge_sensitivity", lambda cortex: made_hinges())
    folder = made_pages(tmp_path / "pages")
    measuring_pictures.write_pages(folder, {"ball": ball})
    text = (folder / "gyral-net.md").read_text()
    assert text.startswith("# By hand\n")
    assert "old" not in text
    assert "| ball | as they are | 1 | – | 20 | 19 | 1 | 812 | 1.00 |" in text
    assert "| ball | merge | 2 | 4.00 | 10 | 19 | 1 | 812 | 0.75 |" in text
    names = {
        "H",
        "shape-index",
        "sulcal-depth",
        "local-gyrification-index",
        "cortical-thickness",
        "gyral-thickness",
        "crest-lines",
        "gyral-net",
        "sensitivity",
        "wavelength",
        "fractal-dimension",
        "section",
    }
    assert {path.name for path in folder.iterdir()} == {"gyral-net.md", *(f"{name}.png" for name in names)}


@pytest.mark.slow
def test_a_section_shows_chords_of_the_cut_with_their_widths(ball):
    gyri = gyral_thickness(ball.cortex)
    plot = section_plot.section_figure(ball.cortex, gyri)
    (ax,) = plot.axes
    (low, high), (bottom, top) = ax.get_xlim(), ax.get_ylim()
    assert (high - low, top - bottom) == pytest.approx(section_plot.WINDOW)
    widths = [float(t.get_text()) for t in ax.texts if "mm" not in t.get_text()]
    chords = [line.get_xydata() for line in ax.lines if line.get_linewidth() == 2]
    assert len(widths) == len(chords) >= 1
    for width, ends in zip(widths, chords):
        assert ((ends > [low, bottom]) & (ends < [high, top])).all()
        assert 0.6 < width / np.linalg.norm(ends[1] - ends[0]) < 1.05  # less at slanted walls
        at = np.abs(gyri.points[:, [0, 2]] - ends[0]).sum(axis=1).argmin()
        assert round(gyri.width[at], 1) == width
    pial = ax.lines[0].get_xydata()
    radius = np.nanmax(np.linalg.norm(pial, axis=1))  # of a plane cut of a ball about the origin
    assert 10 < radius <= np.linalg.norm(ball.cortex.pial.verts, axis=1).max()
    with pytest.raises(NoSolution):
        section_plot.section_figure(ball.cortex, replace(gyri, partner=np.full_like(gyri.partner, np.nan)))


def test_a_cortex_without_a_name_is_refused(capsys):
    with pytest.raises(SystemExit):
        measuring_pictures.main(["docs/measures", "S1"])
    stderr = capsys.readouterr().err
    assert "'S1'" in stderr
    assert "NAME=CORTEX" in stderr


@pytest.mark.slow
def test_a_page_without_marks_stays_as_it_is(ball, tmp_path, monkeypatch):
    monkeypatch.setattr(measuring_pictures, "hinge_sensitivity", lambda cortex: made_hinges())
    folder = made_pages(tmp_path / "pages", gyral_net="none\n")
    before = {path: path.read_text() for path in folder.iterdir()}
    with pytest.raises(MissingPart, match=r"gyral-net\.md: .*<!-- sensitivity -->"):
        measuring_pictures.write_pages(folder, {"ball": ball})
    assert {path: path.read_text() for path in folder.iterdir()} == before


def test_what_the_docs_say_of_trust_is_in_their_table():
    text = " ".join((Path(__file__).parents[2] / "docs" / "measures" / "gyral-net.md").read_text("utf-8").split())
    rows = [[float(n) for n in row] for row in re.findall(r"\| S1 \| \w[\w ]* \| ([\d.]+) \| \S+ \| (\d+) \|", text)]
    (own,) = [n for times, n in rows if times == 1]
    least, most = (f([n for times, n in rows if times in (0.5, 2)]) for f in (min, max))
    assert f"the {own:.0f} hinges of S1 become {least:.0f} to {most:.0f}." in text
