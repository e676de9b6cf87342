"""The study of accuracy: cases are done once, tables say what the points hold, pages take them between marks."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest

import morphofold.sim
from morphofold.errors import MissingPart, NotFinite
from morphofold.studies.accuracy import accuracy_study as study_module
from morphofold.studies.accuracy.accuracy_bodies import FINEST
from morphofold.studies.accuracy.accuracy_folds import MESH, grown
from morphofold.studies.accuracy.accuracy_page import PARTS, read_study, text_answers, write_page
from morphofold.studies.accuracy.accuracy_page import main as write
from morphofold.studies.accuracy.accuracy_report import SHOWS, expected_errors, write_study
from morphofold.studies.accuracy.accuracy_study import Kept, circumstances
from morphofold.studies.accuracy.accuracy_tables import budget_rows, law_rows, peer_rows, point_rows, preset_rows
from morphofold.studies.accuracy.points import OURS, Case, Point
from morphofold.studies.bench import main

pytestmark = pytest.mark.slow  # studies are not shipped: run them when they change

EDGES = (1.2, 0.8, 0.6, 0.45, 0.27)
PRESETS = {0.6: "draft", 0.45: "standard", 0.27: "fine"}


def solver_point(edge, quantity="radius", against="theory", error=None, axis="mesh", **others):
    seconds = 10 * edge**-4.0
    made = Point(
        "solver",
        "fig6-thick, octant",
        quantity,
        0.01 * edge**2.0 if error is None else error,
        against,
        axis,
        f"h = {edge:.2f} T",
        edge,
        round(1000 * edge**-2),
        seconds,
        seconds,
        seconds,
        preset=PRESETS.get(edge, ""),
    )
    return replace(made, **others)


def measuring_point(n, method=OURS, seconds=None, error=None, **others):
    seconds = 1e-5 * n if seconds is None else seconds
    made = Point(
        "measuring",
        "bumpy sphere",
        "mean curvature",
        50.0 / n if error is None else error,
        "exact",
        "mesh",
        f"{n:,} vertices",
        n**-0.5,
        n,
        seconds,
        0.9 * seconds,
        1.2 * seconds,
        5,
        method,
    )
    return replace(made, **others)


@pytest.fixture
def points():
    folded = [solver_point(e, "gyrification index, g = 2", MESH, 0.05 * e**1.5) for e in EDGES]
    layers = [
        solver_point(0.45, f"{what}, g = 2", "6 elements through the cortex", error, axis="layers", value=3)
        for what, error in (("wavelength", 0.02), ("gyrification index", 0.03))
    ]
    layers += [solver_point(0.45, "gyrification index, g = 2", "pace 0.25", 0.04, axis="pace", value=1)]
    layers += [solver_point(0.45, "gyrification index, g = 2", "kappa/mu = 200", 0.5, axis="kappa", value=50)]
    sizes = (2_562, 10_242, 40_962)
    ours = [measuring_point(n) for n in sizes]
    peers = [measuring_point(n, "libigl", 2e-5 * n, 200 / n) for n in sizes]
    return [*(solver_point(e) for e in EDGES), *folded, *layers, *ours, *peers]


def test_a_case_is_done_once_and_gives_the_same_points_when_read_again(tmp_path):
    calls = []

    def work():
        calls.append(1)
        return [measuring_point(1000)]

    made = circumstances()
    first = Kept(tmp_path, made).points(Case("one", work))
    again = Kept(tmp_path, made).points(Case("one", work))
    assert first == again == [measuring_point(1000)]
    assert len(calls) == 1


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        '{"points": 5}',
        '{"points": [{}]}',
        '{"points": [{"half": 5}]}',
        '{"points": [{"brain": "x"}]}',
        json.dumps({"points": [{**measuring_point(1000).as_row(), "size": "many"}]}),
        json.dumps({"points": [{**measuring_point(1000).as_row(), "seconds": None}]}),
        json.dumps({"points": [{**measuring_point(1000).as_row(), "half": None}]}),
        "[" * 10**5,
    ],
)
def test_a_damaged_case_is_refused_with_its_name(tmp_path, text):
    kept = Kept(tmp_path, {})
    (kept.folder / "one.json").write_text(text)
    with pytest.raises(ValueError, match=str(kept.folder / "one.json")):
        kept.points(Case("one", lambda: pytest.fail("done anew")))


@pytest.mark.parametrize("content", [b"", b"x" * 100, b"PK\x05\x06" + bytes(18)])
def test_damaged_folds_are_refused_with_their_name(tmp_path, content):
    (tmp_path / "folds.npz").write_bytes(content)
    with pytest.raises(ValueError, match=str(tmp_path / "folds.npz")):
        grown(FINEST, tmp_path / "folds.npz")


def test_a_case_of_another_machine_is_done_anew(tmp_path):
    cwd, there = {"processor": "a"}, {"processor": "b"}
    one, other = (
        Kept(tmp_path, made).points(Case("one", lambda n=n: [measuring_point(n)]))[0]
        for made, n in ((cwd, 1000), (there, 2000))
    )
    assert (one.size, other.size) == (1000, 2000)


def test_another_version_of_a_peer_and_other_code_are_other_circumstances(monkeypatch):
    made = circumstances()
    assert made.keys() >= set(study_module.PEERS)
    monkeypatch.setattr(study_module, "version", lambda package: "0.0")
    assert {name for name, value in circumstances().items() if value != made[name]} >= {*study_module.PEERS, "scipy"}


def test_a_case_that_fails_leaves_nothing_and_is_tried_again(tmp_path):
    kept = Kept(tmp_path, {})
    with pytest.raises(ZeroDivisionError):
        kept.points(Case("one", lambda: [measuring_point(1 // 0)]))
    assert not list(kept.folder.iterdir())
    assert kept.points(Case("one", lambda: [measuring_point(1000)]))


def test_numbers_that_are_none_are_refused_and_not_kept(tmp_path):
    kept = Kept(tmp_path, {})
    with pytest.raises(NotFinite, match=r"bumpy sphere, mean curvature, morphofold.* nan\b"):
        kept.points(Case("one", lambda: [measuring_point(1000, error=np.nan)]))
    assert not list(kept.folder.iterdir())


def failed(n=10_242, method="a peer", why="did not come to an end"):
    none = dict.fromkeys(("error", "seconds", "fastest", "slowest"), np.nan)
    return replace(measuring_point(n, method), **none, repeats=0, setting=why)


def test_a_peer_that_failed_is_told_and_takes_no_part(tmp_path, points):
    (again,) = Kept(tmp_path, {}).points(Case("one", lambda: [failed()]))
    assert again.repeats == 0
    assert np.isnan(again.error)
    rows = peer_rows([*points, again])
    assert [row["setting"] for row in rows if row["method"] == "a peer"] == ["did not come to an end"]
    assert [row["method"] for row in point_rows([*points, again])].count("a peer") == 0
    assert law_rows([*points, again]) == law_rows(points)


def test_circumstances_name_what_times_depend_on():
    found = circumstances()
    assert {"processor", "threads", "numba", "morphofold"} <= found.keys()
    assert found["processor"]


def test_cases_of_other_code_are_done_anew(tmp_path, monkeypatch):
    before = circumstances()["code"]
    assert circumstances()["code"] == before
    package = tmp_path / "sim"
    package.mkdir()
    (package / "__init__.py").write_text("")
    (package / "steps.py").write_text("STEP = 1")
    monkeypatch.setattr(morphofold.sim, "__file__", str(package / "__init__.py"))
    one = circumstances()["code"]
    (package / "steps.py").write_text("STEP = 2")
    assert len({before, one, circumstances()["code"]}) == 3


def test_progress_of_both_halves_is_one_and_never_falls(monkeypatch, tmp_path):
    shares = []

    def half(kept, show):
        for share in (0.0, 0.5, 1.0):
            show(share, "a case")
        return []

    for name in ("_measuring", "_solver"):
        monkeypatch.setattr(study_module, name, half)
    study_module.all_points(("solver", "measuring"), Kept(tmp_path, {}), lambda share, words: shares.append(share))
    assert shares == sorted(shares)
    assert (shares[0], shares[-1]) == (0.0, pytest.approx(1.0))


def test_dominated_points_say_by_what(points):
    rows = {(row["quantity"], row["method"], row["size"]): row for row in point_rows(points)}
    assert rows["mean curvature", OURS, 40_962]["front"]
    beaten = rows["mean curvature", "libigl", 10_242]
    assert not beaten["front"]
    assert beaten["dominated_by"] == "morphofold: mesh, 10,242 vertices"


def test_laws_are_those_that_the_points_were_made_by(points):
    rows = {(row["quantity"], row["method"]): row for row in law_rows(points)}
    radius, gi, curvature = (
        rows[key] for key in (("radius", OURS), ("gyrification index, g = 2", OURS), ("mean curvature", OURS))
    )
    assert radius["seconds_power"] == pytest.approx(-4)
    assert radius["error_power"] == pytest.approx(2)
    assert radius["half_the_error"] == pytest.approx(4)
    assert gi["error_power"] == pytest.approx(1.5, abs=1e-3)
    assert curvature["error_power"] == pytest.approx(2)  # of the edge, for 1/n in vertices
    assert curvature["half_the_error"] == pytest.approx(2, rel=1e-4)


def test_peers_stand_beside_us_on_the_same_mesh(points):
    rows = peer_rows(points)
    assert {row["size"] for row in rows} == {2_562, 10_242, 40_962}
    assert all(row["seconds_ratio"] == pytest.approx(2) and row["error_ratio"] == pytest.approx(4) for row in rows)
    assert not peer_rows([p for p in points if p.method == OURS])


def test_presets_carry_their_measured_error_and_that_of_the_law(points):
    rows = {(row["preset"], row["quantity"]): row for row in preset_rows(points)}
    assert rows["standard", "radius"]["error"] == pytest.approx(0.01 * 0.45**2)
    assert rows["draft", "gyrification index, g = 2"]["error_by_law"] == pytest.approx(0.05 * 0.6**1.5, rel=1e-2)
    assert ("standard", "wavelength, g = 2") not in rows  # of another axis


def test_the_error_of_standard_is_told_axis_by_axis(points):
    rows = [row for row in budget_rows(points) if row["axis"] == "layers"]
    assert {(row["quantity"], row["against"]): row["error"] for row in rows} == {
        ("wavelength, g = 2", "6 elements through the cortex"): 0.02,
        ("gyrification index, g = 2", "6 elements through the cortex"): 0.03,
    }


def test_a_forecast_is_given_the_laws(points):
    errors = expected_errors(points)["quantities"]
    assert errors["radius"]["coefficient"] == pytest.approx(0.01)
    assert errors["gyrification index"]["power"] == pytest.approx(1.5, abs=1e-3)
    assert (errors["radius"]["finest"], errors["radius"]["coarsest"]) == (0.27, 1.2)
    assert errors["gyrification index"]["other"] == pytest.approx(0.05)  # layers and pace; kappa/mu is the body's own
    assert errors["radius"]["other"] == 0
    assert expected_errors([p for p in points if p.half == "measuring"]) is None


def test_a_forecast_gives_no_larger_error_to_a_finer_mesh(points):
    rising = [replace(p, error=0.001 / p.value) if p.quantity == "radius" else p for p in points]
    law = expected_errors(rising)["quantities"]["radius"]
    assert law["power"] == 0
    edges = np.array([p.value for p in rising if p.quantity == "radius"])
    assert law["coefficient"] == pytest.approx(np.exp(np.mean(np.log(0.001 / edges))))


def test_a_forecast_of_an_analysis_is_given_the_errors_of_the_persons_presets(points):
    made = next(p for p in points if p.half == "measuring")
    person = lambda preset, quantity, error, subject="S1", n=150_000: replace(
        made, subject=subject, quantity=quantity, error=error, preset=preset, size=n, against="split surface"
    )
    points = [
        *points,
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


@pytest.fixture
def study(points, tmp_path):
    out = tmp_path / "accuracy"
    out.mkdir()
    write_study(points, circumstances(), out)
    return out


def test_a_study_writes_what_its_summary_says(study):
    summary, tables = read_study(study)
    assert summary["left_out"] == {}
    assert all((study / name).stat().st_size > 0 for name in summary["files"])
    assert {"points.tsv", "figures/overview.png", "figures/solver.png"} <= set(summary["files"])
    assert len(tables["points"]) == 20
    assert sum(row["front"] for row in tables["points"]) == 17  # the three of the peer are beaten


def test_a_study_of_one_half_says_what_it_lacks(points, tmp_path):
    write_study([p for p in points if p.half == "measuring" and p.method == OURS], circumstances(), tmp_path)
    summary, _ = read_study(tmp_path)
    assert summary["left_out"].keys() == {"presets", "budget", "peers"}
    assert summary["errors"] is None
    assert "figures/overview.png" not in summary["files"]


def test_the_answer_is_told_in_words(study):
    assert "fig6-thick, octant, radius, mesh: half the error takes 4 (4 to 4) times as long" in text_answers(study)


@pytest.fixture
def page(tmp_path):
    page = tmp_path / "accuracy.md"
    page.write_text("# Accuracy\n\n" + "\n".join(f"<!-- {name} -->\n<!-- /{name} -->\n" for name in PARTS))
    return page


def test_a_page_takes_its_parts_and_pictures_from_the_study(study, page, tmp_path):
    table = tmp_path / "table.json"
    table.write_text('{"costs": {"a": 1}, "errors": {"quantities": {}}}')
    assert write([str(study), str(page), "--table", str(table)]) == 0
    text = page.read_text()
    assert "| solver | fig6-thick, octant | radius | theory | mesh | −4.00 ± 0.00 | 2.00 ± 0.00 | 4 (4 to 4) |" in text
    assert "libigl" in text
    assert (tmp_path / "accuracy-overview.png").read_bytes() == (study / "figures" / "overview.png").read_bytes()
    written = json.loads(table.read_text())
    assert written["costs"] == {"a": 1}
    assert written["errors"]["quantities"]["radius"]["power"] == pytest.approx(2)
    assert written["errors"]["quantities"].keys() >= {"radius"}
    before = text
    write_page(study, page)
    assert page.read_text() == before  # the same study gives the same page


def test_a_page_without_a_mark_is_left_alone(study, page, capsys):
    page.write_text(page.read_text().replace("<!-- peers -->", ""))
    before = page.read_text()
    assert write([str(study), str(page)]) == 2
    assert f"{page}: " in capsys.readouterr().err
    with pytest.raises(MissingPart, match=r"<!-- peers -->.*<!-- /peers -->"):
        write_page(study, page)
    assert page.read_text() == before


def test_half_a_study_makes_no_page(points, page, tmp_path, capsys):
    out = tmp_path / "half"
    out.mkdir()
    write_study([p for p in points if p.half == "measuring"], circumstances(), out)
    before = page.read_text()
    assert write([str(out), str(page)]) == 2
    assert f"{out}: " in capsys.readouterr().err
    with pytest.raises(MissingPart, match=r"\bmeasuring\b"):
        write_page(out, page)
    assert page.read_text() == before


_STUDY: dict[str, object] = {"shows": SHOWS, "made": {}, "halves": [], "files": [], "errors": None}


def test_a_folder_of_something_else_is_no_study(tmp_path, page, capsys):
    assert write([str(tmp_path), str(page)]) == 2
    assert "summary.json" in capsys.readouterr().err
    for content in (
        "",
        "[]",
        '{"shows": "folds"}',
        json.dumps({**_STUDY, "shows": "folds"}),
        json.dumps({**_STUDY, "files": 5}),
    ):
        (tmp_path / "summary.json").write_text(content)
        assert write([str(tmp_path), str(page)]) == 2
        assert "summary.json" in capsys.readouterr().err


def test_the_command_refuses_before_it_works(tmp_path, capsys):
    assert main(["accuracy", "-o", ""]) == 2
    assert main(["accuracy", "-o", str(tmp_path / "a"), "--halves", "brain"]) == 2
    stderr = capsys.readouterr().err
    assert re.search(r"--halves: 'brain' .* measuring, solver\. \[unknown-name\]", stderr)
    (tmp_path / "b").mkdir()
    (tmp_path / "b" / "precious.txt").write_text("mine")
    assert main(["accuracy", "-o", str(tmp_path / "b")]) == 2
    assert [p.name for p in (tmp_path / "b").iterdir()] == ["precious.txt"]
    assert not (tmp_path / "a").exists()


def test_the_command_writes_a_study_and_does_no_case_twice(tmp_path, monkeypatch, capsys, points):
    def some(halves, kept, show):
        return [p for k, made in enumerate(points) for p in kept.points(Case(f"case-{k}", lambda made=made: [made]))]

    monkeypatch.setattr(study_module, "all_points", some)
    out = tmp_path / "accuracy"
    assert main(["accuracy", "-o", str(out), "-q"]) == 0
    assert "half the error takes 4" in capsys.readouterr().out
    cases = sorted((out / "cases").rglob("*.json"))
    assert len(cases) == len(points)
    times = [case.stat().st_mtime_ns for case in cases]
    assert main(["accuracy", "-o", str(out), "-q", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["halves"] == ["measuring", "solver"]
    assert [case.stat().st_mtime_ns for case in sorted((out / "cases").rglob("*.json"))] == times
