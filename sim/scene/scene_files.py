"""Scenes from TOML files, built-in names and ``table.key=value`` settings, and back to TOML.

What pydantic finds wrong is told with the file and line, or the setting, that it comes from.
"""

import difflib
import json
import os
import re
import tomllib
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError

from morphofold.errors import (
    DoesNotApply,
    NotFinite,
    NotReadable,
    OutOfRange,
    Refusal,
    UnknownName,
    WrongFile,
    WrongShape,
)
from morphofold.io.files import existing_file
from morphofold.sim.scene import Scene
from morphofold.sim.scene.geometries import path_or_sample

BUILT_IN = Path(__file__).parent.parent / "scenes"
MOST_PROBLEMS = 20  # that are reported for one scene
MOST_SHOWN_CHARACTERS = 60  # characters of a wrong value that are shown
#: error classes by pydantic's types of problems; any other type is ``NotReadable``
ERROR_CLASSES: dict[str, type[Refusal]] = {
    **dict.fromkeys(("greater_than", "greater_than_equal", "less_than", "less_than_equal"), OutOfRange),
    "finite_number": NotFinite,
    **dict.fromkeys(("too_short", "too_long"), WrongShape),
    **dict.fromkeys(("literal_error", "unknown_name"), UnknownName),
}

Problem = Mapping[str, Any]  # one of pydantic's errors
Key = tuple[str, ...]
#: pairs of a key and the setting that changes it
Settings = Sequence[tuple[Key, str]]


@dataclass(frozen=True)
class Source:
    """A text that was read, and its name in messages."""

    name: str
    text: str

    @cached_property
    def tables(self) -> dict[str, Any]:
        try:
            return tomllib.loads(self.text)
        except (ValueError, RecursionError) as error:  # a number of too many digits is not a TOMLDecodeError
            raise NotReadable(f"{self.name}: not a TOML file: {error}.") from None

    @cached_property
    def lines(self) -> dict[Key, int]:
        """Line of each key and each table."""
        line_numbers: dict[Key, int] = {}
        table_key: Key = ()
        for line_number, raw_line in enumerate(self.text.splitlines(), 1):
            line = raw_line.split("#")[0].strip()
            if line.startswith("["):
                table_key = tuple(line.strip("[] ").split("."))
                line_numbers.setdefault(table_key, line_number)
            elif "=" in line:
                line_numbers.setdefault(table_key + tuple(line.split("=")[0].strip(' "').split(".")), line_number)
        return line_numbers


def scene_names() -> list[str]:
    """Names of the built-in scenes."""
    return sorted(path.stem for path in BUILT_IN.glob("*.toml"))


def load_scene(source: str | Path | Scene, settings: Iterable[str] = ()) -> Scene:
    """A scene from a built-in name, a TOML file or a ``Scene``, changed by ``table.key=value`` settings.

    A file can name another scene with ``like``: a built-in one, or a file. The values of this file replace those of
    that scene. Files are named by their paths from the folder of the file that names them, in settings from the working
    folder. If a file or a setting changes ``growth.final`` but not ``output.stages``, stages beyond it are dropped. If
    it sets ``accuracy.level`` but not ``accuracy.edge``, the edge is dropped, because it would overrule the level.

    Raises
    ------
    FileNotFoundError
        If there is neither a built-in scene nor a file of that name.
    ValueError
        If the file is not TOML, or contains something unknown, impossible or contradictory. The message is the first
        problem, with its line or setting; the other problems are notes of the error.
    """
    own_source = Source(source.name, to_toml(source)) if isinstance(source, Scene) else _read_source(source)
    set_keys = [(_key_of_setting(setting), setting) for setting in settings]
    base_source = _base_scene(own_source, None if isinstance(source, Scene) else Path(source).parent)
    scene, problems = _validated(own_source, base_source, set_keys)
    if scene is not None:
        return scene
    sources: list[Source] = [source for source in (own_source, base_source) if source is not None]
    if set_keys and _validated(own_source, base_source, [])[0] is not None:  # only the settings are to blame
        sources = [Source(f"setting{'s' * (len(set_keys) > 1)} {', '.join(_shortened(s) for _, s in set_keys)}", "")]
    messages = [f"{_origin(p, set_keys, sources)}: {_text_of_problem(p)}." for p in problems[:MOST_PROBLEMS]]
    if len(problems) > MOST_PROBLEMS:
        messages.append(f"{own_source.name}: {len(problems) - MOST_PROBLEMS:,} more problems.")
    cause = problems[0].get("ctx", {}).get("error")
    error_class = type(cause) if isinstance(cause, Refusal) else ERROR_CLASSES.get(problems[0]["type"], NotReadable)
    raise with_notes(messages, error_class)


def _validated(own_source: Source, base: Source | None, settings: Settings) -> tuple[Scene | None, list[Problem]]:
    """The scene, or its problems without consequences of others: a list with wrong items is also too short."""
    try:
        return Scene.model_validate(_tables_of_scene(own_source, base, settings)), []
    except ValidationError as error:
        problems: list[Problem] = [*error.errors()]
    parents = {problem["loc"][:n_parts] for problem in problems for n_parts in range(len(problem["loc"]))}
    return None, [problem for problem in problems if problem["type"] != "too_short" or problem["loc"] not in parents]


def _read_source(source: str | Path) -> Source:
    path, names = Path(source), scene_names()
    if str(source) in names:
        path = BUILT_IN / f"{source}.toml"
    elif os.path.lexists(path):
        existing_file(path, "TOML file of a scene")
    else:
        similar_names = difflib.get_close_matches(str(source), names, n=1)
        hint_text = f"Did you mean {similar_names[0]}?" if similar_names else f"Built-in scenes: {', '.join(names)}."
        raise FileNotFoundError(f"no scene file or built-in scene {str(source)!r}. {hint_text}")
    try:
        return Source(str(Path(source)), path.read_text("utf-8"))
    except UnicodeDecodeError:
        raise NotReadable(f"{path}: not a TOML file: it is not UTF-8 text.") from None


def _base_scene(own_source: Source, folder: Path | None) -> Source | None:
    """The scene that ``like`` names: built in, or a file by its path from ``folder``."""
    if "like" not in own_source.tables:
        return None
    like = own_source.tables["like"]
    if not isinstance(like, str):
        raise NotReadable(f'{own_source.name}: like must name a scene, such as like = "fig5" (got {_shortened(like)}).')
    try:
        base_source = _read_source(like if folder is None or like in scene_names() else folder / like)
        if "like" in base_source.tables:
            raise WrongFile("uses like itself; name the scene that it is like.")
    except (FileNotFoundError, ValueError) as error:
        raise type(error)(f"{own_source.name}: like = {like!r}: {error}") from None
    return base_source


def _tables_of_scene(own_source: Source, base_source: Source | None, settings: Settings) -> dict[str, Any]:
    """The tables of a scene: its own replace those of its base, the settings replace both."""
    own_tables = _with_paths(own_source.tables, Path(own_source.name).parent)
    own_tables.pop("like", None)
    tables, passed_tables = own_tables, dict[str, Any]()
    if base_source is not None:
        tables = _merge_tables(_with_paths(base_source.tables, Path(base_source.name).parent), own_tables)
        _drop_overruled(tables, own_tables)
    for key, setting in settings:
        _apply_setting(tables, key, setting)
        _apply_setting(passed_tables, key, setting)
    _drop_overruled(tables, passed_tables)
    return _with_paths(tables, Path())  # those of settings are from the working folder


def _drop_overruled(tables: dict[str, Any], own_tables: Mapping[str, Any]) -> None:
    """Drop stages beyond a final growth, and the edge beside a level, that ``own_tables`` set without them."""
    growth, accuracy_table = (_table_or_empty(own_tables, table_name) for table_name in ("growth", "accuracy"))
    output_table = _table_or_empty(tables, "output")
    if isinstance(final := growth.get("final"), int | float) and "stages" not in _table_or_empty(own_tables, "output"):
        if isinstance(stages := output_table.get("stages"), list):
            output_table["stages"] = [g for g in stages if not isinstance(g, int | float) or g <= final]
    if "level" in accuracy_table and "edge" not in accuracy_table:
        _table_or_empty(tables, "accuracy").pop("edge", None)


def _with_paths(tables: dict[str, Any], folder: Path, table: str = "") -> dict[str, Any]:
    """The tables with the absolute path of each file that they name by its path from ``folder``.

    A file that exists only by its path from the working folder, the rule up to version 0.3, is taken with a warning.
    Samples, and a subject's maps and spheres, keep their names.
    """
    resolved = dict(tables)
    for key, value in tables.items():
        if isinstance(value, dict):
            resolved[key] = _with_paths(value, folder, key)
        if key not in ("file", "subject", "sphere") or not isinstance(value, str):
            continue
        path, found_path = folder / value, path_or_sample(value)
        if key != "subject" and re.fullmatch(r"[\w-]+", value) and not os.path.lexists(path):
            continue  # the name of a map or a sphere
        if not os.path.lexists(path) and found_path.exists():
            if found_path != Path(value):
                continue
            warnings.warn(
                f"{table}.{key} = {value!r}: is found from the working folder, not from {folder}, the folder of its "
                "scene. Later versions will not read it: give its path from the scene.",
                stacklevel=2,
            )
            path = found_path
        if os.path.lexists(path) or (table == "geometry" and key != "sphere"):
            resolved[key] = os.path.abspath(path)
    return resolved


def _merge_tables(base_tables: dict[str, Any], own_tables: dict[str, Any]) -> dict[str, Any]:
    merged = dict(base_tables)
    for key, value in own_tables.items():
        both_are_tables = isinstance(value, dict) and isinstance(merged.get(key), dict)
        merged[key] = _merge_tables(merged[key], value) if both_are_tables else value
    return merged


def _key_of_setting(setting: str) -> Key:
    """``table.key`` of ``table.key=value``."""
    name, equals_sign, _ = setting.partition("=")
    key = tuple(part.strip() for part in name.split("."))
    if not equals_sign or not all(key):
        raise NotReadable(f"setting {setting!r} must have the form table.key=value, for example growth.final=1.8.")
    if key == ("like",):
        raise DoesNotApply(
            f"setting {setting!r}: 'like' is allowed only in a file; pass the scene that it names instead."
        )
    return key


def _apply_setting(tables: dict[str, Any], key: Key, setting: str) -> None:
    """Put the value of ``table.key=value`` into the tables."""
    value_text = setting.partition("=")[2].strip()
    try:
        parsed_tables = tomllib.loads(f"v = {value_text}")
    except (ValueError, RecursionError):
        parsed_tables = {}
    table = tables
    for table_name in key[:-1]:
        table = table.setdefault(table_name, {})
        if not isinstance(table, dict):
            raise NotReadable(f"setting {setting!r}: {table_name!r} is a value, not a table.")
    table[key[-1]] = parsed_tables["v"] if list(parsed_tables) == ["v"] else value_text  # a bare word is a string


def _table_or_empty(tables: Mapping[str, Any], name: str) -> dict[str, Any]:
    """The table ``name``, empty if there is none."""
    table = tables.get(name)
    return table if isinstance(table, dict) else {}


def _origin(problem: Problem, settings: Settings, sources: Sequence[Source]) -> str:
    """The setting, or the file and line, of the key of a problem, of one that the message names, or of its table."""
    loc = tuple(part for part in problem["loc"] if isinstance(part, str))
    named_keys = [tuple(named_key.strip(".,:;()").split(".")) for named_key in problem["msg"].split()]
    key_settings = [setting for key, setting in settings if key == loc[: len(key)]]
    named = [setting for named_key in named_keys for key, setting in settings if key in (named_key, loc + named_key)]
    for setting in (*key_settings[::-1], *named):
        return f"setting {_shortened(setting)}"
    for key_group in ([loc + named_key for named_key in named_keys], *([loc[:end]] for end in range(len(loc), 0, -1))):
        for source in sources:
            for key in key_group:
                if key in source.lines:
                    return f"{source.name}, line {source.lines[key]}"
    return sources[0].name


def _text_of_problem(problem: Problem) -> str:
    """Key, requirement and value."""
    key_text, value = "", problem["input"]
    for part in problem["loc"]:
        key_text += f", item {part + 1}" if isinstance(part, int) else f"{', ' if 'item' in key_text else '.'}{part}"
    text = re.sub(r"^\w+ should", "must", problem["msg"].removeprefix("Value error, "))
    if not isinstance(value, dict | BaseModel):
        text += f" (got {_shortened(repr(value) if isinstance(value, str) else value)})"
    return f"{key_text.lstrip('.,') or 'scene'}: {text}"


def _shortened(value: Any) -> str:
    """A value as in a scene file, or a text, in one line."""
    text = " ".join((value if isinstance(value, str) else toml_value(value)).split())
    return text if len(text) <= MOST_SHOWN_CHARACTERS else f"{text[: MOST_SHOWN_CHARACTERS - 4]} ..."


def with_notes(lines: Sequence[str], error_class: type[Refusal] = NotReadable) -> Refusal:
    """An error with the first line as its message and the others as its notes."""
    error = error_class(lines[0])
    for line in lines[1:]:
        error.add_note(line)
    return error


def to_toml(scene: Scene) -> str:
    """A scene as TOML, with every value."""
    return _tables_as_toml(scene.model_dump(exclude_none=True))


def _tables_as_toml(tables: Mapping[str, Any], prefix: str = "") -> str:
    lines = [f"{key} = {toml_value(value)}" for key, value in tables.items() if not isinstance(value, dict)]
    for key, value in tables.items():
        if isinstance(value, dict):
            lines.append(f"\n[{prefix}{key}]")
            table_text = _tables_as_toml(value, f"{prefix}{key}.")
            if table_text.strip():
                lines.append(table_text.rstrip("\n"))
    return "\n".join(lines) + "\n"


def toml_value(value: Any) -> str:
    """A value as TOML."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")  # as in TOML, except DEL
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key} = {toml_value(item)}" for key, item in value.items()) + "}"
    if isinstance(value, tuple | list):
        return "[" + ", ".join(toml_value(item) for item in value) + "]"
    return str(value)
