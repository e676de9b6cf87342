"""Fixtures that every test file may use, and the record of the hard cases."""

import gc
import json
import os
import re
import signal
from pathlib import Path

if "PYTEST_XDIST_WORKER" in os.environ:  # several processes share the cores: before numpy is imported
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # processes that tests start would compile every module again
    gc.set_threshold(100_000, 50, 50)  # collecting thousands of tests and compiling leave little to collect

import numpy as np
import pytest

from morphofold.shapes import icosphere
from morphofold.surface import Surface


@pytest.fixture
def cwd(tmp_path, monkeypatch):
    """An empty working directory."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def rng():
    """A fresh random generator with a fixed seed."""
    return np.random.default_rng(20150901)


@pytest.fixture
def usual_signals():
    """Signals that nohup, or a shell without job control, ignores act, also in processes that the test starts.

    So does Ctrl-C where dask-jobqueue, when it was imported, set a handler of its own.
    """
    usual = {signal.SIGINT: signal.default_int_handler, signal.SIGTERM: signal.SIG_DFL}
    if hasattr(signal, "SIGHUP"):  # not on Windows
        usual[signal.SIGHUP] = signal.SIG_DFL
    before = {number: signal.signal(number, handler) for number, handler in usual.items()}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.fixture
def rough(rng):
    """A closed surface whose coordinates float32 holds exactly, near zero too."""
    verts, faces = icosphere(2, radius=40.0)
    verts = verts + 0.5 * rng.standard_normal(verts.shape)
    verts[0] *= 1e-4
    return Surface(verts.astype(np.float32), faces, "rough")


@pytest.fixture(scope="session")
def measured_average():
    """All measures of the average brain fsaverage5, and the shares of the work that were told."""
    from morphofold.analysis import measure
    from morphofold.io import read_cortex, sample_path

    shares = []
    return measure(read_cortex(sample_path("fsaverage5")), progress=lambda share, _: shares.append(share)), shares


#: in files whose tests begin, since they compile the kernels of the solver
SOLVES = re.compile(r"sim\.(?:body|run|elements|effects)\b|forecasts\b|made_(?:bodies|octants|simulations|solver)")


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items):
    """The solver's tests first: pytest-xdist hands out halves, and two processes shall not compile the same kernels."""
    if "PYTEST_XDIST_WORKER" in os.environ:
        solves = {path: bool(SOLVES.search(path.read_text("utf-8"))) for path in {item.path for item in items}}
        items.sort(key=lambda item: not solves[item.path])


def pytest_addoption(parser):
    parser.addoption("--hard-cases", metavar="FILE", help="write what the hard cases recorded as JSON")


def pytest_configure(config):
    if config.getoption("--hard-cases") and not hasattr(config, "workerinput"):
        config.pluginmanager.register(HardCases(Path(config.getoption("--hard-cases"))))


class HardCases:
    """Gathers what hard cases recorded, from all processes, and writes it at the end."""

    def __init__(self, file):
        self.file, self.rows = file, {}

    def pytest_runtest_logreport(self, report):
        records = [value for name, value in report.user_properties if name.startswith("hard case")]
        if report.when == "call" and records:
            self.rows[report.nodeid] = {"outcome": report.outcome, "records": records}

    def pytest_sessionfinish(self):
        self.file.write_text(json.dumps(dict(sorted(self.rows.items())), indent=1, ensure_ascii=False) + "\n")


@pytest.fixture(scope="session")
def finished_run(tmp_path_factory):
    """The folder of a finished run of ``demo``, which no test changes."""
    from made_simulations import TINY

    from morphofold.simulation import simulate

    return simulate("demo", tmp_path_factory.mktemp("simulation") / "finished", settings=TINY).path


@pytest.fixture(scope="session")
def stopped_run(tmp_path_factory):
    """The folder of a run of ``demo`` that was stopped beyond its first stage, which no test changes."""
    from made_simulations import stop_run

    return stop_run(tmp_path_factory.mktemp("simulation") / "stopped")


@pytest.fixture
def quick_searches(monkeypatch):
    """Bodies under smooth surfaces, with searches for even cells and good bricks on coarse lattices."""
    from morphofold.sim.hemisphere import hemisphere_body

    smaller = {"SHIFT_CELLS": 8, "SHIFT_DEGREE": 4, "SHIFT_ITERATIONS": 15, "CORE_CELLS": 8, "MOVES_DEGREE": 4}
    for name, value in smaller.items():
        monkeypatch.setattr(hemisphere_body, name, value)
    hemisphere_body._smooth_body.cache_clear()
    yield
    hemisphere_body._smooth_body.cache_clear()
