"""The table of inferred growth: a row for each kind of body, means over seeds, and what could not be grown."""

from morphofold.studies.person.inferences import draw, rows_of, summary_of


def run(spread, folds, turned=0, healthy=1):
    bands = {"folds_7_11": folds, "folds_12_16": folds / 2, "folds_17_22": 0.1, "folds_23_30": -0.1}
    lines = {"valleys": 0.4, "valleys_by_chance": 0.3, "crests": 0.5, "crests_by_chance": 0.35}
    own = {"spread": spread, "turned": turned, "folds": folds, "healthy": healthy, "gyrification_index": 1.5}
    return own | bands | lines | {"p_above_deepened": 0.024}


RESULTS = {
    "subject": "bert",
    "hemi": "lh",
    "controls": {"before growth": 0.3, "sulci deepened": 0.4},
    "between_seeds": {"0": 0.2, "0.3": 0.9},
    "not_grown": ["spread30-seed3"],
    "runs": [run(0, 0.1), run(0, 0.3), run(0.3, 0.5), run(0.3, 0.7), run(0.3, 0.0, turned=1, healthy=0)],
}


def test_bodies_of_a_kind_are_one_row_with_their_means_and_every_seeds_number(tmp_path):
    rows = rows_of(RESULTS)
    assert [row[1:3] for row in rows] == [
        ["none: unfolded", "0.30"],
        ["none: sulci deepened", "0.40"],
        ["even", "0.10, 0.30"],
        ["30 %", "0.50, 0.70"],
        ["30 %, map turned", "0.00"],
    ]
    assert rows[3][3:8] == ["0.024, 0.024", "0.60, 0.30, 0.10, −0.10", "0.90", "40, 30 %", "50, 35 %"]
    assert rows[4][5] == ""  # turned maps are not of one place
    assert summary_of([RESULTS, RESULTS]).startswith("10 runs, 8 of them within all limits of the solver; 2 more")
    draw([RESULTS], tmp_path / "curve.png")
    assert (tmp_path / "curve.png").stat().st_size > 5000
