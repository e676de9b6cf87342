"""Time and memory for many subjects: small made-up ones, so that the cost around the measures is visible."""

import shutil
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from morphofold.group.group_tables import GROUP_FOLDER, write_group
from morphofold.group.measure_subject import Participant, measure_participant
from morphofold.group.task_records import Outcome, TaskFolder
from morphofold.group.workers import open_workers, run_tasks
from morphofold.group_pages.cohort_page import group_report
from morphofold.io import write_annotation, write_surface
from morphofold.progress_callbacks import Progress, logged, part_of
from morphofold.studies.known_shapes import bumpy_sphere
from morphofold.studies.markdown import cells, table
from morphofold.surface import Regions, Surface
from morphofold.timing import peak_memory

SPHERE_LEVEL = 2  # 162 vertices
N_REGIONS = 34  # as many as in FreeSurfer's first atlas, so that tables have a realistic size


def write_subjects(folder: Path, n_subjects: int, show_share: Callable[[float], None] = lambda _: None) -> list[Path]:
    """``n_subjects`` made-up left hemispheres as FreeSurfer subjects, each of another size; existing ones are kept."""
    pial = bumpy_sphere(SPHERE_LEVEL, radius=40.0)
    white_verts = pial.verts * (1 - 3 / np.linalg.norm(pial.verts, axis=1, keepdims=True))
    region_index = np.arange(len(white_verts)) % N_REGIONS
    colours = np.column_stack([np.arange(N_REGIONS), np.full(N_REGIONS, 9), np.full(N_REGIONS, 9)]).astype(np.uint8)
    regions = Regions(region_index, tuple(f"region-{i:02d}" for i in range(N_REGIONS)), colours)
    subject_folders = []
    for i, scale in enumerate(1 + 0.05 * np.random.default_rng(0).standard_normal(n_subjects)):
        subject_dir = folder / f"sub-{i:05d}"
        subject_folders.append(subject_dir)
        if (subject_dir / "label" / "lh.aparc.annot").is_file():  # written last
            continue
        for subfolder in ("surf", "label"):
            (subject_dir / subfolder).mkdir(parents=True, exist_ok=True)
        for name, verts in (("white", white_verts), ("pial", pial.verts)):
            write_surface(subject_dir / "surf" / f"lh.{name}", Surface((verts * scale).astype(np.float32), pial.faces))
        write_annotation(subject_dir / "label" / "lh.aparc.annot", regions)
        show_share((i + 1) / n_subjects)
    return subject_folders


def measure_load(out: Path, n_subjects: int, n_workers: int, progress: Progress = logged) -> dict[str, Any]:
    """Measure ``n_subjects`` made-up subjects with workers of one thread each, again with all done, then group them.

    Results go to ``out``/cohort-COUNT-WORKERS, which is replaced if it exists; ``out``/made-up is reused.

    Returns
    -------
    dict
        ``subjects``, ``workers``; times [s]: ``seconds`` from the start of the workers until all were measured,
        ``measuring`` of all workers together on subjects, ``again`` of a second run, which finds everything done,
        ``group`` of tables and page; peak memory of this process, which distributes the work, and of a worker; the
        number of ``rows`` of measures.tsv; sizes on disk of its two files, of the page, and of the results of one
        subject with its log and record; ``overhead``, the time of a worker per subject outside of measuring:
        distribution, waiting, and the last subject [s].

    Raises
    ------
    RuntimeError
        If a subject fails.
    """
    folders = write_subjects(out / "made-up", n_subjects, lambda part: progress(0.1 * part, "writing made-up subjects"))
    cohort = out / f"cohort-{n_subjects}-{n_workers}"
    shutil.rmtree(cohort, ignore_errors=True)
    cohort.mkdir(parents=True)

    def run(run_id: str, begin: float, share: float) -> tuple[float, list[Outcome]]:
        tasks = [Participant(sub.name, str(sub), TaskFolder(str(cohort), sub.name, run_id), ("lh",)) for sub in folders]
        began_at = time.perf_counter()
        outcomes = run_tasks(pool, measure_participant, tasks, lambda done, text: progress(begin + share * done, text))
        return time.perf_counter() - began_at, outcomes

    with open_workers(n_workers) as pool:
        first_seconds, outcomes = run("1", 0.1, 0.7)
        for failed_task in (task for task in outcomes if task.state != "done"):
            raise RuntimeError(f"{failed_task.name}: {dict(failed_task.failures)}. Made-up subjects should not fail.")
        seconds_again, outcomes_again = run("2", 0.8, 0.1)
        for repeated_task in (task for task in outcomes_again if task.state != "reused"):
            raise RuntimeError(f"{repeated_task.name}: was {repeated_task.state} again, although nothing had changed.")
    folder_by_name = {subject.name: cohort / "subjects" / subject.name for subject in folders}
    began_at = time.perf_counter()
    write_group(cohort, folder_by_name, report=group_report, progress=part_of(progress, 0.9, 0.1))
    group_seconds = time.perf_counter() - began_at
    tsv, parquet, page = (cohort / GROUP_FOLDER / name for name in ("measures.tsv", "measures.parquet", "report.html"))
    with tsv.open("rb") as file:
        n_rows = sum(1 for _ in file) - 1
    subject_bytes = sum(
        file.stat().st_size
        for name in ("subjects", "logs", "records")
        for file in (cohort / name).rglob("*")
        if file.is_file()
    )
    busy_seconds = sum(task.seconds for task in outcomes)
    return {
        "subjects": n_subjects,
        "workers": n_workers,
        "seconds": first_seconds,
        "measuring": busy_seconds,
        "again": seconds_again,
        "group": group_seconds,
        "memory_GiB": peak_memory() or 0.0,
        "worker_GiB": max(task.memory_GiB for task in outcomes),
        "rows": n_rows,
        "tsv_bytes": tsv.stat().st_size,
        "parquet_bytes": parquet.stat().st_size,
        "page_bytes": page.stat().st_size,
        "subject_bytes": subject_bytes / n_subjects,
        "overhead": (first_seconds * n_workers - busy_seconds) / n_subjects,
    }


def text_table(load_rows: Sequence[dict[str, Any]]) -> list[str]:
    """Lines of a table of the loads."""
    heads = "subjects | workers | s | s each | beside | again s | group s | GiB | worker GiB"
    formats = {"subjects": "{:,}", "workers": "{}", "seconds": "{:.1f}", "each": "{:.4f}", "overhead": "{:.4f}"}
    formats |= {"again": "{:.1f}", "group": "{:.1f}", "memory_GiB": "{:.2f}", "worker_GiB": "{:.2f}"}
    table_rows = [load_row | {"each": load_row["measuring"] / load_row["subjects"]} for load_row in load_rows]
    size_lines = [
        f"{load_row['subjects']:,} subjects: {load_row['rows']:,} rows, {load_row['tsv_bytes'] / 1e6:.1f} MB as text, "
        f"{load_row['parquet_bytes'] / 1e6:.2f} MB as Parquet; page {load_row['page_bytes'] / 1e3:.0f} kB; "
        f"{load_row['subject_bytes'] / 1e3:.0f} kB per subject"
        for load_row in {load_row["subjects"]: load_row for load_row in load_rows}.values()
    ]
    return [table(heads, cells(table_rows, formats)), *size_lines]
