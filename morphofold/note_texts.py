"""Notes on measures, and the warnings among them: the texts of notes.toml."""

import tomllib
from collections.abc import Container
from pathlib import Path
from typing import Any

_TOML: dict[str, Any] = tomllib.loads(Path(__file__).with_name("notes.toml").read_text("utf-8"))
_WARNINGS: dict[str, dict[str, str]] = _TOML["warnings"]
#: texts of notes by name, with gaps
NOTES: dict[str, str] = _TOML["notes"] | {code: entry["note"] for code, entry in _WARNINGS.items() if "note" in entry}
#: how the cortex was found, by the word of ``mesh_quality.cortex_checks.cortex_label``
MASK_SOURCES: dict[str, str] = _TOML["cortex_mask"]
#: notes that commands also print as warnings, by code: cause and cure (docs/messages.md)
WARNINGS = {code: (entry["cause"], entry["cure"]) for code, entry in _WARNINGS.items()}
#: level of each warning: a severe one puts all numbers of a surface in doubt, a slight one none, the others some
LEVELS = {code: entry.get("level", "check") for code, entry in _WARNINGS.items()}
VERDICTS = {"severe": "leave out", "check": "check", "slight": "use"}  # by the level of the worst warning


def note(name: str, /, *keys: str, **values: Any) -> dict[str, str]:
    """The note of a name, its gaps filled with values, under that name or under other keys."""
    return dict.fromkeys(keys or (name,), NOTES[name].format(**values))


def verdict(notes: Container[str]) -> tuple[str, tuple[str, ...]]:
    """Whether to use a surface with these notes, and the codes of the warnings that speak against it, the worst first.

    "leave out" if a warning puts all its numbers in doubt, "check" if one puts some in doubt, else "use".
    """
    reasons = [code for level in ("severe", "check") for code in WARNINGS if LEVELS[code] == level and code in notes]
    return VERDICTS[LEVELS[reasons[0]] if reasons else "slight"], tuple(reasons)
