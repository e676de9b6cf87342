"""What a scene says: validated TOML. An effect runs if and only if its table is there."""

from __future__ import annotations

import difflib
import math
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Discriminator, Field, Tag, ValidationError, model_validator

from morphofold.sim.scene_words import Problem, Source, as_toml, blamed, explain, root_problems

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
SMALLEST, LARGEST = 1e-3, 1e4               # of lengths in a scene [mm]
Length = Annotated[float, Field(ge=SMALLEST, le=LARGEST)]

#: accuracy level: surface edge over cortex thickness
LEVELS = {"draft": 0.80, "standard": 0.45, "fine": 0.40}
CROSSINGS = 180.0       # times that a wave crosses the cortex while growth rises by 1

MOST_BRICKS = 5_000_000  # about 6 GB of memory

#: effects that a shape can have, where it can't have them all
EFFECTS_OF = {
    "radial": ("core_growth",),
    "patch": ("contact", "perturbation", "core_growth", "regional_growth", "ramp", "inertia", "bulk_viscosity"),
    "strip": ("contact", "perturbation", "core_growth", "regional_growth", "ramp", "inertia", "bulk_viscosity"),
    "mesh": ("contact", "perturbation", "core_growth", "regional_growth", "ramp", "inertia"),
}


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


Coordinate = Annotated[float, Field(ge=-LARGEST, le=LARGEST)]
Direction = tuple[float, float, float]
Point = tuple[Coordinate, Coordinate, Coordinate]


class _Layers(_Table):
    """What every body has: a cortex on a core [mm]."""

    cortex_thickness: Length = 2.0


class Spot(_Table):
    """A region around a pial point ``centre`` [mm]: full ``factor`` there, 1 beyond ``radius`` [mm]."""

    centre: Annotated[Point, Field(strict=False)]
    radius: Length
    factor: Annotated[float, Field(gt=0, le=4)]


class Sphere(_Layers):
    """Bilayer sphere (Razavi et al. 2015, Fig. 2): C = radius, C - B = cortex_thickness, A = hole_radius [mm].

    ``thickness_spots``: regions of another cortical thickness, their factors times ``cortex_thickness``.
    """

    shape: Literal["sphere"] = "sphere"
    radius: Length = 50.0
    hole_radius: Length = 25.0
    portion: Literal["full", "half", "quarter", "octant"] = "half"
    thickness_spots: Annotated[tuple[Spot, ...], Field(strict=False)] = ()

    @model_validator(mode="after")
    def _layers_fit(self) -> Sphere:
        _check_layers(self.radius, self.cortex_thickness, self.hole_radius)
        return self

    @property
    def semi_axes(self) -> Direction:
        return (self.radius, self.radius, self.radius)


class Ellipsoid(_Layers):
    """Bilayer ellipsoid; ``semi_axes`` of the pial surface [mm], the hole a copy of it, ``hole_share`` as large."""

    shape: Literal["ellipsoid"]
    semi_axes: Annotated[tuple[Length, Length, Length], Field(strict=False)] = (60.0, 45.0, 40.0)
    hole_share: Annotated[float, Field(gt=0, lt=1)] = 0.5
    portion: Literal["full", "half", "quarter", "octant"] = "half"
    thickness_spots: Annotated[tuple[Spot, ...], Field(strict=False)] = ()

    @model_validator(mode="after")
    def _layers_fit(self) -> Ellipsoid:
        _check_layers(min(self.semi_axes), self.cortex_thickness, self.hole_share * min(self.semi_axes))
        return self


class Patch(_Layers):
    """A flat block of ``size`` along x and y and of ``depth`` [mm], symmetry planes on its sides, held at its base."""

    shape: Literal["patch"]
    size: Annotated[tuple[Length, Length], Field(strict=False)] = (40.0, 40.0)
    depth: Length = 25.0

    @model_validator(mode="after")
    def _layers_fit(self) -> Patch:
        _check_layers(self.depth, self.cortex_thickness, 0.0)
        return self


class Strip(_Layers):
    """A slice of a patch in plane strain: ``length`` along x and ``depth`` [mm]."""

    shape: Literal["strip"]
    length: Length = 80.0
    depth: Length = 25.0

    @model_validator(mode="after")
    def _layers_fit(self) -> Strip:
        _check_layers(self.depth, self.cortex_thickness, 0.0)
        return self


class Radial(_Layers):
    """The sphere in one dimension: it stays a sphere, whether stable or not. Names as in the sphere [mm]."""

    shape: Literal["radial"]
    radius: Length = 50.0
    hole_radius: Length = 25.0

    @model_validator(mode="after")
    def _layers_fit(self) -> Radial:
        _check_layers(self.radius, self.cortex_thickness, self.hole_radius)
        return self


class MeshFile(_Layers):
    """Any body of tetrahedra, from a ``file`` that meshio reads, lengths times ``scale`` to mm.

    The cortex is what lies less than ``cortex_thickness`` below the outer surface, or the tetrahedra whose cell data
    ``label`` hold the value ``cortex_label``. ``held`` names what never moves: an ``inner`` surface (a ventricle), or
    ``nothing``.
    """

    shape: Literal["mesh"]
    file: Annotated[str, Field(min_length=1)]
    scale: Annotated[float, Field(ge=1e-6, le=1e6)] = 1.0
    label: str | None = None
    cortex_label: int = 1
    held: Literal["inner", "nothing"] = "nothing"


def _check_layers(radius: float, thickness: float, hole: float) -> None:
    if thickness >= radius:
        raise ValueError(f"cortex_thickness {thickness:g} leaves no core in {radius:g} mm; make it smaller")
    if hole >= radius - thickness:
        raise ValueError(
            f"hole_radius {hole:g} is not inside the core of radius {radius - thickness:g} ({radius:g} - "
            f"cortex_thickness {thickness:g}); make it smaller than {radius - thickness:g}"
        )


SHAPES: dict[str, type[_Layers]] = {
    "sphere": Sphere, "ellipsoid": Ellipsoid, "patch": Patch, "strip": Strip, "radial": Radial, "mesh": MeshFile,
}  # fmt: skip


def _shape(table: Any) -> str:
    """Which geometry a table means; a sphere unless it says otherwise."""
    named = table.get("shape", "sphere") if isinstance(table, dict) else getattr(table, "shape", "sphere")
    return str(named)


Geometry = Annotated[
    Annotated[Sphere, Tag("sphere")] | Annotated[Ellipsoid, Tag("ellipsoid")] | Annotated[Patch, Tag("patch")]
    | Annotated[Strip, Tag("strip")] | Annotated[Radial, Tag("radial")] | Annotated[MeshFile, Tag("mesh")],
    Discriminator(_shape, custom_error_type="shape", custom_error_message=f"must be one of {', '.join(SHAPES)}"),
]  # fmt: skip


class Material(_Table):
    """``mu_ratio``: shear modulus of the cortex over that of the core. ``kappa_ratio``: bulk over shear modulus, in
    both layers."""

    mu_ratio: Annotated[float, Field(ge=1e-4, le=1e4)] = 1.0
    kappa_ratio: Annotated[float, Field(ge=5, le=2000)] = 50.0


class Growth(_Table):
    """Growth law and final growth stretch of the cortex; ``rate``: pace, times that by default."""

    law: Literal["isotropic", "tangential"] = "isotropic"
    final: Annotated[float, Field(ge=1, le=4)] = 2.0
    rate: Annotated[float, Field(ge=1e-3, le=4)] = 1.0


class Contact(_Table):
    """Self-contact of the pial surface; no options."""


class Perturbation(_Table):
    """Random smooth imperfection of the cortical thickness: rms amplitude over the thickness, and its seed.

    ``wavelength`` [mm]: of its waves in space, by default 7.85 cortical thicknesses. A sphere cuts them 1.2 to 1.3
    times as long (a strip twice, or so), about the wrinkles' own.
    """

    amplitude: Annotated[float, Field(gt=0, le=0.3)] = 0.02
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    wavelength: Length | None = None


class CoreGrowth(_Table):
    """Isotropic growth of the core, to ``final`` when the cortex reaches its own (g_c of Eq. 9)."""

    final: Annotated[float, Field(gt=0.5, le=4)] = 1.2


class RegionalGrowth(_Table):
    """Regions where the cortex takes ``factor`` times the growth g - 1."""

    spots: Annotated[tuple[Spot, ...], Field(strict=False, min_length=1)]


class Ramp(_Table):
    """Shape of the growth ramp; without it growth rises linearly. The number of steps stays about the same."""

    shape: Literal["exponential", "smooth", "slowing"]


class Enclosure(_Table):
    """A rigid shell around the body, of the shape of its first surface, ``gap`` [mm] outside of it."""

    gap: Annotated[float, Field(ge=0, le=LARGEST)] = 2.0


class Inertia(_Table):
    """True inertia. ``duration``: time in which growth rises by 1, ``damping``: rate at which velocities decay, per
    time; time in that of a shear wave across 1 mm of core at density 1. Growth waits for collapsing elements still."""

    density: Annotated[float, Field(ge=1e-4, le=1e4)] = 1.0
    duration: Annotated[float, Field(ge=1, le=1e6)] = 500.0
    damping: Annotated[float, Field(ge=0, le=10)] = 0.05


class BulkViscosity(_Table):
    """Viscous pressure against volume rate, as in the program that the paper used."""

    linear: Annotated[float, Field(ge=0, le=0.5)] = 0.06                # the mass leaves room for as much
    quadratic: Annotated[float, Field(ge=0, le=2)] = 1.2


class Effects(_Table):
    contact: Contact | None = None
    perturbation: Perturbation | None = None
    core_growth: CoreGrowth | None = None
    regional_growth: RegionalGrowth | None = None
    ramp: Ramp | None = None
    enclosure: Enclosure | None = None
    inertia: Inertia | None = None
    bulk_viscosity: BulkViscosity | None = None

    @property
    def named(self) -> tuple[str, ...]:
        """Effects that this scene calls for."""
        return tuple(name for name in type(self).model_fields if getattr(self, name) is not None)


class Accuracy(_Table):
    """Preset, or the number of element layers through the cortex and the largest surface edge [mm]."""

    level: Literal["draft", "standard", "fine"] = "standard"
    elements_through_cortex: Annotated[int, Field(ge=1, le=12)] = 3
    edge: Positive | None = None


class Output(_Table):
    """Growth stretches at which surfaces are written; the final one is always written. Growth meets each stage
    exactly, so one more stage shifts the steps around it a little."""

    stages: Annotated[tuple[Annotated[float, Field(ge=1)], ...], Field(strict=False)] = ()
    volume: bool = True
    checkpoint_minutes: Positive = 0.5


class Scene(_Table):
    """Everything needed to repeat a simulation."""

    name: Annotated[str, Field(min_length=1, max_length=80, pattern=r"^[A-Za-z0-9][A-Za-z0-9 ._+-]*$")]
    title: Annotated[str, Field(max_length=200, pattern=r"^[^\x00-\x1f\x7f]*$")] = ""
    geometry: Geometry = Sphere()
    material: Material = Material()
    growth: Growth = Growth()
    effects: Effects = Effects()
    accuracy: Accuracy = Accuracy()
    output: Output = Output()

    @model_validator(mode="after")
    def _stages_within_growth(self) -> Scene:
        late = [g for g in self.output.stages if g > self.growth.final]
        if late:
            raise ValueError(
                f"output.stages: {late[0]:g} lies beyond growth.final = {self.growth.final:g}; drop it or grow further"
            )
        names = [f"{g:.2f}" for g in self.stages]
        if len(set(names)) < len(names):
            raise ValueError("output.stages: stages (with growth.final) must differ by 0.01 at least")
        return self

    @model_validator(mode="after")
    def _effects_fit_the_shape(self) -> Scene:
        shape, effects = self.geometry.shape, self.effects
        fits = EFFECTS_OF.get(shape)
        for name in effects.named:
            if fits is not None and name not in fits:
                raise ValueError(f"effects.{name} makes no sense with geometry.shape = {shape!r}; drop it")
        if shape == "mesh" and self.accuracy != Accuracy():
            raise ValueError("accuracy makes no sense with geometry.shape = 'mesh': the mesh is the file's; drop it")
        if effects.core_growth is not None and self.growth.final == 1:
            raise ValueError("effects.core_growth needs a cortex that grows: growth.final is 1")
        if effects.ramp is not None and self.growth.final == 1:
            raise ValueError("effects.ramp needs growth: growth.final is 1")
        return self

    @model_validator(mode="after")
    def _fits_in_memory(self) -> Scene:
        bricks = self.bricks
        if bricks > MOST_BRICKS:
            many = f"about {bricks:.1e}" if bricks < 1e99 else "more than 1e+99"
            raise ValueError(
                f"this takes {many} bricks (surface edge {self.edge:.3g} mm), more than {MOST_BRICKS:.0e}; "
                "take a thicker cortex, a smaller portion, a coarser accuracy.level or a larger accuracy.edge"
            )
        return self

    @property
    def stages(self) -> tuple[float, ...]:
        """Growth stretches at which surfaces are written, ascending, the final one last."""
        return tuple(sorted({*self.output.stages, self.growth.final}))

    @property
    def edge(self) -> float:
        """Largest surface edge asked for [mm]."""
        thinnest = min((spot.factor for spot in getattr(self.geometry, "thickness_spots", ())), default=1.0)
        thickness = self.geometry.cortex_thickness * min(thinnest, 1.0)
        return self.accuracy.edge or LEVELS[self.accuracy.level] * thickness

    @property
    def cells(self) -> int:
        """Surface cells along a quarter of a great circle of a sphere or ellipsoid, an even number."""
        if not isinstance(self.geometry, Sphere | Ellipsoid):
            raise ValueError(f"{self.name}: cells are counted on a sphere or an ellipsoid only.")
        return max(4, 2 * math.ceil(0.5 * self._edges_along_a_quarter(self.geometry) - 1e-9))

    def _edges_along_a_quarter(self, body: Sphere | Ellipsoid) -> float:
        """Of the longest great circle, as the edge asks for; infinite if the edge is next to nothing."""
        return 0.5 * math.pi * max(body.semi_axes) / self.edge

    @property
    def bricks(self) -> float:
        """About how many bricks the body has; 0 where it isn't made of bricks by us."""
        geometry, layers = self.geometry, self.accuracy.elements_through_cortex + 8
        if isinstance(geometry, Sphere | Ellipsoid):
            share = {"full": 1.0, "half": 0.5, "quarter": 0.25, "octant": 0.125}[geometry.portion]
            along = max(4.0, self._edges_along_a_quarter(geometry))
            return 6 * along * along * share * layers
        if isinstance(geometry, Patch):
            return (geometry.size[0] / self.edge) * (geometry.size[1] / self.edge) * layers
        if isinstance(geometry, Strip):
            return geometry.length / self.edge * layers
        return 0.0

    def steps_per_unit(self, crossing: float) -> float:
        """Steps for growth to rise by 1 in a body whose cortex a wave crosses in ``crossing`` steps."""
        return CROSSINGS * crossing / self.growth.rate

    @property
    def called_effects(self) -> dict[str, Any]:
        """Options of the effects that run, by name: those named, and those that the geometry brings along."""
        called = {name: getattr(self.effects, name) for name in self.effects.named}
        planes = isinstance(self.geometry, Patch | Strip) or getattr(self.geometry, "portion", "full") != "full"
        if planes and self.effects.contact is not None:
            called["symmetry"] = None
        if isinstance(self.geometry, Strip):
            called["plane_strain"] = None
        return called

    def to_toml(self) -> str:
        """This scene, every value spelled out, as TOML."""
        return _toml(self.model_dump(exclude_none=True))


def scene_names() -> list[str]:
    """Names of the built-in scenes."""
    folder = resources.files("morphofold.sim") / "scenes"
    return sorted(p.name.removesuffix(".toml") for p in folder.iterdir() if p.name.endswith(".toml"))


def load_scene(source: str | Path | Scene, settings: Iterable[str] = ()) -> Scene:
    """A scene from a built-in name, a TOML file, or a ``Scene``, with ``table.key=value`` settings put over it.

    A file may begin with ``like``: a built-in scene, or a file by its path from the folder of this one, over which it
    is put. Where a file or a setting changes ``growth.final`` and leaves ``output.stages``, stages beyond are dropped.

    Raises
    ------
    FileNotFoundError
        If there is neither a built-in scene nor a file of that name.
    ValueError
        If the file is not TOML, or says something unknown, impossible or contradictory; one line per problem,
        with the line or the setting that says it.
    """
    own = Source(source.name, source.to_toml()) if isinstance(source, Scene) else _read(source)
    keyed = [(_key_of(setting), setting) for setting in settings]
    try:
        base = _base(own, None if isinstance(source, Scene) else Path(source).parent)
        tables = _tables(own, base, keyed)
        try:
            return Scene.model_validate(tables)
        except ValidationError as error:
            problems = root_problems(error.errors())
    except RecursionError:
        raise ValueError(f"{own.where}: not a scene: lists or tables are nested too deeply.") from None
    sources = [own] if base is None else [own, base]

    def still(fewer: Sequence[tuple[str, str]]) -> list[Problem]:
        try:
            Scene.model_validate(_tables(own, base, fewer))
        except ValidationError as error:
            return root_problems(error.errors())
        return []

    raise ValueError("\n".join(explain(p, sources, blamed(p, keyed, still), Scene, SHAPES) for p in problems))


def _read(source: str | Path) -> Source:
    path = Path(source)
    if path.suffix != ".toml" and str(source) in scene_names():
        text = (resources.files("morphofold.sim") / "scenes" / f"{source}.toml").read_text("utf-8")
        return Source(str(source), text)
    if not str(source):
        raise ValueError(f"no scene is named. Built-in scenes: {', '.join(scene_names())}.")
    if path.is_dir():
        inside = path / "scene.toml"
        more = f"name {inside}" if inside.is_file() else "name a TOML file or a built-in scene"
        raise ValueError(f"{path}: is a folder, not a scene; {more}.")
    if path.exists() and not path.is_file():
        raise ValueError(f"{path}: is a device or a pipe, not a scene; name a TOML file or a built-in scene.")
    if not path.is_file():
        close = difflib.get_close_matches(str(source), scene_names(), n=1)
        hint = f" Did you mean {close[0]}?" if close else f" Built-in scenes: {', '.join(scene_names())}."
        raise FileNotFoundError(f"no scene file or built-in scene {str(source)!r}.{hint}")
    if path.stat().st_size > 1_000_000:
        raise ValueError(f"{path}: {path.stat().st_size:,} bytes is no scene file.")
    try:
        return Source(str(path), path.read_text("utf-8"))
    except UnicodeDecodeError:
        raise ValueError(f"{path}: not a TOML file: it is not UTF-8 text.") from None


def _parsed(source: Source) -> dict[str, Any]:
    try:
        return tomllib.loads(source.text)
    except RecursionError:
        raise ValueError(f"{source.where}: not a scene: lists or tables are nested too deeply.") from None
    except ValueError as error:                                         # a number of too many digits is no decode error
        raise ValueError(f"{source.where}: not a TOML file: {error}.") from None


def _base(own: Source, folder: Path | None) -> Source | None:
    """The scene that ``like`` names, by its path from ``folder`` or built in."""
    tables = _parsed(own)
    if "like" not in tables:
        return None
    like = tables["like"]
    if not isinstance(like, str) or not like:
        raise ValueError(f'{own.where}: like must name a scene, such as like = "fig5" (got {as_toml(like)}).')
    try:
        base = _read(like if folder is None or like in scene_names() else folder / like)
        if "like" in _parsed(base):
            raise ValueError("is itself like another scene; name that one.")
    except FileNotFoundError as error:
        raise FileNotFoundError(f"{own.where}: like = {as_toml(like)}: {error}") from None
    except ValueError as error:
        raise ValueError(f"{own.where}: like = {as_toml(like)}: {error}") from None
    return base


def _tables(own: Source, base: Source | None, settings: Sequence[tuple[str, str]]) -> dict[str, Any]:
    """What a scene says: its own tables over those of its base, the settings over both."""
    tables = _parsed(own)
    tables.pop("like", None)
    if base is not None:
        above = tables
        tables = _over(_parsed(base), above)
        if "final" in _table(above, "growth") and "stages" not in _table(above, "output"):
            _drop_late_stages(tables)
    for key, setting in settings:
        _put(tables, key, setting)
    changed = {key for key, _ in settings}
    if changed & {"growth", "growth.final"} and not changed & {"output", "output.stages"}:
        _drop_late_stages(tables)
    return tables


def _over(below: dict[str, Any], above: dict[str, Any]) -> dict[str, Any]:
    merged = dict(below)
    for key, value in above.items():
        both = isinstance(value, dict) and isinstance(merged.get(key), dict)
        merged[key] = _over(merged[key], value) if both else value
    return merged


def _key_of(setting: str) -> str:
    """``table.key`` of ``table.key=value``."""
    key, equals, _ = setting.partition("=")
    parts = [part.strip() for part in key.split(".")]
    if not equals or not all(parts):
        raise ValueError(f"setting {as_toml(setting)} must read table.key=value, for example growth.final=1.8.")
    if parts == ["like"]:
        raise ValueError(f"setting {as_toml(setting)}: like stands in a file only; name that scene instead.")
    return ".".join(parts)


def _put(tables: dict[str, Any], key: str, setting: str) -> None:
    """Put the value of ``table.key=value`` into the tables."""
    value = setting.partition("=")[2].strip()
    try:
        parsed = tomllib.loads(f"v = {value}")
    except RecursionError:
        raise ValueError(f"setting {as_toml(setting)}: lists or tables are nested too deeply.") from None
    except ValueError:
        parsed = {}
    *path, last = key.split(".")
    table = tables
    for part in path:
        table = table.setdefault(part, {})
        if not isinstance(table, dict):
            raise ValueError(f"setting {as_toml(setting)}: {part!r} is a value, not a table.")
    table[last] = parsed["v"] if list(parsed) == ["v"] else value       # a bare word is a string


def _table(tables: Mapping[str, Any], name: str) -> dict[str, Any]:
    """A table of the tables, empty if there is none."""
    table = tables.get(name)
    return table if isinstance(table, dict) else {}


def _drop_late_stages(tables: dict[str, Any]) -> None:
    """Stages that a smaller final growth no longer reaches."""
    final, output = _table(tables, "growth").get("final"), _table(tables, "output")
    if isinstance(final, int | float) and isinstance(output.get("stages"), list):
        output["stages"] = [g for g in output["stages"] if not isinstance(g, int | float) or g <= final]


def _toml(tables: Mapping[str, Any], prefix: str = "") -> str:
    lines = [f"{key} = {_value(v)}" for key, v in tables.items() if not isinstance(v, dict)]
    for key, v in tables.items():
        if isinstance(v, dict):
            lines.append(f"\n[{prefix}{key}]")
            body = _toml(v, f"{prefix}{key}.")
            if body.strip():
                lines.append(body.rstrip("\n"))
    return "\n".join(lines) + "\n"


def _value(v: Any) -> str:
    if isinstance(v, bool):
        return "true" if v else "false"
    if isinstance(v, str):
        escaped = v.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")
        return f'"{escaped}"'
    if isinstance(v, dict):
        return "{" + ", ".join(f"{key} = {_value(x)}" for key, x in v.items()) + "}"
    if isinstance(v, tuple | list):
        return "[" + ", ".join(_value(x) for x in v) + "]"
    return repr(v)
