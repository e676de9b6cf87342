"""The group of a cohort: tables and page of all its subjects, from their results on disk."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Literal

from morphofold.group.covariates import NO_COVARIATES, Covariates
from morphofold.group.group_tables import Group, write_tables
from morphofold.group.tasks import Outcome
from morphofold.io import atomic_folder
from morphofold.progress import Progress, part_of, silent

GROUP_FOLDER = "group"
DrawReport = Callable[[Group, Path, Progress], object]


def write_group(
    out: Path,
    results: Mapping[str, Path],
    outcomes: Sequence[Outcome] = (),
    *,
    report: DrawReport | Literal[False] = False,
    progress: Progress = silent,
    covariates: Covariates = NO_COVARIATES,
) -> Group:
    """Write ``out/group`` completely or not at all: the tables of ``group_tables.write_tables``, and report.html if
    there is a ``report``.

    Parameters
    ----------
    out : Path
        Folder of the cohort.
    results : mapping of subject to path
        Folder of the results of each, whether it exists or not.
    outcomes : sequence of Outcome
        Outcomes of subjects measured in this run; for others, the records are used.
    report : callable or False
        Draws the page of a group into a folder: :func:`morphofold.report.pages.group_page.group_report`.
    progress : callable
        Called with the share done and the current step.
    covariates : Covariates
        Of the subjects, for the tables.
    """
    by_name = {one.name: one for one in outcomes}
    with atomic_folder(out / GROUP_FOLDER) as folder:
        group = write_tables(folder, out, results, by_name, lambda share: progress(0.7 * share, "tables"), covariates)
        if report:
            report(group, folder, part_of(progress, 0.7, 0.3))
    progress(1.0, "done")
    return group
