"""What many subjects cost: made-up ones, small, so that what is around the measuring shows."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from morphofold.clock import peak_memory
from morphofold.cohort.fleet import open_fleet
from morphofold.cohort.group import GROUP, write_group
from morphofold.cohort.participant import Participant, measure_participant
from morphofold.cohort.running import run_tasks
from morphofold.cohort.tasks import Place
from morphofold.io import write_annotation, write_surface
from morphofold.shapes import bumpy_sphere
from morphofold.surface import Regions, Surface

LEVEL = 2               # 162 vertices
REGIONS = 34            # as many as FreeSurfer's first atlas has, so that tables have their true size


@dataclass(frozen=True)
class Load:
    """What a cohort of made-up subjects took.

    Attributes
    ----------
    subjects, workers : int
    seconds : float
        Until all were measured, the start of the workers included [s].
    measuring : float
        Seconds that workers spent on subjects, all together [s].
    overhead : float
        Seconds of a worker that each subject took beside [s].
    again : float
        Seconds of a second run, which finds all of it done [s].
    group : float
        Seconds of tables and page [s].
    memory_GiB, worker_GiB : float
        Most memory of the process that hands out the work, and of a worker.
    rows, tsv_bytes, parquet_bytes, page_bytes : int
    """

    subjects: int
    workers: int
    seconds: float
    measuring: float
    overhead: float
    again: float
    group: float
    memory_GiB: float
    worker_GiB: float
    rows: int
    tsv_bytes: int
    parquet_bytes: int
    page_bytes: int

    def as_dict(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        return asdict(self)


def write_subjects(folder: Path, count: int, tell: Callable[[float], None] = lambda share: None) -> list[Path]:
    """``count`` made-up left hemispheres of FreeSurfer's shape, each of another size; those that are there stay."""
    shape = bumpy_sphere(LEVEL, radius=40.0)
    inner = shape.verts * (1 - 3 / np.linalg.norm(shape.verts, axis=1, keepdims=True))
    labels = np.arange(len(inner)) % REGIONS
    colours = np.column_stack([np.arange(REGIONS), np.full(REGIONS, 9), np.full(REGIONS, 9)]).astype(np.uint8)
    regions = Regions(labels, tuple(f"region-{i:02d}" for i in range(REGIONS)), colours)
    found = []
    for i, size in enumerate(1 + 0.05 * np.random.default_rng(0).standard_normal(count)):
        place = folder / f"sub-{i:05d}"
        found.append(place)
        if (place / "label" / "lh.aparc.annot").is_file():              # written last
            continue
        for part in ("surf", "label"):
            (place / part).mkdir(parents=True, exist_ok=True)
        for name, verts in (("white", inner), ("pial", shape.verts)):
            write_surface(place / "surf" / f"lh.{name}", Surface((verts * size).astype(np.float32), shape.faces))
        write_annotation(place / "label" / "lh.aparc.annot", regions)
        tell((i + 1) / count)
    return found


def measure_load(
    out: Path, count: int, workers: int, progress: Callable[[float, str], None] = lambda share, text: None
) -> Load:
    """Measure ``count`` made-up subjects in ``out``/subjects-COUNT with so many workers of one thread, twice."""
    folders = write_subjects(out / "made-up", count, lambda share: progress(0.1 * share, "writing made-up subjects"))
    place = out / f"cohort-{count}-{workers}"
    place.mkdir(parents=True, exist_ok=True)
    tasks = [Participant(f.name, str(f), Place(str(place), f.name, "1"), ("lh",), report=False) for f in folders]
    began = time.perf_counter()
    with open_fleet(workers=workers) as fleet:
        done = run_tasks(fleet, measure_participant, tasks, lambda share, text: progress(0.1 + 0.7 * share, text))
        seconds = time.perf_counter() - began
        again = time.perf_counter()
        run_tasks(fleet, measure_participant, tasks, lambda share, text: progress(0.8 + 0.1 * share, text))
        again = time.perf_counter() - again
    began = time.perf_counter()
    write_group(place, {task.name: task.results for task in tasks}, progress=lambda share, text: progress(0.95, text))
    group = time.perf_counter() - began
    measuring = sum(one.seconds for one in done)
    sizes = [os.path.getsize(place / GROUP / name) for name in ("measures.tsv", "measures.parquet", "report.html")]
    with (place / GROUP / "measures.tsv").open("rb") as file:
        rows = sum(1 for _ in file) - 1
    progress(1.0, "done")
    return Load(
        count, workers, seconds, measuring, (seconds * workers - measuring) / count, again, group,
        peak_memory() or 0.0, max(one.memory_GiB for one in done), rows, *sizes,
    )  # fmt: skip


def text_table(loads: Sequence[Load]) -> list[str]:
    """Lines that say it."""
    lines = []
    for one in loads:
        lines += [
            f"{one.subjects:,} subjects, {one.workers} workers: {one.seconds:.0f} s, {one.subjects / one.seconds:.2f} "
            f"a second; each {one.measuring / one.subjects:.3f} s of a worker and {one.overhead:.3f} s beside",
            f"  found done {one.again:.0f} s; tables and page {one.group:.0f} s; {one.memory_GiB:.2f} GiB, a worker "
            f"{one.worker_GiB:.2f} GiB",
            f"  {one.rows:,} rows: text {one.tsv_bytes / 1e6:.1f} MB, Parquet {one.parquet_bytes / 1e6:.1f} MB; page "
            f"{one.page_bytes / 1e3:.0f} kB",
        ]
    return lines
