"""How fast it is: elements, steps, cohorts and two installations are timed, and docs/speed.md gets its parts."""

import json
import sys
from contextlib import nullcontext
from pathlib import Path

import numba
import numpy as np
import pytest
from commands import refused
from made_cohort import HereWorkers, quick_measure
from made_simulations import made_simulation

from morphofold.analysis.measures_result import SCALARS
from morphofold.errors import DamagedFile, MissingPart, WrongFile
from morphofold.group.group_tables import REGION_MEASURES
from morphofold.io import read_cortex
from morphofold.sim.effects import build_effects
from morphofold.sim.equilibrium.wrinkle_onset import slow_growth
from morphofold.sim.mesh.brick_mesh import bilayer_sphere
from morphofold.sim.output.simulation_folder import FolderWriter
from morphofold.sim.scene.effect_registry import effects_of
from morphofold.sim.scene.scene_files import load_scene
from morphofold.studies.bench import main
from morphofold.studies.folded_ball import folded_ball
from morphofold.studies.speed import cohort_speed, measuring_page, paired, solver_speed, speed_page
from morphofold.studies.speed.measuring_speed import measuring_speed
from morphofold.studies.speed.solver_speed import PEER_SPEEDS, PEERS_SOURCE, cut_bricks, element_speed, speed_body
from morphofold.studies.speed.speed_page import whole_run

# tetrahedra and timing ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("portion", ["full", "octant"])
def test_cut_bricks_conform_and_are_six_a_brick_with_the_same_nodes(portion):
    bilayer = bilayer_sphere(50, 3, 25, portion, 4)
    cut = cut_bricks(bilayer)
    assert cut.mesh.nelements == 6 * bilayer.mesh.nelements
    assert len(cut.mesh.subdomains["cortex"]) == 6 * len(bilayer.mesh.subdomains["cortex"])
    np.testing.assert_array_equal(cut.mesh.p, bilayer.mesh.p)
    # a quad inside that its two bricks cut along different diagonals would leave four faces of one tetrahedron each
    assert len(cut.mesh.boundary_facets()) == 2 * len(bilayer.mesh.boundary_facets())


def test_cut_bricks_fill_the_shell_at_second_order():
    cells, exact = np.array([4, 8, 16]), 4 / 3 * np.pi * (50**3 - 25**3) / 8
    error = []
    for n in cells:
        mesh = cut_bricks(bilayer_sphere(50, 3, 25, "octant", n)).mesh
        corners = mesh.p.T[mesh.t.T]
        error.append(abs(np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])).sum() / 6 / exact - 1))
    assert np.polyfit(np.log(1 / cells), np.log(error), 1)[0] == pytest.approx(2.0, abs=0.1)
    assert error[-1] < 5e-3


@pytest.mark.parametrize("element", ["brick", "tet"])
def test_timing_leaves_threads_and_body_as_they_were(element):
    body, before = speed_body(element, 4, "octant"), numba.get_num_threads()
    x = body.X + 0.1 * np.random.default_rng(1).standard_normal(body.X.shape)

    def state():
        forces = body.forces(x).copy()
        body.update_state(x)
        return forces, body.elements.state()["energy"].copy(), body.mass.copy()

    first, threads = state(), tuple(dict.fromkeys((1, before)))
    rows = element_speed(body, threads, seconds=1e-3)
    for expected, array in zip(first, state()):
        np.testing.assert_array_equal(array, expected)
    assert numba.get_num_threads() == before
    assert [row["threads"] for row in rows] == list(threads)
    assert {(row["element"], row["elements"]) for row in rows} == {(element, body.bilayer.mesh.nelements)}
    assert all(row["best"] >= row["median"] for row in rows)


def test_bench_speed_times_both_elements_and_says_that_peers_are_quoted(capsys, monkeypatch):
    monkeypatch.setattr(solver_speed, "CELL_COUNTS", {"brick": (4,), "tet": (4,)})
    assert main(["speed", "--seconds", "0.001", "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert {row["element"] for row in rows} == {"brick", "tet"}  # and nothing that is quoted
    assert {row["threads"] for row in rows} == {1, numba.get_num_threads()}
    assert all(row["median"] > 0 and np.isfinite(row["best"]) for row in rows)
    assert main(["speed", "--seconds", "0.001"]) == 0
    measured, quoted = capsys.readouterr().out.split("quoted and not measured here: ")
    assert quoted.startswith(PEERS_SOURCE)
    assert all(peer[0] not in measured and " | ".join(peer) in quoted for peer in PEER_SPEEDS)


@pytest.mark.parametrize("name", effects_of("sphere"))
def test_the_scene_in_which_an_effect_is_timed_has_it_and_no_other(name):
    scene = solver_speed.effect_scene([name])
    assert tuple(scene.effects) == (name,)
    assert name in {effect.name for effect in build_effects(scene)}  # and is not refused
    assert slow_growth(scene) is None or slow_growth(scene).pace > 0  # nor when its pace is chosen


# the solver's part of the page --------------------------------------------------------------------------------

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
TABLES_OF_SOLVER = ("elements", "quoted", "effects", "shares")  # beside the page
EFFECTS = [{"effect": "none", "ms": 2.0, "share": 1.0}, {"effect": "contact", "ms": -0.002, "share": -0.001}]


def made_run(out, warnings=(), **numbers):
    """A folder of a demo that took 10 s: 5,000 steps of 1,000 bricks, 6 s in elements, 1.5 s in contact."""
    writer = FolderWriter(out, load_scene("demo"), lambda cortex: {})
    writer.begin()
    seconds = [
        (1900, {"elements": 3.0, "contact": 0.25}),
        (2000, {"elements": 4.0, "contact": 0.5}),
        (2100, {"elements": 4.5, "contact": 0.75, "symmetry": 0.25}),
        (5000, {"elements": 6.0, "contact": 1.0, "symmetry": 0.5}),
    ]
    writer.log([{"step": step, "seconds": spent} for step, spent in seconds])
    defaults = {"elements": 1000, "steps": 5000, "seconds": 10.0, "seconds_by_phase": seconds[-1][1]}
    writer.health([{"step": 1500}, {"step": 2000}, {"step": 5000}], list(warnings), **defaults, **numbers)
    return out


@pytest.fixture
def work(tmp_path):
    """A page with marks, the files of bench, and a simulation; the folder that holds them."""
    (tmp_path / "speed.md").write_text(PAGE)
    (tmp_path / "speed.json").write_text(json.dumps(SPEED))
    (tmp_path / "effects.json").write_text(json.dumps(EFFECTS))
    made_run(tmp_path / "run", threads=2, peak_memory_GiB=0.75)
    return tmp_path


def write(work, *runs):
    files = {name: work / f"{name}.json" for name in ("speed", "effects")}
    speed_page.write_page(work / "speed.md", *(work / run for run in runs), **files)
    return (work / "speed.md").read_text()


def test_the_numbers_of_a_whole_run_follow_from_its_health_and_log(work):
    row = whole_run(work / "run")
    assert (row["scene"], row["portion"], row["elements"], row["kind"]) == ("demo", "half", 1000, "bricks")
    assert row["level"] == "edge 1.97 mm"
    assert row["millions"] == pytest.approx(0.5)  # 1,000 x 5,000 / 10 s
    assert row["shares"] == pytest.approx({"elements": 0.6, "contact": 0.1, "symmetry": 0.05, "other": 0.25})
    assert row["last_contact"] == pytest.approx(1 / 3)  # steps 2,000 to 5,000: 1 s of 3 s
    assert (row["threads"], row["memory"], row["healthy"]) == (2, 0.75, True)


def test_the_page_holds_what_was_measured_what_is_quoted_and_its_own_words(work):
    made_run(work / "ill", warnings=["1 crossing"])
    text = write(work, "run", "ill")
    for line in (
        "| brick | 27,648 | 2 | 18.0 | 20.0 | 12.0 | 6.0 |",
        "| tet | 41,472 | 1 | 28.0 | 30.0 | 20.0 | 20.0 |",
        "| none | 2.000 | 100.0 % |",
        "| demo | edge 1.97 mm | half | 1,000 bricks | 5,000 | 2 | 10.0 | 0.50 | 0.75 |",
        "| scene | level | elements | contact | symmetry | other | contact at the end |",
        "| demo | edge 1.97 mm | 60.0 % | 10.0 % | 5.0 % | 25.0 % | 33.3 % |",
        "1 of 2 runs are healthy; not: demo (edge 1.97 mm).",
    ):
        assert line in text
    assert "stale" not in text
    assert [text.count(word) for word in ("Before.", "Between.", "After.")] == [1, 1, 1]
    assert write(work, "run", "ill") == text
    measured, quoted = text.split("quoted and not measured here: ")
    assert quoted.startswith(PEERS_SOURCE)
    assert all(peer[0] not in measured for peer in PEER_SPEEDS)
    assert f"| {' | '.join(PEER_SPEEDS[0])} |" in quoted
    assert f"| {' | '.join(PEER_SPEEDS[1])} |" not in quoted
    made_simulation(work / "radial", "radial")  # in one dimension: without elements and steps
    assert "| radial | standard | – | – | – | – |" in write(work, "radial")


def test_the_page_has_the_largest_bodies_and_effects_and_files_have_all(work):
    small = {"element": "brick", "elements": 6144, "threads": 1, "best": 9.0, "median": 8.0, "steps": 7.0}
    (work / "speed.json").write_text(json.dumps([*SPEED, small]))
    text = write(work, "run")
    assert "| 6,144 |" not in text
    assert "| contact | −0.002 |" not in text
    lines = {name: (work / f"speed-{name}.tsv").read_text("utf-8").splitlines() for name in TABLES_OF_SOLVER}
    assert lines["elements"][-1] == "brick\t6,144\t1\t8.0\t9.0\t7.0\t7.0"
    assert lines["effects"][-1] == "contact\t−0.002\t−0.1 %"
    assert lines["quoted"][1:] == ["\t".join(peer) for peer in PEER_SPEEDS]
    assert len(lines["shares"]) == 2


@pytest.mark.parametrize(
    ("name", "text", "kind", "expected"),
    [
        ("speed.md", PAGE.replace("<!-- /runs -->", ""), MissingPart, "<!-- runs -->.*<!-- /runs -->"),
        ("speed.json", "[", WrongFile, "python3 run.py bench speed --json"),
        ("speed.json", "[]", WrongFile, "python3 run.py bench speed --json"),
        ("effects.json", json.dumps(SPEED), WrongFile, "effects.json: .*'ms'"),
        ("run/health.json", "{}", ValueError, "health.json: "),
        ("run/log.jsonl", '{"step": 1}\n', DamagedFile, "log.jsonl: "),
        ("run/scene.toml", None, ValueError, "run/scene.toml"),
    ],
)
def test_what_is_not_as_written_is_refused_and_the_page_stays(work, name, text, kind, expected):
    (work / name).unlink()
    if text is not None:
        (work / name).write_text(text)
    before = (work / "speed.md").read_text()
    with pytest.raises(kind, match=expected):
        write(work, "run")
    assert (work / "speed.md").read_text() == before


# what measuring costs -----------------------------------------------------------------------------------------

STEPS = [
    {"vertices": n, "threads": 2, "stage": stage, "seconds": s * n / 1e4, "memory_GiB": 0.5 if stage == "all" else None}
    for n in (10_000, 160_000)
    for stage, s in (("areas", 0.1), ("all", 0.4))
]
PAIR = {"case": "all", "vertices": 160_000, "repeats": 3, "seconds": 7.0, "other_seconds": 14.0}
TABLES = {
    "measures": STEPS,
    "pairs": [{**PAIR, "case": case, "ratio": 0.5, "low": 0.48, "high": 0.52} for case in ("all", "curvature")],
    "peers": [
        {"quantity": "mean curvature", "program": program, "vertices": 163_842, "seconds": s, "error": 0.0008}
        for program, s in (("morphofold, 2.2 edges", 0.5), ("fast", 1.0), ("slow", 2.0))
    ],
}


def test_the_page_holds_the_numbers_of_its_files(tmp_path):
    page, files = tmp_path / "speed.md", {name: tmp_path / f"{name}.json" for name in TABLES}
    page.write_text("\n".join(f"<!-- {name} -->\nstale\n<!-- /{name} -->\n" for name in TABLES))
    for name, rows in TABLES.items():
        files[name].write_text(json.dumps(rows))
    measuring_page.write_page(page, **files)
    text = page.read_text()
    assert "stale" not in text
    assert "| areas | 0.10 | 1.60 | 0.91 |" in text  # proportional to n: less than n log n
    assert "| peak memory, GiB | 0.50 | 0.50 | – |" in text
    assert "| all | 7.00 | 14.00 | 0.50 | 0.48 to 0.52 |" in text
    assert "| mean curvature | morphofold, 2.2 edges | 0.50 | 0.08% |" in text
    assert "| fast |" in text
    assert not any(cell in text for cell in ("| slow |", "| curvature |"))
    pairs, peers = ((tmp_path / f"speed-{name}.tsv").read_text("utf-8") for name in ("pairs", "peers"))
    assert (pairs.count("\n"), peers.count("\n")) == (3, 4)
    assert (tmp_path / measuring_page.PICTURE_NAME).read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow
def test_every_stage_of_measure_is_timed_and_they_add_up():
    rows = measuring_speed([1500, 1000], progress=lambda fraction, text: None)
    for n in (1000, 1500):
        seconds = {row["stage"]: row["seconds"] for row in rows if row["vertices"] == n}
        assert {"areas", "curvature", "all"} < seconds.keys()
        assert sum(seconds.values()) == pytest.approx(2 * seconds["all"])
        assert min(seconds.values()) > 0


@pytest.mark.parametrize(
    ("option", "code"),
    [
        ("measures --vertices=999", "out-of-range"),
        ("measures --vertices=10000,x", "not-readable"),
        (f"measures --against={sys.executable} --vertices=1000,2000", "options-clash"),
        ("cohort -o load --subjects=0", "out-of-range"),
        ("cohort -o load --workers=1001", "out-of-range"),
    ],
)
def test_numbers_that_cannot_be_are_refused_before_anything_is_timed(cwd, capsys, option, code):
    refused(capsys, ["bench", *option.split()], f" [{code}]")
    assert list(cwd.iterdir()) == []


# two installations --------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_every_measure_has_its_ratio_between_quartiles():
    rows = paired.paired_speed(folded_ball(1500), Path(sys.executable), scale=15.0, repeats=3, threads=1)
    assert tuple(row["case"] for row in rows) == paired.MEASURE_NAMES
    for row in rows:
        assert (row["vertices"], row["repeats"]) == (1500, 3)
        assert 0 < row["low"] <= row["ratio"] <= row["high"]
        assert min(row["seconds"], row["other_seconds"]) > 0


def test_a_python_that_can_not_measure_is_refused(tmp_path):
    with pytest.raises(MissingPart):
        paired.paired_speed(folded_ball(1500), tmp_path / "nowhere")
    broken = tmp_path / "python"
    broken.write_text("#!/bin/sh\necho 'no module of that name' >&2\nexit 1\n")
    broken.chmod(0o755)
    with pytest.raises(WrongFile, match="no module of that name"):
        paired.paired_speed(folded_ball(1500), broken)


# many subjects ------------------------------------------------------------------------------------------------


@pytest.fixture
def work_in_this_process(monkeypatch):
    monkeypatch.setattr(cohort_speed, "open_workers", lambda workers: nullcontext(HereWorkers()))
    monkeypatch.setattr("morphofold.analysis.measuring.measure", quick_measure)


def test_made_up_subjects_are_complete_of_other_sizes_and_stay(tmp_path):
    folders = cohort_speed.write_subjects(tmp_path, 3)
    cortices = [read_cortex(folder, "lh") for folder in folders]
    assert len({cortex.pial.verts.max() for cortex in cortices}) == 3
    assert all(len(cortex.regions.names) == cohort_speed.N_REGIONS for cortex in cortices)
    (folders[0] / "label" / "lh.aparc.annot").unlink()  # as if it had been stopped there
    when = (folders[1] / "surf" / "lh.white").stat().st_mtime_ns
    assert cohort_speed.write_subjects(tmp_path, 3) == folders
    assert (folders[0] / "label" / "lh.aparc.annot").is_file()
    assert (folders[1] / "surf" / "lh.white").stat().st_mtime_ns == when


def test_rows_and_bytes_of_a_cohort_are_those_of_its_files(tmp_path, work_in_this_process):
    load = cohort_speed.measure_load(tmp_path, 5, 2)
    out = tmp_path / "cohort-5-2"
    assert load["rows"] == 5 * (len(SCALARS) + cohort_speed.N_REGIONS * len(REGION_MEASURES))
    assert load["rows"] == len((out / "group" / "measures.tsv").read_text().splitlines()) - 1
    assert load["page_bytes"] == (out / "group" / "report.html").stat().st_size
    assert load["overhead"] * 5 == pytest.approx(2 * load["seconds"] - load["measuring"])
    of_one = [
        file.stat().st_size
        for name in ("subjects/sub-00000", "logs/sub-00000.log", "records/sub-00000.json")
        for file in [out / name, *(out / name).rglob("*")]
        if file.is_file()
    ]
    assert load["subject_bytes"] == pytest.approx(sum(of_one), rel=0.02)
    assert any(f"{load['rows']:,} rows" in line for line in cohort_speed.text_table([load]))


@pytest.mark.slow
def test_the_command_measures_on_real_workers(cwd, capsys):
    assert main(["cohort", "-o", "load", "--subjects", "6", "--workers", "1,2", "-q", "--json"]) == 0
    alone, pair = json.loads(capsys.readouterr().out)["loads"]
    assert (alone["workers"], pair["workers"]) == (1, 2)
    assert alone["rows"] == pair["rows"]
    assert 0 < alone["worker_GiB"] < 2
    assert alone["again"] < alone["seconds"]
    first, second = (
        {p.name: p.read_bytes() for p in (cwd / "load" / f"cohort-6-{n}" / "group").iterdir() if p.is_file()}
        for n in (1, 2)
    )
    assert first == second
