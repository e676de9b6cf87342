"""The group of a cohort: tables and page of all its subjects, from what is on disk of each."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Literal

from morphofold.cohort.tables import Group, write_tables
from morphofold.cohort.tasks import Outcome
from morphofold.io import atomic_folder
from morphofold.progress import Progress, part_of, silent

GROUP = "group"
Draw = Callable[[Group, Path, Progress], object]


def write_group(
    out: Path,
    results: Mapping[str, Path],
    outcomes: Sequence[Outcome] = (),
    *,
    report: Draw | Literal[False] = False,
    progress: Progress = silent,
) -> Group:
    """Write ``out/group``, whole or not at all: measures.tsv, measures.parquet, failures.tsv; and
    report.html if it is drawn.

    Parameters
    ----------
    out : Path
        Of the cohort.
    results : mapping of subject to path
        Where the results of each are, or would be.
    outcomes : sequence of Outcome
        Of subjects that were measured just now; of others the records tell.
    report : callable or False
        Draws the page of a group into a folder: :func:`morphofold.report.pages.group_page.group_report`.
    progress : callable
        Told the share done and what is being done.
    """
    by_name = {one.name: one for one in outcomes}
    with atomic_folder(out / GROUP) as folder:
        group = write_tables(folder, out, results, by_name, lambda share: progress(0.7 * share, "tables"))
        if report:
            report(group, folder, part_of(progress, 0.7, 0.3))
    progress(1.0, "done")
    return group
