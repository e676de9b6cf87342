"""Set everything up in .venv and run a task: ``python3 run.py demo`` or ``python3 run.py test``.

Needs only Python 3.11 or newer with pip, and a network for the first set-up. Further words go to the task:
``python3 run.py test -k curvature``.
"""

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent
BIN = ROOT / ".venv" / ("Scripts" if os.name == "nt" else "bin")
SOURCES = [ROOT / name for name in ("pyproject.toml", "constraints.txt", "run.py")]

#: extras of pyproject.toml that a task needs; MB to load with each set of them
EXTRAS = {"setup": (), "demo": (), "docs": ("docs",), "test": ("docs", "test")}
SIZES = {(): 300, ("docs",): 320, ("docs", "test"): 430}
TASKS = {
    "setup": [],
    "demo": [["morphofold", "demo", "-o", "demo"]],
    "docs": [["python", "-m", "mkdocs", "build", "--strict"]],
    "test": [["ruff", "check", "."], ["mypy"], [*"python -m pytest -n auto --maxprocesses 4 --dist worksteal".split()]],
}


def main(words: list[str]) -> int:
    if sys.version_info < (3, 11):  # noqa: UP036  (this file is what an older Python reads first)
        return fail(f"Python 3.11 or newer is needed, this is {sys.version.split()[0]}; try python3.12 or so.")
    if not words or words[0] not in TASKS:
        return fail(f"name a task: {', '.join(TASKS)}.")
    os.chdir(ROOT)
    extras = EXTRAS[words[0]]
    if not any(is_ready(more) for more in SIZES if set(extras) <= set(more)):
        code = set_up(extras)
        if code:
            return code
        mark(extras).touch()
    for i, command in enumerate(TASKS[words[0]]):
        last = i == len(TASKS[words[0]]) - 1
        code = call([str(BIN / command[0]), *command[1:], *(words[1:] if last else [])])
        if code:
            return code
    return 0


def mark(extras: tuple[str, ...]) -> Path:
    return ROOT / ".venv" / "-".join((".ready", *extras))


def is_ready(extras: tuple[str, ...]) -> bool:
    """Whether .venv has these extras, as the sources now say."""
    return mark(extras).exists() and all(s.stat().st_mtime <= mark(extras).stat().st_mtime for s in SOURCES)


def set_up(extras: tuple[str, ...]) -> int:
    """uv from pip into .tools, which works where venv and system installs don't; the rest by uv into .venv."""
    print(f"setting up .venv (once; downloads about {SIZES[extras]} MB)", flush=True)
    outside = getattr(sys, "_base_executable", sys.executable)          # not the Python of .venv, which has no pip
    pip = [outside, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--upgrade"]
    uv = str(ROOT / ".tools" / "bin" / "uv")
    python = str(BIN / "python")
    for command in (
        [*pip, "--target", ".tools", "uv"],
        [uv, "venv", "--quiet", "--allow-existing", "--python", outside, ".venv"],
        [
            *[uv, "pip", "install", "--quiet", "--compile-bytecode", "--python", python],
            *["-c", "constraints.txt", "-e", f".[{','.join(extras)}]" if extras else "."],
        ],
    ):
        code = call(command)
        if code:
            return fail(f"set-up failed at: {' '.join(command)}")
    print(f"ready: the command is {BIN.relative_to(ROOT) / 'morphofold'}", flush=True)
    return 0


def call(command: list[str]) -> int:
    quiet = {"UV_PYTHON_DOWNLOADS": "never", "PIP_ROOT_USER_ACTION": "ignore"}
    try:
        return subprocess.call(command, env={**os.environ, **quiet})
    except KeyboardInterrupt:
        return 130
    except OSError as error:
        return fail(f"{command[0]}: {error}")


def fail(message: str) -> int:
    print(f"run.py: {message}", file=sys.stderr)
    return 2


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
