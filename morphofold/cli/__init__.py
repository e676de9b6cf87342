"""The ``morphofold`` command: one module per subcommand, heavy imports inside ``run``."""

from __future__ import annotations

import argparse
import importlib
import os
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, NoReturn

from morphofold import __version__
from morphofold.cli.streams import one_line, print_line, standard_streams
from morphofold.errors import DISK_FULL_ERRORS, BadUsage, code_of
from morphofold.threads import BLAS_VARIABLES

PROGRAM = "morphofold"
#: subcommand -> its line in the overview
COMMANDS = {
    "demo": "grow a cortex, measure it and a real one, write the comparison",
    "simulate": "grow a scene into folds",
    "analyze": "measure a FreeSurfer subject, a simulation, or a pair of files",
    "compare": "put analyses side by side",
    "unfold": "unfold a cortex to a smooth surface with the same vertices",
    "cohort": "measure many subjects on several workers, and write tables and a page of the group",
    "overlap": "where subjects have hinges and crests, and how many they share, against chance",
    "stats": "test a model of age, sex and so on at every vertex of a cohort's maps on a template",
    "bids": "the same as cohort for a BIDS dataset, called like a BIDS-App",
    "sweep": "grow a scene with many values and seeds, and draw phase diagrams with the lines of theory",
    "theory": "radius, stress, creases and wrinkles of the growing sphere, without a simulation",
    "reproduce": "reproduce figures of the paper",
    "scenes": "list the built-in scenes",
}


#: of the overview of all commands
EXAMPLES = ("morphofold demo -o demo", "morphofold analyze subjects/bert -o bert")


class Parser(argparse.ArgumentParser):
    """Help begins with ``examples``. Errors are one line, and empty values are refused: an empty path would mean the
    current folder."""

    examples: Sequence[str] = ()

    def __init__(self, *args: Any, **options: Any):
        super().__init__(*args, **options)
        self.register("type", None, _non_empty_text)  # for every argument that is text

    def add_subparsers(self, **options: Any) -> Any:
        commands = super().add_subparsers(**options)
        commands.type = str  # the parser of the subcommand checks for empty values
        return commands

    def format_help(self) -> str:
        title = "Examples" if len(self.examples) > 1 else "Example"
        shown = "\n".join([f"{title}:", *(f"  {example}" for example in self.examples), "", ""])
        return (shown if self.examples else "") + super().format_help()

    def error(self, message: str) -> NoReturn:
        raise BadUsage(f"{message.rstrip('.')}. See {self.prog} --help.")


def _non_empty_text(text: str) -> str:
    if not text or "\0" in text:
        raise argparse.ArgumentTypeError("its value is empty" if not text else "its value contains a NUL")
    return text


def parser() -> argparse.ArgumentParser:
    """Return the parser of the whole command line, without importing anything heavy."""
    from rich_argparse import RichHelpFormatter

    top = Parser(
        prog=PROGRAM,
        description="Grow folded cortices, read real ones, and measure both with the same code.",
        formatter_class=RichHelpFormatter,
    )
    top.add_argument("--version", action="version", version=f"morphofold {__version__}")
    top.examples = EXAMPLES
    commands = top.add_subparsers(dest="command", metavar="COMMAND", required=True)
    for name, words in COMMANDS.items():
        module = importlib.import_module(f"morphofold.cli.{name}")
        sub = commands.add_parser(name, help=words, description=module.__doc__, formatter_class=RichHelpFormatter)
        sub.examples = module.EXAMPLES
        module.add_args(sub)
        add_shared(sub, default=False)
        sub.set_defaults(run=module.run)
    return top


def add_shared(parser: argparse.ArgumentParser, *, default: Any) -> None:
    """Add the options that every command has."""
    parser.add_argument("-q", "--quiet", action="store_true", default=default, help="show no progress")
    parser.add_argument("--debug", action="store_true", default=default, help="show the traceback of an error")


def add_options(parser: argparse.ArgumentParser, *options: tuple[str, str | None, str]) -> None:
    """Add options in the order given: their names, the name of the value (None: a flag), and the text of --help."""
    for names, value, words in options:
        kind: dict[str, Any] = {"action": "store_true"} if value is None else {"metavar": value}
        parser.add_argument(*names.split(), help=words, **kind)


def add_scene(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("scene", metavar="SCENE", help="a built-in scene (see morphofold scenes) or a TOML file")


def add_settings(parser: argparse.ArgumentParser, words: str) -> None:
    parser.add_argument("--set", dest="settings", metavar="TABLE.KEY=VALUE", action="append", default=[], help=words)


def add_threads(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--threads", type=int, metavar="N", help="threads (default: all cores)")


def add_questions(parser: Parser, words: Mapping[str, str], more: Mapping[str, str]) -> dict[str, Parser]:
    """Return a parser for each WHAT of a command, with its own of the command's examples; ``more`` is appended to the
    description of each."""
    questions = parser.add_subparsers(dest="what", metavar="WHAT", required=True)
    found = {
        name: questions.add_parser(
            name,
            help=choices,
            description=f"{choices[0].upper()}{choices[1:]}. {more.get(name, '')}",
            formatter_class=parser.formatter_class,
        )
        for name, choices in words.items()
    }
    for name, sub in found.items():
        sub.examples = [example for example in parser.examples if name in example.split()]
    return found


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code, as ``run_parser`` does."""
    return run_parser(PROGRAM, parser, argv)


def run_parser(program: str, build: Callable[[], argparse.ArgumentParser], argv: Sequence[str] | None) -> int:
    """Run what ``argv`` names, and return the exit code: 0 done, 1 the work failed, 2 bad input, 130 interrupted.

    If nobody reads the output any more, the work is still done, and the exit code stays the same. The parser that
    ``build`` returns sets ``run``; ``program`` begins each line on an error.
    """
    for name in BLAS_VARIABLES:  # NumPy is not imported yet
        os.environ.setdefault(name, "1")
    with standard_streams():
        try:
            args = build().parse_args(argv)
        except SystemExit as end:  # after --help or --version
            return int(end.code or 0)
        except BadUsage as error:
            return _print_failure(program, error, 2, error)
        except OSError as error:  # --help can't be written
            return _print_failure(program, f"standard output: {error.strerror}.", 2, error)
        return _run_parsed(args, f"{program} {vars(args).get('command', '')}".strip())


def _run_parsed(args: argparse.Namespace, program: str) -> int:
    try:
        with warnings.catch_warnings():
            warnings.showwarning = _show_warning
            with _signals_as_interrupts():
                code = args.run(args)
        sys.stdout.flush()
        return code
    except (KeyboardInterrupt, SystemError) as error:
        # a compiled kernel passes Ctrl-C on as the cause of a SystemError
        if isinstance(error, SystemError) and not isinstance(error.__cause__, KeyboardInterrupt):
            raise
        return _print_failure(program, f"interrupted.{getattr(args, 'on_interrupt', '')}", 130)
    except (ValueError, TypeError, OSError) as error:
        if args.debug:
            raise
        if isinstance(error, OSError) and error.errno is not None:  # the system's message, not ours
            where = f"{error.filename}: " if error.filename is not None else ""
            cure = "Free space" if error.errno in DISK_FULL_ERRORS else "Name another file or folder"
            return _print_failure(program, f"{where}{error.strerror}. {cure}.", 2, error)
        return _print_failure(program, error, 2, error)
    except MemoryError as error:
        if args.debug:
            raise
        line = str(error) or "memory did not suffice"  # numpy gives the amount
        more = "" if line.endswith(".") else ". Close other programs, or ask for less."
        return _print_failure(program, f"{line}{more}", 2, error)
    except Exception as error:
        if args.debug:
            raise
        known = "UnstableError", "ConvergenceError"  # not imported, so that --help is fast
        if isinstance(error, ImportError) or type(error).__name__ in known:
            return _print_failure(program, error, 1)
        return _print_failure(program, f"{type(error).__name__}: {error} (a defect; --debug shows where)", 1)


@contextmanager
def _signals_as_interrupts() -> Iterator[None]:
    """Treat SIGTERM and SIGHUP as Ctrl-C, so that half-written files are removed; only the main thread can do this.

    A signal that was ignored before (by nohup) stays ignored. A second SIGTERM or SIGHUP is ignored too: a terminal and
    its shell both send one when they end, and half-written files have to be removed first. An error after a signal
    counts as the interrupt: compiled code (numpy's ``tofile``) may raise one of its own in place of it.
    """
    ends = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]  # not on Windows
    usual: dict[int, Any] = {signal.SIGINT: signal.default_int_handler, **dict.fromkeys(ends, signal.SIG_DFL)}
    main_thread = threading.current_thread() is threading.main_thread()
    ours = [number for number in usual if main_thread and signal.getsignal(number) == usual[number]]
    came = []

    def interrupt(number: int, frame: object) -> NoReturn:
        came.append(number)
        for each in set(ours) - {signal.SIGINT}:
            signal.signal(each, signal.SIG_IGN)
        raise KeyboardInterrupt

    for number in ours:
        signal.signal(number, interrupt)
    try:
        yield
    except Exception:
        if came:
            raise KeyboardInterrupt from None
        raise
    finally:
        for number in ours:
            signal.signal(number, usual[number])


def _show_warning(message: Warning | str, *_: object, **__: object) -> None:
    """Print a warning in one line, without the source line."""
    print_line(f"morphofold: warning: {message}", file=sys.stderr)


def _print_failure(program: str, text: object, status: int, refused: BaseException | None = None) -> int:
    """Print the text of an error, and the code of a refusal; return the exit code."""
    line = one_line(" ".join([str(text).strip(), *getattr(text, "__notes__", ())])) or type(text).__name__
    if refused is not None:
        line += f" [{code_of(refused)}]"
    print(f"{program}: {line}", file=sys.stderr)
    return status
