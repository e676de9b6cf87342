"""The study of accuracy: fronts and power laws of made-up points, cases done once, tables, and the page."""

import json
from dataclasses import replace

import numpy as np
import pytest

import morphofold.sim
from morphofold.errors import DamagedFile, MissingPart, NotFinite, OutOfRange
from morphofold.studies.accuracy import accuracy_study
from morphofold.studies.accuracy.accuracy_page import PART_MAKERS, read_study, write_page
from morphofold.studies.accuracy.accuracy_report import expected_errors, write_study
from morphofold.studies.accuracy.accuracy_study import Cases, circumstances
from morphofold.studies.accuracy.accuracy_tables import budget_rows, law_rows, peer_rows, point_rows, preset_rows
from morphofold.studies.accuracy.error_points import OUR_CODE, POINT_FIELDS, Case, Point
from morphofold.studies.accuracy.folds_by_mesh import OWN_LIMIT
from morphofold.studies.accuracy.time_error_fronts import better_than, halving, law
from morphofold.studies.bench import main as bench

EDGES = (1.2, 0.8, 0.6, 0.45, 0.27)
PRESETS = {0.6: "draft", 0.45: "standard", 0.27: "fine"}
SIZES = (2_562, 10_242, 40_962)


def point(seconds, error, **others):
    made = Point("solver", "a body", "radius", error, "theory", "mesh", "h", 1.0, 100, seconds, seconds, seconds)
    return replace(made, **others)


def solver_point(edge, quantity="radius", against="theory", error=None, **others):
    """Time goes with the edge to the power of -4, the error with that of 2 unless it is given."""
    mesh = {"setting": f"h = {edge:.2f} T", "value": edge, "size": round(1e3 / edge**2)}
    fields = {
        "subject": "fig6-thick, octant",
        "quantity": quantity,
        "against": against,
        "preset": PRESETS.get(edge, ""),
    }
    return point(10 / edge**4, 0.01 * edge**2 if error is None else error, **(fields | mesh | others))


def measuring_point(n, method=OUR_CODE, seconds=None, error=None, **others):
    """Time is proportional to the number of vertices, the error inversely, unless they are given."""
    seconds, error = 1e-5 * n if seconds is None else seconds, 50.0 / n if error is None else error
    fields = {"half": "measuring", "subject": "bumpy sphere", "quantity": "mean curvature", "against": "exact"}
    mesh = {"setting": f"{n:,} vertices", "value": n**-0.5, "size": n, "repeats": 5, "method": method}
    return point(seconds, error, **(fields | mesh | {"fastest": 0.9 * seconds, "slowest": 1.2 * seconds} | others))


@pytest.fixture
def points():
    folded = [solver_point(e, "gyrification index, g = 2", OWN_LIMIT, 0.05 * e**1.5) for e in EDGES]
    limits = [
        solver_point(0.45, f"{quantity}, g = 2", against, error, axis=axis, value=value)
        for quantity, against, error, axis, value in (
            ("wavelength", "6 elements through the cortex", 0.02, "layers", 3),
            ("gyrification index", "6 elements through the cortex", 0.03, "layers", 3),
            ("gyrification index", "pace 0.25", 0.04, "pace", 1),
            ("gyrification index", "kappa/mu = 200", 0.5, "kappa", 50),
        )
    ]
    ours = [measuring_point(n) for n in SIZES]
    peers = [measuring_point(n, "libigl", 2e-5 * n, 200 / n) for n in SIZES]
    return [*(solver_point(e) for e in EDGES), *folded, *limits, *ours, *peers]


# fronts, power laws, what half an error costs -----------------------------------------------------------------


def test_what_nothing_beats_is_the_front():
    cheap, middle, dear = point(1, 0.3), point(2, 0.2), point(4, 0.1)
    slow, wrong = point(3, 0.2), point(2, 0.25)
    assert better_than([cheap, slow, middle, wrong, dear]) == [None, middle, None, middle, None]


@pytest.mark.parametrize(
    ("own", "others", "beaten"),
    [
        ((1, 0.1), [(0.8, 0.1), (0.9, 0.097)], False),  # a little faster or truer
        ((1, 0.1), [(0.7, 0.1)], True),
        ((1, 0.1), [(0.9, 0.09)], True),
        ((2, 0.1), [(1, 0.101)], True),  # half the time for a hair less accuracy
        ((2, 0.1), [(1, 0.11)], False),
    ],
)
def test_only_what_is_clearly_faster_or_truer_dominates(own, others, beaten):
    assert (better_than([point(*own), *(point(*other) for other in others)])[0] is not None) == beaten


@pytest.mark.parametrize("power", [-3.0, 0.5, 2.0])
def test_a_power_law_is_recovered_exactly(power):
    x = np.array([0.2, 0.5, 1.0, 3.0])
    fit = law(x, 7.0 * x**power)
    assert (fit.power, fit.coefficient) == (pytest.approx(power, abs=1e-6), pytest.approx(7.0, rel=1e-6))
    assert fit.uncertainty < 1e-5
    assert fit.at(2.0) == pytest.approx(7.0 * 2.0**power)


def test_the_interval_of_the_power_holds_the_true_one_in_95_of_100_cases(rng):
    x = np.geomspace(0.3, 1.2, 6)
    fits = [law(x, 2.0 * x**1.7 * np.exp(0.2 * rng.standard_normal(6))) for _ in range(400)]
    assert 0.91 < np.mean([abs(fit.power - 1.7) < fit.uncertainty for fit in fits]) < 0.985


@pytest.mark.parametrize(
    ("x", "y"), [([1, 2], [1, 2]), ([1, 1, 1], [1, 2, 3]), ([1, 2, 3], [1, 0, 2]), ([1, 2, 3], [1, np.nan, 2])]
)
def test_no_law_is_drawn_through_too_little(x, y):
    with pytest.raises(OutOfRange):
        law(x, y)


def test_half_the_error_takes_a_power_of_two_of_the_time(rng):
    """Of a method of second order in three dimensions and time four times; without bound the interval is large; an
    error that does not fall has no price."""
    x = np.array([0.25, 0.5, 1.0])
    price = halving(law(x, 10 * x**-4.0), law(x, 0.1 * x**2.0))
    assert (price.factor, price.low, price.high) == pytest.approx((4, 4, 4), rel=1e-3)
    error = law(x, x)
    price = halving(law(x, x**-3.0), replace(error, uncertainty=0.9999 * error.power))
    assert price.factor == pytest.approx(8.0)
    assert 1e100 < price.high < np.inf
    assert halving(law(x, x**-3.0), law(x, 0.1 * np.exp(0.5 * rng.standard_normal(3)))) is None


def test_a_point_survives_being_written_as_a_row():
    preset = point(1.5, 0.25, preset="draft")
    assert tuple(preset.as_row()) == POINT_FIELDS
    assert Point.from_row(preset.as_row()) == preset
    with pytest.raises(DamagedFile, match=r"\bsubject\b"):
        Point.from_row({"half": "solver"})


# cases, each done once ----------------------------------------------------------------------------------------


def test_a_case_is_done_once_for_each_machine_and_gives_the_same_points_when_read_again(tmp_path):
    calls = []

    def work():
        calls.append(1)
        return [measuring_point(1000)]

    for made in (circumstances(), circumstances(), {"processor": "another"}):
        assert Cases(tmp_path, made).points(Case("one", work)) == [measuring_point(1000)]
    assert len(calls) == 2


@pytest.mark.parametrize(
    "text",
    [
        "",
        '{"points": 5}',
        '{"points": [{}]}',
        json.dumps({"points": [{**measuring_point(1000).as_row(), "size": "many"}]}),
        json.dumps({"points": [{**measuring_point(1000).as_row(), "seconds": None}]}),
    ],
)
def test_a_damaged_case_is_refused_with_its_name(tmp_path, text):
    cases = Cases(tmp_path, {})
    (cases.folder / "one.json").write_text(text)
    with pytest.raises(ValueError, match=str(cases.folder / "one.json")):
        cases.points(Case("one", lambda: pytest.fail("done anew")))


@pytest.mark.parametrize(("error", "raised"), [(lambda: 1 // 0, ZeroDivisionError), (lambda: np.nan, NotFinite)])
def test_a_case_that_fails_or_has_no_number_leaves_nothing_and_is_tried_again(tmp_path, error, raised):
    cases = Cases(tmp_path, {})
    with pytest.raises(raised):
        cases.points(Case("one", lambda: [measuring_point(1000, error=error())]))
    assert not list(cases.folder.iterdir())
    assert cases.points(Case("one", lambda: [measuring_point(1000)]))


def test_a_peer_that_failed_is_shown_and_takes_no_part(tmp_path, points):
    nothing = dict.fromkeys(("error", "seconds", "fastest", "slowest"), np.nan)
    failed = replace(measuring_point(10_242, "a peer"), **nothing, repeats=0, setting="did not come to an end")
    (again,) = Cases(tmp_path, {}).points(Case("one", lambda: [failed]))
    assert again.repeats == 0
    assert np.isnan(again.error)
    rows = peer_rows([*points, again])
    assert [row["setting"] for row in rows if row["method"] == "a peer"] == ["did not come to an end"]
    assert [row["method"] for row in point_rows([*points, again])].count("a peer") == 0
    assert law_rows([*points, again]) == law_rows(points)


def test_cases_of_other_code_are_done_anew(tmp_path, monkeypatch):
    digests = {circumstances()["code"]}
    assert digests == {circumstances()["code"]}
    package = tmp_path / "sim"
    package.mkdir()
    (package / "__init__.py").write_text("")
    monkeypatch.setattr(morphofold.sim, "__file__", str(package / "__init__.py"))
    for step in (1, 2):
        (package / "steps.py").write_text(f"STEP = {step}")
        digests.add(circumstances()["code"])
    assert len(digests) == 3


# tables -------------------------------------------------------------------------------------------------------


def test_a_dominated_point_says_by_what(points):
    rows = {(row["quantity"], row["method"], row["size"]): row for row in point_rows(points)}
    assert rows["mean curvature", OUR_CODE, 40_962]["front"]
    beaten = rows["mean curvature", "libigl", 10_242]
    assert not beaten["front"]
    assert beaten["dominated_by"] == "morphofold: mesh, 10,242 vertices"


def test_laws_are_those_that_the_points_were_made_by(points):
    rows = {(row["quantity"], row["method"]): row for row in law_rows(points)}
    radius, gi, curvature = (rows[name, OUR_CODE] for name in ("radius", "gyrification index, g = 2", "mean curvature"))
    assert radius["seconds_power"] == pytest.approx(-4)
    assert radius["error_power"] == pytest.approx(2)
    assert radius["half_the_error"] == pytest.approx(4)
    assert gi["error_power"] == pytest.approx(1.5, abs=1e-3)
    assert curvature["error_power"] == pytest.approx(2)  # of the edge, for 1/n in vertices
    assert curvature["half_the_error"] == pytest.approx(2, rel=1e-4)


def test_peers_are_compared_with_us_on_the_same_mesh(points):
    rows = peer_rows(points)
    assert {row["size"] for row in rows} == set(SIZES)
    assert all(row["seconds_ratio"] == pytest.approx(2) and row["error_ratio"] == pytest.approx(4) for row in rows)
    assert not peer_rows([p for p in points if p.method == OUR_CODE])


def test_presets_have_their_measured_error_and_that_of_the_law(points):
    rows = {(row["preset"], row["quantity"]): row for row in preset_rows(points)}
    assert rows["standard", "radius"]["error"] == pytest.approx(0.01 * 0.45**2)
    assert rows["draft", "gyrification index, g = 2"]["error_by_law"] == pytest.approx(0.05 * 0.6**1.5, rel=1e-2)
    assert ("standard", "wavelength, g = 2") not in rows  # of another axis
    errors = {row["quantity"]: row["error"] for row in budget_rows(points) if row["axis"] == "layers"}
    assert errors == {"wavelength, g = 2": 0.02, "gyrification index, g = 2": 0.03}


def test_a_forecast_gets_the_laws(points):
    errors = expected_errors(points)["quantities"]
    assert errors["radius"]["coefficient"] == pytest.approx(0.01)
    assert errors["gyrification index"]["power"] == pytest.approx(1.5, abs=1e-3)
    assert (errors["radius"]["finest"], errors["radius"]["coarsest"]) == (0.27, 1.2)
    assert errors["gyrification index"]["other"] == pytest.approx(0.05)  # layers and pace; kappa/mu is the body's own
    assert errors["radius"]["other"] == 0
    assert expected_errors([p for p in points if p.half == "measuring"]) is None


def test_a_forecast_of_an_analysis_gets_the_errors_of_the_persons_presets(points):
    def person(preset, quantity, error, subject="S1", n=150_000):
        return measuring_point(
            n, error=error, subject=subject, quantity=quantity, preset=preset, against="split surface"
        )

    points += [
        person("draft", "hinges", 0.03),
        person("standard", "hinges", 0.02),
        person("fine", "hinges", 0.01),
        person("standard", "mean curvature", 0.05, "S1, pial"),
        person("standard", "mean curvature", 0.9, "S1, white"),
        person("standard", "crest length", 0.01),
        person("fine", "crest length", 0.02),  # by chance
        person("", "hinges", 0.8),
        person("standard", "hinges", 0.4, "S1 at 10,000 vertices", 10_001),
    ]
    whole, thinned = expected_errors(points)["measuring"]
    assert (whole["subject"], whole["vertices"], thinned["vertices"]) == ("S1", 150_000, 10_001)
    assert whole["quantities"] == {
        "crest length": {"against": "split surface", "draft": 0.02, "standard": 0.02, "fine": 0.02},
        "hinges": {"against": "split surface", "draft": 0.03, "standard": 0.02, "fine": 0.01},
        "mean curvature": {"against": "split surface", "draft": 0.05, "standard": 0.05, "fine": 0.05},
    }
    assert thinned["quantities"]["hinges"]["fine"] == 0.4


# the folder, the page, the command ----------------------------------------------------------------------------


@pytest.fixture
def study(points, tmp_path):
    out = tmp_path / "accuracy"
    out.mkdir()
    write_study(points, circumstances(), out)
    return out


@pytest.fixture
def page(tmp_path):
    page = tmp_path / "accuracy.md"
    page.write_text("# Accuracy\n\n" + "\n".join(f"<!-- {name} -->\n<!-- /{name} -->\n" for name in PART_MAKERS))
    return page


def test_a_study_writes_what_its_summary_says(study):
    summary, tables = read_study(study)
    assert summary["left_out"] == {}
    assert all((study / name).stat().st_size > 0 for name in summary["files"])
    assert {"points.tsv", "figures/overview.png", "figures/solver.png"} <= set(summary["files"])
    assert len(tables["points"]) == 20
    assert sum(row["front"] for row in tables["points"]) == 17  # the three of the peer are beaten


def test_a_study_of_one_half_says_what_it_lacks_and_makes_no_page(points, page, tmp_path):
    write_study([p for p in points if p.half == "measuring" and p.method == OUR_CODE], circumstances(), tmp_path)
    summary, _ = read_study(tmp_path)
    assert summary["left_out"].keys() == {"presets", "budget", "peers"}
    assert summary["errors"] is None
    assert "figures/overview.png" not in summary["files"]
    before = page.read_text()
    with pytest.raises(MissingPart, match=f"{tmp_path}: "):
        write_page(tmp_path, page)
    assert page.read_text() == before


def test_a_page_takes_its_parts_and_pictures_from_the_study(study, page, tmp_path):
    table = tmp_path / "table.json"
    table.write_text('{"costs": {"a": 1}, "errors": {"quantities": {}}}')
    write_page(study, page, table=table)
    text = page.read_text()
    laws, peers = ((tmp_path / f"accuracy-{name}.tsv").read_text("utf-8") for name in ("laws", "peers"))
    cells = ["solver", "fig6-thick, octant", "radius", "theory", "mesh", "−4.00 ± 0.00", "2.00 ± 0.00", "4 (4 to 4)"]
    assert "\t".join(cells) in laws
    assert "libigl" in peers
    assert (tmp_path / "accuracy-overview.png").read_bytes() == (study / "figures" / "overview.png").read_bytes()
    written = json.loads(table.read_text())
    assert written["costs"] == {"a": 1}
    assert written["errors"]["quantities"]["radius"]["power"] == pytest.approx(2)
    write_page(study, page)
    assert page.read_text() == text  # the same study gives the same page


def test_the_command_writes_a_study_and_does_no_case_twice(tmp_path, monkeypatch, capsys, points):
    def some(halves, cases, show):
        return [p for k, made in enumerate(points) for p in cases.points(Case(f"case-{k}", lambda made=made: [made]))]

    monkeypatch.setattr(accuracy_study, "all_points", some)
    out = tmp_path / "accuracy"
    assert bench(["accuracy", "-o", str(out), "-q"]) == 0
    assert "half the error takes 4" in capsys.readouterr().out
    times = {case.name: case.stat().st_mtime_ns for case in (out / "cases").rglob("*.json")}
    assert len(times) == len(points)
    assert bench(["accuracy", "-o", str(out), "-q", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["halves"] == ["measuring", "solver"]
    assert {case.name: case.stat().st_mtime_ns for case in (out / "cases").rglob("*.json")} == times
