"""Pages of the docs that code writes: messages, tables, measures; and how lines of code are counted."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from morphofold.analysis import gyral_thickness, measure
from morphofold.analysis.measures_result import FRAMES
from morphofold.errors import PYTHON_CODES, NoSolution, Refusal
from morphofold.quantities import COLUMN_WORDS, SCALAR_WORDS
from morphofold.sim.stage_checks import BOUNDS
from morphofold.studies.folded_ball import folded_ball
from morphofold.studies.import_layers import code_lines
from morphofold.studies.page_sentences import Page
from morphofold.studies.pages import column_page, measuring_pictures, message_page, section_plot
from morphofold.studies.pages.measuring_pictures import LINE_COLOURS, crest_figure, crest_row

DOCS = Path(__file__).resolve().parents[2] / "docs"


@pytest.mark.parametrize(("name", "module"), [("messages.md", message_page), ("tables.md", column_page)])
def test_a_generated_page_is_what_the_code_says(name, module, tmp_path):
    page = (DOCS / name).read_text(encoding="utf-8")
    (tmp_path / name).write_text(page, encoding="utf-8")
    module.write(tmp_path / name)
    assert (tmp_path / name).read_text(encoding="utf-8") == page


def test_every_refusal_code_bound_and_column_is_explained():
    kinds = Refusal.__subclasses__()
    assert len({kind.code for kind in kinds}) == len(kinds)
    assert all(str(kind.__doc__).count("\n\n") == 1 and kind.code.islower() and " " not in kind.code for kind in kinds)
    page = (DOCS / "messages.md").read_text(encoding="utf-8")
    assert all(f"| `{code}` |" in page for code in (*PYTHON_CODES.values(), "disk-full"))
    assert message_page.HEALTH_MEANING.keys() == {*BOUNDS, "lowest_J"}
    assert {column for columns in FRAMES.values() for column in columns} <= {*COLUMN_WORDS, *SCALAR_WORDS}


# measures -----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def ball():
    return measure(folded_ball(4000))


@pytest.fixture
def pages(tmp_path, monkeypatch):
    """A folder of pages with marks, for which the sensitivity of the hinges is made up."""
    counts = {"n_hinges": 20, "n_hinges_3": 19, "n_hinges_4": 1, "n_ends": 0, "crest_length_mm": 812.4}
    base = {"length": "", "factor": 1.0, "mm": np.nan, "kept": 1.0, "old": 1.0} | counts
    rows = [
        {**base, "length": length, "factor": factor, "mm": 2 * factor, "n_hinges": round(20 / factor), "kept": 0.75}
        for length in ("persistence", "merge")
        for factor in (0.5, 2.0)
    ]
    monkeypatch.setattr(measuring_pictures, "hinge_sensitivity", lambda cortex: [base, *rows])
    (tmp_path / "gyral-net.md").write_text("# By hand\n<!-- sensitivity -->\nold\n<!-- /sensitivity -->\n")
    return tmp_path


@pytest.mark.slow
def test_crest_lines_have_the_colours_of_their_kind(ball):
    row = crest_row(ball, "ball")
    for colour in LINE_COLOURS.values():
        fraction = (row.rgb == [int(colour[k : k + 2], 16) for k in (1, 3, 5)]).all(axis=1).mean()
        assert 0.01 < fraction < 0.3
    gyral = (row.rgb == [0xD5, 0x5E, 0x00]).all(axis=1)
    height = np.linalg.norm(ball.cortex.pial.verts, axis=1)
    assert height[gyral].mean() > height.mean() + 2  # on the crowns
    assert crest_figure([row]).ndim == 3


@pytest.mark.slow
def test_the_pages_get_their_tables_and_every_picture(ball, pages):
    measuring_pictures.write_pages(pages, {"ball": ball})
    text = (pages / "gyral-net.md").read_text()
    assert text.startswith("# By hand\n")
    assert "old" not in text
    assert "| ball | as they are | 1 | – | 20 | 19 | 1 | 812 | 1.00 |" in text
    assert "| ball | persistence | 2 | 4.00 | 10 | 19 | 1 | 812 | 0.75 |" in text
    assert "| ball | merge |" not in text
    assert "\nball\tmerge\t2\t4.00\t10\t19\t1\t812\t0.75\n" in (pages / "gyral-net-sensitivity.tsv").read_text()
    maps = "H shape-index sulcal-depth local-gyrification-index cortical-thickness gyral-thickness"
    names = f"{maps} crest-lines gyral-net sensitivity wavelength fractal-dimension section".split()
    text_names = {"gyral-net.md", "gyral-net-sensitivity.tsv"}
    assert {path.name for path in pages.iterdir()} == text_names | {f"{name}.png" for name in names}


@pytest.mark.slow
def test_a_section_shows_the_cut_with_the_widths_of_its_gyri(ball):
    gyri = gyral_thickness(ball.cortex)
    (ax,) = section_plot.section_figure(ball.cortex, gyri).axes
    (low, high), (bottom, top) = ax.get_xlim(), ax.get_ylim()
    assert (high - low, top - bottom) == pytest.approx(section_plot.WINDOW_MM)
    widths = [float(t.get_text()) for t in ax.texts if "mm" not in t.get_text()]
    segments = [line.get_xydata() for line in ax.lines if line.get_linewidth() == 2]
    assert len(widths) == len(segments) >= 1
    for width, ends in zip(widths, segments):
        assert ((ends > [low, bottom]) & (ends < [high, top])).all()
        assert 0.6 < width / np.linalg.norm(ends[1] - ends[0]) < 1.05  # less at slanted walls
        nearest = np.abs(gyri.points[:, [0, 2]] - ends[0]).sum(axis=1).argmin()
        assert round(gyri.width[nearest], 1) == width
    radius = np.nanmax(np.linalg.norm(ax.lines[0].get_xydata(), axis=1))  # of a plane cut of a ball about the origin
    assert 10 < radius <= np.linalg.norm(ball.cortex.pial.verts, axis=1).max()
    with pytest.raises(NoSolution):
        section_plot.section_figure(ball.cortex, replace(gyri, partner=np.full_like(gyri.partner, np.nan)))


def test_what_the_docs_say_of_trust_is_in_their_table():
    page = Page("measures/gyral-net")
    rows = [(row["times"], row["hinges"]) for row in page.tsv_rows("sensitivity") if row["surface"] == "S1"]
    (count,) = [n for times, n in rows if times == 1]
    changed = [n for times, n in rows if times in (0.5, 2)]
    numbers = count, min(changed), max(changed)
    page.assert_sentence("the # hinges of S1 become # to # (the doubtful ones included)", *numbers)


# lines of code ------------------------------------------------------------------------------------------------

SOURCE = '''# a comment
TEXT = """two
lines"""


class Two:
    """A class."""

    def three(self):

        return (3
        )   # the same
'''


def test_blank_lines_comments_and_docstrings_do_not_count():
    assert code_lines(SOURCE) == {2, 3, 6, 9, 11, 12}
