import json

import numba
import numpy as np
import pytest

from morphofold.errors import DamagedFile, MissingPart, NothingToDo, UnknownName, WrongFile
from morphofold.sim.effects import build_effects
from morphofold.sim.equilibrium.wrinkles import slow_growth
from morphofold.sim.mesh.brick_mesh import bilayer_sphere
from morphofold.sim.output.folder import FolderWriter
from morphofold.sim.scene.plugins import effects_of
from morphofold.sim.scene.scene_files import load_scene
from morphofold.studies.bench import main
from morphofold.studies.speed import solver_speed
from morphofold.studies.speed import speed_page as speed_page
from morphofold.studies.speed.solver_speed import PEERS, PEERS_SOURCE, cut_bricks, element_speed, speed_body
from morphofold.studies.speed.speed_page import whole_run, write_page

PAGE = """# How fast

Before.

<!-- elements -->
<!-- /elements -->

Between.

<!-- effects -->
stale
<!-- /effects -->

<!-- runs -->
<!-- /runs -->

After.
"""
SPEED = [
    {"element": "brick", "elements": 27648, "threads": 2, "best": 20.0, "median": 18.0, "steps": 12.0},
    {"element": "tet", "elements": 41472, "threads": 1, "best": 30.0, "median": 28.04, "steps": 20.0},
]
EFFECTS = [{"effect": "none", "ms": 2.0, "share": 1.0}, {"effect": "contact", "ms": -0.002, "share": -0.001}]


# tetrahedra and timing --------------------------------------------------------------------------------------


@pytest.mark.parametrize("portion", ["full", "octant"])
def test_cut_bricks_conform_and_are_six_a_brick_with_the_same_nodes(portion):
    bilayer = bilayer_sphere(50, 3, 25, portion, 4)
    cut = cut_bricks(bilayer)
    assert cut.mesh.nelements == 6 * bilayer.mesh.nelements
    assert len(cut.mesh.subdomains["cortex"]) == 6 * len(bilayer.mesh.subdomains["cortex"])
    np.testing.assert_array_equal(cut.mesh.p, bilayer.mesh.p)
    # a quad inside that its two bricks cut along different diagonals would leave four faces of one tetrahedron each
    assert len(cut.mesh.boundary_facets()) == 2 * len(bilayer.mesh.boundary_facets())


def test_the_faces_of_cut_bricks_are_those_of_the_pial_surface():
    cut = cut_bricks(bilayer_sphere(50, 3, 25, "full", 4))
    facets = np.sort(cut.mesh.facets[:, cut.mesh.boundary_facets()], axis=0).T
    outside = {tuple(f) for f in facets if f.max() < cut.n_surface}
    same = sum(tuple(f) in outside for f in np.sort(cut.faces, axis=1))
    assert len(cut.faces) == len(outside)
    assert same == len(cut.faces)


def test_cut_bricks_fill_the_shell_at_second_order():
    n, exact = np.array([4, 8, 16]), 4 / 3 * np.pi * (50**3 - 25**3) / 8
    error = []
    for cells in n:
        bilayer = cut_bricks(bilayer_sphere(50, 3, 25, "octant", cells))
        corners = bilayer.mesh.p.T[bilayer.mesh.t.T]
        volume = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])) / 6
        error.append(abs(volume.sum() / exact - 1))
    assert np.polyfit(np.log(1 / n), np.log(error), 1)[0] == pytest.approx(2.0, abs=0.1)
    assert error[-1] < 5e-3


@pytest.mark.parametrize("element", ["brick", "tet"])
def test_timing_leaves_threads_and_body_as_they_were(element):
    body, before = speed_body(element, 4, "octant"), numba.get_num_threads()
    x = body.X + 0.1 * np.random.default_rng(1).standard_normal(body.X.shape)

    def state():
        forces = body.forces(x).copy()
        body.update_state(x)
        return forces, body.elements.state()["energy"].copy(), body.mass.copy()

    first = state()
    threads = tuple(dict.fromkeys((1, before)))
    rows = element_speed(body, threads, seconds=1e-3)
    for one, two in zip(first, state()):
        np.testing.assert_array_equal(one, two)
    assert numba.get_num_threads() == before
    assert [row["threads"] for row in rows] == list(threads)
    assert {row["element"] for row in rows} == {element}
    assert {row["elements"] for row in rows} == {body.bilayer.mesh.nelements}
    assert all(row["best"] >= row["median"] for row in rows)


def test_a_number_of_threads_that_is_refused_changes_nothing():
    before = numba.get_num_threads()
    with pytest.raises(ValueError, match=rf"\b1 and {numba.config.NUMBA_NUM_THREADS}\b"):
        element_speed(speed_body("brick", 4, "octant"), (1, 100_000), seconds=1e-3)
    assert numba.get_num_threads() == before


def test_an_unknown_element_is_refused():
    with pytest.raises(UnknownName, match=r"element .* brick, tet, .*'wedge'"):
        speed_body("wedge", 4)


def test_the_quoted_speeds_and_times_per_step_agree_on_the_tetrahedra_of_their_source():
    assert "35,497 tet4" in PEERS_SOURCE
    for peer in PEERS:
        ms, millions = ([float(word.lstrip("~")) for word in text.split(" to ")] for text in (peer.ms, peer.millions))
        assert sorted(35.497 / t for t in ms) == pytest.approx(millions, rel=0.02)  # as rounded there


def test_bench_speed_times_both_elements_and_says_that_peers_are_quoted(capsys, monkeypatch):
    monkeypatch.setattr(solver_speed, "SIZES", {"brick": (4,), "tet": (4,)})
    assert main(["speed", "--seconds", "0.001", "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert {row["element"] for row in rows} == {"brick", "tet"}  # and nothing that is quoted
    assert {row["threads"] for row in rows} == {1, numba.get_num_threads()}
    assert all(row["median"] > 0 and np.isfinite(row["best"]) for row in rows)
    assert main(["speed", "--seconds", "0.001"]) == 0
    measured, quoted = capsys.readouterr().out.split("quoted, not measured here; ")
    assert PEERS_SOURCE in " ".join(quoted.split())
    assert all(peer.design not in measured and f"{peer.ms:>10} {peer.millions:>20}" in quoted for peer in PEERS)


@pytest.mark.parametrize("name", effects_of("sphere"))
def test_the_scene_in_which_an_effect_is_timed_has_it_and_no_other(name):
    scene = solver_speed.effect_scene([name])
    assert tuple(scene.effects) == (name,)
    assert name in {effect.name for effect in build_effects(scene)}  # and is not refused
    assert slow_growth(scene) is None or slow_growth(scene).pace > 0  # nor when its pace is chosen


# the page ---------------------------------------------------------------------------------------------------


def made_run(out, settings=(), **numbers):
    """A folder of a demo that took 10 s: 5,000 steps of 1,000 bricks, 6 s in elements, 1.5 s in contact."""
    writer = FolderWriter(out, load_scene("demo", settings), lambda cortex: {})
    writer.begin()
    seconds = [
        (1900, {"elements": 3.0, "contact": 0.25}),
        (2000, {"elements": 4.0, "contact": 0.5}),
        (2100, {"elements": 4.5, "contact": 0.75, "symmetry": 0.25}),
        (5000, {"elements": 6.0, "contact": 1.0, "symmetry": 0.5}),
    ]
    writer.log([{"step": step, "seconds": spent} for step, spent in seconds])
    defaults = {"elements": 1000, "steps": 5000, "seconds": 10.0, "seconds_by_phase": seconds[-1][1]}
    warnings = numbers.pop("warnings", [])
    stages = numbers.pop("stages", [{"step": 1500}, {"step": 2000}, {"step": 5000}])
    writer.health(stages, warnings, **{**defaults, **numbers})
    return out


@pytest.fixture
def cwd(tmp_path):
    """A page with marks, the files of bench, and a simulation; where they lie."""
    (tmp_path / "speed.md").write_text(PAGE)
    (tmp_path / "speed.json").write_text(json.dumps(SPEED))
    (tmp_path / "effects.json").write_text(json.dumps(EFFECTS))
    made_run(tmp_path / "run", threads=2, peak_memory_GiB=0.75)
    return tmp_path


def write(cwd, *folders):
    write_page(cwd / "speed.md", cwd / "speed.json", cwd / "effects.json", [cwd / f for f in folders or ("run",)])
    return (cwd / "speed.md").read_text()


def test_the_numbers_of_a_whole_run_follow_from_its_health_and_log(cwd):
    row = whole_run(cwd / "run")
    assert (row["scene"], row["portion"], row["elements"], row["kind"]) == ("demo", "half", 1000, "bricks")
    assert row["level"] == "edge 1.97 mm"
    assert row["millions"] == pytest.approx(0.5)  # 1,000 x 5,000 / 10 s
    assert row["shares"] == pytest.approx({"elements": 0.6, "contact": 0.1, "symmetry": 0.05, "other": 0.25})
    assert row["last_contact"] == pytest.approx(1 / 3)  # steps 2,000 to 5,000: 1 s of 3 s
    assert (row["threads"], row["memory"], row["healthy"]) == (2, 0.75, True)


def test_a_run_of_one_stage_counts_contact_from_its_start(tmp_path):
    row = whole_run(made_run(tmp_path / "run", ["output.stages=[]"], stages=[{"step": 5000}]))
    assert row["last_contact"] == pytest.approx(1.5 / 7.5)


def test_what_an_older_run_did_not_record_is_a_dash(tmp_path):
    made_run(tmp_path / "run")
    row = whole_run(tmp_path / "run")
    assert (row["threads"], row["memory"]) == (None, None)
    assert "| 5,000 | – | 10.0 | 0.50 | – | 33.3 % | – |" in speed_page._runs([row])[0]


def test_a_run_in_one_dimension_has_a_time_and_no_element_speed(tmp_path):
    from made_simulations import made_simulation

    made_simulation(tmp_path / "radial", "radial")
    row = whole_run(tmp_path / "radial")
    assert [row[name] for name in ("elements", "steps", "millions", "last_contact")] == [None] * 4
    assert row["seconds"] > 0
    assert "| radial | standard | – | – | – | – |" in speed_page._runs([row])[0]


def test_the_page_holds_what_was_measured_and_its_own_words(cwd):
    made_run(cwd / "ill", warnings=["1 crossing"])
    text = write(cwd, "run", "ill")
    assert "| brick | 27,648 | 2 | 18.0 | 20.0 | 12.0 | 6.0 |" in text
    assert "| tet | 41,472 | 1 | 28.0 | 30.0 | 20.0 | 20.0 |" in text
    assert "| contact | −0.002 | −0.1 % |" in text
    run = "| demo | edge 1.97 mm | half | 1,000 bricks | 5,000 | 2 | 10.0 | 0.50 | 0.25 | 33.3 % | 0.75 |"
    assert run in text
    assert "| scene | level | elements | contact | symmetry | other |" in text
    assert "| demo | edge 1.97 mm | 60.0 % | 10.0 % | 5.0 % | 25.0 % |" in text
    assert "1 of 2 runs are healthy; not: demo (edge 1.97 mm)." in text
    assert "stale" not in text
    assert [text.count(word) for word in ("Before.", "Between.", "After.")] == [1, 1, 1]
    assert write(cwd, "run", "ill") == text


def test_quoted_speeds_stand_in_a_table_of_their_own_under_their_source(cwd):
    measured, quoted = write(cwd).split("quoted and not measured here: ")
    assert quoted.startswith(PEERS_SOURCE)
    for peer in PEERS:
        assert peer.design not in measured
        assert f"| {peer.design} | {peer.threads} | {peer.ms} | {peer.millions} | {peer.timed} |" in quoted


def spoil(cwd, name, text):
    (cwd / name).write_text(text)


@pytest.mark.parametrize(
    ("name", "text", "kind", "expected"),
    [
        ("speed.md", PAGE.replace("<!-- /runs -->", ""), MissingPart, "<!-- runs -->.*<!-- /runs -->"),
        ("speed.json", "[", DamagedFile, "JSON.*line 1 column 2"),
        ("speed.json", "[]", WrongFile, "python3 run.py bench speed --json"),
        ("speed.json", json.dumps(EFFECTS), WrongFile, "row 0 of 2 .*'element', .*None"),
        ("speed.json", json.dumps([SPEED[0], {**SPEED[1], "steps": 0}]), WrongFile, r"row 1 of 2 .*'steps', .*\b0\."),
        ("effects.json", json.dumps(SPEED), WrongFile, "row 0 of 2 .*'effect', .*None"),
        ("effects.json", json.dumps([{"effect": "none", "ms": "2", "share": 1}]), WrongFile, "row 0 of 1 .*'ms'"),
        ("run/health.json", "{}", ValueError, "health.json: morphofold: "),
        ("run/log.jsonl", "", DamagedFile, "IndexError"),
        ("run/log.jsonl", '{"step": 1}\n', DamagedFile, "KeyError: 'seconds'"),
    ],
)
def test_what_is_not_as_written_is_refused_and_the_page_stays(cwd, capsys, name, text, kind, expected):
    spoil(cwd, name, text)
    refused(cwd, capsys, name, kind, expected)


@pytest.mark.parametrize("name", ["speed.md", "speed.json", "effects.json", "run/scene.toml", "run/health.json"])
def test_a_file_that_is_not_there_is_named(cwd, capsys, name):
    (cwd / name).unlink()
    refused(cwd, capsys, name, FileNotFoundError, name)


def test_bytes_that_are_no_text_are_refused(cwd, capsys):
    (cwd / "speed.json").write_bytes(b"\xff\xfe\x00")
    refused(cwd, capsys, "speed.json", DamagedFile, "'utf-8'")


def refused(cwd, capsys, name, kind, expected):
    """One line that begins with the file's name, and the error whose text tells so much; the page stays."""
    page = cwd / "speed.md"
    before = page.read_text() if page.exists() else None
    files = [f"--speed={cwd / 'speed.json'}", f"--effects={cwd / 'effects.json'}"]
    assert speed_page.main([str(page), *files, str(cwd / "run")]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    assert f": {cwd / name}: " in err
    with pytest.raises(kind, match=expected):
        write(cwd)
    assert (page.read_text() if page.exists() else None) == before


def test_no_simulation_is_refused(cwd):
    with pytest.raises(NothingToDo):
        write_page(cwd / "speed.md", cwd / "speed.json", cwd / "effects.json", [])
