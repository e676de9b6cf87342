"""Standard streams that are closed, full or left by their reader, and signals: work is done, and the code its own."""

import io
import os
import shlex
import signal
import subprocess
import sys
import time

import pytest

from morphofold.cli.terminal_output import one_line, progress

CALL = f"{shlex.quote(sys.executable)} -m morphofold"
needs_shell = pytest.mark.skipif(sys.platform == "win32", reason="needs a shell's redirections and SIGHUP")


def shell(command, cwd, **options):
    return subprocess.run(["bash", "-c", command], cwd=cwd, capture_output=True, text=True, timeout=120, **options)


def test_a_line_stays_one_steers_no_terminal_and_keeps_the_letters_of_all_languages():
    for text in ("a\nb", "\r", "\x1b[31m", "\x7f", "\x85", "\u2028", "\u202e", "\udcff", "\0"):
        line = one_line(f"<{text}>")
        assert line.isprintable()
        assert line.startswith("<")
        assert line[1:-1].encode("ascii").decode("unicode_escape") == text
    assert one_line("Gehirn äöü 脳 мозг – 10 µm \\n") == "Gehirn äöü 脳 мозг – 10 µm \\n"


@needs_shell
@pytest.mark.parametrize(("command", "code"), [("--help", 1), ("theory radius --growth 1:2:9000", 0)])  # 1 by rich
def test_a_reader_that_has_read_enough_ends_a_command_in_silence(command, code, tmp_path):
    done = shell(f"{CALL} {command} | head -1; exit ${{PIPESTATUS[0]}}", tmp_path)
    assert (done.returncode, done.stdout.count("\n"), done.stderr) == (code, 1, "")


@needs_shell
@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="needs a device that is always full")
@pytest.mark.parametrize("command", ["--help", "theory radius"])
def test_a_full_disk_below_standard_output_is_refused_in_one_line(command, tmp_path):
    done = shell(f"{CALL} {command} > /dev/full", tmp_path)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1


@pytest.mark.slow
@needs_shell
def test_a_terminal_without_letters_of_ours_ends_nothing(tmp_path):
    env = {**os.environ, "PYTHONIOENCODING": "ascii"}
    done = shell(f"{CALL} theory radius --growth nan; {CALL} theory bifurcation --thickness 2", tmp_path, env=env)
    assert (done.returncode, done.stderr.count("\n")) == (0, 1)


def started(argv, cwd, **options):
    """A run that goes on for half a minute, once it has written its first lines."""
    silent = {"cwd": cwd, "stderr": subprocess.PIPE, "text": True}
    run = subprocess.Popen([sys.executable, "-m", "morphofold", *argv], **silent, **options)
    until = time.monotonic() + 100
    while not any(cwd.glob("*/log.jsonl")) and time.monotonic() < until:
        assert run.poll() is None
        time.sleep(0.05)
    return run


#: the log comes with the checkpoint
SIMULATE = "simulate fig5 -o run -q --set geometry.portion=octant --set output.checkpoint_minutes=0.02".split()


@needs_shell
@pytest.mark.parametrize(
    "name", ["SIGTERM", *(pytest.param(name, marks=pytest.mark.slow) for name in ("SIGINT", "SIGHUP"))]
)
def test_a_signal_ends_a_run_whose_checkpoint_stays_and_nothing_half_written(name, tmp_path, usual_signals):
    """A terminal tells its processes of a hang-up, and its shell does: neither may end the tidying up of the other."""
    run = started(SIMULATE, tmp_path)
    for _ in range(2 if name == "SIGHUP" else 1):
        run.send_signal(getattr(signal, name))
    assert run.wait(60) == 130
    assert "--resume" in run.stderr.read()
    names = {path.name for path in (tmp_path / "run").iterdir()}
    assert "checkpoint.npz" in names
    assert not [name for name in names if name.startswith(".")]
    assert "lock" not in names


@pytest.mark.slow
@needs_shell
def test_under_nohup_a_hang_up_is_nothing(tmp_path):
    run = started(SIMULATE, tmp_path, preexec_fn=lambda: signal.signal(signal.SIGHUP, signal.SIG_IGN))
    for _ in range(3):
        run.send_signal(signal.SIGHUP)
        time.sleep(0.3)
        assert run.poll() is None
    run.kill()
    run.wait()


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.mark.parametrize("stream", [Terminal, io.StringIO])
def test_progress_of_a_name_with_brackets_and_line_ends_is_printed(stream, monkeypatch):
    monkeypatch.setattr(sys, "stderr", stream())
    with progress("[/x] a\nb [bold]") as report:
        report(0.5, "[/y] c\nd")
    assert r"[/x] a\nb [bold]" in sys.stderr.getvalue()
