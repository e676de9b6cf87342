"""Sentences of docs/speed.md have the numbers of its tables, and of the code."""

import re

import numpy as np

from morphofold.sim.dynamics import NODES_PER_THREAD, STEPS_PER_MEASUREMENT
from morphofold.studies.page_sentences import Page
from morphofold.studies.speed.measuring_page import PICTURE_NAME
from morphofold.studies.speed.solver_speed import NOISE_MM

PAGE = Page("speed")


def test_the_answer_at_the_top():
    wall_times = {(row["scene"], row["level"], row["portion"]): row["wall time, s"] for row in PAGE.tables("runs")[0]}
    runs = [wall_times["fig6-thick", "standard", "octant"], wall_times["fig5", "standard", "half"]]
    PAGE.assert_sentence("`fig6-thick` at `standard` takes # s and half of `fig5` # s", *runs, tolerance=0.5)
    steps = {row["step"]: row for row in PAGE.tables("measures")[0]}
    hemisphere = [steps[name]["160,000"] for name in ("all", "peak memory, GiB")]
    PAGE.assert_sentence("160,000 vertices takes about # s and # GiB", *hemisphere, tolerance=0.5)
    PAGE.assert_sentence("a million vertices # s", steps["all"]["1,000,000"], tolerance=0.5)
    (row,) = re.findall(r"^\| CPU s, .* \| ([\d.]+) \| ([\d.]+) ", PAGE.text, re.M)
    PAGE.assert_sentence("BrainGrowth # s of CPU time to grow, and morphofold # s", *map(float, row))
    assert f"({PICTURE_NAME})" in PAGE.text


def test_the_times_against_earlier_versions():
    rows = PAGE.tsv_rows("versions")

    def ratio(**where):
        pairs = [row for row in rows if all(row[column] == cell for column, cell in where.items())]
        assert pairs
        return np.mean([row["later, CPU s"] / row["earlier, CPU s"] for row in pairs])

    PAGE.assert_sentence("took # of the time of 0.2.0", ratio(earlier="0.2.0 (3d9708a)"), tolerance=0.005)
    since = [ratio(earlier="962f73f", scene=scene) for scene in ("fig5", "fig6-thick")]
    PAGE.assert_sentence(
        "octants take # (`fig5` at `standard`) and # of it (`fig6-thick` at `fine`)", *since, tolerance=0.005
    )


def test_what_is_timed():
    PAGE.assert_sentence("perturbed by # mm", NOISE_MM)
    PAGE.assert_sentence("mass and energies every # steps", STEPS_PER_MEASUREMENT)
    assert f"one thread for every {NODES_PER_THREAD:,} nodes" in PAGE.prose
