"""Generated parts of docs/commands: the options of every command, taken from the parser.

``python -m morphofold.studies.pages.command_pages docs/commands`` writes them between the marks ``<!-- options -->``
and ``<!-- /options -->`` of each command's page, and the list of commands between the marks ``commands`` in index.md.
"""

import sys
import textwrap
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from cyclopts import App
from cyclopts.argument import Argument

from morphofold.cli import COMMANDS, app
from morphofold.io.files import write_text
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
    marked = {folder / "index.md": ("commands", [overview()])}
    marked |= {folder / f"{name}.md": ("options", list(options(name))) for name in COMMANDS}
    texts = {page: between_marks(page.read_text("utf-8"), mark, parts, page) for page, (mark, parts) in marked.items()}
    for page, text in texts.items():
        write_text(page, text)


def overview() -> str:
    """Table with a line per command."""
    summary_of = {name: (command.__doc__ or "").partition("\n")[0].rstrip(".") for name, command in COMMANDS.items()}
    return table(["command", "what it does"], [[f"[{name}]({name}.md)", text] for name, text in summary_of.items()])


def options(command_name: str) -> Iterator[str]:
    """Headings, descriptions and tables of a command, and of the commands below it."""
    for name_path, command in commands_below(app()[command_name], command_name):
        if name_path != (command_name,):
            yield f"### morphofold {' '.join(name_path)}"
            help_text = " ".join(command.help.partition("For example:")[0].split())
            yield textwrap.fill(help_text, 120, break_on_hyphens=False)
        yield from _usage_and_options(command, " ".join(("morphofold", *name_path)))


def commands_below(command: App, *path: str) -> Iterator[tuple[tuple[str, ...], App]]:
    """The commands that do work, by what is typed: ``command`` itself, or the commands below it."""
    subcommands = [subcommand for subcommand in command if not subcommand.startswith("-")]
    for subcommand in subcommands:
        yield from commands_below(command[subcommand], *path, subcommand)
    if not subcommands:
        yield path, command


def _usage_and_options(command: App, program: str) -> Iterator[str]:
    """Usage of a command in one line, and a table of its arguments."""
    arguments = sorted(command.assemble_argument_collection(parse_docstring=True), key=_order)
    positionals = [_positional(argument) for argument in arguments if argument.index is not None]
    yield f"`{' '.join([program, *positionals, '[options]'])}`"
    yield table(["option", "meaning"], [[_spelling(a), meaning(a)] for a in arguments])


def _order(argument: Argument) -> tuple[bool, int]:
    """Arguments first, then own options, then groups of shared ones as in ``--help``."""
    option_groups: Any = argument.parameter.group or ()
    return argument.index is None, max((group.sort_key or 0 for group in option_groups), default=0)


def _positional(argument: Argument) -> str:
    shown_name = argument.name.lstrip("-").upper()
    shown_name = f"{shown_name}..." if "list" in str(argument.hint) else shown_name
    return shown_name if argument.required else f"[{shown_name}]"


def _spelling(argument: Argument) -> str:
    if argument.index is not None:
        return f"`{_positional(argument)}`"
    *short_names, long_name = sorted(argument.parameter.name or (), key=len)
    word = value_word(argument)
    return ", ".join([*(f"`{name}`" for name in short_names), f"`{long_name} {word}`" if word else f"`{long_name}`"])


def value_word(argument: Argument) -> str:
    if choices := argument.get_choices():
        return f"{{{','.join(choices)}}}"
    type_words = {"bool": "", "int": "INT", "float": "FLOAT", "Path": "PATH"}
    type_text = str(argument.hint)
    type_word = next((word for type_name, word in type_words.items() if type_name in type_text), "TEXT")
    return f"{type_word}..." if argument.parameter.consume_multiple else type_word


def meaning(argument: Argument) -> str:
    help_text = " ".join((argument.parameter.help or "").split()).replace("|", "\\|").replace("<", "&lt;")
    default = argument.field_info.default
    has_default = argument.show_default and not argument.required and default not in (None, argument.field_info.empty)
    return f"{help_text} Default: {default}." if has_default else help_text


if __name__ == "__main__":
    write_pages(Path(sys.argv[1]))
