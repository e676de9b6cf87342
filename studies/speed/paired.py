"""Measures by this installation and by another one: the same surface, in turn; ratios with their spread."""

import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from morphofold.errors import MissingPart, WrongFile
from morphofold.progress_callbacks import Progress, logged
from morphofold.surface import Cortex

#: what is timed, by public functions that every version since 0.2 has
MEASURE_NAMES = (
    "all",
    "cortical thickness",
    "curvature",
    "gyral thickness",
    "gyral graph",
    "local gyrification",
    "sulcal depth",
)
#: reads a case a line, and answers with its seconds on a cortex that is new each time; the first one compiles
WORKER_CODE = """
import json, sys, time
import numpy as np
import morphofold as mf
from morphofold import analysis
from morphofold.surface import Cortex, Surface
from morphofold.threads import set_threads
set_threads(int(sys.argv[2]) or None)
arrays = np.load(sys.argv[1])
measure_by_name = {
    "all": lambda c: mf.measure(c),
    "cortical thickness": lambda c: analysis.cortical_thickness(c.white, c.pial),
    "curvature": lambda c: analysis.curvature(c.pial.verts, c.faces, float(arrays["scale"])),
    "gyral thickness": lambda c: analysis.gyral_thickness(c),
    "gyral graph": lambda c: analysis.gyral_graph(c),
    "local gyrification": lambda c: analysis.local_gyrification_index(c.pial.verts, c.faces),
    "sulcal depth": lambda c: analysis.sulcal_depth(c.pial.verts, c.faces),
}
print(json.dumps(getattr(mf, "__version__", "")), flush=True)
for line in sys.stdin:
    faces = arrays["faces"].copy()
    cortex = Cortex(Surface(arrays["white"], faces), Surface(arrays["pial"], faces), name="timed")
    began = time.perf_counter()
    measure_by_name[line.strip()](cortex)
    print(json.dumps(time.perf_counter() - began), flush=True)
"""


def paired_speed(
    cortex: Cortex,
    other_python: Path,
    *,
    scale: float = 3.0,
    repeats: int = 5,
    threads: int | None = None,
    progress: Progress = logged,
) -> list[dict[str, Any]]:
    """Seconds of each measure by this installation and another one, in turn, and their ratios.

    Parameters
    ----------
    cortex : Cortex
    other_python : Path
        Interpreter of an environment in which another version of morphofold is installed.
    scale : float
        Of curvature [mm].
    repeats : int
        Pairs for each measure, after one of each that compiles; the order changes from pair to pair.
    threads : int, optional
        Of both; None: all cores.

    Returns
    -------
    list of dict
        For each of ``MEASURE_NAMES``: ``case``, ``vertices``, ``repeats``, median ``seconds`` of this and
        ``other_seconds``, and ``ratio``, the median over pairs of the seconds of this over those of the other one,
        with ``low`` and ``high``, its quartiles.

    Raises
    ------
    MissingPart
        If there is no such interpreter.
    WrongFile
        If it can not measure; the message ends with the last line of its error.
    """
    if not other_python.exists():
        raise MissingPart(f"{other_python}: no such file. Name the python of an environment with another morphofold.")
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as folder, ExitStack() as exit_stack:
        npz = Path(folder) / "cortex.npz"
        np.savez(npz, white=cortex.white.verts, pial=cortex.pial.verts, faces=cortex.faces, scale=scale)
        workers = [exit_stack.enter_context(_worker(exe, npz, threads)) for exe in (Path(sys.executable), other_python)]
        for k, quantity in enumerate(MEASURE_NAMES):
            seconds_pairs = []
            for repeat in range(1 + repeats):
                progress((k + repeat / (1 + repeats)) / len(MEASURE_NAMES), quantity)
                pair_seconds = {i: _ask(workers[i], quantity, other_python) for i in ((0, 1) if repeat % 2 else (1, 0))}
                seconds_pairs.append((pair_seconds[0], pair_seconds[1]))
            our_seconds, their_seconds = np.array(seconds_pairs[1:]).T
            low_ratio, median_ratio, high_ratio = np.percentile(our_seconds / their_seconds, [25, 50, 75])
            rows.append(
                {
                    "case": quantity,
                    "vertices": cortex.n_vertices,
                    "repeats": repeats,
                    "seconds": float(np.median(our_seconds)),
                    "other_seconds": float(np.median(their_seconds)),
                    "ratio": float(median_ratio),
                    "low": float(low_ratio),
                    "high": float(high_ratio),
                }
            )
    return rows


@contextmanager
def _worker(python: Path, npz_file: Path, threads: int | None) -> Iterator[subprocess.Popen[str]]:
    worker = subprocess.Popen(
        [str(python), "-c", WORKER_CODE, str(npz_file), str(threads or 0)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=npz_file.parent,
    )
    try:
        _answer(worker, python)
        yield worker
    finally:
        worker.kill()
        worker.communicate()


def _ask(worker: subprocess.Popen[str], quantity: str, python: Path) -> float:
    assert worker.stdin is not None
    worker.stdin.write(f"{quantity}\n")
    worker.stdin.flush()
    return float(_answer(worker, python))


def _answer(worker: subprocess.Popen[str], python: Path) -> Any:
    assert worker.stdout is not None
    assert worker.stderr is not None
    answer_line = worker.stdout.readline()
    if not answer_line:
        reason = (worker.stderr.read().strip().splitlines() or ["it stopped"])[-1]
        raise WrongFile(f"{python}: can not measure with it: {reason}. Name a python that has morphofold 0.2 or newer.")
    return json.loads(answer_line)
