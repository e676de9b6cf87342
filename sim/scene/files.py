"""Scenes from TOML files, built-in names and ``table.key=value`` settings, and back to TOML."""

import difflib
import json
import os
import re
import tomllib
import warnings
from collections.abc import Iterable, Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from morphofold.errors import DoesNotApply, NotReadable, UnknownName, WrongFile
from morphofold.io.files import existing_file
from morphofold.sim.scene import SHAPES, Scene
from morphofold.sim.scene.geometries import path_or_sample
from morphofold.sim.scene.problems import Problem, Source, as_toml, blamed, explain, kind_of, root_problems, with_notes

MOST_PROBLEMS = 20  # that are reported for one scene


def scene_names() -> list[str]:
    """Names of the built-in scenes."""
    folder = resources.files("morphofold.sim") / "scenes"
    return sorted(p.name.removesuffix(".toml") for p in folder.iterdir() if p.name.endswith(".toml"))


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
    own = Source(source.name, to_toml(source)) if isinstance(source, Scene) else _read_source(source)
    keyed = [(_key_of_setting(setting), setting) for setting in settings]
    try:
        base = _base_scene(own, None if isinstance(source, Scene) else Path(source).parent)
        tables = _tables_of_scene(own, base, keyed)
        try:
            return Scene.model_validate(tables)
        except ValidationError as error:
            problems = root_problems(error.errors())
    except RecursionError:
        raise NotReadable(f"{own.where}: not a scene: lists or tables are nested too deeply.") from None
    sources = [own] if base is None else [own, base]

    def still(fewer: Sequence[tuple[str, str]]) -> list[Problem]:
        try:
            Scene.model_validate(_tables_of_scene(own, base, fewer))
        except ValidationError as error:
            return root_problems(error.errors())
        return []

    lines = [explain(p, sources, blamed(p, keyed, still), Scene, SHAPES) for p in problems[:MOST_PROBLEMS]]
    more = [f"{own.where}: {len(problems) - len(lines):,} more problems."] if len(problems) > len(lines) else []
    raise with_notes(lines + more, kind_of(problems[0]))


def _read_source(source: str | Path) -> Source:
    path = Path(source)
    if path.suffix != ".toml" and str(source) in scene_names():
        text = (resources.files("morphofold.sim") / "scenes" / f"{source}.toml").read_text("utf-8")
        return Source(str(source), text)
    if not str(source):
        raise UnknownName(f"no scene is named. Built-in scenes: {', '.join(scene_names())}.")
    if path.is_dir():
        inside = path / "scene.toml"
        more = f"name {inside}" if inside.is_file() else "name a TOML file or a built-in scene"
        raise WrongFile(f"{path}: is a folder, not a scene; {more}.")
    if os.path.lexists(path):
        existing_file(path, "TOML file of a scene")
    else:
        close = difflib.get_close_matches(str(source), scene_names(), n=1)
        hint = f" Did you mean {close[0]}?" if close else f" Built-in scenes: {', '.join(scene_names())}."
        raise FileNotFoundError(f"no scene file or built-in scene {str(source)!r}.{hint}")
    if path.stat().st_size > 1_000_000:
        raise WrongFile(
            f"{path}: {path.stat().st_size:,} bytes are too many for a scene; name a TOML file or a built-in scene."
        )
    try:
        return Source(str(path), path.read_text("utf-8"))
    except UnicodeDecodeError:
        raise NotReadable(f"{path}: not a TOML file: it is not UTF-8 text.") from None


def _parse_source(source: Source) -> dict[str, Any]:
    try:
        return tomllib.loads(source.text)
    except RecursionError:
        raise NotReadable(f"{source.where}: not a scene: lists or tables are nested too deeply.") from None
    except ValueError as error:  # a number of too many digits is not a TOMLDecodeError
        raise NotReadable(f"{source.where}: not a TOML file: {error}.") from None


def _base_scene(own: Source, folder: Path | None) -> Source | None:
    """The scene that ``like`` names: built in, or a file by its path from ``folder``."""
    tables = _parse_source(own)
    if "like" not in tables:
        return None
    like = tables["like"]
    if not isinstance(like, str) or not like:
        raise NotReadable(f'{own.where}: like must name a scene, such as like = "fig5" (got {as_toml(like)}).')
    try:
        base = _read_source(like if folder is None or like in scene_names() else folder / like)
        if "like" in _parse_source(base):
            raise WrongFile("uses like itself; name the scene that it is like.")
    except FileNotFoundError as error:
        raise FileNotFoundError(f"{own.where}: like = {as_toml(like)}: {error}") from None
    except ValueError as error:
        raise type(error)(f"{own.where}: like = {as_toml(like)}: {error}") from None
    return base


def _tables_of_scene(own: Source, base: Source | None, settings: Sequence[tuple[str, str]]) -> dict[str, Any]:
    """The tables of a scene: its own replace those of its base, the settings replace both."""
    tables = _with_paths(_parse_source(own), Path(own.where).parent)
    tables.pop("like", None)
    if base is not None:
        above = tables
        tables = _merge_tables(_with_paths(_parse_source(base), Path(base.where).parent), above)
        if "final" in _table_or_empty(above, "growth") and "stages" not in _table_or_empty(above, "output"):
            _drop_late_stages(tables)
        if "level" in _table_or_empty(above, "accuracy") and "edge" not in _table_or_empty(above, "accuracy"):
            _table_or_empty(tables, "accuracy").pop("edge", None)
    for key, setting in settings:
        _apply_setting(tables, key, setting)
    changed = {key for key, _ in settings}
    if changed & {"growth", "growth.final"} and not changed & {"output", "output.stages"}:
        _drop_late_stages(tables)
    if "accuracy.level" in changed and not changed & {"accuracy", "accuracy.edge"}:
        _table_or_empty(tables, "accuracy").pop("edge", None)
    return _with_paths(tables, Path())  # those of settings are from the working folder


def _with_paths(tables: dict[str, Any], folder: Path, within: str = "") -> dict[str, Any]:
    """The tables with the absolute path of each file that they name by its path from ``folder``.

    A file that exists only by its path from the working folder, the rule up to version 0.3, is taken with a warning.
    Samples, and a subject's maps and spheres, keep their names.
    """
    found = dict(tables)
    for key, value in tables.items():
        if isinstance(value, dict):
            found[key] = _with_paths(value, folder, key)
        if key not in ("file", "subject", "sphere") or not isinstance(value, str):
            continue
        place, other = folder / value, path_or_sample(value)
        if key != "subject" and re.fullmatch(r"[\w-]+", value) and not os.path.lexists(place):
            continue  # the name of a map or a sphere
        if not os.path.lexists(place) and other.exists():
            if other != Path(value):
                continue
            warnings.warn(
                f"{within}.{key} = {value!r}: is found from the working folder, not from {folder}, the folder of its "
                "scene. Later versions will not read it: give its path from the scene.",
                stacklevel=2,
            )
            place = other
        if os.path.lexists(place) or (within == "geometry" and key != "sphere"):
            found[key] = os.path.abspath(place)
    return found


def _merge_tables(below: dict[str, Any], above: dict[str, Any]) -> dict[str, Any]:
    merged = dict(below)
    for key, value in above.items():
        both = isinstance(value, dict) and isinstance(merged.get(key), dict)
        merged[key] = _merge_tables(merged[key], value) if both else value
    return merged


def _key_of_setting(setting: str) -> str:
    """``table.key`` of ``table.key=value``."""
    key, equals, _ = setting.partition("=")
    parts = [part.strip() for part in key.split(".")]
    if not equals or not all(parts):
        raise NotReadable(
            f"setting {as_toml(setting)} must have the form table.key=value, for example growth.final=1.8."
        )
    if parts == ["like"]:
        raise DoesNotApply(
            f"setting {as_toml(setting)}: 'like' is allowed only in a file; pass the scene that it names instead."
        )
    return ".".join(parts)


def _apply_setting(tables: dict[str, Any], key: str, setting: str) -> None:
    """Put the value of ``table.key=value`` into the tables."""
    value = setting.partition("=")[2].strip()
    try:
        parsed = tomllib.loads(f"v = {value}")
    except RecursionError:
        raise NotReadable(f"setting {as_toml(setting)}: lists or tables are nested too deeply.") from None
    except ValueError:
        parsed = {}
    *path, last = key.split(".")
    table = tables
    for part in path:
        table = table.setdefault(part, {})
        if not isinstance(table, dict):
            raise NotReadable(f"setting {as_toml(setting)}: {part!r} is a value, not a table.")
    table[last] = parsed["v"] if list(parsed) == ["v"] else value  # a bare word is a string


def _table_or_empty(tables: Mapping[str, Any], name: str) -> dict[str, Any]:
    """The table ``name``, empty if there is none."""
    table = tables.get(name)
    return table if isinstance(table, dict) else {}


def _drop_late_stages(tables: dict[str, Any]) -> None:
    """Drop the stages that a smaller final growth no longer reaches."""
    final, output = _table_or_empty(tables, "growth").get("final"), _table_or_empty(tables, "output")
    if isinstance(final, int | float) and isinstance(output.get("stages"), list):
        output["stages"] = [g for g in output["stages"] if not isinstance(g, int | float) or g <= final]


def to_toml(scene: Scene) -> str:
    """A scene as TOML, with every value."""
    return _tables_as_toml(scene.model_dump(exclude_none=True))


def _tables_as_toml(tables: Mapping[str, Any], prefix: str = "") -> str:
    lines = [f"{key} = {toml_value(v)}" for key, v in tables.items() if not isinstance(v, dict)]
    for key, v in tables.items():
        if isinstance(v, dict):
            lines.append(f"\n[{prefix}{key}]")
            body = _tables_as_toml(v, f"{prefix}{key}.")
            if body.strip():
                lines.append(body.rstrip("\n"))
    return "\n".join(lines) + "\n"


def toml_value(v: Any) -> str:
    """A value as TOML."""
    if isinstance(v, bool):
        return "true" if v else "false"
    if isinstance(v, str):
        return json.dumps(v, ensure_ascii=False).replace("\x7f", "\\u007f")  # as in TOML, except DEL
    if isinstance(v, dict):
        return "{" + ", ".join(f"{key} = {toml_value(x)}" for key, x in v.items()) + "}"
    if isinstance(v, tuple | list):
        return "[" + ", ".join(toml_value(x) for x in v) + "]"
    return repr(v)
