"""Jobs on Dask: each is done once however workers end, and nothing of one is another's."""

import http.client
import logging
import os
import re
import tempfile
import time
import urllib.error
import urllib.request
from pathlib import Path
from types import SimpleNamespace

import psutil
import pytest

import morphofold
import morphofold.group.fleet as fleet_module
from morphofold.errors import Mismatch, OptionsClash, OutOfRange, TooLarge
from morphofold.group.fleet import Fleet, GiB, Job, Lost, _workers_and_memory, open_fleet


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
def test_jobs_survive_their_workers(tmp_path):
    lost = []
    with open_fleet(workers=2, memory=1.0) as fleet, fleet.reporting_deaths(lost.extend):
        assert "2 workers of 1 thread, at most 1.0 GiB each" in fleet.words
        found = dict(fleet.run(dies_once, [Job(f"job {i}", str(tmp_path)) for i in range(8)]))
    assert {job.name: outcome for job, outcome in found.items()} == {f"job {i}": "alive" for i in range(8)}
    assert lost
    assert all(name.startswith("job ") for name in lost)


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
    with open_fleet(workers=2, memory=1.0) as fleet:
        assert len(list(fleet.run(square, [Job("a", 2)]))) == 1
        there = set(listening(psutil.Process())) - before
        assert len(there) >= 5  # else they were not seen
        assert {address.ip for address in there} == {"127.0.0.1"}
        assert {get(address) for address in there} == {None, 404}


@pytest.mark.slow
def test_names_that_are_no_text_are_jobs_like_others_and_nobody_else_sees_names():
    jobs = [Job(f"anna \udcff {i}", f"\udcff{i}") for i in range(3)]
    with open_fleet(workers=1, memory=1.0) as fleet:
        found = {job.name: outcome for job, outcome in fleet.run(ends_badly, jobs)}
        seen = fleet.client.run_on_scheduler(lambda dask_scheduler: str(list(dask_scheduler.transition_log)))
    assert found == {job.name: job.argument for job in jobs}
    assert "job-" in seen
    assert "anna" not in seen


@pytest.mark.slow
def test_one_job_that_is_cancelled_is_lost_alone():
    class Cancelling(Fleet):
        def _outcome(self, future):
            if self.flying[future.key].name == "bad":
                future.cancel(reason="somebody", force=True)
            return super()._outcome(future)

    with open_fleet(workers=1, memory=1.0) as fleet:
        cancelling = Cancelling(fleet.client, fleet.words, fleet.bound)
        found = {job.name: outcome for job, outcome in cancelling.run(square, [Job("bad", 2), Job("good", 3)])}
    assert isinstance(found["bad"], Lost)
    assert found["good"] == 9


@pytest.mark.slow
def test_workers_leave_nothing_in_the_temporary_folder(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with open_fleet(workers=1, memory=1.0) as fleet:
        assert [outcome for _, outcome in fleet.run(square, [Job("a", 3)])] == [9]
        assert list(tmp_path.glob("*/dask-scratch-space"))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_a_job_that_always_kills_its_worker_is_lost_and_takes_no_other_with_it():
    jobs = [Job("bad", "dies"), Job("wrong", "raises"), *(Job(f"good {i}", f"{i}") for i in range(20))]
    with open_fleet(workers=2, memory=1.0) as fleet:
        found = {job.name: outcome for job, outcome in fleet.run(ends_badly, jobs)}
    assert len(found) == len(jobs)
    assert isinstance(found["bad"], Lost)
    assert "3 workers died" in found["bad"].reason
    assert "1.0 GiB" in found["bad"].reason
    assert isinstance(found["wrong"], Lost)
    assert "RuntimeError: no more" in found["wrong"].reason
    assert all(found[f"good {i}"] == f"{i}" for i in range(20))


@pytest.mark.slow
def test_results_and_jobs_do_not_pile_up():
    """Far more jobs than may be with the scheduler at once; what was yielded is let go of."""
    taken = []

    def many():
        for i in range(2000):
            taken.append(i)
            yield Job(f"{i}", i)

    with open_fleet(workers=1, memory=1.0) as fleet:
        seen = 0
        for job, outcome in fleet.run(square, many()):
            assert outcome == job.argument**2
            seen += 1
            assert len(taken) - seen <= fleet._window()
            assert len(fleet.client.futures) <= fleet._window() + 1
    assert seen == 2000


@pytest.mark.slow
def test_a_cluster_that_runs_already_is_used(monkeypatch):
    from distributed import LocalCluster

    with LocalCluster(n_workers=2, threads_per_worker=1, memory_limit=2**30, dashboard_address=":0") as cluster:
        with open_fleet(scheduler=cluster.scheduler_address) as fleet:
            assert fleet.words.startswith(f"2 workers at {cluster.scheduler_address}, 1 GiB each")
            assert {outcome for _, outcome in fleet.run(square, [Job("a", 3)])} == {9}
        words = rf" {re.escape(morphofold.__version__)},.* 99\.0\."
        monkeypatch.setattr(morphofold, "__version__", "99.0")
        with pytest.raises(Mismatch, match=words), open_fleet(scheduler=cluster.scheduler_address):
            pass


def environment_of_worker(name):
    return os.environ[name]


@pytest.mark.slow
def test_a_worker_does_one_job_at_a_time_with_all_its_threads_and_ours_stay(monkeypatch):
    """Kernels of two jobs in one process would end it."""
    monkeypatch.setenv("NUMBA_NUM_THREADS", "7")
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    with open_fleet(workers=1, threads=2, memory=1.0) as fleet:
        assert list(fleet.client.nthreads().values()) == [1]
        names = ("NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MALLOC_TRIM_THRESHOLD_")  # Dask has another of the last
        found = {job.argument: value for job, value in fleet.run(environment_of_worker, [Job(n, n) for n in names])}
        assert found == dict(zip(names, ("2", "1", str(2**28))))
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


@pytest.mark.parametrize(
    ("asked", "kind", "expected"),
    [
        ({"workers": 0}, OutOfRange, r"^workers .*\b0\.$"),
        ({"threads": 0}, OutOfRange, r"^threads .*\b0\.$"),
        ({"memory": -1.0}, OutOfRange, r"^memory .* -1\.$"),
        ({"memory": float("nan")}, OutOfRange, r"^memory .* nan\.$"),
        ({"scheduler": "tcp://127.0.0.1:1", "workers": 2}, OptionsClash, "scheduler.*workers"),
    ],
)
def test_numbers_that_are_none_are_refused(asked, kind, expected):
    with pytest.raises(kind, match=expected), open_fleet(**asked):
        pass


def test_the_log_of_dask_is_as_it_was_afterwards(monkeypatch):
    monkeypatch.setattr(fleet_module, "SCHEDULER_TIMEOUT_S", 1)
    log = logging.getLogger("distributed")
    before = log.level
    with pytest.raises(ConnectionError, match=r"tcp://127\.0\.0\.1:1\b"), open_fleet(scheduler="tcp://127.0.0.1:1"):
        pass
    assert log.level == before


def test_a_scheduler_that_is_gone_is_told():
    from distributed.client import FutureCancelledError

    class Cancelled:
        def __init__(self, reason):
            self.reason = reason

        def result(self):
            raise FutureCancelledError("k", self.reason)

    for status, reason in (("running", "scheduler-connection-lost"), ("closed", None)):
        with pytest.raises(ConnectionError):
            Fleet(SimpleNamespace(status=status), "", "")._outcome(Cancelled(reason))
    lost, died = Fleet(SimpleNamespace(status="running"), "", "")._outcome(Cancelled("somebody"))
    assert isinstance(lost, Lost)
    assert not died


def test_what_its_machine_is_to_blame_for_is_no_defect():
    class Full:
        def result(self):
            raise OSError(28, "No space left on device", "anna.log")

    lost, died = Fleet(None, "", "")._outcome(Full())
    assert not died
    assert "No space left on device: 'anna.log'" in lost.reason
    assert "defect" not in lost.reason
