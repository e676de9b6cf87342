"""Generated parts of docs/commands: the options of every command, taken from the parser.

``python -m morphofold.studies.pages.commands docs/commands`` writes them between the marks ``<!-- options -->`` and
``<!-- /options -->`` of each command's page, and the list of commands between the marks ``commands`` in index.md.
"""

from __future__ import annotations

import argparse
import sys
import textwrap
from collections.abc import Iterator
from pathlib import Path

from morphofold.cli import COMMANDS, parser
from morphofold.io import atomic_file
from morphofold.studies.markdown import between_marks, table


def write_pages(folder: Path) -> None:
    """Write the marked parts of the pages in ``folder`` again.

    Raises
    ------
    FileNotFoundError
        If a command has no page.
    MissingPart
        If a page does not have exactly one pair of marks. No page is changed then.
    """
    texts = {folder / "index.md": ("commands", [overview()])}
    texts |= {folder / f"{name}.md": ("options", list(options(name))) for name in COMMANDS}
    renewed = {page: between_marks(page.read_text("utf-8"), mark, parts, page) for page, (mark, parts) in texts.items()}
    for page, text in renewed.items():
        with atomic_file(page) as temporary:
            temporary.write_text(text, encoding="utf-8")


def overview() -> str:
    """Table with a line per command."""
    return table(["command", "what it does"], [[f"[{name}]({name}.md)", words] for name, words in COMMANDS.items()])


def options(name: str) -> Iterator[str]:
    """Headings, descriptions and tables of a command, and of the commands below it."""
    command = subcommands(parser())[name]
    below = subcommands(command)
    if not below:
        yield from _usage_and_options(command)
    for sub in below.values():
        yield f"### {sub.prog}"
        yield textwrap.fill(" ".join((sub.description or "").split()), 120, break_on_hyphens=False)
        yield from _usage_and_options(sub)


def subcommands(command: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    """The commands below a command, by name."""
    found = (a.choices for a in command._actions if isinstance(a, argparse._SubParsersAction))
    return dict(next(found, {}) or {})


def _usage_and_options(command: argparse.ArgumentParser) -> Iterator[str]:
    """Usage of a command in one line, and a table of its arguments."""
    plain = argparse.HelpFormatter(command.prog)
    taken = [a for a in command._actions if a.dest != "help"]
    given = [_argument_metavar(plain, a) for a in taken if not a.option_strings]
    yield f"`{' '.join([command.prog, *given, '[options]'])}`"
    yield table(
        ["option", "meaning"], [[_option_spelling(plain, a), _table_cell(plain._expand_help(a))] for a in taken]
    )


def _option_spelling(plain: argparse.HelpFormatter, action: argparse.Action) -> str:
    value = _argument_metavar(plain, action)
    if not action.option_strings:
        return f"`{value}`"
    *short, long = action.option_strings
    return ", ".join([*(f"`{word}`" for word in short), f"`{long} {value}`" if value else f"`{long}`"])


def _argument_metavar(plain: argparse.HelpFormatter, action: argparse.Action) -> str:
    name = (
        plain._get_default_metavar_for_positional
        if not action.option_strings
        else (plain._get_default_metavar_for_optional)
    )
    return plain._format_args(action, name(action)) if action.nargs != 0 else ""


def _table_cell(words: str) -> str:
    return " ".join(words.split()).replace("|", "\\|").replace("<", "&lt;")


if __name__ == "__main__":
    write_pages(Path(sys.argv[1]))
