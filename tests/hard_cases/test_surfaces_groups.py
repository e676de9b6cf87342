"""Groups of hemispheres that were measured unlike, or of which one side failed: no statistic tells the two apart."""

from dataclasses import replace

import numpy as np
from hard_cases.made_surfaces import case
from made_cohort import HereWorkers, participants, quick_measure, write_subject
from made_groups import made_group

from morphofold.group import group_tables
from morphofold.group.group_distributions import asymmetry, distributions, measures_of
from morphofold.group.group_tables import Pooling, write_group
from morphofold.group.measure_subject import measure_participant
from morphofold.group.workers import run_tasks
from morphofold.group_pages import cohort_page


def by_width(cortex, **options):
    """Hinges as the width of the net has it, which is another on the right: of one brain twice as many."""
    width = {"lh": 8.0, "rh": 5.6}[cortex.hemi]
    result = quick_measure(cortex, **options)
    noise = round(float(np.abs(cortex.pial.verts[:, 0]).max())) % 3
    hinges = {"n_hinges": round(6000 / width**2) + noise}
    return replace(result, scalars=result.scalars | hinges, parameters=result.parameters | {"graph_width_mm": width})


@case(
    "a group whose left and right hemispheres were measured with nets of unlike width",
    "hemispheres measured unlike are not pooled",
    (group_tables, "pooling", lambda *measured: Pooling()),
)
def test_hinges_of_unlike_nets_are_in_no_test(holds, tmp_path, monkeypatch):
    monkeypatch.setattr("morphofold.analysis.measuring.measure", by_width)
    folders = [write_subject(tmp_path / "subjects" / f"s{k}", 1 + k / 50) for k in range(6)]
    subjects = participants(folders, tmp_path / "out")
    run_tasks(HereWorkers(), measure_participant, subjects)
    group = write_group(tmp_path / "out", {subject.name: subject.results for subject in subjects}, report=False)
    scalars = measures_of(group)
    hinges = lambda rows: [row for row in rows if row.measure == "n_hinges"]
    holds.equal("tests of hinges, left against right", hinges(asymmetry(scalars)), [])
    holds.equal("distributions of hinges", hinges(distributions(scalars)), [])
    holds.equal("values left out, of", group.pooling.left_out.get("n_hinges"), (12, 12))


@case("a group of alike sides, of which the right ones of the most folded brains failed")
def test_medians_of_the_sides_are_of_the_same_subjects(holds):
    folded = np.repeat(np.linspace(2.0, 3.0, 20)[:, None], 2, axis=1)
    folded[12:, 1] = np.nan
    group = made_group(20, gyrification_index=folded)
    rows = cohort_page.headlines(measures_of(group), cohort_page.BOTH_SIDES)
    left, right = rows["gyrification_index"]
    holds.equal("subjects, left and right", (left.n, right.n), (12, 12))
    holds("difference of the medians", abs(left.median - right.median), at_most=0)
