"""What a scene says, table by table. An effect runs if and only if its table is there."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Discriminator, Field, Tag, model_validator

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
SMALLEST, LARGEST = 1e-3, 1e4               # of lengths in a scene [mm]
Length = Annotated[float, Field(ge=SMALLEST, le=LARGEST)]

#: accuracy level: surface edge over cortex thickness, by error and time as docs/accuracy.md measures them
LEVELS = {"draft": 0.60, "standard": 0.45, "fine": 0.27}
COARSE = 0.5            # edge over thickness beyond which the time of a third element through the cortex goes elsewhere
CROSSINGS = 180.0       # times that a wave crosses the cortex while growth rises by 1
SLOWEST_RATE = 1e-3     # of growth.rate

MOST_BRICKS = 5_000_000  # about 6 GB of memory

_FOLDED = ("contact", "perturbation", "notch", "core_growth", "regional_growth", "ramp", "inertia")
#: effects that a shape can have, where it can't have them all
EFFECTS_OF = {
    "radial": ("core_growth",),
    "patch": (*_FOLDED, "bulk_viscosity"),
    "strip": (*_FOLDED, "bulk_viscosity"),
    "mesh": _FOLDED,
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
    rate: Annotated[float, Field(ge=SLOWEST_RATE, le=4)] = 1.0


class Contact(_Table):
    """Self-contact of the pial surface; no options."""


class Perturbation(_Table):
    """Random smooth imperfection of the cortical thickness: rms amplitude over the thickness, and its seed.

    ``wavelength`` [mm]: of its waves in space, by default theory's first wrinkles over 1.28: a sphere cuts waves in
    space so much longer (a strip twice, or so).
    """

    amplitude: Annotated[float, Field(gt=0, le=0.3)] = 0.02
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    wavelength: Length | None = None


class Notch(_Table):
    """Narrow pits in the pial surface at points ``at`` [mm], or with ``line`` one groove from each to the next; in a
    strip grooves across it at their x. ``depth`` over the thickness; ``width`` [mm], by default the thickness."""

    at: Annotated[tuple[Annotated[Point, Field(strict=False)], ...], Field(strict=False, min_length=1)]
    line: bool = False
    depth: Annotated[float, Field(gt=0, le=0.5)] = 0.1
    width: Length | None = None


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
    notch: Notch | None = None
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


def elements_through(edge_over_T: float) -> int:
    """Elements through the cortex that go with an edge over its thickness, unless a scene says how many."""
    return 2 if edge_over_T > COARSE else 3


class Accuracy(_Table):
    """Preset, or the number of element layers through the cortex and the largest surface edge [mm], which overrules it
    unless the preset is set later; and the precision of the forces of bricks."""

    level: Literal["draft", "standard", "fine"] = "standard"
    elements_through_cortex: Annotated[int, Field(ge=1, le=12)] | None = None
    edge: Positive | None = None
    precision: Literal["single", "double"] = "single"


class Output(_Table):
    """Growth stretches at which the body rests and surfaces are written; the final one is always written.

    ``stability``: count the unstable modes of each stage, by an exact factorisation of the stiffness. That takes as
    long as half of a run of an octant, far longer for larger bodies, and is done for strips alone unless it is asked
    for.
    """

    stages: Annotated[tuple[Annotated[float, Field(ge=1)], ...], Field(strict=False)] = ()
    volume: bool = True
    stability: bool | None = None
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
        if effects.notch is not None and effects.notch.line and (shape == "strip" or len(effects.notch.at) == 1):
            raise ValueError(
                "effects.notch.line joins two points or more; in a strip grooves run across without it: drop it"
            )
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
    def thinnest(self) -> float:
        """Thickness of the ungrown cortex where a spot makes it thinnest [mm]."""
        factor = min((spot.factor for spot in getattr(self.geometry, "thickness_spots", ())), default=1.0)
        return self.geometry.cortex_thickness * min(factor, 1.0)

    @property
    def edge(self) -> float:
        """Largest surface edge asked for [mm]."""
        return self.accuracy.edge or LEVELS[self.accuracy.level] * self.thinnest

    @property
    def elements_through_cortex(self) -> int:
        """Layers of bricks in the cortex."""
        return self.accuracy.elements_through_cortex or elements_through(self.edge / self.thinnest)

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
        geometry, layers = self.geometry, self.elements_through_cortex + 8
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


def in_double(scene: Scene) -> Scene:
    """The same scene with forces of double precision, as states at rest and their stability need them."""
    return scene.model_copy(update={"accuracy": scene.accuracy.model_copy(update={"precision": "double"})})
