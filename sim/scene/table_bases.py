"""Base classes of the tables of a scene: keys with their meaning, unit and range."""

import difflib
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator
from pydantic_core import InitErrorDetails, PydanticCustomError


def key(meaning: str, unit: str = "", **limits: Any) -> Any:
    """A key: its meaning and unit, as in docs/scenes.md and diagrams, and its limits for pydantic."""
    return Field(description=meaning, json_schema_extra={"unit": unit}, **limits)


def unit_of(table: type[BaseModel], name: str) -> str:
    """The unit of a key, empty if it has none."""
    field = table.model_fields.get(name)
    schema_extra = field.json_schema_extra if field is not None else None
    return str(schema_extra.get("unit", "")) if isinstance(schema_extra, dict) else ""


SHORTEST_LENGTH_MM, LONGEST_LENGTH_MM = 1e-3, 1e4  # of lengths in a scene [mm]
Length = Annotated[float, Field(ge=SHORTEST_LENGTH_MM, le=LONGEST_LENGTH_MM)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Coordinate = Annotated[float, Field(ge=-LONGEST_LENGTH_MM, le=LONGEST_LENGTH_MM)]
Direction = tuple[float, float, float]
Point = tuple[Coordinate, Coordinate, Coordinate]


class Table(BaseModel):
    """A table of a scene: it allows no unknown keys, converts no values and cannot be changed later."""

    model_config = ConfigDict(frozen=True, strict=True, allow_inf_nan=False)

    @model_validator(mode="before")
    @classmethod
    def _has_known_keys(cls, table: Any) -> Any:
        return check_keys(table, cls.model_fields)


def check_keys(table: Any, known: Iterable[str]) -> Any:
    """The table, if that is what it is and all its keys are known; a problem for each other key says which are."""
    problems = []
    for name in (name for name in (table if isinstance(table, Mapping) else ()) if name not in known):
        similar_names = difflib.get_close_matches(name, known, n=1)
        hint = f"did you mean {similar_names[0]}?" if similar_names else f"known here: {', '.join(known) or 'none'}"
        problems.append(_unknown(name, f"unknown key ({hint})", table))
    if problems:
        raise ValidationError.from_exception_data("table", problems)
    return table


def read_variant(
    table: Any, key: str, default: str, names: Iterable[str], model_of: Callable[[str], type[Table]]
) -> Any:
    """A table, read by the model of the variant that its ``key`` names, or by that of the default one."""
    if isinstance(table, Table):
        return table
    name = table.get(key, default) if isinstance(table, Mapping) else default
    if name not in [*names]:
        problem = _unknown(key, f"must be one of {', '.join(names)}", name)
        raise ValidationError.from_exception_data("table", [problem])
    return model_of(name).model_validate(table)


def _unknown(name: str, text: str, value: Any) -> InitErrorDetails:
    return InitErrorDetails(type=PydanticCustomError("unknown_name", text), loc=(name,), input=value)  # type: ignore[arg-type]


class Spot(Table):
    """A region around a pial point ``centre`` [mm]: the full ``factor`` at the centre, 1 beyond ``radius`` [mm]."""

    centre: Point = key("a point of the outer surface", "mm", strict=False)
    radius: Length = key("distance beyond which the factor is 1", "mm")
    factor: float = key("factor at the centre", gt=0, le=4)


class SphereMap(Table):
    """A map with a value for each vertex of a sphere, smoothed by spherical harmonics up to ``degree``."""

    file: str = key(
        "FreeSurfer, GIFTI or text file: a path from the scene, or one of data_samples; of a subject also a name, "
        "`thickness` is `surf/?h.thickness`",
        min_length=1,
    )
    sphere: str | None = key(
        "sphere of its vertices, registered to that of the body; by default that of the subject", default=None
    )
    degree: int = key(
        "largest degree of the harmonics: 16 shows what is wider than a tenth of the body", ge=0, le=40, default=16
    )


class MaterialOptions(Table):
    """The table ``[material]`` of a scene, and what the rest of the package needs to know about the material.

    Attributes
    ----------
    theory : bool
        Whether the theory, the radial equilibria and what is derived from them hold for this material.
    errors_known : bool
        Whether the stored table of errors is valid for scenes with it.
    """

    theory: ClassVar[bool] = False
    errors_known: ClassVar[bool] = False

    model: str
    mu_ratio: float = key("shear modulus of the cortex over that of the core", ge=1e-4, le=1e4, default=1.0)
    kappa_ratio: float = key("bulk over shear modulus, in both layers", ge=5, le=2000, default=50.0)

    def build(self) -> Any:
        """The ``Material`` that kernels and tangent take."""
        raise NotImplementedError


class EffectOptions(Table):
    """The table ``[effects.NAME]`` of a scene, and what the rest of the package needs to know about the effect.

    Attributes
    ----------
    shapes : tuple of str
        Geometries that can use it.
    theory : bool
        Whether the theory of the growing sphere still holds with it.
    errors_known : bool
        Whether the stored table of errors is valid for scenes with it.
    real_time : bool
        Whether time is real, so that growth does not wait for equilibrium.
    at_onset : bool
        Whether it acts on a smooth body, so that the growth at which folds begin depends on it.
    history : bool
        Whether a state depends on how it was reached, so that a run can't begin at the state of another run.
    counted : str
        Name under which its time is counted, if not its own.
    example : str
        Options, as TOML, that work for a sphere of 50 mm and an octant of it; it is timed with these.
    """

    shapes: ClassVar[tuple[str, ...]] = ("sphere", "ellipsoid", "patch", "strip", "cortex", "mesh")
    theory: ClassVar[bool] = False
    errors_known: ClassVar[bool] = False
    real_time: ClassVar[bool] = False
    at_onset: ClassVar[bool] = True
    history: ClassVar[bool] = False
    counted: ClassVar[str] = ""
    example: ClassVar[str] = "{}"

    def files(self, scene: Any) -> dict[str, Path]:
        """The files that it reads, by content."""
        return {}

    def check(self, scene: Any) -> None:
        """Raise ``ValueError`` if it does not fit the rest of the ``Scene``."""

    def first_wrinkles(self, growth: float, scene: Any) -> float:
        """Growth stretch of the cortex at its first wrinkles, from the theoretical value without this effect."""
        return growth
