"""The tables of docs/messages.md: every code of a refusal, with cause and cure.

``python -m morphofold.studies.pages.messages docs/messages.md`` puts them between the marks of that page.
"""

from __future__ import annotations

import sys
from pathlib import Path

from morphofold.errors import Refusal
from morphofold.studies.markdown import renewed, table, write_texts


def refusals() -> str:
    """A row for each kind of refusal: its code, class, cause and cure."""
    return table(("code", "class", "cause", "cure"), [
        (f"`{kind.code}`", f"`{kind.__name__}`", " ".join((kind.__doc__ or "").split()), kind.cure)
        for kind in Refusal.__subclasses__()
    ])  # fmt: skip


def write(page: Path) -> None:
    """Put the tables between the marks of ``page``; raises as :func:`morphofold.studies.markdown.renewed`."""
    write_texts({page: renewed(page, page.read_text(encoding="utf-8"), {"refusals": [refusals()]})})


if __name__ == "__main__":
    write(Path(sys.argv[1]))
