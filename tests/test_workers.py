"""Tasks on Dask: each is done once however workers end, and nothing of one is another's."""

import http.client
import os
import re
import tempfile
import time
import urllib.error
import urllib.request
from pathlib import Path

import psutil
import pytest

from morphofold import __version__
from morphofold.errors import Mismatch, TooLarge
from morphofold.group import workers
from morphofold.group.workers import GiB, Lost, _workers_and_memory, open_workers


def square(x):
    return x * x


def dies_once(folder):
    """Ends its worker the first time it is called."""
    if not Path(folder, "died").exists():
        Path(folder, "died").touch()
        os.kill(os.getpid(), 9)
    return "alive"


def ends_badly(what):
    if what == "dies":
        os.kill(os.getpid(), 9)
    if what == "raises":
        raise RuntimeError("no more")
    time.sleep(0.1)
    return what


@pytest.mark.slow
def test_tasks_survive_their_workers(tmp_path, capfd):
    lost = []
    with open_workers(2, memory=1.0) as two:
        assert two.label == "2 workers of 1 thread, at most 1.0 GiB each"
        outcomes = [outcome for _, outcome in two.run(dies_once, 8 * [str(tmp_path)], lost.extend)]
    assert outcomes == 8 * ["alive"]
    assert lost == [str(tmp_path)]
    assert capfd.readouterr() == ("", "")  # Dask's log is silent


def listening(*processes):
    """Addresses at which processes and their children listen, and the ports of the pages among them."""
    every = [one for process in processes for one in (process, *process.children(recursive=True))]
    return [c.laddr for one in every for c in one.net_connections("inet") if c.status == psutil.CONN_LISTEN]


def get(address):
    try:
        with urllib.request.urlopen(f"http://{address.ip}:{address.port}/status", timeout=2) as answer:
            return answer.status
    except urllib.error.HTTPError as error:
        return error.code
    except (OSError, http.client.HTTPException):
        return None  # it does not speak HTTP


@pytest.mark.slow
def test_nothing_listens_beyond_this_machine_and_nothing_shows_pages():
    before = set(listening(psutil.Process()))
    with open_workers(2, memory=1.0) as two:
        assert len(list(two.run(square, [2]))) == 1
        there = set(listening(psutil.Process())) - before
        assert len(there) >= 5  # else they were not seen
        assert {address.ip for address in there} == {"127.0.0.1"}
        assert {get(address) for address in there} == {None, 404}


@pytest.mark.slow
def test_nobody_else_sees_names_which_may_be_no_text():
    with open_workers(1, memory=1.0) as one:
        names = [f"anna \udcff {i}" for i in range(3)]
        assert dict(one.run(ends_badly, names)) == dict(zip(names, names))
        log = one.client.run_on_scheduler(lambda dask_scheduler: str(list(dask_scheduler.transition_log)))
    assert "ends_badly" in log
    assert "anna" not in log


@pytest.mark.slow
def test_workers_leave_nothing_in_the_temporary_folder(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with open_workers(1, memory=1.0) as one:
        assert list(one.run(square, [3])) == [(3, 9)]
        assert list(tmp_path.glob("*/dask-scratch-space"))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_a_task_that_always_kills_its_worker_is_lost_and_takes_no_other_with_it():
    tasks = ["dies", "raises", *(f"good {i}" for i in range(20))]
    with open_workers(2, memory=1.0) as two:
        outcomes = dict(two.run(ends_badly, tasks))
    assert outcomes == {
        "dies": Lost("3 workers died during it. Give workers more memory, and see its log."),
        "raises": Lost("RuntimeError: no more (a defect; its log shows where)"),
        **{f"good {i}": f"good {i}" for i in range(20)},
    }


@pytest.mark.slow
def test_a_cluster_that_runs_already_is_used_and_one_that_ends_is_told(monkeypatch):
    from distributed import LocalCluster

    with LocalCluster(n_workers=2, threads_per_worker=1, memory_limit=2**30, dashboard_address=":0") as cluster:
        with open_workers(scheduler=cluster.scheduler_address) as running:
            assert running.label == f"2 workers at {cluster.scheduler_address}, 1 GiB each"
            assert list(running.run(square, [3])) == [(3, 9)]
            outcomes = running.run(time.sleep, [0.0, 60.0])
            next(outcomes)
            cluster.close()
            with pytest.raises(ConnectionError):
                next(outcomes)


@pytest.mark.slow
def test_workers_of_another_version_are_refused(monkeypatch):
    from distributed import LocalCluster

    with LocalCluster(n_workers=1, threads_per_worker=1, memory_limit=2**30, dashboard_address=":0") as cluster:
        monkeypatch.setattr(workers, "__version__", "99.0")
        words = rf" {re.escape(__version__)},.* 99\.0\."
        with pytest.raises(Mismatch, match=words), open_workers(scheduler=cluster.scheduler_address):
            pass


def environment_of_worker(name):
    return os.environ[name]


@pytest.mark.slow
def test_a_worker_does_one_task_at_a_time_with_all_its_threads_and_ours_stay(monkeypatch):
    """Kernels of two tasks in one process would end it."""
    monkeypatch.setenv("NUMBA_NUM_THREADS", "7")
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    with open_workers(1, threads=2, memory=1.0) as one:
        assert list(one.client.nthreads().values()) == [1]
        names = ("NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MALLOC_TRIM_THRESHOLD_")  # Dask has another of the last
        assert dict(one.run(environment_of_worker, names)) == dict(zip(names, ("2", "1", str(2**28))))
    assert os.environ["NUMBA_NUM_THREADS"] == "7"  # which Dask had set to those of its workers
    assert "OMP_NUM_THREADS" not in os.environ


def test_workers_share_what_the_machine_has(monkeypatch):
    monkeypatch.setattr("distributed.system.MEMORY_LIMIT", int(20 * GiB))
    monkeypatch.setattr("dask.system.CPU_COUNT", 8)
    assert _workers_and_memory(None, 1, None, 0.0) == (8, pytest.approx(18 / 8))
    assert _workers_and_memory(None, 2, None, 0.0) == (4, pytest.approx(18 / 4))
    assert _workers_and_memory(None, 1, None, 5.0) == (3, pytest.approx(6))  # 3 x 5 GiB fit into 18
    assert _workers_and_memory(None, 1, 4.0, 3.0) == (4, 4.0)
    assert _workers_and_memory(2, 1, None, 0.0) == (2, pytest.approx(9))
    assert _workers_and_memory(None, 1, None, 17.0) == (1, pytest.approx(18))
    with pytest.raises(TooLarge, match=r"\b5\.0 GiB.*\b6 .*\b3\.0 GiB"):
        _workers_and_memory(6, 1, None, 5.0)


def test_a_scheduler_that_does_not_answer_is_told(monkeypatch, capfd):
    monkeypatch.setattr(workers, "SCHEDULER_TIMEOUT_S", 1)
    with pytest.raises(ConnectionError, match=r"tcp://127\.0\.0\.1:1\b"), open_workers(scheduler="tcp://127.0.0.1:1"):
        pass
    assert capfd.readouterr() == ("", "")
