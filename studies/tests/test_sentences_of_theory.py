"""Sentences of docs/theory.md have the numbers of the tables there, which runs write, and of the code."""

import csv
import re

import numpy as np
import pytest

from morphofold.sim import theory
from morphofold.sim.sphere_theory.smooth_sphere import SmoothSphere
from morphofold.studies import post_onset, spacing, stress_growth_study
from morphofold.studies.markdown import table_with_tsv
from morphofold.studies.page_sentences import Page, spread

PAGE = Page("theory")
LAWS = ("isotropic", "tangential")
STUDIES = {"post-onset": post_onset, "spacing": spacing, "stress-growth": stress_growth_study}


@pytest.mark.parametrize("name", STUDIES)
def test_a_table_of_the_page_is_the_part_of_the_whole_one_that_the_study_shows(name, tmp_path):
    whole = PAGE.path.with_name(f"theory-{name}.tsv").read_text("utf-8")
    rows, study = [*csv.reader(whole.splitlines(), delimiter="\t", quoting=csv.QUOTE_NONE)][1:], STUDIES[name]
    part = table_with_tsv(tmp_path / "theory.md", name, study.COLUMN_HEADS, rows, study.is_shown)
    assert f"<!-- {name} -->\n\n{part}\n\n<!-- /{name} -->" in PAGE.path.read_text("utf-8")
    assert (tmp_path / f"theory-{name}.tsv").read_text("utf-8") == whole


def test_constants_of_radius_and_creases():
    crease, longer = theory.CREASE, theory.CREASE ** (1 / 3)
    sentence = (
        'times faster" growth means edges # times as long, # times the volume if isotropic, # times if tangential'
    )
    PAGE.assert_sentence(sentence, longer, longer**3, longer**2, tolerance=0.01)
    PAGE.assert_sentence(r"can crease once $\lambda_r/\lambda_\theta \ge #$", crease, tolerance=0)
    PAGE.assert_sentence(r"if $\bar C^3 \ge #/#$", 12, 7, tolerance=0)
    assert theory.thickest_creasing() ** 3 == pytest.approx(12 / 7)
    PAGE.assert_sentence(r"$\bar C \ge$ #:", theory.thickest_creasing(), tolerance=5e-5)
    PAGE.assert_sentence("both tend to $#^{1/3}$ = #.", crease, longer, tolerance=5e-5)
    sentence = r"($\lambda_r/\lambda_\theta$ = #, equibiaxial stretch #)"
    PAGE.assert_sentence(sentence, theory.BIOT, theory.BIOT ** (-1 / 3), tolerance=5e-4)


def test_limits_of_the_code():
    sentence = r"κ/μ from (\S+) to (\S+) or ∞, μ ratio (\S+) to (\S+), T/C from (\S+), A/C from (\S+)\. "
    (limits,) = re.findall(sentence, PAGE.prose)
    lowest_kappa, largest_kappa, lowest_mu, largest_mu, least_T, least_hole = map(float, limits)
    SmoothSphere(least_T, lowest_mu, "isotropic", lowest_kappa, least_hole)
    SmoothSphere(least_T, largest_mu, "isotropic", largest_kappa, least_hole)
    inside = {"T_over_C": 0.04, "mu_ratio": 1.0, "kappa_ratio": np.inf, "A_over_C": 0.5}
    for beyond in (
        {"kappa_ratio": 0.99 * lowest_kappa},
        {"kappa_ratio": 1.01 * largest_kappa},
        {"mu_ratio": 0.99 * lowest_mu},
        {"mu_ratio": 1.01 * largest_mu},
        {"T_over_C": 0.99 * least_T},
        {"A_over_C": 0.99 * least_hole},
    ):
        with pytest.raises(ValueError, match="must"):
            SmoothSphere(**(inside | beyond))


def test_wrinkles_before_creases():
    rows = PAGE.tsv_rows("wrinkles")
    of = lambda column, **where: spread(row[column] for row in rows if all(row[key] == where[key] for key in where))
    equal, stiff = {"μ ratio": 1}, {"μ ratio": 4}
    PAGE.assert_sentence("as stiff as its core wrinkles at g = # to #, one", *of("wrinkle g", **equal), tolerance=0.005)
    PAGE.assert_sentence("one four times as stiff at # to #, in", *of("wrinkle g", **stiff), tolerance=0.005)
    PAGE.assert_sentence("in waves of # to # thicknesses", *of("wavelength/T"), tolerance=0.05)
    PAGE.assert_sentence("expects creases later, at # to #.", *of("crease g"), tolerance=0.005)
    assert all(row["wrinkle g"] < row["crease g"] for row in rows)
    equal_rows = [row for row in rows if row["μ ratio"] == 1]
    lags = [spread(row["crease g"] - row["wrinkle g"] for row in equal_rows if row["law"] == law) for law in LAWS]
    sentence = "at ratio 1 by # to # in g under isotropic and by # to # under tangential growth"
    PAGE.assert_sentence(sentence, *lags[0], *lags[1], tolerance=0.005)
    sentence = "meet the crease criterion at an amplitude of # to # T, at ratio 4 at # to # T."
    PAGE.assert_sentence(sentence, *of("a/T", **equal), *of("a/T", **stiff))


def test_octants_of_bricks():
    errors = [float(row["edge 0.98 T"].removesuffix(" %")) for row in PAGE.tsv_rows("octants")]
    PAGE.assert_sentence("lose their stability # to # % later on octants with edges of 0.98 T", *spread(errors))


def test_what_follows_the_onset():
    rows = PAGE.tsv_rows("post-onset")
    assert all((row["c"] < 0) == (row["kind"] == "subcritical") == (row["ratio"] <= 0.7) for row in rows)
    last_folds = lambda *ratios: spread(-row["back, until"] for row in rows if row["ratio"] in ratios)
    PAGE.assert_sentence("and stay until # to # in g below it.", *last_folds(0.5, 0.7))
    (first_folds,) = {row["folds from g - g_crit"] for row in rows if row["ratio"] == 1}
    sentence = "within # in g the valley creases and the fold jumps; it stays until # to # below."
    PAGE.assert_sentence(sentence, first_folds, *last_folds(1))
    assert all(row["folds from g - g_crit"] <= 0 for row in rows if row["ratio"] < 1)  # at the onset


def test_spacing_of_folds_in_theory():
    rows = PAGE.tsv_rows("spacing")
    by = lambda column, law, ratio, least_g=0.0: [
        row[column] for row in rows if row["law"] == law and row["ratio"] == ratio and row["g"] >= least_g
    ]
    firsts = {ratio: max(by("over the thickness now", law, ratio)[0] for law in LAWS) for ratio in (4,)}
    soft = min(by("over the thickness now", law, 0.7)[0] for law in LAWS)
    PAGE.assert_sentence("from # (ratio 0.7) to # (ratio 4) at the first folds", soft, firsts[4])
    late = [row["over the thickness now"] for row in rows if row["g"] == 2.2]
    PAGE.assert_sentence("down to # to # at g = 2.2.", *spread(late), tolerance=0.11)
    before = lambda *ratios: spread(
        [value for ratio in ratios for value in by("best wavelength / T", "tangential", ratio, 1.6)]
    )
    PAGE.assert_sentence(
        "from g = 1.6 on: # to # at the ratios 0.7 and 1, # to # at 2, # to # at 4.",
        *before(0.7, 1),
        *before(2),
        *before(4),
        tolerance=0.11,
    )
    grown = spread([row["best wavelength / T"] for row in rows if row["law"] == "isotropic"])
    PAGE.assert_sentence("the spacing grows with it, from # to #.", *grown, tolerance=0.5)
    PAGE.assert_sentence("those *nearly as good* at most # % more.", 100 * spacing.ENERGY_MARGIN, tolerance=1e-9)


def test_waves_of_a_core_that_grows_by_its_stress():
    rows = PAGE.tsv_rows("stress-growth")
    simulated, in_theory = "wavelength / T: simulated", "wavelength / T: theory"
    ends = [row[simulated] for row in rows if row["rate"] in (0, 300)]
    PAGE.assert_sentence("rises from # to # T at equal stiffness, from # to # T at ratio 4:", *ends, tolerance=0.06)
    at = {(row["ratio"], row["rate"]): row[simulated] for row in rows}
    powers = [np.log(at[ratio, 300] / at[ratio, 100]) / np.log(3) for ratio in (1, 4)]
    PAGE.assert_sentence("from 100 to 300 with the power # and #.", *powers, tolerance=0.006)
    largest = max(abs(row[simulated] / row[in_theory] - 1) for row in rows)
    (bound,) = PAGE.numbers("have theory's wavelength within # %")
    assert 0 <= bound - 100 * largest < 0.1
    later = spread(row["g: simulated"] - row["g: theory"] for row in rows)
    PAGE.assert_sentence("and fold # to # later in g.", *later, tolerance=0.0005)
    sentence = "the first wave that is # times as high as before growth"
    PAGE.assert_sentence(sentence, stress_growth_study.AMPLIFICATION, tolerance=0)
    assert len(stress_growth_study.SEEDS) == 3
    assert "(mean of three seeds, 95 % interval)" in PAGE.prose


def test_intervals_of_noise_overlap():
    cells = [row["wavelength / T: noise, simulated"] for row in PAGE.tsv_rows("stress-growth")]
    mean, half = np.array([[float(part) for part in cell.split(" ± ")] for cell in cells if "±" in cell]).T
    assert ((mean - half).max() <= (mean + half).min()) == ("their intervals overlap" in PAGE.prose)


def test_volume_that_the_core_gains():
    errors = [cell for row in PAGE.tsv_rows("core-volume") for cell in row.values() if str(cell).endswith(" %")]
    PAGE.assert_sentence("is off by # to +# %", *spread(float(error.removesuffix(" %")) for error in errors))
