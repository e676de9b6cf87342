"""What the reproduced figures show, on octants at draft; minutes."""

import csv

import pytest
from made_simulations import MadeRuns

from morphofold.simulation import simulate
from morphofold.studies.paper import REPRODUCTIONS, paper_folds, paper_theory

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def reproduced(tmp_path_factory):
    """Draws a figure from octants at draft and reads its table; bodies that were grown stay."""
    folder = tmp_path_factory.mktemp("figures")

    def grow(name, scene, settings):
        coarse = [*settings, "accuracy.level=draft"]
        if not name.startswith("fig3"):  # which is an octant, or radial
            coarse.append("geometry.portion=octant")
        return simulate(scene, folder / "simulations" / name, settings=coarse, resume=True)

    def rows(figure, table):
        REPRODUCTIONS[figure](folder, MadeRuns(grow))
        with (folder / f"{table}.tsv").open(encoding="utf-8", newline="") as file:
            return list(csv.DictReader(file, delimiter="\t"))

    return rows


def at(rows, scene, growth):
    return next(
        {**row, **{k: float(v.replace("n/a", "nan")) for k, v in row.items() if k in NUMBERS}}
        for row in rows
        if row["scene"] == scene and float(row["growth"]) == growth
    )


NUMBERS = ("sulci", "wavelength_mm", "degree", "height_skewness", "gyral_thickness_mm", "theory_degree")


def test_the_sphere_of_figure_3_grows_as_theory_says_until_it_folds(reproduced):
    rows = [row for row in reproduced("fig3", "fig3a") if row["source"] == paper_theory.THREE_D]
    for row in rows:
        smooth = float(row["growth"]) <= 1.3
        assert (row["folded"] == "0") == smooth
        if smooth:
            assert abs(float(row["over_1d"])) < 5e-4
            assert abs(float(row["over_theory"])) < 5e-4
        else:
            assert float(row["over_theory"]) < -1e-3  # what grows then goes into folds


def test_a_thick_cortex_has_fewer_and_larger_folds(reproduced, monkeypatch):
    monkeypatch.setattr(paper_folds, "FIG6", paper_folds.FIG6[1:])
    rows = reproduced("fig6", "fig6")
    for growth in (1.35, 1.6, 2.0):
        normal, thick = (at(rows, scene, growth) for scene in ("fig5", "fig6-thick"))
        assert thick["sulci"] < 0.75 * normal["sulci"]
        assert 1.25 < thick["wavelength_mm"] / normal["wavelength_mm"] < 1.6
        assert 1.2 < thick["gyral_thickness_mm"] / normal["gyral_thickness_mm"] < 1.7


def test_a_soft_cortex_furrows_where_a_stiff_one_waves(reproduced):
    rows = reproduced("fig7", "fig7")
    soft, middle, stiff = (at(rows, column.scene, column.growths[0]) for column in paper_folds.FIG7)
    assert soft["height_skewness"] + 0.15 < middle["height_skewness"] < stiff["height_skewness"] - 0.15
    for row in (soft, middle, stiff):
        assert row["degree"] == pytest.approx(row["theory_degree"], abs=2)
    last = [at(rows, column.scene, 2.0) for column in paper_folds.FIG7]
    waves = [row["wavelength_mm"] for row in last]
    assert waves == sorted(waves)
