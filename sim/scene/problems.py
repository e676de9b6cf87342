"""Messages about problems of a scene: the place, the key and what it must be, in terms of TOML."""

import difflib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel

from morphofold.errors import NotFinite, NotReadable, OutOfRange, Refusal, UnknownName, WrongShape
from morphofold.sim.scene import materials
from morphofold.sim.scene.effects import effect_names, options_of

Problem = Mapping[str, Any]
Loc = tuple[str | int, ...]

TAGGED_TABLES = ("geometry", "material")
MOST_SHOWN_CHARACTERS = 60  # characters of a wrong value that are shown


@dataclass(frozen=True)
class Source:
    """A text that was read, and its name in messages."""

    where: str
    text: str


def root_problems(problems: Iterable[Problem]) -> list[Problem]:
    """The problems without consequences of others: a list with wrong items is also reported as too short."""
    problems = list(problems)
    locs = [p["loc"] for p in problems]
    return [
        p
        for p in problems
        if p["type"] != "too_short" or not any(len(o) > len(p["loc"]) and o[: len(p["loc"])] == p["loc"] for o in locs)
    ]


def kind_of(problem: Problem) -> type[Refusal]:
    """The error class of a problem: that of morphofold's own check, or the one for pydantic's type."""
    own = problem.get("ctx", {}).get("error")
    return type(own) if isinstance(own, Refusal) else _ERROR_CLASSES.get(problem["type"], NotReadable)


def with_notes(lines: Sequence[str], kind: type[Refusal] = NotReadable) -> Refusal:
    """An error with the first line as its message and the others as its notes."""
    error = kind(lines[0])
    for line in lines[1:]:
        error.add_note(line)
    return error


def blamed(
    problem: Problem, settings: Sequence[tuple[str, str]], still: Callable[[Sequence[tuple[str, str]]], list[Problem]]
) -> str | None:
    """The setting, of (key, setting) pairs, that caused a problem; None if the scene itself did.

    This is the setting of the key itself. Otherwise it is one without which the problem disappears, or else changes:
    the first that the message names, or the last. ``still`` gives the problems that remain with fewer settings.
    """
    loc = _without_tag(problem["loc"])
    own = [given for key, given in settings if _parts_of_key(key) == loc[: len(_parts_of_key(key))]]
    if own:
        return own[-1]
    cures, changes = {}, {}
    for key, given in settings:
        left = [p for p in still([s for s in settings if s[0] != key]) if _same_problem(p, problem)]
        if not left:
            cures[key] = given
        elif all(p["msg"] != problem["msg"] for p in left):
            changes[key] = given
    for found in (cures, changes):
        if found:
            words = [word.strip(".,:;()") for word in problem["msg"].split()]
            named = [key for word in words for key in found if word in (key, key.split(".")[-1])]
            return found[named[0] if named else list(found)[-1]]
    if settings and not any(_same_problem(p, problem) for p in still([])):
        return settings[-1][1]
    return None


def explain(
    problem: Problem,
    sources: Sequence[Source],
    setting: str | None,
    model: type[BaseModel],
    shapes: Mapping[str, type[BaseModel]],
) -> str:
    """One problem as a message: where, which key, what is wrong, what to do.

    Parameters
    ----------
    problem : mapping
        One of pydantic's errors.
    sources : sequence of Source
        The file, then the scene that ``like`` names.
    setting : str or None
        The setting that caused the problem, instead of a line of a file.
    model, shapes
        The model of the scene, and its geometries by shape.
    """
    loc, shape = _without_tag(problem["loc"]), None
    if len(problem["loc"]) > 1 and problem["loc"][0] in TAGGED_TABLES:
        shape = str(problem["loc"][1])
    if problem["type"] == "shape":
        loc = (*loc, "shape")
    if setting is not None:
        at = f"setting {_shorten_text(setting)}"
    else:
        at = _file_and_line(sources, [str(part) for part in loc if isinstance(part, str)], problem["msg"])
    key = _key_in_words(loc)
    if problem["type"] == "extra_forbidden":
        return f"{at}: unknown key {key}. {_known_keys(loc, shape, model, shapes)}"
    got = problem["input"].get("shape") if problem["type"] == "shape" else problem["input"]
    shown = "" if problem["type"] == "missing" or isinstance(got, dict | BaseModel) else f" (got {as_toml(got)})"
    return f"{at}: {key}: {_requirement_of_key(problem, loc)}{shown}."


def as_toml(value: Any) -> str:
    """A value as in a scene file, shortened if it is long."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return _shorten_text(repr(value))
    if isinstance(value, list | tuple):
        return _shorten_text("[" + ", ".join(map(as_toml, value[:20])) + (", ..." if len(value) > 20 else "") + "]")
    if isinstance(value, int) and abs(value) >= 10**MOST_SHOWN_CHARACTERS:  # Python refuses to print the longest ones
        return f"a whole number of more than {MOST_SHOWN_CHARACTERS} digits"
    return _shorten_text(str(value))


def _requirement_of_key(problem: Problem, loc: Loc) -> str:
    """What a key must be."""
    context, last = problem.get("ctx", {}), loc[-1] if loc else ""
    kind = problem["type"]
    if kind == "missing":
        if isinstance(last, int):
            return "a number is missing"
        return (
            f"is missing; add it, for example {_EXAMPLES_OF_KEYS[str(last)]}"
            if last in _EXAMPLES_OF_KEYS
            else "is missing; add it"
        )
    if kind == "string_pattern_mismatch":
        return _PATTERN_MESSAGES.get(str(last), "has characters that are not allowed")
    if kind in _WORDS_OF_LIMITS:
        return f"must be {_WORDS_OF_LIMITS[kind]} {_format_number(next(iter(context.values())))}"
    if kind in ("string_too_short", "string_too_long"):
        least, most = context.get("min_length"), context.get("max_length")
        return f"must have {f'{least} character' if least else f'{most} characters'} at {'least' if least else 'most'}"
    if kind == "too_short":
        return f"must hold at least {context['min_length']} item"
    if kind == "too_long":
        return f"must hold {context['max_length']} items, not {context['actual_length']}"
    if kind == "literal_error":
        return f"must be {context['expected']}"
    return _TOML_MESSAGES.get(kind) or problem["msg"].removeprefix("Value error, ")


_WORDS_OF_LIMITS = {
    "greater_than": "greater than",
    "greater_than_equal": "greater than or equal to",
    "less_than": "less than",
    "less_than_equal": "less than or equal to",
}
#: error classes by pydantic's types of problems; any other type is ``NotReadable``
_ERROR_CLASSES: dict[str, type[Refusal]] = {
    **dict.fromkeys(_WORDS_OF_LIMITS, OutOfRange),
    "finite_number": NotFinite,
    **dict.fromkeys(("too_short", "too_long"), WrongShape),
    **dict.fromkeys(("extra_forbidden", "literal_error", "shape", "material"), UnknownName),
}
#: messages for pydantic's types of problems, in terms of TOML
_TOML_MESSAGES = {
    "model_type": "must be a table of keys",
    "dict_type": "must be a table of keys",
    "tuple_type": "must be a list in [ ]",
    "float_type": "must be a number",
    "int_type": "must be a whole number",
    "string_type": "must be text in quotes",
    "bool_type": "must be true or false",
    "finite_number": "must be a finite number",
}
_PATTERN_MESSAGES = {
    "name": "must begin with a letter or a digit, and contain only letters, digits, spaces and . _ + -",
    "title": "must be one line of text, without control characters",
}
_EXAMPLES_OF_KEYS = {
    "name": 'name = "mine"',
    "file": 'file = "body.vtu"',
    "shape": 'shape = "smooth"',
    "at": "at = [[0.0, 0.0, 50.0]]",
    "centre": "centre = [0.0, 0.0, 50.0]",
    "radius": "radius = 20.0",
    "factor": "factor = 0.5",
    "spots": "spots = [{centre = [0.0, 0.0, 50.0], radius = 20.0, factor = 0.5}]",
}


def _known_keys(loc: Loc, shape: str | None, model: Any, shapes: Mapping[str, type[BaseModel]]) -> str:
    """The keys that are allowed in place of an unknown one."""
    names: Sequence[str] = effect_names()
    if loc[0] == "effects" and len(loc) > 2:
        model, loc = options_of(str(loc[1])), loc[2:]
    elif loc[0] == "material":
        model, loc = materials.options_of(shape or materials.DEFAULT_MATERIAL), loc[1:]
    for part in (part for part in loc[:-1] if isinstance(part, str)):
        inner = _table_in_annotation(model.model_fields[part].annotation, model)
        model = shapes[shape] if part == "geometry" and shape else inner
    if loc[0] != "effects":
        names = list(model.model_fields)
    close = difflib.get_close_matches(str(loc[-1]), names, n=1)
    if close:
        return f"Did you mean {close[0]}?"
    return f"Known here: {', '.join(names)}." if names else "It has no options."


def _table_in_annotation(annotation: Any, otherwise: Any) -> Any:
    """The table inside an annotation, such as ``Spot`` of ``tuple[Spot, ...]``."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    found = [_table_in_annotation(option, None) for option in getattr(annotation, "__args__", ())]
    return next((table for table in found if table is not None), otherwise)


def _without_tag(loc: Loc) -> Loc:
    """The place without the tag of its geometry or material."""
    return (loc[0], *loc[2:]) if loc and loc[0] in TAGGED_TABLES else tuple(loc)


def _parts_of_key(key: str) -> Loc:
    return tuple(part.strip() for part in key.split("."))


def _same_problem(one: Problem, other: Problem) -> bool:
    return (one["type"], one["loc"]) == (other["type"], other["loc"])


def _key_in_words(loc: Loc) -> str:
    """``table.key``, with the number of a list item, counted from 1."""
    words = ""
    for part in loc:
        words += f", item {part + 1}" if isinstance(part, int) else f"{', ' if 'item' in words else '.'}{part}"
    return words.lstrip(".,") or ("scene" if not loc else '""')


def _format_number(value: float) -> str:
    return f"{value:.0f}" if value == int(value) and abs(value) < 1e9 else f"{value:g}"


def _shorten_text(text: str) -> str:
    text = " ".join(text.split())  # one line
    return text if len(text) <= MOST_SHOWN_CHARACTERS else f"{text[: MOST_SHOWN_CHARACTERS - 4]} ..."


def _file_and_line(sources: Sequence[Source], loc: list[str], message: str) -> str:
    """File and line of a key that the message names, else of the key at ``loc``, else of its table."""
    words = [word.strip(".,:;()").split(".") for word in message.split()]
    for keys, exact in (([loc + word for word in words], True), ([loc], True), ([loc], False)):
        for source in sources:
            for key in keys:
                if line := _line_of_key(source.text, key, exact):
                    return f"{source.where}, line {line}"
    return sources[0].where


def _line_of_key(text: str, loc: list[str], exact: bool = False) -> int | None:
    """Line of the key at ``loc``, or (unless ``exact``) of its table, or None."""
    table: list[str] = []
    best = None
    for number, raw in enumerate(text.splitlines(), 1):
        line = raw.split("#")[0].strip()
        if line.startswith("["):
            table = line.strip("[] ").split(".")
            if table == loc:
                return number
            if table == loc[:-1] and not exact:
                best = number
        elif "=" in line:
            key = table + line.split("=")[0].strip().strip('"').split(".")
            if key == (loc if exact else loc[: len(key)]):
                return number
    return best
