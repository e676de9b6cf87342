import json
import re
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

from morphofold.cli.options import NOT_IN_ALL
from morphofold.errors import MissingPart
from morphofold.report.pictures.sheet import png_bytes
from morphofold.sim import theory
from morphofold.studies.accuracy.radial_finite_elements import radial_equilibrium
from morphofold.studies.folds import fold_tables
from morphofold.studies.paper import paper_figures
from morphofold.studies.paper import paper_page as paper_page
from morphofold.studies.paper.paper_folds import FIG5, FIG6, FIG7
from morphofold.tables import write_table

PAGE = Path(__file__).parents[2] / "docs" / "figures.md"
SIMULATION = {"folder": "simulations/fig5", "level": "draft", "elements": 8250, "steps": 600, "seconds": 20.4}


def fold(scene, g, T=2.0, **more):
    """A row of a table of folds whose wavelength is 9 T, and at g = 2 10 T + 1 mm."""
    numbers = dict.fromkeys(fold_tables.COLUMNS, 1.0)
    wavelength = 10 * T + 1 if g == 2 else 9 * T
    return {
        "scene": scene,
        "level": "draft",
        "growth": g,
        "thickness_mm": T,
        **numbers,
        "wavelength_mm": wavelength,
        "theory_wavelength_mm": 8 * T,
        "note": None,
        **more,
    }


@pytest.fixture
def out(tmp_path):
    """What ``reproduce fig5 fig6 fig7`` leaves, with numbers that are made up."""
    folder = tmp_path / "out"
    folder.mkdir()
    rows = {
        "fig5": [fold("fig5", g) for line in FIG5 for g in line] + [fold("fig5", 1.2)],
        "fig6": [fold(c.scene, g, T) for T, c in zip((1.0, 2.0, 3.0), FIG6) for g in c.growth],
        "fig7": [fold(c.scene, g) for c in FIG7 for g in c.growth],
    }
    for name in rows:
        write_table(folder / f"{name}.tsv", list(rows[name][0]), rows[name])
        (folder / f"{name}.png").write_bytes(png_bytes(np.full((40, 60, 3), 90, dtype=np.uint8)))
    figures = {
        name: {
            "shows": "",
            "files": [f"{name}.png", f"{name}.tsv"],
            "simulations": [{**SIMULATION, "healthy": True, "warnings": []}],
        }
        for name in rows
    }
    figures["fig4"] = {"shows": "", "files": []}
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


def test_what_stands_between_the_marks_is_renewed_and_nothing_else(out, page):
    assert paper_page.write_page(out, page) == ["fig5", "fig6", "fig7"]
    once = page.read_text()
    for name in ("fig5", "fig6", "fig7"):
        assert f"Before {name}." in once
        assert f"After {name}." in once
        assert f"({name}.png)" in part(page, name)
    assert "OUTDATED" not in once
    paper_page.write_page(out, page)
    assert page.read_text() == once


def test_a_table_has_the_growths_of_the_pictures(out, page):
    paper_page.write_page(out, page)
    found = re.findall(r"^\| (\d\.\d\d) \| 1.00 ", part(page, "fig5"), re.M)
    assert found == [f"{g:.2f}" for line in FIG5 for g in line]
    for name, columns in (("fig6", FIG6), ("fig7", FIG7)):
        for column in columns:
            found = re.findall(rf"^\| {re.escape(column.title)} \| (\d\.\d\d) \| 1.00 ", part(page, name), re.M)
            assert found == [f"{g:.2f}" for g in column.growth]


def test_the_first_picture_stands_beside_theory(out, page):
    paper_page.write_page(out, page)
    begin = "| thick, T/C = 3/50 | 1.25 | 1.000 "
    (line,) = [line for line in part(page, "fig6").splitlines() if line.startswith(begin)]
    assert line.split(" | ")[6:8] == ["9.00", "8.00"]


def test_slopes_on_thickness_are_those_of_the_lines(out, page):
    paper_page.write_page(out, page)
    cells = [line[2:].split(" | ") for line in part(page, "fig6").splitlines()]
    lines = {name: numbers for name, *numbers in cells}
    assert lines["wavelength, first picture"][:3] == ["9.00", "0.00", "0.00"]
    assert lines["wavelength, last picture"][:3] == ["10.00", "0.00", "1.00"]
    assert lines["wavelength of the first wrinkles, theory"][0] == "8.00"


def test_a_run_that_is_not_healthy_is_told(out, page):
    index = json.loads((out / "summary.json").read_text())
    index["figures"]["fig7"]["simulations"][0].update(healthy=False, warnings=["min J 0.01"])
    (out / "summary.json").write_text(json.dumps(index))
    paper_page.write_page(out, page)
    assert "**not healthy**: min J 0.01" in part(page, "fig7")
    assert "- `fig5`, draft: 8,250 bricks, 600 steps, 20 s, healthy" in part(page, "fig5")


def test_pictures_are_halved(out, page):
    image = np.zeros((41, 60, 3), dtype=np.uint8)
    image[::2, ::2] = 208  # a mean of 52, which is a step of four
    (out / "fig5.png").write_bytes(png_bytes(image))
    paper_page.write_page(out, page)
    small = np.round(255 * imread(page.parent / "fig5.png"))
    assert small.shape[:2] == (20, 30)
    assert (small[:, :, :3] == 52).all()


@pytest.mark.parametrize("broken", ["<!-- fig6 -->", "<!-- /fig6 -->"])
def test_a_page_without_marks_is_refused_and_stays_as_it_was(out, page, broken):
    page.write_text(page.read_text().replace(broken, ""))
    before = page.read_text()
    with pytest.raises(MissingPart, match=rf"{page.name}: .*<!-- fig6 -->.*<!-- /fig6 -->"):
        paper_page.write_page(out, page)
    assert page.read_text() == before


# docs/figures.md ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("page", "names"),
    [(PAGE, set(paper_figures.PARTS) - {"fig4", *NOT_IN_ALL}), (PAGE.with_name("hemisphere.md"), NOT_IN_ALL)],
)
def test_the_pages_of_the_docs_have_a_place_for_every_figure(page, names):
    text = page.read_text(encoding="utf-8")
    for name in names:
        assert text.count(f"<!-- {name} -->") == text.count(f"<!-- /{name} -->") == 1
        assert any(PAGE.parent.glob(f"{name}*.png"))  # test_docs.py follows each link


def test_the_tables_of_the_docs_have_the_columns_of_the_code():
    text = PAGE.read_text(encoding="utf-8")
    heads = f"| {' | '.join(paper_figures.FOLDS)} |"
    assert heads in text
    assert text.count(heads[2:]) == 3


@pytest.mark.slow
def test_what_the_page_says_of_theory_is_what_the_code_gives():
    text = " ".join(PAGE.read_text(encoding="utf-8").split())
    found = [theory.bifurcation(T / 50, 2.0, kappa_ratio=50) for T in (1, 2, 3)]
    g = [b.g_crit for b in found]
    assert f"theory has {g[0]:.3f}, {g[1]:.3f} and {g[2]:.3f} for the three" in text
    crease = theory.critical_growth(50 / 48)
    assert f"which are at {g[1]:.3f}. Eq. (12), the paper's criterion, is met at {crease:.3f}" in text
    waves = [b.wavelength * 50 / T for b, T in zip(found, (1, 2, 3))]
    assert f"gives {fold_tables.film_wavelength(1, 2):.1f} T" in text
    assert f"gives {min(waves):.1f} to {max(waves):.1f} T" in text


def test_the_compression_is_lowered_by_as_much_as_the_page_says():
    lowered, compression = [], []
    for T in (1, 2, 3):
        at = radial_equilibrium(2.0, T / 50, kappa_ratio=50).at(np.linspace(1 - T / 50, 1, 9), "cortex").sigma_theta
        incompressible = theory.stresses(2.0, 50 - T, 50, n=9).sigma_theta
        lowered += list(1 - at / incompressible)
        compression += list(-incompressible)
    text = " ".join(PAGE.read_text(encoding="utf-8").split())
    assert f"a compression of {min(compression):.0f} to {max(compression):.0f} μ" in text
    assert f"lowers it by {100 * min(lowered):.0f} to {100 * max(lowered):.0f} %" in text
