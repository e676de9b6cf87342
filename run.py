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

USER, ALL = "[group]", "[test,docs,bench]"
EXTRAS = {"setup": USER, "demo": USER, "docs": "[group,docs]", "test": ALL, "bench": ALL, "accuracy": ALL}  # of a task
SIZES = {USER: 400, "[group,docs]": 430, ALL: 550}  # MB to load; each holds those before
BENCH = ["python", "-m", "morphofold.studies.bench"]
#: Pythons and versions of dependencies of the task ``environments``; the first takes the lowest that are declared
ENVIRONMENTS = [("3.11", "lowest-direct"), ("3.12", "highest"), ("3.13", "highest"), ("3.14", "highest")]
TASKS = {
    "setup": [],
    "demo": [["morphofold", "demo", "-o", "demo"]],
    "docs": [
        ["python", "-m", "morphofold.studies.pages.pages_to_try", ".pages"],
        ["python", "-m", "mkdocs", "build", "--strict"],
    ],
    "bench": [BENCH],
    "accuracy": [
        [*BENCH, "accuracy", "-o", "accuracy"],
        [
            *["python", "-m", "morphofold.studies.accuracy.accuracy_page", "accuracy", "docs/accuracy.md"],
            *["--table", "morphofold/forecasts/table.json"],
        ],
    ],
    "test": [
        ["ruff", "check", "."],
        ["ruff", "format", "--check", "."],
        ["codespell"],
        ["mypy"],
        [*"python -m pytest -n auto --maxprocesses 4 --dist worksteal".split()],
    ],
}


def main(words: list[str]) -> int:
    if sys.version_info < (3, 11):  # noqa: UP036  (this file is what an older Python reads first)
        return fail(f"Python 3.11 or newer is needed, this is {sys.version.split()[0]}; try python3.12 or so.")
    if not words or words[0] not in (*TASKS, "environments"):
        return fail(f"name a task: {', '.join(TASKS)}, environments.")
    os.chdir(ROOT)
    if words[0] == "environments":
        return environments(words[1:])
    extras = EXTRAS[words[0]]
    if not is_ready(extras):
        code = set_up(extras)
        if code:
            return code
        ready_file(extras).touch()
    for i, command in enumerate(TASKS[words[0]]):
        last = i == len(TASKS[words[0]]) - 1
        code = call([str(BIN / command[0]), *command[1:], *(words[1:] if last else [])])
        if code:
            return code
    return 0


def ready_file(extras: str) -> Path:
    return ROOT / ".venv" / f".ready{extras}"


def is_ready(extras: str) -> bool:
    """Whether these extras, or more, were set up after the last change of what they are made from."""
    newest = max(s.stat().st_mtime for s in SOURCES)
    more = [ready_file(e) for e in list(SIZES)[list(SIZES).index(extras) :]]
    return any(ready.exists() and ready.stat().st_mtime >= newest for ready in more)


def uv_file() -> Path:
    return ROOT / ".tools" / "bin" / "uv"


def uv_itself() -> list[list[str]]:
    """The command that gets uv from pip, if it is not here yet."""
    pip = [outer_python(), "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--target", ".tools", "uv"]
    return [] if uv_file().exists() else [pip]


def environments(words: list[str]) -> int:
    """Run the tests, or those that ``words`` choose, in an environment of each kind; return the number of failures."""
    os.environ.setdefault("UV_PYTHON_DOWNLOADS", "automatic")
    failures = 0
    for version, resolution in ENVIRONMENTS:
        folder = ROOT / ".environments" / f"{version}-{resolution}"
        python = str(folder / BIN.name / "python")
        commands = [
            *uv_itself(),
            [str(uv_file()), "venv", "--quiet", "--allow-existing", "--python", version, str(folder)],
            [
                str(uv_file()),
                "pip",
                "install",
                "--quiet",
                "--resolution",
                resolution,
                "--python",
                python,
                "-e",
                ".[test,docs]",
            ],
            [python, "-m", "pytest", "-q", "-n", "2", *words],
        ]
        failed = next((command for command in commands if call(command)), None)
        failures += failed is not None
        print(f"{folder.name}: {'passed' if failed is None else 'FAILED at ' + ' '.join(failed)}", flush=True)
    return failures


def set_up(extras: str) -> int:
    """uv from pip into .tools, which works where venv and system installs don't; the rest by uv into .venv."""
    print(f"setting up .venv (once; downloads about {SIZES[extras]} MB)", file=sys.stderr, flush=True)
    base, uv, python = outer_python(), str(uv_file()), str(BIN / "python")
    for command in (
        *uv_itself(),
        [uv, "venv", "--quiet", "--allow-existing", "--python", base, ".venv"],
        [
            *[uv, "pip", "install", "--quiet", "--compile-bytecode", "--python", python],
            *["-c", "constraints.txt", "-e", f".{extras}"],
        ],
    ):
        code = call(command)
        if code:
            return fail(f"set-up failed at: {' '.join(command)}")
    print(f"ready: the command is {BIN.relative_to(ROOT) / 'morphofold'}", file=sys.stderr, flush=True)
    return 0


def outer_python() -> str:
    """The Python that runs this file, or where that is .venv's own, which has no pip, the one it was made from."""
    inside = Path(sys.prefix).resolve() == (ROOT / ".venv").resolve()
    return str(getattr(sys, "_base_executable", sys.executable) if inside else sys.executable)


def call(command: list[str]) -> int:
    quiet = {"UV_PYTHON_DOWNLOADS": "never", "PIP_ROOT_USER_ACTION": "ignore"}
    try:
        process = subprocess.Popen(command, env={**quiet, **os.environ})
    except OSError as error:
        return fail(f"{command[0]}: {error}")
    while True:
        try:
            return process.wait()
        except KeyboardInterrupt:  # the command gets Ctrl-C too, and may have a checkpoint to write
            pass


def fail(message: str) -> int:
    print(f"run.py: {message}", file=sys.stderr)
    return 2


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
