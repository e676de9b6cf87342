"""Where commands may write."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path


def refuse_overlap(out: Path, inputs: Iterable[Path]) -> None:
    """Raise ``ValueError`` if writing ``out`` would replace a folder that the command reads, or one around it."""
    target = out.resolve()
    for source in inputs:
        place = source.resolve()
        if target == place or target in place.parents:
            raise ValueError(
                f"{out}: is, or holds, the input {source}, which writing there would replace; name another -o."
            )


def writable_name(name: str) -> str:
    """A subject's name as a folder's name: separators become dashes."""
    return name.replace("/", "-").replace("\\", "-").strip(". ") or "unnamed"
