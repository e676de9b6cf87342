"""What an analysis has cost: it adds up, is said where it is looked for, and changes nothing else."""

import json
import re
from html import unescape
from types import SimpleNamespace

import numba
import pytest

from morphofold.cli import main
from morphofold.forecasts.cost_record import ANALYSIS_STAGES, TABLE, measured_errors
from morphofold.io import write_surface
from morphofold.number_texts import percent
from morphofold.studies.folded_ball import folded_ball


@pytest.fixture
def pair(cwd):
    """A folded ball as a pair of files, and the command that measures it."""
    ball = folded_ball(7000)
    for name in ("white", "pial"):
        write_surface(cwd / f"lh.{name}", getattr(ball, name))
    return ["analyze", "--white", "lh.white", "--pial", "lh.pial", "--name", "ball", "-q"]


@pytest.mark.slow
def test_an_analysis_says_its_cost_in_a_line_a_file_and_on_its_page(cwd, pair, capsys):
    assert main([*pair, "--threads", "1", "-o", "out"]) == 0
    line = next(line for line in capsys.readouterr().out.splitlines() if line.startswith("time: "))
    cost = json.loads((cwd / "out/cost.json").read_text(encoding="utf-8"), parse_constant=pytest.fail)
    assert set(cost["stages"]) == set(ANALYSIS_STAGES)  # those of measure and no other; some run beside each other
    assert cost["seconds"] == pytest.approx(sum(stage["seconds"] for stage in cost["stages"].values()))
    assert sum(stage["share"] for stage in cost["stages"].values()) == pytest.approx(1)
    assert (cost["vertices"], cost["accuracy"], cost["threads"]) == ({"lh": 7000}, "standard", 1)
    assert cost["memory_GiB"] > 0.1
    worst = max(cost["errors"], key=lambda name: cost["errors"][name]["error"])
    expected = f"expected errors up to {percent(cost['errors'][worst]['error'])} ({worst})"
    assert line.endswith(f"{expected}, by one person's hemisphere and its mesh")
    page = (cwd / "out" / "report.html").read_text(encoding="utf-8")
    section = unescape(page.split("<h2>What it cost</h2>")[1].split("</section>")[0])
    for part in (*ANALYSIS_STAGES, "by 1 thread", "GiB", "lh of 7,000 vertices", *cost["errors"], cost["how"]):
        assert part in section
    (longest, _), *_ = sorted(cost["stages"].items(), key=lambda item: -item[1]["seconds"])
    assert f", {longest} " in line


@pytest.mark.slow
def test_only_the_cost_differs_between_threads_and_again(cwd, pair, capsys):
    for layout in ("plain", "bids"):
        written = []
        for threads in (1, numba.config.NUMBA_NUM_THREADS):
            out = cwd / f"{layout} {len(written)}"
            assert main([*pair, "--layout", layout, "--threads", str(threads), "-o", str(out)]) == 0
            files = {p.relative_to(out).as_posix(): p.read_bytes() for p in out.rglob("*") if p.is_file()}
            (cost,) = (name for name in files if name.endswith("cost.json"))
            del files[cost]
            (page,) = (name for name in files if name.endswith("report.html"))
            files[page] = re.sub(rb"<h2>What it cost</h2>.*?</section>", b"", files[page], flags=re.DOTALL)
            written.append(files)
        assert written[0] == written[1]


def test_errors_on_meshes_unlike_the_persons_are_doubted_whichever_hemisphere_it_is():
    n = TABLE["errors"]["measuring"][0]["vertices"]
    for sizes, unlike in (((n, n), ""), ((n, 2 * n), f"{2 * n:,}"), ((n, 2 * n, 3 * n), f"{2 * n:,} or {3 * n:,}")):
        for order in (sizes, sizes[::-1]):
            doubts = measured_errors([counted(each) for each in order], "standard").doubts
            assert len(doubts) == bool(unlike)
            assert all(f"on one of {unlike} is not known" in doubt for doubt in doubts)
    assert "not of a simulated cortex" in measured_errors([counted(n, "simulation")], "standard").doubts[0]


@pytest.mark.parametrize(("n", "measured"), [(6_600, False), (6_700, True), (229_000, True), (230_000, False)])
def test_no_errors_are_expected_of_meshes_beyond_those_that_were_measured(n, measured):
    expected = measured_errors([counted(n), counted(max(n, 152_893))], "fine")
    assert bool(expected.errors) == measured
    assert (f"{n:,} vertices" in expected.how) != measured


def counted(n, origin="files"):
    """A stand-in that says it has ``n`` vertices."""
    return SimpleNamespace(n_vertices=n, origin=origin)
