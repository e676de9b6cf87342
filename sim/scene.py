"""What a scene says: validated TOML. An effect runs if and only if its table is there."""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Iterable, Mapping
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]

#: accuracy level: (surface edge over cortex thickness, steps per unit of growth and cell of a quarter circle)
LEVELS = {"draft": (0.80, 110.0), "standard": (0.55, 140.0), "fine": (0.40, 180.0)}


MOST_BRICKS = 5_000_000  # about 6 GB of memory


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class Geometry(_Table):
    """Bilayer sphere (Razavi et al. 2015, Fig. 2): C = radius, C - B = cortex_thickness, A = hole_radius [mm]."""

    shape: Literal["sphere"] = "sphere"
    radius: Positive = 50.0
    cortex_thickness: Positive = 2.0
    hole_radius: Positive = 25.0
    portion: Literal["full", "half", "quarter", "octant"] = "half"

    @model_validator(mode="after")
    def _layers_fit(self) -> Geometry:
        if self.cortex_thickness >= self.radius:
            raise ValueError(
                f"cortex_thickness {self.cortex_thickness:g} leaves no core in radius {self.radius:g}; make it smaller"
            )
        core = self.radius - self.cortex_thickness
        if self.hole_radius >= core:
            raise ValueError(
                f"hole_radius {self.hole_radius:g} is not inside the core of radius {core:g} (radius {self.radius:g} - "
                f"cortex_thickness {self.cortex_thickness:g}); make it smaller than {core:g}"
            )
        return self


class Material(_Table):
    """``mu_ratio``: shear modulus of the cortex over that of the core. ``kappa_ratio``: kappa over mu of the core, for
    both layers; from mu_ratio 2 on it is raised by mu_ratio / 2, so that a stiff cortex stays nearly incompressible.
    """

    mu_ratio: Positive = 1.0
    kappa_ratio: Annotated[float, Field(ge=5, le=2000)] = 50.0


class Growth(_Table):
    """Growth law and final growth stretch of the cortex; ``rate`` below 1 grows slower than the level's own pace."""

    law: Literal["isotropic", "tangential"] = "isotropic"
    final: Annotated[float, Field(ge=1, le=4)] = 2.0
    rate: Annotated[float, Field(gt=0, le=4)] = 1.0


class Contact(_Table):
    """Self-contact of the pial surface; no options."""


class Perturbation(_Table):
    """Random smooth imperfection of the cortical thickness: rms amplitude over the thickness, and its seed.

    ``degree``: waves per turn; by default 0.8 radius / thickness, about the wrinkles' own.
    """

    amplitude: Annotated[float, Field(gt=0, le=0.3)] = 0.02
    seed: Annotated[int, Field(ge=0)] = 0
    degree: Positive | None = None


class Effects(_Table):
    contact: Contact | None = None
    perturbation: Perturbation | None = None

    @property
    def named(self) -> tuple[str, ...]:
        """Effects that this scene calls for."""
        return tuple(name for name in type(self).model_fields if getattr(self, name) is not None)


class Accuracy(_Table):
    """Preset, or the number of brick layers through the cortex and of cells along a quarter circle."""

    level: Literal["draft", "standard", "fine"] = "standard"
    elements_through_cortex: Annotated[int, Field(ge=1, le=12)] = 3
    cells_per_quarter: Annotated[int, Field(ge=4, le=400)] | None = None

    @model_validator(mode="after")
    def _even(self) -> Accuracy:
        if self.cells_per_quarter is not None and self.cells_per_quarter % 2:
            raise ValueError(f"cells_per_quarter must be even, got {self.cells_per_quarter}")
        return self


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
    geometry: Geometry = Geometry()
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
    def _fits_in_memory(self) -> Scene:
        share = {"full": 1.0, "half": 0.5, "quarter": 0.25, "octant": 0.125}[self.geometry.portion]
        bricks = 6 * self.cells**2 * share * (self.accuracy.elements_through_cortex + 6)
        if bricks > MOST_BRICKS:
            raise ValueError(
                f"this takes about {bricks:.1e} bricks ({self.cells} cells along a quarter circle), more than "
                f"{MOST_BRICKS:.0e}; take a thicker cortex, a smaller portion, a coarser accuracy.level or fewer "
                "accuracy.cells_per_quarter"
            )
        return self

    @property
    def stages(self) -> tuple[float, ...]:
        """Growth stretches at which surfaces are written, ascending, the final one last."""
        return tuple(sorted({*self.output.stages, self.growth.final}))

    @property
    def cells(self) -> int:
        """Surface cells along a quarter of a great circle."""
        if self.accuracy.cells_per_quarter is not None:
            return self.accuracy.cells_per_quarter
        edge = LEVELS[self.accuracy.level][0] * self.geometry.cortex_thickness
        return max(8, 2 * round(0.5 * 1.5707963 * self.geometry.radius / edge))

    @property
    def steps_per_unit(self) -> float:
        """Steps for growth to rise by 1: a wave needs as many more steps to cross as there are more cells."""
        return LEVELS[self.accuracy.level][1] * self.cells / self.growth.rate

    @property
    def moduli(self) -> tuple[float, float, float]:
        """mu of cortex and core, and kappa, in units of mu of the core."""
        mu = self.material.mu_ratio
        return mu, 1.0, self.material.kappa_ratio * max(1.0, mu / 2)

    def to_toml(self) -> str:
        """This scene, every value spelled out, as TOML."""
        return _toml(self.model_dump(exclude_none=True))


def scene_names() -> list[str]:
    """Names of the built-in scenes."""
    folder = resources.files("morphofold.sim") / "scenes"
    return sorted(p.name.removesuffix(".toml") for p in folder.iterdir() if p.name.endswith(".toml"))


def load_scene(source: str | Path | Scene, settings: Iterable[str] = ()) -> Scene:
    """A scene from a built-in name, a TOML file, or a ``Scene``, with ``table.key=value`` settings put over it.

    Raises
    ------
    FileNotFoundError
        If there is neither a built-in scene nor a file of that name.
    ValueError
        If the file is not TOML, or says something unknown, impossible or contradictory; one line per problem,
        with the line it stands on.
    """
    if isinstance(source, Scene):
        text, where = source.to_toml(), source.name
    else:
        text, where = _read(source)
    try:
        tables = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ValueError(f"{where}: not a TOML file: {error}.") from None
    settings = list(settings)
    changed = {_put(tables, setting): setting for setting in settings}
    if "growth.final" in changed and "output.stages" not in changed:
        _drop_late_stages(tables)
    try:
        return Scene.model_validate(tables)
    except ValidationError as error:
        raise ValueError("\n".join(_explain(p, text, where, changed) for p in error.errors())) from None


def _read(source: str | Path) -> tuple[str, str]:
    path = Path(source)
    if path.suffix != ".toml" and str(source) in scene_names():
        return (resources.files("morphofold.sim") / "scenes" / f"{source}.toml").read_text("utf-8"), str(source)
    if not path.is_file():
        close = difflib.get_close_matches(str(source), scene_names(), n=1)
        hint = f" Did you mean {close[0]}?" if close else f" Built-in scenes: {', '.join(scene_names())}."
        raise FileNotFoundError(f"no scene file or built-in scene {str(source)!r}.{hint}")
    if path.stat().st_size > 1_000_000:
        raise ValueError(f"{path}: {path.stat().st_size:,} bytes is no scene file.")
    try:
        return path.read_text("utf-8"), str(path)
    except UnicodeDecodeError:
        raise ValueError(f"{path}: not a TOML file: it is not UTF-8 text.") from None


def _put(tables: dict[str, Any], setting: str) -> str:
    """Put ``table.key=value`` into the tables; returns ``table.key``."""
    key, equals, value = setting.partition("=")
    if not equals or not key.strip():
        raise ValueError(f"setting {setting!r} must read table.key=value, for example growth.final=1.8.")
    try:
        parsed = tomllib.loads(f"v = {value}")["v"]
    except tomllib.TOMLDecodeError:
        parsed = value.strip()                                          # a bare word is a string
    *path, last = key.strip().split(".")
    table = tables
    for part in path:
        table = table.setdefault(part, {})
        if not isinstance(table, dict):
            raise ValueError(f"setting {setting!r}: {part!r} is a value, not a table.")
    table[last] = parsed
    return key.strip()


def _drop_late_stages(tables: dict[str, Any]) -> None:
    """Stages that a smaller final growth no longer reaches."""
    final, output = tables["growth"]["final"], tables.get("output", {})
    if isinstance(final, int | float) and isinstance(output, dict) and isinstance(output.get("stages"), list):
        output["stages"] = [g for g in output["stages"] if not isinstance(g, int | float) or g <= final]


def _explain(problem: Mapping[str, Any], text: str, where: str, changed: Mapping[str, str]) -> str:
    """One problem as: where, which key, what is wrong, what to do."""
    loc = [str(part) for part in problem["loc"]]
    key = ".".join(loc) or "scene"
    words = [word.strip(".,:;()").split(".") for word in problem["msg"].split()]
    line = next((n for word in words if (n := _line_of(text, loc + word, exact=True))), None) or _line_of(text, loc)
    at = f"{where}, line {line}" if line else where
    blamed = [s for k, s in changed.items() if k == key or k.startswith(f"{key}.") or k in problem["msg"]
              or (not loc and k.split(".")[-1] in problem["msg"])]  # fmt: skip
    at = f"setting {blamed[0]}" if blamed else at
    if problem["type"] == "extra_forbidden":
        model: Any = Scene
        for part in loc[:-1]:
            model = next(iter(_models(model.model_fields[part].annotation)), model)
        close = difflib.get_close_matches(loc[-1], model.model_fields, n=1)
        names = ", ".join(model.model_fields)
        known = f"Did you mean {close[0]}?" if close else f"Known here: {names}." if names else "It has no options."
        return f"{at}: unknown key {key}. {known}"
    message = _WORDS.get(problem["type"]) or problem["msg"].removeprefix("Value error, ")
    got = "" if isinstance(problem["input"], dict | BaseModel) else f" (got {problem['input']!r})"
    return f"{at}: {key}: {message}{got}."


#: pydantic's words for what a TOML file can get wrong, in words of TOML
_WORDS = {
    "model_type": "must be a table of keys",
    "tuple_type": "must be a list, for example [1.5, 1.8]",
    "float_type": "must be a number",
    "int_type": "must be a whole number",
    "string_type": "must be text in quotes",
    "bool_type": "must be true or false",
    "finite_number": "must be a finite number",
}


def _models(annotation: Any) -> list[type[BaseModel]]:
    options = getattr(annotation, "__args__", (annotation,))
    return [option for option in options if isinstance(option, type) and issubclass(option, BaseModel)]


def _line_of(text: str, loc: list[str], exact: bool = False) -> int | None:
    """Line on which the key at ``loc`` stands, or (unless ``exact``) its table, or None."""
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
    if isinstance(v, tuple | list):
        return "[" + ", ".join(_value(x) for x in v) + "]"
    return repr(v)
