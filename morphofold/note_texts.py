"""Notes on measures, and the warnings among them: the texts of notes.toml."""

import tomllib
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
#: warnings that put all numbers of a surface in doubt, and those that put none in doubt; the others are about some
SEVERE_WARNINGS, SLIGHT_WARNINGS = (
    tuple(code for code, entry in _WARNINGS.items() if entry.get("level") == level) for level in ("severe", "slight")
)


def note(name: str, /, *keys: str, **values: Any) -> dict[str, str]:
    """The note of a name, its gaps filled with values, under that name or under other keys."""
    return dict.fromkeys(keys or (name,), NOTES[name].format(**values))
