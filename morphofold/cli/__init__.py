"""The ``morphofold`` command: :mod:`morphofold.cli.command_options` says what a command takes.

The module that does the work is only imported with its command.
"""

import gc
import io
import os
import re
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from functools import cache
from itertools import pairwise
from pkgutil import resolve_name
from typing import Any, NoReturn

from cyclopts import App, CycloptsError, MissingArgumentError, Parameter, ValidationError

from morphofold import __version__
from morphofold.cli import command_options
from morphofold.cli.command_options import Answer, Options, Theory
from morphofold.cli.terminal_output import one_line, print_answer, print_line
from morphofold.errors import DISK_FULL_ERRORS, BadUsage, OutOfRange, Refusal, code_of
from morphofold.lazy import DRAWERS, draw
from morphofold.threads import BLAS_VARIABLES, set_threads

COMMAND_NAMES = (
    "demo simulate analyze compare unfold cohort overlap stats bids sweep infer theory reproduce scenes".split()
)
COMMANDS: dict[str, type[Options]] = {name: getattr(command_options, name.capitalize()) for name in COMMAND_NAMES}
DESCRIPTION = """Grow folded cortices, read real ones, and measure both with the same code.

For example:

- `morphofold demo -o demo`
- `morphofold analyze subjects/bert -o bert`"""
GARBAGE_THRESHOLD = 20_000  # new objects per search for garbage: at Python's 700 the searches are a sixth of compiling
SOLVER_ERRORS = "UnstableError", "ConvergenceError"  # by name: to import them takes too long for --help


@cache
def app() -> App:
    """Return the parser of the whole command line, without importing anything heavy."""
    parser = new_app("morphofold", DESCRIPTION)
    parser.register_install_completion_command()
    for position, command in enumerate(COMMANDS.values()):
        if command is Theory:
            theory_app = parser.command(App(name="theory", help=command.__doc__, sort_key=position))
        else:
            parser.command(command, sort_key=position)
    for position, question_class in enumerate(Theory.__subclasses__()):
        theory_app.command(question_class, sort_key=position)
    return parser


def new_app(name: str, description: str | None) -> App:
    """Return a parser without commands; a command is a class of options, and parsing returns one of them."""
    return App(
        name=name,
        help=description,
        version=f"{name} {__version__}",
        help_format="markdown",
        default_parameter=Parameter(negative=()),
        result_action="return_value",
    )


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code, as ``run_app`` does."""
    return run_app(app(), _run_command, argv)


def _run_command(args: Options) -> Answer:
    gc.set_threshold(GARBAGE_THRESHOLD)
    if isinstance(args, command_options.Threaded):
        set_threads(args.threads)
    name = type(args).__name__.lower()
    if name in DRAWERS:
        return draw(name, args)  # type: ignore[no-any-return]
    return resolve_name(f"morphofold.cli.{args.work or f'{name}:run'}")(args)  # type: ignore[no-any-return]


def run_app(parser: App, run: Callable[[Any], Answer], argv: Sequence[str] | None) -> int:
    """Run what ``argv`` names, and return the exit code: 0 done, 1 the work failed, 2 bad input, 130 interrupted.

    ``run`` takes the options of the command.
    """
    for name in BLAS_VARIABLES:  # NumPy is not imported yet
        os.environ.setdefault(name, "1")
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # for a name that is not text, or an old terminal
    argv = sys.argv[1:] if argv is None else argv
    args: Any = None
    answer = Answer(None, [])
    program = " ".join([*parser.name, *(argument for argument in argv[:1] if argument in parser)])
    try:
        with warnings.catch_warnings(), _signals_as_interrupts():
            warnings.showwarning = lambda message, *_, **__: print_line(  # in one line, without the source line
                f"morphofold: warning: {message}", file=sys.stderr
            )
            args = parsed(parser, argv)
            answer = answer if args is None else run(args)  # none after --help and --version
            print_answer(answer, as_json=getattr(args, "json", False))
        sys.stdout.flush()
        return answer.code
    except BrokenPipeError:  # the reader, such as head, has read enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # what is left is flushed there
        return answer.code
    except BaseException as error:
        exit_code, error_text = _failure(error, getattr(args, "on_interrupt", ""))
        if not exit_code or ("--debug" in argv and exit_code != 130):
            raise
        line = one_line(" ".join([str(error_text).strip(), *getattr(error, "__notes__", ())])) or type(error).__name__
        print(f"{program}: {line}" + (f" [{code_of(error)}]" if exit_code == 2 else ""), file=sys.stderr)
        return exit_code


def parsed(parser: App, argv: Sequence[str]) -> Any:
    """The options of the command that ``argv`` names; None after --help and --version, which print.

    Raises
    ------
    BadUsage
        If an option is unknown, a value is missing, or can't be understood.
    OutOfRange
        If a number is outside the limits of its option.
    OptionsClash
        If options contradict each other.
    """
    for option, text in pairwise(["", *argv]):
        if text == "--":
            break
        if not text or "\0" in text or re.fullmatch(r"--?[\w-]+=", text):  # an empty path would be the current folder
            name = text.partition("=")[0] or (f"after {option}" if option.startswith("-") else "an argument")
            raise BadUsage(f"{name}: the value is empty, or contains a NUL. Give it a value, or leave it out.")
    try:
        command, bound_args, _ = parser.parse_args(argv, exit_on_error=False, print_error=False, help_on_error=False)
    except CycloptsError as error:
        raise _refusal_of(error, parser) from None
    options = command(*bound_args.args, **bound_args.kwargs)
    if isinstance(options, Options):
        options.check_rules(bound_args.arguments)
    return options


def _refusal_of(error: CycloptsError, parser: App) -> Refusal:
    argument, cause, text = error.argument, error.__cause__, str(error).strip()
    if isinstance(error, ValidationError) and argument is not None:
        return OutOfRange(f"{argument.name} {error.exception_message}")
    if isinstance(cause, Refusal):
        return cause
    if isinstance(error, MissingArgumentError) and argument is not None and argument.index is not None:
        text = f"{argument.name.strip('-').upper()} is missing."
    full_stop = "" if text.endswith((".", "?")) else "."
    return BadUsage(f"{text}{full_stop} See {' '.join([*parser.name, *(error.command_chain or ())])} --help.")


def _failure(error: BaseException, interrupt_note: str) -> tuple[int, object]:
    """Exit code of an error and its text; code 0 if it should pass."""
    if KeyboardInterrupt in (type(error), type(error.__cause__)):  # the cause: from compiled code
        return 130, f"interrupted.{interrupt_note}"
    if isinstance(error, OSError) and error.errno is not None:  # the system's message, not ours
        file_prefix = f"{error.filename}: " if error.filename is not None else ""
        cure = "Free space" if error.errno in DISK_FULL_ERRORS else "Name another file or folder"
        return 2, f"{file_prefix}{error.strerror}. {cure}."
    if isinstance(error, ValueError | TypeError | OSError):
        return 2, error
    if isinstance(error, MemoryError):
        text = str(error).rstrip(".") or "memory did not suffice"  # numpy gives the amount
        return 2, f"{text}. Close other programs, or ask for less."
    if isinstance(error, SystemError) or not isinstance(error, Exception):
        return 0, ""
    if isinstance(error, ImportError):
        from morphofold.optional_packages import with_cure

        with_cure(error)
        return 1, f"{error}." if hasattr(error, "__notes__") else error
    if type(error).__name__ in SOLVER_ERRORS:
        return 1, error
    return 1, f"{type(error).__name__}: {error} (a defect; --debug shows where)"


@contextmanager
def _signals_as_interrupts() -> Iterator[None]:
    """Treat SIGTERM and SIGHUP as Ctrl-C, so that half-written files are removed; only the main thread can do this.

    A signal that was ignored before (by nohup) stays ignored. A second one is ignored, too: a terminal and its shell
    both send one when they end, and half-written files have to be removed first.
    """
    signal_numbers = {signal.SIGTERM, getattr(signal, "SIGHUP", signal.SIGTERM)}  # Windows has one of them
    in_main_thread = threading.current_thread() is threading.main_thread()
    unhandled = [number for number in signal_numbers if in_main_thread and signal.getsignal(number) == signal.SIG_DFL]

    def interrupt(received: int, frame: object) -> NoReturn:
        for signal_number in unhandled:
            signal.signal(signal_number, signal.SIG_IGN)
        raise KeyboardInterrupt

    with ExitStack() as old_handlers:
        for number in unhandled:
            old_handlers.callback(signal.signal, number, signal.signal(number, interrupt))
        yield
