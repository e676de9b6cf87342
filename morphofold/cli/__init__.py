"""The ``morphofold`` command: one module per subcommand, heavy imports inside ``run``."""

from __future__ import annotations

import argparse
import importlib
import io
import os
import signal
import sys
import threading
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from morphofold import __version__

#: subcommand -> what the overview says of it
COMMANDS = {
    "demo": "grow a cortex, measure it and a real one, write the comparison",
    "simulate": "grow a scene into folds",
    "analyze": "measure a FreeSurfer subject, a simulation, or a pair of files",
    "compare": "put analyses side by side",
    "cohort": "measure many subjects on several workers, and put them into tables and a page of the group",
    "bids": "the same for a BIDS dataset, called as BIDS-Apps are",
    "sweep": "grow a scene with many values and seeds, and draw phase diagrams with the theory in them",
    "theory": "radius, stress, creases and wrinkles of the growing sphere, without simulating it",
    "reproduce": "draw figures of the paper anew",
    "scenes": "list the built-in scenes",
    "bench": "measure speed on this machine, and how far folds agree",
}


def parser() -> argparse.ArgumentParser:
    """The whole command line, without importing anything heavy."""
    from rich_argparse import RichHelpFormatter

    top = argparse.ArgumentParser(
        prog="morphofold",
        description="Grow folded cortices, read real ones, and measure both with the same ruler.",
        formatter_class=RichHelpFormatter,
    )
    top.add_argument("--version", action="version", version=f"morphofold {__version__}")
    commands = top.add_subparsers(dest="command", metavar="COMMAND", required=True)
    for name, words in COMMANDS.items():
        module = importlib.import_module(f"morphofold.cli.{name}")
        sub = commands.add_parser(name, help=words, description=module.__doc__, formatter_class=RichHelpFormatter)
        module.add_args(sub)
        add_shared(sub, default=False)
        sub.set_defaults(run=module.run)
    return top


def add_shared(parser: argparse.ArgumentParser, *, default: Any) -> None:
    """The options that every command has."""
    parser.add_argument("-q", "--quiet", action="store_true", default=default, help="no progress")
    parser.add_argument("--debug", action="store_true", default=default, help="show the traceback of an error")


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; 0 done, 1 the work itself failed, 2 bad input or usage, 130 interrupted."""
    if isinstance(sys.stdout, io.TextIOWrapper):                        # as standard error does: names may be no text
        sys.stdout.reconfigure(errors="backslashreplace")
    try:
        args = parser().parse_args(argv)
    except OSError as error:                                            # no room for --help
        return _fail("", f"standard output: {error.strerror}.", 2)
    try:
        with warnings.catch_warnings():
            warnings.showwarning = _one_line
            with _terminated_as_interrupted():
                code = args.run(args)
        sys.stdout.flush()
        return code
    except BrokenPipeError:                                             # whoever read our words has had enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except (KeyboardInterrupt, SystemError) as error:
        # a compiled kernel hands Ctrl-C on as the cause of a SystemError
        if isinstance(error, SystemError) and not isinstance(error.__cause__, KeyboardInterrupt):
            raise
        print(f"morphofold {args.command}: interrupted.{getattr(args, 'on_interrupt', '')}", file=sys.stderr)
        return 130
    except (ValueError, TypeError, OSError, ImportError) as error:
        if args.debug:
            raise
        if isinstance(error, OSError) and error.errno is not None:      # the system's own words, not ours
            where = f"{error.filename}: " if error.filename is not None else ""
            return _fail(args.command, f"{where}{error.strerror}. Name another place to read or write.", 2)
        return _fail(args.command, error, 2)
    except MemoryError as error:
        if args.debug:
            raise
        told = str(error) or "memory did not suffice"                   # numpy says how much it wanted
        more = "" if told.endswith(".") else ". Close other programs, or ask for less."
        return _fail(args.command, f"{told}{more}", 2)
    except Exception as error:
        if args.debug:
            raise
        if type(error).__name__ in ("UnstableError", "ConvergenceError"):      # not imported for the sake of --help
            return _fail(args.command, error, 1)
        return _fail(args.command, f"{type(error).__name__}: {error} (a defect; --debug shows where)", 1)


@contextmanager
def _terminated_as_interrupted() -> Iterator[None]:
    """SIGTERM as Ctrl-C, so that what is half written is removed; the main thread alone can say so."""
    if threading.current_thread() is not threading.main_thread() or signal.getsignal(signal.SIGTERM) != signal.SIG_DFL:
        yield
        return
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


def _one_line(message: Warning | str, *_: object, **__: object) -> None:
    """A warning as the users of a command want it: without the source line."""
    print(f"morphofold: warning: {message}", file=sys.stderr)


def _fail(command: str, error: object, code: int) -> int:
    lines = str(error).strip().splitlines() or [type(error).__name__]
    for line in lines:
        print(f"morphofold {command}".strip() + f": {line}", file=sys.stderr)
    return code
