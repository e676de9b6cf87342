"""The numbers of the docs are those of the code."""

import re
from pathlib import Path

import pytest

from morphofold.sim import theory

DOCS = Path(__file__).parent.parent / "docs"
THEORY = (DOCS / "theory.md").read_text(encoding="utf-8")
WRINKLES = (DOCS / "theory-wrinkles.tsv").read_text(encoding="utf-8")
ROWS = re.findall(r"^(isotropic|tangential)\t(\d)/50\t(\d)\t(.*)$", WRINKLES, re.M)
CASES = [pytest.param(*row, marks=[pytest.mark.slow] * (row[1] != "2")) for row in ROWS]


def test_the_table_of_creases_and_wrinkles_holds_the_papers_cases():
    cases = {(law, int(T), int(ratio)) for law, T, ratio, _ in ROWS}
    assert cases == {(law, T, ratio) for law in ("isotropic", "tangential") for T in (1, 2, 3) for ratio in (1, 2, 4)}
    on_the_page = re.findall(r"^\| ((?:isotropic|tangential) \| \d/50 \| .*) \|$", THEORY, re.M)
    assert on_the_page
    assert {row.replace(" | ", "\t") for row in on_the_page} <= {*WRINKLES.splitlines()}


@pytest.mark.parametrize(("law", "T", "mu_ratio", "printed"), CASES)
def test_a_row_of_creases_and_wrinkles_is_what_the_code_gives(law, T, mu_ratio, printed):
    T_over_C = int(T) / 50
    wrinkle = theory.bifurcation(T_over_C, float(mu_ratio), law)
    c = float(theory.deformed_radius(wrinkle.g_crit, 1 / (1 - T_over_C), law)) * (1 - T_over_C)
    numbers = (
        f"{wrinkle.g_crit:.4f}",
        f"{wrinkle.mode:.0f}",
        f"{wrinkle.wavelength / T_over_C:.2f}",
        f"{theory.critical_growth(1 / (1 - T_over_C), law):.4f}",
        f"{(wrinkle.g_crit / c) ** 3:.3f}",
        f"{wrinkle.creasing_amplitude / T_over_C:.2f}",
    )
    assert printed == "\t".join(numbers)


@pytest.mark.slow
def test_the_order_turns_at_the_stiffness_ratios_that_the_text_names():
    named = re.search(r"at ratio ([\d., ]+) \(isotropic\) and ([\d., ]+) \(tangential\)", " ".join(THEORY.split()))
    for law, ratios in zip(("isotropic", "tangential"), named.groups()):
        for T, ratio in zip((1, 2, 3), map(float, ratios.split(", "))):
            crease = float(theory.critical_growth(50 / (50 - T), law))
            softer, stiffer = (theory.bifurcation(T / 50, ratio + d, law).g_crit for d in (-0.006, 0.006))
            assert stiffer < crease < softer
