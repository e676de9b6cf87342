"""What the tables of a scene are made of: keys with their meaning, unit and range."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar

from pydantic import BaseModel, ConfigDict, Field


def key(meaning: str, unit: str = "", **limits: Any) -> Any:
    """A key: what it means and in which unit, as docs/scenes.md and diagrams say it, and pydantic's limits of it."""
    return Field(description=meaning, json_schema_extra={"unit": unit}, **limits)


def unit_of(table: type[BaseModel], name: str) -> str:
    """The unit of a key, empty if it has none."""
    field = table.model_fields.get(name)
    extra = field.json_schema_extra if field is not None else None
    return str(extra.get("unit", "")) if isinstance(extra, dict) else ""


SMALLEST, LARGEST = 1e-3, 1e4  # of lengths in a scene [mm]
Length = Annotated[float, Field(ge=SMALLEST, le=LARGEST)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Coordinate = Annotated[float, Field(ge=-LARGEST, le=LARGEST)]
Direction = tuple[float, float, float]
Point = tuple[Coordinate, Coordinate, Coordinate]


class Table(BaseModel):
    """A table of a scene: no unknown keys, nothing converted, nothing changed later."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class Spot(Table):
    """A region around a pial point ``centre`` [mm]: full ``factor`` there, 1 beyond ``radius`` [mm]."""

    centre: Annotated[Point, key("a point of the outer surface", "mm", strict=False)]
    radius: Annotated[Length, key("beyond it the factor is 1", "mm")]
    factor: Annotated[float, key("at the centre", gt=0, le=4)]


class MaterialOptions(Table):
    """The table ``[material]`` of a scene, and what the rest of the house has to know of the material.

    Attributes
    ----------
    theory : bool
        Whether theory, the radial equilibria and what is taken from them are of this material.
    errors_known : bool
        Whether the stored table of errors is of scenes with it.
    """

    theory: ClassVar[bool] = False
    errors_known: ClassVar[bool] = False

    model: str
    mu_ratio: Annotated[float, key("shear modulus of the cortex over that of the core", ge=1e-4, le=1e4)] = 1.0
    kappa_ratio: Annotated[float, key("bulk over shear modulus, in both layers", ge=5, le=2000)] = 50.0

    def build(self) -> Any:
        """The ``Material`` that kernels and tangent take."""
        raise NotImplementedError


class EffectOptions(Table):
    """The table ``[effects.NAME]`` of a scene, and what the rest of the house has to know of the effect.

    Attributes
    ----------
    shapes : tuple of str
        Geometries that can have it.
    theory : bool
        Whether the theory of the growing sphere is as true with it as without.
    errors_known : bool
        Whether the stored table of errors is of scenes with it.
    real_time : bool
        Whether time is real, and growth does not wait for equilibrium.
    at_onset : bool
        Whether it acts on a smooth body, so that the growth at which folds begin hangs on it.
    counted : str
        Where its time is counted, if not under its own name.
    example : str
        Options, as TOML, that do for a sphere of 50 mm and an octant of it; by these it is timed.
    """

    shapes: ClassVar[tuple[str, ...]] = ("sphere", "ellipsoid", "patch", "strip", "mesh")
    theory: ClassVar[bool] = False
    errors_known: ClassVar[bool] = False
    real_time: ClassVar[bool] = False
    at_onset: ClassVar[bool] = True
    counted: ClassVar[str] = ""
    example: ClassVar[str] = "{}"

    def check(self, scene: Any) -> None:
        """Raise ``ValueError`` if it does not go with the rest of the ``Scene``."""

    def first_wrinkles(self, growth: float, scene: Any) -> float:
        """The cortex's growth stretch at which it wrinkles first, from that by theory without this effect."""
        return growth
