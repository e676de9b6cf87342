"""Sentences of pages have the numbers of the tables there, which runs write."""

import re
from pathlib import Path

import numpy as np
import pytest

DOCS = Path(__file__).parents[2] / "docs"
NAMES = ("figures", "folds", "laws", "hemisphere", "theory", "accuracy")
PAGES = {name: (DOCS / f"{name}.md").read_text("utf-8").replace("−", "-") for name in NAMES}
PROSE = " ".join(re.sub(r"<!-- (\w+) -->.*?<!-- /\1 -->", "", "".join(PAGES.values()), flags=re.S).split())


def tables(mark, page="figures"):
    """The tables between marks of a page, rows by column; a second column of a name ends in 2. Cells are numbers where
    they can be."""
    (part,) = re.findall(rf"<!-- {mark} -->(.*?)<!-- /{mark} -->", PAGES[page], re.S)
    found = []
    for block in re.findall(r"(?:^\|.*\n)+", part, re.M):
        heads, _, *rows = ([cell.strip() for cell in line.split("|")[1:-1]] for line in block.splitlines())
        heads = [f"{head} 2" if head in heads[:k] else head for k, head in enumerate(heads)]
        found.append([dict(zip(heads, map(as_number, row))) for row in rows])
    return found


def as_number(cell):
    try:
        return float(cell)
    except ValueError:
        return cell


def first(rows, growth=None):
    """Rows of each body at its first growth, or at one."""
    by_body = {}
    for row in rows:
        if growth in (None, row["g"]):
            by_body.setdefault(next(iter(row.values())), row)
    return [*by_body.values()]


def assert_sentence(sentence, *values, tolerance=0.001):
    """The pages have this sentence once, and its numbers, each a ``#`` here, are those of the tables."""
    pattern = re.escape(sentence).replace(r"\#", r"(-?\d+(?:\.\d+)?)")
    (numbers,) = re.findall(pattern, PROSE)
    numbers = [float(number) for number in ((numbers,) if isinstance(numbers, str) else numbers)]
    assert numbers == pytest.approx(list(values), abs=tolerance), sentence


def spread(values):
    return min(values), max(values)


def test_the_film_formula_and_the_waves_that_form():
    waves, sizes = [], []
    for figure in ("fig6", "fig7"):
        stages, _, theory, *_ = tables(figure)
        waves += theory
        sizes += first(stages)
    excess = [
        100 * (w["by the film formula"] * s["cortex, mm"] / s["wavelength, mm"] - 1) for w, s in zip(waves, sizes)
    ]
    assert_sentence("picture it gives waves # to # % too long", *spread(excess), tolerance=0.6)
    of_fig6 = tables("fig6")[2]
    assert_sentence("gives # to # T, and waves", *spread([row["by theory 2"] for row in of_fig6]), tolerance=0.06)
    assert_sentence("and waves of # to # T form", *spread([row["wavelength / T"] for row in of_fig6]), tolerance=0.06)


def test_the_first_pictures_of_soft_and_stiff_cortices():
    stages, seeds, theory = tables("fig7")
    rows = first(stages)
    assert_sentence(
        "the height has an rms of # to # mm at every ratio", *spread([row["rms, mm"] for row in rows]), tolerance=0.06
    )
    ends = [[float(x) for x in row["skewness"].split(" to ")] for row in first(seeds)]
    assert [round(np.mean(pair), 1) for pair in ends[:2]] == [-1.9, -1.2]
    assert_sentence("skewness is -1.9, -1.2 and # to #, in", *ends[2][::-1], tolerance=0.06)
    waits = [row["walls touch, g"] - row["wrinkles by theory, g"] for row in theory]
    assert waits[0] < 0.01
    assert_sentence("at ratio 2 after # of growth, at ratio 4 after #.", *waits[1:], tolerance=0.006)


def test_gyral_thickness_of_models():
    rows = tables("fig8")[0]
    bodies = [row for row in rows if row["surface"].startswith("T = ")]
    (models,) = [row for row in rows if row["surface"] == "models"]
    assert_sentence(
        "the gyri of models are # to # times", *spread([row["at crests"] for row in bodies]), tolerance=0.06
    )
    assert_sentence("from body to body: W = # t.", models["robust slope"], tolerance=0.006)
    assert_sentence(
        "the ratio is # to # in the three models", *spread([row["at crests"] for row in bodies]), tolerance=0.06
    )
    averages = [row["at crests"] for row in rows if row["surface"].startswith("fsaverage5")]
    assert_sentence("The average brain has # to #, because", *spread(averages), tolerance=0.06)
    assert all(row["robust slope"] < 0 for row in bodies)
    assert sum(row["to"] <= 0 for row in bodies) == 2


def test_hinges_of_models_and_of_the_person():
    thin, normal, thick, person = tables("fig9")[0]
    densities = [row["per width²"] for row in (normal, thick, person, thin)]
    assert_sentence(
        "of hinges (# and # per square of the crown width, the person #; the thin one has #)",
        *densities,
        tolerance=0.006,
    )
    angles = [row["median largest angle, degrees"] for row in (normal, person)]
    assert_sentence("The largest angle is about #° in the bodies and #° in", *angles, tolerance=7)
    assert round(10 * thin["hinges"] / sum(row["hinges"] for row in (thin, normal, thick))) == 7
    assert_sentence("With # hinges to choose from", person["with three arms"], tolerance=0.1)


def test_laws_through_growth_and_across_scales():
    (growth,), (scales,), (spacing,) = (tables(mark, "laws") for mark in ("growth", "scales", "spacing"))
    isotropic, tangential = ([row for row in growth if law in row["body"]] for law in ("isotropic", "tangential"))
    entries = [row["in the range of mammals from"] for row in (*isotropic[::-1], tangential[-1])]
    assert_sentence(
        "of their size at g = #, # and #, thick ones first; with tangential growth only the thickest does, at #.",
        *entries,
    )
    assert [row["in the range of mammals from"] for row in tangential[:-1]] == ["–", "–"]
    before, after = ([row[g] for row in growth] for g in ("1", "2"))
    differences = [max(before) - min(before), *(max(after[k : k + 3]) - min(after[k : k + 3]) for k in (0, 3))]
    assert_sentence(
        "K differs by # before growth and, at g = 2, by # (isotropic) or # (tangential)", *differences, tolerance=0.011
    )
    exponents = {g: spread([row["exponent"] for row in scales if row["g"] == g]) for g in (1.4, 1.8, 2.0)}
    numbers = [number for low, high in exponents.values() for number in (high, low)]
    assert_sentence(
        "from between # and # at g = 1.4 to between # and # at g = 1.8 and between # and # at g = 2, for", *numbers
    )
    person, average, shell = scales[:3]
    assert_sentence("S1 has # on the left", person["exponent"])
    assert_sentence("averaged away, #.", average["exponent"])
    assert_sentence("a body without folds has #", shell["exponent"])
    assert_sentence(
        "spheres have # to #: fewer", *spread([row["over the thickness now"] for row in spacing[:-2]]), tolerance=0.06
    )
    assert_sentence(
        "Folds of S1 are wider, # thicknesses; those", spacing[-2]["over the thickness now"], tolerance=0.06
    )


def test_bias_and_pattern_of_folds():
    (rows,) = tables("carried", "folds")
    per_cent = lambda level, column: [
        float(row[column].split("(")[1].split(" %")[0]) for row in rows if row["run"] == level
    ]
    standard, fine = (per_cent(level, "its index") for level in ("standard", "fine"))
    low, high = spread([-error for error in standard])
    assert_sentence("So `standard` is # to # % too low, # on average", low, high, -np.mean(standard), tolerance=0.051)
    assert_sentence("`fine` is # to # % too low, corrected", *spread([-error for error in fine]))
    assert_sentence("corrected it is within # % of the limit", max(map(abs, per_cent("standard", "corrected"))))
    assert_sentence("corrected within # %: the limit", max(map(abs, per_cent("fine", "corrected"))))
    pattern = {
        level: [100 * (row["limit"] / row["limit of finest run"] - 1) for row in rows if row["run"] == level]
        for level in ("standard", "fine")
    }
    below, extremes = [-np.mean(pattern["standard"])], [-value for value in spread(pattern["standard"])][::-1]
    assert_sentence("are # % below those of the finest run's on average (# to # %)", *below, *extremes, tolerance=0.06)
    extremes = [-value for value in spread(pattern["fine"])][::-1]
    assert_sentence("those of `fine` # % (# to # %)", -np.mean(pattern["fine"]), *extremes, tolerance=0.06)


def test_growth_that_would_fold_like_a_person():
    ((*rows,),) = tables("inferences", "hemisphere")
    numbers = lambda row, column: [float(text) for text in str(row[column]).split(", ")]
    by_growth = {}
    for row in rows:
        by_growth.setdefault(row["growth"], []).append(row)
    folds = {
        growth: spread([number for row in members for number in numbers(row, "folds, of each seed")])
        for growth, members in by_growth.items()
    }
    at_spreads = [number for growth in ("30 %", "20 %", "10 %") for number in folds[growth]]
    assert_sentence("correlation is # to # at 30 %, # to # at 20 % and # to # at 10 %.", *at_spreads)
    assert_sentence("Even growth has # to # and turned maps # to #, less", *folds["even"], *folds["30 %, map turned"])
    assert_sentence("had before growth (# to #).", *folds["none: unfolded"])
    assert_sentence("without growth, have # to #, which", *folds["none: sulci deepened"])
    p_of = lambda growth, who: spread(
        [
            p
            for row in by_growth[growth]
            if row["hemisphere"].startswith(who)
            for p in numbers(row, "p, more than deepened")
        ]
    )
    assert_sentence("from every seed with p of # to #, at", *p_of("30 %", "S1"), tolerance=0.006)
    assert_sentence("only some runs (# to #).", *p_of("20 %", "S1"), tolerance=0.006)
    assert_sentence("but with p of # to #: no result", *p_of("30 %", "fsaverage"), tolerance=0.006)
    assert p_of("30 %", "S1")[1] < 0.05 < p_of("20 %", "S1")[1]
    between = [
        number for growth in ("30 %", "even") for number in spread([row["between seeds"] for row in by_growth[growth]])
    ]
    assert_sentence("different seeds correlate by # to #, even ones by # to #.", *between)
    pairs = lambda column: [numbers({column: row[column].removesuffix(" %")}, column) for row in by_growth["30 %"]]
    (valleys, chance), (crests, chance_of_crests) = (
        zip(*pairs(column)) for column in ("valleys, by chance", "crests, by chance")
    )
    assert_sentence(
        "within 3 mm (# to # % and # to # % at 30 %; by chance # to # % and # to # %).",
        *(number for shares in (valleys, crests, chance, chance_of_crests) for number in spread(shares)),
    )


def test_spacing_of_folds_in_theory():
    ((*rows,),) = tables("spacing", "theory")
    by = lambda column, law, ratio, least_g=0.0: [
        row[column] for row in rows if row["law"] == law and row["ratio"] == ratio and row["g"] >= least_g
    ]
    firsts = {
        ratio: max(by("over the thickness now", law, ratio)[0] for law in ("isotropic", "tangential")) for ratio in (4,)
    }
    soft = min(by("over the thickness now", law, 0.7)[0] for law in ("isotropic", "tangential"))
    assert_sentence("from # (ratio 0.7) to # (ratio 4) at the first folds", soft, firsts[4])
    late = [row["over the thickness now"] for row in rows if row["g"] == 2.2]
    assert_sentence("down to # to # at g = 2.2.", *spread(late), tolerance=0.11)
    before = lambda *ratios: spread(
        [value for ratio in ratios for value in by("best wavelength / T", "tangential", ratio, 1.6)]
    )
    assert_sentence(
        "from g = 1.6 on: # to # at the ratios 0.7 and 1, # to # at 2, # to # at 4.",
        *before(0.7, 1),
        *before(2),
        *before(4),
        tolerance=0.11,
    )
    grown = spread([row["best wavelength / T"] for row in rows if row["law"] == "isotropic"])
    assert_sentence("the spacing grows with it, from # to #.", *grown, tolerance=0.5)


def test_waves_of_a_core_that_grows_by_its_stress():
    ((*rows,),) = tables("stress-growth", "theory")
    ends = [row["wavelength / T: simulated"] for row in rows if row["rate"] in (0, 300)]
    assert_sentence("rises from # to # T at equal stiffness, from # to # T at ratio 4:", *ends, tolerance=0.06)
    at = {(row["ratio"], row["rate"]): row["wavelength / T: simulated"] for row in rows}
    powers = [np.log(at[ratio, 300] / at[ratio, 100]) / np.log(3) for ratio in (1, 4)]
    assert_sentence("from 100 to 300 with the power # and #.", *powers, tolerance=0.006)


def test_errors_of_the_presets():
    rows = {(row["subject"], row["quantity"], row["against"]): row for row in tables("presets", "accuracy")[0]}
    error = lambda quantity, against, level: float(
        re.search(r"(-?[\d.e+]+) %", rows["fig6-thick, octant", quantity, against][level])[1]
    )
    levels = ("draft", "standard", "fine", "finest")
    index, wave = (
        [[error(f"{name}, g = {g}", "finest mesh", level) for level in levels] for g in ("2", "1.5")]
        for name in ("gyrification index", "wavelength")
    )
    own = [
        [error(f"gyrification index, g = {g}", "limit of its folds", level) for level in levels] for g in ("2", "1.5")
    ]
    assert_sentence(
        "of the four differs by #, #, # and # % (#, #, # and # % at g = 1.5)", *index[0], *index[1], tolerance=0.51
    )
    assert_sentence("wavelength by #, #, # and # % (#, #, # and # %)", *wave[0], *wave[1], tolerance=0.51)
    assert_sentence("alone the index is #, #, # and # % low (#, #, # and # %)", *own[0], *own[1], tolerance=0.11)
