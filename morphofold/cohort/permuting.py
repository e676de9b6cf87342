"""The permutations of a model on the workers of a fleet."""

from __future__ import annotations

import pickle
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from morphofold.arrays import Array
from morphofold.cohort.fleet import Fleet, Job, Lost
from morphofold.inference.permutations import PERMUTATIONS_AT_ONCE, Null
from morphofold.progress import Progress


def on_workers(fleet: Fleet, folder: Path) -> Callable[[Null, Progress], Array]:
    """A function for ``infer(..., largest=)`` that computes exchanges on a fleet; results have the same bytes as here.

    ``folder`` must be at the same path for all workers. The data lie there in a file while they work.

    The function raises ``RuntimeError`` if the workers die under a part of the work.
    """
    return partial(_on_workers, fleet, folder)


def _on_workers(fleet: Fleet, folder: Path, null: Null, progress: Progress) -> Array:
    count = len(null.exchanges)
    found = np.empty((count, 3))
    with tempfile.TemporaryDirectory(prefix=".permutations.", dir=folder) as place:
        data = Path(place) / "null.pickle"
        with data.open("wb") as file:
            pickle.dump(null, file, protocol=5)
        parts = [(first, min(first + PERMUTATIONS_AT_ONCE, count)) for first in range(0, count, PERMUTATIONS_AT_ONCE)]
        jobs = [Job(f"permutations {first} to {last}", (str(data), first, last)) for first, last in parts]
        done = 0
        for job, answer in fleet.run(_part, jobs):
            if isinstance(answer, Lost):
                raise RuntimeError(f"{job.name}: {answer.reason}")
            _, first, last = job.argument
            found[first:last] = answer
            done += last - first
            progress(done / count, f"{done} of {count} permutations")
    return found


def _part(what: tuple[str, int, int]) -> Array:
    data, first, last = what
    with open(data, "rb") as file:
        null: Null = pickle.load(file)
    return null.largest(first, last)
