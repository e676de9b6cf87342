"""Tasks on Dask: each is done once however workers end, and nothing of one is another's."""

import http.client
import os
import tempfile
import time
import urllib.error
import urllib.request
from pathlib import Path

import psutil
import pytest

from morphofold.errors import TooLarge
from morphofold.group import workers
from morphofold.group.workers import GiB, Lost, _workers_and_memory, open_workers


def square(x):
    return x * x


def environment_of_worker(name):
    return os.environ[name]


def dies_once(folder):
    """Ends its worker the first time it is called."""
    if not Path(folder, "died").exists():
        Path(folder, "died").touch()
        os.kill(os.getpid(), 9)
    return "alive"


def ends_badly(text):
    if text == "dies":
        os.kill(os.getpid(), 9)
    if text == "raises":
        raise RuntimeError("no more")
    time.sleep(0.1)
    return text


def listening(*processes):
    """Addresses at which processes and their children listen, and the ports of the pages among them."""
    every = [each for process in processes for each in (process, *process.children(recursive=True))]
    return [c.laddr for each in every for c in each.net_connections("inet") if c.status == psutil.CONN_LISTEN]


def get(address):
    try:
        with urllib.request.urlopen(f"http://{address.ip}:{address.port}/status", timeout=2) as answer:
            return answer.status
    except urllib.error.HTTPError as error:
        return error.code
    except (OSError, http.client.HTTPException):
        return None  # it does not speak HTTP


@pytest.mark.slow
def test_tasks_survive_their_workers_and_one_that_always_kills_them_is_lost_alone(tmp_path, capfd):
    tasks = ["dies", "raises", *(f"good {i}" for i in range(20))]
    with open_workers(2, memory=1.0) as two:
        assert two.label == "2 workers of 1 thread, at most 1.0 GiB each"
        assert [outcome for _, outcome in two.run(dies_once, 8 * [str(tmp_path)])] == 8 * ["alive"]
        outcomes = dict(two.run(ends_badly, tasks))
    assert outcomes == {
        "dies": Lost("3 workers died during it. Give workers more memory, and see its log."),
        "raises": Lost("RuntimeError: no more (a defect; its log shows where)"),
        **{f"good {i}": f"good {i}" for i in range(20)},
    }
    assert capfd.readouterr() == ("", "")  # Dask's log is silent


@pytest.mark.slow
def test_workers_are_private_and_leave_nothing_behind(tmp_path, monkeypatch):
    """Nothing listens beyond this machine or shows pages, and nobody else sees names, which may be no text."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    before, names = set(listening(psutil.Process())), [f"anna \udcff {i}" for i in range(3)]
    with open_workers(2, memory=1.0) as two:
        assert dict(two.run(ends_badly, names)) == dict(zip(names, names))
        addresses = set(listening(psutil.Process())) - before
        assert len(addresses) >= 5  # else they were not seen
        assert {address.ip for address in addresses} == {"127.0.0.1"}
        assert {get(address) for address in addresses} == {None, 404}
        log = two.client.run_on_scheduler(lambda dask_scheduler: str(list(dask_scheduler.transition_log)))
        assert list(tmp_path.glob("*/dask-scratch-space"))
    assert "ends_badly" in log
    assert "anna" not in log
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_a_worker_does_one_task_at_a_time_with_all_its_threads(monkeypatch):
    """Kernels of two tasks in one process would end it."""
    monkeypatch.setenv("NUMBA_NUM_THREADS", "7")
    for name in ("OPENBLAS_NUM_THREADS", "MALLOC_TRIM_THRESHOLD_"):
        monkeypatch.delenv(name, raising=False)
    with open_workers(1, threads=2, memory=1.0) as single:
        assert list(single.client.nthreads().values()) == [1]
        names = ("NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MALLOC_TRIM_THRESHOLD_")  # Dask has another of the last
        assert dict(single.run(environment_of_worker, names)) == dict(zip(names, ("2", "1", str(2**28))))
    assert os.environ["NUMBA_NUM_THREADS"] == "7"


@pytest.mark.slow
def test_a_cluster_that_runs_already_is_used_and_its_end_is_an_error():
    from distributed import LocalCluster

    with LocalCluster(n_workers=2, threads_per_worker=1, memory_limit=2**30, dashboard_address=":0") as cluster:
        with open_workers(scheduler=cluster.scheduler_address) as running:
            assert running.label == f"2 workers at {cluster.scheduler_address}"
            assert list(running.run(square, [3])) == [(3, 9)]
            outcomes = running.run(time.sleep, [0.0, 60.0])
            next(outcomes)
            cluster.close()
            with pytest.raises(ConnectionError):
                next(outcomes)


def test_workers_divide_the_cores_and_memory_of_the_machine(monkeypatch):
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


def test_a_scheduler_that_does_not_answer_is_an_error(monkeypatch, capfd):
    monkeypatch.setattr(workers, "SCHEDULER_TIMEOUT_S", 1)
    with pytest.raises(ConnectionError, match=r"tcp://127\.0\.0\.1:1\b"), open_workers(scheduler="tcp://127.0.0.1:1"):
        pass
    assert capfd.readouterr() == ("", "")
