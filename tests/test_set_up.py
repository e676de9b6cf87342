"""What a set-up does: run.py in a checkout, and the first script of a container."""

import importlib.util
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

FILE = Path(__file__).resolve().parent.parent / "run.py"
pytestmark = pytest.mark.skipif(not FILE.is_file(), reason="needs a checkout")


@pytest.fixture
def task(tmp_path, monkeypatch):
    """run.py as a module, of an empty folder, where calls are only noted."""
    spec = importlib.util.spec_from_file_location("run_py", FILE)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    source = tmp_path / "pyproject.toml"
    source.touch()
    (tmp_path / ".venv").mkdir()
    module.called = []
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(module, "ROOT", tmp_path)
    monkeypatch.setattr(module, "BIN", tmp_path / ".venv" / "bin")
    monkeypatch.setattr(module, "SOURCES", [source])
    monkeypatch.setattr(module, "call", lambda command: module.called.append(command) or 0)
    return module


def test_what_the_tests_need_is_enough_for_the_commands_until_the_sources_change(task):
    task.main(["test"])
    assert task.called
    task.called.clear()
    task.main(["setup"])
    assert task.called == []
    task.ready_file(task.ALL).rename(task.ready_file(task.USER))  # and not the other way round
    task.main(["test"])
    assert any("pip" in command for command in task.called)
    task.called.clear()
    os.utime(task.SOURCES[0], (2e9, 2e9))
    task.main(["setup"])
    assert task.called


def test_an_activated_venv_sets_up_with_the_python_it_was_made_from(task, monkeypatch):
    monkeypatch.setattr(sys, "_base_executable", "/usr/bin/outer")
    assert task.outer_python() == sys.executable  # a Python elsewhere
    monkeypatch.setattr(sys, "prefix", str(task.ROOT / ".venv"))
    task.set_up(task.USER)
    assert task.called[0][0] == "/usr/bin/outer"
    assert "/usr/bin/outer" in task.called[1]


def test_the_environments_have_the_lowest_versions_and_the_newest_and_count_failures(task, monkeypatch):
    assert task.main(["environments", "-k", "curvature"]) == 0
    tests = [command for command in task.called if "pytest" in command]
    assert [command[-2:] for command in tests] == [["-k", "curvature"]] * len(task.ENVIRONMENTS)
    resolutions = [command[command.index("--resolution") + 1] for command in task.called if "--resolution" in command]
    assert set(resolutions) == {"lowest-direct", "highest"}
    monkeypatch.setattr(task, "call", lambda command: "pytest" in command)
    assert task.main(["environments"]) == len(task.ENVIRONMENTS)


@pytest.fixture
def contained(tmp_path):
    """Runs a command as in a container whose compiled code is one file."""
    (tmp_path / "image" / "compiled").mkdir(parents=True)
    (tmp_path / "image" / "compiled" / "kernel.nbc").write_text("code\n")
    script = tmp_path / "container.sh"
    script.write_text((FILE.parent / "container.sh").read_text().replace("/opt/morphofold", str(tmp_path / "image")))
    (tmp_path / "tmp").mkdir()

    def run(command, scratch=tmp_path / "tmp"):
        argv = ["sh", str(script), "sh", "-c", command]
        environment = {name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"}
        env = {**environment, "TMPDIR": str(scratch)}
        return subprocess.run(argv, env=env, capture_output=True, encoding="utf-8")

    return run


@pytest.mark.skipif(sys.platform != "linux", reason="runs in a container of Linux")
def test_a_container_compiles_into_a_folder_of_its_own_that_goes_with_it_and_works_without(contained, tmp_path):
    done = contained('cd "$NUMBA_CACHE_DIR" && cat kernel.nbc; stat -c %a ..; touch new; exit 3')
    assert (done.stdout.split(), done.returncode) == (["code", "700"], 3)
    until = time.monotonic() + 60
    while list((tmp_path / "tmp").iterdir()) and time.monotonic() < until:
        time.sleep(0.05)
    assert list((tmp_path / "tmp").iterdir()) == []
    assert [path.name for path in (tmp_path / "image" / "compiled").iterdir()] == ["kernel.nbc"]
    done = contained('echo "works${NUMBA_CACHE_DIR-}"', tmp_path / "none")
    assert (done.stdout, done.returncode) == ("works\n", 0)


@pytest.mark.skipif(sys.platform == "win32", reason="needs the signal of a terminal")
def test_after_an_interrupt_a_task_ends_when_its_command_has_tidied_up(tmp_path, usual_signals):
    """As on a terminal, which interrupts both processes; the command takes longer than subprocess.call would wait."""
    command = (
        "import pathlib, time\n"
        "try:\n    pathlib.Path('begun').touch(); time.sleep(60)\n"
        "except KeyboardInterrupt:\n    time.sleep(1); pathlib.Path('tidied').touch(); raise SystemExit(130)\n"
    )
    code = f"import runpy, sys; sys.exit(runpy.run_path({str(FILE)!r})['call']([sys.executable, '-c', {command!r}]))"
    task = subprocess.Popen([sys.executable, "-c", code], cwd=tmp_path, start_new_session=True)
    until = time.monotonic() + 60
    while not (tmp_path / "begun").exists() and time.monotonic() < until:
        time.sleep(0.02)
    time.sleep(0.5)  # on a busy machine the task waits for its command only now
    os.killpg(task.pid, signal.SIGINT)
    assert task.wait(60) == 130
    assert (tmp_path / "tidied").exists()
