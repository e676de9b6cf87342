"""The table of inferred growth: a row for each kind of body, means over seeds, and what could not be grown."""

import json

from morphofold.studies.person.inferences import draw, main, rows_of, summary_of


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


def test_the_page_has_a_few_rows_of_the_first_hemisphere_and_the_table_beside_it_all(tmp_path):
    folders = []
    for hemi in ("lh", "rh"):
        folders.append(tmp_path / hemi)
        (folders[-1] / "result").mkdir(parents=True)
        results = {**RESULTS, "hemi": hemi, "runs": [*RESULTS["runs"], run(0.1, 0.3)]}
        (folders[-1] / "result" / "inference.json").write_text(json.dumps(results))
    page = tmp_path / "person.md"
    page.write_text("above\n<!-- inferences -->\n<!-- /inferences -->\nbelow\n")
    main(page, folders)
    text = page.read_text("utf-8")
    shown = [line.split(" | ")[:2] for line in text.splitlines() if line.startswith("| bert")]
    assert shown == [["| bert lh", growth] for growth in ("none: sulci deepened", "even", "30 %", "30 %, map turned")]
    assert "All 12 rows: [person-inferences.tsv](person-inferences.tsv)." in text
    assert "12 runs, 10 of them within all limits" in text
    lines = (tmp_path / "person-inferences.tsv").read_text("utf-8").splitlines()
    assert [line.split("\t")[0] for line in lines] == ["hemisphere", *["bert lh"] * 6, *["bert rh"] * 6]
    assert (tmp_path / "inferences.png").is_file()
