"""What the pages say of the paper's figures: sentences that follow the numbers, pictures, tables between marks."""

import json
import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from morphofold.cli.command_options import NOT_IN_ALL
from morphofold.report.pictures.pixel_canvas import png_bytes
from morphofold.sim import theory
from morphofold.studies.accuracy.radial_finite_elements import radial_equilibrium
from morphofold.studies.folds import fold_measures
from morphofold.studies.paper import figure_parts, paper_page
from morphofold.studies.paper.paper_folds import FIG5, FIG6, FIG7
from morphofold.studies.paper.paper_report import write_paper_report
from morphofold.studies.paper.verdicts import UNFOLDED_TEXT, VERDICT_MAKERS
from morphofold.tables import write_table

PAGE = Path(__file__).parents[2] / "docs" / "figures.md"
SIMULATION = {"folder": "simulations/fig5", "level": "draft", "elements": 8250, "steps": 600, "seconds": 20.4}
GREY = png_bytes(np.full((40, 60, 3), 90, dtype=np.uint8))

# docs/figures.md ----------------------------------------------------------------------------------------------


def fold(scene, g, T=2.0):
    """A row of a table of folds whose wavelength is 9 T, and at g = 2 10 T + 1 mm."""
    body = {"scene": scene, "level": "draft", "growth": g, "thickness_mm": T}
    waves = {"wavelength_mm": 10 * T + 1 if g == 2 else 9 * T, "theory_wavelength_mm": 8 * T, "note": None}
    return body | dict.fromkeys(fold_measures.COLUMN_TEXTS, 1.0) | waves


@pytest.fixture
def out(tmp_path):
    """What ``reproduce fig5 fig6 fig7`` leaves, with numbers that are made up."""
    folder = tmp_path / "out"
    folder.mkdir()
    tables = {
        "fig5": [fold("fig5", g) for line in FIG5 for g in line] + [fold("fig5", 1.2)],
        "fig6": [fold(c.scene, g, T) for T, c in zip((1.0, 2.0, 3.0), FIG6) for g in c.growths],
        "fig7": [fold(c.scene, g) for c in FIG7 for g in c.growths],
    }
    figures = {"fig4": {"shows": "", "files": []}}
    for name, rows in tables.items():
        write_table(folder / f"{name}.tsv", list(rows[0]), rows)
        seed_rows = [{"seed": seed, **row, "gyrification_index": 1.0 + seed} for seed in (1, 2) for row in rows]
        write_table(folder / f"{name}-seeds.tsv", list(seed_rows[0]), seed_rows)
        (folder / f"{name}.png").write_bytes(GREY)
        simulation = {**SIMULATION, "healthy": name != "fig7", "warnings": ["min J 0.01"] if name == "fig7" else []}
        files = [f"{name}.png", f"{name}.tsv", f"{name}-seeds.tsv"]
        figures[name] = {"shows": "", "files": files, "simulations": [simulation]}
    (folder / "summary.json").write_text(json.dumps({"figures": figures}))
    return folder


@pytest.fixture
def page(tmp_path):
    path = tmp_path / "docs" / "page.md"
    path.parent.mkdir()
    marked = [f"Before {n}.\n<!-- {n} -->\nOUTDATED\n<!-- /{n} -->\nAfter {n}." for n in ("fig5", "fig6", "fig7")]
    path.write_text("\n".join(marked))
    return path


def part(page, name):
    return re.search(f"<!-- {name} -->(.*)<!-- /{name} -->", page.read_text(), re.S)[1]


def rows_of_tsv(page, name):
    """The lines of a table beside the page, as cells."""
    lines = page.with_name(f"{page.stem}-{name}.tsv").read_text(encoding="utf-8").splitlines()
    return [line.split("\t") for line in lines]


def test_what_stands_between_the_marks_is_renewed_and_nothing_else(out, page):
    assert paper_page.write_page(out, page) == ["fig5", "fig6", "fig7"]
    once = page.read_text()
    for name in ("fig5", "fig6", "fig7"):
        assert f"Before {name}." in once
        assert f"After {name}." in once
        assert f"({name}.png)" in part(page, name)
    assert "OUTDATED" not in once
    assert "Simulations, 0 of 1 healthy: [page-fig7-runs.tsv](page-fig7-runs.tsv)." in part(page, "fig7")
    assert rows_of_tsv(page, "fig7-runs")[1][-1] == "min J 0.01"
    assert rows_of_tsv(page, "fig5-runs")[1] == ["fig5", "draft", "8250", "600", "20", "healthy"]
    paper_page.write_page(out, page)
    assert page.read_text() == once


def test_tables_have_the_growths_of_the_pictures_the_theory_and_the_slopes_on_thickness(out, page):
    paper_page.write_page(out, page)
    assert [row[:2] for row in rows_of_tsv(page, "fig5")[1:]] == [[f"{g:.2f}", "1.00"] for line in FIG5 for g in line]
    for name, columns in (("fig6", FIG6), ("fig7", FIG7)):
        for column in columns:
            growths, growths_of_seeds = (
                [row[1] for row in rows_of_tsv(page, table) if row[0] == column.title and row[2] == index]
                for table, index in ((name, "1.00"), (f"{name}-seeds", "1.00 to 3.00"))
            )
            assert growths == [f"{g:.2f}" for g in column.growths]
            assert growths_of_seeds == [growths[0], growths[-1]]
    (row,) = [row for row in rows_of_tsv(page, "fig6-waves") if row[:3] == ["thick, T/C = 3/50", "1.25", "1.000"]]
    assert row[6:8] == ["9.00", "8.00"]
    cells = {name: numbers for name, *numbers in rows_of_tsv(page, "fig6-slopes")}
    assert cells["wavelength, first picture"][:4] == ["9.00", "9.00", "9.00", "0.00"]
    assert cells["wavelength, last picture"][:4] == ["10.00", "10.00", "10.00", "1.00"]
    assert cells["wavelength of the first wrinkles, theory"][0] == "8.00"


def test_the_page_shows_a_few_rows_and_links_every_table(out, page):
    paper_page.write_page(out, page)
    for name, n_rows in (("fig5", 4), ("fig6", 3), ("fig7", 3)):
        lines = [line for line in part(page, name).splitlines() if line.startswith("| ")]
        assert len(lines) == 2 + n_rows
        assert lines[0][2:-2] == paper_page.SHOWN[name].heads
        for tsv_file in page.parent.glob(f"page-{name}*.tsv"):
            assert f"]({tsv_file.name})" in part(page, name)
    assert [line.split(" | ")[1] for line in part(page, "fig6").splitlines() if "T/C" in line] == ["2.00"] * 3


def test_a_table_without_a_name_stays_whole(page):
    table = figure_parts.Table(["a"], [["1"], ["2"]])
    texts = paper_page.paragraphs_of(
        page, "x", [figure_parts.Image("x", "y"), table], [{**SIMULATION, "healthy": True}]
    )
    assert texts[:2] == ["![y](x.png)", "| a |\n| --- |\n| 1 |\n| 2 |"]
    assert not list(page.parent.glob("*.tsv"))


def test_the_rows_of_the_page_are_those_of_the_tables_beside_it():
    for name in paper_page.SHOWN:
        heads, *rows = rows_of_tsv(PAGE, name)
        assert paper_page.shown_rows(figure_parts.Table(heads, rows, name)) in PAGE.read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("page", "names"),
    [(PAGE, set(figure_parts.PART_MAKERS) - {"fig4", *NOT_IN_ALL}), (PAGE.with_name("hemisphere.md"), NOT_IN_ALL)],
)
def test_the_pages_of_the_docs_have_marks_and_a_picture_of_every_figure(page, names):
    text = page.read_text(encoding="utf-8")
    for name in names:
        assert text.count(f"<!-- {name} -->") == text.count(f"<!-- /{name} -->") == 1
        assert any(PAGE.parent.glob(f"{name}*.png"))  # test_docs.py follows each link


@pytest.mark.slow
def test_what_the_page_says_of_theory_is_what_the_code_gives():
    text = " ".join(PAGE.read_text(encoding="utf-8").split())
    exact = [theory.bifurcation(T / 50, 2.0, kappa_ratio=50) for T in (1, 2, 3)]
    g = [b.g_crit for b in exact]
    assert f"theory has {g[0]:.3f}, {g[1]:.3f} and {g[2]:.3f} for the three" in text
    crease = theory.critical_growth(50 / 48)
    assert f"which are at {g[1]:.3f}. Eq. (12), the paper's criterion, is met at {crease:.3f}" in text
    assert f"it gives {crease:.3f} for all three" in text
    waves = [b.wavelength * 50 / T for b, T in zip(exact, (1, 2, 3))]
    assert f"gives {fold_measures.film_wavelength(1, 2):.1f} T" in text
    assert f"gives {min(waves):.1f} to {max(waves):.1f} T" in text


def test_the_compression_is_lowered_by_as_much_as_the_page_says():
    lowered, compression = [], []
    for T in (1, 2, 3):
        hoop = radial_equilibrium(2.0, T / 50, kappa_ratio=50).at(np.linspace(1 - T / 50, 1, 9), "cortex").sigma_theta
        incompressible = theory.stresses(2.0, 50 - T, 50, n=9).sigma_theta
        lowered += list(1 - hoop / incompressible)
        compression += list(-incompressible)
    text = " ".join(PAGE.read_text(encoding="utf-8").split())
    assert f"a compression of {min(compression):.0f} to {max(compression):.0f} μ" in text
    assert f"lowers it by {100 * min(lowered):.0f} to {100 * max(lowered):.0f} %" in text


# the page of all figures --------------------------------------------------------------------------------------

SCENES = {1.0: "fig7-ratio1", 2.0: "fig5", 4.0: "fig7-ratio4"}
FIRST = {column.scene: column.growths[0] for column in FIG7}


def row(T=2.0, mu=2.0, g=2.0, **more):
    """A row of a table of folds with wavelengths of 9 T, in theory 8 T, of a film 5 T."""
    body = {"scene": "x", "T_over_C": T / 50, "thickness_mm": T, "mu_ratio": mu, "growth": g, "law": "isotropic"}
    waves = {"wavelength_mm": 9 * T, "theory_wavelength_mm": 8 * T, "film_wavelength_mm": 5 * T, "sulci": 100 / T}
    onset = {"theory_g": 1.2, "theory_degree": 17.0, "degree": 18.0, "first_contact_g": 1.25}
    shape = {"height_rms_mm": 1.8, "height_skewness": -1 / mu, "gyral_thickness_mm": 5 * T, "gyrification_index": g}
    return body | waves | onset | shape | more


def soft_to_stiff(skewness, **more):
    rows = [row(mu=mu, g=FIRST[SCENES[mu]], scene=SCENES[mu], height_skewness=s) for mu, s in zip(SCENES, skewness)]
    rows = [row(scene="fig5", g=2.0), *({**each, **more} for each in rows[::-1])]
    return {"fig7.tsv": rows, "fig7-seeds.tsv": [{**each, "seed": 1.0} for each in rows]}


def line(points, surface="a", slope=1.0, low=-1.0, ratio=2.5, crests=2.9, robust=-1.0, least=None):
    fit = {"slope": slope, "slope_low": low, "intercept_mm": -0.2, "robust_slope": robust, "robust_low": least}
    ratios = {"gyral_over_cortical": ratio, "gyral_over_cortical_at_crests": crests}
    return {"surface": surface, "points": points} | fit | ratios


def bodies(**more):
    rows = [row(T, g=g, **more) for T in (1.0, 2.0, 3.0) for g in (1.5, 2.0)]
    return {"fig6.tsv": rows, "fig6-seeds.tsv": [{**each, "seed": 1.0} for each in rows]}


def deepening(of_seed_0, of_seed_1):
    rows = [[row(g=g, gyrification_index=index(g)) for g in (1.25, 1.5, 2)] for index in (of_seed_0, of_seed_1)]
    return {"fig5.tsv": rows[0], "fig5-seeds.tsv": [{**each, "seed": 1.0} for each in rows[1]]}


def hinges(verdict, p):
    numbers = [
        {"number": "shape", "energy": 0.05, "p": p, "median": None, "other_median": None},
        {"number": "largest angle, degrees", "energy": None, "p": None, "median": 190.0, "other_median": 170.0},
    ]
    nearest = [
        {"source": name, "to_other": near, "from_other": near + 0.05, "n": 9.0, "verdict": verdict}
        for name, near in {"model": 0.18, "MRI itself": 0.19, "random net": 0.2}.items()
    ]
    return {"fig9-numbers.tsv": numbers, "fig9-nearest.tsv": nearest}


def radius(off):
    rows = [{"source": "finite elements, 3-D", "over_theory": o, "folded": f} for o, f in ((off, 0.0), (-0.04, 1.0))]
    return {"fig3a.tsv": rows, "fig3b.tsv": [{"source": "smooth sphere, 1-D", "over_theory": 0.003}]}


YES, NO = "As in the paper", "Not as in the paper"
LINES = [
    line("regions, x", low=0.5, robust=1.0, least=0.2),
    line("regions, y"),
    line("bodies", slope=2.5),
    line("crests", "T = 1 mm"),
    line("crests", "S1 lh", ratio=3.9, crests=2.8),
]
OF_LINES = [YES, "W = 2.50 t − 0.2 mm", "in 1 of 2 fits", "confidence in 1 (by least squares 2 and 1)"]
OF_LINES += ["confidence in 0 of 2", "2.9 times as wide", "2.8 times in a person", "2.5 and 3.9 times"]
SKEWED = (-1, -0.5, -0.2)
SENTENCES = [
    ("fig3", radius(1e-4), [YES, "radius within 0.01 %", "stress within 0.3 %", "up to 4 % off"]),
    ("fig3", radius(0.02), [NO, "radius within 2 %"]),
    ("fig5", deepening(float, float), [YES, "each of 2 seeds", "GI is 1.25 at g = 1.25 and 2.00"]),
    ("fig5", deepening(lambda g: 3 - g, lambda g: 3 - g), [NO]),
    ("fig5", deepening(float, lambda g: 3 - g), [NO, "for 1 of 2 seeds"]),
    ("fig6", bodies(), [YES, "100, 50 and 33 sulci", "5.0, 10.0 and 15.0 mm", "9.0 T", "8.0 T", "5.0 T"]),
    ("fig6", bodies(sulci=7.0), [NO]),
    ("fig6", bodies(gyral_thickness_mm=None), [UNFOLDED_TEXT]),
    ("fig7", soft_to_stiff(SKEWED), [YES, "−1.00, −0.50 and −0.20 at ratios 1, 2 and 4"]),
    ("fig7", soft_to_stiff(SKEWED), ["1.20, 1.20 and 1.20, all before the creases"]),
    ("fig7", soft_to_stiff(SKEWED, first_contact_g=1.3), ["touch 0.10, 0.10 and 0.10 of growth after"]),
    ("fig7", soft_to_stiff(SKEWED, first_contact_g=None), ["come first at small ratios."]),
    ("fig7", soft_to_stiff(SKEWED, theory_g=1.5), ["not all before the creases of Eq. (12) at 1.43"]),
    ("fig7", soft_to_stiff((-1, -1.5, -0.2)), [NO]),
    ("fig8", {"fig8.tsv": LINES}, OF_LINES),
    ("fig8", {"fig8.tsv": [line("bodies"), line("crests", "T = 1 mm", crests=None)]}, [UNFOLDED_TEXT]),
    ("fig9", hinges("No closer.", 0.001), ["No closer.", "0.190 and 0.240", "shapes differ"]),
    ("fig9", hinges("Closer.", 0.4), ["Closer.", "do not differ significantly", "190°", "170°"]),
]


@pytest.mark.parametrize(("figure", "tables", "expected"), SENTENCES)
def test_a_sentence_follows_the_numbers(figure, tables, expected):
    sentence = VERDICT_MAKERS[figure](tables)
    assert [text for text in expected if text not in sentence] == []


class Tags(HTMLParser):
    """Tags of a page, with their attributes."""

    def __init__(self, text):
        super().__init__()
        self.tags = []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))


def test_the_page_of_all_figures_has_each_with_its_sentence_picture_and_time(tmp_path):
    points = (("isotropic", 1e-3, 1.34), ("isotropic", 0.04, 1.43), ("tangential", 0.04, 1.38))
    rows = [{"source": "theory", "law": law, "T_over_C": T, "g_crease": g, "reason": None} for law, T, g in points]
    write_table(tmp_path / "fig4.tsv", list(rows[0]), rows)
    (tmp_path / "fig4.png").write_bytes(GREY)
    simulation = {**SIMULATION, "seconds": 300.0, "healthy": False, "warnings": ["<hot>"], "scene": "x"}
    files = ["fig4.png", "fig4.tsv"]
    entry = {"files": files, "shows": "<b>creases", "seconds": 3.4, "simulations": [simulation, dict(simulation)]}
    index = {"morphofold": "1", "lengths": "mm", "figures": {"fig4": entry}}
    text = write_paper_report(tmp_path, index).read_text(encoding="utf-8")
    assert "A thin cortex can crease from g = 1.34 on" in text
    assert "from 1.43 if growth is isotropic, from 1.38 if tangential" in text
    assert "Measured and drawn in 3 s" in text
    assert "1 simulation, 5 min" in text  # the same one twice
    assert "not healthy: &lt;hot&gt;" in text
    assert "<b>creases" not in text
    tags = Tags(text).tags
    (picture,) = [attrs for tag, attrs in tags if tag == "img"]
    assert picture["src"].startswith("data:image/png;base64,")
    assert not [attrs for tag, attrs in tags if tag == "script" or str(attrs.get("href", "#"))[:4] == "http"]
