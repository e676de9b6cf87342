"""What the page of all figures says: sentences that follow the numbers, each figure with its picture and its time."""

import json
from html.parser import HTMLParser

import numpy as np
import pytest

from morphofold.report.pictures.sheet import png_bytes
from morphofold.studies.paper.paper_folds import FIG7
from morphofold.studies.paper.paper_report import duration, write_paper_report
from morphofold.studies.paper.verdicts import UNFOLDED, VERDICTS
from morphofold.tables import write_table

SCENES = {1.0: "fig7-ratio1", 2.0: "fig5", 4.0: "fig7-ratio4"}
FIRST = {column.scene: column.growth[0] for column in FIG7}


def fold(T=2.0, mu=2.0, g=2.0, **more):
    numbers = {
        "scene": "x",
        "T_over_C": T / 50,
        "law": "isotropic",
        "height_rms_mm": 1.8,
        "thickness_mm": T,
        "mu_ratio": mu,
        "growth": g,
        "wavelength_mm": 9 * T,
        "theory_wavelength_mm": 8 * T,
        "film_wavelength_mm": 5 * T,
        "theory_g": 1.2,
        "theory_degree": 17.0,
        "degree": 18.0,
        "sulci": 100 / T,
        "gyral_thickness_mm": 5 * T,
        "gyrification_index": g,
        "height_skewness": -1 / mu,
        "first_contact_g": 1.25,
    }
    return {**numbers, **more}


def soft_to_stiff(skewness, **more):
    rows = [fold(mu=mu, g=FIRST[SCENES[mu]], scene=SCENES[mu], height_skewness=s) for mu, s in zip(SCENES, skewness)]
    return {"fig7.tsv": [fold(scene="fig5", g=2.0), *({**row, **more} for row in rows[::-1])]}


def line(points, surface="a", slope=1.0, low=-1.0, ratio=2.5, crests=2.9, robust=-1.0, least=None):
    return {
        "surface": surface,
        "points": points,
        "slope": slope,
        "slope_low": low,
        "intercept_mm": -0.2,
        "gyral_over_cortical": ratio,
        "gyral_over_cortical_at_crests": crests,
        "robust_slope": robust,
        "robust_low": least,
    }


def bodies(**more):
    return {"fig6.tsv": [fold(T, g=g, **more) for T in (1.0, 2.0, 3.0) for g in (1.5, 2.0)]}


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
    rows = [
        {"source": "finite elements, 3-D", "over_theory": off, "folded": 0.0},
        {"source": "finite elements, 3-D", "over_theory": -0.04, "folded": 1.0},
    ]
    return {"fig3a.tsv": rows, "fig3b.tsv": [{"source": "smooth sphere, 1-D", "over_theory": 0.003}]}


SENTENCES = [
    ("fig3", radius(1e-4), ["As in the paper", "radius within 0.01 %", "stress within 0.3 %", "up to 4 % off"]),
    ("fig3", radius(0.02), ["Not as in the paper", "radius within 2 %"]),
    ("fig3", {"fig3a.tsv": [], "fig3b.tsv": []}, ["Not as in the paper", "nan"]),
    ("fig5", {"fig5.tsv": [fold(g=g) for g in (1.25, 1.5, 2)]}, ["As in the paper", "GI is 1.25 at g = 1.25 and 2.00"]),
    ("fig5", {"fig5.tsv": [fold(g=g, gyrification_index=3 - g) for g in (1.25, 1.5, 2)]}, ["Not as in the paper"]),
    ("fig5", {"fig5.tsv": [fold(wavelength_mm=None)]}, [UNFOLDED]),
    ("fig5", {"fig5.tsv": [fold()]}, [UNFOLDED]),
    ("fig6", bodies(), ["As in the paper", "100, 50 and 33 sulci", "5.0, 10.0 and 15.0 mm", "9.0 T", "8.0 T", "5.0 T"]),
    ("fig6", bodies(sulci=7.0), ["Not as in the paper"]),
    ("fig6", bodies(wavelength_mm=None), [UNFOLDED]),
    ("fig6", bodies(gyral_thickness_mm=None), [UNFOLDED]),
    ("fig7", soft_to_stiff((-1, -0.5, -0.2)), ["As in the paper", "−1.00, −0.50 and −0.20 at ratios 1, 2 and 4"]),
    ("fig7", soft_to_stiff((-1, -0.5, -0.2)), ["1.20, 1.20 and 1.20, all before the creases"]),
    ("fig7", soft_to_stiff((-1, -0.5, -0.2), first_contact_g=1.3), ["touch 0.10, 0.10 and 0.10 of growth after"]),
    ("fig7", soft_to_stiff((-1, -0.5, -0.2), first_contact_g=None), ["come first at small ratios."]),
    ("fig7", soft_to_stiff((-1, -0.5, -0.2), theory_g=1.5), ["not all before the creases of Eq. (12) at 1.43"]),
    ("fig7", soft_to_stiff((-1, -0.5, -0.2), gyral_thickness_mm=None), ["As in the paper"]),
    ("fig7", soft_to_stiff((-1, -1.5, -0.2)), ["Not as in the paper"]),
    ("fig7", {"fig7.tsv": [fold(mu=2.0, scene="fig5", g=FIRST["fig5"])]}, [UNFOLDED]),
    (
        "fig8",
        {
            "fig8.tsv": [
                line("regions, x", low=0.5, robust=1.0, least=0.2),
                line("regions, y"),
                line("bodies", slope=2.5),
                line("crests", "T = 1 mm"),
                line("crests", "S1 lh", ratio=3.9, crests=2.8),
            ]
        },
        [
            "As in the paper",
            "W = 2.50 t − 0.2 mm",
            "in 1 of 2 fits",
            "confidence in 1 (by least squares 2 and 1)",
            "confidence in 0 of 2",
            "2.9 times as wide",
            "2.8 times in a person",
            "2.5 and 3.9 times",
        ],
    ),
    (
        "fig8",
        {"fig8.tsv": [line("bodies", slope=-1), line("crests", "T = 1 mm"), line("crests", "S1 lh")]},
        ["Not as in the paper"],
    ),
    ("fig8", {"fig8.tsv": [line("bodies"), line("crests", "T = 1 mm", crests=None)]}, [UNFOLDED]),
    ("fig9", hinges("No closer.", 0.001), ["No closer.", "0.190 and 0.240", "shapes differ"]),
    ("fig9", hinges("Closer.", 0.4), ["Closer.", "do not differ significantly", "190°", "170°"]),
]


@pytest.mark.parametrize(("figure", "tables", "words"), SENTENCES)
def test_a_sentence_follows_the_numbers(figure, tables, words):
    sentence = VERDICTS[figure](tables)
    for word in words:
        assert word in sentence


class Page(HTMLParser):
    def __init__(self, text):
        super().__init__()
        self.tags = []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))


def test_a_page_has_each_figure_with_its_sentence_picture_and_time(tmp_path):
    points = (("isotropic", 1e-3, 1.34), ("isotropic", 0.04, 1.43), ("tangential", 0.04, 1.38))
    rows = [{"source": "theory", "law": law, "T_over_C": T, "g_crease": g, "reason": None} for law, T, g in points]
    write_table(tmp_path / "fig4.tsv", list(rows[0]), rows)
    (tmp_path / "fig4.png").write_bytes(png_bytes(np.full((40, 60, 3), 90, dtype=np.uint8)))
    simulation = {
        "folder": "simulations/x",
        "level": "draft",
        "elements": 8250,
        "steps": 600,
        "seconds": 300.0,
        "healthy": False,
        "warnings": ["<hot>"],
        "scene": "x",
    }
    entry = {
        "files": ["fig4.png", "fig4.tsv"],
        "shows": "<b>creases",
        "seconds": 3.4,
        "simulations": [simulation, simulation],
    }
    index = {"morphofold": "1", "lengths": "mm", "figures": {"fig4": json.loads(json.dumps(entry))}}
    text = write_paper_report(tmp_path, index).read_text(encoding="utf-8")
    tags = Page(text).tags
    assert "A thin cortex can crease from g = 1.34 on" in text
    assert "from 1.43 if growth is isotropic, from 1.38 if tangential" in text
    assert "Measured and drawn in 3 s" in text
    assert "1 simulation, 5 min" in text  # the same one twice
    assert "not healthy: &lt;hot&gt;" in text
    assert "<b>creases" not in text
    (picture,) = [attrs for tag, attrs in tags if tag == "img"]
    assert picture["src"].startswith("data:image/png;base64,")
    assert not [attrs for tag, attrs in tags if tag == "script" or str(attrs.get("href", "#"))[:4] == "http"]


def test_a_figure_of_an_earlier_version_is_told(tmp_path):
    write_table(tmp_path / "fig4.tsv", ["other"], [{"other": 1.0}])
    index = {"morphofold": "1", "lengths": "mm", "figures": {"fig4": {"files": ["fig4.tsv"], "shows": "s"}}}
    assert "whose tables lack &#39;law&#39;; draw it again." in write_paper_report(tmp_path, index).read_text()


def test_times_are_in_words():
    assert [duration(s) for s in (0.4, 59.6, 3230)] == ["0 s", "60 s", "54 min"]
