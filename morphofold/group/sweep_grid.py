"""The grid of a sweep: varied keys of a scene, their values, and the scene of every point and seed."""

import difflib
import hashlib
import itertools
import math
import re
import tomllib
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from morphofold.errors import (
    DoesNotApply,
    NamedTwice,
    NothingToDo,
    NotReadable,
    OptionsClash,
    Refusal,
    TooLarge,
    UnknownName,
)
from morphofold.sim.effects.perturbation import build
from morphofold.sim.output.run_inputs import inputs_of
from morphofold.sim.scene import MeshFile, Scene
from morphofold.sim.scene.effect_registry import effects_of
from morphofold.sim.scene.scene_files import load_scene, toml_value

SEED_KEY = "effects.perturbation.seed"
MOST_RUNS = 10_000
LONGEST_NAME = 80  # most characters of a name, as for a scene

GridIndex = tuple[int, ...]  # of a point: the index of its value on each axis
SceneSource = str | Path | Scene


@dataclass(frozen=True)
class Axis:
    """A varied key, such as ``"geometry.cortex_thickness"``; ``label`` is its name in tables and pages, and ``values``
    are plain: numbers, text, booleans, lists."""

    key: str
    label: str
    values: tuple[Any, ...]

    @property
    def texts(self) -> tuple[str, ...]:
        """The values as text for pages."""
        return tuple(value if isinstance(value, str) else toml_value(value) for value in self.values)

    @property
    def numeric(self) -> bool:
        """Whether every value is a number."""
        return all(isinstance(value, int | float) and not isinstance(value, bool) for value in self.values)


@dataclass(frozen=True)
class SweepPoint:
    """One scene of a grid: ``grid_index`` has its value's index on each axis, ``seed`` is None without imperfection."""

    name: str
    grid_index: GridIndex
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
    def scenes(self) -> dict[GridIndex, Scene]:
        """``grid_index`` of every point (once for all seeds) and its scene with the first seed."""
        return {point.grid_index: point.scene for point in reversed(self.points)}


def make_grid(
    source: SceneSource, vary: Sequence[str], *, seeds: int | None = None, settings: Sequence[str] = ()
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
        Such as ``"growth.final=1.8"``; applied to the scene before the varied values. Without a wavelength of its own,
        the imperfection has that of this scene at all points.

    Raises
    ------
    ValueError, FileNotFoundError
        If the scene, a key or a value is unknown or given twice, or a scene of the grid is impossible; the first such
        is named.
    """
    base_scene = load_scene(source, settings)
    settings = [*settings, *_imperfection_of(base_scene)]
    scene_keys = keys_of(base_scene)
    values_by_key: dict[str, Sequence[Any]] = {}
    for axis_text in vary:
        full_key, axis_values = _parse_axis(axis_text, scene_keys)
        if full_key in values_by_key:
            raise NamedTwice(f"--vary {full_key} is given twice. Give all its values at once, as {full_key}=1,2,3.")
        values_by_key[full_key] = axis_values
    if seeds is not None:
        if SEED_KEY in values_by_key:
            raise OptionsClash(f"--seeds {seeds}: --vary also gives seeds. Leave one of them out.")
        values_by_key[SEED_KEY] = range(min(seeds, MOST_RUNS + 1))
    if not values_by_key:
        raise NothingToDo("nothing is varied. Pass --vary KEY=VALUE,VALUE or --seeds N.")
    n_runs = math.prod(map(len, values_by_key.values()))
    if n_runs > MOST_RUNS:
        raise TooLarge(f"{n_runs:,} runs are more than {MOST_RUNS:,}. Vary fewer values.")
    seed_values = values_by_key.pop(SEED_KEY, None)
    short_name_counts = Counter(full_key.rpartition(".")[2] for full_key in scene_keys)
    axes = tuple(
        Axis(
            full_key,
            short_name if short_name_counts[short_name := full_key.rpartition(".")[2]] == 1 else full_key,
            tuple(axis_values),
        )
        for full_key, axis_values in values_by_key.items()
    )
    points = _grid_points(source, settings, axes, seed_values)
    return Grid(base_scene.name, axes, tuple(dict.fromkeys(point.seed for point in points)), points)


def _imperfection_of(scene: Scene) -> list[str]:
    """The wavelength of the scene's imperfection as a setting: one for the whole grid, unless it is set or varied."""
    options = scene.effects.get("perturbation")
    if options is None or options.wavelength is not None:
        return []
    return [f"effects.perturbation.wavelength={build(options, scene).wavelength!r}"]


# keys and values ---------------------------------------------------------------------------------------------


def keys_of(scene: Scene) -> list[str]:
    """``table.key`` of all keys that a scene of this shape may have."""
    classes = {name: type(getattr(scene, name)) for name in ("geometry", "material", "growth", "accuracy", "output")}
    classes |= {f"effects.{name}": options_class for name, options_class in effects_of(scene.geometry.shape).items()}
    return [f"{table_name}.{key}" for table_name, table_class in classes.items() for key in table_class.model_fields]


def _parse_axis(text: str, keys: Sequence[str]) -> tuple[str, list[Any]]:
    """Key and values of ``KEY=VALUE,VALUE``."""
    key_text, _, listing = (part.strip() for part in text.partition("="))
    if not key_text or not listing:
        raise NotReadable(f"--vary {text!r}: must be KEY=VALUE,VALUE, as cortex_thickness=1,2,3.")
    full_keys = [key_text] if key_text in keys else [key for key in keys if key.endswith(f".{key_text}")]
    if not full_keys:
        similar_keys = difflib.get_close_matches(key_text, [key.rpartition(".")[2] for key in keys], n=1)
        hint_text = f" Did you mean {similar_keys[0]}?" if similar_keys else ""
        raise UnknownName(
            f"--vary {key_text}: this scene has no such key.{hint_text} `morphofold scenes SCENE` prints its keys."
        )
    if len(full_keys) > 1:
        tables = " and of ".join(key.rpartition(".")[0] for key in full_keys)
        raise UnknownName(f"--vary {key_text}: is a key of {tables}. Give the table too, as {full_keys[0]}={listing}.")
    axis_values = _parse_values(listing)
    if repeated_values := [value for i, value in enumerate(axis_values) if value in axis_values[:i]]:
        raise NamedTwice(f"--vary {full_keys[0]}: lists {toml_value(repeated_values[0])} twice. List each value once.")
    return full_keys[0], axis_values


def _parse_values(text: str) -> list[Any]:
    """TOML values between commas; what is none is text, as in --set."""
    try:
        return list(tomllib.loads(f"v = [{text}]")["v"])
    except ValueError:
        first_text, comma, later_text = text.partition(",")
        return [*_parse_values(first_text), *_parse_values(later_text)] if comma else [text.strip()]


# points ------------------------------------------------------------------------------------------------------


def _grid_points(
    source: SceneSource, settings: Sequence[str], axes: tuple[Axis, ...], seeds: Sequence[Any] | None
) -> tuple[SweepPoint, ...]:
    """The points of a grid; raises as :func:`make_grid`."""
    points: list[SweepPoint] = []
    for grid_index in itertools.product(*(range(len(axis.values)) for axis in axes)):
        point_settings = [*settings, *(f"{axis.key}={toml_value(axis.values[i])}" for axis, i in zip(axes, grid_index))]
        try:
            scenes = [load_scene(source, point_settings)]
            if seeds is not None:
                if "perturbation" not in scenes[0].effects:
                    raise DoesNotApply(
                        "has no [effects.perturbation], so all seeds would give the same result. Leave the seeds out, "
                        "or set an imperfection with --set effects.perturbation.amplitude=0.02."
                    )
                scenes = [load_scene(source, [*point_settings, f"{SEED_KEY}={toml_value(seed)}"]) for seed in seeds]
        except Refusal as error:
            raise type(error)(f"{_point_name(axes, grid_index, None) or 'the scene'}: {error}") from None
        for scene in scenes:
            perturbation = scene.effects.get("perturbation")
            seed = None if perturbation is None else perturbation.seed
            points.append(SweepPoint(_point_name(axes, grid_index, seed), grid_index, seed, scene))
    for scene in {p.scene.geometry.file: p.scene for p in points if isinstance(p.scene.geometry, MeshFile)}.values():
        inputs_of(scene)  # raises if the mesh can't be read
    folder_names = _distinct_folder_names([point.name for point in points])
    return tuple(
        replace(point, name=folder_name, scene=point.scene.model_copy(update={"name": folder_name}))
        for point, folder_name in zip(points, folder_names)
    )


def _point_name(axes: Sequence[Axis], grid_index: Sequence[int], seed: int | None) -> str:
    """A name from the values: ``cortex_thickness-1_mu_ratio-2_seed-0``."""
    name_parts = [f"{axis.label}-{_text_in_name(axis.texts[i])}" for axis, i in zip(axes, grid_index)]
    return "_".join([*name_parts, *([] if seed is None else [f"seed-{seed}"])])


def _text_in_name(text: str) -> str:
    """A value as part of a folder's name: whole numbers without .0, x between the values of a list."""
    return re.sub(r"[^A-Za-z0-9.+-]+", "-", text.removesuffix(".0").replace(", ", "x").strip("[]")) or "empty"


def _distinct_folder_names(names: Sequence[str]) -> list[str]:
    """The names as distinct folder names, none longer than a scene's; a digest separates names that would collide."""
    name_counts = Counter(name.casefold()[:LONGEST_NAME] for name in names)
    return [
        name
        if name_counts[name.casefold()[:LONGEST_NAME]] == 1 and len(name) <= LONGEST_NAME
        else f"{name[: LONGEST_NAME - 9]}-{hashlib.sha256(f'{i} {name}'.encode()).hexdigest()[:8]}"
        for i, name in enumerate(names)
    ]
