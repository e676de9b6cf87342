"""The grid of a sweep: varied keys of a scene, their values, and the scene of every point and seed."""

from __future__ import annotations

import difflib
import hashlib
import itertools
import math
import re
import tomllib
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from morphofold.errors import (
    DoesNotApply,
    NamedTwice,
    NothingToDo,
    NotReadable,
    OptionsClash,
    OutOfRange,
    Refusal,
    TooLarge,
    UnknownName,
)
from morphofold.sim.output.run_files import inputs_of
from morphofold.sim.scene import MeshFile, Scene
from morphofold.sim.scene.effects import effects_of
from morphofold.sim.scene.files import load_scene, toml_value
from morphofold.sim.scene.problems import with_notes
from morphofold.words import in_one_line

if TYPE_CHECKING:
    from pydantic import BaseModel

SEED_KEY = "effects.perturbation.seed"
MOST_RUNS = 10_000
LONGEST_NAME = 80  # most characters of a name, as for a scene
MOST_PROBLEMS_LISTED = 20  # most problems listed for a grid


@dataclass(frozen=True)
class Axis:
    """A varied key, such as ``"geometry.cortex_thickness"``; ``label`` is its name in tables and pages, and ``values``
    are plain: numbers, text, booleans, tuples."""

    key: str
    label: str
    values: tuple[Any, ...]

    @property
    def words(self) -> tuple[str, ...]:
        """The values as text for pages."""
        return tuple(value if isinstance(value, str) else toml_value(value) for value in self.values)

    @property
    def numeric(self) -> bool:
        """Whether every value is a number."""
        return all(isinstance(value, int | float) and not isinstance(value, bool) for value in self.values)


@dataclass(frozen=True)
class SweepPoint:
    """One scene of a grid: ``at`` has the index of its value on each axis, ``seed`` is None without imperfection."""

    name: str
    at: tuple[int, ...]
    seed: int | None
    scene: Scene


@dataclass(frozen=True)
class Grid:
    """All points of a sweep; seeds vary fastest, then the last axis. ``name`` is that of the scene."""

    name: str
    axes: tuple[Axis, ...]
    seeds: tuple[int | None, ...]
    points: tuple[SweepPoint, ...] = field(repr=False)

    @cached_property
    def scenes(self) -> dict[tuple[int, ...], Scene]:
        """``at`` of every point (once for all seeds) and its scene with the first seed."""
        return {point.at: point.scene for point in reversed(self.points)}

    @property
    def places(self) -> list[tuple[int, ...]]:
        """``at`` of every point, sorted."""
        return sorted(self.scenes)


def make_grid(
    source: str | Path | Scene, vary: Sequence[str], *, seeds: int | None = None, settings: Sequence[str] = ()
) -> Grid:
    """The grid of a scene.

    Parameters
    ----------
    source : str, Path or Scene
        A built-in scene's name, a TOML file, or a scene.
    vary : sequence of str
        ``"mu_ratio=1,2,4"``: a key, with as much of its table as makes it unique, and values as TOML.
    seeds : int, optional
        Seeds of the perturbation are 0 to seeds - 1 at every point; None: the seed of the scene.
    settings : sequence of str
        Such as ``"growth.final=1.8"``; applied to the scene before the varied values.

    Raises
    ------
    ValueError, FileNotFoundError
        If the scene, a key or a value is unknown or given twice, or a scene of the grid is impossible: one line
        for each problem, with the points that have it.
    """
    base = load_scene(source, settings)
    keys = keys_of(base)
    given = [_parse_axis(text, keys) for text in vary]
    twice = [key for key, count in Counter(key for key, _ in given).items() if count > 1]
    if twice:
        raise NamedTwice(f"--vary {twice[0]} is given twice. Give all its values at once, as {twice[0]}=1,2,3.")
    if seeds is not None and seeds < 1:
        raise OutOfRange(f"--seeds {seeds}: must be 1 or more.")
    if seeds is not None and seeds > MOST_RUNS:  # before they are listed
        raise _too_many_runs(seeds)
    if seeds is not None and SEED_KEY in dict(given):
        raise OptionsClash(f"--seeds {seeds}: --vary also gives seeds. Leave one of them out.")
    own = dict(given).pop(SEED_KEY, None) or (tuple(range(seeds)) if seeds is not None else None)
    short = {key: key.rpartition(".")[2] for key in keys}
    alike = Counter(short.values())
    axes = tuple(
        Axis(key, short[key] if alike[short[key]] == 1 else key, values) for key, values in given if key != SEED_KEY
    )
    if not axes and own is None:
        raise NothingToDo("nothing is varied. Pass --vary KEY=VALUE,VALUE or --seeds N.")
    count = math.prod(len(axis.values) for axis in axes) * len(own or (0,))
    if count > MOST_RUNS:
        raise _too_many_runs(count)
    return Grid(base.name, axes, *_grid_points(source, settings, axes, own))


def _too_many_runs(count: int) -> TooLarge:
    return TooLarge(f"{count:,} runs are more than {MOST_RUNS:,}. Vary fewer values.")


# keys and values ---------------------------------------------------------------------------------------------


def keys_of(scene: Scene) -> list[str]:
    """``table.key`` of all keys that a scene of this shape may have."""
    tables: dict[str, type[BaseModel]] = {
        "geometry": type(scene.geometry),
        "material": type(scene.material),
        "growth": type(scene.growth),
        **{f"effects.{name}": options for name, options in effects_of(scene.geometry.shape).items()},
        "accuracy": type(scene.accuracy),
        "output": type(scene.output),
    }
    return [f"{table}.{key}" for table, model in tables.items() for key in model.model_fields]


def _parse_axis(text: str, keys: Sequence[str]) -> tuple[str, tuple[Any, ...]]:
    """Key and values of ``KEY=VALUE,VALUE``."""
    asked, equals, rest = (part.strip() for part in text.partition("="))
    if not asked or not equals or not rest:
        raise NotReadable(f"--vary {text!r}: must be KEY=VALUE,VALUE, as cortex_thickness=1,2,3.")
    found = [key for key in keys if key == asked or key.endswith(f".{asked}")]
    if not found:
        names = {name: key for key in keys for name in (key, key.rpartition(".")[2])}
        near = [name for name in names if name.startswith(asked)] or difflib.get_close_matches(asked, names, n=1)
        hint = f"Did you mean {near[0]}?" if near else "morphofold scenes SCENE prints the keys of a scene."
        raise UnknownName(f"--vary {asked}: this scene has no such key. {hint}")
    if len(found) > 1 and asked not in found:
        tables = [key.rpartition(".")[0] for key in found]
        raise UnknownName(
            f"--vary {asked}: is a key of {' and of '.join(tables)}. Give the table too, as {found[0]}={rest}."
        )
    key = asked if asked in found else found[0]
    values = tuple(_lists_as_tuples(value) for value in _parse_values(rest, key))
    twice = [value for i, value in enumerate(values) if value in values[:i]]
    if twice:
        raise NamedTwice(f"--vary {key}: lists {toml_value(twice[0])} twice. List each value once.")
    return key, values


def _parse_values(text: str, key: str) -> list[Any]:
    """TOML values between commas; a bare word is text, as in --set."""
    try:
        return list(_parse_toml(f"[{text}]"))
    except ValueError:
        pass
    parts = [part.strip() for part in text.split(",")]
    wrong = [part for part in parts if not re.fullmatch(r"[\w.+-]+", part)]
    if wrong:
        raise NotReadable(f"--vary {key}: {wrong[0]!r} is not a value. Separate TOML values by commas, as {key}=1,2.")
    values = []
    for part in parts:
        try:
            values.append(_parse_toml(part))
        except ValueError:
            values.append(part)
    return values


def _parse_toml(text: str) -> Any:
    try:
        found = tomllib.loads(f"v = {text}")
    except RecursionError:
        raise NotReadable("nested too deeply") from None
    if list(found) != ["v"]:
        raise NotReadable("more than one value")
    return found["v"]


def _lists_as_tuples(value: Any) -> Any:
    return tuple(map(_lists_as_tuples, value)) if isinstance(value, list) else value


# points ------------------------------------------------------------------------------------------------------


def _grid_points(
    source: str | Path | Scene, settings: Sequence[str], axes: tuple[Axis, ...], seeds: tuple[int, ...] | None
) -> tuple[tuple[int | None, ...], tuple[SweepPoint, ...]]:
    """Seeds and points of a grid; raises as :func:`make_grid`."""
    problems: dict[str, list[str]] = {}
    kinds: list[type[Refusal]] = []  # kinds of the problems, in order of appearance
    meshes: dict[str, Exception | None] = {}
    found: list[tuple[str, tuple[int, ...], int | None, Scene]] = []
    for at in itertools.product(*(range(len(axis.values)) for axis in axes)):
        put = [f"{axis.key}={toml_value(axis.values[i])}" for axis, i in zip(axes, at)]
        try:
            for seed, scene in _scene_with_seeds(source, [*settings, *put], seeds):
                name = _point_name(axes, at, seed)
                if error := _mesh_file_error(scene, meshes):
                    kinds.append(_refusal_type(error))
                    problems.setdefault(in_one_line(error), []).append(name)
                found.append((name, at, seed, scene))
        except (ValueError, FileNotFoundError) as error:
            kinds.append(_refusal_type(error))
            for line in (str(error), *getattr(error, "__notes__", ())):
                problems.setdefault(line, []).append(_point_name(axes, at, None) or "the scene")
    if problems:
        lines = [f"{_first_names(names)}: {line}" for line, names in problems.items()]
        more = [f"{len(lines) - MOST_PROBLEMS_LISTED} more problems."] if len(lines) > MOST_PROBLEMS_LISTED else []
        raise with_notes(lines[:MOST_PROBLEMS_LISTED] + more, kinds[0])
    own = _distinct_folder_names([name for name, *_ in found])
    points = [
        SweepPoint(name, at, seed, scene.model_copy(update={"name": name}))
        for name, (_, at, seed, scene) in zip(own, found)
    ]
    return tuple(dict.fromkeys(point.seed for point in points)), tuple(points)


def _scene_with_seeds(
    source: str | Path | Scene, settings: list[str], seeds: tuple[int, ...] | None
) -> Iterator[tuple[int | None, Scene]]:
    """The scene with each seed; without ``seeds``, with its own seed or none."""
    scene = load_scene(source, settings)
    imperfect = scene.effects.get("perturbation")
    if seeds is None:
        yield None if imperfect is None else imperfect.seed, scene
        return
    if imperfect is None:
        raise DoesNotApply(
            "has no [effects.perturbation], so all seeds would give the same result. Leave the seeds out, or set an "
            "imperfection with --set effects.perturbation.amplitude=0.02."
        )
    for seed in seeds:
        yield seed, load_scene(source, [*settings, f"{SEED_KEY}={toml_value(seed)}"])


def _refusal_type(error: Exception) -> type[Refusal]:
    return type(error) if isinstance(error, Refusal) else NotReadable


def _mesh_file_error(scene: Scene, known: dict[str, Exception | None]) -> Exception | None:
    """Why a scene's mesh file cannot be read, checked once per file; None if it can be."""
    if not isinstance(scene.geometry, MeshFile):
        return None
    file = scene.geometry.file
    if file not in known:
        try:
            inputs_of(scene)
            known[file] = None
        except (ValueError, OSError) as error:
            known[file] = error
    return known[file]


def _point_name(axes: Sequence[Axis], at: Sequence[int], seed: int | None) -> str:
    """A name from the values: ``cortex_thickness-1_mu_ratio-2_seed-0``."""
    parts = [f"{axis.label}-{_value_in_name(axis.values[i])}" for axis, i in zip(axes, at)]
    return "_".join([*parts, *([] if seed is None else [f"seed-{seed}"])])


def _value_in_name(value: Any) -> str:
    if isinstance(value, tuple):
        return "x".join(map(_value_in_name, value))
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int | float):
        return f"{value:.0f}" if abs(value) < 1e15 and float(value).is_integer() else f"{value!r}"
    return re.sub(r"[^A-Za-z0-9.+-]+", "-", str(value)).strip("-.") or "empty"


def _distinct_folder_names(names: Sequence[str]) -> list[str]:
    """The names as distinct folder names, none longer than a scene's; a digest separates names that would collide."""
    alike = Counter(name.casefold()[:LONGEST_NAME] for name in names)
    return [
        name
        if alike[name.casefold()[:LONGEST_NAME]] == 1 and len(name) <= LONGEST_NAME
        else f"{name[: LONGEST_NAME - 9]}-{hashlib.sha256(f'{i} {name}'.encode()).hexdigest()[:8]}"
        for i, name in enumerate(names)
    ]


def _first_names(names: Sequence[str]) -> str:
    names = list(dict.fromkeys(names))
    return ", ".join(names[:2]) + (f" and {len(names) - 2} more" if len(names) > 2 else "")
